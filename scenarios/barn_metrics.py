"""BARN's five difficulty metrics, and the comparison of generated worlds with the published ones.

    python -m scenarios.barn_metrics barn_100.npz

All metrics look at the C-space and are averaged over the cells of the reference path, in cells.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, stats

from scenarios.barn import Grid, c_space
from scenarios.barn_generator import COUNT, MOVES, generated_world
from twin.records import Array

Cells = NDArray[np.int64]  # (n, 2) [row, col]

DISPERSION_RADIUS = 3  # cells (published)

# The published ring of 16 directions, in its own order: one quadrant stands in the order (0, -1), (-2, -1), (-1, -1),
# (-1, -2), (-1, 0), which matters because changes between neighbours in the list are counted.
DISPERSION_RING = (
    *((0, 1), (1, 2), (1, 1), (2, 1), (1, 0), (2, -1), (1, -1), (1, -2)),
    *((0, -1), (-2, -1), (-1, -1), (-1, -2), (-1, 0), (-2, 1), (-1, 1), (-1, 2)),
)
AXES = ((0, 1), (1, 1), (1, 0), (1, -1))


def difficulty(grid: Grid, path: Cells) -> dict[str, float]:
    """The five published metrics of a grid and its reference path (whose first cell stands twice)."""
    blocked = c_space(grid)
    per_cell: dict[str, Callable[[Grid, Cells], Array]] = {
        "closest_obstacle_cells": closest_obstacle,
        "average_visibility_cells": average_visibility,
        "dispersion_changes": dispersion,
        "characteristic_dimension_cells": characteristic_dimension,
    }
    metrics = {name: float(np.mean(metric(blocked, path))) for name, metric in per_cell.items()}
    return metrics | {"tortuosity": tortuosity(path)}


def closest_obstacle(blocked: Grid, cells: Cells) -> Array:
    """(n,) Euclidean distance to the nearest blocked cell."""
    clearance = np.asarray(ndimage.distance_transform_edt(blocked == 0), dtype=np.float64)
    return np.asarray(clearance[tuple(cells.T)])


def average_visibility(blocked: Grid, cells: Cells) -> Array:
    """(n,) free cells seen along 8 directions, the cell itself included, over those that end at an obstacle.

    Rounded down per cell: the release was made with Python 2's division of integers.
    """
    free, hits = zip(*(_look(blocked, cells, move) for move in MOVES), strict=True)
    seen = np.sum([np.where(hit, count + 1, 0) for count, hit in zip(free, hits, strict=True)], axis=0)
    number = np.sum(hits, axis=0)
    return np.asarray(np.where(number > 0, seen // np.maximum(number, 1), 0), dtype=np.float64)


def dispersion(blocked: Grid, cells: Cells) -> Array:
    """(n,) changes between open and blocked round a ring of 16 directions.

    A direction is blocked when an obstacle lies on it within the radius. The published count takes a slanted step as
    two when a component is +2, but as one when it is -2: those look three steps far instead of two.
    """
    ring = []
    for move in DISPERSION_RING:
        steps = math.ceil(DISPERSION_RADIUS / 2) if 2 in move else DISPERSION_RADIUS
        free, hit = _look(blocked, cells, move)
        ring.append(hit & (free < steps))
    changes = np.array(ring) != np.roll(ring, 1, axis=0)
    return np.asarray(changes.sum(axis=0), dtype=np.float64)


def characteristic_dimension(blocked: Grid, cells: Cells) -> Array:
    """(n,) smallest free span over 4 axes, between the centres of the outermost free cells."""
    spans = []
    for axis in AXES:
        forth, _ = _look(blocked, cells, axis)
        back, _ = _look(blocked, cells, (-axis[0], -axis[1]))
        spans.append((forth + back) * math.hypot(*axis))
    return np.asarray(np.min(spans, axis=0), dtype=np.float64)


def tortuosity(path: Cells) -> float:
    """Length of the path over the straight distance of its ends."""
    steps = np.diff(path, axis=0).astype(np.float64)
    straight = np.linalg.norm((path[-1] - path[0]).astype(np.float64))
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum() / straight)


def challenge_path_length(path: Cells) -> float:
    """[m] that the challenge's score counts: start (-2, 3), the reference path, goal (-2, 13).

    Cells become metres as in the challenge's own scripts, 0.15 m and 0.10 m off the cylinders.
    """
    cells = path.astype(np.float64)
    points = np.stack([0.15 * cells[:, 0] - 4.575, 0.15 * cells[:, 1] + 5.075], axis=1)
    steps = np.diff(np.concatenate([[(-2.0, 3.0)], points, [(-2.0, 13.0)]]), axis=0)
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum())


def _look(blocked: Grid, cells: Cells, move: Sequence[int]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """(n,) free cells ahead along `move` until an obstacle or the border, and whether an obstacle ended the look."""
    free = np.zeros(len(cells), dtype=np.int64)
    hit = np.zeros(len(cells), dtype=bool)
    looking = np.ones(len(cells), dtype=bool)
    here = np.array(cells, dtype=np.int64)
    while looking.any():
        here = here + np.asarray(move)
        looking &= ((here >= 0) & (here < blocked.shape)).all(axis=1)
        inside = np.where(looking[:, None], here, 0)
        wall = looking & (blocked[tuple(inside.T)] == 1)
        hit |= wall
        looking &= ~wall
        free += looking
    return free, hit


# --- comparison ------------------------------------------------------------------------------------------------------


def compare(archive: Path) -> list[str]:
    """Lines of a Markdown table: generated against published metrics, two-sample Kolmogorov-Smirnov per metric."""
    with np.load(archive, allow_pickle=False) as data:
        names = [str(name) for name in data["metric_names"]]
        published, real_index = np.asarray(data["metrics"]), np.asarray(data["world_index"])
        grids, cells, offsets = data["grids"], data["path_cells"].astype(np.int64), data["path_offsets"]
    recomputed = np.array(
        [list(difficulty(g, cells[a:b]).values()) for g, a, b in zip(grids, offsets, offsets[1:], strict=False)]
    )
    worlds = [generated_world(k) for k in range(COUNT)]
    generated = np.array([list(difficulty(w.grid, w.path).values()) for w in worlds])
    lines = [
        f"Our metrics on the {len(grids)} published grids and paths: "
        f"largest difference from the published values {np.abs(recomputed - published).max():.1e}.",
        "",
        "| metric | published mean +- sd | generated mean +- sd | KS statistic | KS p-value | rank correlation with "
        "the index: published | generated |",
        "|---|---|---|---|---|---|---|",
    ]
    for k, name in enumerate(names):
        a, b = published[:, k], generated[:, k]
        test = stats.ks_2samp(a, b)
        trends = [stats.spearmanr(index, v).statistic for index, v in ((real_index, a), (range(COUNT), b))]
        lines.append(
            f"| {name} | {a.mean():.3f} +- {a.std():.3f} | {b.mean():.3f} +- {b.std():.3f} | {test.statistic:.3f} | "
            f"{test.pvalue:.3f} | {trends[0]:+.2f} | {trends[1]:+.2f} |"
        )
    return lines


def main(arguments: Sequence[str]) -> int:
    """Print the comparison."""
    if len(arguments) == 1 and not Path(arguments[0]).is_file():
        print(f"scenarios.barn_metrics: {arguments[0]}: no such file", file=sys.stderr)
        return 2
    if len(arguments) != 1:
        print("usage: python -m scenarios.barn_metrics PATH/TO/barn_100.npz", file=sys.stderr)
        return 2
    print("\n".join(compare(Path(arguments[0]))))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
