"""Recordings read back: what was plotted, the lanes and the events."""

from __future__ import annotations

import warnings
from bisect import bisect_right
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader

from twin.recording.sink import RecordingError
from twin.records import Array

PROPERTIES = "/__properties/run"


@dataclass(frozen=True, slots=True)
class Lane:
    """A state over time: `states[k]` holds from `ticks[k]` until the next change."""

    ticks: tuple[int, ...]
    states: tuple[str, ...]

    def at(self, tick: int) -> str | None:
        """The state at a tick; None before the first."""
        k = bisect_right(self.ticks, tick)
        return self.states[k - 1] if k else None


@dataclass(frozen=True, slots=True)
class Series:
    """A plotted scalar."""

    ticks: Array  # (n,) int64 tick indices
    times: Array  # (n,) [s] simulated
    values: Array  # (n,)


@dataclass(frozen=True, slots=True)
class Recording:
    """What a `.rrd` file holds beside its pictures. Names are entity paths without the leading slash."""

    metadata: dict[str, str]
    scalars: dict[str, Series]
    lanes: dict[str, Lane]
    events: tuple[tuple[int, str], ...]  # (tick, text)
    entities: frozenset[str]  # everything drawn or plotted


def read_recording(path: Path | str) -> Recording:
    """Read a recording, complete or cut short. Raises RecordingError when it is neither."""
    path = Path(path)
    chunks = _chunks(path)
    metadata: dict[str, str] = {}
    rows: dict[str, list[tuple[int, float, Any]]] = defaultdict(list)  # (tick, time, value)
    found: dict[str, str] = {}  # entity -> component
    entities = set()
    for chunk in chunks:
        batch = chunk.to_record_batch()
        columns = dict(zip(batch.schema.names, batch.columns, strict=True))
        if chunk.entity_path == PROPERTIES:
            facts = {name: column.to_pylist()[0] for name, column in columns.items()}
            metadata = {name: str(fact[0]) for name, fact in facts.items() if not name.startswith("rerun.")}
            continue
        entity = chunk.entity_path.removeprefix("/")
        entities.add(entity)
        for component in ("Scalars:scalars", "StateChange:state", "TextLog:text"):
            if component in columns and "tick" in columns:
                found[entity] = component
                ticks = columns["tick"].to_pylist()
                times = columns["sim_time"].cast("int64").to_numpy(zero_copy_only=False) * 1e-9
                values = [value[0] for value in columns[component].to_pylist()]
                rows[entity] += zip(ticks, times, values, strict=True)
    return Recording(
        metadata=metadata,
        scalars={e: _series(rows[e]) for e, c in sorted(found.items()) if c == "Scalars:scalars"},
        lanes={e: _lane(rows[e]) for e, c in sorted(found.items()) if c == "StateChange:state"},
        events=tuple((t, v) for t, _, v in sorted(rows.get("events", []), key=lambda row: row[0])),
        entities=frozenset(entities),
    )


def _chunks(path: Path) -> list[Any]:
    if not path.is_file():
        raise RecordingError(
            f"cannot read the recording {path}: {'it is a folder' if path.is_dir() else 'no such file'}"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a file cut short has no footer; that is no news to whoever reads it
            return list(RrdReader(path).stream().to_chunks())
    except Exception as error:  # Rerun raises several kinds
        reason = str(error).splitlines()[0].removeprefix(f"Failed to read RRD file at {path}: ")
        raise RecordingError(f"cannot read the recording {path}: {reason}") from error


def _series(rows: list[tuple[int, float, Any]]) -> Series:
    rows = sorted(rows, key=lambda row: row[0])
    ticks, times, values = zip(*rows, strict=True)
    return Series(np.array(ticks, dtype=np.int64), np.array(times), np.array(values))


def _lane(rows: list[tuple[int, float, Any]]) -> Lane:
    rows = sorted(rows, key=lambda row: row[0])
    return Lane(tuple(row[0] for row in rows), tuple(row[2] for row in rows))
