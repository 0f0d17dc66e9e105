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

from twin.compiled import compiled
from twin.planner.grid import INSCRIBED, LETHAL, NO_INFORMATION, eights
from twin.records import Bytes, frozen_array

Levels = NDArray[np.uint16] | NDArray[np.uint32]

MAX_SMALL_REACH = 400  # [cells] (20 m) up to here the levels fit 16 bits


class Spread(NamedTuple):
    """What depends only on the parameters, by `code` = (dy + R) * (2 R + 1) + dx + R of an offset from its source."""

    reach: int  # R [cells]
    levels: int  # how many different distances there are, 0 included
    cost: Bytes  # (codes,) the cost byte at that offset
    onward: Levels  # (codes, 4) level of the neighbour left, down, right, up; the highest number: not handed on


@lru_cache(maxsize=32)
def spread_tables(reach: int, resolution: float, cost_scaling_factor: float, inscribed_radius: float) -> Spread:
    """Tables for R = `reach` cells: distances ranked, costs (`computeCost`) and the ways onward."""
    side = 2 * reach + 1
    offsets = np.arange(-reach - 1, reach + 2)
    # np.hypot is the C library's; it gives some offsets of equal length (from R = 55 on) different distances, and ROS
    # keys its bins by what it gives.
    distance = np.hypot(np.abs(offsets)[:, None], np.abs(offsets)[None, :])
    keys, level = np.unique(distance, return_inverse=True)
    levels = int(np.count_nonzero(keys <= reach))
    kind = np.uint16 if reach <= MAX_SMALL_REACH else np.uint32
    rank = np.where(distance <= reach, level.reshape(distance.shape), np.iinfo(kind).max).astype(kind)

    cost_of = np.zeros(levels, dtype=np.uint8)
    for k, d in enumerate(keys[:levels].tolist()):
        if d == 0.0:
            cost_of[k] = LETHAL
        elif d * resolution <= inscribed_radius:
            cost_of[k] = INSCRIBED
        else:
            fall = math.exp(-1.0 * cost_scaling_factor * (d * resolution - inscribed_radius))
            cost_of[k] = int((INSCRIBED - 1) * fall)

    inner = slice(1, -1)
    cost = np.where(distance <= reach, cost_of[np.minimum(rank, levels - 1)], 0)[inner, inner]
    onward = np.full((side, side, 4), np.iinfo(kind).max, dtype=kind)
    steps = offsets[inner]
    onward[:, :, 0] = np.where(steps[None, :] <= 0, rank[inner, :-2], onward[:, :, 0])
    onward[:, :, 1] = np.where(steps[:, None] <= 0, rank[:-2, inner], onward[:, :, 1])
    onward[:, :, 2] = np.where(steps[None, :] >= 0, rank[inner, 2:], onward[:, :, 2])
    onward[:, :, 3] = np.where(steps[:, None] >= 0, rank[2:, inner], onward[:, :, 3])
    return Spread(
        reach,
        levels,
        frozen_array(np.ascontiguousarray(cost, dtype=np.uint8).reshape(-1)),
        frozen_array(onward.reshape(side * side, 4)),
    )


class _Scratch(NamedTuple):
    """Working memory for grids of one size, clean between calls. The queues are linked lists in one pool."""

    best: Levels  # (cells,) shortest level at which a cell waits; the highest number everywhere between calls
    cell: NDArray[np.int32]  # (pool,)
    code: NDArray[np.int32]  # (pool,)
    after: NDArray[np.int32]  # (pool,) next entry of the same level, or -1


@lru_cache(maxsize=4)
def _scratch(cells: int, kind: np.dtype[np.unsignedinteger]) -> _Scratch:
    pool = 4 * cells + 1  # every cell is popped at most once and hands on at most four times; untouched pages are free
    return _Scratch(
        np.full(cells, np.iinfo(kind).max, dtype=kind),
        np.empty(pool, dtype=np.int32),
        np.empty(pool, dtype=np.int32),
        np.empty(pool, dtype=np.int32),
    )


def spread(cells: Bytes, x0: int, y0: int, x1: int, y1: int, tables: Spread, inflate_unknown: bool) -> None:
    """Inflate in place the grid (ny, nx) from the lethal cells in [x0, x1) x [y0, y1)."""
    memory = _scratch(cells.size, tables.onward.dtype)
    _spread(
        cells,
        x0,
        y0,
        x1,
        y1,
        tables.reach,
        tables.levels,
        tables.cost,
        tables.onward,
        inflate_unknown,
        memory.best,
        memory.cell,
        memory.code,
        memory.after,
    )


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
    onward: Levels,
    inflate_unknown: bool,
    best: Levels,
    cell: NDArray[np.int32],
    code: NDArray[np.int32],
    after: NDArray[np.int32],
) -> None:
    ny, nx = cells.shape
    flat = cells.ravel()
    side = 2 * reach + 1
    inner = min(x0, y0) >= reach and x1 + reach <= nx and y1 + reach <= ny  # the wave stays on the map by itself
    clean = onward[0, 0]  # the corner of the table is out of reach in every direction
    first = np.full(levels, -1, dtype=np.int32)
    last = np.full(levels, -1, dtype=np.int32)
    count = 0
    words = eights(flat)
    for y in range(y0, y1):
        n, end = y * nx + x0, y * nx + x1
        while n < end:
            if n % 8 == 0 and n + 8 <= end and words[n // 8] == 0:
                n += 8
                continue
            if flat[n] == LETHAL:
                best[n] = 0
                cell[count] = n
                code[count] = reach * side + reach
                after[count] = count + 1
                count += 1
            n += 1
    if count:
        first[0] = 0
        after[count - 1] = -1
    for level in range(levels):
        entry = int(first[level])
        while entry >= 0:
            n = int(cell[entry])
            if best[n] == level:  # else it was queued again, at a shorter distance, and is seen by now
                offset = int(code[entry])
                new, old = cost[offset], flat[n]
                if old == NO_INFORMATION:
                    if new >= INSCRIBED or (inflate_unknown and new > 0):
                        flat[n] = new
                elif new > old:
                    flat[n] = new
                x = 0 if inner else n % nx
                for k in range(4):
                    to = onward[offset, k]
                    if k == 0:
                        inside, nb, nb_code = inner or x > 0, n - 1, offset - 1
                    elif k == 1:
                        inside, nb, nb_code = inner or n >= nx, n - nx, offset - side
                    elif k == 2:
                        inside, nb, nb_code = inner or x < nx - 1, n + 1, offset + 1
                    else:
                        inside, nb, nb_code = inner or n < nx * (ny - 1), n + nx, offset + side
                    if inside and to < best[nb]:
                        best[nb] = to
                        cell[count] = nb
                        code[count] = nb_code
                        after[count] = -1
                        if first[to] < 0:
                            first[to] = count
                        else:
                            after[last[to]] = count
                        last[to] = count
                        count += 1
            entry = int(after[entry])
    for k in range(count):
        best[cell[k]] = clean
