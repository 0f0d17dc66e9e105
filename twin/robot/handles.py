"""Where the Jackal's parts lie inside a compiled model, and how to read them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from twin.records import Array, Pose2, Twist2
from twin.robot.jackal import WHEELS

Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class RobotHandles:
    """Ids and addresses of one Jackal; wheels always in the order fl, fr, rl, rr."""

    bodies: Indices  # (5,) body ids: chassis, wheels
    free_qpos: int  # qpos address of the free joint: position (3) [m], quaternion (4) w x y z
    free_dof: int  # qvel address of the free joint: linear (3) [m/s] world, angular (3) [rad/s] body
    wheel_dofs: Indices  # (4,) qvel addresses
    actuators: Indices  # (4,) ctrl addresses
    lidar: int  # site id
    mount: tuple[float, float, float]  # [m] lidar focal point in base_link
    floor: int  # geom id
    is_robot: NDArray[np.bool_] = field(repr=False)  # (ngeom,) the robot's geoms

    @classmethod
    def resolve(cls, model: mujoco.MjModel, prefix: str = "jackal/", floor: str = "floor") -> RobotHandles:
        """Look everything up by name once, so that the loop only indexes."""
        chassis = model.body(f"{prefix}chassis").id
        base = int(model.body_rootid[chassis])
        joint = int(model.body_jntadr[base])
        if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
            raise ValueError("the robot has no free joint: attach it as twin.arena does")
        lidar = model.site(f"{prefix}lidar").id
        mount = model.body_pos[model.site_bodyid[lidar]] + model.site_pos[lidar]
        wheels = [f"{prefix}{name}_wheel" for name in WHEELS]
        return cls(
            bodies=np.array([chassis, *(model.body(wheel).id for wheel in wheels)]),
            free_qpos=int(model.jnt_qposadr[joint]),
            free_dof=int(model.jnt_dofadr[joint]),
            wheel_dofs=np.array([model.jnt_dofadr[model.joint(wheel).id] for wheel in wheels]),
            actuators=np.array([model.actuator(wheel).id for wheel in wheels]),
            lidar=lidar,
            mount=(float(mount[0]), float(mount[1]), float(mount[2])),
            is_robot=model.body_rootid[model.geom_bodyid] == base,
            floor=model.geom(floor).id,
        )

    def pose(self, data: mujoco.MjData) -> Pose2:
        """World pose of base_link, from the state itself (valid straight after mj_step)."""
        x, y, _, qw, qx, qy, qz = data.qpos[self.free_qpos : self.free_qpos + 7].tolist()
        return Pose2(x, y, math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz)))

    def twist(self, data: mujoco.MjData) -> Twist2:
        """True planar velocity in base_link."""
        vx, vy, _, _, _, w = data.qvel[self.free_dof : self.free_dof + 6].tolist()
        yaw = self.pose(data).yaw
        return Twist2(vx * math.cos(yaw) + vy * math.sin(yaw), w)

    def wheel_speeds(self, data: mujoco.MjData) -> Array:
        """(4,) [rad/s], positive forward."""
        return np.asarray(data.qvel[self.wheel_dofs], dtype=np.float64)

    def yaw_rate(self, data: mujoco.MjData) -> float:
        """The gyro's z [rad/s], without noise.

        Read from the state, not from `sensordata`, which lags one step behind it and does not survive a restore.
        """
        return float(data.qvel[self.free_dof + 5])  # a free joint's angular velocity is in the body's own frame

    def drive(self, data: mujoco.MjData, left: float, right: float) -> None:
        """Command the wheel servos [rad/s]."""
        data.ctrl[self.actuators] = (left, right, left, right)

    def body_poses(self, data: mujoco.MjData) -> Array:
        """(5, 7) world position [m] and quaternion (w, x, y, z) of chassis and wheels."""
        return np.hstack([data.xpos[self.bodies], data.xquat[self.bodies]])

    def touched(self, data: mujoco.MjData) -> tuple[int, float, float] | None:
        """The first thing touched that is not the floor: its geom id and where, world x, y [m]."""
        for i, (first, second) in enumerate(data.contact.geom[: data.ncon].tolist()):
            other = second if self.is_robot[first] else first
            if other != self.floor:
                x, y, _ = data.contact.pos[i].tolist()
                return other, x, y
        return None
