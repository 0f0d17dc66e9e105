"""The best turn in place: part C of `arcs.search_all`.

Whether one is taken depends on those before it, so they come one by one as in ROS. But only those that can still win
are looked at: by what the waves know already, then by the goal grid ahead of the robot, and only then point by point.
"""

from __future__ import annotations

import math

import numpy as np

from twin.compiled import compiled
from twin.planner.arc_check import Ground, Rival, Scratch, check_arc
from twin.planner.arcs import Motion, Window, drive, in_place_rate, total_cost
from twin.planner.forward_search import Best, find_last_cells, wave_cell
from twin.planner.sketch import OFF, Start, certain_cell, posture, sketch
from twin.planner.trajectory_state import Limits
from twin.planner.wave import at_least, grid_value, reach


@compiled
def best_turn(
    ground: Ground,
    limits: Limits,
    window: Window,
    motion: Motion,
    start: Start,
    obstacle: int,
    stuck_left: bool,
    stuck_right: bool,
    best: Best,
    scratch: Scratch,
) -> Best:
    """`best`, or the turn in place that wins against it. All begin on a legal point with cost byte `obstacle`."""
    path, goal = ground.path, ground.goal
    count = 0
    sample = window.w_min
    for _ in range(limits.vtheta_samples):
        turning = sample > window.w_step or sample < -1.0 * window.w_step  # not limited: rules out the slowest samples
        allowed = (sample < 0.0 and not stuck_left) or (sample > 0.0 and not stuck_right)
        if turning and allowed:
            scratch.w[count] = in_place_rate(limits, sample)
            count += 1
        sample += window.w_step
    scratch.v[0] = 0.0
    find_last_cells(ground, limits, motion, start, scratch.v[:1], scratch.w[:count], scratch)

    best_ahead = np.inf
    for k in range(count):
        rate, last = scratch.w[k], int(np.int64(scratch.last[k]))
        if last < 0:
            continue
        limit = best.cost if best.cost >= 0.0 else np.inf
        path_steps, goal_steps = at_least(path, last), at_least(goal, last)
        if path_steps < 0 or goal_steps < 0:
            continue
        if total_cost(limits, float(path_steps), float(goal_steps), float(obstacle)) > limit:
            continue
        path_steps, goal_steps = reach(path, last), reach(goal, last)
        if path_steps < 0 or goal_steps < 0:
            continue
        rival = Rival(float(path_steps), float(goal_steps), limit, True)
        if total_cost(limits, rival.path, rival.goal, float(obstacle)) > limit:
            continue
        ahead_cell = _cell_ahead(ground, limits, motion, start, rate, scratch)
        if ahead_cell == OFF:
            continue
        ahead = float(grid_value(goal, ahead_cell, ground.cells.size))
        if not ahead < best_ahead:
            continue
        found = check_arc(ground, limits, motion, start, 0.0, rate, obstacle, rival, scratch)
        if found >= 0:
            cost = total_cost(limits, rival.path, rival.goal, float(found))
            if cost <= limit:
                best, best_ahead = Best(0.0, rate, cost, last, found), ahead
    return best


@compiled
def _cell_ahead(ground: Ground, limits: Limits, motion: Motion, start: Start, rate: float, scratch: Scratch) -> int:
    """The wave cell that lies heading_lookahead beyond the last point of a turn in place; OFF the map."""
    size_y, size_x = ground.cells.shape
    arc = sketch(limits, start, 0.0, rate)
    width: int = size_x + 2
    if arc.sane:
        end = posture(limits, start, arc, 0.0, rate, arc.points - 1)
        ahead = limits.heading_lookahead * start.per_metre
        cx, cy = certain_cell(end.x + ahead * end.c, size_x), certain_cell(end.y + ahead * end.s, size_y)
        if cx == OFF or cy == OFF:
            return OFF
        if cx >= 0 and cy >= 0:
            return (cy + 1) * width + cx + 1
    k = drive(limits, motion, 0.0, rate, scratch.points) - 1
    end_x, end_y, end_yaw = scratch.points[k, 0], scratch.points[k, 1], scratch.points[k, 2]
    return wave_cell(
        ground,
        end_x + limits.heading_lookahead * math.cos(end_yaw),
        end_y + limits.heading_lookahead * math.sin(end_yaw),
    )
