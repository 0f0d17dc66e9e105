"""What the report stands on: the rows of one version, sorted into experiments, and what is missing in each."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from scenarios.errors import UserError
from scenarios.report.paper import in_order
from scenarios.statistics import PENALTIES, Array, one_version, times_by_cell
from scenarios.store import Store, StoredTrial

Place = tuple[str, str, int, int]  # world, method, seed, run

TITLES = {"courses": "Courses", "barn": "BARN worlds", "barn-like": "Generated BARN-like worlds"}


@dataclass(frozen=True, slots=True)
class Experiment:
    """Worlds of one kind under one protocol, all methods, all runs."""

    key: str  # courses, barn, barn-like; with the protocol where it is not the paper's
    title: str
    protocol: str
    rows: tuple[StoredTrial, ...]  # the finished trials
    errors: tuple[StoredTrial, ...]  # those that raised
    worlds: tuple[str, ...]
    methods: tuple[str, ...]
    plan: tuple[tuple[int, int], ...]  # (seed, run): every one that any world and method has
    times: Mapping[tuple[str, str], Array]  # (world, method) -> penalised times [s]
    full: Mapping[tuple[str, str], Array]  # the same where all runs of the plan are there: what tests are made with

    @property
    def is_courses(self) -> bool:
        """Courses are looked at one by one, BARN worlds all together."""
        return self.protocol == "course"

    def missing(self) -> list[Place]:
        """The trials that are not finished."""
        there = {(row.world, row.method, row.seed, row.run) for row in self.rows}
        places = ((w, m, s, r) for w, m, (s, r) in product(self.worlds, self.methods, self.plan))
        return [place for place in places if place not in there]

    def common_worlds(self, methods: Sequence[str] = ()) -> list[str]:
        """Worlds in which these methods, or all, have all runs."""
        return [w for w in self.worlds if all((w, m) in self.full for m in methods or self.methods)]


@dataclass(frozen=True, slots=True)
class Facts:
    """All that is reported on."""

    sources: tuple[tuple[str, int, int], ...]  # file name, finished trials, failed trials
    experiments: tuple[Experiment, ...]
    code: str  # digest
    policies: Mapping[str, str]  # method -> digest, for the methods that have one
    set_aside: int  # finished trials of other versions, not reported on

    @property
    def rows(self) -> list[StoredTrial]:
        """The finished trials of all experiments."""
        return [row for experiment in self.experiments for row in experiment.rows]

    @property
    def missing(self) -> int:
        """How many trials are not there."""
        return sum(len(experiment.missing()) for experiment in self.experiments)


def read_facts(results: str, pick: str = "") -> Facts:
    """The facts in one or more results files, with commas between. Raises UserError."""
    names = [name.strip() for name in results.split(",")]
    if not all(names):
        raise UserError(f"write results files with commas between and no blank ones, not {results!r}")
    rows: dict[str, StoredTrial] = {}
    sources = []
    for name in dict.fromkeys(names):
        with Store.open(Path(name)) as store:
            found = store.rows()
        counts = Counter(row.status for row in found)
        sources.append((Path(name).name, counts["done"], counts["error"]))
        for row in found:
            _merge(rows, row, name)
    if not any(row.status == "done" for row in rows.values()):
        failed = f" ({len(rows)} failed)" if rows else ""
        raise UserError(f"{results} holds no finished trials{failed}; make some with: appli sweep --out {names[0]} ...")
    if unknown := {row.protocol for row in rows.values()} - set(PENALTIES):
        raise UserError(f"{results}: no penalty is known for the protocol {min(unknown)}; take {', '.join(PENALTIES)}")
    done = one_version(rows.values(), pick)
    policies = {row.method: row.policy for row in done}
    contents = {(row.world, row.protocol): row.world_digest for row in done}
    errors = [
        row
        for row in rows.values()
        if row.status == "error"
        and row.code == done[0].code
        and row.policy == policies.get(row.method, row.policy)
        and row.world_digest == contents.get((row.world, row.protocol), row.world_digest)
    ]
    return Facts(
        sources=tuple(sources),
        experiments=_experiments(done, errors),
        code=done[0].code,
        policies={method: policies[method] for method in in_order(set(policies)) if policies[method]},
        set_aside=sum(row.status == "done" for row in rows.values()) - len(done),
    )


def _merge(rows: dict[str, StoredTrial], row: StoredTrial, name: str) -> None:
    """A trial may stand in several files, but with one result."""
    before = rows.get(row.key)
    if before is None or (before.status == "error" and row.status == "done"):
        rows[row.key] = row
    elif before.status == row.status == "done" and before.facts() != row.facts():
        what = f"{row.world}, {row.method}, run {row.run}"
        raise UserError(f"{name} contradicts another results file in the trial {what}; leave one of them out")


def _experiments(done: Sequence[StoredTrial], errors: Sequence[StoredTrial]) -> tuple[Experiment, ...]:
    kinds = {_kind(row) for row in (*done, *errors)}
    order = list(TITLES)
    made = []
    for family, protocol in sorted(kinds, key=lambda kind: (order.index(kind[0]), kind[1])):
        kind = (family, protocol)
        rows = sorted((row for row in done if _kind(row) == kind), key=_place)
        failed = sorted((row for row in errors if _kind(row) == kind), key=_place)
        plan = tuple(sorted({(row.seed, row.run) for row in (*rows, *failed)}))
        times = times_by_cell(rows)
        usual = protocol in ("course", "appli")
        made.append(
            Experiment(
                key=family if usual else f"{family}-{protocol}",
                title=TITLES[family] if usual else f"{TITLES[family]}, protocol {protocol}",
                protocol=protocol,
                rows=tuple(rows),
                errors=tuple(failed),
                worlds=tuple(sorted({row.world for row in (*rows, *failed)}, key=_natural)),
                methods=in_order({row.method for row in (*rows, *failed)}),
                plan=plan,
                times=times,
                full={cell: found for cell, found in times.items() if len(found) == len(plan)},
            )
        )
    return tuple(made)


def _kind(row: StoredTrial) -> tuple[str, str]:
    if row.protocol == "course":
        return "courses", row.protocol
    return "barn-like" if row.world.startswith("barn-like/") else "barn", row.protocol


def _place(row: StoredTrial) -> tuple[tuple[str, int], str, int, int]:
    return _natural(row.world), row.method, row.seed, row.run


def _natural(name: str) -> tuple[str, int]:
    """world_9 before world_10."""
    match = re.fullmatch(r"(.*?)(\d{1,9})", name)
    return (match.group(1), int(match.group(2))) if match else (name, 0)
