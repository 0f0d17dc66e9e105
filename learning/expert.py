"""The scripted human at the joystick: follows a route with delay, ramps and a slightly unsteady hand."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from learning.route import Pace, Route
from twin.geometry import normalize_angle
from twin.records import STOP, Array, Command, Pose2

TICK = 0.05  # [s]
REACTION = 0.2  # [s] until the hand acts after taking over
V_RAMP = 2.0  # [m/s2] the stick is not slammed
W_RAMP = 6.0  # [rad/s2]
GOOD_OFFSET, GOOD_HEADING = 0.12, 0.35  # [m], [rad] from the route: a good state
TURN_FIRST = 0.6  # [rad] heading errors above this are turned away in place
# The hand's wander takes the robot a few centimetres off the route, and the demonstration shows the way back: without
# such steps Eq. 1 does not learn how much obstacles matter (as in DART, Laskey et al. 2017; docs/learning.md).
UNSTEADY_V = 0.03  # [m/s] standard deviation
UNSTEADY_W = 0.20  # [rad/s]
WANDER_TIME = 0.3  # [s] correlation


@dataclass(frozen=True, slots=True)
class Hand:
    """What the person's hand is doing; immutable."""

    command: Command  # last one sent
    age: float = 0.0  # [s] since taking over
    wander: tuple[float, float] = (0.0, 0.0)
    progress: int = 0  # index on the route


@dataclass(frozen=True, slots=True)
class Expert:
    """Drives one route."""

    route: Route
    pace: Pace

    def drive(self, hand: Hand, pose: Pose2, rng: np.random.Generator) -> tuple[Command, Hand]:
        """The command for the true pose (world), and the hand afterwards."""
        wander = _wander(hand.wander, rng)
        if hand.age < REACTION - 1e-9:
            return hand.command, replace(hand, age=hand.age + TICK, wander=wander)
        progress = _nearest_ahead(self.route.points, hand.progress, pose)
        wish = self._wish(progress, pose, hand.command.v)
        v = _ramp(hand.command.v, wish.v + wander[0] * UNSTEADY_V, V_RAMP * TICK)
        w = _ramp(hand.command.w, wish.w + wander[1] * UNSTEADY_W, W_RAMP * TICK)
        command = Command(min(max(v, 0.0), self.pace.top), min(max(w, -self.pace.turn), self.pace.turn))
        return command, Hand(command, hand.age + TICK, wander, progress)

    def at_end(self, hand: Hand) -> bool:
        """Whether the route is done."""
        return hand.progress >= len(self.route.points) - 4

    def is_good(self, hand: Hand, pose: Pose2) -> bool:
        """Whether the robot is on the route, pointing along it: a state worth learning from."""
        i = min(hand.progress, len(self.route.points) - 2)
        here, there = self.route.points[i], self.route.points[i + 1]
        along = math.atan2(float(there[1] - here[1]), float(there[0] - here[0]))
        off = math.hypot(float(here[0]) - pose.x, float(here[1]) - pose.y)
        return off < GOOD_OFFSET and abs(normalize_angle(along - pose.yaw)) < GOOD_HEADING

    def _wish(self, progress: int, pose: Pose2, v: float) -> Command:
        """Pure pursuit at the route's speed; a turn in place first when the route points elsewhere."""
        ahead = 0.30 + 0.35 * max(v, 0.0)
        target = self.route.points[min(len(self.route.points) - 1, progress + max(2, round(ahead / 0.05)))]
        dx, dy = float(target[0]) - pose.x, float(target[1]) - pose.y
        distance = max(math.hypot(dx, dy), 1e-3)
        error = normalize_angle(math.atan2(dy, dx) - pose.yaw)
        if abs(error) > TURN_FIRST:
            return Command(0.0, math.copysign(min(self.pace.turn, 2.0 * abs(error)), error))
        curvature = 2.0 * math.sin(error) / distance
        speed = float(self.route.speed[progress])
        if abs(curvature) > 1e-6:
            speed = min(speed, self.pace.turn / abs(curvature))
        return Command(speed, speed * curvature)


RETREAT_SPEED, RETREAT_TURN = 0.25, 0.8  # [m/s], [rad/s]
RETREAT_AHEAD = 0.3  # [m] along the trail
ROOM = 0.40  # [m] around the robot's centre: enough to turn on the spot


@dataclass(frozen=True, slots=True)
class Retreat:
    """Backing out the way the robot came, until there is room to turn."""

    trail: Array  # (n, 2) world [m], newest first

    def drive(self, hand: Hand, pose: Pose2, rng: np.random.Generator) -> tuple[Command, Hand]:
        """As `Expert.drive`, backwards along the trail."""
        wander = _wander(hand.wander, rng)
        if hand.age < REACTION - 1e-9:
            return STOP, Hand(STOP, hand.age + TICK, wander, hand.progress)
        progress = _nearest_ahead(self.trail, hand.progress, pose)
        far = np.hypot(self.trail[progress:, 0] - pose.x, self.trail[progress:, 1] - pose.y) > RETREAT_AHEAD
        target = self.trail[progress + int(np.argmax(far))] if far.any() else self.trail[-1]
        bearing = math.atan2(float(target[1]) - pose.y, float(target[0]) - pose.x)
        error = normalize_angle(bearing - pose.yaw - math.pi)
        wish = min(max(2.0 * error, -RETREAT_TURN), RETREAT_TURN) + wander[1] * UNSTEADY_W
        v = _ramp(hand.command.v, -RETREAT_SPEED, V_RAMP * TICK)
        command = Command(v, _ramp(hand.command.w, wish, W_RAMP * TICK))
        return command, Hand(command, hand.age + TICK, wander, progress)

    def at_end(self, hand: Hand) -> bool:
        """Whether the trail is used up."""
        return hand.progress >= len(self.trail) - 2


def _nearest_ahead(points: Array, start: int, pose: Pose2) -> int:
    """The route's point nearest to the robot, never going back and never leaping ahead."""
    window = points[start : start + 20]
    return start + int(np.argmin((window[:, 0] - pose.x) ** 2 + (window[:, 1] - pose.y) ** 2))


def _ramp(last: float, wish: float, step: float) -> float:
    return last + min(max(wish - last, -step), step)


def _wander(wander: tuple[float, float], rng: np.random.Generator) -> tuple[float, float]:
    """Unit-variance noise with a memory of WANDER_TIME."""
    keep = math.exp(-TICK / WANDER_TIME)
    fresh = math.sqrt(1.0 - keep * keep)
    a, b = rng.standard_normal(2).tolist()
    return keep * wander[0] + fresh * a, keep * wander[1] + fresh * b
