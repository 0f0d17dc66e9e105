"""What every surface says about a session in words, and what Studio draws into the scene: values, no library."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from scenarios.keyboard import CAMERA, KEY_HELP
from scenarios.teleop_view import Mode, View
from twin.records import Array

Rgba = tuple[float, float, float, float]
Stroke = tuple[Array, Array, float, Rgba]  # from, to (3,) world [m], radius [m], colour

WHITE: Final[Rgba] = (0.93, 0.94, 0.96, 1.0)
NAMES: Final[Rgba] = (0.62, 0.74, 0.86, 1.0)  # of the names to the left
GREY: Final[Rgba] = (0.80, 0.82, 0.86, 1.0)
MODE_COLOURS: Final[dict[Mode, Rgba]] = {
    Mode.PLANNER: (0.45, 0.80, 1.00, 1.0),
    Mode.NUDGE: (1.00, 0.82, 0.40, 1.0),
    Mode.INTERVENTION: (1.00, 0.45, 0.42, 1.0),
    Mode.REWIND: (0.78, 0.62, 1.00, 1.0),
    Mode.WAITING: (0.78, 0.62, 1.00, 1.0),
    Mode.ENDED: (0.62, 0.86, 0.55, 1.0),
}
PATH: Final[Rgba] = (0.20, 0.62, 1.00, 0.9)
SCAN: Final[Rgba] = (0.95, 0.25, 0.20, 1.0)
TRAIL: Final[Rgba] = (1.00, 0.55, 0.20, 1.0)
PATH_STRIDE: Final = 0.25  # [m] between the points of drawn lines; every stroke costs the browser time
TRAIL_STRIDE: Final = 0.1  # [m]
SCAN_EVERY: Final = 6  # beams per dot


@dataclass(frozen=True, slots=True)
class Line:
    """One line of the panel."""

    text: str
    rgba: Rgba = WHITE
    name: str = ""  # to the left
    column: float = 96.0  # [px] where the text begins after a name
    rule: bool = False  # a line above it
    scale: float = 1.0


def facts(view: View) -> list[tuple[str, str]]:
    """(name, value) of what a driver wants to know."""
    frame, sight = view.frame, view.frame.sight
    rows = [
        ("world", view.world.name),
        ("time", f"{frame.elapsed:.1f} s of {view.world.rules.time_limit:.0f} s"),
        ("speed", f"{frame.twist.v:+.2f} m/s   {frame.twist.w:+.2f} rad/s"),
    ]
    if sight is not None:
        tries = f", {sight.recoveries} recoveries" if sight.recoveries else ""
        rows.append(("driver", f"{sight.state}{tries}"))
        if sight.confidence is not None:
            rows.append(("context", f"{sight.context}, confidence {sight.confidence:.2f}"))
    rows.append(("outcome", "none yet" if frame.outcome is None else frame.outcome.value.replace("_", " ")))
    if view.label is not None:
        rows.append(("recording", f"{view.label}, {view.recorded:.1f} s"))
    rows.append(("saved", f"{len(view.saved)}" + (f": {' '.join(view.saved[-8:])}" if view.saved else "")))
    return rows


def headline(view: View) -> str:
    """Who drives, in capitals."""
    if view.mode is Mode.REWIND:
        return f"REWINDING  {view.rewound:.1f} s back"
    return view.mode.value.upper()


def panel_lines(view: View) -> Iterator[Line]:
    """The panel of a graphical surface."""
    yield Line(headline(view), MODE_COLOURS[view.mode], scale=1.25)
    yield Line(view.message, WHITE)
    for index, (name, value) in enumerate(facts(view)):
        yield Line(value, WHITE, name, rule=index == 0)
    for index, (key, what) in enumerate((*KEY_HELP, (CAMERA.upper(), "camera: behind or above"))):
        yield Line(what, GREY, key, 140.0, rule=index == 0)


def strokes(view: View) -> Iterator[Stroke]:
    """The lines in the scene: path, intervention and scan."""
    sight = view.frame.sight
    if sight is not None:
        yield from _polyline(_thinned(sight.path_points(), PATH_STRIDE), 0.03, 0.018, PATH)
        points = sight.scan_points()[::SCAN_EVERY]
        for x, y in points[np.hypot(points[:, 0] - view.frame.pose.x, points[:, 1] - view.frame.pose.y) < 8.0]:
            at = np.array([x, y, 0.305])  # [m] the scan's height: ride height and mount
            yield at, at + np.array([0.0, 0.0, 0.001]), 0.016, SCAN
    yield from _polyline(_thinned(view.trail, TRAIL_STRIDE), 0.045, 0.025, TRAIL)


def _thinned(points: Array, stride: float) -> Array:
    """Points (n, 2) [m] no closer than `stride` [m] to each other, and the last one."""
    if len(points) < 3:
        return points
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    first = np.unique(np.searchsorted(along, np.arange(0.0, along[-1], stride)))
    kept: Array = points[np.append(first, len(points) - 1)]
    return kept


def _polyline(points: Array, height: float, radius: float, rgba: Rgba) -> Iterator[Stroke]:
    lifted = np.column_stack([points, np.full(len(points), height)])
    for a, b in pairwise(lifted):
        yield a, b, radius, rgba
