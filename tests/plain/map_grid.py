"""The map grids as `base_local_planner::MapGrid` fills them, word for word (spec section 7)."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from twin.planner.inflation import Costmap
from twin.records import Array

Cell = tuple[int, int]


def dense_points(plan: Array, resolution: float) -> list[tuple[float, float]]:
    """The plan with equally spaced points put in where two are further apart than a cell."""
    points: list[tuple[float, float]] = []
    for k, (x, y) in enumerate(plan[:, :2].tolist()):
        if k > 0:
            from_x, from_y = plan[k - 1, :2].tolist()
            gap2 = (x - from_x) ** 2 + (y - from_y) ** 2
            if gap2 > resolution**2:
                steps = math.ceil(math.sqrt(gap2) / resolution)
                points += [
                    (from_x + j * ((x - from_x) / steps), from_y + j * ((y - from_y) / steps)) for j in range(1, steps)
                ]
        points.append((x, y))
    return points


def plan_cells(costmap: Costmap, plan: Array) -> list[Cell]:
    """(x, y) of the first unbroken run of plan points that are on the map and on known cells."""
    ny, nx = costmap.cells.shape
    found: list[Cell] = []
    for x, y in dense_points(plan, costmap.resolution):
        cx, cy = (x - costmap.origin[0]) / costmap.resolution, (y - costmap.origin[1]) / costmap.resolution
        if 0 <= cx < nx and 0 <= cy < ny and costmap.cells[int(cy), int(cx)] != 255:
            found.append((int(cx), int(cy)))
        elif found:
            break
    return found


def grid(costmap: Costmap, targets: list[Cell], within_robot: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Steps from the nearest target; ny * nx on obstacles that were met, one more on what was not met."""
    ny, nx = costmap.cells.shape
    value = np.full((ny, nx), ny * nx + 1, dtype=np.int64)
    marked = np.zeros((ny, nx), dtype=bool)
    for x, y in targets:
        value[y, x], marked[y, x] = 0, True
    queue = deque(targets)
    while queue:
        x, y = queue.popleft()
        for cx, cy in ((x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)):
            if not (0 <= cx < nx and 0 <= cy < ny) or marked[cy, cx]:
                continue
            marked[cy, cx] = True
            if costmap.cells[cy, cx] >= 253 and not within_robot[cy, cx]:
                value[cy, cx] = ny * nx
            else:
                value[cy, cx] = min(value[cy, cx], value[y, x] + 1)
                queue.append((cx, cy))
    return value
