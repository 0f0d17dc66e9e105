"""The colours of a recording: one dark, calm scene in which only what the robot does is bright."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin.records import DEFAULT_CONTEXT, Array, Bytes

RGB = tuple[int, int, int]

BACKGROUND: RGB = (17, 21, 28)
FLOOR: RGB = (27, 33, 42)
GRID: RGB = (52, 61, 74)
START: RGB = (138, 150, 166)
GOAL: RGB = (99, 230, 150)
SCAN: RGB = (255, 107, 107)
GLOBAL_PATH: RGB = (92, 184, 255)
CHOSEN_ARC: RGB = (255, 245, 157)
ILLEGAL_ARC: RGB = (96, 40, 46)
CONTACT: RGB = (255, 59, 92)

OBSTACLES: dict[str, RGB] = {
    "cylinder": (122, 134, 152),
    "box": (134, 142, 156),
    "wall": (108, 118, 134),
    "cardboard": (176, 137, 94),
    "furniture": (150, 110, 84),
    "mesh": (122, 134, 152),
}

CONTEXTS: dict[str, RGB] = {  # the hues of the report's (Okabe and Ito), lighter
    DEFAULT_CONTEXT: (150, 162, 182),
    "A1": (243, 114, 44),
    "A2": (242, 186, 60),
    "B1": (52, 138, 222),
    "B2": (126, 204, 244),
    "D1": (40, 190, 142),
    "D2": (226, 150, 192),
}

STATES: dict[str, RGB] = {
    "controlling": (52, 104, 92),
    "planning": (70, 112, 170),
    "clearing": (176, 132, 60),
    "conservative_reset": (222, 122, 62),
    "aggressive_reset": (222, 122, 62),
    "rotate_recovery": (214, 86, 86),
    "aborted": (150, 40, 60),
}

PHASES: dict[str, RGB] = {  # of an intervention
    "default": CONTEXTS[DEFAULT_CONTEXT],
    "rewound": (176, 132, 60),
    "demonstration": (190, 84, 168),
}

MEASURED: RGB = (92, 184, 255)
COMMANDED: RGB = (255, 214, 102)
HUMAN: RGB = (255, 134, 229)  # also of the trail where a person drives
APPLIED: RGB = (74, 86, 104)
THRESHOLD: RGB = (255, 214, 102)
CLEARANCE: RGB = (99, 230, 150)
CONFIDENCE: RGB = (164, 133, 255)

PARAMETERS: tuple[RGB, ...] = (
    (92, 184, 255),
    (255, 169, 77),
    (92, 184, 255),
    (255, 169, 77),
    (255, 120, 117),
    (81, 207, 102),
    (164, 133, 255),
    (255, 214, 102),
)

_SPARE: tuple[RGB, ...] = ((192, 160, 120), (130, 201, 30), (34, 184, 207), (250, 176, 5), (116, 143, 252))


def obstacle_colour(style: str) -> RGB:
    """The colour of an obstacle by its style; an unknown style looks like a box."""
    return OBSTACLES.get(style, OBSTACLES["box"])


def context_colour(context: str) -> RGB:
    """The colour of a context; unknown labels get one of a few spare colours, always the same."""
    return CONTEXTS.get(context) or _SPARE[sum(context.encode()) % len(_SPARE)]


def dimmed(context: str) -> RGB:
    """A context's colour, half way to the floor: for the outline of the segment built to provoke it."""
    r, g, b = ((2 * c + f) // 3 for c, f in zip(context_colour(context), FLOOR, strict=True))
    return (r, g, b)


def _costmap_colours() -> Bytes:
    """(256, 4) RGBA by cost byte: free is clear, inflation a violet haze, inscribed and lethal stand out."""
    table = np.zeros((256, 4), dtype=np.uint8)
    haze = np.linspace(0.0, 1.0, 252)  # cost 1..252: inside the inflation radius
    low, high = np.array([64, 70, 150]), np.array([120, 76, 160])
    table[1:253, :3] = low + haze[:, None] * (high - low)
    table[1:253, 3] = 25 + 70 * haze
    table[253] = (146, 78, 150, 120)  # the robot's centre here is in collision
    table[254] = (255, 160, 122, 200)  # an obstacle was seen here
    table[255] = (60, 66, 76, 90)  # unknown
    table.setflags(write=False)
    return table


COSTMAP = _costmap_colours()


def arc_colours(costs: Array) -> NDArray[np.uint8]:
    """(n, 3) RGB of candidate arcs by cost (n,): the cheapest bright green, the dearest dull blue, illegal dim red."""
    legal = costs >= 0.0
    colours = np.empty((len(costs), 3), dtype=np.uint8)
    colours[~legal] = ILLEGAL_ARC
    if legal.any():
        # Ranks, not values: one arc of enormous cost must not make the others look alike.
        rank = np.argsort(np.argsort(costs[legal], kind="stable"), kind="stable") / max(int(legal.sum()) - 1, 1)
        cheap, dear = np.array([120, 235, 170]), np.array([48, 74, 112])
        colours[legal] = cheap + np.sqrt(rank)[:, None] * (dear - cheap)
    return colours
