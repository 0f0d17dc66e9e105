"""The sole owner of MuJoCo's model and data: a Jackal in a world that can be observed, driven, saved and restored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from twin.arena import compile_world
from twin.clearance import ClearanceGauge
from twin.planner.obstacle_memory import ObstacleMemory, forget_beyond, no_obstacles, remember
from twin.records import Array, Command, Contact, Observation, Pose2, Scan, frozen_array
from twin.robot import drive, odometry
from twin.robot.drive import DriveConfig, DriveState
from twin.robot.handles import RobotHandles
from twin.robot.lidar import Lidar, LidarConfig
from twin.robot.odometry import OdometryConfig, OdometryState, Reading
from twin.world import World

TICK = 0.05  # [s] scan, map updates, planning and control are serialised at 20 Hz
CONTACT_CHECK = 0.01  # [s] how often contacts are looked at; a touch lasts longer than that


@dataclass(frozen=True, slots=True)
class RobotConfig:
    """How the robot is simulated."""

    lidar_mount: str = "ust10"
    lidar: LidarConfig = field(default_factory=LidarConfig)
    drive: DriveConfig = field(default_factory=DriveConfig)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    timestep: float = 0.002  # [s] of the physics; divides 0.01


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The whole state of a simulation between two ticks."""

    physics: Array  # mjSTATE_INTEGRATION
    steps: int
    drive: DriveState
    odometry: OdometryState
    obstacles: ObstacleMemory
    noise: Mapping[str, Any]  # state of the random generator


class Simulation:
    """One robot in one world. Built fresh for every trial; there is no reset."""

    def __init__(self, world: World, rng: np.random.Generator, config: RobotConfig = RobotConfig()) -> None:
        """Compile the world and put the robot at its start, at rest. `rng` drives all noise."""
        self.world = world
        self.config = config = config or RobotConfig()
        self._rng = rng
        self._model = compile_world(world, config.lidar_mount, config.timestep)
        self._data = mujoco.MjData(self._model)
        self._robot = RobotHandles.resolve(self._model)
        self._lidar = Lidar(self._model, self._robot, config.lidar)
        self._gauge = ClearanceGauge(world)
        self._drive = DriveState()
        self._odometry = odometry.begin(world.start)
        self._obstacles = no_obstacles()
        self._steps = 0
        self._chunk = round(CONTACT_CHECK / config.timestep)
        self._period = round(config.drive.period / config.timestep)  # drive and odometry, in steps
        mujoco.mj_forward(self._model, self._data)

    @property
    def time(self) -> float:
        """Simulated seconds since the start."""
        return self._steps * self.config.timestep

    @property
    def true_pose(self) -> Pose2:
        """base_link in the world, without error."""
        return self._robot.pose(self._data)

    @property
    def body_poses(self) -> Array:
        """(5, 7) world position [m] and quaternion (w, x, y, z): chassis, then wheels fl, fr, rl, rr."""
        return frozen_array(self._robot.body_poses(self._data))

    @property
    def clearance(self) -> float:
        """True distance from the robot's outline to the nearest obstacle [m]."""
        return self._gauge(self.true_pose)

    @property
    def goal(self) -> Pose2:
        """The goal in odom as it was given at the start, when odom and world differed by a translation only."""
        start, goal = self.world.start, self.world.goal
        return Pose2(goal.x - start.x, goal.y - start.y, goal.yaw)

    def scan(self) -> Scan:
        """One lidar sweep with fresh noise."""
        return self._lidar.scan(self._data, self._rng)

    def observe(self) -> Observation:
        """Take a scan, let it mark and clear both obstacle maps, and return all that a driver may know.

        Call it once per tick: every call is a new scan with new noise.
        """
        scan = self.scan()
        pose = self._odometry.pose
        self._obstacles = maps = remember(self._obstacles, scan, pose)
        return Observation(self.time, pose, self._odometry.twist, scan, maps.local_map, maps.global_map, self.goal)

    def apply(self, command: Command | None, clear_beyond: float | None = None) -> Contact | None:
        """Advance one tick under a command; None publishes nothing, so that the last command runs into its time-out.

        `clear_beyond` is the clearing recovery: both maps forget what lies outside a square of that side [m].
        Returns the first contact with anything but the floor.
        """
        if command is not None:
            self._drive = drive.receive(self._drive, command)
        if clear_beyond is not None:
            self._obstacles = forget_beyond(self._obstacles, self._odometry.pose, clear_beyond)
        contact: Contact | None = None
        end = self._steps + round(TICK / self.config.timestep)
        while self._steps < end:
            if self._steps % self._period == 0:
                self._control_period()
            mujoco.mj_step(self._model, self._data, self._chunk)
            self._steps += self._chunk
            if contact is None and (hit := self._robot.touched(self._data)) is not None:
                contact = Contact(self.time, hit[1], hit[2], self._model.geom(hit[0]).name)
        mujoco.mj_kinematics(self._model, self._data)
        return contact

    def _control_period(self) -> None:
        """50 Hz: read wheels and gyro, then set the wheel speeds for the next period."""
        robot, data = self._robot, self._data
        if self._steps > 0:
            reading = Reading(robot.wheel_speeds(data), robot.yaw_rate(data), robot.pose(data), robot.twist(data))
            self._odometry = odometry.advance(self._odometry, reading, self.config.odometry, self._rng)
        self._drive, wheels = drive.advance(self._drive, self.config.drive)
        robot.drive(data, wheels.left, wheels.right)

    def snapshot(self) -> Snapshot:
        """Everything that decides the future, taken between two ticks."""
        spec = mujoco.mjtState.mjSTATE_INTEGRATION
        physics = np.empty(mujoco.mj_stateSize(self._model, spec))
        mujoco.mj_getState(self._model, self._data, physics, spec)
        noise = self._rng.bit_generator.state
        return Snapshot(frozen_array(physics), self._steps, self._drive, self._odometry, self._obstacles, noise)

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a snapshot of this simulation; what follows replays bit for bit."""
        mujoco.mj_setState(self._model, self._data, snapshot.physics, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._steps, self._drive, self._odometry = snapshot.steps, snapshot.drive, snapshot.odometry
        self._obstacles = snapshot.obstacles
        self._rng.bit_generator.state = snapshot.noise
        mujoco.mj_kinematics(self._model, self._data)
