"""The scripts in examples/ run."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from scenarios.trials import TrialSpec
from twin.planner.params import PARAMETER_NAMES, ParameterSpace, PlannerParams

HEADROOM = Path(__file__).resolve().parents[1] / "examples" / "headroom.py"
WORLDS = 12


def headroom(*options: str) -> subprocess.CompletedProcess[str]:
    """Run it with one worker."""
    command = [sys.executable, str(HEADROOM), "--workers", "1", *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture(name="script")
def _script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script as a module, in which a drive takes ten times the distance to the middle of the unit cube."""
    spec = importlib.util.spec_from_file_location("headroom", HEADROOM)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "headroom", module)
    spec.loader.exec_module(module)
    driven: list[TrialSpec] = []

    def drive(trial: TrialSpec) -> tuple[float, bool]:
        driven.append(trial)
        noise = np.random.default_rng(int(trial.world.split("/")[1])).normal()
        return 20.0 + noise + 10.0 * float(np.linalg.norm(ParameterSpace().encode(trial.params) - 0.5)), True

    monkeypatch.setattr(module, "drive", drive)
    monkeypatch.setattr(module, "driven", driven, raising=False)
    return module


def test_headroom_in_the_open() -> None:
    done = headroom("--worlds", "open", "--evaluations", "2", "--json")
    assert done.returncode == 0, done.stderr
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


def test_headroom_refuses_an_unknown_world_in_one_line() -> None:
    done = headroom("--worlds", "opn")
    assert done.returncode == 2
    assert done.stderr.startswith("headroom: unknown world")
    assert len(done.stderr.splitlines()) == 1


def test_the_search_finds_the_optimum_and_repeats(script: ModuleType) -> None:
    options = script.Options(worlds=str(WORLDS), evaluations=200)
    found = []
    with ThreadPoolExecutor(1) as pool:
        for _ in range(2):
            script.driven.clear()
            found.append(script.search(pool, script.default_trials(options, 0, 1), options)["params"])
    assert found[0] == found[1]
    assert np.linalg.norm(ParameterSpace().encode(found[0]) - 0.5) < 0.2
    assert len({trial.params for trial in script.driven}) <= options.evaluations
    assert len(script.driven) < options.evaluations * WORLDS  # some stopped early


def test_what_loses_the_first_third_is_judged_by_it(script: ModuleType) -> None:
    trials = script.default_trials(script.Options(worlds=str(WORLDS)), 0, 1)
    middle = ParameterSpace().decode(np.full(8, 0.5))
    with ThreadPoolExecutor(1) as pool:
        (best,) = script.drive_all(pool, trials, [{"params": middle}])[0]
        script.driven.clear()
        lost, again = script.race(pool, trials, [{"params": PlannerParams()}, {"params": middle}], best)
        assert len(script.driven) == WORLDS // 3 + WORLDS
        full = script.drive_all(pool, trials, [{"params": PlannerParams()}])[0, 0]
    np.testing.assert_allclose(lost, full)  # here the loss is the same everywhere
    np.testing.assert_allclose(again, best)


def test_search_and_comparison_meet_the_same_worlds_and_never_the_same_noise(script: ModuleType) -> None:
    options = script.Options(worlds="4,training", runs=2)
    search, fresh = script.default_trials(options, 0, 1), script.default_trials(options, 1, 4)
    assert {trial.world for trial in search} == {trial.world for trial in fresh}
    assert {trial.world for trial in search} == {"training", *(f"barn-like/{k}" for k in (0, 100, 199, 299))}
    assert (len(search), len(fresh)) == (10, 30)
    assert not {(t.world, t.run) for t in search} & {(t.world, t.run) for t in fresh}
