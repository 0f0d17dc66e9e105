"""The search for one parameter set, with a drive that costs nothing."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from scenarios import headroom
from scenarios.trials import TrialSpec
from twin.planner.params import ParameterSpace, PlannerParams

WORLDS = 12


@pytest.fixture(name="driven")
def _driven(monkeypatch: pytest.MonkeyPatch) -> list[TrialSpec]:
    """What was driven; a drive takes ten times the distance to the middle of the unit cube."""
    driven: list[TrialSpec] = []

    def drive(trial: TrialSpec) -> tuple[float, bool]:
        driven.append(trial)
        noise = np.random.default_rng(int(trial.world.split("/")[1])).normal()
        return 20.0 + noise + 10.0 * float(np.linalg.norm(ParameterSpace().encode(trial.params) - 0.5)), True

    monkeypatch.setattr(headroom, "drive", drive)
    return driven


def test_the_search_finds_the_optimum_and_repeats(driven: list[TrialSpec]) -> None:
    options = headroom.Options(worlds=str(WORLDS), evaluations=200)
    found = []
    with ThreadPoolExecutor(1) as pool:
        for _ in range(2):
            driven.clear()
            found.append(headroom.search(pool, headroom.default_trials(options, 0, 1), options)["params"])
    assert found[0] == found[1]
    assert np.linalg.norm(ParameterSpace().encode(found[0]) - 0.5) < 0.2
    assert len({trial.params for trial in driven}) <= options.evaluations
    assert len(driven) < options.evaluations * WORLDS  # some stopped early


def test_what_loses_the_first_third_is_judged_by_it(driven: list[TrialSpec]) -> None:
    trials = headroom.default_trials(headroom.Options(worlds=str(WORLDS)), 0, 1)
    middle = ParameterSpace().decode(np.full(8, 0.5))
    with ThreadPoolExecutor(1) as pool:
        (best,) = headroom.drive_all(pool, trials, [{"params": middle}])[0]
        driven.clear()
        lost, again = headroom.race(pool, trials, [{"params": PlannerParams()}, {"params": middle}], best)
        assert len(driven) == WORLDS // 3 + WORLDS
        full = headroom.drive_all(pool, trials, [{"params": PlannerParams()}])[0, 0]
    np.testing.assert_allclose(lost, full)  # here the loss is the same everywhere
    np.testing.assert_allclose(again, best)


def test_search_and_comparison_meet_the_same_worlds_and_never_the_same_noise() -> None:
    options = headroom.Options(worlds="4,training", runs=2)
    search, fresh = headroom.default_trials(options, 0, 1), headroom.default_trials(options, 1, 4)
    assert {trial.world for trial in search} == {trial.world for trial in fresh}
    assert {trial.world for trial in search} == {"training", *(f"barn-like/{k}" for k in (0, 100, 199, 299))}
    assert (len(search), len(fresh)) == (10, 30)
    assert not {(t.world, t.run) for t in search} & {(t.world, t.run) for t in fresh}
