"""Path distance and goal distance in cells: the two map grids of the local planner (`base_local_planner::MapGrid`).

Both count 4-neighbour steps round the obstacles of the local costmap, one from every cell of the plan, the other from
the cell where the plan leaves the window ("local goal"). They are rebuilt for every `find_best_path`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.compiled import compiled
from twin.planner.footprint import FOOTPRINT, footprint_cells, raster_capacity
from twin.planner.grid import NO_INFORMATION, cell_to_world, world_to_cell
from twin.planner.inflation import Costmap
from twin.planner.wave import BLOCKED, UNMET, Cells, Wave, clear, empty_wave, finish, seed
from twin.records import Array, Bytes, Pose2, frozen_array


@dataclass(frozen=True, slots=True)
class MapGrids:
    """Both grids of one call; ny * nx stands for an obstacle, ny * nx + 1 for a cell that no wave reached."""

    path: Cells  # (ny, nx) steps to the nearest plan cell
    goal: Cells  # (ny, nx) steps to the local goal
    within_robot: Bytes  # (ny, nx) 1 under the padded footprint, where the path grid (only) ignores obstacles
    local_goal: tuple[float, float] | None  # centre of its cell [m], map frame; None: no plan point is on the map


def map_grids(costmap: Costmap, pose: Pose2, plan: Array) -> MapGrids:
    """Both complete grids for a robot at `pose` and a plan (n, >= 2) [m], all in the map's frame.

    The pose is used as given; `find_best_path` rounds it to f32 before.
    """
    ny, nx = costmap.cells.shape
    path = np.empty((ny, nx), dtype=np.int32)
    goal = np.empty((ny, nx), dtype=np.int32)
    within = np.zeros((ny, nx), dtype=np.uint8)
    local_goal = _fill_grids(
        read_only(costmap.cells), *costmap.origin, costmap.resolution, pose.x, pose.y, pose.yaw, FOOTPRINT,
        plan_points(plan), empty_wave(ny, nx), raster_scratch(costmap.resolution), path, goal, within,
    )  # fmt: skip
    return MapGrids(frozen_array(path), frozen_array(goal), frozen_array(within), goal_centre(costmap, local_goal))


def plan_points(plan: Array) -> Array:
    """The plan (n, >= 2) as the compiled loops take it: C-contiguous, read-only."""
    return frozen_array(np.array(plan, dtype=np.float64))


def raster_scratch(resolution: float) -> Cells:
    """Scratch for the cells under the footprint."""
    return np.empty(raster_capacity(FOOTPRINT, resolution), dtype=np.int32)


def read_only(array: Bytes) -> Bytes:
    """The same cells as a C-contiguous read-only view: the one kind of array that the compiled loops are built for."""
    if array.flags.writeable or not array.flags.c_contiguous:
        array = np.ascontiguousarray(array).view()
        array.setflags(write=False)
    return array


def goal_centre(costmap: Costmap, flat_cell: int) -> tuple[float, float] | None:
    """Map-frame centre [m] of a cell given by its flat index; None for a negative one."""
    if flat_cell < 0:
        return None
    y, x = divmod(flat_cell, costmap.cells.shape[1])
    return (
        cell_to_world(x, costmap.origin[0], costmap.resolution),
        cell_to_world(y, costmap.origin[1], costmap.resolution),
    )


@compiled
def seed_plan(
    path: Wave, cells: Bytes, origin_x: float, origin_y: float, resolution: float, plan: Array
) -> tuple[int, int]:
    """Start the path wave from every cell of the plan, made dense; returns the local goal's cell, or (-1, -1).

    Points further apart than a cell get equally spaced points between them (`MapGrid::adjustPlanResolution`). A point
    counts when it is on the map and its cell is known; the run begins with the first that counts and ends before the
    next that does not. The local goal is the run's last cell.
    """
    size_y, size_x = cells.shape
    goal_x, goal_y = -1, -1
    for k in range(plan.shape[0]):
        steps = 1
        from_x, from_y, delta_x, delta_y = plan[k, 0], plan[k, 1], 0.0, 0.0
        if k > 0:
            gap_x, gap_y = plan[k, 0] - plan[k - 1, 0], plan[k, 1] - plan[k - 1, 1]
            gap2 = gap_x * gap_x + gap_y * gap_y
            if gap2 > resolution * resolution:
                steps = math.ceil(math.sqrt(gap2) / resolution)
                from_x, from_y = plan[k - 1, 0], plan[k - 1, 1]
                delta_x, delta_y = gap_x / steps, gap_y / steps
        for j in range(1, steps + 1):
            if j < steps:
                x, y = from_x + j * delta_x, from_y + j * delta_y
            else:
                x, y = plan[k, 0], plan[k, 1]
            mx, my = world_to_cell(x, y, origin_x, origin_y, resolution, size_x, size_y)
            if mx < 0 or cells[my, mx] == NO_INFORMATION:
                if goal_x >= 0:
                    return goal_x, goal_y
                continue
            goal_x, goal_y = mx, my
            seed(path, (my + 1) * path.width + mx + 1)
    return goal_x, goal_y


@compiled
def open_robot(
    path: Wave,
    size_x: int,
    size_y: int,
    origin_x: float,
    origin_y: float,
    resolution: float,
    x: float,
    y: float,
    yaw: float,
    footprint: Array,
    raster: Cells,
) -> int:
    """Let the path wave (never the goal's) pass under the footprint; returns how many cells of `raster` that are."""
    found = footprint_cells(origin_x, origin_y, resolution, size_x, size_y, x, y, yaw, footprint, raster)
    for k in range(found.length):
        index = (raster[k] // size_x + 1) * path.width + raster[k] % size_x + 1
        if path.value[index] == BLOCKED:
            path.value[index] = UNMET
    return found.length


@compiled
def start_waves(
    path: Wave,
    goal: Wave,
    cells: Bytes,
    origin_x: float,
    origin_y: float,
    resolution: float,
    x: float,
    y: float,
    yaw: float,
    footprint: Array,
    raster: Cells,
    plan: Array,
) -> int:
    """Both waves with their seeds, not spread yet; returns the local goal's flat cell index or -1."""
    size_y, size_x = cells.shape
    clear(path, cells)
    clear(goal, cells)
    open_robot(path, size_x, size_y, origin_x, origin_y, resolution, x, y, yaw, footprint, raster)
    goal_x, goal_y = seed_plan(path, cells, origin_x, origin_y, resolution, plan)
    if goal_x < 0:
        return -1
    seed(goal, (goal_y + 1) * goal.width + goal_x + 1)
    flat: int = goal_y * size_x + goal_x
    return flat


@compiled
def _fill_grids(
    cells: Bytes,
    origin_x: float,
    origin_y: float,
    resolution: float,
    x: float,
    y: float,
    yaw: float,
    footprint: Array,
    plan: Array,
    wave: Wave,
    raster: Cells,
    path: Cells,
    goal: Cells,
    within: Bytes,
) -> int:
    """Fill both grids and the within-robot marks (zero on entry); returns the local goal's flat cell index or -1."""
    size_y, size_x = cells.shape
    clear(wave, cells)
    covered = open_robot(wave, size_x, size_y, origin_x, origin_y, resolution, x, y, yaw, footprint, raster)
    for k in range(covered):
        within[raster[k] // size_x, raster[k] % size_x] = 1
    goal_x, goal_y = seed_plan(wave, cells, origin_x, origin_y, resolution, plan)
    _values(wave, path)
    clear(wave, cells)
    if goal_x >= 0:
        seed(wave, (goal_y + 1) * wave.width + goal_x + 1)
    _values(wave, goal)
    return goal_y * size_x + goal_x if goal_x >= 0 else -1


@compiled
def _values(wave: Wave, grid: Cells) -> None:
    """The wave's whole grid in ROS's numbers: as `grid_value` of every cell, but faster."""
    finish(wave)
    value = wave.value
    size_y, size_x = grid.shape
    for y in range(size_y):
        for x in range(size_x):
            index = (y + 1) * wave.width + x + 1
            steps = value[index]
            if steps < 0:
                near = max(
                    max(value[index - 1], value[index + 1]), max(value[index - wave.width], value[index + wave.width])
                )
                steps = size_x * size_y + (0 if steps == BLOCKED and near >= 0 else 1)
            grid[y, x] = steps
