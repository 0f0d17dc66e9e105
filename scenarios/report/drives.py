"""Drives done again: the store says what happened, not where; a trial repeated bit for bit says that too."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from learning.deploy import AppliDriver
from scenarios.courses import course_names
from scenarios.identity import code_digest, world_digest
from scenarios.report.facts import Experiment
from scenarios.report.policies import PolicyFile
from scenarios.statistics import traversal_time
from scenarios.store import StoredTrial
from scenarios.switches import Switches
from scenarios.trials import TrialSpec, move_base_settings, run_trial
from scenarios.worlds import load_world
from twin.planner.move_base import MoveBase
from twin.records import Array, Tick
from twin.world import World

PREFERRED = ("A+B+c", "A+B+D+c", "A+c", "A+B", "A+B+D", "A")  # whose contexts are shown: the first that was driven


@dataclass(frozen=True, slots=True)
class Trail:
    """Where a drive went, and under which context."""

    number: int  # of the picture
    row: StoredTrial
    points: Array  # (n, 2) [m] world, one per tick
    contexts: tuple[str, ...]  # one per tick


def typical(experiment: Experiment, world: str, files: Mapping[str, PolicyFile]) -> StoredTrial | None:
    """The run with the median time of the most interesting method; None where no policy is at hand."""
    for method in (*PREFERRED, *(m for m in experiment.methods if m not in PREFERRED)):
        rows = [row for row in experiment.rows if row.world == world and row.method == method and row.policy]
        if method in files and rows:
            rows.sort(key=lambda row: (traversal_time(row), row.seed, row.run))
            return rows[(len(rows) - 1) // 2]
    return None


def drive_again(
    row: StoredTrial, file: PolicyFile, number: int, say: Callable[[str], None]
) -> tuple[World, Trail] | str:
    """The drive of a row, or why it cannot be shown."""
    if row.world not in course_names():
        return f"{row.world} is not a built-in course"
    world = load_world(row.world)
    if row.code != code_digest():
        return "the trials were made by other code than this; check it out, or sweep again"
    if world_digest(world) != row.world_digest:
        return f"{row.world} has changed since it was driven; sweep again"
    say(f"driving {row.world} again with {row.method}, seed {row.seed}, run {row.run} ...")
    points: list[tuple[float, float]] = []
    contexts: list[str] = []

    def watch(tick: Tick) -> None:
        points.append((tick.true_pose.x, tick.true_pose.y))
        contexts.append(tick.decision.context)

    driver = AppliDriver(file.policy, MoveBase(move_base_settings(Switches())))
    spec = TrialSpec(row.world, row.protocol, seed=row.seed, run=row.run)
    result = run_trial(spec, world, watch, driver=driver)
    if result.digest != row.digest:
        return f"{row.world} does not come out as stored (another machine?); sweep again here"
    return world, Trail(number, row, np.array(points), tuple(contexts))
