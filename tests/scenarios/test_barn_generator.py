"""The generator of BARN-like worlds and BARN's difficulty metrics."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from scenarios.barn import c_space, hollow, passage
from scenarios.barn_generator import COUNT, MOVES, generated_world, reference_path, smoothed
from scenarios.barn_metrics import difficulty
from scenarios.worlds import load_world

ARCHIVE = Path(__file__).resolve().parents[3] / "shared" / "barn" / "barn_100.npz"
needs_barn = pytest.mark.skipif(not ARCHIVE.is_file(), reason="BARN's data (../shared/barn) is not here")
SOME = range(0, COUNT, 23)


@pytest.fixture(scope="module")
def published() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(grid, path, metrics) of the 100 published worlds."""
    with np.load(ARCHIVE) as data:
        paths = np.split(data["path_cells"].astype(np.int64), data["path_offsets"][1:-1])
        return list(zip(data["grids"], paths, data["metrics"], strict=True))


@needs_barn
def test_metrics_are_the_published_ones(published: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> None:
    for grid, path, metrics in published:
        assert list(difficulty(grid, path).values()) == pytest.approx(metrics, abs=1e-12)


@needs_barn
def test_path_search_reproduces_the_published_paths(published: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> None:
    for grid, path, _ in published:
        assert np.array_equal(reference_path(grid, int(path[0, 0]), int(path[-1, 0])), path)


@needs_barn
@pytest.mark.slow
def test_generated_worlds_are_as_difficult_as_the_published(
    published: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> None:
    """Two-sample Kolmogorov-Smirnov per metric; one fixed set of worlds, so this cannot fail by chance."""
    ours = [generated_world(k) for k in range(0, COUNT, 3)]
    generated = [difficulty(w.grid, w.path) for w in ours]
    for k, name in enumerate(generated[0]):
        assert stats.ks_2samp([m[name] for m in generated], [m[k] for _, _, m in published]).pvalue > 0.1, name


def test_worlds_depend_on_the_index_alone() -> None:
    first = load_world("barn-like/42")
    generated_world.cache_clear()
    assert load_world("barn-like/42") == first
    assert load_world("barn-like/43").obstacles != first.obstacles
    # a fixed fingerprint: a change of the recipe or of numpy's generator must not pass unnoticed
    assert hollow(generated_world(42).grid).sum() == FINGERPRINT[0]
    assert generated_world(42).path.sum(axis=0).tolist() == FINGERPRINT[1]


FINGERPRINT = (123, [557, 435])


@pytest.mark.parametrize("index", SOME)
def test_generated_world_keeps_the_published_facts(index: int) -> None:
    world = generated_world(index)
    grid, path = world.grid, world.path
    assert world.fill == pytest.approx(0.15 + 0.05 * (index // 75))
    assert world.smoothing == 2 + index // 25 % 3
    assert grid[[0, -1]].all()
    region = passage(grid)
    assert region is not None
    assert region[tuple(path.T)].all()
    assert path[0].tolist() == path[1].tolist()
    assert (path[0, 1], path[-1, 1]) == (0, 29)
    moves = [tuple(m) for m in np.diff(path[1:], axis=0).tolist()]
    turns = [(MOVES.index(b) - MOVES.index(a)) % 8 for a, b in itertools.pairwise(moves)]
    assert set(turns) <= {0, 1, 7}  # at most 45 degrees


def test_smoothing_rule_on_cases_by_hand() -> None:
    grid = np.zeros((30, 30), dtype=np.uint8)
    grid[10, 10] = 1  # no neighbour: emptied
    grid[20, 10:12] = 1  # one neighbour each: emptied
    grid[15, 20:23] = grid[16, 20:22] = 1  # (16, 22) sees 3: stays empty; (15, 22) sees 2: stays filled
    step = smoothed(grid)
    assert not step[10, 10]
    assert not step[20, 10:12].any()
    assert step[15, 22]
    assert not step[16, 22]
    grid[14, 21:23] = 1
    grid[16, 23] = 1  # now (16, 22) sees (15, 21), (15, 22), (16, 21), (16, 23) and not enough
    assert not smoothed(grid)[16, 22]
    grid[15, 23] = 1  # the fifth
    assert smoothed(grid)[16, 22]


def test_outside_rows_count_as_filled_and_outside_columns_as_empty() -> None:
    grid = np.zeros((30, 30), dtype=np.uint8)
    grid[0, 10] = grid[0, 12] = grid[1, 10] = grid[1, 12] = 1
    assert smoothed(grid)[0, 11]  # 3 beyond the border and 4 inside
    assert smoothed(grid)[0, 10]  # 3 beyond and 1 inside: unchanged
    assert not smoothed(grid.T)[11, 0]  # 4 inside, none beyond
    assert not smoothed(grid.T)[10, 0]  # 1 inside: emptied


def test_a_straight_free_field_gives_a_straight_path() -> None:
    grid = np.zeros((30, 30), dtype=np.uint8)
    grid[[0, -1]] = 1
    path = reference_path(grid, 15, 15)
    assert path is not None
    assert path[1:].tolist() == [[15, k] for k in range(30)]
    metrics = difficulty(grid, path)
    assert metrics["tortuosity"] == 1.0
    assert metrics["closest_obstacle_cells"] == 12.0  # rows 27..29 are blocked in the C-space
    assert metrics["dispersion_changes"] == 0.0


def test_no_way_through() -> None:
    grid = np.zeros((30, 30), dtype=np.uint8)
    grid[[0, -1]] = 1
    grid[:, 15] = 1
    assert passage(grid) is None
    assert reference_path(grid, 15, 15) is None
    assert c_space(grid)[:, 13:18].all()
