"""Where the robot can truly be: exact distances to the obstacles, on a grid or at chosen points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from twin.records import Array, Pose2, frozen_array
from twin.world import Box, Cylinder, Mesh, Obstacle, World

FLOOR_SKIN = 0.02  # [m] a scanned floor is uneven; wheels of radius 0.098 m roll over less than this
ROBOT_TOP = 0.35  # [m] top of the robot with its lidar (spec: UST-10 at 0.305 m above the floor); what starts higher
HORIZON = 2.0  # [m] distances on the grid are capped here: no motion of this robot depends on more
MARGIN = 1.0  # [m] border of the grid around obstacles, start and goal
MAX_CELLS = 40_000_000
MAX_PIECES = 10_000_000


@dataclass(frozen=True, slots=True)
class FreeSpace:
    """Distance to the nearest obstacle the robot can hit, from the centre of every cell; world frame."""

    distance: Array  # (ny, nx) [m], index [y, x], y up; negative inside cylinders and boxes; at most HORIZON
    origin: tuple[float, float]  # lower-left corner of cell (0, 0) [m]
    resolution: float  # [m] per cell

    def cells(self, points: Array) -> NDArray[np.int64]:
        """(n, 2) the cell [y, x] that holds each of the points (n, 2) [m]; may lie outside the grid."""
        xy = np.floor((np.asarray(points, dtype=np.float64) - self.origin) / self.resolution)
        return xy.astype(np.int64)[:, ::-1]

    def at(self, points: Array) -> Array:
        """(n,) [m] the distance in the cells of the points (n, 2) [m]; HORIZON outside the grid."""
        cells = self.cells(points)
        inside = ((cells >= 0) & (cells < self.distance.shape)).all(axis=1)
        values = np.full(len(cells), HORIZON)
        values[inside] = self.distance[cells[inside, 0], cells[inside, 1]]
        return values

    def reachable(self, start: Pose2, clearance: float) -> NDArray[np.bool_]:
        """(ny, nx) cells that a disc of radius `clearance` [m] can reach from `start`."""
        labels, _ = ndimage.label(self.distance >= clearance, np.ones((3, 3)))
        (row, column) = self.cells(np.array([[start.x, start.y]]))[0]
        here = labels[row, column]
        return np.asarray((labels == here) & (here > 0))


def free_space(world: World, resolution: float = 0.05) -> FreeSpace:
    """The distance map of a world. Raises ValueError when it would need more than MAX_CELLS cells."""
    low, high = _bounds(world)
    shape = tuple(math.ceil(v) for v in ((high - low) / resolution)[::-1])
    if shape[0] * shape[1] > MAX_CELLS:
        raise ValueError(f"the world is too large for a map with {resolution} m cells")
    x = low[0] + (np.arange(shape[1]) + 0.5) * resolution
    y = low[1] + (np.arange(shape[0]) + 0.5) * resolution
    distance = np.full(shape, HORIZON)
    for obstacle in world.obstacles:
        if isinstance(obstacle, Mesh):
            points = mesh_points(obstacle, resolution / 2)
            if len(points):
                centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
                near, _ = cKDTree(points).query(centres, distance_upper_bound=HORIZON)
                np.minimum(distance, near.reshape(shape), out=distance)
        elif not _above_robot(obstacle):
            reach_x, reach_y = _half_extent(obstacle) + HORIZON
            rows = slice(*np.searchsorted(y, (obstacle.y - reach_y, obstacle.y + reach_y)))
            columns = slice(*np.searchsorted(x, (obstacle.x - reach_x, obstacle.x + reach_x)))
            window = distance[rows, columns]
            np.minimum(window, _signed_distance(obstacle, x[None, columns], y[rows, None]), out=window)
    return FreeSpace(frozen_array(distance), (float(low[0]), float(low[1])), resolution)


def obstacle_distance(obstacles: Sequence[Obstacle], points: Array) -> Array:
    """(n,) [m] exact distance from points (n, 2) to the nearest obstacle the robot can hit; inf without any.

    Negative inside cylinders and boxes; meshes are surfaces, met within 0.01 m.
    """
    best = np.full(len(points), np.inf)
    for obstacle in obstacles:
        if isinstance(obstacle, Mesh):
            surface = mesh_points(obstacle, 0.02)
            if len(surface):
                np.minimum(best, cKDTree(surface).query(points)[0], out=best)
        elif not _above_robot(obstacle):
            np.minimum(best, _signed_distance(obstacle, points[:, 0], points[:, 1]), out=best)
    return best


def mesh_points(mesh: Mesh, spacing: float) -> Array:
    """(n, 2) [m] points of the mesh's surface between FLOOR_SKIN and ROBOT_TOP, at most `spacing` apart.

    Triangles are halved across their longest side until that is short enough; halves outside the band are dropped
    at once, so that tall walls and ceilings cost nothing. Raises ValueError for more than MAX_PIECES pieces.
    """
    pieces = _in_band(mesh.vertices[mesh.faces])  # (m, 3 corners, 3)
    points = []
    while len(pieces):
        sides = np.linalg.norm(pieces - np.roll(pieces, -1, axis=1), axis=2)  # side k: corner k to corner k + 1
        longest = sides.argmax(axis=1)
        done = sides.max(axis=1) <= spacing
        points.append(np.concatenate([pieces[done].reshape(-1, 3), pieces[done].mean(axis=1)]))
        pieces, longest = pieces[~done], longest[~done]
        each = np.arange(len(pieces))
        a, b, c = (pieces[each, (longest + k) % 3] for k in range(3))
        middle = (a + b) / 2
        pieces = _in_band(np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]))
        if len(pieces) > MAX_PIECES:
            raise ValueError("the mesh is too large for its distances to be computed; are its units metres?")
    found = np.concatenate([np.empty((0, 3)), *points])
    found = found[(found[:, 2] > FLOOR_SKIN) & (found[:, 2] < ROBOT_TOP), :2]
    lattice = np.round(found * (4 / spacing)).astype(np.int64)
    _, first = np.unique(lattice[:, 0] * 2**32 + lattice[:, 1], return_index=True)  # one number sorts faster than two
    return np.asarray(lattice[first] * (spacing / 4))


def _in_band(triangles: Array) -> Array:
    """Those of the triangles (m, 3, 3) that reach into the heights which the robot can hit."""
    z = triangles[:, :, 2]
    return np.asarray(triangles[(z.max(axis=1) > FLOOR_SKIN) & (z.min(axis=1) < ROBOT_TOP)])


def _above_robot(obstacle: Cylinder | Box) -> bool:
    return isinstance(obstacle, Box) and obstacle.bottom >= ROBOT_TOP


def _half_extent(obstacle: Cylinder | Box) -> Array:
    """(2,) [m] half the sides of the upright rectangle round the obstacle, along the world's x and y."""
    if isinstance(obstacle, Cylinder):
        return np.array([obstacle.radius, obstacle.radius])
    c, s = abs(math.cos(obstacle.yaw)), abs(math.sin(obstacle.yaw))
    return np.array([c * obstacle.length + s * obstacle.width, s * obstacle.length + c * obstacle.width]) / 2


def _signed_distance(obstacle: Cylinder | Box, x: Array, y: Array) -> Array:
    """[m] from the points (x, y) to the outline, negative inside."""
    dx, dy = x - obstacle.x, y - obstacle.y
    if isinstance(obstacle, Cylinder):
        return np.hypot(dx, dy) - obstacle.radius
    c, s = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
    over_x = np.abs(c * dx + s * dy) - obstacle.length / 2
    over_y = np.abs(-s * dx + c * dy) - obstacle.width / 2
    outside = np.hypot(np.maximum(over_x, 0.0), np.maximum(over_y, 0.0))
    return np.asarray(outside + np.minimum(np.maximum(over_x, over_y), 0.0))


def _bounds(world: World) -> tuple[Array, Array]:
    """Lower and upper corner [m] of all that matters, with MARGIN around it."""
    points = [np.array([[world.start.x, world.start.y], [world.goal.x, world.goal.y]])]
    for obstacle in world.obstacles:
        if isinstance(obstacle, Mesh):
            points.append(obstacle.vertices[:, :2])
        else:
            half = _half_extent(obstacle)
            centre = np.array([obstacle.x, obstacle.y])
            points.append(np.stack([centre - half, centre + half]))
    everything = np.concatenate(points)
    return everything.min(axis=0) - MARGIN, everything.max(axis=0) + MARGIN
