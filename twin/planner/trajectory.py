"""`TrajectoryPlanner::findBestPath` with dwa=true: the arc that the Jackal drives next.

One call builds both map grids, samples arcs inside the velocity window and takes the cheapest legal one. With
`explain=True` every candidate is scored and returned; otherwise a search finds the same arc with less work.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from twin.geometry import normalize_angle
from twin.planner.arc_check import Ground
from twin.planner.arc_search import scratch_for, search
from twin.planner.arcs import (
    TABLE_COLUMNS,
    Costs,
    Motion,
    Score,
    Window,
    longest_arc,
    score_arc,
    search_all,
    step_count,
    velocity_window,
)
from twin.planner.footprint import FOOTPRINT
from twin.planner.inflation import Costmap
from twin.planner.map_grid import MapGrids, goal_centre, map_grids, plan_points, read_only
from twin.planner.params import PlannerParams
from twin.planner.planner_flags import PlannerFlags
from twin.planner.sketch import FARTHEST
from twin.planner.trajectory_state import (
    BestPath,
    Candidates,
    ControllerSettings,
    Limits,
    LocalPlannerSettings,
    from_ros_values,
    limits_of,
)
from twin.records import Array, Command, Pose2, Twist2, frozen_array

__all__ = [
    "BestPath",
    "Candidates",
    "ControllerSettings",
    "LocalPlannerSettings",
    "PlannerFlags",
    "find_best_path",
    "from_ros_values",
    "is_legal",
]


def find_best_path(
    costmap: Costmap,
    pose: Pose2,
    velocity: Twist2,
    plan: Array,
    theta: PlannerParams,
    settings: LocalPlannerSettings,
    flags: PlannerFlags,
    explain: bool = False,
    lateral_velocity: float = 0.0,
) -> tuple[BestPath, PlannerFlags]:
    """The best arc from a pose (map frame) and velocity (base_link) along a plan (n, >= 2) [m, map frame].

    Pose and velocity are rounded to f32 as ROS does; angles and rates beyond +-pi are wrapped before, as on their way
    through quaternions. `lateral_velocity` [m/s] is the velocity's y component, 0 on the Jackal.
    """
    at = _rounded(pose)
    start = Motion(at.x, at.y, at.yaw, _f32(velocity.v), _f32(lateral_velocity), _f32(_wrapped(velocity.w)))
    limits = limits_of(theta, settings)
    window = velocity_window(limits, _distance_to_end(plan, at), start.v, start.w)
    if explain or start.vy != 0.0 or not _can_search(costmap, at):
        best, is_backup = _explained(costmap, start, plan, limits, window, flags)
        if not explain:
            best = replace(best, candidates=None)
    else:
        best, is_backup = _searched(costmap, start, plan, limits, window, flags)
    if is_backup:
        return best, flags.after_escape(at.x, at.y, at.yaw, best.cost, settings)
    return best, flags.after_choice(at.x, at.y, at.yaw, best.v, best.w, settings)


def is_legal(
    costmap: Costmap,
    pose: Pose2,
    velocity: Twist2,
    command: Command,
    plan: Array,
    theta: PlannerParams,
    settings: LocalPlannerSettings,
) -> bool:
    """`checkTrajectory` right after `find_best_path` with the same pose and plan: may the robot try this command?

    The map grids are those of that call; pose and velocity are not rounded here, as in ROS.
    """
    limits = limits_of(theta, settings)
    costs = _costs(costmap, map_grids(costmap, _rounded(pose), plan))
    points = np.empty((step_count(limits, command.v, command.w), 3))
    start = Motion(pose.x, pose.y, pose.yaw, velocity.v, 0.0, velocity.w)
    score: Score = score_arc(costs, limits, start, command.v, command.w, points)
    return score.cost >= 0.0


def _f32(value: float) -> float:
    return float(np.float32(value))


def _wrapped(angle: float) -> float:
    """The angle as it leaves a quaternion; inside +-pi it stays as it is."""
    return angle if abs(angle) <= math.pi else normalize_angle(angle)


def _rounded(pose: Pose2) -> Pose2:
    """The pose as findBestPath sees it."""
    return Pose2(_f32(pose.x), _f32(pose.y), _f32(_wrapped(pose.yaw)))


def _distance_to_end(plan: Array, pose: Pose2) -> float:
    """[m] from the robot to the last pose of the plan; inf without a plan, which then limits nothing."""
    return math.hypot(plan[-1, 0] - pose.x, plan[-1, 1] - pose.y) if len(plan) else math.inf


def _costs(costmap: Costmap, grids: MapGrids) -> Costs:
    origin_x, origin_y = costmap.origin
    return Costs(read_only(costmap.cells), origin_x, origin_y, costmap.resolution, grids.path, grids.goal, FOOTPRINT)


def _explained(
    costmap: Costmap, start: Motion, plan: Array, limits: Limits, window: Window, flags: PlannerFlags
) -> tuple[BestPath, bool]:
    """The plain way: complete grids, all candidates. Also says whether the best is the backup."""
    grids = map_grids(costmap, Pose2(start.x, start.y, start.yaw), plan)
    costs = _costs(costmap, grids)
    points = np.empty((longest_arc(limits, window), 3))
    table = np.empty((limits.vtheta_samples * (limits.vx_samples + 1) + 1, TABLE_COLUMNS))
    rows, chosen, is_backup = search_all(
        costs, limits, window, start, flags.escaping, flags.stuck_left, flags.stuck_right, table, points
    )
    v, w = float(table[chosen, 0]), float(table[chosen, 1])
    score = score_arc(costs, limits, start, v, w, points)
    best = BestPath(
        v, 0.0, w, _backed_up(score.cost, is_backup), frozen_array(points[: score.points].copy()),
        score.path, score.goal, score.obstacle, grids.local_goal, Candidates(frozen_array(table[:rows].copy())),
    )  # fmt: skip
    return best, is_backup


def _can_search(costmap: Costmap, pose: Pose2) -> bool:
    """Whether f64 resolves positions as finely as the search needs."""
    return max(abs(pose.x), abs(pose.y), abs(costmap.origin[0]), abs(costmap.origin[1])) < FARTHEST


def _searched(
    costmap: Costmap, start: Motion, plan: Array, limits: Limits, window: Window, flags: PlannerFlags
) -> tuple[BestPath, bool]:
    """The same answer without scoring every candidate."""
    path, goal, raster, scratch = scratch_for(
        costmap.cells.shape, costmap.resolution, limits, longest_arc(limits, window), len(FOOTPRINT)
    )
    ground = Ground(read_only(costmap.cells), *costmap.origin, costmap.resolution, FOOTPRINT, path, goal)
    v, w, score, is_backup, local_goal = search(
        ground, limits, window, start, flags.escaping, flags.stuck_left, flags.stuck_right,
        plan_points(plan), raster, scratch,
    )  # fmt: skip
    best = BestPath(
        v, 0.0, w, _backed_up(score.cost, is_backup), frozen_array(scratch.points[: score.points].copy()),
        score.path, score.goal, score.obstacle, goal_centre(costmap, local_goal),
    )  # fmt: skip
    return best, is_backup


def _backed_up(cost: float, is_backup: bool) -> float:
    """A backup in collision or off the map is driven all the same: its -1 becomes 1."""
    return 1.0 if is_backup and cost == -1.0 else cost
