"""The twin as a dm_env environment: dm_env's own conformance tests, and what an episode must share with a trial."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import dm_env
import numpy as np
import pytest
from absl.testing import absltest
from dm_env.test_utils import EnvironmentTestMixin

from scenarios import TrialSpec, load_world, run_trial
from scenarios.trials import Tally
from tests.test_public_api import fresh
from twin import Cylinder, Outcome, PlannerParams, Pose2, Rules, World
from twin.environment import Environment, RewardWeights, Task

PAGE = Path(__file__).resolve().parents[1] / "docs" / "environment.md"
DEFAULT = PlannerParams().as_array()
RULES = Rules("course", goal_tolerance=0.5, time_limit=8.0)
FREE = World("free", (), Pose2(1.0, 0.0, 0.0), Pose2(3.0, 0.0, 0.0), RULES)
POST = World("post", (Cylinder(2.0, 0.0, 0.2, 0.8),), Pose2(1.0, 0.0, 0.0), Pose2(4.0, 0.0, 0.0), RULES)
FORWARD = np.array([0.8, 0.0])
COMMANDS = Task(actions="command", ticks=4)


class TestThetaConforms(EnvironmentTestMixin, absltest.TestCase):
    """dm_env's tests with theta as the action."""

    def make_object_under_test(self) -> Environment:
        return Environment([FREE, POST])

    def make_action_sequence(self) -> Iterator[np.ndarray]:
        for _ in range(12):  # to the goal and into the next episode
            yield DEFAULT


class TestCommandsConform(EnvironmentTestMixin, absltest.TestCase):
    """dm_env's tests with commands."""

    def make_object_under_test(self) -> Environment:
        return Environment([FREE, POST], COMMANDS)

    def make_action_sequence(self) -> Iterator[np.ndarray]:
        for _ in range(20):
            yield FORWARD


def drive(environment: Environment, action: np.ndarray) -> list[dm_env.TimeStep]:
    """One episode with one action."""
    steps = [environment.reset()]
    while not steps[-1].last():
        steps.append(environment.step(action))
    return steps


def test_an_episode_is_the_trial_of_its_seed_and_run() -> None:
    worlds = [load_world("barn-like/0"), load_world("barn-like/20")]
    environment = Environment(worlds, Task(ticks=7), seed=3)
    for run in range(2):
        tally, step = Tally(), environment.reset()
        while not step.last():
            step = environment.step(DEFAULT)
            for tick in environment.ticks:
                tally.add(tick)
        expected = run_trial(TrialSpec(f"barn-like/{20 * run}", seed=3, run=run))
        assert tally.result().digest == expected.digest
        assert environment.ticks[-1].elapsed == pytest.approx(expected.time)


def test_equal_seeds_give_equal_episodes_and_others_other_noise() -> None:
    def scans(seed: int) -> np.ndarray:
        return np.stack([step.observation["scan"] for step in drive(Environment(POST, seed=seed), DEFAULT)[:4]])

    assert np.array_equal(scans(5), scans(5))
    assert not np.array_equal(scans(5), scans(6))


def test_worlds_take_turns_and_a_reset_begins_the_next() -> None:
    environment = Environment([FREE, POST])
    assert environment.world is FREE
    seen = []
    for _ in range(3):
        environment.reset()
        environment.step(DEFAULT)
        seen.append(environment.world)
    assert seen == [FREE, POST, FREE]
    drive(environment, DEFAULT)
    assert environment.step(DEFAULT).first()
    assert environment.world is FREE


def test_theta_is_what_drives() -> None:
    slow, fast = (len(drive(Environment(FREE, Task(ticks=1)), vector(max_vel_x=v))) for v in (0.3, 1.0))
    assert fast < 0.7 * slow  # short: most of it is speeding up
    environment = Environment(FREE)
    environment.reset()
    environment.step(vector(vx_samples=7) + np.eye(8)[2] * 0.9)
    assert environment.ticks[0].decision.theta == PlannerParams(vx_samples=7)


def vector(**changes: float) -> np.ndarray:
    """The default theta with some values replaced, as an action."""
    return replace(PlannerParams(), **changes).as_array()  # type: ignore[arg-type]


def test_the_reward_is_progress_time_and_how_it_ended() -> None:
    reached = drive(Environment(FREE, COMMANDS), FORWARD)
    assert sum(step.reward for step in reached[1:]) == pytest.approx(2.0 - 0.5 - 0.05 * ticks(reached), abs=0.1)
    hit = Environment(POST, COMMANDS)
    steps = drive(hit, FORWARD)
    assert hit.ticks[-1].outcome is Outcome.COLLIDED
    assert steps[-1].reward == pytest.approx(-51.0, abs=0.5)
    assert [step.discount for step in steps[1:]] == [1.0] * (len(steps) - 2) + [0.0]
    stuck = Environment(FREE, COMMANDS)
    steps = drive(stuck, np.zeros(2))
    assert stuck.ticks[-1].outcome is Outcome.TIMED_OUT
    assert sum(step.reward for step in steps[1:]) == pytest.approx(-8.0 - 50.0, abs=0.05)


def ticks(steps: list[dm_env.TimeStep]) -> float:
    """Of an episode with four in a step, to within one step."""
    return 4.0 * (len(steps) - 1)


def test_time_is_charged_to_the_tick() -> None:
    free = RewardWeights(progress=0.0, collision=0.0, failure=0.0)
    environment = Environment(FREE, Task("command", 7, free))
    steps = drive(environment, FORWARD)
    assert len(environment.ticks) < 7, "the last step is whole: choose another number of ticks"
    assert sum(step.reward for step in steps[1:]) == pytest.approx(-environment.ticks[-1].elapsed)


def test_weights_scale_their_parts() -> None:
    only = RewardWeights(progress=0.0, time=0.0, collision=0.0, failure=0.0, success=7.0)
    steps = drive(Environment(FREE, Task("command", 4, only)), FORWARD)
    assert [step.reward for step in steps[1:]] == [0.0] * (len(steps) - 2) + [7.0]
    touch = replace(POST, rules=replace(RULES, stop_on_contact=False, time_limit=3.0))
    steps = drive(Environment(touch, Task("command", 4, replace(only, collision=-1.0))), FORWARD)
    assert {step.reward for step in steps[1:]} == {0.0, -1.0}


def test_the_observation_is_in_the_robots_frame() -> None:
    turned = replace(FREE, start=Pose2(1.0, 0.0, 0.3))  # the goal is 2 m along the world's x
    seen = Environment(turned).reset().observation
    np.testing.assert_allclose(seen["goal"], [2.0 * np.cos(0.3), -2.0 * np.sin(0.3)], atol=1e-5)
    assert (seen["scan"] == 30.0).all()  # nothing there: range_max, not inf
    steps = drive(Environment(POST, COMMANDS), np.array([0.5, 0.0]))
    assert steps[0].observation["scan"].min() == pytest.approx(0.8 - 0.1, abs=0.15)  # the lidar sits before the middle
    np.testing.assert_allclose(steps[3].observation["velocity"], [0.5, 0.0], atol=0.05)


@pytest.mark.parametrize("action", [np.zeros(3), np.full(8, np.nan), 1.0])
def test_an_action_that_is_none_is_refused(action: np.ndarray) -> None:
    environment = Environment(FREE)
    environment.reset()
    with pytest.raises(ValueError, match="theta is 8 finite numbers"):
        environment.step(action)


def test_actions_are_clipped_to_their_bounds() -> None:
    environment = Environment(FREE, Task("command", 1))
    environment.reset()
    environment.step(np.array([99.0, -99.0]))
    command = environment.ticks[0].applied
    assert command is not None
    assert (command.v, command.w) == (2.0, -4.0)


@pytest.mark.parametrize("make", [lambda: Environment([]), lambda: Task(ticks=0), lambda: Task("speed")])  # type: ignore[arg-type]
def test_nonsense_is_refused(make: type) -> None:
    with pytest.raises(ValueError, match=r"at least one world|ticks must|actions must"):
        make()


def test_the_example_of_the_page_runs() -> None:
    (example,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len([line for line in example.splitlines() if line]) <= 15
    default, careful = fresh(example).splitlines()
    assert default.startswith("default: reached")
    assert careful.startswith("by sight: reached")
    returns = [float(line.rsplit(" ", 1)[1]) for line in (default, careful)]
    assert returns[1] > returns[0]
