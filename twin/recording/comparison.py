"""Two recordings of one world side by side: both in one file, each below a folder of its own, on one time line.

A Rerun viewer shows one recording at a time, and all recordings of an application in the same layout. So a comparison
is a recording of another application, whose entities are those of the two with `a/` and `b/` in front.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk, RrdReader

from twin.recording import palette, views
from twin.recording.palette import RGB
from twin.recording.plots import Lines
from twin.recording.reading import Recording, read_recording
from twin.recording.sink import RecordingError

APPLICATION = "appli_twin_comparison"
SIDES = ("a/", "b/")
COLOURS: tuple[RGB, RGB] = (palette.MEASURED, (255, 169, 77))
TOP_ASPECT = 2.2  # width over height of a top view, two of which share a 16:9 window
LEGEND = "speed [m/s]"  # the plot that has it; the others have the same colours
PLOTS = {  # plot: entities, of both recordings
    "speed [m/s]": ("odometry/v",),
    "clearance [m]": ("clearance",),
    "confidence": ("appli/confidence", "appli/threshold"),
    "max_vel_x [m/s]": ("params/max_vel_x",),
    "inflation_radius [m]": ("params/inflation_radius",),
}


def write_comparison(first: Path, second: Path, path: Path) -> None:
    """Write both recordings to `path`, side by side. Raises RecordingError unless both are of one world."""
    sources = (first, second)
    recordings = tuple(read_recording(source) for source in sources)
    worlds = [recording.metadata.get("world", "?") for recording in recordings]
    if worlds[0] != worlds[1]:
        raise RecordingError(f"{first} is of the world {worlds[0]}, {second} of {worlds[1]}; compare two of one world")
    stream = rr.RecordingStream(APPLICATION, recording_id=f"{first} {second}", send_properties=False)
    stream.save(path)
    names = _names(recordings)
    stream.send_recording_name(f"{worlds[0]} · {names[0]} and {names[1]}")
    box = (0.0, 0.0, 1.0, 1.0)
    both: list[Chunk] = []
    for side, source in zip(SIDES, sources, strict=True):
        chunks = _chunks(source)
        box = _floor(chunks) or box
        both += [chunk.with_entity_path(f"/{side}{chunk.entity_path.lstrip('/')}") for chunk in chunks]
    stream.send_blueprint(_layout(box, recordings, names))
    stream.send_chunks(sorted(both, key=first_tick))  # a slow viewer shows both sides as far as it has got
    stream.disconnect()


def first_tick(chunk: Chunk) -> int:
    """Where a chunk begins; what never changes comes before everything."""
    return int(chunk.to_record_batch().column("tick")[0].as_py()) if "tick" in chunk.timeline_names else -1


def _chunks(path: Path) -> list[Chunk]:
    """All that is drawn or plotted; what a recording says of itself stays behind."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        chunks: list[Chunk] = RrdReader(path).stream().to_chunks()
    return [chunk for chunk in chunks if not chunk.entity_path.startswith("/__")]


def _floor(chunks: list[Chunk]) -> views.Box | None:
    """What the floor covers [m]."""
    for chunk in chunks:
        if chunk.entity_path == "/world/floor":
            columns = chunk.to_record_batch()
            if "Mesh3D:vertex_positions" in columns.schema.names:
                corners = np.array(columns.column("Mesh3D:vertex_positions").to_pylist()[0])
                low, high = corners.min(axis=0), corners.max(axis=0)
                return float(low[0]), float(low[1]), float(high[0]), float(high[1])
    return None


def _names(recordings: tuple[Recording, ...]) -> tuple[str, str]:
    """What tells the two apart: the method, or else the seed."""
    facts = [recording.metadata for recording in recordings]
    methods = [fact.get("method") or fact.get("driver") or "?" for fact in facts]
    seeds = [fact.get("seed", "?") for fact in facts]
    a, b = methods if seeds[0] == seeds[1] else [f"{m}, seed {s}" for m, s in zip(methods, seeds, strict=True)]
    return (a, b) if a != b else (f"{a} (1)", f"{b} (2)")


def _layout(box: views.Box, recordings: tuple[Recording, ...], names: tuple[str, str]) -> rrb.Blueprint:
    """Each recording a column of scenes; below, lanes and plots of both."""
    titles = [f"{side.rstrip('/')}: {name}" for side, name in zip(SIDES, names, strict=True)]
    scenes = rrb.Horizontal(*(_column(box, side, title) for side, title in zip(SIDES, titles, strict=True)))
    plots = [
        views.plot(title, lines, styled=True, legend=title == LEGEND)
        for title, entities in PLOTS.items()
        if (lines := _lines(entities, recordings, titles))
    ]
    below = rrb.Horizontal(views.lanes(SIDES), *plots, column_shares=[1.4, *(1.0 for _ in plots)])
    return views.opened(rrb.Vertical(scenes, below, row_shares=[2.2, 1.0]))


def _column(box: views.Box, side: str, title: str) -> Any:
    beside = rrb.Horizontal(
        views.robot_view(side, f"robot {title}"), views.summary(side, f"run {title}"), column_shares=[1.1, 1.0]
    )
    return rrb.Vertical(views.top_view(box, TOP_ASPECT, side, title), beside, row_shares=[1.6, 1.0])


def _lines(entities: tuple[str, ...], recordings: tuple[Recording, ...], titles: list[str]) -> Lines:
    """The lines of one plot, of those recordings that have them."""
    lines = {}
    for side, recording, title, colour in zip(SIDES, recordings, titles, COLOURS, strict=True):
        for entity in entities:
            if entity in recording.scalars:
                threshold = entity == "appli/threshold"
                lines[side + entity] = ("threshold", palette.THRESHOLD, 1.2) if threshold else (title, colour, 1.6)
    return lines
