"""The steps {x_t, a_t} of an intervention as columns: small in memory and on disk, byte-equal when taken out again.

A step holds two obstacle maps of 40 kB and 640 kB; packed, it costs about 10 kB. A map is kept as what differs from
the map of the step before (moved with the rolling window), in runs of equal cells.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from learning.step_columns import MAPS, Columns, check_columns
from twin.planner.map_frame import shifted
from twin.records import Array, Bytes, Command, Observation, ObstacleMap, Pose2, Scan, Twist2, frozen_array


@dataclass(frozen=True, slots=True)
class Step:
    """One tick of an intervention: x_t, a_t of the paper."""

    observation: Observation
    action: Command  # what the intervener commanded
    labelled: bool = True  # False: kept but not learned from (getting out of trouble without a rewind)


@dataclass(frozen=True, eq=False, slots=True)
class PackedSteps(Sequence[Step]):
    """Steps over columns (`step_columns.py`). Going through it in order is cheap, an index costs some ms."""

    columns: Columns

    def __post_init__(self) -> None:
        check_columns(self.columns)
        for column in self.columns.values():
            column.setflags(write=False)

    def __len__(self) -> int:
        return len(self.columns["time"])

    def __iter__(self) -> Iterator[Step]:
        maps = zip(*(_unpack_maps(self.columns, name) for name in MAPS), strict=True)
        for k, (local_map, global_map) in enumerate(maps):
            yield self._step(k, local_map, global_map)

    @overload
    def __getitem__(self, index: int) -> Step: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Step, ...]: ...
    def __getitem__(self, index: int | slice) -> Step | tuple[Step, ...]:
        if isinstance(index, slice):
            wanted = range(*index.indices(len(self)))
            found = {k: step for k, step in enumerate(self) if k in wanted}
            return tuple(found[k] for k in wanted)
        at = index + len(self) if index < 0 else index
        if not 0 <= at < len(self):
            raise IndexError(f"step {index} of {len(self)}")
        local_map, global_map = (_unpack_map(self.columns, name, at) for name in MAPS)
        return self._step(at, local_map, global_map)

    @property
    def times(self) -> Array:
        """(T,) [s]."""
        return self.columns["time"]

    @property
    def actions(self) -> Array:
        """(T, 2) v [m/s], w [rad/s] of the intervener."""
        return self.columns["action"]

    @property
    def labelled(self) -> NDArray[np.bool_]:
        """(T,) which steps are for learning."""
        return self.columns["labelled"]

    @property
    def poses(self) -> Array:
        """(T, 3) odom_from_base x, y [m], yaw [rad]."""
        return self.columns["pose"]

    @property
    def ranges(self) -> Array:
        """(T, N) [m] the scans, right to left; inf = no return."""
        return self.columns["ranges"]

    def _step(self, k: int, local_map: ObstacleMap, global_map: ObstacleMap) -> Step:
        c = self.columns
        frame = c["scan_frame"].tolist()
        scan = Scan(c["ranges"][k], frame[0], frame[1], frame[2], frame[3], (frame[4], frame[5], frame[6]))
        pose, twist, goal = (
            Pose2(*c["pose"][k].tolist()),
            Twist2(*c["twist"][k].tolist()),
            Pose2(*c["goal"][k].tolist()),
        )
        x = Observation(float(c["time"][k]), pose, twist, scan, local_map, global_map, goal)
        return Step(x, Command(*c["action"][k].tolist()), bool(c["labelled"][k]))


def pack(steps: Sequence[Step]) -> PackedSteps:
    """The steps as columns. Raises ValueError when they do not form one intervention (see `step_columns.py`)."""
    if len(steps) == 0:
        raise ValueError("an intervention needs at least one step")
    rows = [(s.observation, s.action) for s in steps]
    frames = {_scan_frame(x.scan) for x, _ in rows}
    if len(frames) > 1 or len({x.scan.ranges.shape for x, _ in rows}) > 1:
        raise ValueError("the scans of an intervention must have one geometry")
    if any(x.scan.ranges.dtype != np.float64 for x, _ in rows):
        raise ValueError("ranges must be float64")
    columns: dict[str, NDArray[Any]] = {
        "time": np.array([x.time for x, _ in rows], dtype=np.float64),
        "pose": np.array([(x.pose.x, x.pose.y, x.pose.yaw) for x, _ in rows], dtype=np.float64),
        "twist": np.array([(x.twist.v, x.twist.w) for x, _ in rows], dtype=np.float64),
        "goal": np.array([(x.goal.x, x.goal.y, x.goal.yaw) for x, _ in rows], dtype=np.float64),
        "action": np.array([(a.v, a.w) for _, a in rows], dtype=np.float64),
        "labelled": np.array([s.labelled for s in steps], dtype=np.bool_),
        "ranges": np.stack([x.scan.ranges for x, _ in rows]),
        "scan_frame": np.array(frames.pop(), dtype=np.float64),
    }
    for name in MAPS:
        maps = [x.local_map if name == "local" else x.global_map for x, _ in rows]
        columns |= {f"{name}_{column}": array for column, array in _pack_maps(maps).items()}
    return PackedSteps(columns)


def _scan_frame(scan: Scan) -> tuple[float, ...]:
    return (scan.angle_min, scan.angle_max, scan.range_min, scan.range_max, *scan.mount)


class _Runs(NamedTuple):
    gap: NDArray[np.int32]
    length: NDArray[np.int32]
    value: Bytes


def _changes(before: Bytes, after: Bytes) -> _Runs:
    """How to make the flat grid `before` into `after`."""
    changed = np.flatnonzero(before != after)
    if len(changed) == 0:
        return _Runs(np.empty(0, np.int32), np.empty(0, np.int32), np.empty(0, np.uint8))
    values = after[changed]
    fresh = np.ones(len(changed), dtype=np.bool_)
    fresh[1:] = (np.diff(changed) > 1) | (values[1:] != values[:-1])
    first = np.flatnonzero(fresh)
    starts, lengths = changed[first], np.diff(first, append=len(changed))
    gaps = np.diff(starts, prepend=0)
    gaps[1:] -= lengths[:-1]
    return _Runs(gaps.astype(np.int32), lengths.astype(np.int32), values[first])


def _apply_changes(flat: Bytes, runs: _Runs) -> None:
    """Make a writable flat grid into the one after the changes."""
    lengths = runs.length.astype(np.int64)
    ends = np.cumsum(runs.gap.astype(np.int64) + lengths)
    within = np.arange(int(lengths.sum())) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    flat[np.repeat(ends - lengths, lengths) + within] = np.repeat(runs.value, lengths)


def _window_shift(before: Sequence[float], after: Sequence[float], resolution: float) -> tuple[int, int]:
    """How many cells (x, y) the window moved."""
    return round((after[0] - before[0]) / resolution), round((after[1] - before[1]) / resolution)


def _pack_maps(maps: Sequence[ObstacleMap]) -> dict[str, NDArray[Any]]:
    first = maps[0]
    if any(m.cells.shape != first.cells.shape or m.resolution != first.resolution for m in maps):
        raise ValueError("the maps of an intervention must have one size and resolution")
    if any(m.cells.dtype != np.uint8 for m in maps):
        raise ValueError("map cells must be uint8")
    changes = []
    before, origin = np.zeros_like(first.cells), first.origin
    for m in maps:
        moved = _window_shift(origin, m.origin, m.resolution)
        changes.append(_changes(shifted(before, *moved).ravel(), m.cells.ravel()))
        before, origin = m.cells, m.origin
    return {
        "shape": np.array(first.cells.shape, dtype=np.int32),
        "resolution": np.array(first.resolution, dtype=np.float64),
        "origin": np.array([m.origin for m in maps], dtype=np.float64),
        "touched": np.array([m.touched for m in maps], dtype=np.float64),
        "whole": np.array([m.whole for m in maps], dtype=np.bool_),
        "runs": np.array([len(c.gap) for c in changes], dtype=np.int32),
        "gap": np.concatenate([c.gap for c in changes]),
        "length": np.concatenate([c.length for c in changes]),
        "value": np.concatenate([c.value for c in changes]),
    }


def _unpack_maps(columns: Columns, name: str, only: int | None = None) -> Iterator[ObstacleMap]:
    """The maps in order; with `only`, just that one."""
    c = {key.removeprefix(f"{name}_"): column for key, column in columns.items() if key.startswith(f"{name}_")}
    resolution = float(c["resolution"])
    origins = c["origin"].tolist()
    ends = np.cumsum(c["runs"].astype(np.int64)).tolist()
    cells = np.zeros(tuple(c["shape"].tolist()), dtype=np.uint8)
    last = len(origins) if only is None else only + 1
    for k in range(last):
        move = _window_shift(origins[max(0, k - 1)], origins[k], resolution)
        if only is None or move != (0, 0):
            cells = shifted(cells, *move)
        span = slice(ends[k] - int(c["runs"][k]), ends[k])
        _apply_changes(cells.reshape(-1), _Runs(c["gap"][span], c["length"][span], c["value"][span]))
        if only is None or k == only:
            touched = tuple(c["touched"][k].tolist())
            yield ObstacleMap(
                frozen_array(cells), (origins[k][0], origins[k][1]), resolution, touched, bool(c["whole"][k])
            )


def _unpack_map(columns: Columns, name: str, index: int) -> ObstacleMap:
    return next(_unpack_maps(columns, name, index))
