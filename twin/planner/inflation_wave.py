"""How inflation spreads from the lethal cells (`costmap_2d::InflationLayer`'s bins), fast and bit-equal.

ROS keeps one FIFO bin per distance, pops the bins in order of distance, and hands every popped cell's source on to its
four neighbours. This is not an exact distance transform: a cell may end up with a source that is not its nearest, so
the order must be kept. Two things make it quick without changing any result. A neighbour that already waits at a
shorter or equal distance is not queued again, because ROS would find it seen when it popped the second entry. And a
source is only handed on outwards, because the cells on the way back to the source have been seen before.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.planner.grid import INSCRIBED, LETHAL, NO_INFORMATION, compiled
from twin.records import Bytes, frozen_array

UNREACHED = 65535  # more than any level; R <= 400 cells (20 m) has fewer
MAX_REACH = 400  # [cells]


class Spread(NamedTuple):
    """What depends only on the parameters, by `code` = (dy + R) * (2 R + 1) + dx + R of an offset from its source."""

    reach: int  # R [cells]
    levels: int  # how many different distances there are, 0 included
    cost: Bytes  # (codes,) the cost byte at that offset
    onward: NDArray[np.uint16]  # (codes, 4) level of the neighbour left, down, right, up; UNREACHED: not handed on


@lru_cache(maxsize=64)
def spread_tables(reach: int, resolution: float, cost_scaling_factor: float, inscribed_radius: float) -> Spread:
    """Tables for R = `reach` cells: distances ranked, costs (`computeCost`) and the ways onward."""
    side = 2 * reach + 1
    offsets = np.arange(-reach, reach + 1)
    squares = offsets[:, None] ** 2 + offsets[None, :] ** 2
    distances = np.unique(squares[squares <= reach * reach])
    rank = np.full(2 * (reach + 1) ** 2 + 1, UNREACHED, dtype=np.uint16)
    rank[distances] = np.arange(len(distances))

    cost = np.zeros((side, side), dtype=np.uint8)
    onward = np.full((side, side, 4), UNREACHED, dtype=np.uint16)
    for j, dy in enumerate(offsets.tolist()):
        for i, dx in enumerate(offsets.tolist()):
            d = math.hypot(dx, dy)
            if d > reach:
                continue
            if d == 0.0:
                cost[j, i] = LETHAL
            elif d * resolution <= inscribed_radius:
                cost[j, i] = INSCRIBED
            else:
                fall = math.exp(-1.0 * cost_scaling_factor * (d * resolution - inscribed_radius))
                cost[j, i] = int((INSCRIBED - 1) * fall)
            for k, (step_x, step_y) in enumerate(((-1, 0), (0, -1), (1, 0), (0, 1))):
                if dx * step_x + dy * step_y >= 0:
                    onward[j, i, k] = rank[(dx + step_x) ** 2 + (dy + step_y) ** 2]
    return Spread(reach, len(distances), frozen_array(cost.reshape(-1)), frozen_array(onward.reshape(side * side, 4)))


class _Scratch(NamedTuple):
    """Working memory for grids of one shape, clean between calls. The queues are linked lists in one pool."""

    best: NDArray[np.uint16]  # (cells,) shortest level at which a cell waits; UNREACHED everywhere between calls
    cell: NDArray[np.int32]  # (pool,)
    code: NDArray[np.int32]  # (pool,)
    after: NDArray[np.int32]  # (pool,) next entry of the same level, or -1
    ends: NDArray[np.int32]  # (2, levels) first and last entry of each level


@lru_cache(maxsize=4)
def _scratch(cells: int, levels: int) -> _Scratch:
    pool = 4 * cells + 1  # every cell is popped at most once and hands on at most four times; untouched pages are free
    return _Scratch(
        np.full(cells, UNREACHED, dtype=np.uint16),
        np.empty(pool, dtype=np.int32),
        np.empty(pool, dtype=np.int32),
        np.empty(pool, dtype=np.int32),
        np.empty((2, levels), dtype=np.int32),
    )


def spread(cells: Bytes, x0: int, y0: int, x1: int, y1: int, tables: Spread, inflate_unknown: bool) -> None:
    """Inflate in place the grid (ny, nx) from the lethal cells in [x0, x1) x [y0, y1)."""
    scratch = _scratch(cells.size, tables.levels)
    _spread(cells, x0, y0, x1, y1, tables.reach, tables.levels, tables.cost, tables.onward, inflate_unknown, *scratch)


@compiled
def _spread(
    cells: Bytes,
    x0: int,
    y0: int,
    x1: int,
    y1: int,
    reach: int,
    levels: int,
    cost: Bytes,
    onward: NDArray[np.uint16],
    inflate_unknown: bool,
    best: NDArray[np.uint16],
    cell: NDArray[np.int32],
    code: NDArray[np.int32],
    after: NDArray[np.int32],
    ends: NDArray[np.int32],
) -> None:
    ny, nx = cells.shape
    flat = cells.ravel()
    side = 2 * reach + 1
    ends[:] = -1
    count = 0
    last = -1
    for y in range(y0, y1):
        for m in range(y * nx + x0, y * nx + x1):
            if flat[m] == LETHAL:
                best[m] = 0
                cell[count] = m
                code[count] = reach * side + reach
                after[count] = -1
                if last >= 0:
                    after[last] = count
                last = count
                count += 1
    if count:
        ends[0, 0] = 0
    for level in range(levels):
        entry = ends[0, level]
        while entry >= 0:
            n = int(cell[entry])
            if best[n] == level:
                offset = int(code[entry])
                new, old = cost[offset], flat[n]
                if old == NO_INFORMATION:
                    if new >= INSCRIBED or (inflate_unknown and new > 0):
                        flat[n] = new
                elif new > old:
                    flat[n] = new
                x = n % nx
                for k in range(4):
                    to = onward[offset, k]
                    if k == 0:
                        inside, nb, nb_code = x > 0, n - 1, offset - 1
                    elif k == 1:
                        inside, nb, nb_code = n >= nx, n - nx, offset - side
                    elif k == 2:
                        inside, nb, nb_code = x < nx - 1, n + 1, offset + 1
                    else:
                        inside, nb, nb_code = n < nx * (ny - 1), n + nx, offset + side
                    if inside and to < best[nb]:
                        best[nb] = to
                        cell[count] = nb
                        code[count] = nb_code
                        after[count] = -1
                        if ends[0, to] < 0:
                            ends[0, to] = count
                        else:
                            after[ends[1, to]] = count
                        ends[1, to] = count
                        count += 1
            entry = after[entry]
    for k in range(count):
        best[cell[k]] = UNREACHED
