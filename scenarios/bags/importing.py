"""`appli collect --bag`: interventions of a recorded drive, of a real robot or of the twin."""

from __future__ import annotations

import bisect
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

from rich.table import Column
from rich.text import Text

from learning.interventions import Intervention, Metadata, Step, save_intervention
from learning.steps import PackedSteps, pack
from scenarios.bags import topics
from scenarios.bags.files import BagError, BagReader
from scenarios.bags.frames import goals_in_odom
from scenarios.bags.options import BagOptions
from scenarios.bags.replay import PERIOD, Moment, find_robot, moments, odom_frame
from scenarios.bags.spans import Span, default_type, marked_spans, parse_range
from scenarios.errors import UserError, blame
from scenarios.folders import make_folder
from scenarios.run import compile_kernels
from scenarios.tables import plain_table, print_table
from scenarios.teaching import highest_numbers
from twin.planner.obstacle_layer import GLOBAL_MAP
from twin.records import STOP, Observation, Pose2

REACH = GLOBAL_MAP.size_x * GLOBAL_MAP.resolution / 2  # [m] from the origin to the nearest border of the global map


@dataclass
class _Gathering:
    """The steps of one span, as they come."""

    span: Span
    label: str
    steps: list[Step] = field(default_factory=list)
    commanded: bool = False  # somebody drove
    packed: PackedSteps | None = None  # once the span is over

    def finish(self) -> None:
        """Pack the steps: their maps take a hundredth of the memory then."""
        if self.packed is None:
            if not self.steps:
                raise BagError(
                    f"{self.span.said_by} holds no step: it is shorter than {PERIOD / 1e9} s, or before the first scan"
                )
            self.packed, self.steps = pack(self.steps), []


@dataclass(frozen=True, slots=True)
class Source:
    """Where interventions are said to come from."""

    world: str
    seed: int


def collect_bag_command(
    options: BagOptions, world: str | None, out: Path, seed: int, rewinding: bool, record: bool
) -> int:
    """Read a bag, write its interventions, print a table."""
    assert options.bag is not None
    if not rewinding or record:
        raise UserError(f"{'--record' if record else '--no-rewind'} does not go with --bag")
    if seed < 0:
        raise UserError(f"--seed must be 0 or more, not {seed}")
    with blame():
        interventions, remarks = read_interventions(options, Source(world or options.bag.stem, seed), out)
    for remark in remarks:
        print(f"appli collect: {remark}", file=sys.stderr)
    table = plain_table(Column("file", no_wrap=True), "label", "from [s]", "to [s]", "steps", "said by")
    make_folder(out)
    written: list[Path] = []
    for made in interventions:
        try:
            with blame(f"cannot write to {out}"):
                written.append(path := save_intervention(made, out))
        except BaseException:
            for done in written:  # all or none
                done.unlink(missing_ok=True)
            raise
        ended = made.start_time + made.duration
        said = made.metadata.trigger
        table.add_row(path.name, made.label, f"{made.start_time:.2f}", f"{ended:.2f}", str(len(made.steps)), Text(said))
    print_table(table)
    print(f"{len(interventions)} intervention{'s' * (len(interventions) != 1)} in {out}")
    return 0


def read_interventions(options: BagOptions, source: Source, out: Path) -> tuple[list[Intervention], list[str]]:
    """All interventions of a bag, and remarks. Raises BagError or UserError unless every one of them is good.

    Those without a number in their label go on counting where the folder `out` ends.
    """
    assert options.bag is not None
    default = default_type(options.type, options.label)
    if (options.marker is None) == (options.range == ()):
        raise UserError("say which parts are interventions: --range START:END:TYPE or --marker TOPIC, one of the two")
    spans = [parse_range(text, default) for text in options.range]
    with BagReader(options.bag) as bag:
        scan = topics.find_topic(bag, topics.SCAN, options.scan)
        odometry = topics.find_topic(bag, topics.ODOMETRY, options.odom)
        cmd_vel = topics.find_topic(bag, topics.CMD_VEL, options.cmd_vel)
        goal = topics.find_topic(bag, topics.GOAL, options.goal)
        if options.marker is not None:
            spans = marked_spans(bag, topics.find_topic(bag, topics.MARKER, options.marker), default)
        length = bag.seconds(bag.end)
        if late := next((s for s in spans if s.end > length + PERIOD / 1e9), None):
            raise BagError(f"{bag.path}: {late.said_by} ends after the bag, which is {length:.2f} s long")
        robot, remark = find_robot(bag, scan, odometry, cmd_vel)
        frame, start = odom_frame(bag, odometry)
        goals = [
            (time, Pose2(pose.x - start.x, pose.y - start.y, pose.yaw))
            for time, pose in goals_in_odom(bag, goal, frame)
        ]
        if not goals:
            raise BagError(f"{bag.path}: {goal} never gives a goal, only empty paths; try another --goal topic")
        compile_kernels()
        until = bag.start + round(max(span.end for span in spans) * 1e9)
        gatherings = [_Gathering(span, label) for span, label in _labelled(spans, out)]
        _gather(bag, gatherings, moments(bag, robot, until), goals, robot.cmd_vel)
        made = [_finished(gathering, source) for gathering in gatherings]
    return made, [] if remark is None else [remark]


def _labelled(spans: Sequence[Span], out: Path) -> Iterator[tuple[Span, str]]:
    """The spans in order of time, with labels for those that have none."""
    numbers = highest_numbers(out)
    for span in sorted(spans, key=lambda span: span.start):
        if span.label is None:
            numbers[span.kind] += 1
        yield span, span.label or f"{span.kind}{numbers[span.kind]}"


def _gather(
    bag: BagReader,
    gatherings: Sequence[_Gathering],
    ticks: Iterable[Moment],
    goals: Sequence[tuple[int, Pose2]],
    cmd_vel: str,
) -> None:
    """Let every span have its steps. Raises BagError where one of them could not be learnt from."""
    given = [time for time, _ in goals]
    for moment in ticks:
        at = bag.seconds(moment.time)
        for gathering in gatherings:
            span = gathering.span
            if gathering.packed is not None or at < span.start:
                continue
            if at >= span.end:
                gathering.finish()
                continue
            if not gathering.steps and at - span.start > PERIOD / 1e9:
                raise BagError(f"{bag.path}: {span.said_by} begins before lidar and odometry do, at {at:.2f} s")
            if moment.stale is not None:
                raise BagError(f"{bag.path}: {moment.stale} is silent at {at:.2f} s, within {span.said_by}")
            latest = bisect.bisect_right(given, moment.time) - 1
            if latest < 0:
                first = bag.seconds(given[0])
                raise BagError(f"{bag.path}: {span.said_by} begins before the first goal, at {first:.2f} s")
            goal = goals[latest][1]
            for what, pose in (("robot", moment.pose), ("goal", goal)):
                if max(abs(pose.x), abs(pose.y)) >= REACH:
                    raise BagError(
                        f"{bag.path}: at {at:.2f} s the {what} is at ({pose.x:.1f}, {pose.y:.1f}) m from where the bag "
                        f"starts, outside the global map of +-{REACH:.0f} m; cut the bag nearer to the intervention"
                    )
            gathering.commanded |= moment.command is not None
            gathering.steps.append(Step(_observation(at, moment, goal), moment.command or STOP))
    for gathering in gatherings:
        gathering.finish()
        if not gathering.commanded:
            raise BagError(f"{bag.path}: {cmd_vel} is silent within {gathering.span.said_by}; nobody drives there")


def _observation(at: float, moment: Moment, goal: Pose2) -> Observation:
    maps = moment.obstacles
    return Observation(at, moment.pose, moment.twist, moment.scan, maps.local_map, maps.global_map, goal)


def _finished(gathering: _Gathering, source: Source) -> Intervention:
    metadata = Metadata(
        world=source.world,
        seed=source.seed,
        source="bag",
        trigger=gathering.span.said_by,
        versions={name: version(name) for name in ("appli-twin", "numpy", "rosbags")},
    )
    assert gathering.packed is not None
    return Intervention(gathering.span.kind, gathering.label, gathering.packed, metadata)
