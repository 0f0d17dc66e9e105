"""World and cell coordinates of a costmap, as `costmap_2d::Costmap2D` computes them.

A grid is an (ny, nx) array indexed [y, x]; y grows upwards in the world. `origin_x, origin_y` [m] is the lower-left
corner of cell (0, 0), `resolution` [m] the side of a cell. All arithmetic is f64 with real divisions, because a
multiplication by the inverse puts points near a cell border into another cell than ROS does.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.compiled import compiled
from twin.records import Bytes

FREE = 0
INSCRIBED = 253  # cost of a cell closer to an obstacle than the inscribed radius
LETHAL = 254
NO_INFORMATION = 255


@compiled
def axis_cell(w: float, origin: float, resolution: float, size: int) -> int:
    """`worldToMap` on one axis: the cell index of the coordinate w [m], or -1 when it is off the map (or NaN)."""
    if not w >= origin:
        return -1
    cells = (w - origin) / resolution
    if not cells < size:
        return -1
    return int(cells)


@compiled
def world_to_cell(
    wx: float, wy: float, origin_x: float, origin_y: float, resolution: float, size_x: int, size_y: int
) -> tuple[int, int]:
    """`worldToMap`: the cell (x, y) of a point [m]; (-1, -1) when the point is off the map."""
    mx = axis_cell(wx, origin_x, resolution, size_x)
    my = axis_cell(wy, origin_y, resolution, size_y)
    if mx < 0 or my < 0:
        return -1, -1
    return mx, my


@compiled
def clamped_axis_cell(w: float, origin: float, resolution: float, size: int) -> int:
    """`worldToMapEnforceBounds` on one axis: coordinates beyond the map give its first or last cell."""
    if w < origin:
        return 0
    if w >= resolution * size + origin:
        return size - 1
    # The formula may round up to `size` although the comparison above let w through; ROS clips the window later.
    return int((w - origin) / resolution)


@compiled
def cell_to_world(m: int, origin: float, resolution: float) -> float:
    """`mapToWorld` on one axis: the coordinate [m] of the centre of cell m."""
    return origin + (m + 0.5) * resolution


@compiled
def eights(flat: Bytes) -> NDArray[np.uint64]:
    """A C-contiguous grid's bytes (n,) in groups of eight (n // 8,), to pass over free space quickly."""
    return flat[: len(flat) // 8 * 8].view(np.uint64)


def cell_distance(distance: float, resolution: float) -> int:
    """`cellDistance`: a metric distance in whole cells, rounded up: 0.30 m is 6 cells of 0.05, 0.02 m is 1."""
    return max(0, math.ceil(distance / resolution))


def size_in_metres(cells: int, resolution: float) -> float:
    """What `getSizeInMetersX` answers: half a cell less than the cells cover (9.975 m for 200 cells of 0.05)."""
    return (cells - 1 + 0.5) * resolution
