"""Somebody who watches the robot from beside the course and notices when it needs, or could use, help.

Sees what a person sees: where the robot truly is, how it moves, and the room around it. Planner internals stay hidden.

Every trigger is a rule on the last seconds; all thresholds are here. A rule that fires needs its window to fill again
before it can fire anew (hysteresis), because an intervention starts the watch afresh.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from learning.expert import TICK
from twin.free_space import FreeSpace
from twin.geometry import normalize_angle
from twin.records import Array, Pose2

STUCK_TIME, STUCK_PROGRESS = 4.0, 0.35  # A: less than 0.35 m towards the goal in 4 s
BACK_WITHIN, BACK_TIME, BACK_SPEED = 6.0, 0.3, -0.10  # A: drives backwards for 0.3 of the last 6 s
SPIN_TIME, SPIN_ANGLE, SPIN_REACH = 4.0, 1.25 * math.pi, 0.15  # A: turns 225 degrees on the spot within 4 s
CRASH_TIME, CRASH_GAP = 0.5, 0.21  # A: half a second from touching, its centre 0.21 m from something
SLOW_TIME, SLOW_SHARE = 3.0, 0.6  # B: for 3 s below 60 % of the speed that the room allows ...
OPEN_AHEAD, OPEN_SIDE = 2.5, 0.8  # ... where 2.5 m ahead are free and 0.8 m around: "open"
OPEN_SPEED = 1.5  # [m/s] what a person would drive there
SHAKE_TIME, SHAKE_COUNT, SHAKE_RATE = 4.0, 3, 0.25  # B: three reversals of a turn of 0.25 rad/s and more within 4 s,
STUTTER_TIME = 0.15  # [s] or a short step back,
CREEP_TIME, CREEP_SPEED, CREEP_FROM = 0.3, 0.25, 0.4  # or a slow-down from 0.4 m/s to below 0.25 m/s for 0.3 s, ...
NARROW_AHEAD, NARROW_SIDE = 1.0, 0.45  # ... while something narrower than 0.45 m to a side lies within 1 m ahead
GOOD_PACE = 0.12  # [m/s] towards the goal: slower is trouble already begun
EDGE = 0.5  # [s] how far before its first sign trouble is said to have begun


@dataclass(frozen=True, slots=True)
class Sight:
    """What the bystander saw in one tick."""

    index: int
    pose: Pose2  # world


@dataclass(frozen=True, slots=True)
class Trouble:
    """Something worth an intervention."""

    kind: Literal["A", "B"]
    reason: str
    began: int  # tick
    noticed: int  # tick


class Bystander:
    """A fold over sights; `notice` says what is wrong now, if anything."""

    def __init__(self, space: FreeSpace, to_goal: Array) -> None:
        """`to_goal`: cost-to-go of every cell of the space [m]."""
        self._space = space
        self._to_goal = to_goal
        self._seen: list[Sight] = []
        self._left: list[float] = []  # [m] still to go, by tick
        self._v: list[float] = []  # [m/s] forward
        self._w: list[float] = []  # [rad/s]

    def see(self, sight: Sight) -> None:
        """Take in one tick."""
        before = self._seen[-1].pose if self._seen else sight.pose
        now = sight.pose
        dx, dy = now.x - before.x, now.y - before.y
        self._v.append((dx * math.cos(now.yaw) + dy * math.sin(now.yaw)) / TICK)
        self._w.append(normalize_angle(now.yaw - before.yaw) / TICK)
        self._seen.append(sight)
        row, column = self._space.cells(np.array([[now.x, now.y]]))[0]
        row, column = (int(np.clip(i, 0, n - 1)) for i, n in zip((row, column), self._to_goal.shape, strict=True))
        left = float(self._to_goal[row, column])
        self._left.append(left if math.isfinite(left) else (self._left[-1] if self._left else 0.0))

    def look_again(self) -> None:
        """Forget the past: somebody has just intervened."""
        self._seen, self._left, self._v, self._w = [], [], [], []

    def urgent(self) -> Trouble | None:
        """Type A: somebody must intervene now."""
        for reason, hit in (
            ("drives backwards", self._backs_up()),
            ("turns on the spot", self._spins()),
            ("makes no progress", self._is_stuck()),
            ("is about to touch something", self._about_to_touch()),
        ):
            if hit:
                return Trouble("A", reason, self.last_good(), self._seen[-1].index)
        return None

    def improvable(self, ticks: int) -> Trouble | None:
        """Type B: somebody could do better, judged by the last `ticks` ticks only (those spent in this place)."""
        if self._is_slow(ticks):
            return Trouble("B", "is slow in the open", self._back(SLOW_TIME + EDGE), self._seen[-1].index)
        if self._shakes(ticks):
            return Trouble("B", "enters a narrow place unsteadily", self._back(SHAKE_TIME + EDGE), self._seen[-1].index)
        return None

    def _backs_up(self) -> bool:
        recent = self._v[-round(BACK_WITHIN / TICK) :]
        return recent[-1] < BACK_SPEED and sum(v < BACK_SPEED for v in recent) * TICK >= BACK_TIME - 1e-9

    def _spins(self) -> bool:
        recent = _last(self._w, SPIN_TIME)
        if len(recent) == 0:
            return False
        here, then = self._seen[-1].pose, self._seen[-len(recent)].pose
        return abs(sum(recent)) * TICK > SPIN_ANGLE and math.hypot(here.x - then.x, here.y - then.y) < SPIN_REACH

    def _is_stuck(self) -> bool:
        recent = _last(self._left, STUCK_TIME)
        return len(recent) > 0 and recent[0] - recent[-1] < STUCK_PROGRESS

    def _about_to_touch(self) -> bool:
        pose, v, w = self._seen[-1].pose, self._v[-1], self._w[-1]
        if abs(v) < 0.05:
            return False
        t = np.arange(1, 6) * (CRASH_TIME / 5)
        yaw = pose.yaw + w * t
        points = np.c_[pose.x + v * t * np.cos((pose.yaw + yaw) / 2), pose.y + v * t * np.sin((pose.yaw + yaw) / 2)]
        return bool((self._space.at(points) < CRASH_GAP).any())

    def _is_slow(self, ticks: int) -> bool:
        recent = _last(self._v, SLOW_TIME)
        if not 0 < len(recent) <= ticks or float(np.mean(recent)) > SLOW_SHARE * OPEN_SPEED:
            return False
        seen = self._seen[-len(recent) :: 5]
        return all(self.is_open(s.pose) for s in seen)

    def is_open(self, pose: Pose2) -> bool:
        """Whether there is room around the robot and far ahead of it."""
        ahead = np.arange(0.0, OPEN_AHEAD, 0.2)
        points = np.c_[pose.x + ahead * math.cos(pose.yaw), pose.y + ahead * math.sin(pose.yaw)]
        room = self._space.at(points)
        return bool(room[0] > OPEN_SIDE and (room > 0.45).all())

    def _shakes(self, ticks: int) -> bool:
        n = min(ticks, len(self._v), round(SHAKE_TIME / TICK))
        if n * TICK < 1.0 or not self._narrow_ahead():
            return False
        v, w = self._v[-n:], self._w[-n:]
        stutters = sum(speed < BACK_SPEED for speed in v) * TICK >= STUTTER_TIME - 1e-9
        creeps = float(np.mean(_last(v, CREEP_TIME))) < CREEP_SPEED and max(v) > CREEP_FROM
        return stutters or creeps or reversals(w, SHAKE_RATE) >= SHAKE_COUNT

    def _narrow_ahead(self) -> bool:
        pose = self._seen[-1].pose
        ahead = np.arange(0.0, NARROW_AHEAD, 0.1)
        points = np.c_[pose.x + ahead * math.cos(pose.yaw), pose.y + ahead * math.sin(pose.yaw)]
        return bool((self._space.at(points) < NARROW_SIDE).any())

    def last_good(self) -> int:
        """The tick at which progress towards the goal was last good: trouble begins there, not where it shows."""
        window = round(1.0 / TICK)
        for k in range(len(self._left) - 1, window, -1):
            if self._left[k - window] - self._left[k] > GOOD_PACE * window * TICK:
                return self._seen[max(0, k - round(EDGE / TICK))].index
        return self._seen[0].index

    def _back(self, seconds: float) -> int:
        return self._seen[max(0, len(self._seen) - 1 - round(seconds / TICK))].index


def _last(values: Sequence[float], seconds: float) -> Sequence[float]:
    """The values of the last seconds, or nothing while fewer have been seen."""
    n = round(seconds / TICK)
    return values[-n:] if len(values) >= n else []


def reversals(rates: Sequence[float], least: float) -> int:
    """How often the sign of the rate changes between swings of at least `least`."""
    signs = [1 if r > 0 else -1 for r in _moving_mean(rates) if abs(r) >= least]
    return sum(a != b for a, b in pairwise(signs))


def _moving_mean(values: Sequence[float], width: int = 5) -> Array:
    return np.convolve(values, np.ones(width) / width, mode="valid")
