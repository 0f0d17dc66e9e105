"""Where on a course which context was in force, from above."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.collections import LineCollection

from scenarios.report.drives import Trail
from scenarios.report.figures.floor_plan import draw_ends, draw_obstacles, extent
from scenarios.report.figures.style import context_colours, drawing, panel
from scenarios.report.picture import Panel
from twin.world import World

WIDTH = 5.4  # [in]
SHORT = 1.2  # [m] of a context that gets no label


def map_panel(world: World, trail: Trail) -> Panel:
    """The world, and the drive coloured by context."""
    size = np.ptp(np.concatenate([extent(world), trail.points]), axis=0) + 1.0
    labels = sorted(set(trail.contexts), key=lambda name: (name != "default", name))
    colours = context_colours(labels)
    with drawing(WIDTH, float(np.clip((WIDTH - 0.6) * size[1] / size[0], 1.2, 6.0)) + 0.8) as (figure, axes):
        draw_obstacles(axes, world)
        points = trail.points
        lines: Any = np.stack([points[:-1], points[1:]], axis=1)
        for start, end, label in _stretches(trail):
            style: dict[str, Any] = {"colors": colours[label], "linewidths": 2.0 if label == "default" else 3.2}
            axes.add_collection(LineCollection(lines[start:end], capstyle="round", **style))
        for label in labels:
            _name(axes, trail, label, colours[label])
        draw_ends(axes, world)
        handles = [axes.plot([], [], color=colours[label], linewidth=3)[0] for label in labels]
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=8, handlelength=1.2)
        title = f"{world.name}, {trail.row.method}, run {trail.row.run}: contexts along the drive"
        return panel(figure, f"contexts-{trail.number}", title)


def _stretches(trail: Trail) -> list[tuple[int, int, str]]:
    """(first, past the last, context) of the pieces between two points with the same context."""
    found: list[tuple[int, int, str]] = []
    for k, label in enumerate(trail.contexts[:-1]):
        if found and found[-1][2] == label:
            found[-1] = (found[-1][0], k + 1, label)
        else:
            found.append((k, k + 1, label))
    return found


def _name(axes: Any, trail: Trail, label: str, colour: str) -> None:
    """A context's name beside its longest stretch."""
    stretches = [(start, end) for start, end, name in _stretches(trail) if name == label]
    steps = np.hypot(*np.diff(trail.points, axis=0).T)
    start, end = max(stretches, key=lambda s: float(steps[s[0] : s[1]].sum()), default=(0, 0))
    if float(steps[start:end].sum()) < SHORT or label == "default":
        return
    middle = trail.points[(start + end) // 2]
    axes.annotate(label, middle, xytext=(5, 5), textcoords="offset points", color=colour, weight="bold", size=9)
