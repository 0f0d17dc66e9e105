"""Walls of a course: lines on the floor as boxes or cylinders, and the two lines beside a corridor's centre line."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from twin.world import Box, Cylinder, Obstacle

Point = tuple[float, float]
Points = tuple[Point, ...]


def wall_boxes(
    points: Sequence[Point], thickness: float, height: float, style: str, closed: bool = False
) -> list[Obstacle]:
    """A polyline as long thin boxes. Boxes reach half a thickness over inner corners so that no slit stays open."""
    loop = [*points, points[0]] if closed else list(points)
    boxes: list[Obstacle] = []
    for i, (a, b) in enumerate(itertools.pairwise(loop)):
        yaw, length = math.atan2(b[1] - a[1], b[0] - a[0]), math.dist(a, b)
        before = thickness / 2 if closed or i > 0 else 0.0
        after = thickness / 2 if closed or i < len(loop) - 2 else 0.0
        middle = (length + after - before) / 2
        x, y = a[0] + middle * math.cos(yaw), a[1] + middle * math.sin(yaw)
        boxes.append(Box(x, y, yaw, length + before + after, thickness, height, style=style))
    return boxes


def cylinder_row(points: Sequence[Point], radius: float, height: float, style: str) -> list[Obstacle]:
    """A polyline as cylinders that touch: one at every point, and as many between as leave no gap."""
    x, y = points[0]
    row: list[Obstacle] = [Cylinder(x, y, radius, height, style)]
    for a, b in itertools.pairwise(points):
        count = math.ceil(math.dist(a, b) / (2 * radius) - 1e-9)
        for k in range(1, count + 1):
            x, y = (start + k / count * (end - start) for start, end in zip(a, b, strict=True))
            row.append(Cylinder(x, y, radius, height, style))
    return row


def corridor_walls(centre: Sequence[Point], spacing: float) -> tuple[Points, Points]:
    """The two walls of a corridor: lines parallel to its centre line, `spacing` apart, joined in mitres.

    Raises ValueError when a bend is so sharp or a leg so short that a wall would fold back on itself.
    """
    line = np.array(centre)
    along = np.diff(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)  # (n - 1, 2) normals of the legs
    corner = left[:-1] + left[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        mitre = 2 * corner / (corner**2).sum(axis=1, keepdims=True)
    offsets = np.concatenate([left[:1], mitre, left[-1:]]) * (spacing / 2)
    if not np.isfinite(offsets).all() or np.linalg.norm(offsets, axis=1).max() > 2 * spacing:
        raise ValueError("bends too sharply for a corridor; split the turn over more points")
    walls = (line + offsets, line - offsets)
    for wall in walls:
        if ((np.diff(wall, axis=0) * along).sum(axis=1) <= 0).any():
            raise ValueError("has a leg too short for the corridor's width; leave out a point or narrow the corridor")
    return tuple(tuple((float(x), float(y)) for x, y in wall) for wall in walls)  # type: ignore[return-value]
