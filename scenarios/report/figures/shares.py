"""Figures of shares: how trials ended, how confident the classifiers were."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from scenarios.report.facts import Experiment, Facts
from scenarios.report.figures.style import OUTCOME_COLOURS, brief, drawing, label_ends, method_style, panel
from scenarios.report.picture import INK, Panel, Picture
from scenarios.statistics import OUTCOMES, outcome_shares
from scenarios.store import CONFIDENCE_BINS

LEGIBLE = 0.07  # share below which a bar is too short for its number


def outcomes_picture(facts: Facts) -> Picture:
    """How the trials of every method ended, a panel per experiment."""
    panels = []
    for experiment in facts.experiments:
        with drawing(3.6, 1.0 + 0.27 * len(experiment.methods)) as (figure, axes):
            for height, method in enumerate(experiment.methods):
                shares = outcome_shares(row for row in experiment.rows if row.method == method)
                left = 0.0
                for outcome in OUTCOMES:
                    share = 0.0 if np.isnan(shares[outcome]) else shares[outcome]
                    axes.barh(height, share, left=left, color=OUTCOME_COLOURS[outcome], height=0.74)
                    if share >= LEGIBLE:
                        number = f"{100.0 * share:.0f}"
                        axes.text(left + share / 2, height, number, ha="center", va="center", color="black", size=8)
                    left += share
            axes.set_yticks(range(len(experiment.methods)), [brief(m) for m in experiment.methods])
            axes.set_xticks(np.linspace(0, 1, 6), [f"{k}" for k in range(0, 101, 20)])
            axes.set_xlim(0, 1)
            axes.set_ylim(len(experiment.methods) - 0.5, -0.5)
            axes.set(xlabel="share of trials [%]", title=experiment.title)
            axes.grid(False)
            axes.tick_params(axis="y", length=0)
            handles = [axes.barh(0, 0, color=OUTCOME_COLOURS[name]) for name in OUTCOMES]
            names = [name.replace("_", " ") for name in OUTCOMES]
            small = {"fontsize": 8, "handlelength": 0.9, "columnspacing": 1.0}
            figure.legend(handles, names, loc="outside lower center", ncols=4, **small)
            panels.append(panel(figure, f"{experiment.key}-outcomes", f"outcomes: {experiment.title}"))
    return Picture("outcomes", "How the trials ended.", tuple(panels))


def confidence_picture(facts: Facts, thresholds: Mapping[str, float], usual: float) -> Picture | None:
    """Histograms of the classifiers' confidence; `thresholds`: method -> eps_u, `usual` elsewhere. None without any."""
    panels: list[Panel] = []
    for experiment in facts.experiments:
        for worlds, title in _scenes(experiment):
            counts = _counts(experiment, worlds)
            if not counts:
                continue
            with drawing(3.6, 2.5) as (figure, axes):
                ends = []
                edges = np.linspace(0, 1, CONFIDENCE_BINS + 1)
                for method, found in counts.items():
                    share = 100.0 * found / found.sum()
                    style = method_style(method, experiment.methods)
                    axes.stairs(share, edges, linewidth=1.6, color=style["color"], linestyle=style["linestyle"])
                    ends.append((method, 1.0, float(share[-1]), style["color"]))
                for threshold in sorted({thresholds.get(method, usual) for method in counts}):
                    axes.axvline(threshold, color=INK, linewidth=0.8, linestyle=":")
                    top = axes.get_ylim()[1]
                    axes.text(threshold, top, f"ε_u = {threshold:g} ", ha="right", va="top", size=8)
                axes.set(xlabel="confidence u", ylabel="share of ticks [%]", title=title)
                axes.set_xlim(0, 1)
                axes.set_ylim(bottom=0)
                figure.canvas.draw()
                label_ends(axes, ends, 0.09)
                panels.append(panel(figure, f"confidence-{len(panels)}", f"confidence: {title}"))
    if not panels:
        return None
    caption = "Confidence of the classifiers in all ticks. Left of the dotted line a method with +c takes the default."
    return Picture("confidence", caption, tuple(panels))


def _scenes(experiment: Experiment) -> list[tuple[Sequence[str], str]]:
    """Courses one by one, other worlds together."""
    if experiment.is_courses:
        return [((world,), world) for world in experiment.worlds]
    return [(experiment.worlds, experiment.title)]


def _counts(experiment: Experiment, worlds: Sequence[str]) -> dict[str, np.ndarray]:  # type: ignore[type-arg]
    """Method -> ticks per bin, for the methods that decide by confidence, or for all where none does."""
    counts: dict[str, np.ndarray] = {}  # type: ignore[type-arg]
    for row in experiment.rows:
        if row.confidence is not None and row.world in worlds and len(row.confidence) == CONFIDENCE_BINS:
            counts[row.method] = counts.get(row.method, np.zeros(CONFIDENCE_BINS)) + np.array(row.confidence)
    counts = {m: counts[m] for m in experiment.methods if m in counts and counts[m].sum() > 0}
    return {m: found for m, found in counts.items() if m.endswith("+c")} or counts
