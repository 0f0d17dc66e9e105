"""The robot's outline on a costmap: constants, the line walk, rasterisation and `footprintCost`.

The same padded polygon is used everywhere in move_base: collision checks, footprint clearing, the within-robot cells
of the path grid and the rotate recovery.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.compiled import compiled
from twin.planner.grid import LETHAL, NO_INFORMATION, world_to_cell
from twin.records import Array, Bytes, frozen_array

JACKAL_FOOTPRINT = ((-0.21, -0.165), (-0.21, 0.165), (0.21, 0.165), (0.21, -0.165))
"""Unpadded corners in base_link [m] (jackal_navigation/params/costmap_common_params.yaml: footprint)."""

FOOTPRINT_PADDING = 0.1  # [m] (costmap_common_params.yaml: footprint_padding)

OFF_MAP, HITS_UNKNOWN, HITS_OBSTACLE = -3, -2, -1
"""The negative answers of `footprint_cost`."""


def padded_footprint(corners: tuple[tuple[float, float], ...], padding: float) -> Array:
    """(n, 2) [m] base_link: every coordinate moved away from 0 by the padding, in the order given.

    ROS parses the corners from a string as f32 and keeps the padding in an f32 member, then adds in f64.
    """
    unpadded = np.array(corners, dtype=np.float32).astype(np.float64)
    return frozen_array(unpadded + np.sign(unpadded) * np.float64(np.float32(padding)))


def footprint_radii(footprint: Array) -> tuple[float, float]:
    """(inscribed, circumscribed) radius [m]: extreme distances of the corners and edges from the robot's centre."""
    nearest, farthest = math.inf, 0.0
    for (ax, ay), (bx, by) in zip(footprint.tolist(), np.roll(footprint, -1, axis=0).tolist(), strict=True):
        length2 = (bx - ax) ** 2 + (by - ay) ** 2
        t = 0.0 if length2 == 0.0 else min(1.0, max(0.0, -(ax * (bx - ax) + ay * (by - ay)) / length2))
        edge = math.hypot(ax + t * (bx - ax), ay + t * (by - ay))
        corner = math.hypot(ax, ay)
        nearest, farthest = min(nearest, edge, corner), max(farthest, corner)
    return nearest, farthest


FOOTPRINT = padded_footprint(JACKAL_FOOTPRINT, FOOTPRINT_PADDING)
"""(4, 2) [m] base_link: the padded corners in the order (-,-), (-,+), (+,+), (+,-): +-0.31 x +-0.265."""

INSCRIBED_RADIUS, CIRCUMSCRIBED_RADIUS = footprint_radii(FOOTPRINT)


@compiled
def line_cells(x0: int, y0: int, x1: int, y1: int, size_x: int, cells: NDArray[np.int32], start: int) -> int:
    """Walk from cell (x0, y0) to (x1, y1), both included (`LineIterator`).

    Writes the flat indices y * size_x + x into `cells` from position `start` on and returns the position after the
    last one; the walk has max(|x1 - x0|, |y1 - y0|) + 1 cells. Nothing is checked against the map.
    """
    dx, dy = abs(x1 - x0), abs(y1 - y0)
    step_x = 1 if x1 >= x0 else -1
    step_y = size_x if y1 >= y0 else -size_x
    den, add, major, minor = (dx, dy, step_x, step_y) if dx >= dy else (dy, dx, step_y, step_x)
    num = den // 2
    index = y0 * size_x + x0
    cells[start] = index
    for k in range(start + 1, start + den + 1):
        num += add
        if num >= den:
            num -= den
            index += minor
        index += major
        cells[k] = index
    return start + den + 1


@compiled
def line_cost(flat: Bytes, size_x: int, x0: int, y0: int, x1: int, y1: int) -> int:
    """The highest cost byte on the line walk, or HITS_UNKNOWN / HITS_OBSTACLE at the first such cell."""
    dx, dy = abs(x1 - x0), abs(y1 - y0)
    step_x = 1 if x1 >= x0 else -1
    step_y = size_x if y1 >= y0 else -size_x
    den, add, major, minor = (dx, dy, step_x, step_y) if dx >= dy else (dy, dx, step_y, step_x)
    num = den // 2
    index = y0 * size_x + x0
    highest = 0
    for _ in range(den + 1):
        cost = int(np.int64(flat[index]))  # int64, because numba would unify uint64 with the negative answers as float
        if cost >= LETHAL:
            return HITS_UNKNOWN if cost == NO_INFORMATION else HITS_OBSTACLE
        if cost > highest:
            highest = cost
        num += add
        if num >= den:
            num -= den
            index += minor
        index += major
    return highest


@compiled
def footprint_cost(
    cells: Bytes,
    origin_x: float,
    origin_y: float,
    resolution: float,
    x: float,
    y: float,
    yaw: float,
    footprint: Array,
) -> int:
    """`CostmapModel::footprintCost`: the highest cost byte under the outline of the footprint at a pose.

    `cells` is (ny, nx) and C-contiguous, the pose is in the map's frame [m, rad], `footprint` (n, 2) [m] in base_link.
    Returns 0..253, or OFF_MAP, HITS_UNKNOWN, HITS_OBSTACLE, whichever the walk along the edges meets first. Only the
    outline is tested, never the interior, and 253 on it is legal. Fewer than 3 corners: the centre cell decides.
    """
    size_y, size_x = cells.shape
    flat = cells.ravel()
    cx, cy = world_to_cell(x, y, origin_x, origin_y, resolution, size_x, size_y)
    if cx < 0:
        return OFF_MAP
    corners = footprint.shape[0]
    if corners < 3:
        cost = int(np.int64(flat[cy * size_x + cx]))
        if cost == NO_INFORMATION:
            return HITS_UNKNOWN
        return HITS_OBSTACLE if cost >= LETHAL - 1 else cost
    c, s = math.cos(yaw), math.sin(yaw)
    px, py = footprint[0, 0], footprint[0, 1]
    first_x, first_y = world_to_cell(
        x + (px * c - py * s), y + (px * s + py * c), origin_x, origin_y, resolution, size_x, size_y
    )
    if first_x < 0:
        return OFF_MAP
    highest = 0
    ax, ay = first_x, first_y
    for k in range(1, corners + 1):
        if k < corners:
            px, py = footprint[k, 0], footprint[k, 1]
            bx, by = world_to_cell(
                x + (px * c - py * s), y + (px * s + py * c), origin_x, origin_y, resolution, size_x, size_y
            )
            if bx < 0:
                return OFF_MAP
        else:
            bx, by = first_x, first_y
        cost = line_cost(flat, size_x, ax, ay, bx, by)
        if cost < 0:
            return cost
        highest = max(highest, cost)
        ax, ay = bx, by
    return highest


class Raster(NamedTuple):
    """What `footprint_cells` found."""

    length: int  # cells written
    complete: bool  # False: a corner is off the map, only the edges before it were walked, nothing was filled


@compiled
def footprint_cells(
    origin_x: float,
    origin_y: float,
    resolution: float,
    size_x: int,
    size_y: int,
    x: float,
    y: float,
    yaw: float,
    footprint: Array,
    cells: NDArray[np.int32],
) -> Raster:
    """The flat cell indices under the footprint at a pose: its outline, then each column filled between its extremes.

    Writes into `cells`; `raster_capacity` says how long it must be. With all corners on the map every cell comes
    exactly once. When corner k is off the map only the cells of the edges that end before corner k are written
    (`FootprintHelper::getFootprintCells`), some of them twice, and the raster is not complete.
    """
    c, s = math.cos(yaw), math.sin(yaw)
    corners = footprint.shape[0]
    count = 0
    first_x, first_y, ax, ay = -1, -1, -1, -1
    low_x, high_x = size_x, -1
    for k in range(corners + 1):
        if k < corners:
            px, py = footprint[k, 0], footprint[k, 1]
            bx, by = world_to_cell(
                x + (px * c - py * s), y + (px * s + py * c), origin_x, origin_y, resolution, size_x, size_y
            )
            if bx < 0:
                return Raster(count, False)
            low_x, high_x = min(low_x, bx), max(high_x, bx)
        else:
            bx, by = first_x, first_y
        if k == 0:
            first_x, first_y = bx, by
        else:
            count = line_cells(ax, ay, bx, by, size_x, cells, count)
        ax, ay = bx, by

    low = np.full(high_x - low_x + 1, size_y, dtype=np.int32)
    high = np.full(high_x - low_x + 1, -1, dtype=np.int32)
    for k in range(count):
        row, column = cells[k] // size_x, cells[k] % size_x - low_x
        low[column] = min(low[column], row)
        high[column] = max(high[column], row)
    count = 0
    for column in range(len(low)):
        for row in range(low[column], high[column] + 1):
            cells[count] = row * size_x + column + low_x
            count += 1
    return Raster(count, True)


@compiled
def raster_capacity(footprint: Array, resolution: float) -> int:
    """How many entries the `cells` buffer of `footprint_cells` needs at any pose on any map of that resolution."""
    radius = 0.0
    for k in range(footprint.shape[0]):
        radius = max(radius, math.hypot(footprint[k, 0], footprint[k, 1]))
    side: int = 2 * math.ceil(radius / resolution) + 2
    return max(side * side, side * len(footprint))
