"""The report as data: sections of text, tables and pictures."""

from __future__ import annotations

from dataclasses import dataclass

from scenarios.report.picture import Picture
from scenarios.report.sheet import Sheet


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph; `kind` = note, missing or warning."""

    text: str
    kind: str = "note"


@dataclass(frozen=True, slots=True)
class Row:
    """Tables that stand side by side where there is room."""

    sheets: tuple[Sheet, ...]


Block = Text | Sheet | Row | Picture


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and what stands below it."""

    name: str
    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Report:
    """All of it."""

    title: str
    status: str
    finished: bool
    sections: tuple[Section, ...]
    files: tuple[Sheet, ...] = ()  # tables that are written as CSV only

    def sheets(self) -> dict[str, Sheet]:
        """All tables by name."""
        found: list[Sheet] = list(self.files)
        for section in self.sections:
            for block in section.blocks:
                found += [block] if isinstance(block, Sheet) else list(block.sheets) if isinstance(block, Row) else []
        return {sheet.name: sheet for sheet in found}
