"""docs/commands.md from the command line itself: `python -m scenarios.reference FILE`, which is `make reference`."""

from __future__ import annotations

import contextlib
import inspect
import io
import os
import re
import sys
from pathlib import Path
from unittest import mock

from scenarios.cli import parse
from scenarios.commands import COMMANDS

WIDTH = 100  # [characters] of the help texts
HEAD = """<!-- Written by `make reference` from the help texts of the command line; edit those. -->
# Commands

Exit codes: 0 = fine, 1 = it ran and the robot did not arrive or a check failed, 2 = bad input, said in one line.
`.venv/bin/appli` is the command that the installation makes; `python -m scenarios` is the same.
"""


def reference() -> str:
    """The page."""
    rows = [f"| [`appli {name}`](#appli-{name}) | {_summary(name)} |" for name in COMMANDS]
    parts = [HEAD, "| command | what it does |\n|---|---|\n" + "\n".join(rows) + "\n"]
    parts += [f"## appli {name}\n\n```text\n{help_text(name)}\n```\n" for name in COMMANDS]
    return "\n".join(parts)


def help_text(name: str) -> str:
    """What `appli NAME --help` prints in a terminal of WIDTH columns, without the frames."""
    said = io.StringIO()
    size = {"COLUMNS": str(WIDTH), "LINES": "100", "NO_COLOR": "1"}
    with mock.patch.dict(os.environ, size), contextlib.redirect_stdout(said):
        parse([name, "--help"])
    return _unframed(re.sub(r"\x1b\[[0-9;]*m", "", said.getvalue()))


def _unframed(text: str) -> str:
    """tyro draws a box round every group of options: its title becomes a line, the rest of the frame goes."""
    lines = [line.rstrip().removeprefix(" ") for line in text.splitlines()]
    lines = [line for line in lines if not re.fullmatch(r" ?-{20,}", line)]
    return "\n".join(f"{line}:" if re.fullmatch(r"[a-z][a-z ]*", line) else line for line in lines).strip()


def _summary(name: str) -> str:
    return (inspect.getdoc(COMMANDS[name]) or "").splitlines()[0]


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(reference(), encoding="utf-8")
