"""The robot under its base controller, without planner: what the driving tests measure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from tests.robot.worlds import world
from twin.arena import compile_world
from twin.records import Command, Pose2
from twin.robot import drive, odometry
from twin.robot.handles import RobotHandles

PERIOD = drive.DriveConfig().period


@dataclass(frozen=True)
class Track:
    """What happened, sampled once per controller period."""

    poses: np.ndarray  # (n, 3) true x, y [m], yaw [rad], unwrapped
    twists: np.ndarray  # (n, 2) true v [m/s], w [rad/s]
    estimates: np.ndarray  # (n, 3) odometry x, y, yaw, unwrapped
    tilt: np.ndarray  # (n,) [rad] of base_link's z axis from the vertical

    @property
    def length(self) -> float:
        """Distance driven [m]."""
        return float(np.linalg.norm(np.diff(self.poses[:, :2], axis=0), axis=1).sum())


def run(
    commands: Iterable[Command | None],
    timestep: float = 0.002,
    config: odometry.OdometryConfig | None = None,
    seed: int = 0,
) -> Track:
    """Drive on an open floor; one command per controller period, None = nothing arrives."""
    model = compile_world(world("open"), timestep=timestep)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    robot = RobotHandles.resolve(model)
    rng = np.random.default_rng(seed)
    base, estimate = drive.DriveState(), odometry.begin(robot.pose(data))
    poses, twists, estimates, tilt = [], [], [], []
    for command in commands:
        if command is not None:
            base = drive.receive(base, command)
        base, wheels = drive.advance(base, drive.DriveConfig())
        robot.drive(data, wheels.left, wheels.right)
        mujoco.mj_step(model, data, round(PERIOD / timestep))
        pose, twist = robot.pose(data), robot.twist(data)
        reading = odometry.Reading(robot.wheel_speeds(data), robot.yaw_rate(data), pose, twist)
        estimate = odometry.advance(estimate, reading, config or odometry.OdometryConfig(), rng)
        poses.append(_row(pose))
        estimates.append(_row(estimate.pose))
        twists.append((twist.v, twist.w))
        tilt.append(float(np.arccos(np.clip(data.xmat[robot.bodies[0], 8], -1, 1))))
    return Track(_unwrapped(poses), np.array(twists), _unwrapped(estimates), np.array(tilt))


def held(v: float, w: float, seconds: float) -> list[Command]:
    """The same command for a while."""
    return [Command(v, w)] * round(seconds / PERIOD)


def _row(pose: Pose2) -> tuple[float, float, float]:
    return pose.x, pose.y, pose.yaw


def _unwrapped(rows: list[tuple[float, float, float]]) -> np.ndarray:
    table = np.array(rows)
    table[:, 2] = np.unwrap(table[:, 2])
    return table
