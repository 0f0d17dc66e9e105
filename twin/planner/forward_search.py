"""The best forward arc with little work: the same answer as part A of `arcs.search_all`, bit for bit.

A legal forward arc costs path_bias * path + goal_bias * goal + occdist_scale * obstacle, where path and goal belong to
its last point alone. So every arc's last cell is found first (`sketch.py`), the goal wave runs from the local goal
towards the robot, and an arc becomes known when the wave meets its last cell. Known arcs are tried in the order of
their cost without obstacles; the first that proves legal bounds all others, and the waves stop as soon as nothing that
they have not met can be cheaper. Of equals the earlier sample wins, which is ROS's order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twin.compiled import compiled
from twin.planner.arc_check import Ground, Rival, Scratch, check_arc
from twin.planner.arcs import Motion, Window, drive, total_cost
from twin.planner.grid import world_to_cell
from twin.planner.heap import pop, push
from twin.planner.sketch import OFF, UNCERTAIN, Start, last_cells
from twin.planner.trajectory_state import Limits
from twin.planner.wave import BLOCKED, HEAD, TAIL, at_least, reach, spread_from
from twin.records import Array


class Best(NamedTuple):
    """The best candidate so far; cost < 0: none."""

    v: float
    w: float
    cost: float
    last: int  # cell of its last point
    obstacle: int


@compiled
def find_last_cells(
    ground: Ground, limits: Limits, motion: Motion, start: Start, v: Array, w: Array, scratch: Scratch
) -> None:
    """The cells of the last points of the candidates (v[i], w[j]), to `scratch.last`; OFF also where one blocks."""
    size_y, size_x = ground.cells.shape
    last, path, goal = scratch.last, ground.path.value, ground.goal.value
    last_cells(limits, start, v, w, size_x, size_y, last)
    for arc in range(len(v) * len(w)):
        index = last[arc]
        if index == UNCERTAIN:
            k = drive(limits, motion, v[arc // len(w)], w[arc % len(w)], scratch.points) - 1
            index = wave_cell(ground, scratch.points[k, 0], scratch.points[k, 1])
        if index != OFF and (path[index] == BLOCKED or goal[index] == BLOCKED):
            index = OFF
        last[arc] = index


@compiled
def wave_cell(ground: Ground, x: float, y: float) -> int:
    """The wave cell of a point [m]; OFF the map."""
    size_y, size_x = ground.cells.shape
    cx, cy = world_to_cell(x, y, ground.origin_x, ground.origin_y, ground.resolution, size_x, size_y)
    return (cy + 1) * (size_x + 2) + cx + 1 if cx >= 0 else OFF


@compiled
def best_forward(
    ground: Ground, limits: Limits, window: Window, motion: Motion, start: Start, obstacle: int, scratch: Scratch
) -> Best:
    """Part A: the first of the cheapest forward arcs. All begin on a legal point with cost byte `obstacle`."""
    goal, heap, last, first = ground.goal, scratch.heap, scratch.last, scratch.first
    turns = limits.vtheta_samples
    arcs = limits.vx_samples * turns
    sample = window.v_min
    for i in range(limits.vx_samples):
        scratch.v[i] = sample
        sample += window.v_step
    scratch.w[0], sample = 0.0, window.w_min
    for j in range(1, turns):  # the highest rate is never driven
        scratch.w[j] = sample
        sample += window.w_step
    find_last_cells(ground, limits, motion, start, scratch.v[: limits.vx_samples], scratch.w[:turns], scratch)
    unknown = 0
    for arc in range(arcs):
        index = last[arc]
        if index >= 0:
            scratch.following[arc] = first[index]
            first[index] = arc
            unknown += 1

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
        steps = reach(ground.path, last[arc])
        if steps < 0:
            continue
        cost = total_cost(limits, float(steps), float(goal.value[last[arc]]), float(obstacle))
        if cost > bound:  # the path wave was not here yet when the arc became known
            push(heap, cost, arc)
            continue
        rival = Rival(float(steps), float(goal.value[last[arc]]), best_cost, arc < best_arc)
        v, w = scratch.v[arc // turns], scratch.w[arc % turns]
        found = check_arc(ground, limits, motion, start, v, w, obstacle, rival, scratch)
        if found >= 0:
            cost = total_cost(limits, rival.path, rival.goal, float(found))
            if cost < best_cost or (cost == best_cost and arc < best_arc):
                best_cost, best_arc, best_obstacle = cost, arc, found
    for arc in range(arcs):
        if last[arc] >= 0:
            first[last[arc]] = -1
    if best_arc < 0:
        return Best(0.0, 0.0, -1.0, 0, 0)
    index = int(np.int64(last[best_arc]))
    return Best(scratch.v[best_arc // turns], scratch.w[best_arc % turns], best_cost, index, best_obstacle)


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
