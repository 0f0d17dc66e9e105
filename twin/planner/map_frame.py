"""Where a costmap lies: its size, its origin, and how a rolling window follows the robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.planner.grid import size_in_metres
from twin.records import Bytes, Pose2

Bounds = tuple[float, float, float, float]  # min x, min y, max x, max y [m, odom]

NO_BOUNDS: Bounds = (1e30, 1e30, -1e30, -1e30)
"""Bounds that contain nothing: where every update of a layered costmap starts."""


@dataclass(frozen=True, slots=True)
class MapSpec:
    """The frame of one costmap: `origin` [m, odom] is where cell (0, 0) starts; a rolling map moves it."""

    size_x: int  # cells
    size_y: int  # cells
    resolution: float  # [m] per cell
    origin: tuple[float, float]
    rolling: bool


LOCAL_MAP = MapSpec(200, 200, 0.05, (0.0, 0.0), rolling=True)
"""10 x 10 m round the robot (jackal_navigation/params/odom_nav_params/local_costmap_params.yaml)."""

GLOBAL_MAP = MapSpec(800, 800, 0.05, (-20.0, -20.0), rolling=False)
"""40 x 40 m, fixed in odom (jackal_navigation/params/odom_nav_params/global_costmap_params.yaml)."""


def rolled_origin(origin: tuple[float, float], spec: MapSpec, pose: Pose2) -> tuple[tuple[float, float], int, int]:
    """The origin after the window followed the robot, and the shift in cells (x, y) (`Costmap2D::updateOrigin`).

    The shift is truncated towards zero, so the window lags behind by up to a cell in either direction; the new
    origin accumulates in f64 from the old one.
    """
    if not spec.rolling:
        return origin, 0, 0
    desired_x = pose.x - size_in_metres(spec.size_x, spec.resolution) / 2
    desired_y = pose.y - size_in_metres(spec.size_y, spec.resolution) / 2
    shift_x = int((desired_x - origin[0]) / spec.resolution)
    shift_y = int((desired_y - origin[1]) / spec.resolution)
    if shift_x == 0 and shift_y == 0:
        return origin, 0, 0
    return (origin[0] + shift_x * spec.resolution, origin[1] + shift_y * spec.resolution), shift_x, shift_y


def shifted(cells: Bytes, shift_x: int, shift_y: int) -> Bytes:
    """A writable copy of the grid (ny, nx) as seen from a window moved by whole cells; what is new is 0."""
    if shift_x == 0 and shift_y == 0:
        return cells.copy()
    ny, nx = cells.shape
    moved = np.zeros_like(cells)
    x0, x1 = max(0, shift_x), min(nx, nx + shift_x)
    y0, y1 = max(0, shift_y), min(ny, ny + shift_y)
    if x0 < x1 and y0 < y1:
        moved[y0 - shift_y : y1 - shift_y, x0 - shift_x : x1 - shift_x] = cells[y0:y1, x0:x1]
    return moved


def whole_map_bounds(origin: tuple[float, float], spec: MapSpec) -> Bounds:
    """Bounds that reach into the first and the last cell of the map [m, odom]."""
    return (
        *origin,
        origin[0] + size_in_metres(spec.size_x, spec.resolution),
        origin[1] + size_in_metres(spec.size_y, spec.resolution),
    )
