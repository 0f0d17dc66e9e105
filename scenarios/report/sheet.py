"""A table as values with units, and its three forms: CSV in full precision, Markdown and HTML for reading."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

NONE = "–"  # what is not there


@dataclass(frozen=True, slots=True)
class Form:
    """How a kind of value is written."""

    show: Callable[[Any], str]
    parts: tuple[str, ...] = ("",)  # suffixes of its CSV columns
    number: bool = True  # set to the right


def _pair(value: tuple[float, float], digits: int, between: str) -> str:
    first, second = value
    if math.isnan(second):
        return f"{first:.{digits}f}"
    return f"{first:.{digits}f}{between}{second:.{digits}f}"


def _p(value: float) -> str:
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


TEXT = Form(str, number=False)
COUNT = Form(lambda v: f"{v:,}")
WHOLE = Form(lambda v: f"{v:.0f}")
ONE = Form(lambda v: f"{v:.1f}")  # one decimal place
TWO = Form(lambda v: f"{v:.2f}")  # two
DIGEST = Form(lambda v: v[:16], number=False)
SHORT = Form(lambda v: f"{v:.3g}")
SIGNED = Form(lambda v: f"{v:+.2f}")
SPREAD = Form(lambda v: _pair(v, 1, " ± "), ("_mean", "_sd"))
RANGE = Form(lambda v: _pair(v, 0, "–"), ("_low", "_high"))
BOUNDS = Form(lambda v: f"{v[0]:.3g} – {v[1]:.3g}", ("_low", "_high"))
CHANGE = Form(lambda v: _pair(v, 2, " → "), ("_default", "_learned"))
ERRORS = Form(lambda v: _pair(v, 2, ", "), ("_v", "_w"))
P = Form(_p)


@dataclass(frozen=True, slots=True)
class Column:
    """One column."""

    name: str  # in the CSV
    title: str  # for readers, with the unit
    form: Form = TEXT


@dataclass(frozen=True, slots=True)
class Sheet:
    """A table. The rows hold a value per column; None where there is none."""

    name: str  # of its CSV file, and of its place in a README
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Any, ...], ...]
    note: str = ""
    heat: bool = False  # colour the numbers as percentages

    def shown(self) -> list[list[str]]:
        """The cells as people read them."""
        return [[_shown(c, value) for c, value in zip(self.columns, row, strict=True)] for row in self.rows]

    def csv(self) -> str:
        """All values, in columns of one number each."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([c.name + part for c in self.columns for part in c.form.parts])
        for row in self.rows:
            cells: list[Any] = []
            for column, value in zip(self.columns, row, strict=True):
                parts = value if isinstance(value, tuple) else (value,) * len(column.form.parts)
                cells += [_plain(part) for part in parts]
            writer.writerow(cells)
        return text.getvalue()

    def markdown(self) -> str:
        """A pipe table, without its caption."""
        lines = [[c.title for c in self.columns], ["---:" if c.form.number else "---" for c in self.columns]]
        lines += self.shown()
        lines[0], *rest = [[_pipes(cell) for cell in line] if k != 1 else line for k, line in enumerate(lines)]
        return "\n".join(f"| {' | '.join(line)} |" for line in [lines[0], *rest])

    def html(self) -> str:
        """A figure with caption; wide ones scroll by themselves."""
        head = "".join(_cell("th", c.title, c.form.number, ' scope="col"') for c in self.columns)
        head = head.replace("_", "_<wbr>")
        body = []
        for row, cells in zip(self.rows, self.shown(), strict=True):
            line = [_cell("th", cells[0], self.columns[0].form.number, ' scope="row"')]
            for column, value, cell in zip(self.columns[1:], row[1:], cells[1:], strict=True):
                line.append(_cell("td", cell, column.form.number, self._colour(value)))
            body.append(f"<tr>{''.join(line)}</tr>")
        note = f'<p class="note">{escape(self.note)}</p>' if self.note else ""
        kind = ' class="heat"' if self.heat else ""
        table = f"<table{kind}><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"
        return (
            f'<figure class="sheet" id="{escape(self.name)}"><figcaption>{escape(self.caption)}</figcaption>'
            f'<div class="scroll">{table}</div>{note}</figure>'
        )

    def _colour(self, value: Any) -> str:
        """The background of a percentage; the ink stays legible on it in the light and in the dark."""
        if not self.heat or not isinstance(value, (int, float)) or math.isnan(value):
            return ""
        return f' style="background:rgba(213,94,0,{0.85 * min(max(value, 0.0), 100.0) / 100.0:.2f})"'


def _shown(column: Column, value: Any) -> str:
    first = value[0] if isinstance(value, tuple) else value
    if first is None or (isinstance(first, float) and math.isnan(first)):
        return NONE
    return column.form.show(value)


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.9g}"
    return "" if value is None else value


def _pipes(text: str) -> str:
    return " ".join(text.split()).replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;").replace("`", "\\`")


def _cell(tag: str, text: str, number: bool, more: str) -> str:
    kind = ' class="n"' if number else ""
    return f"<{tag}{kind}{more}>{escape(text)}</{tag}>"


def matrix(name: str, caption: str, methods: Sequence[str], cells: dict[tuple[str, str], Any], note: str = "") -> Sheet:
    """Methods against methods; a heat map when the cells are numbers."""
    numbers = not any(isinstance(value, str) for value in cells.values())
    form = WHOLE if numbers else TEXT
    columns = (Column("worse", "row worse than column"), *(Column(method, method, form) for method in methods))
    rows = tuple((row, *(cells.get((row, column)) for column in methods)) for row in methods)
    return Sheet(name, caption, columns, rows, note, heat=numbers)
