"""The candidates of the local planner, computed the plain way: every arc, every point, in ROS's order.

This is `TrajectoryPlanner::createTrajectories` to the letter. `explain=True` runs it; tests hold the fast search
(`arc_search.py`) against it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twin.compiled import compiled
from twin.planner.footprint import OFF_MAP as FOOTPRINT_OFF_MAP
from twin.planner.footprint import footprint_cost
from twin.planner.grid import world_to_cell
from twin.planner.trajectory_state import COLLISION, LEGAL, NO_PATH, OFF_MAP, Limits
from twin.planner.wave import Cells
from twin.records import Array, Bytes


class Window(NamedTuple):
    """The velocities to try. Steps may be negative (after a cut of the limits) or not finite (1 sample)."""

    v_min: float  # [m/s]
    v_step: float
    w_min: float  # [rad/s]
    w_step: float


class Score(NamedTuple):
    """How one arc ended; path, goal and obstacle are those of the points scored until then."""

    cost: float
    points: int
    path: float
    goal: float
    obstacle: float
    reason: int


class Costs(NamedTuple):
    """The local costmap and both map grids."""

    cells: Bytes  # (ny, nx)
    origin_x: float
    origin_y: float
    resolution: float
    path: Cells  # (ny, nx)
    goal: Cells  # (ny, nx)
    footprint: Array  # (4, 2)


@compiled
def velocity_window(limits: Limits, goal_distance: float, v: float, w: float) -> Window:
    """What the acceleration limits allow within one control period from (v, w), and the goal allows within sim_time.

    `goal_distance` [m] from the robot to the last pose of the cropped plan (inf without a plan).
    """
    v_limit = min(limits.max_vel_x, goal_distance / limits.sim_time)
    v_max = max(min(v_limit, v + limits.acc_x * limits.sim_period), limits.min_vel_x)
    v_min = max(limits.min_vel_x, v - limits.acc_x * limits.sim_period)
    w_max = min(limits.max_vel_theta, w + limits.acc_theta * limits.sim_period)
    w_min = max(limits.min_vel_theta, w - limits.acc_theta * limits.sim_period)
    return Window(
        v_min, (v_max - v_min) / (limits.vx_samples - 1), w_min, (w_max - w_min) / (limits.vtheta_samples - 1)
    )


@compiled
def step_count(limits: Limits, v: float, w: float) -> int:
    """How many points an arc has. The angular term knows no sim_time (as in ROS)."""
    steps = max(abs(v) * limits.sim_time / limits.sim_granularity, abs(w) / limits.angular_sim_granularity)
    return max(1, int(steps + 0.5))


@compiled
def ramp(current: float, target: float, change: float) -> float:
    """The velocity after one step towards the target, by at most `change`."""
    if target - current >= 0.0:
        return min(target, current + change)
    return max(target, current - change)


class Motion(NamedTuple):
    """A pose in the map's frame [m, rad] and a velocity in base_link [m/s, rad/s]."""

    x: float
    y: float
    yaw: float
    v: float
    vy: float
    w: float


@compiled
def advance(limits: Limits, dt: float, at: Motion, target_v: float, target_w: float) -> Motion:
    """One Euler step towards (target_v, 0, target_w): the new velocity along the old heading."""
    v = ramp(at.v, target_v, limits.acc_x * dt)
    vy = ramp(at.vy, 0.0, limits.acc_y * dt)
    w = ramp(at.w, target_w, limits.acc_theta * dt)
    side_x, side_y = 0.0, 0.0
    if vy != 0.0:
        side_x, side_y = vy * math.cos(math.pi / 2 + at.yaw), vy * math.sin(math.pi / 2 + at.yaw)
    return Motion(
        at.x + (v * math.cos(at.yaw) + side_x) * dt,
        at.y + (v * math.sin(at.yaw) + side_y) * dt,
        at.yaw + w * dt,
        v,
        vy,
        w,
    )


@compiled
def drive(limits: Limits, start: Motion, target_v: float, target_w: float, points: Array) -> int:
    """The points of a whole arc, legal or not, into `points` (>= step_count, 3); returns how many."""
    steps = step_count(limits, target_v, target_w)
    dt = limits.sim_time / steps
    at = start
    for k in range(steps):
        points[k, 0], points[k, 1], points[k, 2] = at.x, at.y, at.yaw
        at = advance(limits, dt, at, target_v, target_w)
    return steps


@compiled
def score_arc(costs: Costs, limits: Limits, start: Motion, target_v: float, target_w: float, points: Array) -> Score:
    """Drive one arc towards (target_v, 0, target_w) for sim_time, and score it.

    Writes the scored points into `points` (>= step_count, 3). The position after the last step is never scored. Only
    the last point decides path and goal, the highest byte met decides the obstacle part.
    """
    steps = step_count(limits, target_v, target_w)
    dt = limits.sim_time / steps
    size_y, size_x = costs.cells.shape
    blocked = size_x * size_y
    path, goal, obstacle = 0.0, 0.0, 0.0
    at = start
    for k in range(steps):
        mx, my = world_to_cell(at.x, at.y, costs.origin_x, costs.origin_y, costs.resolution, size_x, size_y)
        if mx < 0:
            return Score(-1.0, k, path, goal, obstacle, OFF_MAP)
        outline = footprint_cost(
            costs.cells, costs.origin_x, costs.origin_y, costs.resolution, at.x, at.y, at.yaw, costs.footprint
        )
        if outline < 0:
            return Score(-1.0, k, path, goal, obstacle, OFF_MAP if outline == FOOTPRINT_OFF_MAP else COLLISION)
        obstacle = max(max(obstacle, float(outline)), float(costs.cells[my, mx]))
        path, goal = float(costs.path[my, mx]), float(costs.goal[my, mx])
        if goal >= blocked or path >= blocked:
            return Score(-2.0, k, path, goal, obstacle, NO_PATH)
        points[k, 0], points[k, 1], points[k, 2] = at.x, at.y, at.yaw
        at = advance(limits, dt, at, target_v, target_w)
    return Score(total_cost(limits, path, goal, obstacle), steps, path, goal, obstacle, LEGAL)


@compiled
def total_cost(limits: Limits, path: float, goal: float, obstacle: float) -> float:
    """The cost of a legal arc, added in ROS's order. It never falls when one of the three parts rises."""
    return limits.path_bias * path + goal * limits.goal_bias + limits.occdist_scale * obstacle


@compiled
def look_ahead_goal(costs: Costs, x: float, y: float, yaw: float, distance: float) -> float:
    """The goal-grid value `distance` [m] ahead of a pose; -1 when that is off the map."""
    size_y, size_x = costs.cells.shape
    mx, my = world_to_cell(
        x + distance * math.cos(yaw), y + distance * math.sin(yaw),
        costs.origin_x, costs.origin_y, costs.resolution, size_x, size_y,
    )  # fmt: skip
    return -1.0 if mx < 0 else float(costs.goal[my, mx])


@compiled
def longest_arc(limits: Limits, window: Window) -> int:
    """An upper bound of the points of any candidate, the backup included."""
    v = max(abs(window.v_min), abs(limits.escape_vel))
    w = max(abs(window.w_min), abs(limits.min_in_place))
    if limits.vx_samples > 1:
        v = max(v, abs(window.v_min + window.v_step * limits.vx_samples))
    if limits.vtheta_samples > 1:
        w = max(w, abs(window.w_min + window.w_step * limits.vtheta_samples))
    return step_count(limits, v, w) + 1


@compiled
def in_place_rate(limits: Limits, sample: float) -> float:
    """The rate of an in-place candidate: the sample, but never slower than min_in_place_vel_theta."""
    return max(sample, limits.min_in_place) if sample > 0.0 else min(sample, -1.0 * limits.min_in_place)


@compiled
def search_all(
    costs: Costs,
    limits: Limits,
    window: Window,
    start: Motion,
    escaping: bool,
    stuck_left: bool,
    stuck_right: bool,
    table: Array,
    points: Array,
) -> tuple[int, int, bool]:
    """Score every candidate in ROS's order into the rows of `table`.

    Columns: v, w, cost, points, path, goal, obstacle, reason. Returns the number of rows, the chosen one and whether
    that is the backup, the last row, which is there only when no other candidate is legal. `points` is scratch for one
    arc.
    """
    rows, best = 0, -1
    best_cost = -1.0
    v_sample = window.v_min
    for _ in range(0 if escaping else limits.vx_samples):
        w_sample = 0.0
        next_w = window.w_min
        for _ in range(limits.vtheta_samples):  # straight on, then all rates but the highest
            s = score_arc(costs, limits, start, v_sample, w_sample, points)
            _record(table, rows, v_sample, w_sample, s)
            if s.cost >= 0.0 and (s.cost < best_cost or best_cost < 0.0):
                best, best_cost = rows, s.cost
            rows += 1
            w_sample = next_w
            next_w += window.w_step
        v_sample += window.v_step

    sample = window.w_min
    best_ahead = np.inf
    for _ in range(limits.vtheta_samples):
        rate = in_place_rate(limits, sample)
        s = score_arc(costs, limits, start, 0.0, rate, points)
        _record(table, rows, 0.0, rate, s)
        turning = sample > window.w_step or sample < -1.0 * window.w_step  # not limited: rules out the slowest samples
        if s.cost >= 0.0 and (s.cost <= best_cost or best_cost < 0.0) and turning:
            end = points[s.points - 1]
            ahead = look_ahead_goal(costs, end[0], end[1], end[2], limits.heading_lookahead)
            allowed = (sample < 0.0 and not stuck_left) or (sample > 0.0 and not stuck_right)
            if 0.0 <= ahead < best_ahead and allowed:
                best, best_cost, best_ahead = rows, s.cost, ahead
        rows += 1
        sample += window.w_step

    is_backup = best < 0
    if is_backup:
        s = score_arc(costs, limits, start, limits.escape_vel, 0.0, points)
        _record(table, rows, limits.escape_vel, 0.0, s)
        best = rows
        rows += 1
    return rows, best, is_backup


@compiled
def _record(table: Array, row: int, v: float, w: float, s: Score) -> None:
    table[row, 0], table[row, 1], table[row, 2], table[row, 3] = v, w, s.cost, s.points
    table[row, 4], table[row, 5], table[row, 6], table[row, 7] = s.path, s.goal, s.obstacle, s.reason


TABLE_COLUMNS = 8
