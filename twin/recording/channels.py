"""What a batch of ticks adds to a recording: per entity, rows of Rerun columns on the ticks they belong to.

Entity paths: `world/...` is drawn, everything else is plotted, shown as lanes, or listed. Costmap, plan and arcs are
drawn at 5 Hz, the scan of the top view at 10 Hz, the rest at 20 Hz.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from twin.geometry import distance
from twin.recording import drawing, palette
from twin.recording.judge import Judge
from twin.recording.plots import evidence_entity
from twin.records import Array, Pose2, Tick

EVERY = 4  # ticks between two drawings of costmap, plan and candidate arcs
FLAT_SCAN_EVERY = 2  # ticks between two drawings of the scan in the top view
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")  # the order of Tick.body_poses


@dataclass(frozen=True, slots=True)
class Rows:
    """Columns of one entity, one row per tick."""

    entity: str
    ticks: Sequence[Tick]
    columns: Any  # rr.ComponentColumnList


def rows_of(ticks: Sequence[Tick], before: Tick | None, judge: Judge | None = None) -> Iterator[Rows]:
    """Everything that `ticks` add; they follow `before`, if that is given."""
    yield from _scalars(ticks, judge)
    yield from _states(ticks, before)
    yield from _trail(ticks, before)
    yield from _contacts(ticks)
    yield from _events(ticks, before)
    yield from drawings_of(ticks, before)


def drawings_of(ticks: Sequence[Tick], before: Tick | None) -> Iterator[Rows]:
    """What is drawn of `ticks` for the moment, and gone with the next."""
    yield from _poses(ticks, before)
    yield _scans(ticks)
    if flat := [tick for tick in ticks if tick.index % FLAT_SCAN_EVERY == 0]:
        yield _flat_scans(flat)
    if drawn := [tick for tick in ticks if tick.index % EVERY == 0]:
        yield _candidates(drawn)
        yield _chosen(drawn)
        yield _costmaps(drawn)
        yield _plans(drawn)


def phase_of(tick: Tick, phase: str, event: str) -> Iterator[Rows]:
    """A phase that begins with `tick`: its lane, and its line in the log."""
    yield Rows("phase", [tick], rr.StateChange.columns(state=[phase]))
    yield Rows("events", [tick], rr.TextLog.columns(text=[event], level=[rr.TextLogLevel.INFO]))


def scalars_of(tick: Tick, judge: Judge | None = None) -> Iterator[tuple[str, float]]:
    """(entity, value) of everything that is plotted for one tick."""
    decision = tick.decision
    commands = {"planner": decision.command, "human": tick.override, "applied": tick.applied}
    for source, command in commands.items():
        if command is not None:
            yield f"command/{source}/v", command.v
            yield f"command/{source}/w", command.w
    yield "odometry/v", tick.observation.twist.v
    yield "odometry/w", tick.observation.twist.w
    yield "clearance", tick.clearance
    for name, value in decision.theta.as_dict().items():
        yield f"params/{name}", float(value)
    if decision.confidence is not None:
        yield "appli/confidence", decision.confidence
        if judge is not None and judge.threshold is not None:
            yield "appli/threshold", judge.threshold
    if judge is not None:
        for label, evidence in judge.evidence(tick.observation.scan).items():
            yield evidence_entity(label), evidence
    if decision.arc is not None:
        yield "arc/cost", decision.arc.cost
        yield "arc/path_cells", decision.arc.path_cells
        yield "arc/goal_cells", decision.arc.goal_cells
        yield "arc/obstacle", decision.arc.obstacle
    for reason, count in decision.rejected.items():
        yield f"arc/rejected/{reason}", float(count)


def events_of(tick: Tick, before: Tick | None) -> Iterator[tuple[str, str]]:
    """(text, level) of what happened at one tick that is worth a line in the log."""
    decision = tick.decision
    if tick.index == 0:
        yield f"start, {distance(tick.observation.pose, tick.observation.goal):.1f} m to the goal", rr.TextLogLevel.INFO
    earlier = 0 if tick.index == 0 else decision.recoveries if before is None else before.decision.recoveries
    if decision.recoveries > earlier:
        yield f"recovery {decision.recoveries}: {decision.state}", rr.TextLogLevel.WARN
    if before is not None and decision.context != before.decision.context:
        yield f"context {before.decision.context} -> {decision.context}", rr.TextLogLevel.INFO
    if decision.aborted:
        yield "move_base gives up", rr.TextLogLevel.ERROR
    if (hit := tick.contact) is not None:
        yield f"contact with {hit.obstacle} at ({hit.x:.2f}, {hit.y:.2f})", rr.TextLogLevel.ERROR
    if tick.outcome is not None:
        level = rr.TextLogLevel.INFO if tick.outcome.value == "reached" else rr.TextLogLevel.ERROR
        yield f"{tick.outcome.value} after {tick.elapsed:.2f} s", level


def style_drawings(stream: Any) -> None:
    """Colours and sizes [m] of what is drawn per tick, logged once."""
    lines = {
        "world/robot/arcs/candidates": (None, 0.006),
        "world/robot/arcs/chosen": (palette.CHOSEN_ARC, 0.022),
        "world/global_path": (palette.GLOBAL_PATH, 0.018),
        "world/trail": (None, 0.028),
    }
    points = {
        "world/robot/scan": (palette.SCAN, 0.016),
        "world/plan/scan": (palette.SCAN, 0.03),
        "world/contact": (palette.CONTACT, 0.09),
    }
    for shape, styles in ((rr.LineStrips3D, lines), (rr.Points3D, points)):
        for entity, (colour, radius) in styles.items():
            stream.send_columns(entity, [], shape.columns(radii=[radius]))
            if colour is not None:
                stream.send_columns(entity, [], shape.columns(colors=np.array([colour], np.uint8)))
    # Below 1, or Rerun ignores the image's own transparency.
    stream.send_columns("world/local_costmap", [], rr.GridMap.columns(opacity=[0.99]))


def _scalars(ticks: Sequence[Tick], judge: Judge | None) -> Iterator[Rows]:
    found: dict[str, tuple[list[Tick], list[float]]] = {}
    for tick in ticks:
        for name, value in scalars_of(tick, judge):
            at, values = found.setdefault(name, ([], []))
            at.append(tick)
            values.append(value)
    for name, (at, values) in sorted(found.items()):
        yield Rows(name, at, rr.Scalars.columns(scalars=values))


def _states(ticks: Sequence[Tick], before: Tick | None) -> Iterator[Rows]:
    """The lanes: one row per change."""
    lanes: dict[str, Callable[[Tick], str]] = {
        "planner/state": lambda tick: tick.decision.state,
        "appli/context": lambda tick: tick.decision.context,
    }
    for name, state in lanes.items():
        changed = [b for a, b in _steps(ticks, before) if a is None or state(a) != state(b)]
        if changed:
            yield Rows(name, changed, rr.StateChange.columns(state=[state(tick) for tick in changed]))


def _poses(ticks: Sequence[Tick], before: Tick | None) -> Iterator[Rows]:
    bodies = np.array([tick.body_poses for tick in ticks])
    wheels = drawing.wheels_on_chassis(bodies)
    yield _transforms("world/robot", ticks, bodies[:, 0])
    for k, name in enumerate(WHEELS):
        yield _transforms(f"world/robot/wheels/{name}", ticks, wheels[:, k])
    if before is None:
        mount = np.array([[*ticks[0].observation.scan.mount, 1.0, 0.0, 0.0, 0.0]])
        yield _transforms("world/robot/scan", ticks[:1], mount)
    # What the planner believes is given in odom; this places odom where it truly is.
    odom = np.array([_spatial(drawing.world_from_odom(tick)) for tick in ticks])
    yield _transforms("world/local_costmap", ticks, odom)
    yield _transforms("world/global_path", ticks, odom)


def _scans(ticks: Sequence[Tick]) -> Rows:
    points = [drawing.scan_points(tick.observation.scan) for tick in ticks]
    columns = rr.Points3D.columns(positions=np.concatenate(points))
    return Rows("world/robot/scan", ticks, columns.partition([len(p) for p in points]))


def _flat_scans(ticks: Sequence[Tick]) -> Rows:
    """Every second return, laid on the floor: seen from above, what is drawn higher up is shifted outwards."""
    points = [drawing.on_plane(drawing.scan_in_world(tick)[::2], 0.04) for tick in ticks]
    columns = rr.Points3D.columns(positions=np.concatenate(points))
    return Rows("world/plan/scan", ticks, columns.partition([len(p) for p in points]))


def _trail(ticks: Sequence[Tick], before: Tick | None) -> Iterator[Rows]:
    """The stretch driven since the tick before, coloured by the context that drove it, or as a person's."""
    moved = [(a, b) for a, b in _steps(ticks, before) if a is not None and a.true_pose != b.true_pose]
    if moved:
        strips = np.array([[(p.x, p.y, 0.02) for p in (a.true_pose, b.true_pose)] for a, b in moved], np.float32)
        colours = [_driver_colour(a) for a, _ in moved]
        columns = rr.LineStrips3D.columns(strips=strips, colors=np.array(colours, np.uint8))
        yield Rows("world/trail", [b for _, b in moved], columns)


def _driver_colour(tick: Tick) -> palette.RGB:
    return palette.HUMAN if tick.override is not None else palette.context_colour(tick.decision.context)


def _contacts(ticks: Sequence[Tick]) -> Iterator[Rows]:
    touching = [(tick, tick.contact) for tick in ticks if tick.contact is not None]
    if touching:
        positions = np.array([(hit.x, hit.y, 0.15) for _, hit in touching], np.float32)
        columns = rr.Points3D.columns(positions=positions)
        yield Rows("world/contact", [tick for tick, _ in touching], columns)


def _events(ticks: Sequence[Tick], before: Tick | None) -> Iterator[Rows]:
    events = [(tick, *event) for last, tick in _steps(ticks, before) for event in events_of(tick, last)]
    if events:
        at, texts, levels = zip(*events, strict=True)
        yield Rows("events", at, rr.TextLog.columns(text=texts, level=levels))


def _candidates(ticks: Sequence[Tick]) -> Rows:
    arcs = [drawing.candidate_arcs(tick.decision) for tick in ticks]
    strips = np.concatenate([a.points for a in arcs])  # one array: Rerun converts a list 10 x slower
    colours = np.concatenate([a.colours for a in arcs])
    columns = rr.LineStrips3D.columns(strips=strips, colors=colours)
    return Rows("world/robot/arcs/candidates", ticks, columns.partition([len(a.colours) for a in arcs]))


def _chosen(ticks: Sequence[Tick]) -> Rows:
    return _strips("world/robot/arcs/chosen", ticks, [drawing.chosen_arc(tick) for tick in ticks])


def _plans(ticks: Sequence[Tick]) -> Rows:
    paths = [tick.decision.global_path for tick in ticks]
    empty = np.zeros((0, 2))
    return _strips("world/global_path", ticks, [drawing.on_plane(empty if p is None else p, 0.012) for p in paths])


def _costmaps(ticks: Sequence[Tick]) -> Rows:
    maps = [drawing.costmap_of(tick) for tick in ticks]
    columns = rr.GridMap.columns(
        data=[drawing.costmap_image(m).tobytes() for m in maps],
        format=[
            rr.components.ImageFormat(m.cells.shape[1], m.cells.shape[0], color_model="RGBA", channel_datatype="U8")
            for m in maps
        ],
        cell_size=[m.resolution for m in maps],
        translation=np.array([(*m.origin, 0.008) for m in maps]),
    )
    return Rows("world/local_costmap", ticks, columns)


def _strips(entity: str, ticks: Sequence[Tick], lines: Sequence[drawing.Floats]) -> Rows:
    """One polyline per tick; an empty one clears the last."""
    columns = rr.LineStrips3D.columns(strips=[line for line in lines if len(line) > 1])
    return Rows(entity, ticks, columns.partition([int(len(line) > 1) for line in lines]))


def _transforms(entity: str, ticks: Sequence[Tick], poses: Array) -> Rows:
    """Poses (n, 7): position [m] and quaternion, scalar first; Rerun wants the scalar last."""
    turned = np.roll(poses[:, 3:], -1, axis=1)
    return Rows(entity, ticks, rr.Transform3D.columns(translation=poses[:, :3], quaternion=turned))


def _spatial(pose: Pose2) -> tuple[float, ...]:
    """A planar pose as position and quaternion (w, x, y, z)."""
    return (pose.x, pose.y, 0.0, float(np.cos(pose.yaw / 2)), 0.0, 0.0, float(np.sin(pose.yaw / 2)))


def _steps(ticks: Sequence[Tick], before: Tick | None) -> Iterator[tuple[Tick | None, Tick]]:
    """(the tick before, tick) for each tick."""
    last = before
    for tick in ticks:
        yield last, tick
        last = tick
