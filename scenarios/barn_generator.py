"""`barn-like/K`: worlds made by BARN's published recipe, reproducible from the index alone.

Recipe (dataset paper and the authors' public description): 12 sets of parameters, 25 accepted worlds each. A random
fill is smoothed by a cellular automaton; the C-space of a 0.75 m square must have one way through; a path is searched
between random rows of its two openings. The random numbers are ours, so the worlds are new ones of the same kind.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from scenarios.barn import SIZE, Grid, PathEnds, c_space, passage
from twin.records import frozen_array

Cell = tuple[int, int]  # row, col

COUNT = 300  # worlds (published)
WORLDS_PER_SET = 25  # (published)
FILLS = (0.15, 0.20, 0.25, 0.30)  # initial share of filled cells (published)
SMOOTHINGS = (2, 3, 4)  # steps of the automaton (published)
FILL_FROM = 5  # filled neighbours that fill a cell (published)
EMPTY_UP_TO = 1  # filled neighbours that leave a cell empty (published)
NEAR_CELLS = 2.0  # clearance up to which the path search avoids a cell (published: 0.30 m)
NEAR_COST = 5.0  # divided by the clearance [cells] (published)
_SEED = 20_200_831  # ours; with the index it decides the world

# Moves in the order in which they turn; a move may be followed by itself or one of its two neighbours (45 degrees).
MOVES: tuple[Cell, ...] = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))


@dataclass(frozen=True, slots=True)
class GeneratedWorld:
    """A world and the reference path through it."""

    index: int
    fill: float
    smoothing: int
    grid: Grid  # (30, 30) [row, col]
    path: NDArray[np.int64]  # (n, 2) [row, col]; the first cell stands twice, as in the published paths

    @property
    def ends(self) -> PathEnds:
        """Rows in which the path begins and ends."""
        return PathEnds(int(self.path[0, 0]), int(self.path[-1, 0]))


@cache
def generated_world(index: int) -> GeneratedWorld:
    """World `index`, 0..299. Fill and smoothing grow with the index as they do in BARN."""
    if not 0 <= index < COUNT:
        raise ValueError(f"generated worlds are numbered 0..{COUNT - 1}, not {index}")
    fill = FILLS[index // (WORLDS_PER_SET * len(SMOOTHINGS))]
    smoothing = SMOOTHINGS[index // WORLDS_PER_SET % len(SMOOTHINGS)]
    rng = np.random.default_rng([_SEED, index])
    while True:
        grid = random_grid(rng, fill, smoothing)
        region = passage(grid)
        if region is None:
            continue
        first = int(rng.choice(np.flatnonzero(region[:, 0])))
        last = int(rng.choice(np.flatnonzero(region[:, -1])))
        path = reference_path(grid, first, last)
        if path is not None:
            return GeneratedWorld(index, fill, smoothing, frozen_array(grid), frozen_array(path))


def random_grid(rng: np.random.Generator, fill: float, smoothing: int) -> Grid:
    """(30, 30) a random fill between two filled side walls, smoothed."""
    grid = (rng.random((SIZE, SIZE)) < fill).astype(np.uint8)
    grid[[0, -1]] = 1
    for _ in range(smoothing):
        grid = smoothed(grid)
    return grid


def smoothed(grid: Grid) -> Grid:
    """One step of the automaton. Outside rows count as filled, outside columns as empty."""
    padded = np.zeros((SIZE + 2, SIZE + 2), dtype=np.int64)
    padded[[0, -1]] = 1  # rows first: beyond a corner is filled, too
    padded[1:-1, 1:-1] = grid
    in_rows = padded[:-2] + padded[1:-1] + padded[2:]
    neighbours = in_rows[:, :-2] + in_rows[:, 1:-1] + in_rows[:, 2:] - grid
    return np.where(neighbours >= FILL_FROM, 1, np.where(neighbours <= EMPTY_UP_TO, 0, grid)).astype(np.uint8)


def reference_path(grid: Grid, first: int, last: int) -> NDArray[np.int64] | None:
    """(n, 2) the path from row `first` of column 0 to row `last` of column 29; None when the search fails.

    The published search, which reproduces all 100 published paths cell for cell from their ends. It is a best-first
    search whose order is not quite A*'s: length so far, plus the penalty of a cell close to an obstacle, which orders
    the search but is not carried along the path; the straight distance to the goal counts only once a better way to a
    cell already waiting has been found. Equals go first come, first served.
    """
    blocked = c_space(grid)
    clearance = ndimage.distance_transform_edt(blocked == 0)
    start, goal = (first, 0), (last, SIZE - 1)
    length: dict[Cell, float] = {start: 0.0}
    parent: dict[Cell, Cell] = {}
    waiting: dict[Cell, float] = {start: 0.0}  # cell -> rank, in the order of discovery
    done: set[Cell] = set()
    while waiting:
        cell = min(waiting, key=waiting.__getitem__)
        del waiting[cell]
        done.add(cell)
        if cell == goal:
            return _trace(parent, cell)
        for move in _allowed_moves(cell, parent.get(cell)):
            neighbour = (cell[0] + move[0], cell[1] + move[1])
            if neighbour in done or not _passable(blocked, cell, move):
                continue
            new_length = length[cell] + math.hypot(*move)
            near = float(clearance[neighbour])
            penalty = NEAR_COST / near if near <= NEAR_CELLS else 0.0
            if neighbour not in waiting:
                waiting[neighbour] = new_length + penalty
            elif new_length < length[neighbour]:
                waiting[neighbour] = new_length + math.dist(neighbour, goal) + penalty
            else:
                continue
            length[neighbour] = new_length
            parent[neighbour] = cell
    return None


def _allowed_moves(cell: Cell, came_from: Cell | None) -> list[Cell]:
    """Straight on, or 45 degrees to either side; any move at the start."""
    if came_from is None:
        return list(MOVES)
    k = MOVES.index((cell[0] - came_from[0], cell[1] - came_from[1]))
    return [MOVES[(k + turn) % len(MOVES)] for turn in (-1, 0, 1)]


def _passable(blocked: Grid, cell: Cell, move: Cell) -> bool:
    """The next cell is free and inside, and a diagonal move does not squeeze between two blocked cells."""
    row, col = cell[0] + move[0], cell[1] + move[1]
    if not (0 <= row < SIZE and 0 <= col < SIZE) or blocked[row, col]:
        return False
    return not (blocked[row, cell[1]] and blocked[cell[0], col])


def _trace(parent: dict[Cell, Cell], cell: Cell) -> NDArray[np.int64]:
    path = [cell]
    while path[-1] in parent:
        path.append(parent[path[-1]])
    return np.array([path[-1], *reversed(path)], dtype=np.int64)
