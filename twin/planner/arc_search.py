"""The best arc with little work: the same answer as `arcs.search_all`, bit for bit.

A legal forward arc costs path_bias * path + goal_bias * goal + occdist_scale * obstacle, where path and goal belong to
its last point alone. So every arc's last cell is found first (`sketch.py`), the goal wave runs from the local goal
towards the robot, and an arc becomes known when the wave meets its last cell. Known arcs are tried in the order of
their cost without obstacles; the first that proves legal bounds all others, and the waves stop as soon as nothing that
they have not met can be cheaper. Of equals the earlier sample wins, which is ROS's order. Turns in place come after,
one by one as in ROS, because each acceptance depends on the one before; but only those that can still win are tried.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twin.planner.arc_check import UNDECIDED, Ground, Rival, check_driven, check_sketch
from twin.planner.arcs import Motion, Score, Window, drive, in_place_rate, total_cost
from twin.planner.footprint import footprint_cost
from twin.planner.grid import compiled, world_to_cell
from twin.planner.heap import Heap, pop, push
from twin.planner.sketch import UNCERTAIN, Posture, Start, certain_cell, posture, sketch
from twin.planner.trajectory_state import LEGAL, Limits
from twin.planner.wave import BLOCKED, HEAD, TAIL, Cells, at_least, grid_value, reach, spread_from
from twin.records import Array


class Scratch(NamedTuple):
    """Room for one search; `first` must hold -1 everywhere between calls."""

    last: Cells  # (arcs,) cell of each forward arc's last point
    following: Cells  # (arcs,) the next arc with the same last cell, or -1
    first: Cells  # ((ny + 2) * (nx + 2),) the first arc with that last cell, or -1
    heap: Heap  # room for all arcs
    v: Array  # (vx_samples,)
    w: Array  # (vtheta_samples,)
    visited: Cells  # (points,) cells of one arc
    points: Array  # (points, 3) of one arc


class Best(NamedTuple):
    """The best candidate so far; cost < 0: none."""

    v: float
    w: float
    cost: float
    last: int  # cell of its last point
    obstacle: int


@compiled
def search(
    ground: Ground,
    limits: Limits,
    window: Window,
    motion: Motion,
    escaping: bool,
    stuck_left: bool,
    stuck_right: bool,
    scratch: Scratch,
) -> tuple[float, float, Score, bool]:
    """What `search_all` chooses, for a start without lateral velocity: v, w, the arc's end, whether it is the backup.

    The waves must have their seeds and may have spread any distance. The arc's points are left in `scratch.points`.
    """
    per_metre = 1.0 / ground.resolution
    at = Posture(
        (motion.x - ground.origin_x) * per_metre,
        (motion.y - ground.origin_y) * per_metre,
        math.cos(motion.yaw),
        math.sin(motion.yaw),
    )
    start = Start(at, motion.v, motion.w, per_metre)
    best = Best(0.0, 0.0, -1.0, 0, 0)
    here, obstacle = _first_point(ground, motion)
    if obstacle >= 0:  # otherwise no candidate is legal, because all begin here
        scratch.visited[0] = here
        if not escaping:
            best = _best_forward(ground, limits, window, motion, start, here, obstacle, scratch)
        best = _best_turn(ground, limits, window, motion, start, here, obstacle, stuck_left, stuck_right, best, scratch)
    if best.cost < 0.0:
        count = drive(limits, motion, limits.escape_vel, 0.0, scratch.points)
        return limits.escape_vel, 0.0, check_driven(ground, limits, scratch.points, count), True
    count = drive(limits, motion, best.v, best.w, scratch.points)
    path, goal = float(ground.path.value[best.last]), float(ground.goal.value[best.last])
    return best.v, best.w, Score(best.cost, count, path, goal, float(best.obstacle), LEGAL), False


@compiled
def _first_point(ground: Ground, motion: Motion) -> tuple[int, int]:
    """The wave cell and the cost byte of the point where all arcs begin; a negative byte if it is certainly illegal."""
    cx, cy = _cell(ground, motion.x, motion.y)
    here = _index(ground, cx, cy)
    if here < 0 or _blocked(ground, here):
        return here, -1
    outline = footprint_cost(
        ground.cells, ground.origin_x, ground.origin_y, ground.resolution, motion.x, motion.y, motion.yaw,
        ground.footprint,
    )  # fmt: skip
    return here, -1 if outline < 0 else max(outline, int(np.int64(ground.cells[cy, cx])))


@compiled
def _last_cell(
    ground: Ground, limits: Limits, motion: Motion, start: Start, here: int, v: float, w: float, scratch: Scratch
) -> int:
    """The wave cell of a candidate's last point; BLOCKED when that is off the map or on an obstacle."""
    size_y, size_x = ground.cells.shape
    arc = sketch(limits, start, v, w)
    if arc.points == 1:
        return here
    cx, cy = UNCERTAIN, UNCERTAIN
    if arc.sane:
        end = posture(limits, start, arc, v, w, arc.points - 1)
        cx, cy = certain_cell(end.x, size_x), certain_cell(end.y, size_y)
    if cx == UNCERTAIN or cy == UNCERTAIN:
        k = drive(limits, motion, v, w, scratch.points) - 1
        cx, cy = _cell(ground, scratch.points[k, 0], scratch.points[k, 1])
    index = _index(ground, cx, cy)
    return BLOCKED if index < 0 or _blocked(ground, index) else index


@compiled
def _cell_ahead(ground: Ground, limits: Limits, motion: Motion, start: Start, rate: float, scratch: Scratch) -> int:
    """The wave cell that lies heading_lookahead beyond the last point of a turn in place; -1 when off the map."""
    size_y, size_x = ground.cells.shape
    arc = sketch(limits, start, 0.0, rate)
    cx, cy = UNCERTAIN, UNCERTAIN
    if arc.sane:
        end = posture(limits, start, arc, 0.0, rate, arc.points - 1)
        ahead = limits.heading_lookahead * start.per_metre
        cx, cy = certain_cell(end.x + ahead * end.c, size_x), certain_cell(end.y + ahead * end.s, size_y)
    if cx == UNCERTAIN or cy == UNCERTAIN:
        end_x, end_y, end_yaw = scratch.points[drive(limits, motion, 0.0, rate, scratch.points) - 1]
        cx, cy = _cell(
            ground,
            end_x + limits.heading_lookahead * math.cos(end_yaw),
            end_y + limits.heading_lookahead * math.sin(end_yaw),
        )
    return _index(ground, cx, cy)


@compiled
def _cell(ground: Ground, x: float, y: float) -> tuple[int, int]:
    size_y, size_x = ground.cells.shape
    return world_to_cell(x, y, ground.origin_x, ground.origin_y, ground.resolution, size_x, size_y)


@compiled
def _index(ground: Ground, cx: int, cy: int) -> int:
    """The wave cell; -1 off the map."""
    return (cy + 1) * ground.path.width + cx + 1 if cx >= 0 and cy >= 0 else -1


@compiled
def _blocked(ground: Ground, index: int) -> bool:
    return ground.path.value[index] == BLOCKED or ground.goal.value[index] == BLOCKED


@compiled
def _check(
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
    """The highest cost byte of a candidate whose last cell both waves have met; negative if illegal or beaten."""
    arc = sketch(limits, start, v, w)
    found = UNDECIDED
    if arc.sane:
        found = check_sketch(ground, limits, start, arc, v, w, obstacle, rival, scratch.visited)
    if found == UNDECIDED:
        score = check_driven(ground, limits, scratch.points, drive(limits, motion, v, w, scratch.points))
        found = int(score.obstacle) if score.cost >= 0.0 else -1
    return found


@compiled
def _best_forward(
    ground: Ground,
    limits: Limits,
    window: Window,
    motion: Motion,
    start: Start,
    here: int,
    obstacle: int,
    scratch: Scratch,
) -> Best:
    """Part A: the first of the cheapest forward arcs. All begin on a legal point with cost byte `obstacle`."""
    path, goal, heap = ground.path, ground.goal, scratch.heap
    unknown = _list_arcs(ground, limits, window, motion, start, here, scratch)
    heap.size[0] = 0
    announced = 0
    best_cost, best_arc, best_obstacle = np.inf, -1, 0
    while True:
        unknown_cost = np.inf  # no arc that is still unknown can be cheaper
        if unknown > 0 and announced < goal.ends[TAIL]:
            unknown_cost = total_cost(limits, 0.0, float(goal.value[goal.queue[announced]]), float(obstacle))
        can_win = heap.size[0] > 0 and (
            heap.cost[0] < best_cost or (heap.cost[0] == best_cost and heap.arc[0] < best_arc)
        )
        if unknown_cost < np.inf and unknown_cost <= best_cost and not (can_win and heap.cost[0] <= unknown_cost):
            announced, met = _meet_arcs(ground, limits, obstacle, announced, scratch)
            unknown -= met
            continue
        if not can_win:
            break
        bound = heap.cost[0]
        arc = pop(heap)
        index = scratch.last[arc]
        steps = reach(path, index)
        if steps < 0:
            continue
        cost = total_cost(limits, float(steps), float(goal.value[index]), float(obstacle))
        if cost > bound:  # the path wave was not here yet when the arc became known
            push(heap, cost, arc)
            continue
        v, w = _sample(limits, scratch, arc)
        rival = Rival(float(steps), float(goal.value[index]), best_cost, arc < best_arc)
        found = _check(ground, limits, motion, start, v, w, obstacle, rival, scratch)
        if found >= 0:
            cost = total_cost(limits, rival.path, rival.goal, float(found))
            if cost < best_cost or (cost == best_cost and arc < best_arc):
                best_cost, best_arc, best_obstacle = cost, arc, found
    for arc in range(limits.vx_samples * limits.vtheta_samples):
        if scratch.last[arc] >= 0:
            scratch.first[scratch.last[arc]] = -1
    if best_arc < 0:
        return Best(0.0, 0.0, -1.0, 0, 0)
    v, w = _sample(limits, scratch, best_arc)
    return Best(v, w, best_cost, int(np.int64(scratch.last[best_arc])), best_obstacle)


@compiled
def _list_arcs(
    ground: Ground, limits: Limits, window: Window, motion: Motion, start: Start, here: int, scratch: Scratch
) -> int:
    """Chain all forward arcs to their last cells; returns how many have one that is not blocked."""
    v, w = window.v_min, window.w_min
    for i in range(limits.vx_samples):
        scratch.v[i] = v
        v += window.v_step
    for j in range(limits.vtheta_samples):
        scratch.w[j] = w
        w += window.w_step
    listed = 0
    for arc in range(limits.vx_samples * limits.vtheta_samples):
        v, w = _sample(limits, scratch, arc)
        index = _last_cell(ground, limits, motion, start, here, v, w, scratch)
        scratch.last[arc] = index
        if index >= 0:
            scratch.following[arc] = scratch.first[index]
            scratch.first[index] = arc
            listed += 1
    return listed


@compiled
def _sample(limits: Limits, scratch: Scratch, arc: int) -> tuple[float, float]:
    """The command of forward arc number `arc`: for each v straight on first, then all rates but the highest."""
    turn = arc % limits.vtheta_samples
    return scratch.v[arc // limits.vtheta_samples], scratch.w[turn - 1] if turn > 0 else 0.0


@compiled
def _meet_arcs(ground: Ground, limits: Limits, obstacle: int, announced: int, scratch: Scratch) -> tuple[int, int]:
    """Put the arcs that end in the goal wave's next level of cells on the heap.

    `announced` says how far along the wave's queue that has been done; a check of an arc may have let the wave itself
    run ahead. Returns the new `announced` and how many arcs were met.
    """
    path, goal = ground.path, ground.goal
    head, tail = goal.ends[HEAD], goal.ends[TAIL]
    level = goal.value[goal.queue[announced]]
    met = 0
    while announced < tail and goal.value[goal.queue[announced]] == level:
        index = goal.queue[announced]
        announced += 1
        if head < announced:
            tail = spread_from(goal.value, goal.queue, tail, index, goal.width)
            head = announced
        arc = scratch.first[index]
        while arc >= 0:
            steps = at_least(path, index)
            if steps >= 0:
                push(scratch.heap, total_cost(limits, float(steps), float(level), float(obstacle)), arc)
            met += 1
            arc = scratch.following[arc]
    goal.ends[HEAD], goal.ends[TAIL] = head, tail
    return announced, met


@compiled
def _best_turn(
    ground: Ground,
    limits: Limits,
    window: Window,
    motion: Motion,
    start: Start,
    here: int,
    obstacle: int,
    stuck_left: bool,
    stuck_right: bool,
    best: Best,
    scratch: Scratch,
) -> Best:
    """Part C: turns in place, each against the best before it and the best look-ahead so far."""
    cells = ground.cells.size
    best_ahead = np.inf
    sample = window.w_min
    for k in range(limits.vtheta_samples):
        if k > 0:
            sample += window.w_step
        turning = sample > window.w_step or sample < -1.0 * window.w_step
        allowed = (sample < 0.0 and not stuck_left) or (sample > 0.0 and not stuck_right)
        if not (turning and allowed):
            continue
        rate = in_place_rate(limits, sample)
        end = _last_cell(ground, limits, motion, start, here, 0.0, rate, scratch)
        beaten = end < 0
        for exact in (False, True):  # first by what the waves know already
            if beaten:
                break
            steps = reach(ground.path, end) if exact else at_least(ground.path, end)
            goal_steps = reach(ground.goal, end) if exact else at_least(ground.goal, end)
            cost = total_cost(limits, float(steps), float(goal_steps), float(obstacle))
            beaten = steps < 0 or goal_steps < 0 or (best.cost >= 0.0 and cost > best.cost)
        if beaten:
            continue
        ahead_cell = _cell_ahead(ground, limits, motion, start, rate, scratch)
        if ahead_cell < 0:
            continue
        ahead = float(grid_value(ground.goal, ahead_cell, cells))
        if not ahead < best_ahead:
            continue
        limit = best.cost if best.cost >= 0.0 else np.inf
        rival = Rival(float(ground.path.value[end]), float(ground.goal.value[end]), limit, True)
        found = _check(ground, limits, motion, start, 0.0, rate, obstacle, rival, scratch)
        if found >= 0:
            cost = total_cost(limits, rival.path, rival.goal, float(found))
            if cost <= limit:
                best, best_ahead = Best(0.0, rate, cost, end, found), ahead
    return best
