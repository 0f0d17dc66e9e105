"""Statistics against scipy, against cases done by hand, and what must hold for constant samples."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from scenarios import statistics as s
from scenarios.barn_metrics import challenge_path_length
from scenarios.errors import UserError
from scenarios.store import StoredTrial
from tests.scenarios.test_store import DONE

ARCHIVE = Path(__file__).resolve().parents[3] / "shared" / "barn" / "barn_100.npz"
RNG = np.random.default_rng(3)
SAMPLE = st.lists(st.integers(20, 1000), min_size=2, max_size=12).map(lambda ticks: np.array(ticks) * 0.05)


def trial(world: str, method: str, run: int, time: float | None, protocol: str = "appli") -> StoredTrial:
    """A finished trial; no time means that it did not arrive."""
    outcome = "reached" if time is not None else "timed_out"
    key = f"{world}/{method}/{run}"
    return replace(
        DONE, key=key, world=world, method=method, run=run, time=time or 31.0, outcome=outcome, protocol=protocol
    )


# --- times and shares ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("protocol", "penalty"), [("appli", 50), ("2020", 50), ("icra22", 100), ("course", 200)])
@pytest.mark.parametrize("outcome", ["collided", "timed_out", "aborted"])
def test_the_penalty_stands_for_whatever_did_not_arrive(protocol: str, penalty: float, outcome: str) -> None:
    row = replace(DONE, protocol=protocol, outcome=outcome, time=7.0)
    assert s.traversal_time(row) == penalty
    assert s.traversal_time(replace(row, outcome="reached")) == 7.0


def test_cells_are_in_the_order_of_runs_and_without_failed_trials() -> None:
    rows = [trial("w", "A", 1, 12.0), trial("w", "A", 0, None), replace(DONE, world="w", method="A", status="error")]
    assert s.times_by_cell(rows)["w", "A"].tolist() == [50.0, 12.0]


def test_a_world_under_two_protocols_is_refused() -> None:
    with pytest.raises(UserError, match="icra22"):
        s.times_by_cell([trial("w", "A", 0, 12.0), trial("w", "dwa", 0, 12.0, "icra22")])


def test_mean_and_deviation_by_hand() -> None:
    assert s.mean(np.array([1.0, 2.0, 6.0])) == 3.0
    assert s.deviation(np.array([1.0, 2.0, 6.0])) == pytest.approx(math.sqrt(7.0))
    assert math.isnan(s.deviation(np.array([1.0])))
    assert math.isnan(s.mean(np.empty(0)))


def test_every_world_counts_alike() -> None:
    times = {("v", "A"): np.array([10.0]), ("w", "A"): np.array([20.0, 40.0, 30.0]), ("w", "B"): np.array([9.0])}
    assert s.mean_over_worlds(times, "A") == 20.0


def test_outcome_shares() -> None:
    rows = [trial("w", "A", k, 1.0) for k in range(3)] + [replace(trial("w", "A", 3, None), outcome="collided")]
    assert s.outcome_shares(rows) == {"reached": 0.75, "collided": 0.25, "timed_out": 0.0, "aborted": 0.0}
    assert math.isnan(s.outcome_shares([])["reached"])


@pytest.mark.parametrize(
    ("time", "score"),
    [(1.0, 0.25), (20.0, 0.25), (25.0, 0.2), (40.0, 0.125), (90.0, 0.125)],  # optimal time 5 s
)
def test_the_challenge_score_by_hand(time: float, score: float) -> None:
    row = replace(DONE, time=time)
    assert s.barn_score(row, path_length=10.0) == pytest.approx(score)
    assert s.barn_score(replace(row, outcome="collided"), path_length=10.0) == 0.0


@pytest.mark.skipif(not ARCHIVE.is_file(), reason="needs ../shared/barn")
def test_path_lengths_of_the_score_are_the_published_ones() -> None:
    with np.load(ARCHIVE, allow_pickle=False) as data:
        cells, offsets = data["path_cells"], data["path_offsets"]
        ours = [challenge_path_length(cells[a:b]) for a, b in itertools.pairwise(offsets)]
        assert ours == pytest.approx(data["path_length_icra22_m"])


# --- tests -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sizes", [(12, 12), (5, 12), (2, 3)])
def test_welch_is_scipys(sizes: tuple[int, int]) -> None:
    a, b = RNG.normal(20.0, 2.0, sizes[0]), RNG.normal(22.0, 5.0, sizes[1])
    verdict, expected = s.welch(a, b), stats.ttest_ind(a, b, equal_var=False)
    assert verdict.p == pytest.approx(expected.pvalue)
    assert verdict.larger == np.sign(expected.statistic)


def test_the_rank_test_is_scipys() -> None:
    a, b = RNG.integers(10, 20, 12).astype(float), RNG.integers(12, 22, 12).astype(float)
    assert s.rank_test(a, b).p == stats.mannwhitneyu(a, b).pvalue
    assert s.rank_test(a, b).larger == np.sign(stats.mannwhitneyu(a, b).statistic - 72.0)


@given(SAMPLE, SAMPLE)
@pytest.mark.parametrize("test", [s.welch, s.rank_test])
def test_swapping_the_samples_swaps_the_verdict(test: object, a: np.ndarray, b: np.ndarray) -> None:
    assert callable(test)
    one, other = test(a, b), test(b, a)
    assert one.swapped().p == pytest.approx(other.p)
    assert one.swapped().larger == other.larger
    assert not (one.worse() and other.worse())


@given(SAMPLE)
def test_a_sample_does_not_differ_from_itself(a: np.ndarray) -> None:
    assert s.welch(a, a).p == pytest.approx(1.0)
    assert not s.welch(a, a).worse()
    assert not s.rank_test(a, a).worse()


def test_constant_samples() -> None:
    slow, fast = np.full(12, 50.0), np.full(12, 14.0)
    assert s.welch(slow, slow.copy()) == s.Verdict(1.0, 0)
    assert s.rank_test(slow, slow.copy()) == s.Verdict(1.0, 0)
    assert s.welch(slow, fast) == s.Verdict(0.0, 1)
    assert s.welch(fast, slow) == s.Verdict(0.0, -1)
    assert s.welch(fast, fast + 1e-9) == s.Verdict(1.0, 0)
    assert s.rank_test(slow, fast).worse()
    assert s.rank_test(slow, fast).p == pytest.approx(stats.mannwhitneyu(slow, fast).pvalue)


def test_one_constant_sample_is_an_ordinary_test() -> None:
    slow, mixed = np.full(12, 50.0), RNG.normal(20.0, 1.0, 12)
    assert s.welch(slow, mixed).p == pytest.approx(stats.ttest_1samp(mixed, 50.0).pvalue)
    assert s.welch(slow, mixed).worse()


def test_too_few_values_decide_nothing() -> None:
    for test in (s.welch, s.rank_test):
        assert math.isnan(test(np.array([50.0]), np.array([1.0, 2.0])).p)
        assert not test(np.array([50.0]), np.array([1.0, 2.0])).worse()


def test_holm_by_hand() -> None:
    p = np.array([0.01, 0.04, 0.03, np.nan, 0.005])
    assert s.holm(p)[:3].tolist() == pytest.approx([0.03, 0.06, 0.06])
    assert s.holm(p)[4] == pytest.approx(0.02)
    assert math.isnan(s.holm(p)[3])


@given(st.lists(st.floats(0.0, 1.0), max_size=30).map(np.array))
def test_holm_never_lowers_and_keeps_the_order(p: np.ndarray) -> None:
    corrected = s.holm(p)
    assert (corrected >= p).all()
    assert (corrected <= 1.0).all()
    assert (np.diff(corrected[np.argsort(p, kind="stable")]) >= 0.0).all()


# --- the table -------------------------------------------------------------------------------------------------------


def test_the_table_by_hand() -> None:
    """Four worlds: A clearly slower, clearly faster, equal, and one with too few trials."""
    slow, fast = np.array([40.0, 41.0, 42.0, 43.0]), np.array([20.0, 21.0, 22.0, 23.0])
    times = {
        ("v", "A"): slow,
        ("v", "dwa"): fast,
        ("w", "A"): fast,
        ("w", "dwa"): slow,
        ("x", "A"): fast,
        ("x", "dwa"): fast,
        ("y", "A"): slow,
        ("y", "dwa"): fast[:1],
    }
    found = s.table(times, ["dwa", "A"])
    assert set(found) == {("dwa", "A"), ("A", "dwa")}
    for e in found.values():
        assert e.worlds == 3
        assert e.worse == e.worse_holm == e.worse_rank == pytest.approx(100.0 / 3.0)
        assert e.interval[0] <= e.worse <= e.interval[1]


def test_holm_in_the_table_counts_the_worlds() -> None:
    """One world with p about 0.03 among 40 that are equal: significant alone, not among 41."""
    near, far = np.array([1.0, 2.0, 3.0, 4.0]), np.array([3.0, 4.0, 5.0, 6.0])
    assert 0.0125 < s.welch(far + 0.5, near).p < 0.05
    times = {("w", "A"): far + 0.5, ("w", "B"): near}
    times |= {(f"w{k}", method): near for k in range(40) for method in "AB"}
    e = s.entry(s.verdicts(times, "A", "B"))
    assert (e.worse, e.worse_holm) == (pytest.approx(100.0 / 41.0), 0.0)


def test_no_worlds_at_all() -> None:
    e = s.entry(s.verdicts({}, "A", "B"))
    assert e.worlds == 0
    assert math.isnan(e.worse)
    assert math.isnan(e.interval[0])


def test_the_bootstrap_is_that_of_resampled_worlds() -> None:
    flags = np.arange(100) < 44
    drawn = [100.0 * RNG.choice(flags, len(flags)).mean() for _ in range(4000)]
    low, high = s.bootstrap_interval(flags, np.random.default_rng(0))
    assert low == pytest.approx(np.quantile(drawn, 0.025), abs=1.5)
    assert high == pytest.approx(np.quantile(drawn, 0.975), abs=1.5)
    assert s.bootstrap_interval(flags, np.random.default_rng(0)) == (low, high)


# --- one version -----------------------------------------------------------------------------------------------------


def version(code: str, policy: str, day: int, world_digest: str = "w") -> StoredTrial:
    finished = f"2026-01-{day:02}T00:00:00+00:00"
    return replace(DONE, code=code, policy=policy, world_digest=world_digest, finished=finished)


def test_rows_of_one_version_pass_without_the_failed() -> None:
    rows = [version("c1", "p", 1), version("c1", "p", 2), replace(version("c2", "p", 3), status="error")]
    assert s.one_version(rows) == rows[:2]
    assert s.one_version([]) == []


@pytest.mark.parametrize(
    "other", [version("c2", "p1", 2), version("c1", "p2", 2), version("c1", "p1", 2, world_digest="w2")]
)
def test_mixtures_are_refused_and_the_newest_can_be_picked(other: StoredTrial) -> None:
    old = version("c1", "p1", 1)
    with pytest.raises(UserError, match="newest"):
        s.one_version([old, other])
    assert s.one_version([old, other], "newest") == [other]


def test_a_code_can_be_picked_by_the_beginning_of_its_digest() -> None:
    rows = [version("abc", "p", 1), version("abd", "p", 2)]
    assert s.one_version(rows, "abc") == rows[:1]
    for pick in ("ab", "x"):
        with pytest.raises(UserError, match="abd"):
            s.one_version(rows, pick)
