"""Clearing and marking as the specification reads: every ray walked, whether or not another took the same cells."""

from __future__ import annotations

import math

import numpy as np

from twin.planner.map_frame import Bounds, MapSpec
from twin.planner.obstacle_layer import Points, ScanSource
from twin.records import Bytes


def _cell(x: float, y: float, spec: MapSpec) -> tuple[int, int] | None:
    if x < spec.origin[0] or y < spec.origin[1]:
        return None
    mx, my = int((x - spec.origin[0]) / spec.resolution), int((y - spec.origin[1]) / spec.resolution)
    return (mx, my) if mx < spec.size_x and my < spec.size_y else None


def _walk(start: tuple[int, int], end: tuple[int, int], cap: int) -> list[tuple[int, int]]:
    """The cells (x, y) of the capped Bresenham line."""
    delta = [end[0] - start[0], end[1] - start[1]]
    dominant = 0 if abs(delta[0]) >= abs(delta[1]) else 1
    length = float(np.hypot(*delta))
    scale = 1.0 if length == 0 else min(1.0, cap / length)
    steps = min(int(scale * abs(delta[dominant])), abs(delta[dominant]))
    sign = [1 if d > 0 else -1 for d in delta]
    at, error, visited = list(start), abs(delta[dominant]) // 2, []
    for _ in range(steps):
        visited.append((at[0], at[1]))
        at[dominant] += sign[dominant]
        error += abs(delta[1 - dominant])
        if error >= abs(delta[dominant]):
            at[1 - dominant] += sign[1 - dominant]
            error -= abs(delta[dominant])
    return [*visited, (at[0], at[1])]


def apply_scan(
    cells: Bytes, spec: MapSpec, points: Points, sensor: tuple[float, float, float], source: ScanSource
) -> tuple[Bytes, Bounds]:
    """The cells after the scan and the touched bounds, on a map that does not roll; without the footprint."""
    out = cells.copy()
    touched: list[tuple[float, float]] = []
    low, size = spec.origin, (spec.size_x * spec.resolution, spec.size_y * spec.resolution)
    high = (low[0] + size[0], low[1] + size[1])
    seen = [p for p in points.astype(np.float64).tolist() if p[2] <= source.max_obstacle_height]
    start = _cell(sensor[0], sensor[1], spec)
    if start is not None:
        touched.append((sensor[0], sensor[1]))
        for p in seen:
            end, slope = [p[0], p[1]], [p[0] - sensor[0], p[1] - sensor[1]]
            for axis in (0, 1):
                if end[axis] < low[axis]:
                    t = (low[axis] - sensor[axis]) / slope[axis]
                    end[axis], end[1 - axis] = low[axis], sensor[1 - axis] + slope[1 - axis] * t
            for axis in (0, 1):
                if end[axis] > high[axis]:
                    t = (high[axis] - sensor[axis]) / slope[axis]
                    end[axis], end[1 - axis] = high[axis] - 0.001, sensor[1 - axis] + slope[1 - axis] * t
            last = _cell(end[0], end[1], spec)
            if last is None:
                continue
            for x, y in _walk(start, last, math.ceil(source.raytrace_range / spec.resolution)):
                out[y, x] = 0
            dx, dy = end[0] - sensor[0], end[1] - sensor[1]
            reach = float(np.hypot(dx, dy))  # the C library's, as in C++; Python's own rounds better
            scale = min(1.0, source.raytrace_range / reach) if reach else 1.0
            touched.append((sensor[0] + dx * scale, sensor[1] + dy * scale))
    for p in seen:
        where = _cell(p[0], p[1], spec)
        if where is None or sum((a - b) ** 2 for a, b in zip(p, sensor, strict=True)) >= source.obstacle_range**2:
            continue
        out[where[1], where[0]] = 254
        touched.append((p[0], p[1]))
    xs, ys = [x for x, _ in touched], [y for _, y in touched]
    return out, (min(xs, default=1e30), min(ys, default=1e30), max(xs, default=-1e30), max(ys, default=-1e30))
