"""The closed loop as an iterator of ticks, and the rules that end it. Nothing in here knows who watches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

from twin.geometry import distance
from twin.records import Command, Contact, Decision, Observation, Outcome, Pose2, Tick
from twin.world import World

if TYPE_CHECKING:  # a loop meets its simulation; `import twin` should not load MuJoCo
    from twin.simulation import Simulation, Snapshot


class Driver(Protocol):
    """Whatever turns observations into commands: a planner, a policy, a person. State in, state out."""

    def start(self) -> Any:
        """The memory before the first tick; an immutable value."""

    def decide(self, observation: Observation, memory: Any) -> tuple[Decision, Any]:
        """The decision for one observation, and the memory for the next; must not modify `memory`."""


@dataclass(frozen=True, slots=True)
class Referee:
    """Applies a world's rules: when the clock starts and when the trial is over."""

    world: World
    clock_start: float | None = None  # [s] simulated time at which the clock started

    def started(self, time: float, pose: Pose2) -> Referee:
        """The referee after seeing the robot at `pose` (world) at `time`: the clock may have started."""
        if self.clock_start is None and distance(pose, self.world.start) >= self.world.rules.clock_distance:
            return replace(self, clock_start=time)
        return self

    def elapsed(self, time: float) -> float:
        """Seconds on the clock."""
        return 0.0 if self.clock_start is None else time - self.clock_start

    def outcome(self, time: float, pose: Pose2, contact: Contact | None, decision: Decision) -> Outcome | None:
        """How the trial ended, or None while it goes on. A clock that never started times out all the same."""
        rules = self.world.rules
        if contact is not None and rules.stop_on_contact:
            return Outcome.COLLIDED
        past_line = rules.finish_line_y is not None and pose.y > rules.finish_line_y
        if past_line or distance(pose, self.world.goal) <= rules.goal_tolerance:
            return Outcome.REACHED
        if decision.aborted:
            return Outcome.ABORTED
        start = 0.0 if self.clock_start is None else self.clock_start
        return Outcome.TIMED_OUT if time - start >= rules.time_limit - 1e-9 else None


@dataclass(frozen=True, slots=True)
class LoopState:
    """Everything that decides how a closed loop goes on."""

    simulation: Snapshot
    memory: Any
    index: int
    referee: Referee


class Loop:
    """A simulation and its driver, one tick at a time, with a state that can be saved and put back."""

    def __init__(self, simulation: Simulation, driver: Driver) -> None:
        """At the start of the trial."""
        self.simulation, self.driver = simulation, driver
        self._memory = driver.start()
        self._index = 0
        self._referee = Referee(simulation.world).started(simulation.time, simulation.true_pose)

    def step(self, override: Command | None = None) -> Tick:
        """Sense, decide, act for 50 ms. An override is a person's command and goes first, as in twist_mux.

        The driver decides all the same, as a planner goes on planning while somebody else drives.
        """
        simulation = self.simulation
        true_pose, bodies, clearance = simulation.true_pose, simulation.body_poses, simulation.clearance
        observation = simulation.observe()
        decision, self._memory = self.driver.decide(observation, self._memory)
        if override is None:
            contact = simulation.apply(decision.command, decision.clear_beyond)
        else:
            contact = simulation.apply(override)
        self._referee = self._referee.started(simulation.time, simulation.true_pose)
        outcome = self._referee.outcome(simulation.time, simulation.true_pose, contact, decision)
        elapsed = self._referee.elapsed(simulation.time)
        tick = Tick(
            self._index, observation, decision, true_pose, bodies, clearance, contact, elapsed, outcome, override
        )
        self._index += 1
        return tick

    def save(self) -> LoopState:
        """The state between two ticks."""
        return LoopState(self.simulation.snapshot(), self._memory, self._index, self._referee)

    def restore(self, state: LoopState) -> None:
        """Back to a saved state; what follows replays bit for bit."""
        self.simulation.restore(state.simulation)
        self._memory, self._index, self._referee = state.memory, state.index, state.referee


def rollout(simulation: Simulation, driver: Driver) -> Iterator[Tick]:
    """Drive until the world's rules end the trial; one tick per 50 ms."""
    loop = Loop(simulation, driver)
    while True:
        tick = loop.step()
        yield tick
        if tick.outcome is not None:
            return
