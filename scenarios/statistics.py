"""Judgements over stored trials: penalised times, tests, tables. Pure functions; one per metric.

The paper's comparison (its table IV): in every world, Welch's t-test on the traversal times of two methods; the table
gives the percentage of worlds in which the row's method is significantly worse, p < 0.05. Beside it stand what a reader
may ask for: the same with Holm's correction over the worlds of an entry, the same with a rank test, and bootstrap
intervals over the worlds.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from scenarios.errors import UserError
from scenarios.store import StoredTrial

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Times = Mapping[tuple[str, str], Array]  # (world, method) -> penalised traversal times [s], by seed and run

ALPHA = 0.05  # (paper, section V)
PENALTIES = {  # [s] traversal time of a trial that did not reach its goal
    "appli": 50.0,  # (paper, section V-C)
    "2020": 50.0,  # the protocol's own limit
    "icra22": 100.0,  # the challenge's limit
    "course": 200.0,  # (paper, section V-B)
}
OUTCOMES = ("reached", "collided", "timed_out", "aborted")
SCORE_SPEED = 2.0  # [m/s] that the challenge's optimal time is reckoned with (BARN challenge, ICRA 2022)
SCORE_CLIP = (4.0, 8.0)  # optimal times between which the actual time counts (the same)
RESAMPLES = 10_000
SAME = 1e-6  # [s] times come in steps of 50 ms; what is closer than this differs by rounding


# --- which rows ------------------------------------------------------------------------------------------------------


def one_version(rows: Iterable[StoredTrial], pick: str = "") -> list[StoredTrial]:
    """The finished rows of one code, one policy per method and one content per world, never a mixture.

    Without `pick` a store that holds several is refused. "newest" takes the code of the row finished last, and with it
    the newest policy of every method and the newest content of every world; anything else is the beginning of a code
    digest. Raises UserError.
    """
    done = [row for row in rows if row.status == "done"]
    codes = _newest_first((row.code, row.finished) for row in done)
    if pick not in ("", "newest"):
        found = [code for code in codes if code.startswith(pick)]
        if len(found) != 1:
            raise UserError(f"no single code digest begins with {pick!r}; there are {_short(codes)}")
        codes = found
    elif len(codes) > 1 and pick == "":
        raise UserError(f"the trials were made by different code ({_short(codes)}, newest first); {_choose(codes)}")
    done = [row for row in done if row.code == codes[0]] if codes else []
    for name, label, digest in (("method", "method", "policy"), ("world", "world", "world_digest")):
        newest: dict[object, str] = {}
        for key in {_place(row, label) for row in done}:
            digests = _newest_first((getattr(r, digest), r.finished) for r in done if _place(r, label) == key)
            if len(digests) > 1 and pick == "":
                raise UserError(f"the {name} {key[0]} is in there in {len(digests)} versions; {_choose([])}")
            newest[key] = digests[0]
        done = [row for row in done if getattr(row, digest) == newest[_place(row, label)]]
    return done


def _place(row: StoredTrial, label: str) -> tuple[str, str]:
    """What may have several versions: a method anywhere, a world under one protocol."""
    return (row.method, "") if label == "method" else (row.world, row.protocol)


def _newest_first(pairs: Iterable[tuple[str, str]]) -> list[str]:
    """The names of (name, time) by their latest time."""
    latest: dict[str, str] = {}
    for name, when in pairs:
        latest[name] = max(when, latest.get(name, ""))
    return sorted(latest, key=lambda name: (latest[name], name), reverse=True)


def _short(digests: Sequence[str]) -> str:
    return ", ".join(digest[:8] for digest in digests)


def _choose(codes: Sequence[str]) -> str:
    return f"pick one: newest{', ' if codes else ''}{' or '.join(code[:8] for code in codes)}"


# --- one trial -------------------------------------------------------------------------------------------------------


def traversal_time(trial: StoredTrial) -> float:
    """[s] as the paper counts it: the penalty for whatever did not reach the goal, collisions included."""
    if trial.outcome == "reached" and trial.time is not None:
        return trial.time
    return PENALTIES[trial.protocol]


def barn_score(trial: StoredTrial, path_length: float) -> float:
    """The challenge's score: success * OT / clip(actual, 4 OT, 8 OT), OT = path length [m] / 2 m/s; 0 .. 0.25."""
    if trial.outcome != "reached" or trial.time is None:
        return 0.0
    optimal = path_length / SCORE_SPEED
    low, high = SCORE_CLIP
    return optimal / min(max(trial.time, low * optimal), high * optimal)


# --- one method ------------------------------------------------------------------------------------------------------


def times_by_cell(trials: Iterable[StoredTrial]) -> dict[tuple[str, str], Array]:
    """(world, method) -> penalised times of its finished trials, in the order of seed and run.

    Raises UserError when a world was driven under several protocols: their times cannot be compared.
    """
    cells: dict[tuple[str, str], list[tuple[int, int, float]]] = {}
    protocols: dict[str, str] = {}
    for trial in trials:
        if trial.status == "done":
            if (other := protocols.setdefault(trial.world, trial.protocol)) != trial.protocol:
                raise UserError(
                    f"{trial.world} was driven under {other} and {trial.protocol}; take one protocol at a time"
                )
            cells.setdefault((trial.world, trial.method), []).append((trial.seed, trial.run, traversal_time(trial)))
    return {cell: np.array([time for *_, time in sorted(found)]) for cell, found in cells.items()}


def mean(times: Array) -> float:
    """[s]; NaN for none."""
    return float(np.mean(times)) if len(times) else math.nan


def deviation(times: Array) -> float:
    """[s] standard deviation of a sample; NaN for fewer than two."""
    return float(np.std(times, ddof=1)) if len(times) > 1 else math.nan


def outcome_shares(trials: Iterable[StoredTrial]) -> dict[str, float]:
    """Share of every outcome among the finished trials; NaN without any."""
    counts = Counter(trial.outcome for trial in trials if trial.status == "done")
    total = counts.total()
    return {name: counts[name] / total if total else math.nan for name in OUTCOMES}


def mean_over_worlds(times: Times, method: str) -> float:
    """[s] mean of the worlds' means; every world counts alike."""
    return mean(np.array([mean(found) for (_, name), found in times.items() if name == method]))


# --- two samples -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Verdict:
    """A two-sided test of two samples, and which is larger."""

    p: float  # NaN when a sample has fewer than two values
    larger: int  # 1: the first sample is larger, -1: the second, 0: neither

    def swapped(self) -> Verdict:
        """The same with the samples exchanged."""
        return Verdict(self.p, -self.larger)

    def worse(self, alpha: float = ALPHA) -> bool:
        """Whether the first sample is significantly larger: the first method is slower."""
        return self.larger > 0 and self.p < alpha


def _constants(a: Array, b: Array) -> Verdict | None:
    """The verdict where no test is needed or possible: too few values, or two constant samples."""
    if min(len(a), len(b)) < 2:
        return Verdict(math.nan, 0)
    if np.ptp(a) > SAME or np.ptp(b) > SAME:
        return None
    return Verdict(1.0, 0) if abs(a[0] - b[0]) <= SAME else Verdict(0.0, 1 if a[0] > b[0] else -1)


def welch(a: Array, b: Array) -> Verdict:
    """Welch's t-test. Constant samples: equal ones do not differ (p = 1), different ones do (p = 0)."""
    if (verdict := _constants(a, b)) is not None:
        return verdict
    error_a, error_b = np.var(a, ddof=1) / len(a), np.var(b, ddof=1) / len(b)  # squared errors of the means
    t = (np.mean(a) - np.mean(b)) / np.sqrt(error_a + error_b)
    freedom = (error_a + error_b) ** 2 / (error_a**2 / (len(a) - 1) + error_b**2 / (len(b) - 1))
    return Verdict(float(2.0 * stats.t.sf(abs(t), freedom)), int(np.sign(t)))


def rank_test(a: Array, b: Array) -> Verdict:
    """Mann-Whitney's U test, ties and constant samples included."""
    if min(len(a), len(b)) < 2:
        return Verdict(math.nan, 0)
    if np.ptp(np.concatenate([a, b])) <= SAME:
        return Verdict(1.0, 0)
    result = stats.mannwhitneyu(a, b, alternative="two-sided")
    return Verdict(float(result.pvalue), int(np.sign(result.statistic - len(a) * len(b) / 2.0)))


def holm(p: Array) -> Array:
    """p-values corrected for their number (Holm 1979); NaN stays and does not count."""
    corrected = np.full(len(p), np.nan)
    order = [k for k in np.argsort(p, kind="stable") if not math.isnan(p[k])]
    largest = 0.0
    for rank, k in enumerate(order):
        largest = max(largest, min(1.0, (len(order) - rank) * float(p[k])))
        corrected[k] = largest
    return corrected


# --- two methods over many worlds ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Entry:
    """One entry of table IV: where the row's method is significantly worse than the column's. In percent."""

    worlds: int  # in which both have two trials or more
    worse: float  # Welch, p < 0.05
    interval: tuple[float, float]  # 95 %, bootstrap over worlds
    worse_holm: float  # Welch, corrected over the worlds
    worse_rank: float  # Mann-Whitney, p < 0.05


def common_worlds(times: Times, row: str, column: str) -> list[str]:
    """Worlds in which both methods have two trials or more, in order."""
    worlds = dict.fromkeys(world for world, _ in times)
    none = np.empty(0)
    return [w for w in worlds if min(len(times.get((w, m), none)) for m in (row, column)) > 1]


def percentage(flags: Flags) -> float:
    """Of true ones; NaN for none at all."""
    return 100.0 * float(np.mean(flags)) if len(flags) else math.nan


def bootstrap_interval(flags: Flags, rng: np.random.Generator, level: float = 0.95) -> tuple[float, float]:
    """Percentile interval of the percentage over resampled worlds.

    Resampling n flags of which a share q is true gives a binomial count, so that it is drawn at once. The runs are not
    resampled: repeated values would make the tests in every world overconfident.
    """
    if not len(flags):
        return math.nan, math.nan
    drawn = 100.0 * rng.binomial(len(flags), float(np.mean(flags)), RESAMPLES) / len(flags)
    low, high = np.quantile(drawn, [(1.0 - level) / 2.0, (1.0 + level) / 2.0])
    return float(low), float(high)


def verdicts(times: Times, row: str, column: str) -> list[tuple[Verdict, Verdict]]:
    """(Welch, rank test) in every world that both methods have."""
    pairs = [(times[world, row], times[world, column]) for world in common_worlds(times, row, column)]
    return [(welch(a, b), rank_test(a, b)) for a, b in pairs]


def entry(found: Sequence[tuple[Verdict, Verdict]], seed: int = 0) -> Entry:
    """Sum up the verdicts of all worlds; `seed` is that of the bootstrap."""
    worse = np.array([w.worse() for w, _ in found], dtype=bool)
    corrected = holm(np.array([w.p for w, _ in found]))
    worse_holm = np.array([w.larger > 0 and p < ALPHA for (w, _), p in zip(found, corrected, strict=True)], dtype=bool)
    worse_rank = np.array([r.worse() for _, r in found], dtype=bool)
    return Entry(
        worlds=len(found),
        worse=percentage(worse),
        interval=bootstrap_interval(worse, np.random.default_rng(seed)),
        worse_holm=percentage(worse_holm),
        worse_rank=percentage(worse_rank),
    )


def table(times: Times, methods: Sequence[str]) -> dict[tuple[str, str], Entry]:
    """(row, column) -> entry, for all pairs of different methods."""
    entries = {}
    for row, column in combinations(methods, 2):
        found = verdicts(times, row, column)
        entries[row, column] = entry(found)
        entries[column, row] = entry([(w.swapped(), r.swapped()) for w, r in found])
    return entries
