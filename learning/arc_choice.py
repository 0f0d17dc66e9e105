"""Which arc G takes, once everything that theta's speeds and weights do not touch is known.

Eq. 1 asks this a hundred thousand times about the same few scenes. Much of `find_best_path`'s time goes into the map
grids; here they are given, complete, so that the cost of every arc without obstacles is known at once and is a lower
bound. Arcs are taken cheapest bound first; the outline at an arc's last point raises its bound; then the whole arc is
checked, and once no bound undercuts the best it has won. Of equals the earlier sample wins, as in ROS. The answer is
that of `find_best_path`, bit for bit (the tests compare them), for a robot without flags from earlier ticks.

Functions that are called per arc or per point take as few arrays as they can or are inlined: numba counts a reference
for every array of a tuple at every call, which costs more than the work.
"""

from __future__ import annotations

import numpy as np

from learning.arc_scene import NO_WAY, Best, Floor, Room, Scene, Stage
from twin.compiled import compiled, inlined
from twin.planner.arc_check import BEATEN, ILLEGAL, UNDECIDED, Rival, loses, outline_cost
from twin.planner.arcs import (
    Costs,
    Motion,
    drive,
    in_place_rate,
    look_ahead_goal,
    score_arc,
    total_cost,
    velocity_window,
)
from twin.planner.footprint import footprint_cost
from twin.planner.grid import world_to_cell
from twin.planner.heap import pop, push
from twin.planner.sketch import (
    OFF,
    UNCERTAIN,
    Posture,
    Sketch,
    Start,
    certain_cell,
    last_cell,
    last_cells,
    posture,
    sketch,
    start_of,
)
from twin.planner.trajectory_state import Limits
from twin.records import Array


@compiled
def choose_arcs(stage: Stage, resolution: float, footprint: Array, limits: Limits, room: Room, actions: Array) -> None:
    """Fill in the actions (n, 2) of the steps on stage; those without a possible command stay as they are."""
    for k in range(len(stage.step)):
        m = stage.motion[k]
        scene = Scene(
            Costs(
                stage.cells[k], stage.origin[k, 0], stage.origin[k, 1], resolution, stage.path[k], stage.goal[k],
                footprint,
            ),
            stage.around[k],
            Motion(m[0], m[1], m[2], m[3], m[4], m[5]),
            stage.goal_distance[k],
        )  # fmt: skip
        best = choose_arc(scene, limits, room)
        if best.cost >= 0.0:
            actions[stage.step[k], 0], actions[stage.step[k], 1] = best.v, best.w


@compiled
def choose_arc(scene: Scene, limits: Limits, room: Room) -> Best:
    """What `find_best_path` commands: v [m/s], w [rad/s] and the cost, below 0 if even the backup is impossible."""
    costs, motion = scene.costs, scene.motion
    size_y, size_x = costs.cells.shape
    best = Best(0.0, 0.0, -1.0)
    mx, my = world_to_cell(motion.x, motion.y, costs.origin_x, costs.origin_y, costs.resolution, size_x, size_y)
    if mx >= 0 and scene.around[my, mx] != NO_WAY:
        outline = footprint_cost(
            costs.cells, costs.origin_x, costs.origin_y, costs.resolution, motion.x, motion.y, motion.yaw,
            costs.footprint,
        )  # fmt: skip
        if outline >= 0:  # otherwise no candidate is legal, because all begin here
            obstacle = max(outline, int(np.int64(costs.cells[my, mx])))
            window = velocity_window(limits, scene.goal_distance, motion.v, motion.w)
            v, w = window.v_min, window.w_min
            for i in range(limits.vx_samples):
                room.v[i] = v
                v += window.v_step
            for j in range(limits.vtheta_samples):
                room.w[j] = w
                w += window.w_step
            room.rates[0] = 0.0
            room.rates[1:] = room.w[:-1]
            best = _best_forward(scene, limits, obstacle, room)
            best = _best_turn(scene, limits, window.w_step, obstacle, best, room)
    if best.cost >= 0.0:
        return best
    backup = score_arc(costs, limits, motion, limits.escape_vel, 0.0, room.points)
    return Best(limits.escape_vel, 0.0, 1.0 if backup.cost == -1.0 else backup.cost)


@compiled
def _floor(scene: Scene) -> Floor:
    size_y, size_x = scene.around.shape
    footprint = scene.costs.footprint * (1.0 / scene.costs.resolution)
    return Floor(scene.costs.cells.ravel(), scene.around.ravel(), footprint, size_x, size_y)


@compiled
def _last_cell_driven(scene: Scene, limits: Limits, v: float, w: float, points: Array) -> tuple[int, int]:
    """The cell of a candidate's last point, driven there step by step as ROS does."""
    costs = scene.costs
    size_y, size_x = costs.cells.shape
    x, y, _ = points[drive(limits, scene.motion, v, w, points) - 1]
    return world_to_cell(x, y, costs.origin_x, costs.origin_y, costs.resolution, size_x, size_y)


@compiled
def _list_arcs(scene: Scene, limits: Limits, start: Start, obstacle: int, room: Room) -> int:
    """Path, goal and bound of every forward arc (inf: its last point is illegal); returns the arc of lowest bound."""
    size_y, size_x = scene.around.shape
    width = size_x + 2  # of the cell numbers that last_cells gives (see wave.py)
    around, path_grid, goal_grid = scene.around, scene.costs.path, scene.costs.goal
    last, path, goal, bound = room.last, room.path, room.goal, room.bound
    turns = len(room.rates)
    last_cells(limits, start, room.v, room.rates, size_x, size_y, last)
    lowest = 0
    for arc in range(len(last)):
        cell = last[arc]
        if cell == UNCERTAIN:
            cx, cy = _last_cell_driven(scene, limits, room.v[arc // turns], room.rates[arc % turns], room.points)
            cell = (cy + 1) * width + cx + 1 if cx >= 0 else OFF
        bound[arc] = np.inf
        if cell >= 0:
            cx, cy = cell % width - 1, cell // width - 1
            if around[cy, cx] != NO_WAY:
                path[arc], goal[arc] = path_grid[cy, cx], goal_grid[cy, cx]
                bound[arc] = total_cost(limits, path[arc], goal[arc], float(obstacle))
        if bound[arc] < bound[lowest]:
            lowest = arc
    return lowest


@compiled
def _best_forward(scene: Scene, limits: Limits, obstacle: int, room: Room) -> Best:
    """The first of the cheapest forward arcs; all begin on a legal point with cost byte `obstacle`."""
    costs, floor = scene.costs, _floor(scene)
    start = start_of(scene.motion, costs.origin_x, costs.origin_y, costs.resolution)
    heap, bounds, looked = room.heap, room.bound, room.obstacle
    paths, goals, speeds, rates = room.path, room.goal, room.v, room.rates
    turns = len(rates)
    lowest = _list_arcs(scene, limits, start, obstacle, room)
    best_cost, best_arc = np.inf, -1
    heap.size[0] = 0
    if bounds[lowest] < np.inf:
        looked[lowest] = -1
        push(heap, bounds[lowest], lowest)
    listed = False
    while heap.size[0] > 0 or not listed:
        if heap.size[0] == 0:  # the most promising arc has been checked, so that hopeless ones need not be listed
            listed = True
            for arc in range(len(bounds)):
                beats = bounds[arc] < best_cost or (bounds[arc] == best_cost and arc < best_arc)
                if beats and arc != lowest:
                    looked[arc] = -1
                    push(heap, bounds[arc], arc)
            continue
        bound = heap.cost[0]
        if bound > best_cost or (bound == best_cost and heap.arc[0] > best_arc):
            break
        arc = pop(heap)
        v, w = speeds[arc // turns], rates[arc % turns]
        path, goal = paths[arc], goals[arc]
        curve = sketch(limits, start, v, w)
        if looked[arc] < 0 and curve.sane:
            met = _look_at(floor, posture(limits, start, curve, v, w, curve.points - 1), obstacle)
            if met == ILLEGAL:
                continue
            looked[arc] = obstacle if met == UNDECIDED else met
            raised = total_cost(limits, path, goal, float(looked[arc]))
            if raised > bound:
                push(heap, raised, arc)
                continue
        known = max(obstacle, int(looked[arc]))
        found = _check(floor, limits, start, curve, v, w, known, Rival(path, goal, best_cost, arc < best_arc))
        if found == UNDECIDED:
            found = _check_driven(scene, limits, v, w, room.points)
        if found >= 0:
            cost = total_cost(limits, path, goal, float(found))
            if cost < best_cost or (cost == best_cost and arc < best_arc):
                best_cost, best_arc = cost, arc
    if best_arc < 0:
        return Best(0.0, 0.0, -1.0)
    return Best(speeds[best_arc // turns], rates[best_arc % turns], best_cost)


@compiled
def _best_turn(scene: Scene, limits: Limits, step: float, obstacle: int, best: Best, room: Room) -> Best:
    """Turns in place, one by one as in ROS: each against the best before it and the best look-ahead so far.

    `step` [rad/s] between samples is not limited: the slowest samples within one step of 0 are ruled out.
    """
    costs, floor = scene.costs, _floor(scene)
    size_y, size_x = costs.cells.shape
    start = start_of(scene.motion, costs.origin_x, costs.origin_y, costs.resolution)
    best_ahead = np.inf
    for k in range(limits.vtheta_samples):
        sample = room.w[k]
        if not (sample > step or sample < -1.0 * step) or sample == 0.0:
            continue
        rate = in_place_rate(limits, sample)
        cx, cy = last_cell(limits, start, 0.0, rate, size_x, size_y)
        if cx == UNCERTAIN or cy == UNCERTAIN:
            cx, cy = _last_cell_driven(scene, limits, 0.0, rate, room.points)
        if cx < 0 or cy < 0 or scene.around[cy, cx] == NO_WAY:
            continue
        limit = best.cost if best.cost >= 0.0 else np.inf
        path, goal = float(costs.path[cy, cx]), float(costs.goal[cy, cx])
        if total_cost(limits, path, goal, float(obstacle)) > limit:
            continue
        curve = sketch(limits, start, 0.0, rate)
        ahead = _goal_ahead(scene, limits, start, curve, rate, room.points)
        if not 0.0 <= ahead < best_ahead:
            continue
        found = _check(floor, limits, start, curve, 0.0, rate, obstacle, Rival(path, goal, limit, True))
        if found == UNDECIDED:
            found = _check_driven(scene, limits, 0.0, rate, room.points)
        cost = total_cost(limits, path, goal, float(found))
        if found >= 0 and cost <= limit:
            best, best_ahead = Best(0.0, rate, cost), ahead
    return best


@compiled
def _goal_ahead(scene: Scene, limits: Limits, start: Start, curve: Sketch, rate: float, points: Array) -> float:
    """The goal grid `heading_lookahead` beyond the last point of a turn in place; -1 off the map."""
    costs = scene.costs
    size_y, size_x = costs.cells.shape
    cx, cy = UNCERTAIN, UNCERTAIN
    if curve.sane:
        end = posture(limits, start, curve, 0.0, rate, curve.points - 1)
        ahead = limits.heading_lookahead * start.per_metre
        cx, cy = certain_cell(end.x + ahead * end.c, size_x), certain_cell(end.y + ahead * end.s, size_y)
    if cx == UNCERTAIN or cy == UNCERTAIN:
        x, y, yaw = points[drive(limits, scene.motion, 0.0, rate, points) - 1]
        return look_ahead_goal(costs, x, y, yaw, limits.heading_lookahead)
    return -1.0 if cx < 0 or cy < 0 else float(costs.goal[cy, cx])


@compiled
def _check(
    floor: Floor, limits: Limits, start: Start, curve: Sketch, v: float, w: float, obstacle: int, rival: Rival
) -> int:
    """The highest byte that a candidate meets; ILLEGAL, UNDECIDED, or BEATEN when it cannot win, legal or not.

    The last point first, then in ever smaller strides, so that trouble shows soon.
    """
    if not curve.sane:
        return UNDECIDED
    last = curve.points - 1
    stride = 1
    while 2 * stride < last:
        stride *= 2
    k = last
    while k > 0:
        met = _look_at(floor, posture(limits, start, curve, v, w, k), obstacle)
        if met < 0:
            return met
        if met > obstacle:
            obstacle = met
            if loses(limits, rival, obstacle):
                return BEATEN
        k = stride if k == last else k + 2 * stride
        while k >= last and stride > 0:
            stride //= 2
            k = stride
    return obstacle


@compiled
def _check_driven(scene: Scene, limits: Limits, v: float, w: float, points: Array) -> int:
    """The same, driven step by step as ROS does."""
    score = score_arc(scene.costs, limits, scene.motion, v, w, points)
    return int(score.obstacle) if score.cost >= 0.0 else ILLEGAL


@inlined
def _look_at(floor: Floor, at: Posture, obstacle: int) -> int:
    """The highest byte met so far with this point; ILLEGAL, or UNDECIDED so close to a cell's border."""
    cx, cy = certain_cell(at.x, floor.size_x), certain_cell(at.y, floor.size_y)
    if cx < 0 or cy < 0:
        return ILLEGAL if cx == OFF or cy == OFF else UNDECIDED
    here = cy * floor.size_x + cx
    highest = int(np.int64(floor.around[here]))
    if highest <= obstacle:
        return obstacle
    if highest == NO_WAY:
        return ILLEGAL
    outline = outline_cost(floor.cells, floor.size_x, floor.size_y, floor.footprint, at)
    return outline if outline < 0 else max(max(obstacle, outline), int(np.int64(floor.cells[here])))
