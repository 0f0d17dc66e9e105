"""navfn's potential field (`NavFn::propNavFnDijkstra`), bit-equal and without touching what the wave does not reach.

Potentials are f32. The working arrays are kept between plans, one set per map shape, and only what the last wave
wrote is reset, because clearing 800 x 800 potentials takes as long as a typical plan. Not for concurrent threads.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.compiled import compiled
from twin.planner.grid import INSCRIBED, NO_INFORMATION
from twin.records import Bytes, frozen_array

Potentials = NDArray[np.float32]

UNREACHED = np.float32(1e10)  # POT_HIGH
OBSTACLE = np.float32(254.0)  # COST_OBS
QUEUE_CAPACITY = 10000  # PRIORITYBUFSIZE: what does not fit is dropped
FIRST_THRESHOLD = np.float32(254.0)  # priority block of the first cycles
THRESHOLD_STEP = np.float32(100.0)


class Costs(NamedTuple):
    """navfn's view of a costmap byte, by that byte."""

    enter: Potentials  # (256,) cost of crossing the cell; OBSTACLE: never entered
    margin: Potentials  # (256,) least improvement of a neighbour that makes the cell worth another look; inf: never


@lru_cache(maxsize=2)
def cost_tables(allow_unknown: bool) -> Costs:
    """`NavFn::setCostmap`: 0..252 -> 50..251, inscribed and lethal -> obstacle, unknown -> 253 where allowed."""
    enter = np.full(256, OBSTACLE, dtype=np.float32)
    for c in range(INSCRIBED):
        enter[c] = min(253, int(50 + 0.8 * c))
    if allow_unknown:
        enter[NO_INFORMATION] = 253
    margin = (0.707106781 * enter.astype(np.float64)).astype(np.float32)
    margin[enter >= OBSTACLE] = np.inf
    return Costs(frozen_array(enter), frozen_array(margin))


class Field(NamedTuple):
    """Working memory for one map shape."""

    potentials: Potentials  # (ny * nx,) what the last wave left
    vacant: Bytes  # (ny * nx,) 0: waits in a queue, or lies on the map's edge; only the edge, between waves
    queues: NDArray[np.uint32]  # (3 * (capacity + 1),) cell indices: this cycle, the next one, over the threshold
    dirty: NDArray[np.int64]  # (4,) cells x0, y0, x1, y1 (half-open) that hold potentials of the last wave


@lru_cache(maxsize=4)
def field(ny: int, nx: int, capacity: int = QUEUE_CAPACITY) -> Field:
    """The working memory for maps of (ny, nx) cells. A queue has a spare entry, which `_relax` may write to."""
    vacant = np.ones((ny, nx), dtype=np.uint8)
    vacant[[0, -1], :] = 0
    vacant[:, [0, -1]] = 0
    return Field(
        np.full(ny * nx, UNREACHED, dtype=np.float32),
        vacant.reshape(-1),
        np.empty(3 * (capacity + 1), dtype=np.uint32),
        np.zeros(4, dtype=np.int64),
    )


@compiled
def _bits(value: np.float32) -> np.uint32:
    """The bits of an f32; the highest one is set when it is negative."""
    return np.float32(value).view(np.uint32)


@compiled
def propagate(
    cells: Bytes,
    source: int,
    goal: int,
    enter: Potentials,
    margin: Potentials,
    potentials: Potentials,
    vacant: Bytes,
    queues: NDArray[np.uint32],
    dirty: NDArray[np.int64],
) -> bool:
    """Spread the wave over the costmap (ny, nx) from the cell index `source`; whether it reached `goal`.

    Stops after the first cycle that gave the goal a potential, so that the field near the front is not relaxed.
    """
    ny, nx = cells.shape
    ns = nx * ny
    cost = cells.ravel()
    for y in range(dirty[1], dirty[3]):
        potentials[y * nx + dirty[0] : y * nx + dirty[2]] = UNREACHED

    size = len(queues) // 3
    current, following, over = 0, size, 2 * size  # where each queue starts; the three change roles
    n_current, n_over = 0, 0
    potentials[source] = 0.0
    lowest, highest = source, source
    for n in (source + 1, source - 1, source - nx, source + nx):
        if 0 <= n < ns and vacant[n] == 1 and enter[cost[n]] < OBSTACLE:
            vacant[n] = 0
            queues[current + n_current] = n
            n_current += 1

    threshold = FIRST_THRESHOLD
    cycles = max(ns // 20, nx + ny)
    cycle = 0
    while cycle < cycles and n_current > 0:
        cycle += 1
        for i in range(current, current + n_current):
            n = int(np.int64(queues[i]))  # signed, because numba would compare a mixed pair as floats
            vacant[n] = 1
            lowest, highest = min(lowest, n), max(highest, n)
        end_following, end_over = _relax(
            cost,
            np.uint64(nx),
            queues,
            np.uint64(current),
            np.uint64(current + n_current),
            np.uint64(following),
            np.uint64(over),
            np.uint64(over + n_over),
            np.uint64(size - 1),
            threshold,
            enter,
            margin,
            potentials,
            vacant,
        )
        n_over = end_over - over
        current, following = following, current
        n_current = end_following - current
        if n_current == 0:
            threshold += THRESHOLD_STEP
            current, over = over, current
            n_current, n_over = n_over, 0
        if potentials[goal] < UNREACHED:
            break

    for i in range(current, current + n_current):
        vacant[queues[i]] = 1
    for i in range(over, over + n_over):
        vacant[queues[i]] = 1
    # A wave gains at most one column per cycle; its rows are known exactly.
    dirty[0], dirty[2] = max(0, source % nx - cycle), min(nx, source % nx + cycle + 1)
    dirty[1], dirty[3] = lowest // nx, highest // nx + 1
    return bool(potentials[goal] < UNREACHED)


@compiled
def _relax(
    cost: Bytes,
    nx: np.uint64,
    queues: NDArray[np.uint32],
    begin: np.uint64,
    end: np.uint64,
    following: np.uint64,
    over: np.uint64,
    end_over: np.uint64,
    capacity: np.uint64,
    threshold: np.float32,
    enter: Potentials,
    margin: Potentials,
    potentials: Potentials,
    vacant: Bytes,
) -> tuple[int, int]:
    """Update the cells queues[begin:end] in order; where the queues `following` and `over` end afterwards.

    Whether a cell improves and whether a neighbour is queued is close to a coin toss, and mispredicted branches took
    half of the time. So there are none: every neighbour is written at the queue's end, and the end moves on by 0 or 1.
    Indices are unsigned because numba would otherwise check each for counting from the back.
    """
    one, sign = np.uint64(1), np.uint32(31)
    end_following = following
    for i in range(begin, end):
        n = np.uint64(queues[i])
        west, east, south, north = n - one, n + one, n - nx, n + nx
        at_west, at_east, at_south, at_north = potentials[west], potentials[east], potentials[south], potentials[north]
        across = at_west if at_west < at_east else at_east
        along = at_south if at_south < at_north else at_north
        lower = across if across < along else along
        difference = abs(across - along)
        hf = enter[cost[n]]
        # The planar-wave update; its quadratic is evaluated in f64 as in C++, and rounded.
        x = difference / hf
        v = np.float32(-0.2301 * x * x + 0.5307 * x + 0.7040)
        new = lower + hf * (np.float32(1.0) if difference >= hf else v)

        before = potentials[n]
        potentials[n] = new if new < before else before
        better = _bits(new - before)
        free_west, free_east, free_south, free_north = vacant[west], vacant[east], vacant[south], vacant[north]
        push_west = np.uint8((_bits(new + margin[cost[west]] - at_west) & better) >> sign) & free_west
        push_east = np.uint8((_bits(new + margin[cost[east]] - at_east) & better) >> sign) & free_east
        push_south = np.uint8((_bits(new + margin[cost[south]] - at_south) & better) >> sign) & free_south
        push_north = np.uint8((_bits(new + margin[cost[north]] - at_north) & better) >> sign) & free_north

        near = new < threshold
        last = end_following if near else end_over
        room = (following if near else over) + capacity - last
        if room < np.uint64(4):  # what does not fit is dropped, and may be queued by another cell later
            push_west = min(push_west, np.uint8(room))
            push_east = min(push_east, np.uint8(room - np.uint64(push_west)))
            push_south = min(push_south, np.uint8(room - np.uint64(push_west) - np.uint64(push_east)))
            push_north = min(
                push_north, np.uint8(room - np.uint64(push_west) - np.uint64(push_east) - np.uint64(push_south))
            )
        vacant[west] = free_west ^ push_west
        vacant[east] = free_east ^ push_east
        vacant[south] = free_south ^ push_south
        vacant[north] = free_north ^ push_north
        queues[last] = west
        last += np.uint64(push_west)
        queues[last] = east
        last += np.uint64(push_east)
        queues[last] = south
        last += np.uint64(push_south)
        queues[last] = north
        last += np.uint64(push_north)
        end_following = last if near else end_following
        end_over = end_over if near else last
    return int(end_following), int(end_over)
