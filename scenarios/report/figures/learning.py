"""Learning curves: Eq. 1 over the search, the classifier's loss over its training."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

from scenarios.report.figures.style import context_colours, drawing, label_ends, method_style, panel
from scenarios.report.picture import Panel, Picture

Curves = Mapping[str, list[tuple[float, float]]]


def learning_picture(fits: Curves, classifiers: Curves) -> Picture | None:
    """One panel for all searches, one for all classifiers; None without any curve."""
    panels = []
    if fits:
        colours = context_colours(tuple(fits))
        panels.append(_lines("fits", fits, colours, "evaluations", "best loss of Eq. 1", steps=True))
    if classifiers:
        colours = {name: method_style(name, tuple(classifiers))["color"] for name in classifiers}
        panels.append(_lines("classifiers", classifiers, colours, "steps", "validation loss", steps=False))
    if not panels:
        return None
    caption = "Learning curves: the search for every context's parameters, and the training of the classifiers."
    return Picture("learning", caption, tuple(panels))


def _lines(name: str, curves: Curves, colours: Mapping[str, str], x: str, y: str, steps: bool) -> Panel:
    with drawing(3.6, 2.7) as (figure, axes):
        ends = []
        last = max((points[-1][0] for points in curves.values() if points), default=1.0)
        for key, points in curves.items():
            if not points:
                continue
            xy = np.array([*points, (last, points[-1][1])] if steps else points)
            style = "steps-post" if steps else "default"
            axes.plot(*xy.T, color=colours[key], linewidth=1.5, drawstyle=style)
            ends.append((key, float(xy[-1, 0]), float(xy[-1, 1]), colours[key]))
        if all(value > 0.0 for points in curves.values() for _, value in points):
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set(xlabel=x, ylabel=y)
        figure.canvas.draw()
        label_ends(axes, ends, 0.085)
        return panel(figure, f"learning-{name}", f"{y} over {x}")
