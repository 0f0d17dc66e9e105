"""A short drive, and bags of it in all formats, whole or spoilt."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from scenarios.bags.files import TYPES, BagWriter, Stamped, Topic, message
from scenarios.bags.recording import BEGIN, TOPICS, BagRecorder, messages
from scenarios.trials import TrialSpec, make_driver, make_simulation
from scenarios.worlds import load_world
from twin.records import Command, Tick
from twin.rollout import Loop

SPEC = TrialSpec("barn-like/7", seed=3)  # starts with a yaw of 90 degrees
NOETIC = get_typestore(Stores.ROS1_NOETIC)
NOETIC.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
MARKER = Topic("/marker", "std_msgs/msg/String")


@cache
def drive(seconds: float = 5.0) -> tuple[Tick, ...]:
    """The default planner, and from 2 s on a person who takes it in a slalom through the first posts."""
    loop = Loop(make_simulation(SPEC, load_world(SPEC.world)), make_driver(SPEC))
    count = round(seconds * 20)
    return tuple(loop.step(Command(0.5, 0.4 * np.sin(0.1 * k)) if k >= 40 else None) for k in range(count))


def said(ticks: Sequence[Tick]) -> list[Stamped]:
    """All messages of a drive."""
    pairs = zip(ticks, [None, *ticks[:-1]], strict=True)
    return [stamped for tick, before in pairs for stamped in messages(tick, before)]


def marked(spans: Iterable[tuple[float, str]]) -> list[Stamped]:
    """What a marker topic says from some times [s] on."""
    return [(MARKER.name, BEGIN + round(at * 1e9), message(MARKER.type_name, text)) for at, text in spans]


def write_mcap(path: Path, content: Sequence[Stamped], topics: Sequence[Topic] = (*TOPICS, MARKER)) -> Path:
    """An MCAP file."""
    with BagWriter(path, topics) as writer:
        writer.write(sorted(content, key=lambda stamped: stamped[1]))
    return path


def write_sqlite(path: Path, content: Sequence[Stamped]) -> Path:
    """The folder of a ROS 2 bag as Humble writes it."""
    with Writer2(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {t.name: writer.add_connection(t.name, t.type_name, typestore=TYPES) for t in TOPICS}
        for topic, time, sent in content:
            connection = connections[topic]
            writer.write(connection, time, TYPES.serialize_cdr(sent, connection.msgtype))
    return path


def write_ros1(path: Path, content: Sequence[Stamped]) -> Path:
    """A ROS 1 bag."""
    with Writer1(path) as writer:
        connections = {t.name: writer.add_connection(t.name, t.type_name, typestore=NOETIC) for t in TOPICS}
        for topic, time, sent in content:
            connection = connections[topic]
            writer.write(connection, time, NOETIC.serialize_ros1(_ros1(sent), connection.msgtype))
    return path


def _ros1(value: Any) -> Any:
    """The same message in the types of ROS 1, whose headers are numbered."""
    if isinstance(value, list):
        return [_ros1(v) for v in value]
    if (type_name := getattr(value, "__msgtype__", None)) is None:
        return value
    names = [f for f in value.__dataclass_fields__ if f != "__msgtype__"]
    fields = {name: _ros1(getattr(value, name)) for name in names}
    if type_name == "std_msgs/msg/Header":
        fields["seq"] = 0
    return NOETIC.types[type_name](**fields)


def spoilt(content: Sequence[Stamped], topic: str, change: Callable[[float, Any], Any]) -> list[Stamped]:
    """The messages with those of one topic changed (time in seconds, message); None drops one."""
    result = []
    for name, time, sent in content:
        new = change((time - BEGIN) / 1e9, sent) if name == topic else sent
        if new is not None:
            result.append((name, time, new))
    return result


def record(path: Path, interrupted_at: int | None = None) -> Path:
    """The drive as the recorder writes it, perhaps with a Ctrl-C at some tick."""
    with BagRecorder(path) as recorder:
        for tick in drive():
            if tick.index == interrupted_at:
                raise KeyboardInterrupt
            recorder.add(tick)
    return path


def flat_pose(x: float, y: float, yaw: float) -> Any:
    """A geometry_msgs/Pose on the floor."""
    turn = message("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    return message("geometry_msgs/msg/Pose", message("geometry_msgs/msg/Point", x, y, 0.0), turn)
