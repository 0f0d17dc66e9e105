"""What stands in the report, in order. What is missing is a line that says how to make it."""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version

from learning.policy import EPS_U
from scenarios.identity import LIBRARIES, code_digest
from scenarios.report import policies, tables
from scenarios.report.difficulty import Difficulty, difficulty_sheet, scores
from scenarios.report.document import Block, Report, Row, Section, Text
from scenarios.report.drives import drive_again, typical
from scenarios.report.facts import Experiment, Facts
from scenarios.report.paper import METHODS
from scenarios.report.picture import Panel, Picture
from scenarios.report.policies import PolicyFile
from scenarios.report.sheet import COUNT, DIGEST, Column, Sheet

SWEEP = "appli sweep --out RESULTS.sqlite --policies DIR --methods " + ",".join(METHODS)


@dataclass(frozen=True, slots=True)
class Material:
    """What a report is made from."""

    facts: Facts
    files: Mapping[str, PolicyFile]  # method -> policy; empty when none were given
    known: Mapping[str, Difficulty]  # experiment -> difficulty of its worlds


def make_report(material: Material, draw: bool, say: Callable[[str], None] = lambda _: None) -> Report:
    """Sections in the paper's order. Without `draw` only the tables."""
    facts = material.facts
    tests = {e.key: tables.Significance(e) for e in facts.experiments if not e.is_courses and len(e.methods) > 1}
    pens = _Pens(material, say) if draw else None
    sections = [
        Section("glance", "At a glance", _glance(facts, tests)),
        Section("parameters", "Parameters (Table I)", _parameters(material)),
        Section("courses", "Courses (Tables II and III)", _courses(facts, pens)),
    ]
    many = [e for e in facts.experiments if not e.is_courses]
    sections += [Section(e.key, e.title, _many(e, material, tests.get(e.key), pens)) for e in many]
    if not many:
        line = f"No BARN worlds in this store. Make them with: {SWEEP} --worlds barn-like --runs 12"
        sections.append(Section("barn", "BARN (Table IV)", (Text(line, "missing"),)))
    sections += [
        Section("outcomes", "Outcomes", (pens.outcomes(),) if pens else ()),
        Section("contexts", "Contexts and confidence", _contexts(facts, pens)),
        Section("learning", "Learning", _learning(material, pens)),
        Section("provenance", "Provenance", _provenance(material)),
    ]
    extra = [_missing_sheet(facts)]
    extra += [tables.courses_sheet(e) for e in facts.experiments if e.is_courses]
    extra += [sheet for found in tests.values() for sheet in (found.plain(), found.pairs())]
    trials = len(facts.rows)
    status = f"{trials:,} trials"
    if facts.missing:
        status = f"Unfinished: {trials:,} of {trials + facts.missing:,} trials, {facts.missing:,} missing"
    errors = sum(len(e.errors) for e in facts.experiments)
    status += f", {errors:,} of them failed with an error" if errors and facts.missing else ""
    return Report("APPLI in the twin", status, not facts.missing, tuple(sections), tuple(extra))


class _Pens:
    """Everything that draws, loaded only when something is drawn."""

    def __init__(self, material: Material, say: Callable[[str], None]) -> None:
        from scenarios.report.figures import learning, map, shares, times

        self._times, self._shares, self._map, self._learning = times, shares, map, learning
        self._material, self._say = material, say

    def outcomes(self) -> Picture:
        return self._shares.outcomes_picture(self._material.facts)

    def worlds(self, experiment: Experiment) -> Picture | None:
        return self._times.worlds_picture(experiment)

    def courses(self, experiment: Experiment) -> Picture:
        return self._times.courses_picture(experiment)

    def difficulty(self, experiment: Experiment, known: Difficulty) -> Picture | None:
        return self._times.difficulty_picture(experiment, known)

    def confidence(self) -> Picture | None:
        thresholds = {name: file.policy.eps_u for name, file in self._material.files.items()}
        return self._shares.confidence_picture(self._material.facts, thresholds, EPS_U)

    def learning(self) -> Picture | None:
        curves = policies.curves(self._material.files)
        return self._learning.learning_picture(curves["fits"], curves["classifiers"])

    def map(self, experiment: Experiment) -> tuple[Block, ...]:
        """A map per course, and a line for every one that cannot be drawn."""
        panels: list[Panel] = []
        words: list[str] = []
        lines: dict[str, Text] = {}
        for world in experiment.worlds:
            row = typical(experiment, world, self._material.files)
            if row is None:
                line = "No map of the contexts: it needs --policies DIR, and trials of a policy on the courses."
                lines[line] = Text(line, "missing")
                continue
            found = drive_again(row, self._material.files[row.method], len(panels), self._say)
            if isinstance(found, str):
                lines[found] = Text(f"No map of the contexts: {found}.", "missing")
                continue
            panels.append(self._map.map_panel(*found))
            words.append(
                f"{row.world}: {row.method}, seed {row.seed}, run {row.run}, {row.outcome} in {row.time:.1f} s"
            )
        caption = "Contexts in force along a drive of median time, repeated bit for bit. " + "; ".join(words) + "."
        picture = (Picture("contexts", caption, tuple(panels), wide=True),) if panels else ()
        return (*picture, *lines.values())


# --- sections --------------------------------------------------------------------------------------------------------


def _glance(facts: Facts, tests: Mapping[str, tables.Significance]) -> tuple[Block, ...]:
    sheet = tables.glance_sheet(facts, tests)
    return (sheet,) if sheet.rows else (Text("Nothing that the paper reports on is in this store.", "missing"),)


def _parameters(material: Material) -> tuple[Block, ...]:
    if not material.files:
        line = "No policies given: add --policies DIR, the folder that appli train --all-methods wrote."
        return (Text(line, "missing"),)
    flatness = policies.flatness_sheet(material.files)
    return (policies.parameters_sheet(material.files), *((flatness,) if flatness else ()))


def _courses(facts: Facts, pens: _Pens | None) -> tuple[Block, ...]:
    blocks: list[Block] = []
    for experiment in facts.experiments:
        if experiment.is_courses:
            blocks += [tables.courses_sheet(experiment, world) for world in experiment.worlds]
            blocks += [pens.courses(experiment)] if pens else []
    line = f"No courses in this store. Make them with: {SWEEP} --worlds training,unseen --runs 20"
    return tuple(blocks) or (Text(line, "missing"),)


def _many(
    experiment: Experiment, material: Material, tests: tables.Significance | None, pens: _Pens | None
) -> tuple[Block, ...]:
    known = material.known.get(experiment.key)
    blocks: list[Block] = [tables.methods_sheet(experiment, scores(experiment, known) if known else None)]
    if pens:
        worlds = pens.worlds(experiment)
        blocks.append(worlds or Text("No figure over worlds: too few have all runs of all methods yet.", "missing"))
    if tests is None:
        blocks.append(Text(f"No Table IV: it needs several methods. Make them with: {SWEEP} ...", "missing"))
    else:
        low, high = tests.worlds
        count = f"{low} to {high}" if low != high else f"{low}"
        text = (
            f"Percentage of worlds in which the row's method is significantly slower than the column's (Welch's "
            f"t-test, p < 0.05). Tested: {count} of {len(experiment.worlds)} worlds, those where both methods have all "
            f"{len(experiment.plan)} runs."
        )
        blocks += [Text(text), Row(tuple(tests.grids()))]
    if known is not None:
        blocks += [difficulty_sheet(experiment, known)] if known.metrics else []
        picture = pens.difficulty(experiment, known) if pens else None
        blocks += [picture] if picture else []
        if known.strangers:
            line = (
                f"{known.strangers} worlds are left out of the difficulty metrics: give the swept files with --worlds."
            )
            blocks.append(Text(line, "missing"))
    return tuple(blocks)


def _contexts(facts: Facts, pens: _Pens | None) -> tuple[Block, ...]:
    blocks: list[Block] = []
    for experiment in facts.experiments:
        sheet = tables.contexts_sheet(experiment)
        blocks += [sheet] if sheet else []
    if pens:
        for experiment in facts.experiments:
            blocks += pens.map(experiment) if experiment.is_courses else ()
        picture = pens.confidence()
        blocks += [picture] if picture else []
    line = f"Only the default drove. Trials of policies come from: {SWEEP} ..."
    return tuple(blocks) if facts.policies else (Text(line, "missing"),)


def _learning(material: Material, pens: _Pens | None) -> tuple[Block, ...]:
    if not material.files:
        return (Text("No policies given: add --policies DIR.", "missing"),)
    sheet = policies.classifiers_sheet(material.files)
    picture = pens.learning() if pens else None
    blocks: list[Block] = [*([sheet] if sheet else []), *([picture] if picture else [])]
    if pens and picture is None:
        blocks.append(Text("These policies hold no learning curves; train them again with: appli train", "missing"))
    return tuple(blocks)


def _provenance(material: Material) -> tuple[Block, ...]:
    facts = material.facts
    if facts.code == code_digest():
        versions = ", ".join(f"{name} {version(name)}" for name in ("appli-twin", *LIBRARIES))
        code = f"Code {facts.code[:16]}, the one installed here: Python {platform.python_version()}, {versions}."
    else:
        code = f"Code {facts.code[:16]}, which is not the one installed here ({code_digest()[:16]})."
    stores = "; ".join(f"{name}: {done:,} finished, {failed:,} failed" for name, done, failed in facts.sources)
    blocks: list[Block] = [Text(f"{code} Results: {stores}.")]
    if facts.set_aside:
        blocks.append(
            Text(f"{facts.set_aside:,} finished trials of other versions are not reported on (--pick).", "warning")
        )
    blocks.append(_experiments_sheet(facts))
    columns = (
        Column("method", "method"),
        Column("digest", "policy (SHA-256)", DIGEST),
        Column("versions", "trained with"),
    )
    rows = []
    for method, digest in facts.policies.items():
        file = material.files.get(method)
        used = file.policy.provenance.versions if file else {}
        rows.append((method, digest, ", ".join(f"{name} {v}" for name, v in used.items()) or None))
    blocks += [Sheet("policies", "Policies", columns, tuple(rows))] if rows else []
    failures = Counter(
        (e.title, row.method, (row.error or "").strip().splitlines()[-1][:160] if row.error else "")
        for e in facts.experiments
        for row in e.errors
    )
    if failures:
        head = (*(Column(n, n) for n in ("where", "method", "error")), Column("trials", "trials", COUNT))
        blocks.append(Sheet("errors", "Failed trials", head, tuple((*what, n) for what, n in failures.most_common(50))))
    return tuple(blocks)


def _experiments_sheet(facts: Facts) -> Sheet:
    columns = (
        Column("experiment", "experiment"),
        Column("protocol", "protocol"),
        *(Column(name, name, COUNT) for name in ("worlds", "methods", "runs", "finished", "missing", "failed")),
    )
    rows = [
        (e.key, e.protocol, len(e.worlds), len(e.methods), len(e.plan), len(e.rows), len(e.missing()), len(e.errors))
        for e in facts.experiments
    ]
    note = "Runs: of every world and method, as many as any has. Which are missing stands in tables/missing.csv."
    return Sheet("experiments", "What was driven", columns, tuple(rows), note)


def _missing_sheet(facts: Facts) -> Sheet:
    names = ("experiment", "world", "method", "seed", "run")
    rows = tuple((e.key, *place) for e in facts.experiments for place in e.missing())
    return Sheet("missing", "Missing trials", tuple(Column(name, name) for name in names), rows)
