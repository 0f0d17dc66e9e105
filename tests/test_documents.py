"""Every command that the documentation shows works: short ones are run, all are parsed."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from scenarios.cli import parse
from scenarios.commands import COMMANDS
from scenarios.reference import help_text
from tests.documents import PAGES, ROOT, Shown, blocks, commands, mentions

SHOWN = [command for page in PAGES for command in commands(page)]
APPLI = list(dict.fromkeys(c for c in SHOWN if c.words[0] == "appli"))
MAKE = list(dict.fromkeys(c for c in SHOWN if c.words[0] == "make"))
PYTHON = list(dict.fromkeys(c for c in SHOWN if c.words[0] == "python"))
MENTIONED = list(dict.fromkeys(c for page in PAGES for c in mentions(page)))


def test_there_are_commands() -> None:
    assert len(APPLI) > 20
    assert len(MAKE) > 4
    assert len(MENTIONED) > 10
    assert {c.words[1] for c in APPLI} >= set(COMMANDS) - {"demo", "view"}, "a command that no page shows"


def test_the_readme_leads_to_every_page() -> None:
    readme = PAGES[0].read_text(encoding="utf-8")
    assert [page.name for page in PAGES[1:] if f"](docs/{page.name})" not in readme] == []


@pytest.mark.parametrize("shown", APPLI, ids=str)
def test_every_command_parses(shown: Shown) -> None:
    parse(list(shown.words[1:]))


def test_other_programs_are_marked() -> None:
    others = [c for c in SHOWN if c.words[0] not in ("appli", "make", "python")]
    assert others
    assert [str(c) for c in others if not c.mark] == []


@pytest.mark.parametrize("shown", [c for c in MENTIONED if c.words[0] == "appli"], ids=str)
def test_every_mentioned_option_exists(shown: Shown) -> None:
    name = shown.words[1]
    assert name in COMMANDS
    known = set(re.findall(r"--[a-z][a-z-]*", help_text(name)))
    assert {word.split("=")[0] for word in shown.words if word.startswith("--")} <= known


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_unmarked_commands_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    short = [c for c in commands(page) if c.words[0] == "appli" and not c.mark]
    if not short:
        return
    furnish(tmp_path)
    monkeypatch.chdir(tmp_path)
    for shown in short:
        call = parse(list(shown.words[1:]))
        code = 0 if call is None else call()
        arrived_or_not = (0, 1) if shown.words[1] == "run" else (0,)
        assert code in arrived_or_not, f"{shown} ended with exit code {code}"


def furnish(folder: Path) -> None:
    """What a reader has made by then: a policy, a course and parameters of their own, a script of keys."""
    (folder / "results").symlink_to(ROOT / "results")
    shutil.copytree(ROOT / "results" / "policies", folder / "out" / "policies")
    shutil.copy(ROOT / "results" / "policies" / "A+B+c.safetensors", folder / "out" / "policy.safetensors")
    (folder / "my-course.toml").write_text(blocks(ROOT / "docs" / "worlds.md", "toml")[0])
    (folder / "mine.yaml").write_text("max_vel_x: 0.8\n")
    keys = next(block for block in blocks(ROOT / "docs" / "driving.md", "text") if "press enter" in block)
    (folder / "drive.keys").write_text(keys)


@pytest.mark.parametrize("shown", MAKE, ids=str)
def test_every_target_of_make_exists(shown: Shown, tmp_path: Path) -> None:
    """Long ones are only planned (`make -n`), nothing is installed, and what is made goes elsewhere."""
    plan = ["-n"] if shown.mark else []
    words = ["make", *plan, "-o", ".venv/.ready", f"BIN={Path(sys.executable).parent}", *shown.words[1:]]
    done = subprocess.run([*words, f"OUT={tmp_path}"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


@pytest.mark.parametrize("shown", [*PYTHON, *(c for c in MENTIONED if c.words[0] == "python")], ids=str)
def test_every_program_exists(shown: Shown) -> None:
    if shown.words[1] == "-m":
        assert importlib.util.find_spec(shown.words[2])
    elif not shown.mark:
        assert (ROOT / shown.words[1]).is_file()


def test_python_commands_are_marked_or_examples() -> None:
    """The examples have tests of their own (tests/test_examples.py)."""
    assert [str(c) for c in PYTHON if not c.mark and not c.words[1].startswith("examples/")] == []


@pytest.mark.slow
@pytest.mark.parametrize(("page", "order"), [("README.md", [0]), ("docs/recordings.md", [1, 0])])
def test_python_on_the_pages_runs(page: str, order: list[int], tmp_path: Path) -> None:
    """That of environment.md has a test of its own; those of cluster.md and real_robot.md need a cluster and ROS."""
    shown = blocks(ROOT / page, "python")
    assert len(shown) == len(order)
    for k in order:
        done = subprocess.run(
            [sys.executable, "-c", shown[k]],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout or "print" not in shown[k]
