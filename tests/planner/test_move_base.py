"""move_base's state machine and recoveries, on hand-made observations without a simulator."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from twin.planner.move_base import RECOVERIES, Memory, MoveBase, MoveBaseDriver, MoveBaseSettings, State, Trigger
from twin.planner.obstacle_layer import GLOBAL_MAP, LOCAL_MAP, MapSpec, empty_map
from twin.planner.params import PlannerParams
from twin.planner.plan import FRESH, Blocked, Plan, plan
from twin.records import Decision, Observation, ObstacleMap, Pose2, Scan, Twist2, frozen_array

THETA = PlannerParams()
SCAN = Scan(frozen_array(np.full(720, np.inf)), -2.35619, 2.35619, 0.1, 30.0, (0.055, 0.0, 0.2414))
GOAL = Pose2(4.0, 0.0, 0.0)


def map_with(spec: MapSpec, origin: tuple[float, float], boxes: list[tuple[float, float, float, float]]) -> ObstacleMap:
    """A map with lethal rectangles (x0, y0, x1, y1) [m, odom]."""
    cells = np.zeros((spec.size_y, spec.size_x), dtype=np.uint8)
    for x0, y0, x1, y1 in boxes:
        i0, i1 = (round((v - origin[0]) / 0.05) for v in (x0, x1))
        j0, j1 = (round((v - origin[1]) / 0.05) for v in (y0, y1))
        cells[max(0, j0) : max(0, j1), max(0, i0) : max(0, i1)] = 254
    return replace(empty_map(spec), cells=frozen_array(cells), origin=origin, whole=True)


def observe(
    time: float,
    pose: Pose2 = Pose2(0.0, 0.0, 0.0),  # noqa: B008
    twist: Twist2 = Twist2(0.0, 0.0),  # noqa: B008
    local: list[tuple[float, float, float, float]] = [],  # noqa: B006
    world: list[tuple[float, float, float, float]] = [],  # noqa: B006
) -> Observation:
    """An observation whose two maps hold the given rectangles."""
    return Observation(
        time,
        pose,
        twist,
        SCAN,
        map_with(LOCAL_MAP, (-5.0, -5.0), local),
        map_with(GLOBAL_MAP, GLOBAL_MAP.origin, world),
        GOAL,
    )


# A closed ring of walls round the robot, 1 m away: no global plan leads out of it.
RING = [(-1.2, -1.2, 1.2, -1.0), (-1.2, 1.0, 1.2, 1.2), (-1.2, -1.2, -1.0, 1.2), (1.0, -1.2, 1.2, 1.2)]
# The robot's centre on an inscribed cell of the local map: every trajectory is rejected.
SMOTHERED = [(0.2, -0.2, 0.3, 0.2), (-0.3, -0.2, -0.2, 0.2)]


def run(step: MoveBase, observations: list[Observation], memory: Memory | None = None) -> tuple[list[Decision], Memory]:
    """Feed observations one by one."""
    memory = Memory() if memory is None else memory
    decisions = []
    for x in observations:
        decision, memory = step.step(x, THETA, memory)
        decisions.append(decision)
    return decisions, memory


def test_in_the_open_it_drives_towards_the_goal() -> None:
    decisions, memory = run(MoveBase(), [observe(0.0), observe(0.05)])
    assert decisions[0].state == "controlling"
    command = decisions[0].command
    assert command is not None
    assert command.v == pytest.approx(0.5)
    assert memory.state is State.CONTROLLING
    assert decisions[0].global_path is not None
    assert tuple(decisions[0].global_path[-1]) == (GOAL.x, GOAL.y)


def test_plan_is_the_first_tick_of_move_base() -> None:
    x = observe(0.0, local=[(1.5, -0.2, 1.7, 0.2)], world=[(1.5, -0.2, 1.7, 0.2)])
    answer, _ = plan(x, THETA)
    decision, _ = MoveBase().step(x, THETA, Memory())
    assert isinstance(answer, Plan)
    assert answer.command == decision.command


def test_plan_does_not_touch_its_arguments() -> None:
    x = observe(0.0, local=[(1.5, -0.2, 1.7, 0.2)], world=[(1.5, -0.2, 1.7, 0.2)])
    _, memory = plan(x, THETA)
    first = plan(x, THETA, memory)[0]
    assert isinstance(first, Plan)
    for theta in (PlannerParams(max_vel_x=1.5, inflation_radius=0.02), THETA):
        again = plan(x, theta, memory)[0]
        assert isinstance(again, Plan)
    assert again.command == first.command
    assert FRESH.local is None


def test_no_way_out_is_blocked() -> None:
    answer, _ = plan(observe(0.0, world=RING), THETA)
    assert answer == Blocked(("no global plan",))


def test_planning_failures_run_through_the_recoveries_and_give_up() -> None:
    step, memory, yaw, decisions = MoveBase(), Memory(), 0.0, []
    for k in range(1000):
        decision, memory = step.step(observe(0.05 * k, Pose2(0.0, 0.0, yaw), world=RING), THETA, memory)
        yaw = math.remainder(yaw + 0.05 * (decision.command.w if decision.command else 0.0), math.tau)
        decisions.append(decision)
    states = [d.state for d in decisions]
    names = {r.name for r in RECOVERIES} | {"aborted"}
    order = [s for k, s in enumerate(states) if k == 0 or states[k - 1] != s]
    assert [s for s in order if s in names] == [*(r.name for r in RECOVERIES), "aborted"]
    first = states.index("conservative_reset")
    assert 0.05 * first == pytest.approx(5.0 + 0.1, abs=0.051), "planner_patience, and a cycle to enter CLEARING"
    assert decisions[states.index("aborted")].aborted
    assert memory.finished
    assert memory.recoveries == 4


def test_nothing_is_published_while_planning_and_the_stop_comes_once() -> None:
    decisions, _ = run(MoveBase(), [observe(0.05 * k, world=RING) for k in range(103)])
    commands = [d.command for d in decisions]
    assert commands[:50] == [None] * 50
    assert sum(c is not None for c in commands) == 1


def test_a_controller_failure_stops_and_plans_again_until_patience_ends() -> None:
    observations = [observe(0.05 * k, local=SMOTHERED) for k in range(320)]
    decisions, memory = run(MoveBase(), observations)
    assert decisions[0].command is not None
    assert decisions[0].command.v == 0.0
    states = [d.state for d in decisions]
    first = states.index("conservative_reset")
    assert 0.05 * first == pytest.approx(15.0 + 0.1, abs=0.051), "controller_patience"
    assert memory.trigger is Trigger.CONTROLLING


def test_the_next_recovery_after_a_controller_failure_comes_at_once() -> None:
    """last_valid_control is not renewed by a recovery."""
    observations = [observe(0.05 * k, local=SMOTHERED) for k in range(320)]
    states = [d.state for d in run(MoveBase(), observations)[0]]
    first = states.index("conservative_reset")
    assert "rotate_recovery" in states[first + 1 : first + 4]


def test_rotation_turns_once_round_and_ends_without_a_stop() -> None:
    step, memory = MoveBase(), Memory()
    yaw, turning, time, last = 0.3, [], 0.0, None
    for _ in range(400):
        time += 0.05
        decision, memory = step.step(observe(time, Pose2(0.0, 0.0, yaw), world=RING), THETA, memory)
        if decision.state == "rotate_recovery":
            assert decision.command is not None
            turning.append(decision.command.w)
            yaw = math.remainder(yaw + 0.05 * decision.command.w, math.tau)
            last = decision
        elif turning:
            break
    assert last is not None
    assert set(turning) == {1.57}
    assert sum(turning) * 0.05 == pytest.approx(math.tau, abs=0.157 + 0.08)
    assert decision.command is None


def test_a_rotation_that_would_hit_is_given_up_at_once() -> None:
    # the padded corner sweeps 0.41 m, the padded side is at 0.265 m: a wall at 0.33 m is hit by the turn
    walls = [*RING, (-0.6, 0.33, 0.6, 0.4)]
    decisions, memory = run(MoveBase(), [observe(0.05 * k, world=RING, local=walls) for k in range(110)])
    rotations = [d for d in decisions if d.state == "rotate_recovery"]
    assert all(d.command is None for d in rotations)
    assert memory.rotation is None


def test_clearing_is_a_no_op_unless_switched_on() -> None:
    observations = [observe(0.05 * k, world=RING) for k in range(110)]
    off, _ = run(MoveBase(), observations)
    on, _ = run(MoveBase(MoveBaseSettings(clearing_works=True)), observations)
    assert all(d.clear_beyond is None for d in off)
    assert [d.clear_beyond for d in on if d.clear_beyond is not None] == [3.0]


def test_the_goal_is_reported_once_position_and_yaw_are_within_tolerance() -> None:
    decisions, memory = run(MoveBase(), [observe(0.0, Pose2(3.9, 0.1, 0.1))])
    assert decisions[0].goal_reached
    assert memory.finished
    decisions, memory = run(MoveBase(), [observe(0.0, Pose2(3.9, 0.1, 1.0))])
    assert not decisions[0].goal_reached, "the yaw is still off"
    assert decisions[0].command is not None
    assert decisions[0].command.w < 0


def test_explaining_changes_nothing_but_the_explanation() -> None:
    observations = [observe(0.05 * k, Pose2(0.02 * k, 0.0, 0.1), local=[(1.5, 0.0, 1.7, 0.3)]) for k in range(10)]
    plain, _ = run(MoveBase(), observations)
    explained, _ = run(MoveBase(explain=True), observations)
    assert [d.command for d in plain] == [d.command for d in explained]
    assert explained[0].candidates is not None
    assert len(explained[0].candidates) == 6 * 20 + 20
    assert sum(explained[0].rejected.values()) == np.count_nonzero(explained[0].candidates[:, 2] < 0)


def test_a_driver_starts_with_a_fresh_memory() -> None:
    driver = MoveBaseDriver(THETA)
    decision, _ = driver.decide(observe(0.0), driver.start())
    assert decision.theta == THETA
