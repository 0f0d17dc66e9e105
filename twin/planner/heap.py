"""A binary heap of (cost, arc), cheapest first and, of equals, the lowest arc first."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.compiled import compiled
from twin.records import Array


class Heap(NamedTuple):
    """The arrays are scratch that the functions below write."""

    cost: Array  # (capacity,)
    arc: NDArray[np.int32]  # (capacity,)
    size: NDArray[np.int32]  # (1,)


def empty_heap(capacity: int) -> Heap:
    """Room for so many entries."""
    return Heap(np.empty(capacity), np.empty(capacity, dtype=np.int32), np.zeros(1, dtype=np.int32))


@compiled
def push(heap: Heap, cost: float, arc: int) -> None:
    """Add an entry."""
    k = heap.size[0]
    heap.size[0] += 1
    while k > 0:
        parent = (k - 1) // 2
        if heap.cost[parent] < cost or (heap.cost[parent] == cost and heap.arc[parent] < arc):
            break
        heap.cost[k], heap.arc[k] = heap.cost[parent], heap.arc[parent]
        k = parent
    heap.cost[k], heap.arc[k] = cost, arc


@compiled
def pop(heap: Heap) -> int:
    """Remove the first entry; returns its arc."""
    first = heap.arc[0]
    heap.size[0] -= 1
    size = heap.size[0]
    cost, arc = heap.cost[size], heap.arc[size]
    k = 0
    while 2 * k + 1 < size:
        child = 2 * k + 1
        if child + 1 < size:
            left, right = heap.cost[child], heap.cost[child + 1]
            if right < left or (right == left and heap.arc[child + 1] < heap.arc[child]):
                child += 1
        if cost < heap.cost[child] or (cost == heap.cost[child] and arc < heap.arc[child]):
            break
        heap.cost[k], heap.arc[k] = heap.cost[child], heap.arc[child]
        k = child
    heap.cost[k], heap.arc[k] = cost, arc
    return int(first)
