"""The vocabulary: small frozen records that every other module speaks in.

Frames: `world` is the simulator's fixed frame, `odom` the robot's own drifting estimate of it (its axes start
parallel to `world`, its origin where the robot starts), `base_link` the robot (x forward, y left, z up).
Units are metres, seconds, radians. Arrays in records are read-only.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from twin.planner.params import PlannerParams

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]

DEFAULT_CONTEXT = "default"


def frozen_array(array: NDArray) -> NDArray:  # type: ignore[type-arg]
    """The same array, marked read-only."""
    array.setflags(write=False)
    return array


@dataclass(frozen=True, slots=True)
class Pose2:
    """A planar pose: x, y [m], yaw [rad]."""

    x: float
    y: float
    yaw: float


@dataclass(frozen=True, slots=True)
class Twist2:
    """A planar velocity in base_link: v [m/s] forward, w [rad/s] counter-clockwise."""

    v: float
    w: float


@dataclass(frozen=True, slots=True)
class Command:
    """What the base is asked to do: v [m/s], w [rad/s] (a `cmd_vel`)."""

    v: float
    w: float


STOP = Command(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Scan:
    """One lidar sweep (sensor_msgs/LaserScan)."""

    ranges: Array  # (n,) [m], right to left, sensor frame; inf = no return
    angle_min: float  # [rad] of the first beam
    angle_max: float  # [rad] of the last beam
    range_min: float  # [m]
    range_max: float  # [m]
    mount: tuple[float, float, float]  # sensor position in base_link [m]; its axes are parallel to base_link's

    @property
    def angles(self) -> Array:
        """(n,) [rad] bearing of each beam in the sensor frame."""
        return np.linspace(self.angle_min, self.angle_max, len(self.ranges))


@dataclass(frozen=True, slots=True)
class ObstacleMap:
    """What one costmap's obstacle layer remembers after a scan; independent of the planner parameters."""

    cells: Bytes  # (ny, nx): 0 free, 254 lethal, 255 unknown; index [y, x], y up
    origin: tuple[float, float]  # odom position of the lower-left corner of cell (0, 0) [m]
    resolution: float  # [m] per cell
    touched: tuple[float, float, float, float]  # bounds changed by this update: min x, min y, max x, max y [m, odom]
    whole: bool = False  # True: everything may have changed (a clearing recovery)


@dataclass(frozen=True, slots=True)
class Observation:
    """x of the paper: all that the navigation system G sees at one tick; complete and free of theta."""

    time: float  # [s] since the start
    pose: Pose2  # odom_from_base
    twist: Twist2  # base_link, from odometry
    scan: Scan
    local_map: ObstacleMap
    global_map: ObstacleMap
    goal: Pose2  # odom


@dataclass(frozen=True, slots=True)
class Arc:
    """One scored candidate of the local planner, with the raw parts of its cost."""

    v: float  # [m/s] commanded
    w: float  # [rad/s] commanded
    cost: float  # total; < 0 = illegal
    path_cells: float  # path-grid value at the last point [cells]
    goal_cells: float  # goal-grid value at the last point [cells]
    obstacle: float  # highest cost byte over the arc, 0..253
    points: Array  # (k, 3) odom x, y, yaw


@dataclass(frozen=True, slots=True)
class Decision:
    """What the driver decided in one tick, with everything needed to explain it afterwards."""

    command: Command | None  # None = nothing published this cycle; the base keeps the last command until its timeout
    theta: PlannerParams
    context: str = DEFAULT_CONTEXT
    confidence: float | None = None  # of the context classifier; None when none drives
    arc: Arc | None = None  # the chosen arc
    candidates: Array | None = None  # (n, 3) v, w, cost (< 0 = illegal) of every arc tried; only when asked to explain
    rejected: dict[str, int] = field(default_factory=dict)  # candidates rejected, by reason; complete when explaining
    state: str = "controlling"  # planning, controlling, or the recovery's name
    recoveries: int = 0  # recovery behaviours started so far
    global_path: Array | None = None  # (n, 2) odom [m]
    local_costmap: ObstacleMap | None = None  # inflated; only when asked to explain
    clear_beyond: float | None = None  # clearing recovery: forget obstacles outside a square of this side [m]
    goal_reached: bool = False  # move_base reports success
    aborted: bool = False  # move_base gave up


class Outcome(StrEnum):
    """How a trial ended."""

    REACHED = "reached"
    COLLIDED = "collided"
    TIMED_OUT = "timed_out"
    ABORTED = "aborted"  # move_base gave up


@dataclass(frozen=True, slots=True)
class Contact:
    """The robot touched something other than the floor."""

    time: float  # [s]
    x: float  # world [m]
    y: float  # world [m]
    obstacle: str  # name of the obstacle's geom


@dataclass(frozen=True, slots=True)
class Tick:
    """One 50 ms step of the closed loop: what was seen, what was decided, what was true."""

    index: int
    observation: Observation
    decision: Decision
    true_pose: Pose2  # world, when the scan was taken
    body_poses: Array  # (5, 7) world position [m] and quaternion (w, x, y, z): chassis, then wheels fl, fr, rl, rr
    clearance: float  # smallest true distance from the robot's outline to an obstacle [m]; inf = nothing near
    contact: Contact | None  # the first contact during the step that followed the decision
    elapsed: float  # [s] on the trial's clock after the step
    outcome: Outcome | None  # set on the last tick only
    override: Command | None = None  # a person's command, applied instead of the decision's

    @property
    def applied(self) -> Command | None:
        """What the base was told: the person's command if there was one, else the driver's."""
        return self.decision.command if self.override is None else self.override
