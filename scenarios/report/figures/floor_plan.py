"""A world from above: what drives are drawn on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from scenarios.report.figures.style import drawing
from scenarios.report.picture import INK
from twin.free_space import FLOOR_SKIN, ROBOT_TOP
from twin.geometry import transform_points
from twin.records import Pose2
from twin.world import Box, Cylinder, World

ASIDE = 1.0  # [m] an end that lies so much higher than the other has its name above it, out of the drive's way
LONGEST = 5.6  # [in] side of the ground
MARGINS = (2.1, 1.1)  # [in] beside and above it: axes, a colour bar or a legend, a title


@contextmanager
def floor_plan(world: World) -> Iterator[tuple[Figure, Any]]:
    """A figure in the shape of a world, with its obstacles, to draw a drive on; start and goal are added at the end."""
    sides = np.ptp(extent(world), axis=0) + 0.5
    width, height = np.maximum(sides * LONGEST / sides.max(), 1.6) + MARGINS
    with drawing(float(width), float(height)) as (figure, axes):
        draw_obstacles(axes, world)
        yield figure, axes
        draw_ends(axes, world)


def draw_obstacles(axes: Any, world: World) -> None:
    """What the robot can hit; of meshes the triangles at its height."""
    axes.add_collection(PatchCollection(_patches(world), facecolor=INK, edgecolor=INK, linewidth=0.6, alpha=0.4))


def draw_ends(axes: Any, world: World) -> None:
    """Start and goal, named; then equal metres on both axes."""
    start, goal = world.start, world.goal
    for pose, other, word, mark, large in ((start, goal, "start", "o", 5), (goal, start, "goal", "*", 9)):
        above = pose.y > other.y + ASIDE
        axes.plot(pose.x, pose.y, mark, color=INK, markersize=large)
        place = {"xytext": (0, 8 if above else -8), "textcoords": "offset points", "va": "bottom" if above else "top"}
        axes.annotate(word, (pose.x, pose.y), **place, ha="center", size=8)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set(xlabel="x [m]", ylabel="y [m]")


def extent(world: World) -> Any:
    """(n, 2) points [m] that the picture must hold."""
    points = [np.array([(pose.x, pose.y) for pose in (world.start, world.goal)])]
    for obstacle in world.obstacles:
        if isinstance(obstacle, (Box, Cylinder)):
            points.append(np.array([[obstacle.x, obstacle.y]]))
        else:
            points.append(obstacle.vertices[:, :2])
    return np.concatenate(points)


def _patches(world: World) -> list[Any]:
    patches: list[Any] = []
    for obstacle in world.obstacles:
        if isinstance(obstacle, Box):
            half = np.array([obstacle.length, obstacle.width]) / 2
            corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half
            patches.append(Polygon(transform_points(Pose2(obstacle.x, obstacle.y, obstacle.yaw), corners)))
        elif isinstance(obstacle, Cylinder):
            patches.append(Circle((obstacle.x, obstacle.y), obstacle.radius))
        else:
            corners = obstacle.vertices[obstacle.faces]
            low, high = corners[:, :, 2].min(axis=1), corners[:, :, 2].max(axis=1)
            patches += [Polygon(face) for face in corners[(high > FLOOR_SKIN) & (low < ROBOT_TOP), :, :2]]
    return patches
