"""One trial: a spec says everything that it is, a result says what happened. Never a judgement."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from learning.deploy import AppliDriver
from learning.policy_file import load_policy
from learning.published import published_parameters
from scenarios.switches import Switches
from scenarios.worlds import load_world
from twin.geometry import distance
from twin.planner.move_base import MoveBase, MoveBaseDriver, MoveBaseSettings
from twin.planner.params import PlannerParams
from twin.planner.plan import PlannerSettings
from twin.planner.trajectory import LocalPlannerSettings
from twin.records import Contact, Outcome, Pose2, Tick
from twin.rollout import Driver, rollout
from twin.simulation import RobotConfig, Simulation
from twin.world import World


def move_base_settings(switches: Switches) -> MoveBaseSettings:
    """The planner's settings under these switches."""
    local = LocalPlannerSettings(meter_scoring_factor=float(switches.meter_scoring_factor))
    planner = PlannerSettings(switches.inflation, switches.couple_min_vel_theta, local)
    return MoveBaseSettings(planner, switches.clearing_works)


@dataclass(frozen=True, slots=True)
class TrialSpec:
    """Everything that decides a trial. Equal specs give byte-equal results."""

    world: str  # as on the command line
    protocol: str = "appli"
    driver: str = "dwa"
    seed: int = 0
    run: int = 0
    params: PlannerParams = field(default_factory=PlannerParams)  # theta of the driver "dwa"
    switches: Switches = field(default_factory=Switches)


@dataclass(frozen=True, slots=True)
class TrialResult:
    """What happened."""

    outcome: Outcome
    time: float  # [s] on the trial's clock
    distance: float  # [m] driven
    recoveries: int  # recovery behaviours started
    contexts: dict[str, float]  # share of ticks per context
    min_clearance: float  # [m] smallest true distance of the robot's outline to an obstacle
    contact: Contact | None  # the first
    ticks: int
    digest: str  # SHA-256 of the tick stream
    versions: dict[str, str]


class Tally:
    """The fold from ticks to a TrialResult."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self._contexts: Counter[str] = Counter()
        self._last: Tick | None = None
        self._distance = 0.0
        self._clearance = math.inf
        self._contact: Contact | None = None

    def add(self, tick: Tick) -> None:
        """Take one tick into account."""
        if self._last is not None:
            self._distance += distance(self._last.true_pose, tick.true_pose)
        self._contexts[tick.decision.context] += 1
        self._clearance = min(self._clearance, tick.clearance)
        self._contact = self._contact or tick.contact
        self._hash.update(tick_bytes(tick))
        self._last = tick

    def result(self) -> TrialResult:
        """The result; the last tick must have had an outcome."""
        if self._last is None or self._last.outcome is None:
            raise ValueError("the trial has not ended")
        count = self._last.index + 1
        return TrialResult(
            outcome=self._last.outcome,
            time=round(self._last.elapsed, 9),
            distance=self._distance,
            recoveries=self._last.decision.recoveries,
            contexts={name: n / count for name, n in sorted(self._contexts.items())},
            min_clearance=self._clearance,
            contact=self._contact,
            ticks=count,
            digest=self._hash.hexdigest(),
            versions={name: version(name) for name in ("appli-twin", "mujoco", "numpy", "numba")},
        )


def tick_bytes(tick: Tick) -> bytes:
    """What two runs must share byte for byte: what was seen, where the robot was, and what was decided."""
    x, decision = tick.observation, tick.decision
    command = (math.nan, math.nan) if decision.command is None else (decision.command.v, decision.command.w)
    numbers = (
        x.time,
        *_flat(x.pose),
        x.twist.v,
        x.twist.w,
        *_flat(tick.true_pose),
        *command,
        *decision.theta.as_array(),
    )
    words = f"{decision.state}|{decision.context}|{decision.confidence}|{tick.outcome}|{tick.contact}"
    return (
        x.scan.ranges.tobytes()
        + tick.body_poses.tobytes()
        + np.array(numbers).tobytes()
        + decision.theta.as_array().tobytes()
        + words.encode()
    )


def _flat(pose: Pose2) -> tuple[float, float, float]:
    return pose.x, pose.y, pose.yaw


def make_driver(spec: TrialSpec, explain: bool = False) -> Driver:
    """The driver that a spec names: `dwa`, `theta:NAME` (a published row, all the time) or a policy file.

    Raises ValueError or OSError when there is none of that name.
    """
    base = MoveBase(move_base_settings(spec.switches), explain)
    if spec.driver == "dwa":
        return MoveBaseDriver(spec.params, base)
    if spec.driver.startswith("theta:"):
        rows, name = published_parameters(), spec.driver.removeprefix("theta:")
        if name not in rows:
            raise ValueError(f"unknown parameters {spec.driver!r}; known: {', '.join(f'theta:{row}' for row in rows)}")
        return MoveBaseDriver(rows[name], base)
    if not spec.driver.endswith(".safetensors"):
        raise ValueError(f"unknown driver {spec.driver!r}; give dwa, theta:NAME or a policy (.safetensors)")
    return AppliDriver(load_policy(Path(spec.driver)), base)


def make_simulation(spec: TrialSpec, world: World) -> Simulation:
    """A fresh simulation; its noise depends on seed, world and run, never on the driver."""
    rng = np.random.default_rng([spec.seed, world.index, spec.run])
    return Simulation(world, rng, RobotConfig(lidar_mount=spec.switches.lidar_mount))


def run_trial(
    spec: TrialSpec,
    world: World | None = None,
    watch: Callable[[Tick], Any] | None = None,
    explain: bool = False,
    driver: Driver | None = None,
) -> TrialResult:
    """Run one trial to its end; `watch` sees every tick. `world` and `driver` save making those of the spec again."""
    world = load_world(spec.world, spec.protocol) if world is None else world
    driver = make_driver(spec, explain) if driver is None else driver
    simulation, tally = make_simulation(spec, world), Tally()
    for tick in rollout(simulation, driver):
        tally.add(tick)
        if watch is not None:
            watch(tick)
    return tally.result()


def result_as_dict(result: TrialResult) -> dict[str, Any]:
    """Plain values for JSON: infinities become null."""
    values = asdict(result)
    values["outcome"] = result.outcome.value
    values["min_clearance"] = result.min_clearance if math.isfinite(result.min_clearance) else None
    return values
