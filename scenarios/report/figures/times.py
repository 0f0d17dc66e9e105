"""Figures of traversal times: over worlds, on the courses, against difficulty."""

from __future__ import annotations

import numpy as np

from scenarios.agenda import PLAIN
from scenarios.report.difficulty import METRICS, Difficulty, mean_times
from scenarios.report.facts import Experiment
from scenarios.report.figures.style import brief, drawing, label_ends, method_style, panel, running_median
from scenarios.report.paper import COURSES
from scenarios.report.picture import INK, Picture
from scenarios.statistics import mean

FEW = 3  # worlds below which there is no curve to draw
BINS = 6  # of worlds, equally many in each
NOTABLE = (PLAIN, "A+c", "A+B+c")  # drawn against difficulty


def worlds_picture(experiment: Experiment) -> Picture | None:
    """Mean times over the worlds, sorted by the default's mean; None where too few worlds have all runs."""
    worlds = experiment.common_worlds()
    if len(worlds) < FEW:
        return None
    means = {m: np.array([mean(experiment.full[w, m]) for w in worlds]) for m in experiment.methods}
    first = PLAIN if PLAIN in means else experiment.methods[0]
    order = np.argsort(means[first], kind="stable")
    width = max(1, len(worlds) // 15)
    with drawing(5.4, 3.5) as (figure, axes):
        ends = []
        rank = np.arange(1, len(worlds) + 1)
        for method in experiment.methods:
            values = means[method][order]
            style = method_style(method, experiment.methods)
            bold = method == first
            if not bold:
                axes.plot(rank, values, ".", color=style["color"], markersize=2.2, alpha=0.28)
            line = values if bold else running_median(values, width)
            axes.plot(rank, line, linewidth=2.0 if bold else 1.5, **style)
            ends.append((method, float(rank[-1]), float(line[-1]), style["color"]))
        axes.set(xlabel=f"world, in the order of {first}'s mean time", ylabel="mean traversal time [s]")
        axes.set_xlim(1, len(worlds))
        axes.set_ylim(bottom=0)
        figure.canvas.draw()
        label_ends(axes, ends)
        drawn = panel(figure, f"{experiment.key}-worlds", "mean traversal times over worlds, a line per method")
    smooth = f"running medians over {width} worlds, with the worlds' means as dots" if width > 1 else "means"
    caption = (
        f"{experiment.title}: mean traversal time of {len(experiment.plan)} runs in each of {len(worlds)} worlds, "
        f"sorted by the mean of {first} (thick). The other methods: {smooth}. Dashed: without the confidence measure."
    )
    return Picture(f"{experiment.key}-worlds", caption, (drawn,), wide=True)


def courses_picture(experiment: Experiment) -> Picture:
    """Every run on every course, with the means and the paper's."""
    panels = []
    for world in experiment.worlds:
        with drawing(3.6, 0.75 + 0.33 * len(experiment.methods)) as (figure, axes):
            for height, method in enumerate(experiment.methods):
                times = experiment.times.get((world, method), np.empty(0))
                colour = method_style(method, experiment.methods)["color"]
                lift = 0.26 * (np.arange(len(times)) / max(1, len(times) - 1) - 0.5)  # so that equals stay visible
                axes.plot(times, height + lift, "o", color=colour, markersize=3.4, alpha=0.45, markeredgewidth=0)
                if len(times):
                    axes.plot([mean(times)] * 2, [height - 0.36, height + 0.36], color=colour, linewidth=2.2)
                if method in COURSES.get(world, {}):
                    paper = COURSES[world][method][0]
                    axes.plot(paper, height, "D", markerfacecolor="none", markeredgecolor=INK, markersize=5.5)
            axes.set_yticks(range(len(experiment.methods)), [brief(m) for m in experiment.methods])
            axes.set_ylim(len(experiment.methods) - 0.4, -0.6)
            axes.set(xlabel="traversal time [s]", title=world)
            axes.set_xlim(left=0)
            axes.grid(False, axis="y")
            axes.tick_params(axis="y", length=0)
            panels.append(panel(figure, f"{experiment.key}-{_slug(world)}-times", f"times on the course {world}"))
    caption = "Every run on the courses (dots), the mean (bar) and the paper's mean (diamond)."
    return Picture(f"{experiment.key}-times", caption, tuple(panels))


def difficulty_picture(experiment: Experiment, known: Difficulty) -> Picture | None:
    """Mean times against the five metrics; None where too few worlds are known."""
    methods = [m for m in NOTABLE if m in experiment.methods]
    times = {m: mean_times(experiment, known, m) for m in methods}
    times = {m: found for m, found in times.items() if len(found) >= FEW}
    if not times:
        return None
    panels = []
    for name, label in METRICS.items():
        with drawing(2.9, 2.4) as (figure, axes):
            ends = []
            for method, found in times.items():
                x = np.array([known.metrics[w][name] for w in found])
                y = np.array(list(found.values()))
                style = method_style(method, experiment.methods)
                axes.plot(x, y, ".", color=style["color"], markersize=3, alpha=0.3)
                line = _binned(x, y)
                axes.plot(*line, linewidth=1.8, marker="o", markersize=3, **style)
                ends.append((method, float(line[0][-1]), float(line[1][-1]), style["color"]))
            axes.set(xlabel=label, ylabel="mean time [s]")
            axes.set_ylim(bottom=0)
            figure.canvas.draw()
            label_ends(axes, ends, 0.09)
            panels.append(panel(figure, f"{experiment.key}-{name}", f"mean time against {label}"))
    caption = (
        f"{experiment.title}: mean traversal time against BARN's difficulty metrics; a dot per world, "
        f"lines through the means of {min(BINS, len(next(iter(times.values()))))} equal groups of worlds."
    )
    return Picture(f"{experiment.key}-difficulty", caption, tuple(panels))


def _binned(x: np.ndarray, y: np.ndarray) -> tuple[list[float], list[float]]:  # type: ignore[type-arg]
    """Means of groups of equally many, by x."""
    groups = np.array_split(np.argsort(x, kind="stable"), min(BINS, len(x)))
    return [float(np.mean(x[g])) for g in groups], [float(np.mean(y[g])) for g in groups]


def _slug(name: str) -> str:
    return "".join(c if c.isalnum() else "-" for c in name)
