"""Frames in a bag: where the lidar sits on the robot, and where a goal lies in odom."""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from scenarios.bags.files import BagError, BagReader
from twin.geometry import compose, invert
from twin.records import Array, Pose2
from twin.robot.jackal import LIDAR_MOUNTS

UPRIGHT = math.cos(math.radians(3.0))  # a lidar tilted by more sees the floor or the ceiling
TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
MANY = 10_000  # transforms looked at for the lidar's place
DEEPEST = 32  # links of a chain of frames; a longer one is a circle


@dataclass(frozen=True, slots=True)
class Transform:
    """parent_from_child in space."""

    parent: str
    rotation: Array  # (3, 3)
    translation: Array  # (3,) [m]


@dataclass(frozen=True, slots=True)
class Placement:
    """A planar lidar on the robot."""

    position: tuple[float, float, float]  # [m] base_link
    yaw: float = 0.0  # [rad] of its x axis in base_link
    upside_down: bool = False

    def bearings(self, angles: Array) -> Array:
        """Bearings in base_link of beams at some angles in the lidar's own frame [rad]."""
        if self.yaw == 0.0 and not self.upside_down:
            return angles
        turned: Array = self.yaw + (-angles if self.upside_down else angles)
        middle = math.tau * round(float(turned.mean()) / math.tau)
        return turned - middle


DEFAULT_PLACEMENT = Placement(LIDAR_MOUNTS["ust10"].position)


def same_frame(a: str, b: str) -> bool:
    """ROS 1 once wrote frames with a slash in front."""
    return a.strip("/") == b.strip("/")


def find_lidar(bag: BagReader, base: str, laser: str) -> Placement | None:
    """Where the frame `laser` is fixed to `base`; None when the bag does not say. Raises BagError when it is tilted."""
    if same_frame(base, laser):
        return Placement((0.0, 0.0, 0.0))
    frames: dict[str, Transform] = {}
    for topic in ("/tf_static", "/tf"):  # an old robot_state_publisher says fixed frames again and again in tf
        for _, child, transform in itertools.islice(_transforms(bag, topic), MANY):
            frames[child] = transform
            if (found := _chain(frames, base.strip("/"), laser.strip("/"))) is not None:
                return _placement(*found, laser)
    return None


def goals_in_odom(bag: BagReader, topic: str, odom: str) -> list[tuple[int, Pose2]]:
    """(time [ns], goal in odom) whenever a goal is given, in time order.

    The topic holds poses, or paths, the last pose of which is the goal. A goal in another frame (map) is moved to odom
    with the transform of the time at which it was given.
    """
    given: list[tuple[int, str, Pose2]] = []
    for _, time, sent in bag.messages([topic]):
        if hasattr(sent, "poses"):
            if len(sent.poses) == 0:
                continue
            frame, pose = sent.header.frame_id or sent.poses[-1].header.frame_id, sent.poses[-1].pose
        else:
            frame, pose = sent.header.frame_id, sent.pose
        goal = pose_in_plane(pose, f"{topic} at {bag.seconds(time):.2f} s")
        if not given or (frame, goal) != given[-1][1:]:
            given.append((time, frame or odom, goal))
    foreign = [frame for _, frame, _ in given if not same_frame(frame, odom)]
    if not foreign:
        return [(time, goal) for time, _, goal in given]
    located = list(_odom_in(bag, foreign[0], odom))
    if not located:
        raise BagError(
            f"{bag.path}: the goal is in the frame {foreign[0]}, odometry in {odom}, and no /tf says how they lie; "
            f"record /tf too"
        )
    moved = []
    for time, frame, goal in given:
        if not same_frame(frame, odom):
            if not same_frame(frame, foreign[0]):
                raise BagError(f"{bag.path}: {topic} uses the frames {foreign[0]} and {frame}; choose one --goal topic")
            latest = max(0, bisect.bisect_right([at for at, _ in located], time) - 1)
            goal = compose(invert(located[latest][1]), goal)
        moved.append((time, goal))
    return moved


def pose_in_plane(pose: Any, where: str) -> Pose2:
    """A geometry_msgs/Pose seen from above. Raises BagError when it is none."""
    p, q = pose.position, pose.orientation
    x, y = finite(where, p.x, p.y)
    return Pose2(x, y, _yaw(where, q.x, q.y, q.z, q.w))


def finite(where: str, *values: float) -> tuple[float, ...]:
    """The values, once none of them is NaN, infinite or absurd."""
    if not all(abs(value) < 1e6 for value in values):
        raise BagError(f"{where} holds {', '.join(f'{v:g}' for v in values)}, which cannot be")
    return tuple(float(value) for value in values)


def _yaw(where: str, x: float, y: float, z: float, w: float) -> float:
    if not math.isclose(x * x + y * y + z * z + w * w, 1.0, abs_tol=0.01):
        raise BagError(f"{where} has an orientation that is no unit quaternion")
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


def _transforms(bag: BagReader, topic: str) -> Iterator[tuple[int, str, Transform]]:
    """(time, child, transform) of a tf topic, with or without a namespace in front of its name."""
    named = [name for name, type_name in bag.topics.items() if name.endswith(topic) and type_name in TF_TYPES]
    for _, time, sent in bag.messages(named):
        for link in sent.transforms:
            t, q = link.transform.translation, link.transform.rotation
            rotation = _rotation(q.x, q.y, q.z, q.w)
            yield (
                time,
                link.child_frame_id.strip("/"),
                Transform(link.header.frame_id.strip("/"), rotation, np.array([t.x, t.y, t.z])),
            )


def _rotation(x: float, y: float, z: float, w: float) -> Array:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _chain(frames: dict[str, Transform], ancestor: str, frame: str) -> tuple[Array, Array] | None:
    """Rotation and translation ancestor_from_frame, going up from `frame`."""
    rotation, translation = np.eye(3), np.zeros(3)
    for _ in range(DEEPEST):
        if frame == ancestor:
            return rotation, translation
        if (link := frames.get(frame)) is None:
            return None
        rotation, translation = link.rotation @ rotation, link.rotation @ translation + link.translation
        frame = link.parent
    return None


def _placement(rotation: Array, translation: Array, laser: str) -> Placement:
    if not abs(rotation[2, 2]) > UPRIGHT or not np.isfinite(translation).all():
        raise BagError(f"the lidar's frame {laser} is tilted: its scans are no horizontal section of the room")
    x, y, z = translation.tolist()
    return Placement((x, y, z), math.atan2(rotation[1, 0], rotation[0, 0]), bool(rotation[2, 2] < 0.0))


def _odom_in(bag: BagReader, frame: str, odom: str) -> Iterator[tuple[int, Pose2]]:
    """(time, frame_from_odom) as localisation corrects it."""
    frames: dict[str, Transform] = {}
    for topic in ("/tf_static", "/tf"):
        for time, child, transform in _transforms(bag, topic):
            frames[child] = transform
            if child == odom.strip("/") and (found := _chain(frames, frame.strip("/"), child)) is not None:
                rotation, (x, y, _) = found[0], found[1].tolist()
                yield time, Pose2(x, y, math.atan2(rotation[1, 0], rotation[0, 0]))
