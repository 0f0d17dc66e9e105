"""The closed loop as an iterator of ticks, and the rules that end it. Nothing in here knows who watches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

from twin.geometry import distance
from twin.records import Contact, Decision, Observation, Outcome, Pose2, Tick
from twin.simulation import Simulation
from twin.world import World


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


def rollout(simulation: Simulation, driver: Driver, memory: Any = None, index: int = 0) -> Iterator[Tick]:
    """Drive until the world's rules end the trial; one tick per 50 ms.

    `memory` continues a driver in the middle of a drive (after a rewind); None starts it. `index` numbers the first
    tick. The simulation is left as it was after the last tick that was asked for.
    """
    memory = driver.start() if memory is None else memory
    referee = Referee(simulation.world).started(simulation.time, simulation.true_pose)
    outcome = None
    while outcome is None:
        true_pose, bodies, clearance = simulation.true_pose, simulation.body_poses, simulation.clearance
        observation = simulation.observe()
        decision, memory = driver.decide(observation, memory)
        contact = simulation.apply(decision.command, decision.clear_beyond)
        referee = referee.started(simulation.time, simulation.true_pose)
        outcome = referee.outcome(simulation.time, simulation.true_pose, contact, decision)
        yield Tick(
            index,
            observation,
            decision,
            true_pose,
            bodies,
            clearance,
            contact,
            referee.elapsed(simulation.time),
            outcome,
        )
        index += 1
