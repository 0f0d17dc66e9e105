"""A picture of the report as data: SVG panels under one caption."""

from __future__ import annotations

from dataclasses import dataclass

INK = "#0a0b0c"  # stands in an SVG for the colour of the text around it


@dataclass(frozen=True, slots=True)
class Panel:
    """One drawing."""

    name: str  # of its file
    title: str  # in words, for those who cannot see it
    svg: str  # with INK where the surrounding text's colour belongs


@dataclass(frozen=True, slots=True)
class Picture:
    """One figure."""

    name: str
    caption: str
    panels: tuple[Panel, ...]
    wide: bool = False  # one panel per line
