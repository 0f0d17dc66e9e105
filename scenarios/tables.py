"""Tables on stdout whose numbers and units survive narrow terminals."""

from __future__ import annotations

from rich.console import Console
from rich.measure import Measurement
from rich.table import Column, Table
from rich.text import Text

WORDS = 6  # characters more than the least that rich would give the column that wraps, or it is read downwards


def plain_table(*columns: str | Column) -> Table:
    """An empty table in which only the last column wraps. Headers keep their units: rich takes "[s]" for a style."""
    table = Table(*columns)
    for column in table.columns:
        column.header = Text(str(column.header).replace(" [", "\n["))
        column.overflow = "fold"  # never "…", which not every terminal has
        column.no_wrap = column.no_wrap or column is not table.columns[-1]
    return table


def print_table(table: Table) -> None:
    """Print it, in too narrow a terminal wider than that: lines break there, but no number loses its end."""
    console = Console()
    everything = console.options.update(max_width=1000)
    least = Measurement.get(console, everything, table).minimum + WORDS
    console.width = max(console.width, least)
    console.print(table)
