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

import math
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from twin.compiled import compiled
from twin.planner.arc_check import BEATEN, ILLEGAL, UNDECIDED, Rival, loses, outline_cost
from twin.planner.arcs import (
    Costs,
    Motion,
    drive,
    in_place_rate,
    look_ahead_goal,
    score_arc,
    step_count,
    total_cost,
    velocity_window,
)
from twin.planner.footprint import footprint_cost
from twin.planner.grid import world_to_cell
from twin.planner.heap import Heap, empty_heap, pop, push
from twin.planner.sketch import OFF, UNCERTAIN, Posture, Sketch, Start, certain_cell, posture, sketch
from twin.planner.trajectory_state import Limits
from twin.records import Array, Bytes

NO_WAY = 255  # in `around`: there is no way from this cell to the plan or to the local goal
LOOK = 254  # in `around`: an outline may meet a lethal cell, or leave the map

Grid = NDArray[np.uint16] | NDArray[np.int32]

_Function = TypeVar("_Function", bound=Callable[..., object])


def inlined(function: _Function) -> _Function:
    """As `compiled`, and put into its callers' code."""
    machine_code: _Function = numba.njit(cache=True, error_model="numpy", inline="always")(function)
    return machine_code


class Stage(NamedTuple):
    """All steps that search an arc, with one inflation radius."""

    step: NDArray[np.int64]  # (m,) which steps these are
    cells: Bytes  # (m, ny, nx) inflated local maps
    around: Bytes  # (m, ny, nx) see `Floor`
    path: Grid  # (m, ny, nx)
    goal: Grid  # (m, ny, nx)
    origin: Array  # (m, 2) [m]
    motion: Array  # (m, 6) `Motion`, as find_best_path rounds it
    goal_distance: Array  # (m,) [m] to the end of the cropped plan


class Scene(NamedTuple):
    """One of them."""

    costs: Costs  # with complete grids
    around: Bytes
    motion: Motion
    goal_distance: float


class Floor(NamedTuple):
    """What a footprint stands on."""

    cells: Bytes  # (ny * nx,)
    around: Bytes  # (ny * nx,) the highest byte that any outline round this cell may meet; or NO_WAY, LOOK
    footprint: Array  # (n, 2) [cells] base_link
    size_x: int
    size_y: int


class Room(NamedTuple):
    """Working memory."""

    heap: Heap
    obstacle: NDArray[np.int32]  # (arcs,) the byte that an arc is known to meet; -1: its last point was not looked at
    path: Array  # (arcs,) path grid at the last point [cells]
    goal: Array  # (arcs,)
    v: Array  # (vx_samples,) [m/s]
    w: Array  # (vtheta_samples,) [rad/s]
    points: Array  # (points, 3)


class Best(NamedTuple):
    """The best candidate so far; cost < 0: none."""

    v: float
    w: float
    cost: float


def room_for(limits: Limits, speed: float, rate: float) -> Room:
    """Working memory for any search under these limits from at most |speed| [m/s] and |rate| [rad/s]."""
    fastest = max(limits.max_vel_x, limits.min_vel_x, abs(limits.escape_vel), speed)
    turn = max(limits.max_vel_theta, abs(limits.min_vel_theta), limits.min_in_place, rate)
    points = step_count(limits, fastest, turn) + 2
    arcs = limits.vx_samples * limits.vtheta_samples
    obstacle, path, goal = np.empty(arcs, dtype=np.int32), np.empty(arcs), np.empty(arcs)
    v, w = np.empty(limits.vx_samples), np.empty(limits.vtheta_samples)
    return Room(empty_heap(arcs), obstacle, path, goal, v, w, np.empty((points, 3)))


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
            best = _best_forward(scene, limits, obstacle, room)
            best = _best_turn(scene, limits, window.w_step, obstacle, best, room)
    if best.cost >= 0.0:
        return best
    backup = score_arc(costs, limits, motion, limits.escape_vel, 0.0, room.points)
    return Best(limits.escape_vel, 0.0, 1.0 if backup.cost == -1.0 else backup.cost)


@compiled
def _start(scene: Scene) -> Start:
    costs, motion = scene.costs, scene.motion
    per_metre = 1.0 / costs.resolution
    x, y = (motion.x - costs.origin_x) * per_metre, (motion.y - costs.origin_y) * per_metre
    return Start(Posture(x, y, math.cos(motion.yaw), math.sin(motion.yaw)), motion.v, motion.w, per_metre)


@compiled
def _floor(scene: Scene) -> Floor:
    size_y, size_x = scene.around.shape
    footprint = scene.costs.footprint * (1.0 / scene.costs.resolution)
    return Floor(scene.costs.cells.ravel(), scene.around.ravel(), footprint, size_x, size_y)


@compiled
def _last_cell(limits: Limits, start: Start, v: float, w: float, size_x: int, size_y: int) -> tuple[int, int]:
    """The cell of a candidate's last point by formula; each may be OFF or UNCERTAIN."""
    arc = sketch(limits, start, v, w)
    if not arc.sane:
        return UNCERTAIN, UNCERTAIN
    end = posture(limits, start, arc, v, w, arc.points - 1)
    return certain_cell(end.x, size_x), certain_cell(end.y, size_y)


@compiled
def _last_cell_driven(scene: Scene, limits: Limits, v: float, w: float, points: Array) -> tuple[int, int]:
    """The same, driven step by step as ROS does."""
    costs = scene.costs
    size_y, size_x = costs.cells.shape
    x, y, _ = points[drive(limits, scene.motion, v, w, points) - 1]
    return world_to_cell(x, y, costs.origin_x, costs.origin_y, costs.resolution, size_x, size_y)


@compiled
def _best_forward(scene: Scene, limits: Limits, obstacle: int, room: Room) -> Best:
    """The first of the cheapest forward arcs; all begin on a legal point with cost byte `obstacle`."""
    floor = _floor(scene)
    size_y, size_x = scene.around.shape
    start = _start(scene)
    heap, speeds, rates = room.heap, room.v, room.w
    turns = limits.vtheta_samples
    heap.size[0] = 0
    for i in range(limits.vx_samples):  # for each speed straight on first, then all rates but the highest
        for j in range(turns):
            v, w = speeds[i], rates[j - 1] if j > 0 else 0.0
            cx, cy = _last_cell(limits, start, v, w, size_x, size_y)
            if cx == UNCERTAIN or cy == UNCERTAIN:
                cx, cy = _last_cell_driven(scene, limits, v, w, room.points)
            if cx < 0 or cy < 0 or scene.around[cy, cx] == NO_WAY:
                continue
            arc = i * turns + j
            path, goal = float(scene.costs.path[cy, cx]), float(scene.costs.goal[cy, cx])
            room.path[arc], room.goal[arc], room.obstacle[arc] = path, goal, -1
            push(heap, total_cost(limits, path, goal, float(obstacle)), arc)

    best_cost, best_arc = np.inf, -1
    while heap.size[0] > 0:
        bound = heap.cost[0]
        if bound > best_cost or (bound == best_cost and heap.arc[0] > best_arc):
            break
        arc = pop(heap)
        v, w = speeds[arc // turns], rates[arc % turns - 1] if arc % turns > 0 else 0.0
        curve = sketch(limits, start, v, w)
        path, goal = room.path[arc], room.goal[arc]
        if room.obstacle[arc] < 0 and curve.sane:
            met = _look_at(floor, posture(limits, start, curve, v, w, curve.points - 1), obstacle)
            if met == ILLEGAL:
                continue
            room.obstacle[arc] = obstacle if met == UNDECIDED else met
            raised = total_cost(limits, path, goal, float(room.obstacle[arc]))
            if raised > bound:
                push(heap, raised, arc)
                continue
        known = max(obstacle, int(room.obstacle[arc]))
        found = _check(floor, limits, start, curve, v, w, known, Rival(path, goal, best_cost, arc < best_arc))
        if found == UNDECIDED:
            found = _check_driven(scene, limits, v, w, room.points)
        if found >= 0:
            cost = total_cost(limits, path, goal, float(found))
            if cost < best_cost or (cost == best_cost and arc < best_arc):
                best_cost, best_arc = cost, arc
    if best_arc < 0:
        return Best(0.0, 0.0, -1.0)
    return Best(speeds[best_arc // turns], rates[best_arc % turns - 1] if best_arc % turns > 0 else 0.0, best_cost)


@compiled
def _best_turn(scene: Scene, limits: Limits, step: float, obstacle: int, best: Best, room: Room) -> Best:
    """Turns in place, one by one as in ROS: each against the best before it and the best look-ahead so far.

    `step` [rad/s] between samples is not limited: the slowest samples within one step of 0 are ruled out.
    """
    costs, floor = scene.costs, _floor(scene)
    size_y, size_x = costs.cells.shape
    start = _start(scene)
    best_ahead = np.inf
    for k in range(limits.vtheta_samples):
        sample = room.w[k]
        if not (sample > step or sample < -1.0 * step) or sample == 0.0:
            continue
        rate = in_place_rate(limits, sample)
        cx, cy = _last_cell(limits, start, 0.0, rate, size_x, size_y)
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
