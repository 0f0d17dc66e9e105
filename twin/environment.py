"""The twin as a `dm_env.Environment`: learners set the planner's parameters, or drive the base themselves.

The task is that of APPLR (Xu et al., ICRA 2021): every second a policy sees the scan and the goal and picks theta,
move_base drives, and the reward pays progress and charges time and collisions. An episode is a trial: the same loop,
the same rules, the same noise, so what a learner is paid for is what `appli run` would have measured.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import dm_env
import numpy as np
from dm_env import specs
from numpy.typing import ArrayLike, NDArray

from twin.geometry import distance, invert, transform_points
from twin.planner.move_base import Memory, MoveBase, MoveBaseSettings
from twin.planner.params import INTEGERS, PARAMETER_NAMES, ParameterSpace, PlannerParams
from twin.records import Array, Command, Decision, Observation, Outcome, Tick
from twin.rollout import Loop
from twin.simulation import TICK, RobotConfig, Simulation
from twin.world import World


@dataclass(frozen=True, slots=True)
class RewardWeights:
    """What a step is worth: progress * metres nearer the goal + time * seconds, and on top what happened in it.

    Distances are true and straight, as in the authors' environment (github.com/Daffan/ros_jackal,
    envs/jackal_gazebo_envs.py), whose defaults these are, but for `collision`. What they trained with is
    `RewardWeights(time=0.0, failure=0.0, success=20.0)` (configs/dwa_params_laser.yaml).
    """

    progress: float = 1.0  # [1/m] goal_reward
    time: float = -1.0  # [1/s] slack_reward, per step of 1 s
    collision: float = -1.0  # in a step with a contact; collision_reward (configs/dwa_params_laser.yaml)
    failure: float = -50.0  # failure_reward: the episode ended and the goal was not reached
    success: float = 0.0  # success_reward: it was


@dataclass(frozen=True, slots=True)
class Task:
    """What a learner is given to do."""

    actions: Literal["theta", "command"] = "theta"
    ticks: int = 20  # of 50 ms, in a step; the action holds for all of them. 20 make the second of the authors' code
    reward: RewardWeights = field(default_factory=RewardWeights)
    space: ParameterSpace = field(default_factory=ParameterSpace)  # bounds of theta
    planner: MoveBaseSettings = field(default_factory=MoveBaseSettings)  # not used with commands
    robot: RobotConfig = field(default_factory=RobotConfig)

    def __post_init__(self) -> None:
        if self.actions not in ("theta", "command"):
            raise ValueError(f"actions must be 'theta' or 'command', not {self.actions!r}")
        if self.ticks < 1:
            raise ValueError(f"ticks must be 1 or more, not {self.ticks}")


class Environment(dm_env.Environment):  # type: ignore[misc]  # dm_env has no types
    """Driving to the goal of one world, or of each of several in turn. Equal arguments and actions, equal episodes.

    Episode k happens in world k modulo their number and meets the noise of that world's trial with this seed and run k.
    The trial's outcome ends it, with discount 0 whatever it is: running out of time is a failure by the rules too.
    """

    def __init__(self, worlds: World | Sequence[World], task: Task = Task(), seed: int = 0) -> None:
        """No episode has begun yet. `seed` is the root of all noise."""
        self._worlds = (worlds,) if isinstance(worlds, World) else tuple(worlds)
        if not self._worlds or seed < 0:
            raise ValueError("an environment needs at least one world, and a seed of 0 or more")
        self._task, self._seed = task, seed
        self._actions, self._observations = _action_spec(task), _observation_spec(task.robot)
        self._episode = -1
        self._simulation: _Foreseen | None = None  # None: the next step begins an episode
        self._driver = _Led(None)
        self._loop: Loop | None = None
        self.ticks: tuple[Tick, ...] = ()  # of the last step, for recordings and measures

    @property
    def world(self) -> World:
        """Where the present episode happens; the first world before there is one."""
        return self._worlds[max(self._episode, 0) % len(self._worlds)]

    def action_spec(self) -> specs.BoundedArray:
        """Theta (8,) in the order and the units of `PlannerParams`, or a command (2,): v [m/s], w [rad/s].

        Actions are clipped to the bounds; sample counts are truncated, as in `ParameterSpace.decode`.
        """
        return self._actions

    def observation_spec(self) -> Mapping[str, specs.Array]:
        """float32: scan (n,) [m], right to left, no return = range_max; goal (2,) x, y [m] in base_link; velocity (2,)
        v [m/s], w [rad/s]. Goal and velocity are what odometry says, drift included.
        """
        return self._observations

    def reset(self) -> dm_env.TimeStep:
        """Begin the next episode, in a fresh simulation."""
        self._episode += 1
        rng = np.random.default_rng([self._seed, self.world.index, self._episode])  # as scenarios.trials
        self._simulation = simulation = _Foreseen(self.world, rng, self._task.robot)
        self._driver = _Led(MoveBase(self._task.planner) if self._task.actions == "theta" else None)
        self._loop = Loop(simulation, self._driver)
        self.ticks = ()
        return dm_env.restart(self._see(simulation))

    def step(self, action: ArrayLike) -> dm_env.TimeStep:
        """Hold the action for `ticks` ticks or to the end. Begins an episode instead, as dm_env asks, when there is
        none or the last one is over.
        """
        simulation, loop = self._simulation, self._loop
        if simulation is None or loop is None:
            return self.reset()
        self._driver.lead(self._checked(action))
        before = distance(simulation.true_pose, self.world.goal)
        ticks: list[Tick] = []
        for _ in range(self._task.ticks):
            ticks.append(loop.step())
            if ticks[-1].outcome is not None:
                break
        self.ticks = tuple(ticks)
        progress = before - distance(simulation.true_pose, self.world.goal)
        reward, seen = self._reward(progress, ticks), self._see(simulation)
        if ticks[-1].outcome is None:
            return dm_env.transition(reward, seen)
        self._simulation = self._loop = None
        return dm_env.termination(reward, seen)

    def _checked(self, action: ArrayLike) -> Array:
        spec = self._actions
        values = np.asarray(action, dtype=np.float64)
        if values.shape != spec.shape or not np.isfinite(values).all():
            raise ValueError(f"{spec.name} is {spec.shape[0]} finite numbers, not {action!r}")
        clipped: Array = np.clip(values, spec.minimum, spec.maximum)
        return clipped

    def _reward(self, progress: float, ticks: Sequence[Tick]) -> float:
        """Of a step that brought the robot `progress` metres nearer."""
        weights, outcome = self._task.reward, ticks[-1].outcome
        reward = weights.progress * progress + weights.time * len(ticks) * TICK
        if any(tick.contact is not None for tick in ticks):
            reward += weights.collision
        if outcome is not None:
            reward += weights.success if outcome is Outcome.REACHED else weights.failure
        return reward

    def _see(self, simulation: _Foreseen) -> dict[str, NDArray[np.float32]]:
        x = simulation.look()
        goal = transform_points(invert(x.pose), np.array([[x.goal.x, x.goal.y]]))[0]
        return {
            "scan": np.minimum(x.scan.ranges, x.scan.range_max).astype(np.float32),
            "goal": goal.astype(np.float32),
            "velocity": np.array([x.twist.v, x.twist.w], dtype=np.float32),
        }


class _Foreseen(Simulation):
    """A simulation whose next observation can be seen before the tick that takes it.

    Between two ticks nothing moves and nothing else draws noise, so looking early changes no bit of what follows.
    """

    _next: Observation | None = None

    def look(self) -> Observation:
        """What the next tick will observe."""
        self._next = self._next or super().observe()
        return self._next

    def observe(self) -> Observation:
        x, self._next = self.look(), None
        return x


class _Led:
    """A driver that is told from outside what to do: theta for the planner, or without one the command itself."""

    def __init__(self, base: MoveBase | None) -> None:
        self._base = base
        self._theta = PlannerParams()
        self._command: Command | None = None

    def lead(self, action: Array) -> None:
        """What to do from now on."""
        if self._base is None:
            self._command = Command(float(action[0]), float(action[1]))
        else:
            self._theta = _theta(action)

    def start(self) -> Any:
        return None if self._base is None else Memory()

    def decide(self, observation: Observation, memory: Any) -> tuple[Decision, Any]:
        if self._base is None:
            return Decision(self._command, self._theta), memory
        return self._base.step(observation, self._theta, memory)


def _action_spec(task: Task) -> specs.BoundedArray:
    if task.actions == "theta":
        low, high = np.array(task.space.lower, dtype=np.float64), np.array(task.space.upper, dtype=np.float64)
    else:
        high = np.array([task.robot.drive.max_v, task.robot.drive.max_w])
        low = -high
    return specs.BoundedArray(low.shape, np.float64, low, high, name=task.actions)


def _observation_spec(robot: RobotConfig) -> dict[str, specs.Array]:
    return {
        "scan": specs.BoundedArray((robot.lidar.beams,), np.float32, 0.0, robot.lidar.range_max, name="scan"),
        "goal": specs.Array((2,), np.float32, name="goal"),
        "velocity": specs.Array((2,), np.float32, name="velocity"),
    }


def _theta(action: Array) -> PlannerParams:
    values = zip(PARAMETER_NAMES, action.tolist(), strict=True)
    return PlannerParams.from_mapping({n: math.floor(v + 1e-9) if n in INTEGERS else v for n, v in values})
