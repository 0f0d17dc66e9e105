"""Is an arc legal, and what is the highest cost byte it meets? The two ways to find out.

`check_sketch` looks at the points of an arc in an order that meets trouble early, each by formula, and gives up when
the arc cannot win any more or a point is too close to a cell border to tell. `check_driven` takes the points that ROS
itself would visit, in ROS's order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twin.compiled import compiled
from twin.planner.arcs import Motion, Score, drive, total_cost
from twin.planner.footprint import OFF_MAP as FOOTPRINT_OFF_MAP
from twin.planner.footprint import footprint_cost
from twin.planner.footprint import line_cost as line_cost
from twin.planner.grid import world_to_cell
from twin.planner.heap import Heap
from twin.planner.sketch import OFF, Posture, Start, after_ramp, certain_cell, posture, sketch
from twin.planner.trajectory_state import COLLISION, LEGAL, NO_PATH, OFF_MAP, Limits
from twin.planner.wave import BLOCKED, Cells, Wave, grid_value, reach
from twin.records import Array, Bytes

ILLEGAL, UNDECIDED, BEATEN = -1, -2, -3
"""What `check_sketch` answers instead of a cost byte; BEATEN: legal or not, it cannot win."""


class Ground(NamedTuple):
    """What arcs run over: the costmap, the footprint, and both waves as far as they have got."""

    cells: Bytes  # (ny, nx)
    origin_x: float  # [m]
    origin_y: float
    resolution: float  # [m]
    footprint: Array  # (n, 2) [m] base_link, n >= 3
    path: Wave
    goal: Wave


class Scratch(NamedTuple):
    """Room for one search. `first` must hold -1 everywhere between calls."""

    v: Array  # (>= vx_samples,) speeds [m/s] to try
    w: Array  # (>= vtheta_samples,) rates [rad/s] to try with each
    last: Cells  # (arcs,) wave cell of each candidate's last point, or OFF
    following: Cells  # (arcs,) the next arc with the same last cell, or -1
    first: Cells  # ((ny + 2) * (nx + 2),) the first arc with that last cell, or -1
    heap: Heap  # room for all arcs
    visited: Cells  # (points,) cells of one arc
    points: Array  # (points, 3) of one arc
    footprint: Array  # (n, 2) [cells]


class Rival(NamedTuple):
    """What an arc is up against: the parts of its own cost that are known, and the best cost so far."""

    path: float
    goal: float
    best: float  # inf: none yet
    wins_ties: bool


@compiled
def loses(limits: Limits, rival: Rival, obstacle: int) -> bool:
    """Whether an arc that has met this cost byte can no longer win."""
    cost = total_cost(limits, rival.path, rival.goal, float(obstacle))
    return cost > rival.best or (cost == rival.best and not rival.wins_ties)


@compiled
def outline_cost(flat: Bytes, size_x: int, size_y: int, footprint: Array, at: Posture) -> int:
    """`footprint_cost` at a posture in cells, for a footprint in cells; ILLEGAL or UNDECIDED."""
    corners = footprint.shape[0]
    highest = 0
    first_x, first_y, before_x, before_y = 0, 0, 0, 0
    for k in range(corners + 1):
        if k < corners:
            px, py = footprint[k, 0], footprint[k, 1]
            cx = certain_cell(at.x + (px * at.c - py * at.s), size_x)
            cy = certain_cell(at.y + (px * at.s + py * at.c), size_y)
            if cx < 0 or cy < 0:
                return ILLEGAL if cx == OFF or cy == OFF else UNDECIDED
        else:
            cx, cy = first_x, first_y
        if k == 0:
            first_x, first_y = cx, cy
        else:
            cost = line_cost(flat, size_x, before_x, before_y, cx, cy)
            if cost < 0:
                return ILLEGAL
            highest = max(highest, cost)
        before_x, before_y = cx, cy
    return highest


@compiled
def check_sketch(
    ground: Ground,
    limits: Limits,
    start: Start,
    target_v: float,
    target_w: float,
    obstacle: int,
    rival: Rival,
    footprint: Array,
    visited: Cells,
) -> int:
    """The highest cost byte of a legal arc whose first point is legal with byte `obstacle` and whose last point both
    waves have met; ILLEGAL, UNDECIDED or BEATEN.

    `footprint` is in cells. `visited` has the first and gets the other points' cells.
    """
    arc = sketch(limits, start, target_v, target_w)
    if not arc.sane:
        return UNDECIDED
    size_y, size_x = ground.cells.shape
    flat, path, goal = ground.cells.ravel(), ground.path.value, ground.goal.value
    half = 0.5 * target_w * arc.dt
    last = arc.points - 1
    stride = 1
    while 2 * stride < last:
        stride *= 2
    k = last
    while k > 0:  # the last point first, then in ever smaller strides, so that a collision shows soon
        if k < arc.ramp_steps:
            at = posture(limits, start, arc, target_v, target_w, k)
        else:
            at = after_ramp(arc, half, k - arc.ramp_steps)
        cx, cy = certain_cell(at.x, size_x), certain_cell(at.y, size_y)
        if cx < 0 or cy < 0:
            return ILLEGAL if cx == OFF or cy == OFF else UNDECIDED
        index = (cy + 1) * (size_x + 2) + cx + 1
        if path[index] == BLOCKED or goal[index] == BLOCKED:
            return ILLEGAL
        outline = outline_cost(flat, size_x, size_y, footprint, at)
        if outline < 0:
            return outline
        highest = max(outline, int(np.int64(flat[cy * size_x + cx])))
        if highest > obstacle:
            obstacle = highest
            if loses(limits, rival, obstacle):
                return BEATEN
        visited[k] = index
        k = stride if k == last else k + 2 * stride
        while k >= last and stride > 0:
            stride //= 2
            k = stride
    return obstacle if _connected(ground, visited, last) else ILLEGAL


@compiled
def _connected(ground: Ground, visited: Cells, last: int) -> bool:
    """Whether both waves get to every visited cell (none is blocked), given that they have met the last one.

    An arc whose steps lead from neighbour to neighbour carries the wave along. Across a corner it is carried by either
    of the cells beside the corner. Otherwise the waves must be asked.
    """
    width = ground.path.width
    for k in range(last):
        a, b = visited[k], visited[k + 1]
        step = abs(b - a)
        if step in (0, 1, width):
            continue
        beside = False
        if step in (width - 1, width + 1):
            row = width if b > a else -width
            beside = _passable(ground, a + row) or _passable(ground, b - row)
        if not beside:
            for j in range(last):
                if reach(ground.path, visited[j]) < 0 or reach(ground.goal, visited[j]) < 0:
                    return False
            return True
    return True


@compiled
def _passable(ground: Ground, index: int) -> bool:
    return bool(ground.path.value[index] != BLOCKED and ground.goal.value[index] != BLOCKED)


@compiled
def check_arc(
    ground: Ground,
    limits: Limits,
    motion: Motion,
    start: Start,
    v: float,
    w: float,
    obstacle: int,
    rival: Rival,
    scratch: Scratch,
) -> int:
    """`check_sketch`, or `check_driven` where that cannot tell: a cost byte, or negative if illegal or beaten."""
    found = check_sketch(ground, limits, start, v, w, obstacle, rival, scratch.footprint, scratch.visited)
    if found == UNDECIDED:
        score = check_driven(ground, limits, scratch.points, drive(limits, motion, v, w, scratch.points))
        found = int(score.obstacle) if score.cost >= 0.0 else ILLEGAL
    return found


@compiled
def check_driven(ground: Ground, limits: Limits, points: Array, count: int) -> Score:
    """`arcs.score_arc` over given points (>= count, 3), with the waves in place of complete grids."""
    size_y, size_x = ground.cells.shape
    path, goal, obstacle = 0, 0, 0
    for k in range(count):
        x, y, yaw = points[k, 0], points[k, 1], points[k, 2]
        mx, my = world_to_cell(x, y, ground.origin_x, ground.origin_y, ground.resolution, size_x, size_y)
        if mx < 0:
            return Score(-1.0, k, float(path), float(goal), float(obstacle), OFF_MAP)
        outline = footprint_cost(
            ground.cells, ground.origin_x, ground.origin_y, ground.resolution, x, y, yaw, ground.footprint
        )
        if outline < 0:
            reason = OFF_MAP if outline == FOOTPRINT_OFF_MAP else COLLISION
            return Score(-1.0, k, float(path), float(goal), float(obstacle), reason)
        obstacle = max(max(obstacle, outline), int(np.int64(ground.cells[my, mx])))
        index = (my + 1) * ground.path.width + mx + 1
        path, goal = reach(ground.path, index), reach(ground.goal, index)
        if path < 0 or goal < 0:
            path = grid_value(ground.path, index, size_x * size_y)
            goal = grid_value(ground.goal, index, size_x * size_y)
            return Score(-2.0, k, float(path), float(goal), float(obstacle), NO_PATH)
    cost = total_cost(limits, float(path), float(goal), float(obstacle))
    return Score(cost, count, float(path), float(goal), float(obstacle), LEGAL)
