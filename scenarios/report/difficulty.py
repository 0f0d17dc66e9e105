"""BARN's difficulty metrics of the worlds in the store, and how they go with the times."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from scenarios import barn_files
from scenarios.agenda import expand
from scenarios.barn import Grid, barn_world
from scenarios.barn_generator import generated_world, reference_path
from scenarios.barn_metrics import challenge_path_length, difficulty
from scenarios.errors import blame
from scenarios.identity import world_digest
from scenarios.report.facts import Experiment
from scenarios.report.sheet import COUNT, SIGNED, Column, Sheet
from scenarios.statistics import barn_score, mean
from twin.world import World

METRICS = {  # as in scenarios.barn_metrics -> axis label
    "closest_obstacle_cells": "distance to the closest obstacle [cells]",
    "average_visibility_cells": "average visibility [cells]",
    "dispersion_changes": "dispersion [changes]",
    "characteristic_dimension_cells": "characteristic dimension [cells]",
    "tortuosity": "tortuosity [-]",
}


@dataclass(frozen=True, slots=True)
class Difficulty:
    """What is known of the worlds of an experiment."""

    metrics: Mapping[str, Mapping[str, float]]  # world -> metric -> value
    lengths: Mapping[str, float]  # world -> length of the challenge's path [m]
    strangers: int  # worlds of the experiment that could not be found with the contents that were driven


def measure(experiment: Experiment, worlds: str) -> Difficulty:
    """The metrics of all worlds that can be found again. `worlds`: files, as for `appli sweep`. Raises UserError."""
    wanted = {row.world: row.world_digest for row in experiment.rows}
    metrics, lengths = {}, {}
    with blame():
        sources = [name for item in worlds.split(",") if item.strip() for name in expand(item.strip())]
        generated = [w for w in wanted if w.startswith("barn-like/")]
        for source in dict.fromkeys([*generated, *sources]):
            found = _find(source, experiment.protocol)
            if found is None:
                continue
            world, grid, path = found
            if wanted.get(world.name) == world_digest(world):
                metrics[world.name] = difficulty(grid, path)
                lengths[world.name] = challenge_path_length(path)
    return Difficulty(metrics, lengths, len(wanted) - len(metrics))


def _find(source: str, protocol: str) -> tuple[World, Grid, NDArray[np.int64]] | None:
    """World, grid and reference path; None for what is no BARN world, or one without a known path."""
    if source.startswith("barn-like/"):
        made = generated_world(int(source.removeprefix("barn-like/")))
        name, grid, ends, index = source, made.grid, made.ends, made.index
    else:
        file, _, fragment = source.partition("#")
        path, suffix = Path(file), Path(file).suffix.lower()
        if suffix == ".npz":
            grid, ends, index = barn_files.read_archive(path, fragment)
        elif suffix == ".world":
            grid, ends, index = barn_files.read_world_file(path)
        elif suffix == ".npy":
            grid, ends, index = barn_files.read_grid_file(path)
        else:
            return None
        name = f"world_{index}"
    cells = reference_path(grid, ends.first, ends.last) if ends.exact else None
    return None if cells is None else (barn_world(name, index, grid, ends, protocol), grid, cells)


def scores(experiment: Experiment, known: Difficulty) -> dict[str, float]:
    """Method -> mean BARN score, under the challenge's protocol and when all paths are known."""
    if experiment.protocol != "icra22" or known.strangers:
        return {}
    return {
        method: mean(np.array([barn_score(r, known.lengths[r.world]) for r in experiment.rows if r.method == method]))
        for method in experiment.methods
    }


def mean_times(experiment: Experiment, known: Difficulty, method: str) -> dict[str, float]:
    """World -> mean time [s] of a method, where it has all runs and the world is known."""
    return {w: mean(experiment.full[w, method]) for w in known.metrics if (w, method) in experiment.full}


def difficulty_sheet(experiment: Experiment, known: Difficulty) -> Sheet:
    """Rank correlation of the mean time with every metric."""
    columns = (
        Column("method", "method"),
        Column("worlds", "worlds", COUNT),
        *(Column(name, label.partition(" [")[0], SIGNED) for name, label in METRICS.items()),
    )
    rows = []
    for method in experiment.methods:
        times = mean_times(experiment, known, method)
        found = [_correlation([known.metrics[w][name] for w in times], list(times.values())) for name in METRICS]
        rows.append((method, len(times), *found))
    caption = f"{experiment.title}: rank correlation of the mean time with BARN's difficulty metrics"
    return Sheet(f"{experiment.key}-difficulty", caption, columns, tuple(rows))


def _correlation(a: list[float], b: list[float]) -> float:
    """Spearman's; NaN where there is too little to say."""
    if len(a) < 3 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return math.nan
    return float(stats.spearmanr(a, b).statistic)
