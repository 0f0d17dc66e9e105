"""What the local planner remembers between calls: oscillation and escape (`base_local_planner::TrajectoryPlanner`)."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from twin.geometry import shortest_angle
from twin.planner.trajectory_state import LocalPlannerSettings
from twin.records import Array


@dataclass(frozen=True, slots=True)
class PlannerFlags:
    """What the planner object remembers between calls; new plans, goals and parameters do not clear it.

    The names are ROS's and read the wrong way round: `stuck_left` forbids turns to negative rates, which two turns to
    positive rates without moving away bring about, and `stuck_right` forbids positive ones.
    """

    stuck_left: bool = False
    stuck_right: bool = False
    rotating_left: bool = False  # an in-place turn with positive rate was chosen
    rotating_right: bool = False  # an in-place turn with negative rate was chosen
    escaping: bool = False
    prev_x: float = 0.0  # where the last in-place turn was chosen [m]
    prev_y: float = 0.0
    escape_x: float = 0.0  # where the last escape began [m]
    escape_y: float = 0.0
    escape_theta: float = 0.0  # [rad]

    @classmethod
    def from_array(cls, state: Array) -> PlannerFlags:
        """The ten numbers in the order of the fields."""
        return cls(*(bool(s) for s in state[:5]), *(float(s) for s in state[5:10]))

    def as_array(self) -> Array:
        """(10,) numbers in the order of the fields."""
        return np.array([float(getattr(self, f.name)) for f in fields(self)])

    def after_choice(self, x: float, y: float, yaw: float, v: float, w: float, s: LocalPlannerSettings) -> PlannerFlags:
        """After a best candidate (v, w) with cost >= 0 was chosen at a pose [m, rad]."""
        stuck_left, stuck_right = self.stuck_left, self.stuck_right
        left, right, prev_x, prev_y = self.rotating_left, self.rotating_right, self.prev_x, self.prev_y
        if not v > 0.0:
            if w < 0.0:
                stuck_right |= right
                right = True
            elif w > 0.0:
                stuck_left |= left
                left = True
            prev_x, prev_y = x, y
        return PlannerFlags(
            stuck_left, stuck_right, left, right, self.escaping,
            prev_x, prev_y, self.escape_x, self.escape_y, self.escape_theta,
        )._after_moving(x, y, yaw, s)  # fmt: skip

    def after_escape(self, x: float, y: float, yaw: float, cost: float, s: LocalPlannerSettings) -> PlannerFlags:
        """After the backup candidate was taken for want of any other; `cost` is the one after -1 became 1."""
        flags = self._reset_when_moved(x, y, s)
        if not flags.escaping and cost > -2.0:
            flags = PlannerFlags(
                flags.stuck_left, flags.stuck_right, flags.rotating_left, flags.rotating_right, True,
                flags.prev_x, flags.prev_y, x, y, yaw,
            )  # fmt: skip
        return flags._reset_when_escaped(x, y, yaw, s)

    def _after_moving(self, x: float, y: float, yaw: float, s: LocalPlannerSettings) -> PlannerFlags:
        return self._reset_when_moved(x, y, s)._reset_when_escaped(x, y, yaw, s)

    def _reset_when_moved(self, x: float, y: float, s: LocalPlannerSettings) -> PlannerFlags:
        if not math.hypot(x - self.prev_x, y - self.prev_y) > s.oscillation_reset_dist:
            return self
        return PlannerFlags(
            False, False, False, False, self.escaping,
            self.prev_x, self.prev_y, self.escape_x, self.escape_y, self.escape_theta,
        )  # fmt: skip

    def _reset_when_escaped(self, x: float, y: float, yaw: float, s: LocalPlannerSettings) -> PlannerFlags:
        moved = math.hypot(x - self.escape_x, y - self.escape_y) > s.escape_reset_dist
        if not moved and not abs(shortest_angle(self.escape_theta, yaw)) > s.escape_reset_theta:
            return self
        return PlannerFlags(
            self.stuck_left, self.stuck_right, self.rotating_left, self.rotating_right, False,
            self.prev_x, self.prev_y, self.escape_x, self.escape_y, self.escape_theta,
        )  # fmt: skip
