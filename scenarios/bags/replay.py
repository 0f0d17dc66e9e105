"""A bag as the observations of its robot, 20 per second, as the twin would have made them.

A tick takes the latest scan, odometry and command that had been recorded by then. Time is when a message was recorded:
Twist and String carry no other. Only where the robot was when a scan was taken is looked up by the stamps that scan and
odometry carry, as tf does.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from scenarios.bags.files import BagError, BagReader
from scenarios.bags.frames import DEFAULT_PLACEMENT, find_lidar, finite, pose_in_plane
from scenarios.bags.scans import ScanReader
from twin.geometry import normalize_angle, shortest_angle
from twin.planner.obstacle_memory import ObstacleMemory, no_obstacles, remember
from twin.records import STOP, Command, Pose2, Scan, Twist2
from twin.robot.drive import DriveConfig

PERIOD = 50_000_000  # [ns]; the twin's tick
STALE = 500_000_000  # [ns] an older scan or odometry says nothing about now
APART = 500_000_000  # [ns] by which the stamps of scan and odometry may differ
HOLD = round(DriveConfig().timeout * 1e9)  # [ns] for which the base obeys a command


@dataclass(frozen=True, slots=True)
class Moment:
    """What was known at one tick."""

    time: int  # [ns] of recording
    pose: Pose2  # odom_from_base; odom's origin is where the robot was first
    twist: Twist2  # base_link
    scan: Scan
    obstacles: ObstacleMemory
    command: Command | None  # the one that the base still obeys
    stale: str | None  # the topic that has been silent for too long


@dataclass(slots=True)
class _Odometry:
    """What odometry has said lately."""

    topic: str
    start: Pose2 | None = None
    twist: Twist2 = field(default=Twist2(0.0, 0.0))
    heard: int = 0  # [ns] of recording
    track: deque[tuple[int, Pose2]] = field(default_factory=lambda: deque(maxlen=512))  # stamp [ns], odom_from_base

    def hear(self, time: int, sent: Any, where: str) -> None:
        pose = pose_in_plane(sent.pose.pose, where)
        if self.start is None:
            self.start = pose
        v, w = finite(where, sent.twist.twist.linear.x, sent.twist.twist.angular.z)
        made = _onwards(self.track[-1][0] if self.track else None, stamp(sent, time), where)
        self.track.append((made, Pose2(pose.x - self.start.x, pose.y - self.start.y, pose.yaw)))
        self.twist, self.heard = Twist2(v, w), time

    def at(self, time: int) -> Pose2:
        """The pose at a stamp: between the two nearest, or the last one known."""
        later = self.track[-1]
        for earlier in reversed(self.track):
            if earlier[0] <= time:
                return earlier[1] if earlier[0] == time or later is earlier else _between(earlier, later, time)
            later = earlier
        return later[1]


@dataclass(frozen=True, slots=True)
class Robot:
    """The names of the topics, and the lidar."""

    odometry: str
    cmd_vel: str
    scans: ScanReader


def find_robot(bag: BagReader, scan: str, odometry: str, cmd_vel: str) -> tuple[Robot, str | None]:
    """The robot of a bag, and a remark when its lidar's place had to be guessed."""
    firsts = {topic: _first(bag, topic) for topic in (scan, odometry)}
    base, laser = firsts[odometry].child_frame_id or "base_link", firsts[scan].header.frame_id
    placement = find_lidar(bag, base, laser)
    remark = None
    if placement is None:
        x, y, z = DEFAULT_PLACEMENT.position
        remark = (
            f"the bag does not say where {laser} is on {base} (/tf_static); taken as BARN's UST-10 at {x}, {y}, {z} m"
        )
    return Robot(odometry, cmd_vel, ScanReader(scan, placement or DEFAULT_PLACEMENT)), remark


def odom_frame(bag: BagReader, odometry: str) -> tuple[str, Pose2]:
    """The frame of odometry, and where in it the robot was first."""
    sent = _first(bag, odometry)
    return sent.header.frame_id or "odom", pose_in_plane(sent.pose.pose, f"{odometry} at its start")


def _first(bag: BagReader, topic: str) -> Any:
    for _, _, sent in bag.messages([topic]):
        return sent
    raise BagError(f"{bag.path}: {topic} never says anything")


def moments(bag: BagReader, robot: Robot, until: int) -> Iterator[Moment]:
    """Every tick from when scan and odometry are known until a time [ns]. Raises BagError for a useless message."""
    state, due = _State(bag, robot), None
    for topic, time, sent in bag.messages((robot.scans.topic, robot.odometry, robot.cmd_vel), until):
        while due is not None and due < time:
            yield state.moment(due)
            due += PERIOD
        state.hear(topic, time, sent)
        if due is None and state.complete:
            due = time
    while due is not None and due <= until:
        yield state.moment(due)
        due += PERIOD


class _State:
    """The fold from messages to moments."""

    def __init__(self, bag: BagReader, robot: Robot) -> None:
        self._bag, self._robot = bag, robot
        self._odometry = _Odometry(robot.odometry)
        self._sweep: tuple[int, int, Any] | None = None  # time, stamp [ns] and message of the latest scan
        self._scan: Scan | None = None  # the same, once a tick needed it
        self._command, self._commanded = STOP, -HOLD - 1
        self._obstacles = no_obstacles()

    @property
    def complete(self) -> bool:
        """Whether there is enough for a moment."""
        return self._sweep is not None and bool(self._odometry.track)

    def hear(self, topic: str, time: int, sent: Any) -> None:
        """Take one message into account."""
        where = f"{self._bag.path}: {topic} at {self._bag.seconds(time):.2f} s"
        if topic == self._robot.scans.topic:
            before = None if self._sweep is None else self._sweep[1]
            self._sweep, self._scan = (time, _onwards(before, stamp(sent, time), where), sent), None
        elif topic == self._robot.odometry:
            self._odometry.hear(time, sent, where)
        else:
            twist = sent.twist if hasattr(sent, "twist") else sent  # TwistStamped or Twist
            self._command, self._commanded = Command(*finite(where, twist.linear.x, twist.angular.z)), time

    def moment(self, time: int) -> Moment:
        """What is known at a tick; the maps remember the scan."""
        assert self._sweep is not None  # since `complete`
        heard, made, sent = self._sweep
        odometry, scans = self._odometry, self._robot.scans
        if self._scan is None:
            try:
                self._scan = scans.scan(sent)
            except BagError as error:
                raise BagError(f"{self._bag.path}: at {self._bag.seconds(heard):.2f} s {error}") from None
        newest, pose = odometry.track[-1]
        ages = {scans.topic: time - heard, odometry.topic: time - odometry.heard}
        stale = next((topic for topic, age in ages.items() if age > STALE), None)
        if stale is None:
            if abs(made - newest) > STALE + APART:
                raise BagError(
                    f"{self._bag.path}: at {self._bag.seconds(time):.2f} s the stamps of {scans.topic} and "
                    f"{odometry.topic} are {abs(made - newest) / 1e9:.1f} s apart; were the clocks synchronised?"
                )
            self._obstacles = remember(self._obstacles, self._scan, pose, odometry.at(made))
        command = self._command if time - self._commanded <= HOLD else None
        return Moment(time, pose, odometry.twist, self._scan, self._obstacles, command, stale)


def stamp(sent: Any, recorded: int) -> int:
    """When a message says that it was made [ns]; when it was recorded, if it does not say."""
    made = int(sent.header.stamp.sec) * 10**9 + int(sent.header.stamp.nanosec)
    return made or recorded


def _onwards(before: int | None, now: int, where: str) -> int:
    """The newer of two stamps [ns]."""
    if before is not None and now < before:
        raise BagError(f"{where} has a stamp {(before - now) / 1e9:.3f} s before the one before; was a clock reset?")
    return now


def _between(earlier: tuple[int, Pose2], later: tuple[int, Pose2], time: int) -> Pose2:
    share = (time - earlier[0]) / (later[0] - earlier[0])
    a, b = earlier[1], later[1]
    turn = shortest_angle(a.yaw, b.yaw)
    return Pose2(a.x + share * (b.x - a.x), a.y + share * (b.y - a.y), normalize_angle(a.yaw + share * turn))
