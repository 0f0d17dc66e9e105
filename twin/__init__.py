"""The digital twin: a Clearpath Jackal in MuJoCo under ROS's move_base.

    import numpy as np
    from twin import Cylinder, MoveBaseDriver, Pose2, Rules, Simulation, World, rollout

    rules = Rules("course", goal_tolerance=0.5, time_limit=60.0)
    world = World("one post", (Cylinder(2.0, 0.1, 0.2, 0.8),), Pose2(0, 0, 0), Pose2(5, 0, 0), rules)
    for tick in rollout(Simulation(world, np.random.default_rng(0)), MoveBaseDriver()):
        print(tick.elapsed, tick.true_pose, tick.outcome)

What stands in `__all__` is the public API. MuJoCo, numba and Rerun are loaded with the first name that needs them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from twin.records import Arc, Command, Contact, Decision, Observation, ObstacleMap, Outcome, Pose2, Scan, Tick, Twist2
from twin.rollout import Driver, Loop, LoopState, Referee, rollout
from twin.world import Box, Cylinder, Mesh, Rules, Segment, World

if TYPE_CHECKING:
    from twin.environment import Environment, RewardWeights, Task
    from twin.planner.move_base import MoveBase, MoveBaseDriver, MoveBaseSettings
    from twin.planner.params import ParameterSpace, PlannerParams
    from twin.planner.plan import PlannerSettings
    from twin.planner.trajectory_state import ControllerSettings, LocalPlannerSettings
    from twin.recording import Recorder, Recording, RecordingError, read_recording
    from twin.rewind import Tape
    from twin.robot.drive import DriveConfig
    from twin.robot.lidar import LidarConfig
    from twin.robot.odometry import OdometryConfig
    from twin.simulation import RobotConfig, Simulation, Snapshot

__all__ = [
    "Arc",
    "Box",
    "Command",
    "Contact",
    "ControllerSettings",
    "Cylinder",
    "Decision",
    "DriveConfig",
    "Driver",
    "Environment",
    "LidarConfig",
    "LocalPlannerSettings",
    "Loop",
    "LoopState",
    "Mesh",
    "MoveBase",
    "MoveBaseDriver",
    "MoveBaseSettings",
    "Observation",
    "ObstacleMap",
    "OdometryConfig",
    "Outcome",
    "ParameterSpace",
    "PlannerParams",
    "PlannerSettings",
    "Pose2",
    "Recorder",
    "Recording",
    "RecordingError",
    "Referee",
    "RewardWeights",
    "RobotConfig",
    "Rules",
    "Scan",
    "Segment",
    "Simulation",
    "Snapshot",
    "Tape",
    "Task",
    "Tick",
    "Twist2",
    "World",
    "read_recording",
    "rollout",
]

_HOMES = {
    "RobotConfig": "simulation",
    "Simulation": "simulation",
    "Snapshot": "simulation",
    "Tape": "rewind",
    "Environment": "environment",
    "RewardWeights": "environment",
    "Task": "environment",
    "Recorder": "recording",
    "Recording": "recording",
    "RecordingError": "recording",
    "read_recording": "recording",
    "ParameterSpace": "planner.params",
    "PlannerParams": "planner.params",
    "PlannerSettings": "planner.plan",
    "MoveBase": "planner.move_base",
    "MoveBaseDriver": "planner.move_base",
    "MoveBaseSettings": "planner.move_base",
    "ControllerSettings": "planner.trajectory_state",
    "LocalPlannerSettings": "planner.trajectory_state",
    "DriveConfig": "robot.drive",
    "LidarConfig": "robot.lidar",
    "OdometryConfig": "robot.odometry",
}


def __getattr__(name: str) -> Any:
    """A name of the public API, loaded when it is first asked for (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
