"""The global planner: navfn's wave and descent, and `NavfnROS::makePlan` round them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.planner.grid import FREE, world_to_cell
from twin.planner.inflation import Costmap
from twin.planner.navfn_path import trace
from twin.planner.navfn_wave import Potentials, cost_tables, field, propagate
from twin.records import Array, Bytes, Pose2, frozen_array

TRACE_STEPS_PER_COLUMN = 4  # getPathFromPotential's budget is 4 * size_x steps


@dataclass(frozen=True, slots=True)
class NavfnResult:
    """One plan on a grid."""

    found: bool  # the goal cell got a potential
    path: NDArray[np.float32]  # (k, 2) [cells] x, y, in trace order: from the goal's cell to the robot's
    potential: Potentials  # (ny, nx) unreached = 1e10


def navfn(cells: Bytes, robot: tuple[int, int], goal: tuple[int, int], allow_unknown: bool = True) -> NavfnResult:
    """Plan on a costmap (ny, nx) between two cells (x, y); the robot's own cell is taken as it is."""
    cells = np.ascontiguousarray(cells)
    ny, nx = cells.shape
    found, path = _solve(cells, robot[1] * nx + robot[0], goal[1] * nx + goal[0], allow_unknown)
    return NavfnResult(found, path, frozen_array(field(ny, nx).potentials.reshape(ny, nx).copy()))


def _solve(cells: Bytes, source: int, goal: int, allow_unknown: bool) -> tuple[bool, NDArray[np.float32]]:
    """(whether the wave reached the goal, the traced points); the potentials stay in `field`."""
    ny, nx = cells.shape
    memory = field(ny, nx)
    costs = cost_tables(allow_unknown)
    if not propagate(
        cells,
        source,
        goal,
        costs.enter,
        costs.margin,
        memory.potentials,
        memory.vacant,
        memory.queues,
        memory.dirty,
    ):
        return False, frozen_array(np.empty((0, 2), dtype=np.float32))
    path = np.empty((TRACE_STEPS_PER_COLUMN * nx, 2), dtype=np.float32)
    return True, frozen_array(path[: trace(memory.potentials, nx, goal, source, path)])


def make_plan(costmap: Costmap, start: Pose2, goal: Pose2) -> tuple[Array | None, Costmap]:
    """`NavfnROS::makePlan` from the robot's pose to the goal (odom), and the costmap it leaves behind.

    The plan is (n, 3) odom x [m], y [m], yaw [rad]; None: planning failed. Its points have yaw 0 but the last, which
    is the exact goal. They are `origin + cells * resolution` although whole numbers of cells mean cell centres, so
    the whole path lies half a cell to the lower left. In the costmap left behind the robot's cell is free.
    """
    ny, nx = costmap.cells.shape
    frame = (*costmap.origin, costmap.resolution, nx, ny)
    robot_x, robot_y = world_to_cell(start.x, start.y, *frame)
    if robot_x < 0:
        return None, costmap
    if costmap.cells[robot_y, robot_x] != FREE:
        cells = costmap.cells.copy()
        cells[robot_y, robot_x] = FREE
        costmap = replace(costmap, cells=frozen_array(cells))
    goal_x, goal_y = world_to_cell(goal.x, goal.y, *frame)
    if goal_x < 0:
        return None, costmap
    _, path = _solve(costmap.cells, robot_y * nx + robot_x, goal_y * nx + goal_x, True)
    if len(path) == 0:
        return None, costmap
    plan = np.zeros((len(path) + 1, 3))
    plan[:-1, :2] = costmap.origin + path[::-1].astype(np.float64) * costmap.resolution
    plan[-1] = goal.x, goal.y, goal.yaw
    return frozen_array(plan), costmap
