"""Laws of one control cycle: cropping and pruning the plan, stopping, turning to the goal's yaw."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.planner.random_scenes import RESOLUTION
from twin.planner.controller import (
    ControllerState,
    ControlResult,
    compute_velocity,
    crop_plan,
    prune_count,
    rotate_to_goal_rate,
    set_plan,
    stop_with_limits,
)
from twin.planner.inflation import Costmap, InflationParams
from twin.planner.params import PlannerParams
from twin.planner.trajectory import ControllerSettings, LocalPlannerSettings, find_best_path
from twin.records import STOP, Array, Command, Pose2, Twist2

THETA, JACKAL, KEEPS = PlannerParams(), LocalPlannerSettings(), ControllerSettings()
STILL = Twist2(0.0, 0.0)
ROBOT = Pose2(5.013, 5.013, 0.0)


def costmap_of(cells: np.ndarray) -> Costmap:
    """A costmap with these bytes as they are."""
    return Costmap(cells.astype(np.uint8), (0.0, 0.0), RESOLUTION, InflationParams(0.3), (0.0, 0.0, 0.0, 0.0), None)


EMPTY = costmap_of(np.zeros((200, 200)))


def line(start: float, end: float, yaw: float = 0.0) -> Array:
    """A plan along x at the robot's y, ending with a yaw."""
    x = np.arange(start, end, 0.025)
    plan = np.stack([x, np.full(len(x), 5.013), np.zeros(len(x))], axis=1)
    plan[-1, 2] = yaw
    return plan


def cycle(
    state: ControllerState,
    pose: Pose2 = ROBOT,
    velocity: Twist2 = STILL,
    costmap: Costmap = EMPTY,
    settings: LocalPlannerSettings = JACKAL,
    explain: bool = False,
) -> tuple[ControlResult, ControllerState]:
    """One control cycle with the odometry equal to the velocity."""
    return compute_velocity(costmap, pose, velocity, velocity, state, THETA, settings, explain)


def at_goal(yaw: float, state: ControllerState | None = None) -> ControllerState:
    """A state whose plan ends 0.1 m ahead with this yaw."""
    return set_plan(state or ControllerState(), line(4.0, 5.113, yaw))


def test_without_a_plan_there_is_no_command() -> None:
    result, state = cycle(ControllerState())
    assert (result.ok, result.command) == (False, STOP)
    assert state == ControllerState()


def test_the_crop_ends_with_the_first_point_beyond() -> None:
    plan = line(0.0, 9.9)
    crop = crop_plan(plan, Pose2(2.0, 5.013, 0.0), 1.0)
    distance = np.abs(crop[:, 0] - 2.0)
    assert (distance[:-1] <= 1.0).all()
    assert distance[-1] > 1.0
    assert crop[0, 0] == pytest.approx(1.0)
    assert len(crop_plan(plan, Pose2(2.0, 50.0, 0.0), 1.0)) == 0


def test_a_plan_that_comes_back_is_cut_where_it_left() -> None:
    there_and_back = np.concatenate([line(5.0, 9.0), line(5.0, 9.0)[::-1]])
    crop = crop_plan(there_and_back, ROBOT, 2.0)
    assert len(crop) < len(there_and_back) / 2


def test_pruning_forgets_what_lies_a_metre_behind() -> None:
    state = set_plan(ControllerState(), line(2.0, 9.0))
    _, after = cycle(state)
    assert after.plan[0, 0] == pytest.approx(5.013 - 1.0, abs=0.025)
    assert np.array_equal(after.plan, state.plan[-len(after.plan) :])
    assert prune_count(after.plan, ROBOT) == 0
    assert len(state.plan) > len(after.plan)  # the state before is untouched


def test_the_stored_plan_loses_as_many_points_as_the_cropped_one() -> None:
    """Even when cropping has skipped points in front of those."""
    plan = line(-8.0, 9.0)
    state = set_plan(ControllerState(), plan)
    _, after = cycle(state)
    crop = crop_plan(plan, ROBOT, 5.0)
    assert crop[0, 0] > plan[0, 0]
    assert len(plan) - len(after.plan) == prune_count(crop, ROBOT)


def test_all_points_too_far_behind_leave_nothing() -> None:
    result, after = cycle(set_plan(ControllerState(), line(1.0, 3.0)))
    assert not result.ok
    assert len(after.plan) == 0


def test_away_from_the_goal_the_command_is_the_best_path() -> None:
    state = set_plan(ControllerState(), line(4.5, 9.0))
    result, after = cycle(state, velocity=Twist2(0.3, 0.1))
    best, flags = find_best_path(EMPTY, ROBOT, Twist2(0.3, 0.1), line(4.5, 9.0), THETA, JACKAL, state.flags)
    assert result.ok
    assert result.command == Command(best.v, best.w)
    assert after.flags == flags
    assert result.arc is not None
    assert np.array_equal(result.arc.points, best.points)
    assert result.candidates is None
    assert result.rejected == {}


def test_explaining_changes_no_result_and_counts_every_candidate() -> None:
    cells = np.zeros((200, 200))
    cells[90:97, 115], cells[104:111, 115] = 254, 254
    state = set_plan(ControllerState(), line(4.5, 9.0))
    plain, _ = cycle(state, costmap=costmap_of(cells))
    told, _ = cycle(state, costmap=costmap_of(cells), explain=True)
    assert plain.command == told.command
    assert told.candidates is not None
    illegal = int((told.candidates[:, 2] < 0.0).sum())
    assert illegal > 0
    assert sum(told.rejected.values()) == illegal


def test_no_legal_trajectory_is_a_zero_command_and_not_ok() -> None:
    unknown = costmap_of(np.full((200, 200), 255))  # no plan point counts: not even the backup is possible
    result, _ = cycle(set_plan(ControllerState(), line(4.5, 9.0)), costmap=unknown)
    assert (result.ok, result.command) == (True, Command(-0.5, 0.0))  # in collision, the backup is blind
    island = np.full((200, 200), 0)
    island[100, 100] = 253  # the centre stands on an inscribed cell that is no goal
    result, _ = cycle(set_plan(ControllerState(), line(4.5, 9.0)), costmap=costmap_of(island))
    assert (result.ok, result.command) == (False, STOP)
    assert result.arc is None


def test_arriving_with_the_right_yaw_is_success() -> None:
    result, after = cycle(at_goal(0.1))
    assert (result.ok, result.command, after.reached_goal) == (True, STOP, True)
    renewed = set_plan(after, line(4.0, 9.0))
    assert not renewed.reached_goal


def test_arriving_at_speed_stops_within_the_limits_before_turning() -> None:
    result, after = cycle(at_goal(1.5), velocity=Twist2(0.8, -1.5))
    assert result.ok
    assert result.command.v == pytest.approx(0.3)  # 0.8 - 10 * 0.05
    assert result.command.w == pytest.approx(-0.5)  # 1.5 - 20 * 0.05
    assert not after.rotating_to_goal


def test_stopped_at_the_goal_it_turns_no_faster_than_max_rotational_vel() -> None:  # [21]
    for yaw in (1.5, -1.5):
        result, after = cycle(at_goal(yaw))
        assert after.rotating_to_goal
        assert result.command.v == 0.0
        assert result.command.w == math.copysign(1.0, yaw)
    fast = replace(THETA, max_vel_theta=3.0)
    result, _ = compute_velocity(EMPTY, ROBOT, STILL, STILL, at_goal(1.5), fast, JACKAL)
    assert result.command.w == 1.0  # reconfiguring does not reach it


def test_a_new_plan_does_not_stop_the_turning() -> None:
    _, turning = cycle(at_goal(1.5))
    result, after = cycle(at_goal(1.5, turning), velocity=Twist2(0.3, 0.9))  # moving, yet it does not stop first
    assert after.rotating_to_goal
    assert result.command.v == 0.0


def test_turning_into_an_obstacle_is_refused() -> None:
    cells = np.zeros((200, 200))
    cells[101:104, 107] = 254  # beside the front: the outline of the turned robot hits it
    result, after = cycle(at_goal(1.5), costmap=costmap_of(cells))
    assert after.rotating_to_goal
    assert (result.ok, result.command) == (False, STOP)


def test_the_search_runs_at_the_goal_for_its_side_effects() -> None:
    away = at_goal(1.5)
    moved = replace(away, flags=replace(away.flags, rotating_left=True, stuck_left=True, prev_x=1.0))
    _, after = cycle(moved)
    assert after.flags != moved.flags


def test_latching_keeps_the_goal_until_the_next_plan() -> None:
    latching = replace(JACKAL, controller=replace(KEEPS, latch_xy_goal_tolerance=True))
    _, state = cycle(at_goal(1.5), settings=latching)
    assert state.xy_latched
    pushed_away = Pose2(ROBOT.x - 0.4, ROBOT.y, 0.0)
    result, _ = cycle(state, pose=pushed_away, settings=latching)
    assert result.command.v == 0.0
    result, _ = cycle(state, pose=pushed_away)  # the latch holds even when latching is switched off
    assert result.command.v == 0.0
    assert not set_plan(state, state.plan).xy_latched
    _, unlatched = cycle(at_goal(1.5))
    assert not unlatched.xy_latched


@settings(deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(-3.0, 3.0))
def test_rotation_is_odd_and_bounded(turn: float, w: float) -> None:
    rate = rotate_to_goal_rate(turn, w, KEEPS)
    assert KEEPS.min_in_place_vel_theta <= abs(rate) <= KEEPS.max_rotational_vel
    if turn != 0.0:
        assert rate == -rotate_to_goal_rate(-turn, -w, KEEPS)
        assert (rate > 0.0) == (turn > 0.0)


@settings(deadline=None)
@given(st.floats(-2.0, 2.0), st.floats(-4.0, 4.0))
def test_stopping_never_reverses_and_ends_at_rest(v: float, w: float) -> None:
    command = stop_with_limits(Twist2(v, w), KEEPS)
    assert abs(command.v) <= abs(v)
    assert abs(command.w) <= abs(w)
    assert command.v * v >= 0.0
    assert command.w * w >= 0.0
    for _ in range(10):
        command = stop_with_limits(Twist2(command.v, command.w), KEEPS)
    assert (command.v, command.w) == (0.0, 0.0)
