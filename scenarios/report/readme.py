"""Tables of a README that come from the store: `<!-- table: NAME -->` ... `<!-- end -->`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from scenarios.errors import UserError, blame
from scenarios.report.sheet import Sheet

_BEGIN = re.compile(r"<!-- table: ([^\s>]+) -->[ \t]*\n")
_END = "<!-- end -->"


def read(path: Path) -> str:
    """The file. Raises UserError."""
    with blame(f"cannot read {path}"):
        return path.read_text(encoding="utf-8")


def places(path: Path, text: str, sheets: Mapping[str, Sheet]) -> list[tuple[str, int, int]]:
    """(name, start, end) of every table in the file. Raises UserError for a mistake in the marks."""
    found = []
    for match in _BEGIN.finditer(text):
        name, start = match.group(1), match.end()
        end = text.find(_END, start)
        following = _BEGIN.search(text, start)
        if end < 0 or (following and following.start() < end):
            raise UserError(f"{path}: the table {name} has no {_END} after it; write one below the table")
        if name not in sheets:
            raise UserError(f"{path}: there is no table {name} from this store; there are {', '.join(sorted(sheets))}")
        found.append((name, start, end))
    if not found:
        known = ", ".join(sorted(sheets))
        raise UserError(f"{path} has no <!-- table: NAME --> ... {_END}; the tables are {known}")
    return found


def differences(path: Path, text: str, sheets: Mapping[str, Sheet]) -> list[str]:
    """One line for every cell in which the file differs from the store."""
    lines = []
    for name, start, end in places(path, text, sheets):
        there, ours = _cells(text[start:end]), _cells(sheets[name].markdown())
        written, wanted = [_label(row) for row in there], [_label(row) for row in ours]
        if not there or there[0] != ours[0] or written != wanted:
            odd = [*(f"without {row}" for row in wanted if row not in written)]
            odd += [f"with {row}" for row in written if row not in wanted]
            what = f": {'; '.join(odd)}" if odd else ""
            lines.append(f"{path}: table {name}: other rows or columns than in the store{what}")
            continue
        for found, row in zip(there[1:], ours[1:], strict=True):
            if len(found) != len(row):
                lines.append(f"{path}: table {name}: {_label(row)}: other columns than in the store")
                continue
            for title, cell, want in zip(ours[0], found, row, strict=True):
                if cell != want:
                    lines.append(f"{path}: table {name}: {_label(row)}, {title}: {cell}, in the store {want}")
    return lines


def updated(path: Path, text: str, sheets: Mapping[str, Sheet]) -> str:
    """The text with its tables from the store."""
    for name, start, end in reversed(places(path, text, sheets)):
        text = text[:start] + sheets[name].markdown() + "\n" + text[end:]
    return text


def _cells(table: str) -> list[list[str]]:
    """Of a pipe table, without the line below its head."""
    lines = [line.strip() for line in table.strip().splitlines() if line.strip()]
    rows = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip("|"))] for line in lines]
    return [row for row in rows if not all(re.fullmatch(r":?-+:?", cell) for cell in row)]


def _label(row: list[str]) -> str:
    """What the row is about: the words before its first number."""
    words: list[str] = []
    for cell in row:
        if words and (re.match(r"[\d<–+-]", cell) or not cell):
            break
        words.append(cell)
    return ", ".join(words)
