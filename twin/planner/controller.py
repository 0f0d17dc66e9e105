"""`TrajectoryPlannerROS`: one control cycle from a costmap, the odometry and a stored plan to a command.

Outside the goal tolerance `find_best_path` decides; inside it the robot stops, turns in place to the goal's yaw and
reports the goal as reached. Everything that ROS keeps in the object is in `ControllerState`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from twin.geometry import shortest_angle
from twin.planner.inflation import Costmap
from twin.planner.params import PlannerParams
from twin.planner.planner_flags import PlannerFlags
from twin.planner.trajectory import find_best_path, is_legal
from twin.planner.trajectory_state import BestPath, ControllerSettings, LocalPlannerSettings
from twin.records import STOP, Arc, Array, Command, Pose2, Twist2, frozen_array

STOPPED_V, STOPPED_W = 0.01, 0.01  # [m/s], [rad/s] (TrajectoryPlannerROS: trans_stopped_velocity, rot_stopped_velocity)
PRUNE_DISTANCE = 1.0  # [m] (base_local_planner::prunePlan)

NO_PLAN = frozen_array(np.empty((0, 3)))


@dataclass(frozen=True, slots=True)
class ControllerState:
    """What one cycle leaves for the next. Immutable."""

    plan: Array = field(default_factory=lambda: NO_PLAN)  # (n, 3) x, y, yaw, map frame; what pruning has left of it
    xy_latched: bool = False  # the goal position counts as reached until the next plan (only with latching on)
    rotating_to_goal: bool = False
    reached_goal: bool = False
    flags: PlannerFlags = field(default_factory=PlannerFlags)


@dataclass(frozen=True, slots=True)
class ControlResult:
    """The answer of one cycle."""

    ok: bool  # False: no legal command; move_base then counts its patience
    command: Command
    best: BestPath | None = None  # the arc behind the command; None when stopping or turning at the goal
    searched: BestPath | None = None  # what find_best_path answered in this cycle, driven or not

    @property
    def arc(self) -> Arc | None:
        """The arc behind the command, with the raw parts of its cost."""
        b = self.best
        return None if b is None else Arc(b.v, b.w, b.cost, b.path_cells, b.goal_cells, b.obstacle, b.points)

    @property
    def candidates(self) -> Array | None:
        """(n, 3) v, w, cost of every candidate; None unless explaining."""
        if self.searched is None or self.searched.candidates is None:
            return None
        return self.searched.candidates.table[:, :3]

    @property
    def rejected(self) -> dict[str, int]:
        """How many candidates were rejected, by reason; empty unless explaining."""
        if self.searched is None or self.searched.candidates is None:
            return {}
        return self.searched.candidates.rejected


def set_plan(state: ControllerState, plan: Array) -> ControllerState:
    """`setPlan`: a new plan (n, 3). Forgets the latch and that the goal was reached, not that it was turning."""
    plan = frozen_array(np.array(plan, dtype=np.float64).reshape(-1, 3))
    return replace(state, plan=plan, xy_latched=False, reached_goal=False)


def crop_plan(plan: Array, pose: Pose2, threshold: float) -> Array:
    """`transformGlobalPlan` with equal frames: from the first point within the threshold [m] to the first beyond it.

    The copying loop tests the distance of the point before, so one point beyond the threshold is still in.
    """
    distance2 = (plan[:, 0] - pose.x) ** 2 + (plan[:, 1] - pose.y) ** 2
    near = distance2 <= threshold * threshold
    if not near.any():
        return plan[:0]
    start = int(np.argmax(near))
    beyond = ~near[start:]
    end = start + int(np.argmax(beyond)) + 1 if beyond.any() else len(plan)
    return plan[start:end]


def prune_count(plan: Array, pose: Pose2) -> int:
    """`prunePlan`: how many leading points of a cropped plan lie 1 m or more behind (or ahead of) the robot."""
    near = (pose.x - plan[:, 0]) ** 2 + (pose.y - plan[:, 1]) ** 2 < PRUNE_DISTANCE * PRUNE_DISTANCE
    return int(np.argmax(near)) if near.any() else len(plan)


def compute_velocity(
    costmap: Costmap,
    pose: Pose2,
    velocity: Twist2,
    odometry: Twist2,
    state: ControllerState,
    theta: PlannerParams,
    settings: LocalPlannerSettings,
    explain: bool = False,
) -> tuple[ControlResult, ControllerState]:
    """`computeVelocityCommands`: pose in the map's frame, planner velocity and odometry twist in base_link."""
    ny, nx = costmap.cells.shape
    threshold = max(nx * costmap.resolution / 2.0, ny * costmap.resolution / 2.0)
    plan = crop_plan(state.plan, pose, threshold)
    passed = prune_count(plan, pose)
    plan = plan[passed:]
    if passed:
        state = replace(state, plan=state.plan[passed:])
    if len(plan) == 0:
        return ControlResult(False, STOP), state

    keeps = settings.controller
    goal_x, goal_y, goal_yaw = (float(g) for g in plan[-1])
    arrived = state.xy_latched or math.hypot(goal_x - pose.x, goal_y - pose.y) <= keeps.xy_goal_tolerance
    if not arrived:
        best, flags = find_best_path(costmap, pose, velocity, plan, theta, settings, state.flags, explain)
        state = replace(state, flags=flags)
        if not best.legal:
            return ControlResult(False, STOP, searched=best), state
        return ControlResult(True, best.command, best, best), state

    if keeps.latch_xy_goal_tolerance:
        state = replace(state, xy_latched=True)
    turn = shortest_angle(pose.yaw, goal_yaw)
    if abs(turn) <= keeps.yaw_goal_tolerance:
        return ControlResult(True, STOP), replace(state, rotating_to_goal=False, xy_latched=False, reached_goal=True)

    # ROS runs the search although it drops the answer; what it remembers of it stays.
    searched, flags = find_best_path(costmap, pose, velocity, plan, theta, settings, state.flags, explain)
    state = replace(state, flags=flags)
    if not state.rotating_to_goal and not is_stopped(odometry):
        command = stop_with_limits(velocity, keeps)
    else:
        state = replace(state, rotating_to_goal=True)
        command = Command(0.0, rotate_to_goal_rate(turn, velocity.w, keeps))
    if is_legal(costmap, pose, velocity, command, plan, theta, settings):
        return ControlResult(True, command, searched=searched), state
    return ControlResult(False, STOP, searched=searched), state


def is_stopped(odometry: Twist2) -> bool:
    """`base_local_planner::stopped`."""
    return abs(odometry.w) <= STOPPED_W and abs(odometry.v) <= STOPPED_V


def stop_with_limits(velocity: Twist2, keeps: ControllerSettings) -> Command:
    """`stopWithAccLimits`: as much slower as the acceleration limits allow within one control period."""
    v = math.copysign(max(0.0, abs(velocity.v) - keeps.acc_lim_x * keeps.sim_period), velocity.v)
    w = math.copysign(max(0.0, abs(velocity.w) - keeps.acc_lim_theta * keeps.sim_period), velocity.w)
    return Command(v, w)


def rotate_to_goal_rate(turn: float, w: float, keeps: ControllerSettings) -> float:
    """`rotateToGoal`: the rate [rad/s] for a remaining turn [rad] at a current rate w [rad/s]."""
    fastest, slowest = keeps.max_rotational_vel, keeps.min_in_place_vel_theta
    change = keeps.acc_lim_theta * keeps.sim_period
    rate = _in_limits(turn, turn, slowest, fastest)
    rate = math.copysign(min(max(abs(rate), abs(w) - change), abs(w) + change), rate)
    rate = math.copysign(min(math.sqrt(2.0 * keeps.acc_lim_theta * abs(turn)), abs(rate)), rate)
    return _in_limits(rate, rate, slowest, fastest)


def _in_limits(rate: float, sign: float, slowest: float, fastest: float) -> float:
    """The rate between slowest and fastest in the direction of `sign` (0 counts as negative)."""
    return min(fastest, max(slowest, rate)) if sign > 0.0 else max(-fastest, min(-slowest, rate))
