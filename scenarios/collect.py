"""`appli collect`: the default planner drives, the synthetic intervener watches, rewinds, and shows a better drive."""

from __future__ import annotations

import functools
import re
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from rich.table import Column
from rich.text import Text

from learning.intervener import Demonstration, Intervener, Plea
from learning.interventions import Intervention, Kind, Metadata, Step, save_intervention
from learning.route import UnreachableError
from scenarios.errors import UserError, blame
from scenarios.folders import make_folder
from scenarios.run import compile_kernels
from scenarios.tables import plain_table, print_table
from scenarios.teaching import TAPE, highest_numbers
from scenarios.trials import TrialSpec, make_driver, make_simulation
from scenarios.worlds import check_protocol, load_world
from twin.geometry import distance
from twin.records import STOP, Array, Pose2, Tick, Twist2
from twin.rewind import Tape
from twin.rollout import Loop
from twin.simulation import TICK
from twin.world import World

TRAIL_SPACING = 0.04  # [m]
LEAD = 3.0  # [s] of the default's drive that a recording shows before the trouble, or before where it is wound back to
SHOWN = 40.0  # [s] of that drive at most: 14 MB each
PATIENCE = 12  # times that help at a place may be needed again before the session gives up


@dataclass(frozen=True, slots=True)
class Collected:
    """One intervention of a session, and how it went."""

    intervention: Intervention
    place: str
    min_clearance: float  # [m] during the demonstration
    ticks: tuple[Tick, ...]  # the demonstration
    before: tuple[Tick, ...]  # the default's drive that led to it, up to where it was noticed; empty unless explained
    start: int  # tick of that drive that was wound back to; after the last = not wound back


@dataclass(frozen=True, slots=True)
class Moment:
    """What is kept of a tick for the whole drive; the tick itself holds maps of 640 kB."""

    time: float  # [s]
    pose: Pose2  # odom
    twist: Twist2
    true_pose: Pose2  # world


class Labels:
    """Which context an intervention teaches. A named place has the same label in every session.

    A place that is named after a context of the intervention's type has that name; any other place has the next number
    of the type. Where places have no names, every intervention is a context of its own, numbered after those so far.
    """

    def __init__(self, world: World, so_far: Mapping[Kind, int] | None = None) -> None:
        self._places = list(dict.fromkeys(segment.name for segment in world.segments))
        self._highest: Counter[Kind] = Counter(so_far or {})

    def of(self, kind: Kind, place: str) -> str:
        """The label of an intervention of this type at this place ("" = nowhere in particular)."""
        taken = [name for name in self._places if re.fullmatch(rf"{kind}[1-9][0-9]{{0,2}}", name)]
        if place in taken:
            return place
        first = max((int(name[1:]) for name in taken), default=0) + 1
        others = [name for name in self._places if name not in taken]
        if place in others:
            return f"{kind}{first + others.index(place)}"
        self._highest[kind] = max(self._highest[kind] + 1, first + len(others))
        return f"{kind}{self._highest[kind]}"


class Session:
    """One drive with interventions."""

    def __init__(
        self,
        spec: TrialSpec,
        world: World,
        say: Callable[[str], None] = lambda _: None,
        rewinding: bool = True,
        labels: Labels | None = None,
        explain: bool = False,
    ) -> None:
        """`say` hears what is going on, in words. Without rewinding the person takes over where the robot is.

        `explain`: ticks hold costmaps and candidate arcs, for a recording.
        """
        self._rewinding = rewinding
        self._spec, self._world, self._say = spec, world, say
        self._tape = Tape(Loop(make_simulation(spec, world), make_driver(spec, explain)), TAPE)
        self._intervener = Intervener(world, rewinding)
        self._rng = np.random.default_rng([spec.seed, world.index, spec.run, 1])  # the human's hand
        self._past: dict[int, Moment] = {}  # by tick
        self._shown: dict[int, Tick] | None = {} if explain else None  # the last SHOWN seconds
        self._labels = labels or Labels(world)
        self._helped = 0

    def run(self, keep: Callable[[Collected], None]) -> None:
        """Drive to the end of the trial; `keep` gets every intervention as soon as it is complete."""
        over = False
        while not over:
            tick = self._tape.step()
            self._remember(tick)
            over = tick.outcome is not None
            plea = self._intervener.watch(tick.index, tick.true_pose, over, tick.contact is not None)
            if plea is None or (over and not self._rewinding):  # without rewinding, over is over
                continue
            new = self._intervener.is_new(plea)
            if not new:
                self._helped += 1
                if self._helped > PATIENCE:
                    self._say("the default gets nowhere even with help; stopped")
                    return
                self._say(f"helps again at {plea.place}: {plea.reason}")
            collected, over = self._intervene(plea, new, over)
            if new:
                keep(collected)

    def _remember(self, tick: Tick) -> None:
        x = tick.observation
        self._past[tick.index] = Moment(x.time, x.pose, x.twist, tick.true_pose)
        if self._shown is not None:
            self._shown[tick.index] = tick
            self._shown.pop(tick.index - round(SHOWN / TICK), None)

    def _intervene(self, plea: Plea, new: bool, over: bool) -> tuple[Collected, bool]:
        """Wind back and drive by hand. True when the trial is over afterwards.

        After a failure (type A) the default goes on from where the person hands back. Where it had managed by itself
        (types B and D) it goes on from where it had got to: the better drive was an excursion.
        """
        start = max(plea.start, self._tape.oldest) if self._rewinding else self._tape.position
        began = self._past[max(plea.began, start) if self._rewinding else plea.began]
        rewound = max(0.0, (plea.noticed - start) * TICK)
        first = min(start, plea.began) - round(LEAD / TICK)
        shown = self._shown or {}
        before = tuple(shown[k] for k in range(first, plea.noticed + 1) if k in shown)
        if plea.kind == "A" or not self._rewinding:
            self._tape.rewind(start)
            ticks, good = self._drive_by_hand(plea, start)
            over = ticks[-1].outcome is not None
            self._intervener.resume(plea, self._tape.position, self._tape.loop.simulation.true_pose)
        else:
            with self._tape.excursion(start):
                ticks, good = self._drive_by_hand(plea, start)
            self._intervener.settle(plea)
        label = self._labels.of(plea.kind, plea.place) if new else f"{plea.kind}1"
        metadata = Metadata(
            world=self._spec.world,
            seed=self._spec.seed,
            source="synthetic",
            trigger=plea.reason,
            trouble_time=began.time,
            trouble_pose=began.pose,
            rewound=rewound,
            versions={name: version(name) for name in ("appli-twin", "mujoco", "numpy")},
        )
        steps = [Step(t.observation, t.applied or STOP, labelled=worth) for t, worth in zip(ticks, good, strict=True)]
        if new:
            self._say(f"{label} at {_where(plea, ticks[0].true_pose)}: {plea.reason}")
        clearance = min(t.clearance for t in ticks)
        made = Intervention(plea.kind, label, steps, metadata)
        return Collected(made, plea.place, clearance, tuple(ticks), before, start), over

    def _drive_by_hand(self, plea: Plea, start: int) -> tuple[list[Tick], list[bool]]:
        """The person's drive from tick `start` until handed back or the trial ends; which ticks are worth learning."""
        simulation, twist = self._tape.loop.simulation, self._past[min(start, plea.noticed)].twist
        trail = None if self._rewinding else self._trail(plea.noticed)
        by_hand = Demonstration.begin(self._intervener, plea, start, simulation.true_pose, twist, trail)
        ticks: list[Tick] = []
        good: list[bool] = []
        while not (ticks and by_hand.is_over(self._tape.position, simulation.true_pose)):
            command, by_hand = by_hand.drive(simulation.true_pose, self._rng)
            ticks.append(self._tape.step(command))
            good.append(by_hand.good)
            if plea.kind == "A" or not self._rewinding:
                self._remember(ticks[-1])
            if ticks[-1].outcome is not None:
                break
        return ticks, good

    def _trail(self, newest: int) -> Array:
        """(n, 2) where the robot has been, newest first, a point every few centimetres."""
        points = [self._past[newest].true_pose]
        for index in range(newest, min(self._past) - 1, -1):
            pose = self._past[index].true_pose
            if distance(pose, points[-1]) > TRAIL_SPACING:
                points.append(pose)
        return np.array([[p.x, p.y] for p in points])


def _where(plea: Plea, pose: Pose2) -> str:
    return plea.place or f"({pose.x:.1f}, {pose.y:.1f})"


def collect_command(
    world_name: str, out: Path, protocol: str, seed: int, sessions: int, rewinding: bool, record: bool
) -> int:
    """Run the sessions, write their interventions, print a table. Exit code 1 = there was nothing to intervene in."""
    if seed < 0:
        raise UserError(f"--seed must be 0 or more, not {seed}")
    if sessions < 1:
        raise UserError(f"--sessions must be 1 or more, not {sessions}")
    with blame():
        world = load_world(world_name, protocol)
        check_protocol(world, protocol)
    make_folder(out)
    compile_kernels()
    table = plain_table(Column("file", no_wrap=True), "label", "rewound [s]", "steps", "closest [m]", "trouble")
    count = 0

    def keep(collected: Collected) -> None:
        nonlocal count
        count += 1
        made = collected.intervention
        with blame(f"cannot write to {out}"):
            path = save_intervention(made, out)
            if record:
                from scenarios.recorded import record_intervention

                record_intervention(path.with_suffix(".rrd"), world, collected)
        table.add_row(
            path.name,
            made.label,
            f"{made.metadata.rewound:.1f}",
            str(len(made.steps)),
            f"{collected.min_clearance:.2f}",
            Text(made.metadata.trigger),
        )

    labels = Labels(world, highest_numbers(out))
    for number in range(seed, seed + sessions):
        say = functools.partial(print, f"appli collect: session {number}:", file=sys.stderr, flush=True)
        try:
            Session(TrialSpec(world_name, protocol, seed=number), world, say, rewinding, labels, record).run(keep)
        except UnreachableError as error:
            raise UserError(f"{world.name}: {error}; a human could not show a way either") from error
    if count == 0:
        print(f"{world.name}: nothing to intervene in")
        return 1
    print_table(table)
    print(f"{count} intervention{'s' * (count != 1)} in {out}")
    return 0
