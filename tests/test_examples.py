"""The scripts in examples/ run from the command line, say what they are there to say, and draw it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenarios import load_world
from twin.planner.params import PARAMETER_NAMES

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
LONGEST = 59  # lines of a script


def run(name: str, *options: str | Path, code: int = 0) -> subprocess.CompletedProcess[str]:
    """Run an example as the README shows it."""
    command = [sys.executable, f"examples/{name}.py", *map(str, options)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == code, done.stderr
    return done


def numbers(line: str) -> list[float]:
    """All numbers in a line, but for those within names."""
    return [float(word) for word in re.findall(r"(?<![\w/.])-?\d+(?:\.\d+)?", line)]


def assert_drawn(plot: Path) -> None:
    """There is a picture, with ink on it and with room left."""
    with Image.open(plot) as image:
        grey = np.asarray(image.convert("L"))
    assert min(grey.shape) > 250
    assert 0.002 < (grey < 250).mean() < 0.6


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_every_example_is_short_tested_and_shown_in_the_readme(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= LONGEST
    assert f'run("{path.stem}"' in Path(__file__).read_text(encoding="utf-8")
    assert f"examples/{path.name}" in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_drive_a_world(tmp_path: Path) -> None:
    plots = tmp_path / "new" / "slow.png", tmp_path / "fast.png"
    slow = run("drive_a_world", "open", "--max-vel-x", "0.3", "--plot", plots[0]).stdout.splitlines()
    fast = run("drive_a_world", "open", "--max-vel-x", "1.0", "--plot", plots[1]).stdout.splitlines()
    assert slow[0].startswith("open: reached after")
    assert numbers(fast[0])[0] < 0.5 * numbers(slow[0])[0]  # [s]
    assert 0.25 < numbers(slow[1])[0] <= 0.3  # [m/s]
    for plot in plots:
        assert_drawn(plot)


@pytest.mark.slow
def test_own_driver(tmp_path: Path) -> None:
    lines = run("own_driver", "barn-like/0", "--plot", tmp_path / "drivers.png").stdout.splitlines()
    (theirs, own) = (line.split() for line in lines[:2])
    assert theirs[:2] == ["move_base", "reached"]
    assert own[:4] == ["follow", "the", "gap", "reached"]
    assert float(own[4]) < float(theirs[2])  # [s] it never hesitates
    assert_drawn(tmp_path / "drivers.png")


@pytest.mark.slow
def test_fit_intervention(tmp_path: Path) -> None:
    said = run("fit_intervention", "--evaluations", "60", "--steps", "30", "--plot", tmp_path / "fit.png").stdout
    shown, default, fitted = said.splitlines()[:3]
    _, _, default_error, error = numbers(shown)
    assert error < 0.3 * default_error
    assert default.startswith("default reached")
    assert fitted.startswith("fitted  reached")
    assert numbers(fitted)[0] < 0.3 * numbers(default)[0]  # [s]
    assert float(re.search(r"max_vel_x (\S+),", fitted)[1]) == pytest.approx(0.8, abs=0.1)  # type: ignore[index]
    assert_drawn(tmp_path / "fit.png")


@pytest.mark.slow
def test_evaluate_policy(tmp_path: Path) -> None:
    lines = run("evaluate_policy", "--worlds", "3", "--plot", tmp_path / "policy.png").stdout.splitlines()
    table = {line.split()[0]: line.split()[1:] for line in lines[:-1]}
    assert set(table) == {"world", "barn-like/0", "barn-like/150", "barn-like/299", "mean", "arrived"}
    times = np.array([[float(word) for word in row] for name, row in table.items() if name.startswith("barn")])
    assert ((times > 5.0) & (times <= 50.0)).all()
    assert (times[:, 0] != times[:, 1]).any()  # it is the policy that drives
    np.testing.assert_allclose([float(word) for word in table["mean"]], times.mean(axis=0), atol=0.1)
    assert table["arrived"][0] == "100%"
    assert_drawn(tmp_path / "policy.png")


@pytest.mark.slow
def test_scanned_room(tmp_path: Path) -> None:
    plot = tmp_path / "room.png"
    lines = run("scanned_room", "--plot", plot).stdout.splitlines()
    assert lines[1].startswith("reached after")
    assert 0.0 < numbers(lines[1])[1] < 0.5  # [m] it came past the partition
    assert_drawn(plot)
    mesh = load_world(str(tmp_path / "room.ply"), start="1,1,0", goal="5,3").obstacles[0]
    assert np.ptp(mesh.vertices[:, :2], axis=0) == pytest.approx([6.2, 4.2], abs=0.1)  # type: ignore[union-attr]
    again = run("scanned_room", "--mesh", tmp_path / "room.ply", "--start=1,3,0", "--goal=3.6,3", "--plot", plot).stdout
    assert "reached after" in again
    assert numbers(again.splitlines()[1])[0] < numbers(lines[1])[0]  # a shorter way, straight ahead


@pytest.mark.slow
def test_confidence() -> None:
    header, *rows = run("confidence", "results/policies/A+B+c.safetensors", "1").stdout.splitlines()
    assert header.split()[:5] == ["world", "place", "steps", "confidence", "confident"]
    assert {tuple(row.split()[:2]) for row in rows} >= {
        (world, f"{kind}1") for world in ("training", "unseen") for kind in "AB"
    }
    for row in rows:
        steps, mean, share = (float(word) for word in row.split()[2:5])
        assert steps > 0
        assert 0.0 < mean <= 1.0
        assert 0.0 <= share <= 1.0


@pytest.mark.slow
def test_headroom_in_the_open() -> None:
    done = run("headroom", "--workers", "1", "--worlds", "open", "--evaluations", "2", "--json")
    report = json.loads(done.stdout)
    assert tuple(report["params"]) == PARAMETER_NAMES
    assert report["drives"] == 3
    assert report["share"] is None  # no policy was given
    default, optimum = report["default"], report["optimum"]
    assert default["reached"] == optimum["reached"] == 1.0
    assert default["gain"] == default["gain_error"] == 0.0
    assert optimum["gain"] == pytest.approx(default["time"] - optimum["time"])
    assert optimum["gain"] == pytest.approx(0.0, abs=0.5)  # occdist_scale changes little where nothing is in the way
    assert "2 tried" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        ("drive_a_world", "nope"),
        ("drive_a_world", "open", "--max-vel-x", "-5"),
        ("own_driver", "nope"),
        ("confidence", "nope.safetensors"),
        ("evaluate_policy", "nope.safetensors"),
        ("evaluate_policy", "--worlds", "0"),
        ("headroom", "--workers", "1", "--worlds", "opn"),
        ("headroom", "--worlds", "0"),
    ],
    ids=" ".join,
)
def test_mistakes_are_one_line(arguments: tuple[str, ...]) -> None:
    done = run(*arguments, code=2)
    assert done.stderr.startswith(f"{arguments[0]}: ")
    assert len(done.stderr.splitlines()) == 1
