"""The terminal's picture: a small top-down map and a status panel, as lines of text. Pure values, no terminal."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scenarios.keyboard import KEY_HELP
from scenarios.surfaces.overlay import facts, headline
from scenarios.teleop_view import Mode, View
from twin.free_space import FreeSpace, free_space
from twin.records import Array
from twin.world import World

CELL: Final = (0.12, 0.24)  # [m] width and height of a character; letters are twice as high as wide
PANEL: Final = 53  # columns
ARROWS: Final = "→↗↑↖←↙↓↘"
COLOURS: Final = {  # ANSI SGR by what a character shows
    "#": "90", "·": "31", "~": "34", "o": "33", "G": "32;1", "@": "1;33",
}  # fmt: skip
MODES: Final = {
    Mode.PLANNER: "1;36", Mode.NUDGE: "1;33", Mode.INTERVENTION: "1;31",
    Mode.REWIND: "1;35", Mode.WAITING: "1;35", Mode.ENDED: "1;32",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Chart:
    """The true obstacles of a world, for drawing."""

    free: FreeSpace | None  # None: the world is too large for one

    @staticmethod
    def of(world: World) -> Chart:
        """The chart of a world; takes a moment."""
        try:
            return Chart(free_space(world))
        except ValueError:
            return Chart(None)

    def characters(self, view: View, columns: int, rows: int) -> NDArray[np.str_]:
        """(rows, columns) the map round the robot, north (world y) up: # obstacle, · scan, ~ path, o driven, G goal."""
        pose = view.frame.pose
        width, height = CELL
        x = pose.x + (np.arange(columns) - columns // 2) * width
        y = pose.y + (rows // 2 - np.arange(rows)) * height
        picture = np.full((rows, columns), " ")
        if self.free is not None:
            centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
            picture[(self.free.at(centres) <= height / 2).reshape(rows, columns)] = "#"

        def mark(points: Array, sign: str) -> None:
            column = np.round((points[:, 0] - x[0]) / width).astype(int)
            row = np.round((y[0] - points[:, 1]) / height).astype(int)
            inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
            picture[row[inside], column[inside]] = sign

        if view.frame.sight is not None:
            mark(view.frame.sight.path_points(), "~")
            mark(view.frame.sight.scan_points(), "·")
        mark(view.trail, "o")
        goal = view.world.goal
        mark(np.array([[goal.x, goal.y]]), "G")
        picture[rows // 2, columns // 2] = ARROWS[round(pose.yaw / (math.tau / 8)) % 8]
        return picture


def picture(view: View, chart: Chart, columns: int, rows: int, colour: bool = True) -> list[str]:
    """At most `rows` lines of at most `columns` characters: map to the left, panel to the right (or above)."""
    panel = _panel(view)
    wide = columns >= PANEL + 30
    map_columns = columns - PANEL - 1 if wide else columns
    map_rows = rows if wide else max(0, rows - 4)
    characters = chart.characters(view, max(1, map_columns), max(1, map_rows))
    lines = [_paint(row, colour) for row in characters]
    if not wide:
        return [*(_styled(text, style, columns, colour) for text, style in panel[:4]), *lines][:rows]
    shown = [*panel, *[("", "")] * rows][:rows]
    right = [_styled(text, style, PANEL, colour) for text, style in shown]
    return [f"{line} {side}" for line, side in zip(lines, right, strict=True)]


def _panel(view: View) -> list[tuple[str, str]]:
    """(text, SGR) of the lines of the panel."""
    message = [view.message[k : k + PANEL] for k in range(0, min(len(view.message), 2 * PANEL), PANEL)]
    return [
        (headline(view), MODES[view.mode]),
        *((line, "1") for line in [*message, ""][:2]),
        *((f"{name:<10} {value}", "") for name, value in facts(view)),
        ("", ""),
        *((f"{key:<17} {what}", "2") for key, what in KEY_HELP),
    ]


def _styled(text: str, style: str, width: int, colour: bool) -> str:
    text = "".join(c if c.isprintable() else "?" for c in text[:width])  # a world's name may hold anything
    return f"\x1b[{style}m{text}\x1b[0m" if colour and style and text else text


def _paint(row: NDArray[np.str_], colour: bool) -> str:
    """A row of the map with as few colour changes as possible."""
    if not colour:
        return "".join(row)
    parts, style = [], ""
    for character in row.tolist():
        wanted = COLOURS["@"] if character in ARROWS else COLOURS.get(character, style)
        if wanted != style:
            parts.append(f"\x1b[0m\x1b[{wanted}m")
            style = wanted
        parts.append(character)
    return "".join(parts) + "\x1b[0m"
