"""How long `make experiments` will take on this machine.

python -m scenarios.experiments FOLDER WORLDS SEEDS
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from scenarios.agenda import expand
from scenarios.errors import UserError, blame
from scenarios.identity import code_digest
from scenarios.progress import duration
from scenarios.report import paper
from scenarios.store import Store
from scenarios.trials import TrialSpec, make_driver, make_simulation
from scenarios.warm_up import warm_up
from scenarios.worlds import load_world
from twin.rollout import rollout
from twin.simulation import TICK

METHODS = len(paper.METHODS)
COURSES, COURSE_RUNS, BARN_RUNS = 2, 20, 12  # (paper, sections V-B and V-C; it had 5 runs on the courses)
PROBE = 100  # ticks that are timed

# Seconds of driving behind one piece of work, rounded means over all methods of the trials in results/.
COURSE_TRIAL, BARN_TRIAL = 55.0, 20.0
SESSION = 400.0  # a drive on the training course, wound back for every intervention
TRAINING = 900.0  # [s] of one core: six searches, three classifiers


@dataclass(frozen=True, slots=True)
class Step:
    """One line of the estimate."""

    name: str
    total: int
    done: int
    seconds: float  # [s] of one core for each piece
    parallel: bool = True


def seconds_per_second(driver: str) -> float:
    """[s] of computing per second of driving, in a world in the middle of the generated ones."""
    spec = TrialSpec("barn-like/150", driver=driver)
    ticks = rollout(make_simulation(spec, load_world(spec.world)), make_driver(spec))
    next(ticks)
    began = time.perf_counter()
    count = sum(1 for _ in islice(ticks, PROBE))
    return (time.perf_counter() - began) / (count * TICK)


def steps(folder: Path, worlds: str, seeds: Sequence[str], cost: float) -> list[Step]:
    """What there is to do; `cost`: computing per second of driving. Raises UserError."""
    with blame():
        count = sum(len(expand(item)) for item in worlds.split(","))
    sessions = sum((folder / "sessions" / seed).is_file() for seed in seeds)
    learned = (folder / "policies" / ".learned").is_file()
    return [
        Step("collect: sessions", len(seeds), sessions, SESSION * cost, parallel=False),
        Step("train: all methods", 1, int(learned), TRAINING),
        Step("courses: trials", METHODS * COURSES * COURSE_RUNS, _done(folder / "courses.sqlite"), COURSE_TRIAL * cost),
        Step("BARN: trials", METHODS * count * BARN_RUNS, _done(folder / "barn.sqlite"), BARN_TRIAL * cost),
    ]


def _done(path: Path) -> int:
    """Trials in a store that this code has made."""
    if not path.exists():
        return 0
    with Store.open(path) as store:
        return len(store.rows(status="done", code=code_digest()))


def main(arguments: Sequence[str]) -> int:
    """Print the estimate."""
    if len(arguments) != 3:
        print("usage: python -m scenarios.experiments FOLDER WORLDS SEEDS", file=sys.stderr)
        return 2
    folder, worlds, seeds = Path(arguments[0]), arguments[1], arguments[2].split()
    try:
        warm_up()
        plain, learned = seconds_per_second("dwa"), seconds_per_second("theta:B2")
        cost = (plain + (METHODS - 1) * (plain + learned) / 2) / METHODS  # policies change between cheap and dear
        plan = steps(folder, worlds, seeds, cost)
    except UserError as error:
        print(f"experiments: {error}", file=sys.stderr)
        return 2
    n = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    print(f"{n} cores; a second of driving takes {plain:.2f} s of one (default) to {learned:.2f} s (the paper's B2)")
    total = 0.0
    for step in plan:
        left = max(0, step.total - step.done)
        seconds = left * step.seconds / (n if step.parallel else 1)
        total += seconds
        print(f"  {step.name:20} {step.total:6,}, done {min(step.done, step.total):6,}, left about {duration(seconds)}")
    print(f"together about {duration(total)}; stop it when you like, the same command goes on", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
