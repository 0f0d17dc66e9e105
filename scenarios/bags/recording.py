"""A fold over ticks that writes a drive as a ROS 2 bag: what the robot published and was told, and nothing else.

The bag's clock is the simulation's plus one second, so that equal drives give equal bags. Every message of a tick
carries its time.
"""

from __future__ import annotations

import math
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from scenarios.bags.files import BagWriter, Stamped, Topic, message
from twin.records import Array, Command, Observation, Pose2, Scan, Tick
from twin.simulation import TICK

ODOM, BASE, LASER = "odom", "base_link", "front_laser"

SCAN = Topic("/scan", "sensor_msgs/msg/LaserScan")
ODOMETRY = Topic("/odometry", "nav_msgs/msg/Odometry")
CMD_VEL = Topic("/cmd_vel", "geometry_msgs/msg/Twist")
TF = Topic("/tf", "tf2_msgs/msg/TFMessage")
TF_STATIC = Topic("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
PLAN = Topic("/plan", "nav_msgs/msg/Path")
GOAL = Topic("/goal", "geometry_msgs/msg/PoseStamped")
TOPICS = (SCAN, ODOMETRY, CMD_VEL, TF, TF_STATIC, PLAN, GOAL)

BEGIN = 10**9  # [ns] on the bag's clock when the simulation starts: to ROS a stamp of zero means "not set"
POSE_VARIANCES = (0.001, 0.001, 1e6, 1e6, 1e6, 0.03)  # jackal_control/config/control.yaml
TWIST_VARIANCES = (0.001, 0.001, 0.001, 1e6, 1e6, 0.03)  # jackal_control/config/control.yaml


class BagRecorder:
    """Writes ticks to an MCAP file. A context manager; see BagWriter for what is left on disk however it ends."""

    def __init__(self, path: Path) -> None:
        """Raises BagError when the file exists or cannot be created."""
        self._writer = BagWriter(path, TOPICS)
        self._last: Tick | None = None

    def __enter__(self) -> BagRecorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.__exit__(kind, error, trace)

    def add(self, tick: Tick) -> None:
        """Record one tick. Raises BagError when the file cannot be written any more."""
        before, self._last = self._last, tick
        self._writer.write(messages(tick, before))


def messages(tick: Tick, before: Tick | None) -> list[Stamped]:
    """What the robot says in one tick. Goal and plan are said when they are new."""
    x, decision = tick.observation, tick.decision
    time = BEGIN + round(x.time * 1e9)
    said: list[Stamped] = []
    if before is None:
        said.append((TF_STATIC.name, time, _transforms(time, BASE, LASER, x.scan.mount, 0.0)))
    said.append((TF.name, time, _transforms(time, ODOM, BASE, (x.pose.x, x.pose.y, 0.0), x.pose.yaw)))
    said.append((ODOMETRY.name, time, _odometry(time, x)))
    said.append((SCAN.name, time, _scan(time, x.scan)))
    if before is None or x.goal != before.observation.goal:
        said.append((GOAL.name, time, _pose_stamped(time, x.goal)))
    path, old = decision.global_path, None if before is None else before.decision.global_path
    if path is not None and not (old is not None and np.array_equal(path, old)):
        said.append((PLAN.name, time, _path(time, path, x.goal)))
    if tick.applied is not None:  # None: nothing was published, and the last command holds until its time-out
        said.append((CMD_VEL.name, time, _twist(tick.applied)))
    return said


def _header(time: int, frame: str) -> Any:
    stamp = message("builtin_interfaces/msg/Time", time // 10**9, time % 10**9)
    return message("std_msgs/msg/Header", stamp, frame)


def _vector(x: float, y: float, z: float) -> Any:
    return message("geometry_msgs/msg/Vector3", x, y, z)


def _turn(yaw: float) -> Any:
    return message("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


def _pose(pose: Pose2) -> Any:
    return message("geometry_msgs/msg/Pose", message("geometry_msgs/msg/Point", pose.x, pose.y, 0.0), _turn(pose.yaw))


def _pose_stamped(time: int, pose: Pose2) -> Any:
    return message("geometry_msgs/msg/PoseStamped", _header(time, ODOM), _pose(pose))


def _twist(command: Command) -> Any:
    return message("geometry_msgs/msg/Twist", _vector(command.v, 0.0, 0.0), _vector(0.0, 0.0, command.w))


def _transforms(time: int, parent: str, child: str, at: tuple[float, float, float], yaw: float) -> Any:
    transform = message("geometry_msgs/msg/Transform", _vector(*at), _turn(yaw))
    stamped = message("geometry_msgs/msg/TransformStamped", _header(time, parent), child, transform)
    return message("tf2_msgs/msg/TFMessage", [stamped])


def _odometry(time: int, x: Observation) -> Any:
    pose = message("geometry_msgs/msg/PoseWithCovariance", _pose(x.pose), np.diag(POSE_VARIANCES).ravel())
    twist = message(
        "geometry_msgs/msg/TwistWithCovariance",
        _twist(Command(x.twist.v, x.twist.w)),
        np.diag(TWIST_VARIANCES).ravel(),
    )
    return message("nav_msgs/msg/Odometry", _header(time, ODOM), BASE, pose, twist)


def _scan(time: int, scan: Scan) -> Any:
    return message(
        "sensor_msgs/msg/LaserScan",
        _header(time, LASER),
        scan.angle_min,
        scan.angle_max,
        (scan.angle_max - scan.angle_min) / (len(scan.ranges) - 1),
        0.0,  # [s] between beams: the whole sweep is one instant
        TICK,  # [s] between scans
        scan.range_min,
        scan.range_max,
        scan.ranges.astype(np.float32),
        np.empty(0, dtype=np.float32),
    )


def _path(time: int, path: Array, goal: Pose2) -> Any:
    """As navfn's: positions without a heading, and the goal's own at the end."""
    poses = [_pose_stamped(time, Pose2(x, y, 0.0)) for x, y in path[:-1, :2].tolist()]
    return message("nav_msgs/msg/Path", _header(time, ODOM), [*poses, _pose_stamped(time, goal)])
