"""What a teleop session shows: one small frame per tick, light enough to keep a minute of them for rewinding."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from twin.geometry import compose, invert, transform_points
from twin.records import Array, Outcome, Pose2, Scan, Tick, Twist2
from twin.world import World


class Mode(StrEnum):
    """Who drives, or why nobody does."""

    PLANNER = "the planner drives"
    NUDGE = "you drive, not recorded"
    INTERVENTION = "you drive, recording"
    REWIND = "rewinding"
    WAITING = "the twin waits for you"
    ENDED = "the run has ended"


@dataclass(frozen=True, slots=True)
class Sight:
    """What the planner saw and wanted when it last decided."""

    scan: Scan
    true_pose: Pose2  # world, when the scan was taken
    odom_pose: Pose2  # odom_from_base at the same time
    path: Array | None  # (n, 2) odom [m]
    state: str
    context: str
    confidence: float | None
    recoveries: int

    @staticmethod
    def of(tick: Tick) -> Sight:
        """The sight of one tick, without its maps."""
        x, decision = tick.observation, tick.decision
        return Sight(
            x.scan,
            tick.true_pose,
            x.pose,
            decision.global_path,
            decision.state,
            decision.context,
            decision.confidence,
            decision.recoveries,
        )

    def scan_points(self) -> Array:
        """(n, 2) world [m] where the beams ended."""
        hit = np.isfinite(self.scan.ranges)
        ranges, angles = self.scan.ranges[hit], self.scan.angles[hit]
        points = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)]) + self.scan.mount[:2]
        return transform_points(self.true_pose, points)

    def path_points(self) -> Array:
        """(n, 2) world [m] the global path, put where the robot truly is."""
        if self.path is None:
            return np.empty((0, 2))
        return transform_points(compose(self.true_pose, invert(self.odom_pose)), np.asarray(self.path))


@dataclass(frozen=True, slots=True)
class Frame:
    """The twin just before a tick."""

    index: int  # of the tick to come
    time: float  # [s] simulated
    elapsed: float  # [s] on the trial's clock
    physics: Array  # mjSTATE_INTEGRATION
    pose: Pose2  # true, world
    twist: Twist2  # base_link, as odometry had it at the last tick
    sight: Sight | None  # None before the first tick
    outcome: Outcome | None  # how the last tick ended, if it did


@dataclass(frozen=True, slots=True)
class View:
    """All that a surface shows."""

    world: World
    mode: Mode
    frame: Frame
    label: str | None = None  # of the intervention in progress, e.g. "A2"
    recorded: float = 0.0  # [s] of the intervention in progress
    trail: Array = field(default_factory=lambda: np.empty((0, 2)))  # (n, 2) world [m] driven in it
    rewound: float = 0.0  # [s] how far back the twin stands from where the rewind began
    saved: tuple[str, ...] = ()  # labels saved in this session
    message: str = ""  # the last thing worth saying
