"""BARN worlds: 30 x 30 cells of cylinders behind a containment wall, and the protocols that were run in them.

Perille, Truong, Xiao, Stone, "Benchmarking Metric Ground Navigation", SSRR 2020. Frame: world, +y is the direction
of travel. Grid index [row, col]: row runs along +x, column along +y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from scenarios.world_checks import WorldError
from twin.records import Array, Pose2
from twin.world import Cylinder, Rules, World

Grid = NDArray[np.uint8]  # (30, 30), index [row, col]; 1 = obstacle cell, insides filled

SIZE = 30  # cells along each side (the generator's)
CELL = 0.15  # [m] (world files: spacing of the cylinders)
ROW0_X = -4.425  # [m] centre of row 0 (world files)
COLUMN0_Y = 5.175  # [m] centre of column 0 (world files)
RADIUS = 0.075  # [m] (world files)
TOP = 0.5  # [m] above the floor: length 1.0 m, centred on the floor (world files)
WALL_Y = 0.075  # [m] back wall of the containment (world files)
ROBOT_CELLS = 5  # the robot of the C-space is a square of 5 x 5 cells (dataset paper)

PROTOCOLS = {
    # jackal_timer, branch no-map: reached when the squared distance is below 0.15, clock from 0.1 of the same
    "2020": Rules("2020", math.sqrt(0.15), 50.0, clock_distance=math.sqrt(0.1), stop_on_contact=False),
    # the same with the paper's penalty of 50 s for a stuck run (which is also its time limit)
    "appli": Rules("appli", math.sqrt(0.15), 50.0, clock_distance=math.sqrt(0.1), stop_on_contact=False),
    # the-barn-challenge, run.py at ICRA 2022
    "icra22": Rules("icra22", 1.0, 100.0, clock_distance=0.1, stop_on_contact=True),
    # ros_jackal / APPLR training
    "apprl": Rules("apprl", 0.4, 100.0, stop_on_contact=False, finish_line_y=10.0),
}


@dataclass(frozen=True, slots=True)
class PathEnds:
    """Rows of the reference path's first cell (column 0) and last cell (column 29)."""

    first: int
    last: int
    exact: bool = True  # False: estimated, because the path is not known


def protocol_rules(protocol: str) -> Rules:
    """The rules of a protocol, or WorldError with the known names."""
    if protocol not in PROTOCOLS:
        raise WorldError(f"unknown protocol {protocol!r}; use --protocol with one of {', '.join(PROTOCOLS)}")
    return PROTOCOLS[protocol]


def start_and_goal(ends: PathEnds, protocol: str) -> tuple[Pose2, Pose2]:
    """Start and goal in the world frame (table in docs/worlds.md).

    2020, appli and apprl convert path cells as the benchmark's own scripts do, 0.15 m and 0.10 m off the cylinders.
    """
    ahead = math.pi / 2
    if protocol == "icra22":
        return Pose2(-2.0, 3.0, 1.57), Pose2(-2.0, 13.0, ahead)
    first_x, last_x = 0.15 * ends.first - 4.575, 0.15 * ends.last - 4.575
    first_y, last_y = 5.075, 0.15 * (SIZE - 1) + 5.075
    if protocol == "apprl":
        return Pose2(first_x, first_y - 1.0, ahead), Pose2(last_x, last_y + 5.0, ahead)
    return Pose2(min(max(first_x, -3.9), -0.5), 4.075, 1.5708), Pose2(last_x, last_y + 0.30, ahead)


def barn_world(name: str, index: int, grid: Grid, ends: PathEnds, protocol: str, note: str = "") -> World:
    """The world of a grid, exactly as the generator writes it to Gazebo."""
    start, goal = start_and_goal(ends, protocol)
    wall = tuple(Cylinder(x, y, RADIUS, TOP, "wall") for x, y in wall_centres().tolist())
    field = tuple(Cylinder(x, y, RADIUS, TOP) for x, y in cell_centres(np.argwhere(hollow(grid))).tolist())
    if not ends.exact:
        note = "; ".join(filter(None, (note, "reference path unknown: start and goal from the middle of the passage")))
    return World(name, wall + field, start, goal, protocol_rules(protocol), index=index, note=note)


def cell_centres(cells: NDArray[np.int64]) -> Array:
    """(n, 2) world position [m] of cells (n, 2) given as [row, col]."""
    return np.array([ROW0_X, COLUMN0_Y]) + CELL * np.asarray(cells, dtype=np.float64)


def wall_centres() -> Array:
    """(96, 2) [m] the containment wall in front of the field, the same in every world."""
    rows = ROW0_X + CELL * np.arange(SIZE)[::-1]
    sides = WALL_Y + CELL * np.arange(1, 34)
    back = np.stack([rows, np.full(SIZE, WALL_Y)], axis=1)
    left = np.stack([np.full(len(sides), rows[-1]), sides], axis=1)
    right = np.stack([np.full(len(sides), rows[0]), sides], axis=1)
    return np.concatenate([back, left, right])


def hollow(grid: Grid) -> Grid:
    """(30, 30) 1 where the world file has a cylinder: filled cells with a free cell or the border beside them."""
    inner = ndimage.minimum_filter(grid, size=3, mode="constant", cval=0)
    return np.asarray(grid & ~inner & 1, dtype=np.uint8)


def filled(mask: Grid) -> Grid:
    """(30, 30) the grid of a cylinder mask: the inverse of `hollow`, so that hollow(filled(mask)) is the mask again.

    Pockets without cylinders are filled when that explains the mask: every cell of the pocket then has eight filled
    neighbours, and no cylinder has. A free pocket that is closed all round can look the same; the larger is filled
    first, which gives the published grid in all of the 100 worlds (in the others no robot could reach it).
    """
    grid = np.array(mask, dtype=np.uint8)
    pockets, count = ndimage.label(mask == 0, np.ones((3, 3)))
    sizes = np.bincount(pockets.ravel(), minlength=count + 1)[1:]
    for k in np.argsort(-sizes, kind="stable") + 1:
        trial = np.where(pockets == k, 1, grid).astype(np.uint8)
        if np.array_equal(hollow(trial), mask):
            grid = trial
    return grid


def c_space(grid: Grid) -> Grid:
    """(30, 30) 1 where the robot's square would overlap an obstacle cell; outside the grid counts as free."""
    return np.asarray(ndimage.maximum_filter(grid, size=ROBOT_CELLS, mode="constant", cval=0))


def passage(grid: Grid) -> NDArray[np.bool_] | None:
    """(30, 30) the free region of the C-space in which the reference path lies, None when there is no way through.

    The largest 4-connected region that touches the first column must be the one touching the last.
    """
    regions, count = ndimage.label(c_space(grid) == 0)
    sizes = np.bincount(regions.ravel(), minlength=count + 1)

    def largest(column: NDArray[np.int32]) -> int:
        touching = [int(k) for k in np.unique(column) if k]
        return max(touching, key=lambda k: (int(sizes[k]), -k), default=0)

    first, last = largest(regions[:, 0]), largest(regions[:, -1])
    return regions == first if first and first == last else None


def estimated_ends(grid: Grid) -> PathEnds:
    """The middle rows of the passage's two openings.

    The generator drew the rows of the path's ends at random inside the openings, so they cannot be reconstructed.
    """
    region = passage(grid)
    if region is None:
        return PathEnds(SIZE // 2, SIZE // 2, exact=False)
    rows = [np.flatnonzero(region[:, column]) for column in (0, -1)]
    first, last = (int(r[len(r) // 2]) for r in rows)
    return PathEnds(first, last, exact=False)
