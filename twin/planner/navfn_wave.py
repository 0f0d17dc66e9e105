"""navfn's potential field (`NavFn::propNavFnDijkstra`), bit-equal and without touching what the wave does not reach.

Potentials are f32. The working arrays are kept between plans, one set per map shape, and only what the last wave
wrote is reset, because clearing 800 x 800 potentials takes as long as a typical plan. Not for concurrent threads.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.planner.grid import INSCRIBED, NO_INFORMATION, compiled
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
    closed: Bytes  # (ny * nx,) 1: waits in a queue, or lies on the map's edge; the edge only, between waves
    queues: NDArray[np.int32]  # (3, QUEUE_CAPACITY + 4) cell indices: this cycle, next cycle, over the threshold
    dirty: NDArray[np.int64]  # (4,) cells x0, y0, x1, y1 (half-open) that hold potentials of the last wave


@lru_cache(maxsize=4)
def field(ny: int, nx: int) -> Field:
    """The working memory for maps of (ny, nx) cells."""
    closed = np.zeros((ny, nx), dtype=np.uint8)
    closed[[0, -1], :] = 1
    closed[:, [0, -1]] = 1
    return Field(
        np.full(ny * nx, UNREACHED, dtype=np.float32),
        closed.reshape(-1),
        np.empty((3, QUEUE_CAPACITY + 4), dtype=np.int32),
        np.zeros(4, dtype=np.int64),
    )


@compiled
def propagate(
    cells: Bytes,
    source: int,
    goal: int,
    enter: Potentials,
    margin: Potentials,
    potentials: Potentials,
    closed: Bytes,
    queues: NDArray[np.int32],
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

    current, following, over = queues[0], queues[1], queues[2]
    n_current, n_following, n_over = 0, 0, 0
    potentials[source] = 0.0
    lowest, highest = source, source
    for n in (source + 1, source - 1, source - nx, source + nx):
        if 0 <= n < ns and closed[n] == 0 and enter[cost[n]] < OBSTACLE:
            closed[n] = 1
            current[n_current] = n
            n_current += 1

    threshold = FIRST_THRESHOLD
    cycles = max(ns // 20, nx + ny)
    cycle = 0
    while cycle < cycles and n_current > 0:
        cycle += 1
        for i in range(n_current):
            closed[current[i]] = 0
        for i in range(n_current):
            n = int(current[i])
            left, right = potentials[n - 1], potentials[n + 1]
            low, high = potentials[n - nx], potentials[n + nx]
            tc = min(left, right)
            ta = min(low, high)
            hf = enter[cost[n]]
            dc = abs(tc - ta)
            ta = min(tc, ta)
            # The planar-wave update; its quadratic is evaluated in f64 as in C++, and rounded.
            x = dc / hf
            v = np.float32(-0.2301 * x * x + 0.5307 * x + 0.7040)
            new = ta + hf if dc >= hf else ta + hf * v
            if not new < potentials[n]:
                continue
            potentials[n] = new
            lowest, highest = min(lowest, n), max(highest, n)
            near = new < threshold
            queue = following if near else over
            count = n_following if near else n_over
            if left > new + margin[cost[n - 1]] and closed[n - 1] == 0 and count < QUEUE_CAPACITY:
                closed[n - 1] = 1
                queue[count] = n - 1
                count += 1
            if right > new + margin[cost[n + 1]] and closed[n + 1] == 0 and count < QUEUE_CAPACITY:
                closed[n + 1] = 1
                queue[count] = n + 1
                count += 1
            if low > new + margin[cost[n - nx]] and closed[n - nx] == 0 and count < QUEUE_CAPACITY:
                closed[n - nx] = 1
                queue[count] = n - nx
                count += 1
            if high > new + margin[cost[n + nx]] and closed[n + nx] == 0 and count < QUEUE_CAPACITY:
                closed[n + nx] = 1
                queue[count] = n + nx
                count += 1
            if near:
                n_following = count
            else:
                n_over = count
        current, following = following, current
        n_current, n_following = n_following, 0
        if n_current == 0:
            threshold += THRESHOLD_STEP
            current, over = over, current
            n_current, n_over = n_over, 0
        if potentials[goal] < UNREACHED:
            break

    for i in range(n_current):
        closed[current[i]] = 0
    for i in range(n_over):
        closed[over[i]] = 0
    # A wave gains at most one cell per cycle; rows are known exactly.
    dirty[0], dirty[2] = max(0, source % nx - cycle), min(nx, source % nx + cycle + 1)
    dirty[1], dirty[3] = lowest // nx, highest // nx + 1
    return bool(potentials[goal] < UNREACHED)
