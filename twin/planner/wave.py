"""A breadth-first wave over the local costmap that can stop and go on: the machinery of both map grids.

A border of blocked cells surrounds the map, so that spreading needs no bounds checks: cell (x, y) of the costmap has
index (y + 1) * width + x + 1 with width = nx + 2. The wave is first in, first out, so a value is final once set,
and every cell not yet met is at least as far away as the cell at the head of the queue.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.compiled import compiled
from twin.planner.grid import INSCRIBED
from twin.records import Bytes

Cells = NDArray[np.int32]

UNMET, BLOCKED = -1, -2
"""Values of cells that the wave has not met and of those that stop it; others are steps from the nearest seed."""

HEAD, TAIL = 0, 1


class Wave(NamedTuple):
    """One wave. The arrays are scratch that the functions below write."""

    value: Cells  # ((ny + 2) * (nx + 2),) steps, UNMET or BLOCKED
    queue: Cells  # met cells in the order met
    ends: Cells  # (2,) queue position of the next cell to spread from, and of the next free place
    width: int  # nx + 2


def empty_wave(ny: int, nx: int) -> Wave:
    """Scratch for a costmap of ny x nx cells."""
    size = (ny + 2) * (nx + 2)
    # Spreading writes each neighbour to the queue before it knows whether it is new: hence one place to spare.
    return Wave(
        np.full(size, BLOCKED, dtype=np.int32), np.empty(size + 1, dtype=np.int32), np.zeros(2, dtype=np.int32), nx + 2
    )


@compiled
def clear(wave: Wave, cells: Bytes) -> None:
    """No seeds; cells of cost 253 and more block. (The border was blocked at birth and never changes.)"""
    wave.ends[HEAD], wave.ends[TAIL] = 0, 0
    size_y, size_x = cells.shape
    for y in range(size_y):
        row = wave.value[(y + 1) * wave.width + 1 : (y + 1) * wave.width + 1 + size_x]
        for x in range(size_x):
            row[x] = np.int32(UNMET) - np.int32(cells[y, x] >= INSCRIBED)


@compiled
def seed(wave: Wave, index: int) -> None:
    """Start (also) here, whatever the cost of the cell."""
    if wave.value[index] != 0:
        wave.value[index] = 0
        wave.queue[wave.ends[TAIL]] = index
        wave.ends[TAIL] += 1


@compiled
def spread_from(value: Cells, queue: Cells, tail: int, index: int, width: int) -> int:
    """Meet the four neighbours of a cell, in ROS's order; returns the new tail. Without branches: they mispredict."""
    steps = value[index] + np.int32(1)
    for step in (-1, 1, -width, width):
        neighbour = index + step
        old = value[neighbour]
        new = old == UNMET
        value[neighbour] = steps if new else old
        queue[tail] = neighbour
        tail += new
    return tail


@compiled
def reach(wave: Wave, index: int) -> int:
    """The cell's final steps, for which the wave goes on as far as it must; UNMET if it never gets there."""
    value, queue = wave.value, wave.queue
    head, tail = wave.ends[HEAD], wave.ends[TAIL]
    while value[index] == UNMET and head < tail:
        tail = spread_from(value, queue, tail, queue[head], wave.width)
        head += 1
    wave.ends[HEAD], wave.ends[TAIL] = head, tail
    steps: int = value[index]
    return steps


@compiled
def finish(wave: Wave) -> None:
    """Let the wave meet all it can."""
    head, tail = wave.ends[HEAD], wave.ends[TAIL]
    while head < tail:
        tail = spread_from(wave.value, wave.queue, tail, wave.queue[head], wave.width)
        head += 1
    wave.ends[HEAD], wave.ends[TAIL] = head, tail


@compiled
def front(wave: Wave) -> int:
    """Steps of the cell that spreads next; -1 when the wave is over."""
    return wave.value[wave.queue[wave.ends[HEAD]]] if wave.ends[HEAD] < wave.ends[TAIL] else -1


@compiled
def at_least(wave: Wave, index: int) -> int:
    """The cell's steps or, before the wave is there, a lower bound of them; negative if it will never be."""
    steps: int = wave.value[index]
    if steps == UNMET and wave.ends[HEAD] < wave.ends[TAIL]:
        return front(wave) + 1
    return steps


@compiled
def grid_value(wave: Wave, index: int, cells: int) -> int:
    """The value of ROS's map grid: steps, `cells` (ny * nx) for an obstacle that the wave meets, else one more."""
    steps = reach(wave, index)
    if steps >= 0:
        return steps
    if steps == BLOCKED:
        for step in (-1, 1, -wave.width, wave.width):
            if wave.value[index + step] >= 0:
                return cells
        for step in (-1, 1, -wave.width, wave.width):
            if reach(wave, index + step) >= 0:
                return cells
    return cells + 1
