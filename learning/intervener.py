"""The scripted "synthetic intervener": decides like a bystander when and where to intervene, and drives like a human.

The session (scenarios/collect.py) owns the simulation and does the rewinding; this module only looks at true poses and
the true map. A person knows the places of a course: within one, trouble of type A is answered at once, an improvable
drive (type B) once the place is over, and a place that needed neither is shown again, more carefully, as type D.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from learning.bystander import Bystander, Sight, Trouble
from learning.expert import ROOM, TICK, Expert, Hand, Retreat
from learning.interventions import Kind
from learning.route import BRISK, CAREFUL, STEADY, Pace, distance_field, plan_route
from twin.free_space import FreeSpace, free_space
from twin.records import Array, Command, Pose2, Twist2
from twin.world import Segment, World

LEAD = 0.5  # [s] the rewind goes this much further back than where the trouble began
LEAST, MOST = 4.0, 12.0  # [s] a demonstration lasts
ORDINARY_TIME = 2.0  # [s] a place passed in less is not worth a demonstration of type D
EASY = 0.50  # [m] from the robot's centre to an obstacle: a person begins anew where there is room to steer, ...
LOOK_BACK = 4.0  # [s] ... if that is not further back than this
SETTLE = 2.0  # [m] without named places, a type B is acted on this far after it was noticed
PACES: dict[Kind, Pace] = {"A": STEADY, "B": BRISK, "D": CAREFUL}


@dataclass(frozen=True, slots=True)
class Plea:
    """The decision to intervene: what, why, and from which tick on to drive anew."""

    kind: Kind
    reason: str
    began: int  # tick
    start: int  # tick to rewind to
    noticed: int  # tick
    place: str  # name of the segment; "" = none


def segment_at(world: World, pose: Pose2) -> Segment | None:
    """The first named segment that holds the pose."""
    return next((s for s in world.segments if _inside(s.polygon, pose.x, pose.y)), None)


def _inside(polygon: tuple[tuple[float, float], ...], x: float, y: float) -> bool:
    """Even-odd rule."""
    inside = False
    for (x0, y0), (x1, y1) in zip(polygon, (*polygon[1:], polygon[0]), strict=True):
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
            inside = not inside
    return inside


class Intervener:
    """Watches one drive. Mutable: it has a memory like a person."""

    def __init__(self, world: World, rewinding: bool = True) -> None:
        """Learns the true map and the ways through it. Raises UnreachableError when no way leads to the goal.

        Without rewinding it acts on everything at once, and has no use for type D.
        """
        self.world = world
        self._rewinding = rewinding
        self.space: FreeSpace = free_space(world)
        self._bystander = Bystander(self.space, distance_field(self.space, world.goal))
        self._poses: dict[int, Pose2] = {}
        self._place: str | None = None
        self._entered = 0
        self._pending: Trouble | None = None
        self._settled: set[str] = set()  # places that were dealt with

    def watch(self, index: int, pose: Pose2, over: bool, touched: bool) -> Plea | None:
        """One tick of the default's drive at its true pose; `over` when the trial has ended with it."""
        self._poses[index] = pose
        self._bystander.see(Sight(index, pose))
        segment = segment_at(self.world, pose)
        place = "" if segment is None else segment.name
        if self._place is None:
            self._place, self._entered = place, index
        if touched:
            began = self._bystander.last_good()
            return self._plea("A", "touched something", began, index, self._place_of(began))
        urgent = self._bystander.urgent()
        if urgent is not None:
            return self._plea("A", urgent.reason, urgent.began, index, self._place_of(urgent.began))
        self._pending = self._pending or self._new_trouble(index)
        if self._pending is not None and not self._rewinding:
            pending, self._pending = self._pending, None
            return self._plea("B", pending.reason, pending.began, index, self._place)
        left = place != self._place or over
        if left or (not self.world.segments and self._has_settled(pose)):
            return self._leave(index, place)
        return None

    def _new_trouble(self, index: int) -> Trouble | None:
        """What could be better in this place; its beginning is never put before the place's own."""
        trouble = self._bystander.improvable(index - self._entered)
        return trouble and replace(trouble, began=max(trouble.began, self._entered))

    def _leave(self, index: int, place: str) -> Plea | None:
        """A place is over: is it worth going back?"""
        here, entered, pending = self._place or "", self._entered, self._pending
        self._place, self._entered, self._pending = place, index, None
        if here in self._settled:
            return None
        if pending is not None:
            return self._plea("B", pending.reason, pending.began, index, here)
        if self._rewinding and here and (index - entered) * TICK >= ORDINARY_TIME:
            return self._plea("D", "the default works here", entered, index, here)
        return None

    def _has_settled(self, pose: Pose2) -> bool:
        if self._pending is None:
            return False
        there = self._poses[self._pending.noticed]
        return math.hypot(pose.x - there.x, pose.y - there.y) > SETTLE

    def _plea(self, kind: Kind, reason: str, began: int, index: int, place: str) -> Plea:
        start = max(self._first_tick, began - round(LEAD / TICK))
        if kind == "A" and place and place == self._place:  # a person shows a place they know from its beginning
            start = min(start, self._entered)
        return Plea(kind, reason, began, began if kind == "D" else self._easy(start), index, place)

    def _easy(self, index: int) -> int:
        """The last tick, not after `index`, with room to steer; `index` itself where there was none of late."""
        for earlier in range(index, max(self._first_tick, index - round(LOOK_BACK / TICK)) - 1, -1):
            if _room(self.space, self._poses[earlier]) >= EASY:
                return earlier
        return index

    @property
    def _first_tick(self) -> int:
        return next(iter(self._poses))

    def _place_of(self, index: int) -> str:
        segment = segment_at(self.world, self._poses[max(index, self._first_tick)])
        return "" if segment is None else segment.name

    def is_new(self, plea: Plea) -> bool:
        """Whether this place has not been dealt with yet; places without a name are always new."""
        return plea.place not in self._settled

    def settle(self, plea: Plea) -> None:
        """The place of the plea has been shown and needs nothing more."""
        if plea.place:
            self._settled.add(plea.place)

    def resume(self, plea: Plea, index: int, pose: Pose2) -> None:
        """The default drives on from where the intervention ended, at tick `index`."""
        self.settle(plea)
        self._bystander.look_again()
        segment = segment_at(self.world, pose)
        self._place, self._entered, self._pending = "" if segment is None else segment.name, index, None
        self._poses = {index: pose}


@dataclass(frozen=True, slots=True)
class Demonstration:
    """A drive by hand, in progress: state in, state out."""

    world: World
    space: FreeSpace
    expert: Expert | Retreat
    hand: Hand
    plea: Plea
    started: int  # tick
    good: bool  # whether what is driven now is worth learning from

    @classmethod
    def begin(
        cls, intervener: Intervener, plea: Plea, index: int, pose: Pose2, twist: Twist2, trail: Array | None = None
    ) -> Demonstration:
        """Take over at `pose` (true). A `trail` (n, 2), newest first, says that the robot was not rewound.

        Such a robot may stand where no forward drive leads out; it backs along the trail first, and nothing is worth
        learning from until a good state is reached.
        """
        world, space, hand = intervener.world, intervener.space, Hand(Command(twist.v, twist.w))
        if trail is not None and not _has_room(space, pose):
            return cls(world, space, Retreat(trail), hand, plea, index, good=False)
        return cls(world, space, _expert(world, space, plea, pose), hand, plea, index, good=trail is None)

    def drive(self, pose: Pose2, rng: np.random.Generator) -> tuple[Command, Demonstration]:
        """The next command."""
        now = self
        if isinstance(self.expert, Retreat) and (_has_room(self.space, pose) or self.expert.at_end(self.hand)):
            hand = Hand(self.hand.command, self.hand.age, self.hand.wander)
            now = replace(self, expert=_expert(self.world, self.space, self.plea, pose), hand=hand)
        command, hand = now.expert.drive(now.hand, pose, rng)
        good = now.good or (isinstance(now.expert, Expert) and now.expert.is_good(hand, pose))
        return command, replace(now, hand=hand, good=good)

    def is_over(self, index: int, pose: Pose2) -> bool:
        """Handed back: the place lies behind, after LEAST and at the latest after MOST seconds."""
        seconds = (index - self.started) * TICK
        if seconds >= MOST:
            return True
        if isinstance(self.expert, Retreat):
            return False
        if self.expert.at_end(self.hand):
            return True
        segment = segment_at(self.world, pose)
        left = bool(self.plea.place) and (segment is None or segment.name != self.plea.place)
        settled = not self.plea.place and self.expert.route.clearance[self.hand.progress] > 0.6
        return seconds >= LEAST and (left or settled)


def _expert(world: World, space: FreeSpace, plea: Plea, pose: Pose2) -> Expert:
    pace = PACES[plea.kind]
    return Expert(plan_route(space, pose, world.goal, pace), pace)


def _has_room(space: FreeSpace, pose: Pose2) -> bool:
    return _room(space, pose) >= ROOM


def _room(space: FreeSpace, pose: Pose2) -> float:
    """[m] from the robot's centre to the nearest obstacle."""
    return float(space.at(np.array([[pose.x, pose.y]]))[0])
