"""Where to stand so that a world fills the picture."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from scenarios.pictures.stage import View
from twin.geometry import transform_points
from twin.records import Array, Pose2
from twin.world import Box, Cylinder, Obstacle, World

MARGIN = 0.3  # [m] round what must be seen
LEANING = -68.0  # [deg] so far from straight down that walls show their height


def whole(world: World, size: tuple[int, int], azimuth: float = 90.0) -> View:
    """A parallel view of all of a world from above."""
    start = np.array([(world.start.x, world.start.y, 0.0)])
    corners = np.concatenate([start, on_floor(goal_rim(world)), *map(_corners, world.obstacles)])
    return fitted(corners, size, azimuth)


def fitted(points: Array, size: tuple[int, int], azimuth: float = 90.0) -> View:
    """The parallel view from above in which points (n, 3) [m] just fit."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    view = View((float(middle[0]), float(middle[1]), 0.0), azimuth, LEANING, height=1.0)
    seen = view.pixels(points, (1, 1))  # [m] in the plane of the picture, y down
    low, high = seen.min(axis=0), seen.max(axis=0)
    wide, high_ = high - low + 2 * MARGIN
    right, down = (low + high) / 2 - 0.5
    a, e = math.radians(azimuth), math.radians(LEANING)
    at = (
        view.at[0] + right * math.sin(a) + down * math.sin(e) * math.cos(a),
        view.at[1] - right * math.cos(a) + down * math.sin(e) * math.sin(a),
        -down * math.cos(e),
    )
    return replace(view, at=at, height=float(max(high_, wide * size[1] / size[0])))


def goal_rim(world: World) -> list[tuple[float, float]]:
    """Points of the plan round the area that counts as arrived."""
    turns = np.linspace(0.0, 2 * math.pi, 36, endpoint=False)
    x, y, radius = world.goal.x, world.goal.y, world.rules.goal_tolerance
    return [(x + radius * math.cos(turn), y + radius * math.sin(turn)) for turn in turns]


def on_floor(points: Iterable[tuple[float, float]]) -> Array:
    """(n, 3) points of the plan with z = 0."""
    flat = np.array(list(points), dtype=np.float64)
    return np.column_stack([flat, np.zeros(len(flat))])


def _corners(obstacle: Obstacle) -> Array:
    """(n, 3) [m] points that an obstacle's picture lies between."""
    if isinstance(obstacle, Cylinder):
        x, y, r = obstacle.x, obstacle.y, obstacle.radius
        return np.array([(x + i * r, y + j * r, z) for i in (-1, 1) for j in (-1, 1) for z in (0.0, obstacle.height)])
    if isinstance(obstacle, Box):
        half = np.array([obstacle.length, obstacle.width]) / 2
        signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
        plan = transform_points(Pose2(obstacle.x, obstacle.y, obstacle.yaw), signs * half)
        top = obstacle.bottom + obstacle.height
        return np.concatenate([np.column_stack([plan, np.full(4, z)]) for z in (0.0, top)])
    low, high = obstacle.vertices.min(axis=0), obstacle.vertices.max(axis=0)
    return np.array([low, high])
