"""A good human's route through the true map: smooth, free of collisions, brisk where there is room."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.csgraph import dijkstra

from twin.free_space import FreeSpace
from twin.records import Array, Pose2, frozen_array

PASSABLE = 0.25  # [m] the robot's centre stays this far from obstacles (half its width is 0.208)
COMFORT = 0.70  # [m] wider than this, clearance is not worth a detour; half a corridor of 1.4 m
SPACING = 0.05  # [m] between the route's points


@dataclass(frozen=True, slots=True)
class Pace:
    """How fast somebody drives."""

    top: float = 2.0  # [m/s] the Jackal's limit
    creep: float = 0.2  # [m/s] with no room to spare
    per_metre: float = 1.0  # [1/s] times r (1 + r): faster, with r metres between the robot's side and obstacles
    lateral: float = 0.8  # [m/s2] comfortable in a curve
    turn: float = 1.6  # [rad/s] comfortable
    brake: float = 1.2  # [m/s2]


BRISK = Pace()
STEADY = Pace(top=0.46)  # where the default planner's 0.5 m/s came to grief, a person is not faster than that
CAREFUL = Pace(top=0.4, creep=0.3, per_metre=0.3, lateral=0.4, turn=0.8, brake=0.6)


@dataclass(frozen=True, slots=True)
class Route:
    """Points every SPACING metres with the speed to have there."""

    points: Array  # (n, 2) world [m]
    speed: Array  # (n,) [m/s]
    clearance: Array  # (n,) [m] from the robot's centre


class UnreachableError(ValueError):
    """No collision-free way exists for the robot."""


def plan_route(space: FreeSpace, start: Pose2, goal: Pose2, pace: Pace) -> Route:
    """The route from start to goal (world). Raises UnreachableError."""
    coarse = _search(space, start, goal)
    points = _smooth(space, _resample(coarse))
    clearance = _sample(space, points)
    return Route(frozen_array(points), frozen_array(_speeds(points, clearance, pace)), frozen_array(clearance))


def distance_field(space: FreeSpace, goal: Pose2) -> Array:
    """(ny, nx) cost-to-go of every cell [m, longer where it is tight]; inf where the goal cannot be reached from."""
    row, column = space.cells(np.array([[goal.x, goal.y]]))[0]
    if not (0 <= row < space.distance.shape[0] and 0 <= column < space.distance.shape[1]):
        raise UnreachableError("the goal lies outside the map")
    cost: Array = dijkstra(_graph(space), indices=row * space.distance.shape[1] + column)
    return cost.reshape(space.distance.shape)


def _graph(space: FreeSpace) -> sparse.csr_matrix:
    """Cells joined to their 16 neighbours (8 and the knight's moves), weighted by length and tightness."""
    ny, nx = space.distance.shape
    free = space.distance >= PASSABLE
    tight = np.clip((COMFORT - space.distance) / (COMFORT - PASSABLE), 0.0, 1.0)
    weight = 1.0 + 3.0 * tight**2
    index = np.arange(ny * nx).reshape(ny, nx)
    rows, columns, values = [], [], []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1)):
        a = (slice(0, ny - dy), slice(max(0, -dx), nx - max(0, dx)))
        b = (slice(dy, ny), slice(max(0, dx), nx - max(0, -dx)))
        both = free[a] & free[b]
        rows.append(index[a][both])
        columns.append(index[b][both])
        values.append((math.hypot(dx, dy) * space.resolution * (weight[a] + weight[b]) / 2)[both])
    i, j, w = np.concatenate(rows), np.concatenate(columns), np.concatenate(values)
    return sparse.csr_matrix((np.r_[w, w], (np.r_[i, j], np.r_[j, i])), shape=(ny * nx, ny * nx))


def _search(space: FreeSpace, start: Pose2, goal: Pose2) -> Array:
    """(n, 2) the cheapest way over cells, world [m]."""
    ny, nx = space.distance.shape
    cells = space.cells(np.array([[start.x, start.y], [goal.x, goal.y]]))
    if ((cells < 0) | (cells >= (ny, nx))).any():
        raise UnreachableError("start or goal lies outside the map")
    free = space.distance >= PASSABLE
    (start_row, start_column), (goal_row, goal_column) = (_nearest(free, cell) for cell in cells)
    source, target = goal_row * nx + goal_column, start_row * nx + start_column
    cost, before = dijkstra(_graph(space), indices=source, return_predecessors=True)
    if not math.isfinite(cost[target]):
        raise UnreachableError("no way from here to the goal is wide enough for the robot")
    way = [target]
    while way[-1] != source:
        way.append(int(before[way[-1]]))
    cells_on_way = np.array(way)
    centres = (np.c_[cells_on_way % nx, cells_on_way // nx] + 0.5) * space.resolution + space.origin
    return np.concatenate([[[start.x, start.y]], centres[1:-1], [[goal.x, goal.y]]])


def _nearest(free: NDArray[np.bool_], cell: NDArray[np.int64]) -> tuple[int, int]:
    """The passable cell nearest to a cell: a robot in a tight spot begins beside the passable ones."""
    row, column = int(cell[0]), int(cell[1])
    if free[row, column]:
        return row, column
    _, (rows, columns) = ndimage.distance_transform_edt(~free, return_indices=True)
    return int(rows[row, column]), int(columns[row, column])


def _resample(points: Array) -> Array:
    """The same line with points every SPACING metres."""
    length = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    at = np.linspace(0.0, length[-1], max(2, round(length[-1] / SPACING) + 1))
    even: Array = np.c_[np.interp(at, length, points[:, 0]), np.interp(at, length, points[:, 1])]
    return even


def _sample(space: FreeSpace, points: Array) -> Array:
    """(n,) distance to obstacles at the points, interpolated between cell centres [m]."""
    at = (points - space.origin) / space.resolution - 0.5
    return np.asarray(ndimage.map_coordinates(space.distance, at[:, ::-1].T, order=1, mode="nearest"))


def _smooth(space: FreeSpace, points: Array, rounds: int = 400) -> Array:
    """An elastic band: drawn straight, kept COMFORT from obstacles where there is room, ends fixed."""
    gy, gx = np.gradient(space.distance, space.resolution)
    for k in range(rounds):
        at = (points - space.origin) / space.resolution - 0.5
        grid = at[:, ::-1].T
        d = ndimage.map_coordinates(space.distance, grid, order=1, mode="nearest")
        away = np.c_[
            ndimage.map_coordinates(gx, grid, order=1, mode="nearest"),
            ndimage.map_coordinates(gy, grid, order=1, mode="nearest"),
        ]
        pull = np.zeros_like(points)
        pull[1:-1] = (points[:-2] + points[2:]) / 2 - points[1:-1]
        calm = 1.0 - k / rounds  # ever smaller pushes, or points would hop for ever across the middle of a corridor
        push = away * (np.clip(COMFORT - d, 0.0, None) * 0.06 * calm)[:, None]
        step = 0.9 * pull + push
        step[[0, -1]] = 0.0
        points = points + step
        if k % 50 == 49:
            points = _resample(points)
    return _resample(points)


def _speeds(points: Array, clearance: Array, pace: Pace) -> Array:
    """(n,) [m/s]: what clearance and curvature allow, within the limits of acceleration and braking."""
    n = len(points)
    curvature = np.abs(curvatures(points))
    room = np.clip(clearance - 0.21, 0.0, None)
    allowed = np.minimum(pace.top, pace.creep + pace.per_metre * room * (1.0 + room))
    allowed = np.minimum(allowed, np.sqrt(pace.lateral / np.maximum(curvature, 1e-6)))
    allowed = np.minimum(allowed, pace.turn / np.maximum(curvature, 1e-6))
    step = np.r_[np.hypot(*np.diff(points, axis=0).T), 0.0]
    for i in range(n - 2, -1, -1):
        allowed[i] = min(allowed[i], math.sqrt(allowed[i + 1] ** 2 + 2 * pace.brake * step[i]))
    return allowed


def curvatures(points: Array) -> Array:
    """(n,) signed curvature [1/m], positive to the left, smoothed over about 0.3 m."""
    if len(points) < 3:
        return np.zeros(len(points))
    d1 = np.gradient(points, axis=0)
    d1 = ndimage.gaussian_filter1d(d1, 2.0, axis=0, mode="nearest")
    d2 = np.gradient(d1, axis=0)
    speed = np.maximum(np.hypot(d1[:, 0], d1[:, 1]), 1e-9)
    return np.asarray((d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / speed**3)
