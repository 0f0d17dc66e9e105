"""The report as Markdown, with its pictures as files beside it."""

from __future__ import annotations

import re

from scenarios.report.document import Block, Report, Row, Text
from scenarios.report.picture import INK
from scenarios.report.sheet import Sheet

PAPER, DARK = "white", "#1b1b1b"  # a picture file cannot know the page that it will stand on


def to_markdown(report: Report) -> str:
    """report.md."""
    lines = [f"# {report.title}", "", report.status + ".", ""]
    for section in report.sections:
        if section.blocks:
            lines += [f"## {section.title}", ""]
            for block in section.blocks:
                lines += [*_block(block), ""]
    return "\n".join(lines).rstrip() + "\n"


def _block(block: Block) -> list[str]:
    if isinstance(block, Text):
        return [_plain(block.text)]
    if isinstance(block, Sheet):
        link = f"[CSV](tables/{block.name}.csv)"
        return [
            f"**{_plain(block.caption)}** ({link})",
            "",
            block.markdown(),
            *(["", block.note] if block.note else []),
        ]
    if isinstance(block, Row):
        return [line for sheet in block.sheets for line in (*_block(sheet), "")][:-1]
    images = [f"![{_plain(panel.title)}](figures/{panel.name}.svg)" for panel in block.panels]
    return [" ".join(images), "", f"*{_plain(block.caption)}*"]


def _plain(text: str) -> str:
    """Names from files must not become markup."""
    return re.sub(r"([\\`*_<\[\]])", r"\\\1", " ".join(text.split()))


def svg_file(svg: str) -> str:
    """A panel as a file of its own, on white."""
    size = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg)
    width, height = size.groups() if size else ("100%", "100%")
    ground = f'<rect width="100%" height="100%" fill="{PAPER}"/>'
    svg = re.sub(r"^<svg ([^>]*)>", rf'<svg width="{width}pt" height="{height}pt" \1>{ground}', svg, count=1)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + svg.replace(INK, DARK)


def figures(report: Report) -> dict[str, str]:
    """File name -> contents of all pictures."""
    blocks = [block for section in report.sections for block in section.blocks]
    panels = [panel for block in blocks if not isinstance(block, (Text, Sheet, Row)) for panel in block.panels]
    return {f"{panel.name}.svg": svg_file(panel.svg) for panel in panels}
