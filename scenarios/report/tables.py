"""The tables that are made from trials alone."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from scenarios.agenda import PLAIN
from scenarios.report.facts import Experiment, Facts
from scenarios.report.paper import COURSE_NAMES, COURSES, TABLE_IV, TABLE_IV_ORDER, in_order
from scenarios.report.sheet import COUNT, ONE, RANGE, SHORT, SPREAD, TWO, Column, P, Sheet, matrix
from scenarios.statistics import (
    OUTCOMES,
    PENALTIES,
    Entry,
    deviation,
    mean,
    mean_over_worlds,
    outcome_shares,
    table,
    welch,
)

NAN = math.nan


# --- courses (the paper's tables II and III) -------------------------------------------------------------------------


def courses_sheet(experiment: Experiment, world: str = "") -> Sheet:
    """Times on one course, or on all of them, next to the paper's."""
    worlds = [world] if world else list(experiment.worlds)
    columns = (
        *(() if world else (Column("course", "course"),)),
        Column("method", "method"),
        Column("paper_name", "in the paper"),
        Column("runs", "runs", COUNT),
        Column("reached", "reached [%]", ONE),
        Column("time", "time [s]", SPREAD),
        Column("ratio", "/ default", TWO),
        Column("p", "p against default", P),
        Column("paper_time", "paper: time [s]", SPREAD),
        Column("paper_ratio", "paper: / default", TWO),
    )
    rows = []
    for name in worlds:
        for method in experiment.methods:
            row = _course_row(experiment, name, method)
            rows.append(row if world else (name, *row))
    number = {"training": "Table II: ", "unseen": "Table III: "}.get(world, "")
    note = (
        f"Mean and standard deviation over runs; a run that did not arrive counts as {PENALTIES['course']:.0f} s. "
        "p: Welch's t-test, made where both methods have all runs. The paper had 5 runs of each."
    )
    key = f"{experiment.key}-{world}" if world else experiment.key
    return Sheet(key, f"{number}traversal time, {world or 'courses'}", columns, tuple(rows), note)


def _course_row(experiment: Experiment, world: str, method: str) -> tuple[object, ...]:
    times = experiment.times.get((world, method), np.empty(0))
    default = experiment.times.get((world, PLAIN), np.empty(0))
    both = method != PLAIN and all((world, m) in experiment.full for m in (method, PLAIN))
    paper = COURSES.get(world, {})
    shares = outcome_shares(r for r in experiment.rows if (r.world, r.method) == (world, method))
    return (
        method,
        COURSE_NAMES.get(method),
        len(times),
        100.0 * shares["reached"],
        (mean(times), deviation(times)),
        mean(times) / mean(default),
        welch(times, default).p if both else NAN,
        paper.get(method),
        paper[method][0] / paper[PLAIN][0] if method in paper else None,
    )


# --- many worlds -----------------------------------------------------------------------------------------------------


def methods_sheet(experiment: Experiment, scores: Mapping[str, float] | None = None) -> Sheet:
    """One line per method over all worlds of an experiment. `scores`: method -> BARN score, where it can be told."""
    columns = (
        Column("method", "method"),
        Column("worlds", "worlds", COUNT),
        Column("trials", "trials", COUNT),
        Column("time", "mean time [s]", ONE),
        Column("ratio", "/ default", TWO),
        *(Column(name, f"{name.replace('_', ' ')} [%]", ONE) for name in OUTCOMES),
        Column("time_reached", "time if reached [s]", ONE),
        Column("recoveries", "recoveries per trial", TWO),
        *((Column("score", "BARN score", TWO),) if scores else ()),
    )
    rows = []
    for method in experiment.methods:
        found = [row for row in experiment.rows if row.method == method]
        reached = np.array([row.time for row in found if row.outcome == "reached"])
        rows.append(
            (
                method,
                len({row.world for row in found}),
                len(found),
                mean_over_worlds(experiment.times, method),
                ratio_to_default(experiment, method),
                *(100.0 * share for share in outcome_shares(found).values()),
                mean(reached),
                mean(np.array([float(row.recoveries or 0) for row in found])),
                *((scores.get(method),) if scores else ()),
            )
        )
    penalty = f"{PENALTIES[experiment.protocol]:.0f} s"
    note = f"Time: mean of the worlds' means, where a run that did not arrive counts as {penalty}. "
    if experiment.missing():
        note += "All stored trials; the ratio only over worlds where both methods have all runs."
    return Sheet(experiment.key, f"{experiment.title}: methods", columns, tuple(rows), note)


def ratio_to_default(experiment: Experiment, method: str) -> float:
    """Mean time over the default's, over the worlds where both have all runs."""
    worlds = set(experiment.common_worlds((method, PLAIN)))
    times = {cell: found for cell, found in experiment.full.items() if cell[0] in worlds}
    return mean_over_worlds(times, method) / mean_over_worlds(times, PLAIN) if worlds else NAN


# --- table IV --------------------------------------------------------------------------------------------------------


class Significance:
    """Table IV of an experiment: where the row's method is significantly worse than the column's."""

    def __init__(self, experiment: Experiment) -> None:
        """Makes all tests, with the worlds where both methods have all runs."""
        self.experiment = experiment
        self.entries = table(experiment.full, experiment.methods)
        self.methods = in_order(set(experiment.methods), TABLE_IV_ORDER)

    @property
    def worlds(self) -> tuple[int, int]:
        """Smallest and largest number of worlds behind an entry."""
        counts = [entry.worlds for entry in self.entries.values()]
        return (min(counts), max(counts)) if counts else (0, 0)

    def entry(self, row: str, column: str) -> Entry | None:
        """One entry; None where nothing was tested."""
        found = self.entries.get((row, column))
        return found if found and found.worlds else None

    def plain(self) -> Sheet:
        """Ours, with the paper's number in brackets; for a README."""
        cells = {}
        for (row, column), entry in self.entries.items():
            ours = "–" if math.isnan(entry.worse) else f"{entry.worse:.0f}"
            paper = TABLE_IV.get((row, column))
            cells[row, column] = ours if paper is None else f"{ours} ({paper})"
        return matrix(f"{self.experiment.key}-significance", self._caption("ours (paper)"), self.methods, cells)

    def grids(self) -> list[Sheet]:
        """Ours, the paper's, and the variants."""
        key = self.experiment.key
        ours, paper = self._cells("worse"), {k: float(v) for k, v in TABLE_IV.items() if set(k) <= set(self.methods)}
        known = tuple(m for m in self.methods if m in TABLE_IV_ORDER)
        intervals = {pair: RANGE.show(entry.interval) for pair, entry in self.entries.items() if entry.worlds}
        holm, rank = self._cells("worse_holm"), self._cells("worse_rank")
        return [
            matrix(f"{key}-worse", self._caption("this twin"), self.methods, ours),
            matrix(f"{key}-paper", "Table IV, paper: 300 worlds, 12 runs", known, paper),
            matrix(f"{key}-holm", self._caption("Holm-corrected over the worlds"), self.methods, holm),
            matrix(f"{key}-rank", self._caption("Mann-Whitney's rank test"), self.methods, rank),
            matrix(f"{key}-interval", self._caption("95 % bootstrap interval"), self.methods, intervals),
        ]

    def pairs(self) -> Sheet:
        """All of it, one line per pair, with bootstrap intervals."""
        columns = (
            Column("row", "method"),
            Column("column", "worse than"),
            Column("worlds", "worlds", COUNT),
            Column("worse", "[%]", ONE),
            Column("interval", "95 % interval", RANGE),
            Column("worse_holm", "Holm [%]", ONE),
            Column("worse_rank", "ranks [%]", ONE),
            Column("paper", "paper [%]", COUNT),
        )
        rows = []
        for row in self.methods:
            for column in self.methods:
                if row != column:
                    e = self.entries[row, column]
                    paper = TABLE_IV.get((row, column))
                    rows.append((row, column, e.worlds, e.worse, e.interval, e.worse_holm, e.worse_rank, paper))
        note = "Interval: percentile bootstrap over the worlds. Holm: corrected over the worlds of one entry."
        return Sheet(f"{self.experiment.key}-pairs", f"{self.experiment.title}: all pairs", columns, tuple(rows), note)

    def _cells(self, name: str) -> dict[tuple[str, str], float]:
        return {pair: getattr(entry, name) for pair, entry in self.entries.items()}

    def _caption(self, what: str) -> str:
        low, high = self.worlds
        count = f"{low}" if low == high else f"{low} to {high}"
        return f"Table IV, {what}: {count} worlds, {len(self.experiment.plan)} runs"


# --- contexts --------------------------------------------------------------------------------------------------------


def contexts_sheet(experiment: Experiment) -> Sheet | None:
    """Mean share of the ticks that every context was in force; None when only the default drove."""
    rows = [row for row in experiment.rows if row.contexts and row.policy]
    labels = sorted({label for row in rows for label in row.contexts or {}}, key=lambda name: (name != "default", name))
    if not rows:
        return None
    lines = []
    for world in experiment.worlds if experiment.is_courses else ("",):
        for method in experiment.methods:
            found = [r.contexts or {} for r in rows if r.method == method and (not world or r.world == world)]
            if found:
                shares = [100.0 * mean(np.array([shares.get(label, 0.0) for shares in found])) for label in labels]
                lines.append((*((world,) if world else ()), method, *shares))
    columns = (
        *((Column("course", "course"),) if experiment.is_courses else ()),
        Column("method", "method"),
        *(Column(label, f"{label} [%]", ONE) for label in labels),
    )
    caption = f"{experiment.title}: share of time in every context"
    return Sheet(f"{experiment.key}-contexts", caption, columns, tuple(lines), heat=True)


# --- at a glance -----------------------------------------------------------------------------------------------------


def glance_sheet(facts: Facts, significance: Mapping[str, Significance]) -> Sheet:
    """The few numbers that the paper's claims rest on."""
    columns = (
        Column("what", "what"),
        Column("where", "where"),
        Column("ours", "this twin", SHORT),
        Column("paper", "paper", SHORT),
    )
    rows: list[tuple[object, ...]] = []
    for experiment in facts.experiments:
        for world in experiment.worlds if experiment.is_courses else ():
            for method in ("A+c", "A+B+c"):
                ours = mean(experiment.times.get((world, method), np.empty(0)))
                default = mean(experiment.times.get((world, PLAIN), np.empty(0)))
                paper = COURSES.get(world)
                ratio = paper[method][0] / paper[PLAIN][0] if paper else None
                if not math.isnan(ours / default):
                    rows.append((f"time of {method} / default", world, ours / default, ratio))
        found = significance.get(experiment.key)
        for row, column in CLAIMS if found else ():
            entry = found.entry(row, column) if found else None
            if entry:
                what = f"{row} worse than {column} [% of worlds]"
                rows.append((what, f"{experiment.key}, {entry.worlds} worlds", entry.worse, TABLE_IV[row, column]))
    return Sheet("glance", "What the paper's claims rest on", columns, tuple(rows))


# Entries of table IV: what learning gains, what it costs, what the confidence and the demonstrations are worth
CLAIMS = ((PLAIN, "A+B+c"), ("A+B+c", PLAIN), ("A+c", PLAIN), ("A", "A+c"), ("A+B+c", "A+B+D+c"))
