"""Inflation as `costmap_2d::InflationLayer` does it, word for word: bins keyed by distance, four neighbours each."""

from __future__ import annotations

import heapq
import math
from collections import deque

import numpy as np

from twin.planner.grid import INSCRIBED, LETHAL, NO_INFORMATION, cell_distance
from twin.planner.inflation import InflationParams, Window
from twin.records import Bytes


def cost_at(distance: float, resolution: float, inflation: InflationParams) -> int:
    """The cost byte `distance` cells from an obstacle."""
    if distance == 0:
        return LETHAL
    if distance * resolution <= inflation.inscribed_radius:
        return INSCRIBED
    factor = math.exp(-1.0 * inflation.cost_scaling_factor * (distance * resolution - inflation.inscribed_radius))
    return int((INSCRIBED - 1) * factor)


def inflate(cells: Bytes, window: Window, resolution: float, inflation: InflationParams) -> Bytes:
    """See `twin.planner.inflation.inflate`."""
    out = cells.copy()
    reach = cell_distance(inflation.radius, resolution)
    if reach == 0:
        return out
    ny, nx = cells.shape
    x0, y0, x1, y1 = window
    bins: dict[float, deque[tuple[int, int, int, int]]] = {0.0: deque()}
    keys = [0.0]
    for y in range(max(0, y0 - reach), min(ny, y1 + reach)):
        for x in range(max(0, x0 - reach), min(nx, x1 + reach)):
            if cells[y, x] == LETHAL:
                bins[0.0].append((x, y, x, y))
    seen = np.zeros(cells.shape, dtype=bool)
    while keys:
        items = bins[heapq.heappop(keys)]
        while items:
            x, y, sx, sy = items.popleft()
            if seen[y, x]:
                continue
            seen[y, x] = True
            cost = cost_at(math.hypot(abs(x - sx), abs(y - sy)), resolution, inflation)
            old = int(out[y, x])
            if old == NO_INFORMATION and (cost > 0 if inflation.inflate_unknown else cost >= INSCRIBED):
                out[y, x] = cost
            else:
                out[y, x] = max(old, cost)
            for nb_x, nb_y in ((x - 1, y), (x, y - 1), (x + 1, y), (x, y + 1)):
                if not (0 <= nb_x < nx and 0 <= nb_y < ny) or seen[nb_y, nb_x]:
                    continue
                distance = math.hypot(abs(nb_x - sx), abs(nb_y - sy))
                if distance > reach:
                    continue
                if distance not in bins:
                    bins[distance] = deque()
                    heapq.heappush(keys, distance)
                bins[distance].append((nb_x, nb_y, sx, sy))
    return out
