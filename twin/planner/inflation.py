"""The master costmap of one ROS layered costmap: its update window, the merge of the obstacle layer, inflation.

`update_costmap` is one pass of `costmap_2d::LayeredCostmap::updateMap` with the Jackal's two layers (obstacles, then
inflation). Cells outside the window of an update keep their old cost, so the costmap has a memory of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.compiled import compiled
from twin.planner.footprint import INSCRIBED_RADIUS
from twin.planner.grid import FREE, NO_INFORMATION, cell_distance, clamped_axis_cell, eights
from twin.planner.inflation_wave import Spread, spread, spread_tables
from twin.planner.map_frame import NO_BOUNDS, Bounds, MapSpec, shifted
from twin.records import Bytes, ObstacleMap, frozen_array

Window = tuple[int, int, int, int]  # cells x0, y0, x1, y1, half-open

COST_SCALING_FACTOR = 10.0  # [1/m] costmap_2d's default; the Jackal's yaml does not set it


@dataclass(frozen=True, slots=True)
class InflationParams:
    """What shapes the slope round obstacles. Lengths in m."""

    radius: float  # how far costs spread, rounded up to whole cells
    cost_scaling_factor: float = COST_SCALING_FACTOR  # [1/m] how fast the cost falls beyond the inscribed radius
    inscribed_radius: float = INSCRIBED_RADIUS
    inflate_unknown: bool = False  # True: every cost > 0 replaces 255; False: only costs >= 253 do


@dataclass(frozen=True, slots=True)
class Costmap:
    """A master grid with what its next update needs to know."""

    cells: Bytes  # (ny, nx): 0 free, 1..252 slope, 253 inscribed, 254 lethal, 255 unknown; index [y, x], y up
    origin: tuple[float, float]  # odom position of the lower-left corner of cell (0, 0) [m]
    resolution: float  # [m] per cell
    inflation: InflationParams | None = None  # in force when the cells were written; None: not known
    bounds: Bounds = NO_BOUNDS  # what the obstacle layer touched in the last update [m, odom]
    window: Window | None = None  # the cells that update rewrote; None: none, because nothing was touched


def update_costmap(
    previous: Costmap | None,
    layer: ObstacleMap,
    spec: MapSpec,
    radius: float,
    cost_scaling_factor: float = COST_SCALING_FACTOR,
    inscribed_radius: float = INSCRIBED_RADIUS,
) -> Costmap:
    """The costmap after the update that follows the layer's. `previous` is not modified.

    The window is what was touched in this update or the one before, grown by the radius [m]; it is the whole map when
    there is no `previous` or the inflation parameters changed. `layer` must be the one that directly follows the
    layer of `previous`, because whatever changed in between is not in the window.
    """
    inflation = InflationParams(radius, cost_scaling_factor, inscribed_radius)
    ny, nx = layer.cells.shape
    if previous is None or previous.inflation != inflation:
        window: Window | None = (0, 0, nx, ny)
    else:
        window = _window(previous.bounds, layer, radius)
    if previous is None or window == (0, 0, nx, ny):
        cells = np.empty_like(layer.cells)
    else:
        shift_x = round((layer.origin[0] - previous.origin[0]) / layer.resolution)
        shift_y = round((layer.origin[1] - previous.origin[1]) / layer.resolution)
        cells = shifted(previous.cells, shift_x, shift_y)
    if window is not None:
        _merge(cells, layer.cells, *window)
        _inflate_in_place(cells, window, layer.resolution, inflation)
    return Costmap(frozen_array(cells), layer.origin, layer.resolution, inflation, layer.touched, window)


def inflate(cells: Bytes, window: Window, resolution: float, inflation: InflationParams) -> Bytes:
    """A copy of the grid (ny, nx), inflated from the lethal cells in the window and up to R cells round it."""
    inflated = np.ascontiguousarray(cells).copy()
    _inflate_in_place(inflated, window, resolution, inflation)
    return inflated


def _window(before: Bounds, layer: ObstacleMap, radius: float) -> Window | None:
    """The cells to rewrite: bounds of the last update and of this one, grown by the radius [m]."""
    ny, nx = layer.cells.shape
    now, (origin_x, origin_y), resolution = layer.touched, layer.origin, layer.resolution
    x0 = clamped_axis_cell(min(before[0], now[0]) - radius, origin_x, resolution, nx)
    y0 = clamped_axis_cell(min(before[1], now[1]) - radius, origin_y, resolution, ny)
    x1 = min(nx, clamped_axis_cell(max(before[2], now[2]) + radius, origin_x, resolution, nx) + 1)
    y1 = min(ny, clamped_axis_cell(max(before[3], now[3]) + radius, origin_y, resolution, ny) + 1)
    return None if x1 < x0 or y1 < y0 else (x0, y0, x1, y1)


@compiled
def _merge(cells: Bytes, layer: Bytes, x0: int, y0: int, x1: int, y1: int) -> None:
    """Reset the window to free and take the layer's costs where it has any ("maximum" over a grid of zeros)."""
    nx = cells.shape[1]
    to, of = cells.ravel(), layer.ravel()
    to_words, of_words = eights(to), eights(of)
    for y in range(y0, y1):
        n, end = y * nx + x0, y * nx + x1
        while n < end:
            if n % 8 == 0 and n + 8 <= end and of_words[n // 8] == 0:
                to_words[n // 8] = 0
                n += 8
                continue
            to[n] = FREE if of[n] == NO_INFORMATION else of[n]
            n += 1


def _inflate_in_place(cells: Bytes, window: Window, resolution: float, inflation: InflationParams) -> None:
    reach = cell_distance(inflation.radius, resolution)
    if reach == 0:
        return
    ny, nx = cells.shape
    x0, y0, x1, y1 = window
    tables: Spread = spread_tables(reach, resolution, inflation.cost_scaling_factor, inflation.inscribed_radius)
    spread(
        cells,
        max(0, x0 - reach),
        max(0, y0 - reach),
        min(nx, x1 + reach),
        min(ny, y1 + reach),
        tables,
        inflation.inflate_unknown,
    )
