"""The commands that README.md and docs/*.md show.

Two marks stand at the end of a line in a code block, for readers as for tests:

    # long: ~3 min            takes more than some seconds: the tests only parse it
    # needs: a robot          needs what no test has: the tests only parse it

Whatever is not marked is run (tests/test_documents.py). Programs that are not ours must be marked; what stands indented
below a marked line, and the `done` of its loop, belongs to it.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
MARK = re.compile(r"#.*?\b(long: ~[\d.]+ (?:s|min|h)\b|needs: \S.*)")
SHELL = ("", "sh", "bash")


@dataclass(frozen=True)
class Shown:
    """One command as a page shows it."""

    page: str
    words: tuple[str, ...]  # appli, make, python or another program, and what follows
    mark: str  # "long: ...", "needs: ..." or nothing

    def __str__(self) -> str:
        return f"{self.page}: {' '.join(self.words)}"


def commands(page: Path) -> list[Shown]:
    """The commands in a page's shell blocks, without the variables that are set for them."""
    found = []
    for language, block in _fenced(page):
        if language not in SHELL:
            continue
        for line in block.replace("\\\n", " ").splitlines():
            if line.startswith((" ", "#")) or line in ("", "done"):
                continue
            mark = MARK.search(line)
            words = shlex.split(line, comments=True)
            while "=" in words[0]:
                del words[0]
            words[0] = words[0].removeprefix(".venv/bin/")
            found.append(Shown(page.name, tuple(words), mark.group(1) if mark else ""))
    return found


def mentions(page: Path) -> list[Shown]:
    """The commands `appli ...` and `python ...` in sentences; they may be cut short, as in `appli train --types`."""
    text = page.read_text(encoding="utf-8")
    for _, block in _fenced(page):
        text = text.replace(block, "")
    spans = re.findall(r"`(?:\.venv/bin/)?(appli [a-z][^`]*|python [a-z-][^`]*)`", text)
    return [Shown(page.name, tuple(span.split()), "") for span in spans]


def blocks(page: Path, language: str) -> list[str]:
    """The code blocks of one language ("" = none said)."""
    return [block for said, block in _fenced(page) if said == language]


def _fenced(page: Path) -> Iterator[tuple[str, str]]:
    """(language, text) of the code blocks of a page, in order."""
    text = page.read_text(encoding="utf-8")
    for found in re.finditer(r"(?ms)^```([a-z]*)$\n(.*?)^```$", text):
        yield found.group(1), found.group(2)
