"""The report as one HTML page that needs nothing else: no scripts, nothing to load, for screens, phones and paper."""

from __future__ import annotations

from html import escape

from scenarios.report.document import Block, Report, Row, Text
from scenarios.report.picture import INK
from scenarios.report.sheet import Sheet

# Even a table with markup in its names cannot make the page load or run anything.
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"

BLUE = "#0072b2"  # too dark on a dark page; the other colours are not

STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1b; --soft: #5c5c5c; --paper: #fff; --line: #d9d9d9; --link: #0060a0;
  --warn: #fdf0d5; --blue: #0072b2; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e6e6; --soft: #a3a3a3; --paper: #15171a; --line: #3a3d41;
  --link: #7cc0f0; --warn: #3b2f14; --blue: #3d9fe0; } }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0 auto; max-width: 76rem; padding: 1.25rem 1rem 4rem; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.75rem; line-height: 1.2; margin: 0.5rem 0; }
h2 { font-size: 1.3rem; margin: 3rem 0 0.75rem; padding-top: 0.75rem; border-top: 1px solid var(--line); }
p { max-width: 46rem; margin: 0.75rem 0; }
a { color: var(--link); }
nav { display: flex; flex-wrap: wrap; gap: 0.25rem 1rem; margin: 1rem 0; font-size: 0.95rem; }
.status { color: var(--soft); }
.warning, .unfinished { background: var(--warn); padding: 0.5rem 0.75rem; border-radius: 4px; color: inherit; }
.missing { color: var(--soft); border-left: 3px solid var(--line); padding-left: 0.75rem; }
figure { margin: 1.5rem 0; }
figcaption { font-size: 0.92rem; max-width: 46rem; }
.sheet > figcaption { font-weight: 600; margin-bottom: 0.4rem; }
.picture > figcaption { color: var(--soft); margin-top: 0.4rem; }
.note { font-size: 0.85rem; color: var(--soft); margin: 0.4rem 0 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.9rem; font-variant-numeric: tabular-nums; }
th, td { padding: 0.28rem 0.6rem; text-align: left; font-weight: normal; white-space: nowrap;
  border-bottom: 1px solid var(--line); }
thead th { border-bottom: 1.5px solid var(--soft); color: var(--soft); vertical-align: bottom; white-space: normal; }
tbody th { font-weight: 600; white-space: normal; min-width: 4.6rem; }
#glance tbody th { min-width: 9rem; } #glance td { white-space: normal; }
.n { text-align: right; }
.heat td, .heat thead th.n { text-align: center; min-width: 2.6rem; }
.heat th, .heat td { padding: 0.3rem 0.35rem; }
.side { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 27rem), 1fr)); gap: 0 2rem; }
.panels { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 20rem), 1fr)); gap: 1rem 1.5rem;
  max-width: 76rem; }
.panels svg { display: block; width: 100%; height: auto; max-width: 30rem; }
.wide .panels { grid-template-columns: minmax(0, 1fr); }
.wide .panels svg { max-width: 54rem; }
svg text { font-family: inherit !important; }
@media (max-width: 30rem) { body { padding: 0.75rem 0.75rem 3rem; } table { font-size: 0.8rem; }
  th, td { padding: 0.25rem 0.4rem; } .heat th, .heat td { padding: 0.3rem 0.15rem; }
  .heat td, .heat thead th.n { min-width: 0; font-size: 0.75rem; } }
@media print { :root { color-scheme: light; --ink: #000; --soft: #444; --paper: #fff; --line: #bbb; --link: #000;
  --warn: #eee; --blue: #0072b2; } body { max-width: none; font-size: 10pt; padding: 0; } nav { display: none; }
  table { font-size: 8pt; }
  figure, tr { break-inside: avoid; } h2 { break-after: avoid; } th, td { padding: 0.15rem 0.35rem; }
  .scroll { overflow: visible; } * { print-color-adjust: exact; -webkit-print-color-adjust: exact; } }
"""


def to_html(report: Report) -> str:
    """report.html."""
    sections = [section for section in report.sections if section.blocks]
    links = "".join(f'<a href="#section-{escape(s.name)}">{escape(s.title)}</a>' for s in sections)
    kind = "status" if report.finished else "unfinished"
    body = "\n".join(
        f'<section id="section-{escape(s.name)}"><h2>{escape(s.title)}</h2>\n{_blocks(s.blocks)}\n</section>'
        for s in sections
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        f"<title>{escape(report.title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        f'<header><h1>{escape(report.title)}</h1>\n<p class="{kind}">{escape(report.status)}.</p>\n<nav>{links}</nav>'
        f"</header>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def _blocks(blocks: tuple[Block, ...]) -> str:
    return "\n".join(_block(block) for block in blocks)


def _block(block: Block) -> str:
    if isinstance(block, Text):
        return f'<p class="{block.kind}">{escape(block.text)}</p>'
    if isinstance(block, Sheet):
        return block.html()
    if isinstance(block, Row):
        return f'<div class="side">{"".join(sheet.html() for sheet in block.sheets)}</div>'
    panels = (
        "".join(f"<div>{panel.svg}</div>" for panel in block.panels)
        .replace(INK, "currentColor")
        .replace(BLUE, "var(--blue)")
    )
    kind = "picture wide" if block.wide else "picture"
    return (
        f'<figure class="{kind}" id="picture-{escape(block.name)}"><div class="panels">{panels}</div>'
        f"<figcaption>{escape(block.caption)}</figcaption></figure>"
    )
