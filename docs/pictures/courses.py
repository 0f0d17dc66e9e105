"""Draws `course_training.png` and `course_unseen.png` from above: `python docs/pictures/courses.py`."""

from __future__ import annotations

import heapq
import math
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Circle, Polygon

from scenarios.worlds import load_world
from twin.free_space import FreeSpace, free_space
from twin.geometry import transform_points
from twin.records import Array, Pose2
from twin.world import Box, Cylinder, World

HERE = Path(__file__).parent
CLEARANCE = 0.315  # [m] half of the robot's 0.43 m and 0.10 m to spare
ROBOT = np.array([[0.21, 0.208], [-0.21, 0.208], [-0.21, -0.208], [0.21, -0.208]])  # [m] outline
OBSTACLES = {"wall": "#555555", "cardboard": "#c69c5d", "furniture": "#7a4a2b"}
SEGMENTS = {"A1": "#e15759", "A2": "#b07aa1", "B1": "#59a14f", "B2": "#edc948", "D1": "#4e79a7", "D2": "#76b7b2"}


def easy_way(space: FreeSpace, world: World) -> Array:
    """(n, 2) [m] a short way that keeps CLEARANCE, and more where there is room for it."""
    start, goal = (tuple(int(v) for v in space.cells(np.array([[p.x, p.y]]))[0]) for p in (world.start, world.goal))
    best, came_from, queue = {start: 0.0}, {start: start}, [(0.0, start)]
    while queue:
        cost, cell = heapq.heappop(queue)
        if cell == goal:
            break
        for i, j in ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            near = (cell[0] + i, cell[1] + j)
            gap = space.distance[near]
            new = cost + math.hypot(i, j) * (1 + 2 * max(0.0, 0.5 - gap))
            if gap >= CLEARANCE and new < best.get(near, math.inf):
                best[near], came_from[near] = new, cell
                heapq.heappush(queue, (new, near))
    way = [goal]
    while way[-1] != start:
        way.append(came_from[way[-1]])
    return np.asarray((np.array(way[::-1])[:, ::-1] + 0.5) * space.resolution + space.origin)


def draw(name: str) -> None:
    """One course, with its segments, obstacles, start, goal and an easy way."""
    world = load_world(name)
    way = easy_way(free_space(world, 0.02), world)
    figure, axes = plt.subplots(figsize=(13, 5.6))
    for segment in world.segments:
        colour = SEGMENTS.get(segment.name, "#cccccc")
        axes.add_patch(Polygon(segment.polygon, facecolor=colour, alpha=0.2))
        inside = way[[_holds(segment.polygon, *point) for point in way]]
        axes.annotate(segment.name, inside[len(inside) // 2] + [0.15, 0.15], fontsize=15, color="#333333")
    for obstacle in world.obstacles:
        if isinstance(obstacle, Box):
            half = np.array([obstacle.length, obstacle.width]) / 2
            corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half
            outline = transform_points(Pose2(obstacle.x, obstacle.y, obstacle.yaw), corners)
            axes.add_patch(Polygon(outline, facecolor=OBSTACLES.get(obstacle.style, "#999999")))
        elif isinstance(obstacle, Cylinder):
            colour = OBSTACLES.get(obstacle.style, "#999999")
            axes.add_patch(Circle((obstacle.x, obstacle.y), obstacle.radius, facecolor=colour))
    axes.plot(*way.T, "k:", linewidth=1)
    for pose, what, face, edge in (
        (world.start, "start", "#222222", "#222222"),
        (world.goal, "goal", "none", "#dd0000"),
    ):
        axes.add_patch(Polygon(transform_points(pose, ROBOT), facecolor=face, edgecolor=edge, linewidth=2))
        axes.annotate(what, (pose.x, pose.y - 0.5), ha="center")
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set(xlabel="x [m]", ylabel="y [m]")
    figure.tight_layout()
    figure.savefig(HERE / f"course_{name}.png", dpi=90)
    plt.close(figure)


def _holds(polygon: tuple[tuple[float, float], ...], x: float, y: float) -> bool:
    """Whether a point lies in a polygon (even-odd rule)."""
    crossings = 0
    for a, b in zip(polygon, (*polygon[1:], polygon[0]), strict=True):
        if (a[1] > y) != (b[1] > y) and x < a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]):
            crossings += 1
    return crossings % 2 == 1


if __name__ == "__main__":
    draw("training")
    draw("unseen")
