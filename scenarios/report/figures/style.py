"""How the report draws: colours that colour-blind readers can tell apart, direct labels, SVG that fits any page."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from html import escape
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from scenarios.report.picture import INK, Panel
from scenarios.statistics import Array

RC = {
    "svg.fonttype": "none",  # text stays text
    "text.parse_math": False,  # names come from files
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "grid.alpha": 0.15,
    "grid.linewidth": 0.6,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), INK),
    "grid.color": INK,
}

# Okabe and Ito's colours. Methods: colour = types of interventions, dashed = without the confidence measure.
ORANGE, SKY, GREEN, BLUE, RED, PURPLE, GREY = (
    *("#e69f00", "#56b4e9", "#009e73", "#0072b2", "#d55e00", "#cc79a7"),
    "#8a8a8a",
)
_TYPES = {"dwa": INK, "A": RED, "A+B": BLUE, "A+B+D": GREEN}
_OTHERS = (PURPLE, ORANGE, SKY)
CONTEXTS = {"default": GREY, "A1": RED, "A2": ORANGE, "B1": BLUE, "B2": SKY, "D1": GREEN, "D2": PURPLE}
OUTCOME_COLOURS = {"reached": GREEN, "collided": RED, "timed_out": ORANGE, "aborted": PURPLE, "error": GREY}


LONGEST = 18  # characters of a name in a drawing


def method_style(method: str, methods: Sequence[str]) -> dict[str, Any]:
    """Colour and line of a method, the same in all figures."""
    types = method.removesuffix("+c")
    strangers = sorted({m.removesuffix("+c") for m in methods} - set(_TYPES))
    colour = _TYPES[types] if types in _TYPES else _OTHERS[strangers.index(types) % len(_OTHERS)]
    plain = method == "dwa" or method.endswith("+c")
    return {"color": colour, "linestyle": "-" if plain else (0, (3.5, 1.6))}


def context_colours(labels: Sequence[str]) -> dict[str, str]:
    """Colour per context; strangers get what is left, in order."""
    spare = [c for c in (ORANGE, SKY, GREEN, BLUE, RED, PURPLE) if c not in {CONTEXTS.get(label) for label in labels}]
    strangers = [label for label in labels if label not in CONTEXTS]
    given = {label: (spare or [PURPLE])[k % max(1, len(spare))] for k, label in enumerate(strangers)}
    return {label: CONTEXTS.get(label) or given[label] for label in labels}


@contextmanager
def drawing(width: float, height: float) -> Iterator[tuple[Figure, Any]]:
    """A figure with one pair of axes in this style; sizes in inches."""
    with mpl.rc_context(RC):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasSVG(figure)
        yield figure, figure.add_subplot()


def panel(figure: Figure, name: str, title: str) -> Panel:
    """The figure as SVG that takes the width it is given. Call inside `drawing`."""
    data = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(data, format="svg", transparent=True, metadata={"Date": None})
    text = data.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->\n?", "", text, flags=re.DOTALL)
    text = re.sub(r"font: ([^;\"]*?)'[^;\"]*", r"font: \1sans-serif", text)  # the page's own type
    text = re.sub(r'(\bid="|url\(#|href="#)', lambda found: f"{found.group(1)}{name}-", text)  # many SVGs on one page
    text = re.sub(r'^<svg ([^>]*?)width="[^"]*"', rf'<svg \1role="img" aria-label="{escape(title)}"', text)
    text = re.sub(r'^<svg ([^>]*?) height="[^"]*"', r"<svg \1", text)
    return Panel(name, title, text)


def brief(name: str) -> str:
    """A name that leaves room for the drawing."""
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 1]}…"


def label_ends(axes: Any, ends: Sequence[tuple[str, float, float, str]], gap: float = 0.065) -> None:
    """Names (text, x, y, colour) to the right of their lines, pushed apart where they would cover each other.

    `gap`: smallest distance, as a share of the height of the axes.
    """
    transform = axes.transData + axes.transAxes.inverted()
    places = sorted(((float(transform.transform((x, y))[1]), text, x, y, c) for text, x, y, c in ends), reverse=True)
    heights = spread([place[0] for place in places], gap)
    for height, (_, text, x, y, colour) in zip(heights, places, strict=True):
        axes.annotate(
            brief(text),
            (x, y),
            xytext=(1.035, height),
            textcoords="axes fraction",
            color=colour,
            va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5, "shrinkA": 1, "shrinkB": 1, "alpha": 0.6},
        )


def spread(heights: Sequence[float], gap: float) -> list[float]:
    """Falling heights, moved as little as need be so that neighbours are `gap` apart (pool adjacent violators)."""
    blocks: list[list[float]] = []  # [sum of wanted positions, count]
    for k, height in enumerate(heights):
        blocks.append([height + k * gap, 1.0])
        while len(blocks) > 1 and blocks[-2][0] / blocks[-2][1] < blocks[-1][0] / blocks[-1][1]:
            total, count = blocks.pop()
            blocks[-1][0] += total
            blocks[-1][1] += count
    wanted = [total / count for total, count in blocks for _ in range(int(count))]
    return [float(value - k * gap) for k, value in enumerate(wanted)]


def running_median(values: Array, width: int) -> Array:
    """Of a window that shrinks at the ends and stays centred."""
    half, n = width // 2, len(values)
    reach = [min(half, k, n - 1 - k) for k in range(n)]
    return np.array([np.median(values[k - r : k + r + 1]) for k, r in enumerate(reach)])
