"""docs/commands.md is what the command line says of itself."""

from __future__ import annotations

from pathlib import Path

import pytest

from scenarios.commands import COMMANDS
from scenarios.reference import help_text, reference

PAGE = Path(__file__).resolve().parents[2] / "docs" / "commands.md"


def test_the_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == reference(), "the command line changed; write it with: make reference"


@pytest.mark.parametrize("width", ["40", "200"])
def test_the_page_does_not_depend_on_the_terminal(width: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = help_text("run")
    monkeypatch.setenv("COLUMNS", width)
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert help_text("run") == before


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_there_with_all_it_says(name: str) -> None:
    text = help_text(name)
    assert text.startswith(f"usage: appli {name}")
    assert "\x1b" not in text
    assert "│" not in text
    assert "options:" in text
