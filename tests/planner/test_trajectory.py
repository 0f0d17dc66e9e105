"""Laws of findBestPath, and the traps of the specification (numbers in brackets are those of its section 15)."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.planner.random_scenes import RESOLUTION, Call, random_call
from twin.planner.arcs import velocity_window
from twin.planner.inflation import Costmap, InflationParams, inflate
from twin.planner.params import PlannerParams
from twin.planner.trajectory import BestPath, LocalPlannerSettings, PlannerFlags, find_best_path, from_ros_values
from twin.planner.trajectory_state import limits_of
from twin.records import Array, Pose2, Twist2

JACKAL = LocalPlannerSettings()
MIDDLE = Pose2(5.013, 5.013, 0.0)  # off the cell borders
AHEAD = np.stack([np.arange(5.0, 9.5, 0.025), np.full(180, 5.013)], axis=1)


def costmap_of(cells: np.ndarray) -> Costmap:
    """A costmap with these bytes as they are."""
    return Costmap(cells.astype(np.uint8), (0.0, 0.0), RESOLUTION, InflationParams(0.3), (0.0, 0.0, 0.0, 0.0), None)


EMPTY = costmap_of(np.zeros((200, 200)))


def best(
    costmap: Costmap = EMPTY,
    pose: Pose2 = MIDDLE,
    velocity: Twist2 = Twist2(0.3, 0.0),  # noqa: B008
    plan: Array = AHEAD,
    theta: PlannerParams = PlannerParams(),  # noqa: B008
    local: LocalPlannerSettings = JACKAL,
    flags: PlannerFlags = PlannerFlags(),  # noqa: B008
) -> tuple[BestPath, PlannerFlags]:
    """The explained answer, after making sure that the fast one is the same."""
    answer, after = find_best_path(costmap, pose, velocity, plan, theta, local, flags, explain=True)
    fast, fast_after = find_best_path(costmap, pose, velocity, plan, theta, local, flags)
    assert same(answer, fast)
    assert after == fast_after
    return answer, after


def same(a: BestPath, b: BestPath) -> bool:
    """Equal to the last bit in everything but the candidates."""
    names = [f.name for f in fields(BestPath) if f.name not in ("candidates", "points")]
    return all(getattr(a, n) == getattr(b, n) for n in names) and np.array_equal(a.points, b.points)


def table(answer: BestPath) -> Array:
    """(n, 8) all candidates."""
    assert answer.candidates is not None
    return answer.candidates.table


def call_best(call: Call) -> tuple[BestPath, PlannerFlags]:
    """`best` of a random call."""
    return best(call.costmap, call.pose, call.velocity, call.plan, call.theta, call.settings, call.flags)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 10**9))
@example(0)
def test_the_fast_search_equals_scoring_every_candidate(seed: int) -> None:
    call_best(random_call(seed))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**9))
def test_the_choice_follows_from_the_candidates(seed: int) -> None:
    """The forward winner is the first of the cheapest; a turn wins only if it costs no more."""
    call = random_call(seed)
    answer, _ = call_best(call)
    rows = table(answer)
    forward = rows[: 0 if call.flags.escaping else call.theta.vx_samples * call.theta.vtheta_samples]
    legal = forward[forward[:, 2] >= 0.0]
    if len(legal):
        first = legal[np.argmin(legal[:, 2])]
        assert answer.cost <= first[2]
        if answer.v > 0.0:
            assert (answer.v, answer.w, answer.cost) == tuple(first[:3])
    assert (rows[:, 2] >= 0.0).any() or answer.v == call.settings.escape_vel
    costs = (
        call.theta.pdist_scale * call.settings.meter_scoring_factor * rows[:, 4]
        + rows[:, 5] * (call.theta.gdist_scale * call.settings.meter_scoring_factor)
        + call.theta.occdist_scale * rows[:, 6]
    )
    assert np.array_equal(np.where(rows[:, 7] == 0, costs, -1.0), np.where(rows[:, 2] >= 0.0, rows[:, 2], -1.0))


def test_the_same_arguments_give_the_same_bytes() -> None:
    call = random_call(3)
    arguments = (call.costmap, call.pose, call.velocity, call.plan, call.theta, call.settings, call.flags)
    first, _ = find_best_path(*arguments)
    for seed in range(5):  # other calls in between leave nothing behind
        other = random_call(seed)
        find_best_path(other.costmap, other.pose, other.velocity, other.plan, other.theta, other.settings, other.flags)
    again, _ = find_best_path(*arguments)
    assert same(first, again)
    assert first.points.tobytes() == again.points.tobytes()


def test_pose_and_velocity_are_rounded_to_f32() -> None:  # [1]
    tiny = 1e-9
    a, _ = best(pose=MIDDLE, velocity=Twist2(0.3, 0.1))
    b, _ = best(pose=Pose2(MIDDLE.x + tiny, MIDDLE.y - tiny, 0.0), velocity=Twist2(0.3 + tiny, 0.1 + tiny))
    assert a.points[0, 0] == float(np.float32(MIDDLE.x))
    assert same(a, b)


def test_samples_of_the_jackal_from_standstill() -> None:  # [2], 8.2, 8.3
    answer, _ = best(velocity=Twist2(0.0, 0.0))
    rows = table(answer)
    assert len(rows) == 6 * 20 + 20
    assert np.allclose(np.unique(rows[:120, 0]), np.linspace(0.1, 0.5, 6))
    rates = rows[:20, 1]
    assert rates[0] == 0.0
    assert np.allclose(rates[1:], np.linspace(-1.0, 1.0, 20)[:-1])  # the highest rate is never driven
    assert rows[120:, 1].max() == pytest.approx(1.0)  # but it is turned in place
    assert np.abs(rows[120:, 1]).min() == 0.314


def test_repeated_addition_of_the_steps() -> None:  # [12]
    theta = PlannerParams(vx_samples=19, vtheta_samples=59)
    answer, _ = best(theta=theta, velocity=Twist2(0.3, 0.2))
    window = velocity_window(limits_of(theta, JACKAL), math.inf, float(np.float32(0.3)), float(np.float32(0.2)))
    w = window.w_min
    for row in table(answer)[1:59]:
        assert row[1] == w
        w += window.w_step


def test_angular_steps_do_not_know_sim_time() -> None:  # [3]
    points = {(round(row[0], 6), round(row[1], 6)): row[3] for row in table(best(velocity=Twist2(0.0, 0.57))[0])}
    assert points[(0.5, 0.0)] == 50  # 0.5 * 2.0 / 0.02
    assert points[(0.1, 0.0)] == 10
    assert points[(0.0, 1.57)] in (78, 79)  # 1.57 / 0.02, not times 2.0; the sample is a last bit below 1.57


def test_only_the_last_point_decides_path_and_goal_and_it_is_not_the_last_integrated() -> None:  # [4], [5]
    answer, _ = best()
    x, y, _ = answer.points[-1]
    assert answer.goal_cells == abs(int(x / RESOLUTION) - 189) + abs(int(y / RESOLUTION) - 100)
    straight = table(best(theta=PlannerParams(vx_samples=1), velocity=Twist2(0.1, 0.0))[0])[0]
    assert straight[3] == 10
    # 9 steps of 0.02 m at most from the start, the tenth is not scored
    assert straight[5] == 189 - int((float(np.float32(5.013)) + 9 * 0.02) / RESOLUTION)


def test_the_obstacle_part_is_the_maximum_over_the_arc() -> None:  # [4], [10]
    cells = np.zeros((200, 200))
    cells[105, 112] = 100  # under the outline of the passing robot only
    answer, _ = best(costmap_of(cells))
    straight = table(answer)[table(answer)[:, 1] == 0.0]
    assert straight[:, 6].max() == 100.0


def test_253_is_legal_under_the_outline_but_not_under_the_centre() -> None:  # [10]
    cells = np.zeros((200, 200))
    cells[104:, :] = 253
    beside, _ = best(costmap_of(cells))
    assert beside.legal
    assert beside.obstacle == 253.0
    cells[:] = 0
    cells[:, 106] = 253  # a curtain ahead: no outline problem, but the centre may not pass
    rows = table(best(costmap_of(cells))[0])
    assert (rows[:120, 7] != 1).all()
    assert (rows[rows[:, 0] > 0.3, 7] == 3).all()


def test_lethal_inside_the_outline_is_not_seen() -> None:  # [10]
    cells = np.zeros((200, 200))
    cells[102, 102] = 254
    answer, _ = best(costmap_of(cells), plan=np.array([[5.013, 5.013], [4.0, 5.013]]))
    rows = table(answer)
    assert (rows[120:, 7] == 0).all()  # turning round it is legal
    cells[102, 106] = 254
    assert best(costmap_of(cells))[0].cost == 1.0  # on the outline: collision at the first point, backup


def test_first_of_equals_wins_forward_and_turns_win_ties() -> None:  # [6]
    free = PlannerParams(pdist_scale=0.0, gdist_scale=0.0)
    answer, _ = best(theta=free)
    assert (table(answer)[:, 2] == 0.0).all()
    assert answer.v == 0.0  # an in-place turn replaces a forward arc of equal cost
    assert answer.cost == 0.0
    blocked = PlannerFlags(stuck_left=True, stuck_right=True, prev_x=5.013, prev_y=5.013)
    answer, _ = best(theta=free, flags=blocked)
    assert (answer.v, answer.w) == tuple(table(answer)[0, :2])  # the first candidate of all


def test_look_ahead_decides_between_turns_of_equal_cost() -> None:  # [6]
    for side in (1.0, -1.0):
        plan = np.stack([np.full(160, 5.013), 5.013 + side * np.arange(160) * 0.025], axis=1)
        backwards = Pose2(5.013, 5.013, -side * 0.3)
        only_turns = PlannerFlags(escaping=True, escape_x=5.013, escape_y=5.013, escape_theta=-side * 0.3)
        answer, _ = best(pose=backwards, plan=plan, flags=only_turns, velocity=Twist2(0.0, 0.0))
        assert answer.v == 0.0
        assert answer.w * side > 0.0


def test_the_slowest_in_place_samples_never_win() -> None:  # [7]
    three = PlannerParams(vtheta_samples=3)  # samples -1, 0, 1 with a step of 1: none is beyond the step
    only_turns = PlannerFlags(escaping=True)
    answer, _ = best(theta=three, velocity=Twist2(0.0, 0.0), flags=replace(only_turns, escape_x=5.0, escape_y=5.0))
    assert answer.v == -0.5


def test_stuck_left_forbids_negative_rates_and_stuck_right_positive_ones() -> None:  # [8]
    here = PlannerFlags(escaping=True, prev_x=5.013, prev_y=5.013, escape_x=5.013, escape_y=5.013)
    assert best(velocity=Twist2(0.0, 0.0), flags=replace(here, stuck_left=True))[0].w > 0.0
    assert best(velocity=Twist2(0.0, 0.0), flags=replace(here, stuck_right=True))[0].w < 0.0
    both = replace(here, stuck_left=True, stuck_right=True)
    assert best(velocity=Twist2(0.0, 0.0), flags=both)[0].v == -0.5


def test_two_turns_on_the_spot_lock_out_the_other_side() -> None:  # [8]
    first = PlannerFlags().after_choice(1.0, 2.0, 0.0, 0.0, -0.5, JACKAL)
    assert first == PlannerFlags(rotating_right=True, prev_x=1.0, prev_y=2.0)
    second = first.after_choice(1.0, 2.0, 0.0, 0.0, -0.5, JACKAL)
    assert second.stuck_right
    assert not second.stuck_left
    moved = second.after_choice(1.06, 2.0, 0.0, 0.3, 0.0, JACKAL)
    assert not moved.stuck_right
    assert not moved.rotating_right
    near = second.after_choice(1.04, 2.0, 0.0, 0.3, 0.0, JACKAL)
    assert near.stuck_right


def test_turning_renews_the_place_that_must_be_left() -> None:  # 8.5
    flags = PlannerFlags()
    for k in range(5):  # 0.04 m per call: never 0.05 m from the last turn
        flags = flags.after_choice(1.0 + 0.04 * k, 0.0, 0.0, 0.0, 0.5, JACKAL)
    assert flags.stuck_left


def test_the_backup_drives_into_obstacles_but_not_without_a_path() -> None:  # [9]
    box = np.zeros((200, 200))
    box[90:111, 94:96] = 254
    box[90:111, 105:107] = 254
    answer, flags = best(costmap_of(box))
    assert (answer.v, answer.w, answer.cost) == (-0.5, 0.0, 1.0)
    assert answer.command.v == -0.5
    assert flags.escaping
    assert (flags.escape_x, flags.escape_y) == (float(np.float32(5.013)),) * 2
    assert table(answer)[-1, 2] == -1.0  # its raw cost
    nowhere, flags = best(plan=np.array([[-3.0, -3.0]]))
    assert nowhere.cost == -2.0
    assert not nowhere.legal
    assert nowhere.command.v == 0.0
    assert not flags.escaping


def test_escaping_ends_by_distance_or_turn() -> None:  # 8.5
    flags = PlannerFlags(escaping=True, escape_x=1.0, escape_y=1.0, escape_theta=0.0)
    assert flags.after_escape(1.05, 1.0, 0.05, 1.0, JACKAL).escaping
    assert not flags.after_escape(1.11, 1.0, 0.0, 1.0, JACKAL).escaping
    assert not flags.after_escape(1.0, 1.0, -0.11, 1.0, JACKAL).escaping


def test_no_forward_arcs_while_escaping() -> None:
    flags = PlannerFlags(escaping=True, escape_x=5.013, escape_y=5.013)
    rows = table(best(flags=flags)[0])
    assert len(rows) == 20
    assert (rows[:, 0] == 0.0).all()


def test_samples_run_downwards_when_too_fast() -> None:  # [13]
    rows = table(best(velocity=Twist2(1.5, 0.0))[0])
    assert rows[0, 0] == 1.0  # 1.5 - 10 * 0.05, above max_vel_x
    assert rows[100, 0] == pytest.approx(0.5)


def test_the_end_of_the_plan_caps_the_speed() -> None:  # [14]
    near = np.stack([np.linspace(5.0, 5.613, 30), np.full(30, 5.013)], axis=1)
    rows = table(best(plan=near, velocity=Twist2(0.0, 0.0))[0])
    assert rows[:120, 0].max() == pytest.approx(0.3, abs=1e-6)  # 0.6 m within sim_time
    at_goal = table(best(plan=AHEAD[:1], velocity=Twist2(0.0, 0.0))[0])
    assert (at_goal[:120, 0] == 0.1).all()  # never below min_vel_x


def test_one_sample_of_each_lets_no_turn_win() -> None:  # 8.2
    one = PlannerParams(vx_samples=1, vtheta_samples=1)
    answer, _ = best(theta=one)
    assert len(table(answer)) == 2
    assert answer.v == 0.1


def test_min_vel_theta_does_not_follow_max_vel_theta() -> None:  # section 13
    slow = PlannerParams(max_vel_theta=0.4)
    rates = table(best(theta=slow, velocity=Twist2(0.0, 0.0))[0])[:20, 1]
    assert (rates.min(), rates.max() < 0.4) == (-1.0, True)


def test_meter_scoring_scales_path_and_goal_but_not_obstacles() -> None:  # [17]
    raw = limits_of(PlannerParams(), JACKAL)
    scaled = limits_of(PlannerParams(), replace(JACKAL, meter_scoring_factor=0.05))
    assert (raw.path_bias, raw.goal_bias, raw.occdist_scale) == (0.75, 1.0, 0.1)
    assert (scaled.path_bias, scaled.goal_bias, scaled.occdist_scale) == (0.75 * 0.05, 0.05, 0.1)


def test_a_wrapped_heading_is_the_same_heading() -> None:  # 8.1
    a, _ = best(pose=Pose2(5.013, 5.013, 3.0))
    b, _ = best(pose=Pose2(5.013, 5.013, 3.0 + 2 * math.pi))
    assert same(a, b)


def test_a_corridor_is_driven_along_its_plan() -> None:
    cells = np.zeros((200, 200), dtype=np.uint8)
    cells[85, :], cells[115, :] = 254, 254
    costmap = costmap_of(inflate(cells, (0, 0, 200, 200), RESOLUTION, InflationParams(0.3)))
    answer, _ = best(costmap, velocity=Twist2(0.4, 0.0))
    assert answer.v == pytest.approx(0.5)
    assert abs(answer.w) < 0.2
    assert answer.obstacle == 0.0


def test_values_under_ros_names() -> None:
    theta, local = from_ros_values({"path_bias": 0.0375, "goal_bias": 0.05, "vx_samples": 9.0, "escape_vel": -0.1})
    assert (theta.pdist_scale, theta.gdist_scale, theta.vx_samples) == (0.0375, 0.05, 9)
    assert (local.escape_vel, local.meter_scoring_factor) == (-0.1, 1.0)
    with pytest.raises(ValueError, match="warp_factor"):
        from_ros_values({"warp_factor": 9.0})


def test_only_differential_drives() -> None:
    with pytest.raises(ValueError, match="holonomic"):
        LocalPlannerSettings(holonomic_robot=True)


def test_lateral_velocity_fades_at_its_own_limit() -> None:
    """Only recordings have one; it pushes the arc sideways until acc_lim_y has stopped it."""
    moved, _ = find_best_path(
        EMPTY, MIDDLE, Twist2(0.3, 0.0), AHEAD, PlannerParams(), JACKAL, PlannerFlags(), lateral_velocity=0.2
    )
    straight, _ = best()
    assert moved.points[5, 1] != straight.points[5, 1]
    assert moved.candidates is None
