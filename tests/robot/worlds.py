"""Worlds of every kind that the robot's tests drive and scan in."""

from __future__ import annotations

import numpy as np

from twin.records import Pose2
from twin.world import Box, Cylinder, Mesh, Obstacle, Rules, World

RULES = Rules(protocol="test", goal_tolerance=0.3, time_limit=50.0)


def world(name: str, *obstacles: Obstacle, start: Pose2 | None = None) -> World:
    """A world with its goal 5 m ahead of the start."""
    return World(name, obstacles, start or Pose2(0.0, 0.0, 0.0), Pose2(5.0, 0.0, 0.0), RULES)


def cylinders(count: int = 400) -> World:
    """BARN-like: cylinders of 15 cm on a grid of 15 cm, neighbours touching, round a free strip along x."""
    rng = np.random.default_rng(5)
    cells = [(i, j) for i in range(-15, 60) for j in range(-20, 21) if abs(j) > 4]
    chosen = rng.choice(len(cells), size=count, replace=False)
    return world("cylinders", *(Cylinder(0.15 * cells[k][0], 0.15 * cells[k][1], 0.075, 0.5) for k in chosen))


def boxes() -> World:
    """Long walls, slanted boxes, one hanging above the floor but in the way of the scan."""
    rng = np.random.default_rng(6)
    clutter = [
        Box(x, y, rng.uniform(-3, 3), rng.uniform(0.1, 0.8), rng.uniform(0.1, 0.8), rng.uniform(0.35, 1.0))
        for x, y in rng.uniform((-4, 1.0), (10, 3.5), size=(40, 2))
    ]
    return world(
        "boxes",
        Box(3.0, 4.0, 0.0, 16.0, 0.1, 1.0, style="wall"),
        Box(3.0, -1.5, 0.03, 16.0, 0.1, 1.0, style="wall"),
        Box(2.0, 0.8, 0.7, 0.6, 0.4, 0.1, bottom=0.25, style="furniture"),
        *clutter,
    )


def room() -> World:
    """An L-shaped room as one open mesh, with a table on four legs, and two solids standing in it."""
    corners = [(-4.0, -3.0), (4.0, -3.0), (4.0, 0.0), (1.0, 0.0), (1.0, 3.0), (-4.0, 3.0)]
    patches = [
        _patch((*a, 0.0), (*b, 0.0), (*b, 2.5), (*a, 2.5), 12)
        for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)
    ]
    patches.append(_patch((-4, -3, 0.01), (4, -3, 0.01), (4, 3, 0.01), (-4, 3, 0.01), 12))  # a scanned floor
    patches.append(_patch((-1, -1, 0.7), (0, -1, 0.7), (0, 0, 0.7), (-1, 0, 0.7), 3))  # table top
    for x in (-1.0, 0.0):
        for y in (-1.0, 0.0):
            patches.append(_patch((x - 0.03, y, 0), (x + 0.03, y, 0), (x + 0.03, y, 0.7), (x - 0.03, y, 0.7), 3))
            patches.append(_patch((x, y - 0.03, 0), (x, y + 0.03, 0), (x, y + 0.03, 0.7), (x, y - 0.03, 0.7), 3))
    offsets = np.cumsum([0, *(len(v) for v, _ in patches[:-1])])
    mesh = Mesh(
        np.vstack([v for v, _ in patches]),
        np.vstack([f + offset for (_, f), offset in zip(patches, offsets, strict=True)]).astype(np.int32),
    )
    solids = (Cylinder(2.5, -2.0, 0.2, 0.6), Box(-3.0, 1.5, 0.4, 0.5, 0.3, 0.5))
    return world("room", mesh, *solids, start=Pose2(-2.0, -2.0, 0.0))


def _patch(a: tuple, b: tuple, c: tuple, d: tuple, n: int) -> tuple[np.ndarray, np.ndarray]:
    """The quadrilateral a b c d as a grid of 2 n^2 triangles: vertices (k, 3), faces (m, 3)."""
    s, t = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1))
    s, t = s.reshape(-1, 1), t.reshape(-1, 1)
    vertices = (np.array(a) * (1 - s) + np.array(b) * s) * (1 - t) + (np.array(d) * (1 - s) + np.array(c) * s) * t
    k = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1, 1)
    return vertices, np.vstack([np.hstack([k, k + 1, k + n + 2]), np.hstack([k, k + n + 2, k + n + 1])])


def everything() -> World:
    """Cylinders, boxes and a mesh together."""
    return World(
        "everything",
        (*cylinders(150).obstacles, *boxes().obstacles, *room().obstacles),
        Pose2(0.0, 0.0, 0.0),
        Pose2(5.0, 0.0, 0.0),
        RULES,
    )


WORLDS = (cylinders, boxes, room, everything)
