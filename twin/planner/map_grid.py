"""Path distance and goal distance in cells: the two map grids of the local planner (`base_local_planner::MapGrid`).

Both count 4-neighbour steps round the obstacles of the local costmap, one from every cell of the plan, the other from
the cell where the plan leaves the window ("local goal"). They are rebuilt for every `find_best_path`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.planner.footprint import FOOTPRINT, footprint_cells, raster_capacity
from twin.planner.grid import INSCRIBED, NO_INFORMATION, cell_to_world, compiled, world_to_cell
from twin.planner.inflation import Costmap
from twin.records import Array, Bytes, Pose2, frozen_array

Cells = NDArray[np.int32]


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
    scratch = np.empty(ny * nx + raster_capacity(FOOTPRINT, costmap.resolution), dtype=np.int32)
    flat_goal = fill_grids(
        read_only(costmap.cells), *costmap.origin, costmap.resolution, pose.x, pose.y, pose.yaw, FOOTPRINT,
        np.ascontiguousarray(plan, dtype=np.float64), path, goal, within, scratch,
    )  # fmt: skip
    return MapGrids(frozen_array(path), frozen_array(goal), frozen_array(within), goal_centre(costmap, flat_goal))


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
    plan: Array, cells: Bytes, origin_x: float, origin_y: float, resolution: float, values: Cells, queue: Cells
) -> tuple[int, int]:
    """Set the cells of the plan, made dense, to 0 in `values` and list each once, in plan order, in `queue`.

    Points further apart than a cell get equally spaced points between them (`MapGrid::adjustPlanResolution`). A point
    counts when it is on the map and its cell is known; the run begins with the first that counts and ends before the
    next that does not. Returns the length of the list and the flat index of the last cell (the local goal), or -1.
    """
    size_y, size_x = cells.shape
    value = values.ravel()
    count, last = 0, -1
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
                if last >= 0:
                    return count, last
                continue
            last = my * size_x + mx
            if value[last] != 0:
                value[last] = 0
                queue[count] = last
                count += 1
    return count, last


@compiled
def spread(cells: Bytes, within: Bytes, values: Cells, queue: Cells, seeds: int) -> None:
    """The wave from the first `seeds` cells of `queue` over the whole grid (`MapGrid::computeTargetDistance`).

    `values` must hold ny * nx + 1 everywhere but 0 at the seeds. Seeds spread even when they are obstacles; other cells
    of cost 253 and more get ny * nx and stop the wave, unless the robot stands on them (`within`).
    """
    size_y, size_x = cells.shape
    obstacle = size_x * size_y
    unreached = obstacle + 1
    flat, robot, value = cells.ravel(), within.ravel(), values.ravel()
    head, tail = 0, seeds
    while head < tail:
        index = queue[head]
        head += 1
        steps = value[index] + 1
        x = index % size_x
        for k in range(4):
            if k == 0:
                if x == 0:
                    continue
                neighbour = index - 1
            elif k == 1:
                if x == size_x - 1:
                    continue
                neighbour = index + 1
            elif k == 2:
                neighbour = index - size_x
                if neighbour < 0:
                    continue
            else:
                neighbour = index + size_x
                if neighbour >= obstacle:
                    continue
            if value[neighbour] != unreached:
                continue
            if flat[neighbour] >= INSCRIBED and robot[neighbour] == 0:
                value[neighbour] = obstacle
                continue
            value[neighbour] = steps
            queue[tail] = neighbour
            tail += 1


@compiled
def fill_grids(
    cells: Bytes,
    origin_x: float,
    origin_y: float,
    resolution: float,
    x: float,
    y: float,
    yaw: float,
    footprint: Array,
    plan: Array,
    path: Cells,
    goal: Cells,
    within: Bytes,
    scratch: Cells,
) -> int:
    """Fill both grids and the within-robot marks (zero on entry); returns the local goal's flat cell index or -1.

    `scratch` holds ny * nx + `raster_capacity` cells.
    """
    size_y, size_x = cells.shape
    unreached = size_x * size_y + 1
    path[:] = unreached
    goal[:] = unreached
    raster = footprint_cells(origin_x, origin_y, resolution, size_x, size_y, x, y, yaw, footprint, scratch)
    marks = within.ravel()
    for k in range(raster.length):
        marks[scratch[k]] = 1

    seeds, last = seed_plan(plan, cells, origin_x, origin_y, resolution, path, scratch)
    if last < 0:
        return -1
    spread(cells, within, path, scratch, seeds)
    goal.ravel()[last] = 0
    scratch[0] = last
    spread(cells, np.zeros_like(within), goal, scratch, 1)
    return last
