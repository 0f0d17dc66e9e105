"""How much time is there to gain? One parameter set, searched by CMA-ES directly for the mean traversal time.

A diagnosis, never part of APPLI: it drives the very worlds that it is judged on, hundreds of times. What it finds is
about what one set of parameters can give; a policy that changes them by context may do better.
"""

from __future__ import annotations

import sys
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any, Literal

import cma
import numpy as np

from scenarios.barn_generator import COUNT
from scenarios.run import compile_kernels
from scenarios.statistics import PENALTIES
from scenarios.trials import TrialSpec, make_driver, run_trial
from scenarios.worlds import load_world
from twin.planner.params import PARAMETER_NAMES, ParameterSpace, PlannerParams
from twin.records import Array, Outcome

SPACE, POPULATION, SIGMA = ParameterSpace(), 8, 0.2  # [cube sides] first step size, as in learning.fit
Change = dict[str, Any]  # fields of a TrialSpec that replace those of the default's trial


@dataclass(frozen=True, slots=True)
class Options:
    """Search one parameter set for the least mean traversal time, and compare it with the default on fresh seeds."""

    worlds: str = "doorway"  # names with commas between, as for `appli run`; a number N = N of the 300 barn-like ones
    evaluations: int = 8  # parameter sets to try at most
    runs: int = 1  # drives per world in the search, all with the same noise; the comparison has 3 times as many, fresh
    policy: str = ""  # a trained policy (.safetensors): which share of the gain does it reach?
    start: Literal["default", "middle"] = "default"  # where the search starts
    seed: int = 0  # of all noise and of the search
    workers: int | None = None  # processes; one per core


@dataclass(frozen=True, slots=True)
class Drives:
    """One driver in the comparison; the errors of pairs of equal world and noise."""

    time: float  # [s] mean
    reached: float  # share
    gain: float  # [s] mean, over the default
    gain_error: float  # [s] standard error


@dataclass(frozen=True, slots=True)
class Headroom:
    """What was found."""

    drives: int  # of each driver in the comparison
    params: PlannerParams  # the optimum
    share: float | None  # of the optimum's gain that the policy reaches; None without a policy or without a gain
    drivers: dict[str, Drives]  # default, optimum, policy


def measure(options: Options) -> Headroom:
    """Search, then compare on fresh seeds; says on stderr how it goes. Raises ValueError or OSError for bad options."""
    trials, fresh = default_trials(options, 0, 1), default_trials(options, 1, 4)
    with ProcessPoolExecutor(options.workers, get_context("spawn"), compile_kernels) as pool:
        optimum = search(pool, trials, options)
        drivers: dict[str, Change] = {"default": {}, "optimum": optimum}
        drivers |= {"policy": {"driver": options.policy}} if options.policy else {}
        times, reached = drive_all(pool, fresh, list(drivers.values()))
    gain = times[0] - times  # [s] in pairs
    error = gain.std(1, ddof=1) / len(fresh) ** 0.5
    rows = zip(times.mean(1), reached.mean(1), gain.mean(1), error, strict=True)
    compared = {name: Drives(*map(float, row)) for name, row in zip(drivers, rows, strict=True)}
    share = None
    if options.policy and compared["optimum"].gain > 0.0:
        share = compared["policy"].gain / compared["optimum"].gain
    return Headroom(len(fresh), optimum["params"], share, compared)


def default_trials(options: Options, begin: int, end: int) -> list[TrialSpec]:
    """(end - begin) * runs per world, every third world first. Raises ValueError or OSError for what is not there."""
    if min(options.evaluations, options.runs, options.workers or 1, options.seed + 1) < 1:
        raise ValueError("--evaluations, --runs and --workers must be at least 1, --seed 0")
    names, runs = [], range(begin * options.runs, end * options.runs)
    for word in options.worlds.split(","):
        if word.isdigit():
            if int(word) < 1:
                raise ValueError("--worlds takes a number of 1 or more")
            names += [f"barn-like/{k:.0f}" for k in np.linspace(0, COUNT - 1, int(word)).round()]
        else:
            load_world(word)  # must exist
            names.append(word)
    specs = [TrialSpec(name, seed=options.seed, run=run) for k in range(3) for name in names[k::3] for run in runs]
    make_driver(replace(specs[0], driver=options.policy or "dwa"))
    return specs


def drive(spec: TrialSpec) -> tuple[float, bool]:
    """Traversal time [s] as the paper counts it, and whether the goal was reached."""
    world = load_world(spec.world, spec.protocol)
    result = run_trial(spec, world)
    reached = result.outcome is Outcome.REACHED
    return (result.time if reached else PENALTIES[world.rules.protocol]), reached


def drive_all(pool: Executor, trials: list[TrialSpec], changes: list[Change]) -> Array:
    """(2, len(changes), len(trials)) what `drive` says of all trials with all changes."""
    drives = list(pool.map(drive, [replace(trial, **change) for change in changes for trial in trials]))
    return np.array(drives, dtype=np.float64).T.reshape(2, len(changes), len(trials))


def race(pool: Executor, trials: list[TrialSpec], changes: list[Change], best: Array) -> list[Array]:
    """Times [s] per change. Who is two standard errors behind the best in the first third is judged by that alone."""
    third = len(trials) // 3 if len(trials) >= 9 else 0
    behind = drive_all(pool, trials[:third], changes)[0] - best[:third]
    out = [third > 0 and d.mean() > 2.0 * d.std(ddof=1) / third**0.5 for d in behind]
    rest = iter(drive_all(pool, trials[third:], [c for c, o in zip(changes, out, strict=True) if not o])[0])
    return [best + d.mean() if o else np.r_[best[:third] + d, next(rest)] for d, o in zip(behind, out, strict=True)]


def brief(params: PlannerParams) -> str:
    """All eight in a line."""
    return ", ".join(f"{name} {value:.3g}" for name, value in params.as_dict().items())


def search(pool: Executor, trials: list[TrialSpec], options: Options) -> Change:
    """The best change. The default, and with it an occdist_scale of 0.01, are tried first."""
    tried: list[Change] = [{"params": PlannerParams()}, {"params": PlannerParams(occdist_scale=0.01)}]
    tried = tried[: options.evaluations]
    points, times = [SPACE.encode(change["params"]) for change in tried], list(drive_all(pool, trials, tried)[0])
    middle = np.full(len(PARAMETER_NAMES), 0.5)
    settings = {"bounds": [0.0, 1.0], "popsize": POPULATION, "seed": options.seed + 1, "verbose": -9}
    strategy = cma.CMAEvolutionStrategy(points[0] if options.start == "default" else middle, SIGMA, settings)
    while True:
        best = int(np.argmin([t.mean() for t in times]))
        last = " ".join(f"{t.mean():.1f}" for t in times[-POPULATION:])
        print(f"{len(tried)} tried, last {last} s; best {times[best].mean():.2f} s", file=sys.stderr)
        count = POPULATION - len(tried) % POPULATION
        if len(tried) + count > options.evaluations:
            return tried[best]
        points += strategy.ask(count)
        changes: list[Change] = [{"params": SPACE.decode(np.asarray(point))} for point in points[-count:]]
        times, tried = times + race(pool, trials, changes, times[best]), tried + changes
        strategy.tell(points[-POPULATION:], [float(t.mean()) for t in times[-POPULATION:]])
