"""`appli bench`: the speed figures of the project, measured in one process and given as ratios."""

from __future__ import annotations

import json as json_module
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from typing import Any

from scenarios.bench_planner import CPP_MS, find_best_path_times
from scenarios.collect import Collected, Session
from scenarios.trials import TrialSpec, make_driver, make_simulation
from scenarios.warm_up import warm_up
from scenarios.worlds import load_world
from twin.planner.params import PlannerParams
from twin.records import Command
from twin.rollout import rollout

WORLDS = ("barn-like/50", "barn-like/150", "barn-like/250")
SIMULATED = 15.0  # [s] of every trial that are timed
B2 = PlannerParams(0.72, 0.73, 19, 59, 0.62, 1.00, 0.32, 0.24)  # the paper's Table I, second "B1"

# figure -> (must, aim) for what is a ratio or an absolute limit
TARGETS: dict[str, tuple[float, float]] = {
    "trial_over_floor": (3.0, 2.0),
    "trial_b2_over_floor": (5.0, 3.0),
    "fit_seconds": (60.0, 15.0),
    "table_hours": (6.0, 2.0),
    "worker_rss_mb": (600.0, 350.0),
}


@dataclass(frozen=True, slots=True)
class Drive:
    """One timed drive."""

    commands: list[tuple[Command | None, float | None]]
    seconds: float  # wall clock
    simulated: float  # [s]


def timed_drive(spec: TrialSpec) -> Drive:
    """The closed loop for the first `SIMULATED` seconds, as a trial runs it."""
    world = load_world(spec.world, spec.protocol)
    simulation, driver = make_simulation(spec, world), make_driver(spec)
    commands = []
    began = time.perf_counter()
    for tick in rollout(simulation, driver):
        commands.append((tick.decision.command, tick.decision.clear_beyond))
        if simulation.time >= SIMULATED:
            break
    return Drive(commands, time.perf_counter() - began, simulation.time)


def timed_floor(spec: TrialSpec, drive: Drive) -> float:
    """Wall seconds of physics and lidar alone for the same commands: the same drive without maps and planner."""
    simulation = make_simulation(spec, load_world(spec.world, spec.protocol))
    began = time.perf_counter()
    for command, _ in drive.commands:
        simulation.scan()
        simulation.apply(command)
    return time.perf_counter() - began


def loop_figures(repeats: int) -> dict[str, float]:
    """Real-time factors of the floor and of whole trials, default and B2, interleaved so that noise hits all alike."""
    wall = {"floor": 0.0, "trial": 0.0, "floor_b2": 0.0, "trial_b2": 0.0}
    simulated = {"trial": 0.0, "trial_b2": 0.0}
    for _ in range(repeats):
        for name in WORLDS:
            for suffix, theta in (("", PlannerParams()), ("_b2", B2)):
                spec = TrialSpec(name, params=theta)
                drive = timed_drive(spec)
                wall[f"trial{suffix}"] += drive.seconds
                simulated[f"trial{suffix}"] += drive.simulated
                wall[f"floor{suffix}"] += timed_floor(spec, drive)
    floor_rtf = (simulated["trial"] + simulated["trial_b2"]) / (wall["floor"] + wall["floor_b2"])
    trial_rtf, trial_b2_rtf = simulated["trial"] / wall["trial"], simulated["trial_b2"] / wall["trial_b2"]
    return {
        "floor_rtf": floor_rtf,
        "trial_rtf": trial_rtf,
        "trial_over_floor": wall["trial"] / wall["floor"],
        "trial_b2_rtf": trial_b2_rtf,
        "trial_b2_over_floor": wall["trial_b2"] / wall["floor_b2"],
        "table_hours": table_hours(trial_rtf, trial_b2_rtf),
    }


def table_hours(trial_rtf: float, trial_b2_rtf: float, mean_trial: float = 20.0) -> float:
    """Estimate for 25,200 trials of `mean_trial` seconds on two cores, half at the default's cost, half at B2's."""
    seconds_per_simulated = (1 / trial_rtf + 1 / trial_b2_rtf) / 2
    return 25_200 * mean_trial * seconds_per_simulated / 2 / 3600


def child(code: str, **environment: str) -> float:
    """The number that a fresh Python process prints."""
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **environment}, check=True, capture_output=True, text=True
    )
    return float(done.stdout)


def worker_rss_mb() -> float:
    """Peak memory of a process that runs one whole trial [MB]."""
    return child(
        "import resource; from scenarios.trials import TrialSpec, run_trial;"
        f"run_trial(TrialSpec({WORLDS[0]!r}));"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
    )


def numba_compile_seconds() -> float:
    """Seconds that the first run on a machine spends on compiling: warm-up with an empty cache less with a full one."""
    code = "import time; t = time.perf_counter(); from scenarios.warm_up import warm_up; warm_up();" + (
        "print(time.perf_counter() - t)"
    )
    with tempfile.TemporaryDirectory() as cache:
        first = child(code, NUMBA_CACHE_DIR=cache)
        return first - child(code, NUMBA_CACHE_DIR=cache)


def fit_seconds() -> tuple[float, int]:
    """Seconds for Eq. 1 on one intervention of the synthetic intervener, and its number of steps."""
    from learning.fit import FitSettings, fit

    kept: list[Collected] = []
    Session(TrialSpec("training"), load_world("training")).run(kept.append)
    longest = max((c.intervention for c in kept), key=lambda i: len(i.steps))
    fit(longest, FitSettings(max_evaluations=1, restarts=0))  # compiles
    return fit(longest).seconds, len(longest.steps)


def measure(repeats: int = 2) -> dict[str, Any]:
    """All figures."""
    warm_up()
    figures: dict[str, Any] = {name: round(value, 3) for name, value in loop_figures(repeats).items()}
    figures["find_best_path_ms"] = {name: round(ms, 4) for name, ms in find_best_path_times().items()}
    figures["worker_rss_mb"] = round(worker_rss_mb(), 1)  # before the fit: a child inherits its parent's peak
    seconds, steps = fit_seconds()
    figures["fit_seconds"], figures["fit_steps"] = round(seconds, 2), steps
    figures["numba_compile_seconds"] = round(numba_compile_seconds(), 1)
    return figures


def bench_command(json: bool, repeats: int) -> int:
    """Measure and print."""
    figures = measure(repeats)
    if json:
        print(json_module.dumps(figures))
        return 0
    from rich.console import Console
    from rich.table import Table

    table = Table("figure", "measured", "must", "aim", "against C++")
    for name, value in figures.items():
        if isinstance(value, dict):
            for scene, ms in value.items():
                limit = CPP_MS[scene]
                row = (f"{ms:.3f}", f"{limit}", f"{0.3 * limit:.2f}", f"{ms / limit:.2f}")
                table.add_row(f"findBestPath {scene}, ms", *row)
        else:
            must, aim = TARGETS.get(name, (None, None))
            table.add_row(name, f"{value}", "" if must is None else f"{must:g}", "" if aim is None else f"{aim:g}", "")
    Console().print(table)
    return 0
