"""The obstacle layer of a ROS layered costmap, fed by one planar scan (`costmap_2d::ObstacleLayer`).

What the scans marked and cleared does not depend on the planner parameters, so this layer is part of the
observation; `inflation.py` turns it into the costmap that the planners read.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from twin.compiled import compiled
from twin.planner.footprint import FOOTPRINT, footprint_cells, raster_capacity
from twin.planner.grid import FREE, LETHAL, NO_INFORMATION, cell_distance, world_to_cell
from twin.planner.map_frame import (
    GLOBAL_MAP,
    LOCAL_MAP,
    NO_BOUNDS,
    MapSpec,
    rolled_origin,
    shifted,
    whole_map_bounds,
)
from twin.records import Array, Bytes, ObstacleMap, Pose2, Scan, frozen_array

Points = NDArray[np.float32]  # (n, 3) [m, odom]: x, y, z of the scan's returns, f32 as in a PointCloud2


@dataclass(frozen=True, slots=True)
class ScanSource:
    """How a scan marks and clears (jackal_navigation/params/costmap_common_params.yaml, costmap_2d's defaults)."""

    obstacle_range: float = 2.5  # [m] returns at or beyond it mark nothing
    raytrace_range: float = 3.0  # [m] cells beyond it are not cleared
    min_obstacle_height: float = -2.0  # [m] in odom
    max_obstacle_height: float = 2.0  # [m] in odom
    footprint_clearing_enabled: bool = True


JACKAL_SCAN = ScanSource()

__all__ = [
    "GLOBAL_MAP",
    "JACKAL_SCAN",
    "LOCAL_MAP",
    "MapSpec",
    "ScanSource",
    "clear_outside",
    "empty_map",
    "scan_points",
    "update_obstacles",
]


def empty_map(spec: MapSpec) -> ObstacleMap:
    """A map on which nothing was ever seen."""
    cells = frozen_array(np.zeros((spec.size_y, spec.size_x), dtype=np.uint8))
    return ObstacleMap(cells, spec.origin, spec.resolution, NO_BOUNDS)


@lru_cache(maxsize=8)
def _bearings(beams: int, angle_min: float, angle_max: float) -> tuple[Array, Array]:
    """Cosines and sines (n,) of the beams' bearings in the sensor frame."""
    angles = np.linspace(angle_min, angle_max, beams)
    return np.cos(angles), np.sin(angles)


def scan_points(scan: Scan, pose: Pose2) -> tuple[Points, tuple[float, float, float]]:
    """The scan's returns in odom, taken at `pose` (odom_from_base), and where the sensor was [m, odom].

    Beams outside range_min <= r < range_max are dropped (`inf_is_valid: false`): they neither mark nor clear.
    """
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    mount_x, mount_y, mount_z = scan.mount
    sensor = (pose.x + c * mount_x - s * mount_y, pose.y + s * mount_x + c * mount_y, mount_z)
    cosines, sines = _bearings(len(scan.ranges), scan.angle_min, scan.angle_max)
    points = np.empty((len(scan.ranges), 3), dtype=np.float32)
    n = _project(scan.ranges, cosines, sines, scan.range_min, scan.range_max, c, s, *sensor, points)
    return frozen_array(points[:n]), sensor


@compiled
def _project(
    ranges: Array,
    cosines: Array,
    sines: Array,
    range_min: float,
    range_max: float,
    c: float,
    s: float,
    sensor_x: float,
    sensor_y: float,
    sensor_z: float,
    points: Points,
) -> int:
    n = 0
    for k in range(len(ranges)):
        r = ranges[k]
        if range_min <= r < range_max:
            x, y = r * cosines[k], r * sines[k]
            points[n, 0] = sensor_x + c * x - s * y
            points[n, 1] = sensor_y + s * x + c * y
            points[n, 2] = sensor_z
            n += 1
    return n


def update_obstacles(
    previous: ObstacleMap,
    spec: MapSpec,
    points: Points,
    sensor: tuple[float, float, float],
    pose: Pose2,
    source: ScanSource = JACKAL_SCAN,
    footprint: Array = FOOTPRINT,
) -> ObstacleMap:
    """The layer after one map update: roll, clear along all rays, mark all returns, clear the footprint.

    `points` and `sensor` come from `scan_points`; `pose` is the robot's now (odom_from_base), `footprint` (n, 2) [m]
    in base_link. `previous` is not modified. `touched` is what the layer adds to the bounds of the update, the
    footprint included; after `clear_outside` it is the whole map.
    """
    origin, shift_x, shift_y = rolled_origin(previous.origin, spec, pose)
    cells = shifted(previous.cells, shift_x, shift_y)
    bounds = np.array(whole_map_bounds(origin, spec) if previous.whole else NO_BOUNDS)
    _apply_scan(
        cells,
        *origin,
        spec.resolution,
        points,
        *sensor,
        source.obstacle_range,
        source.raytrace_range,
        cell_distance(source.raytrace_range, spec.resolution),
        source.min_obstacle_height,
        source.max_obstacle_height,
        bounds,
    )
    if source.footprint_clearing_enabled:
        _clear_footprint(cells, *origin, spec.resolution, pose.x, pose.y, pose.yaw, footprint, bounds)
    min_x, min_y, max_x, max_y = bounds.tolist()
    return ObstacleMap(frozen_array(cells), origin, spec.resolution, (min_x, min_y, max_x, max_y))


def clear_outside(previous: ObstacleMap, pose: Pose2, reset_distance: float) -> ObstacleMap:
    """The clear-costmap recovery: forget everything but a square of side `reset_distance` [m] round the robot.

    Forgotten cells become 255, which the costmap ignores, and the next update covers the whole map.
    """
    ny, nx = previous.cells.shape
    half = reset_distance / 2
    (origin_x, origin_y), resolution = previous.origin, previous.resolution
    start_x = int((pose.x - half - origin_x) / resolution)
    start_y = int((pose.y - half - origin_y) / resolution)
    end_x = int((pose.x + half - origin_x) / resolution)
    end_y = int((pose.y + half - origin_y) / resolution)
    cells = np.full_like(previous.cells, NO_INFORMATION)
    kept = (slice(max(0, start_y + 1), max(0, min(ny, end_y))), slice(max(0, start_x + 1), max(0, min(nx, end_x))))
    cells[kept] = previous.cells[kept]
    spec = MapSpec(nx, ny, resolution, previous.origin, rolling=False)
    touched = whole_map_bounds(previous.origin, spec)
    return ObstacleMap(frozen_array(cells), previous.origin, resolution, touched, whole=True)


@compiled
def _touch(bounds: Array, x: float, y: float) -> None:
    bounds[0], bounds[1] = min(bounds[0], x), min(bounds[1], y)
    bounds[2], bounds[3] = max(bounds[2], x), max(bounds[3], y)


@compiled
def _clear_line(flat: Bytes, size_x: int, x0: int, y0: int, x1: int, y1: int, cap: int) -> None:
    """Free the cells of the line walk from (x0, y0) to (x1, y1), but at most `cap` cells far (Euclidean)."""
    dx, dy = abs(x1 - x0), abs(y1 - y0)
    step_x = 1 if x1 > x0 else -1
    step_y = size_x if y1 > y0 else -size_x
    den, add, major, minor = (dx, dy, step_x, step_y) if dx >= dy else (dy, dx, step_y, step_x)
    length = math.hypot(dx, dy)
    scale = 1.0 if length == 0.0 else min(1.0, cap / length)
    error = den // 2
    index = y0 * size_x + x0
    for _ in range(min(int(scale * den), den)):
        flat[index] = FREE
        index += major
        error += add
        if error >= den:
            index += minor
            error -= den
    flat[index] = FREE


@compiled
def _apply_scan(
    cells: Bytes,
    origin_x: float,
    origin_y: float,
    resolution: float,
    points: Points,
    sensor_x: float,
    sensor_y: float,
    sensor_z: float,
    obstacle_range: float,
    raytrace_range: float,
    raytrace_cells: int,
    min_height: float,
    max_height: float,
    bounds: Array,
) -> None:
    """Clear along every ray, then mark every return, so that a ray never wipes another ray's hit."""
    size_y, size_x = cells.shape
    flat = cells.ravel()
    far_x, far_y = origin_x + size_x * resolution, origin_y + size_y * resolution
    x0, y0 = world_to_cell(sensor_x, sensor_y, origin_x, origin_y, resolution, size_x, size_y)
    if x0 >= 0:
        _touch(bounds, sensor_x, sensor_y)
        last_x, last_y = -1, -1
        for k in range(len(points)):
            if not min_height <= points[k, 2] <= max_height:
                continue
            # Clip the end to the map. The slope stays that of the whole ray; the margin of 1 mm keeps the far
            # sides inside without taking part in the slope.
            end_x, end_y = float(points[k, 0]), float(points[k, 1])
            dx, dy = end_x - sensor_x, end_y - sensor_y
            if end_x < origin_x:
                end_x, end_y = origin_x, sensor_y + dy * ((origin_x - sensor_x) / dx)
            if end_y < origin_y:
                end_x, end_y = sensor_x + dx * ((origin_y - sensor_y) / dy), origin_y
            if end_x > far_x:
                end_x, end_y = far_x - 0.001, sensor_y + dy * ((far_x - sensor_x) / dx)
            if end_y > far_y:
                end_x, end_y = sensor_x + dx * ((far_y - sensor_y) / dy), far_y - 0.001
            x1, y1 = world_to_cell(end_x, end_y, origin_x, origin_y, resolution, size_x, size_y)
            if x1 < 0:
                continue
            if x1 != last_x or y1 != last_y:  # neighbouring beams often end in the same cell: the same line again
                _clear_line(flat, size_x, x0, y0, x1, y1, raytrace_cells)
                last_x, last_y = x1, y1
            reach = math.hypot(end_x - sensor_x, end_y - sensor_y)
            scale = min(1.0, raytrace_range / reach) if reach > 0.0 else 1.0
            _touch(bounds, sensor_x + (end_x - sensor_x) * scale, sensor_y + (end_y - sensor_y) * scale)
    for k in range(len(points)):
        x, y, z = np.float64(points[k, 0]), np.float64(points[k, 1]), np.float64(points[k, 2])
        if not min_height <= z <= max_height:
            continue
        dx, dy, dz = x - sensor_x, y - sensor_y, z - sensor_z
        if dx * dx + dy * dy + dz * dz >= obstacle_range * obstacle_range:
            continue
        mx, my = world_to_cell(x, y, origin_x, origin_y, resolution, size_x, size_y)
        if mx >= 0:
            flat[my * size_x + mx] = LETHAL
            _touch(bounds, x, y)


@compiled
def _clear_footprint(
    cells: Bytes,
    origin_x: float,
    origin_y: float,
    resolution: float,
    x: float,
    y: float,
    yaw: float,
    footprint: Array,
    bounds: Array,
) -> None:
    """Free the cells under the footprint, unless a corner is off the map; touch its corners either way."""
    size_y, size_x = cells.shape
    flat = cells.ravel()
    under = np.empty(raster_capacity(footprint, resolution), dtype=np.int32)
    raster = footprint_cells(origin_x, origin_y, resolution, size_x, size_y, x, y, yaw, footprint, under)
    if raster.complete:
        for k in range(raster.length):
            flat[under[k]] = FREE
    c, s = math.cos(yaw), math.sin(yaw)
    for k in range(footprint.shape[0]):
        px, py = footprint[k, 0], footprint[k, 1]
        _touch(bounds, x + (px * c - py * s), y + (px * s + py * c))
