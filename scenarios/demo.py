"""`appli demo`: the paper in miniature. Collect interventions, learn from them, and drive with and without."""

from __future__ import annotations

import shutil
import sys
import time
from pathlib import Path

from scenarios.collect import collect_command
from scenarios.errors import UserError, blame
from scenarios.folders import make_folder
from scenarios.policy_options import PolicyOptions
from scenarios.recorded import open_recorder
from scenarios.run import compile_kernels
from scenarios.tables import plain_table, print_table
from scenarios.training import train_command
from scenarios.trials import TrialResult, TrialSpec, make_driver, run_trial
from scenarios.worlds import load_world
from twin.simulation import TICK

WORLDS = ("training", "barn-like/60", "barn-like/150", "barn-like/240")
METHOD = "A+B+c"


def demo_command(out: Path, seed: int, sessions: int) -> int:
    """Collect, train, drive and record, print a table and what to open next. Exit code 0 once all is done.

    What an earlier demo left in the folder is used again: interventions, and the policy learned from them.
    """
    if sessions < 1 or seed < 0:
        raise UserError("--sessions must be 1 or more, and --seed 0 or more")
    make_folder(out)
    compile_kernels()
    interventions, policy = out / "interventions", out / f"{METHOD}.safetensors"
    if policy.exists():
        _say(f"using {policy}")
    else:
        _say(f"1. {sessions} sessions of a scripted intervener on the training course")
        for number in range(seed, seed + sessions):
            if any(interventions.glob(f"*-seed{number}-*.npz")):
                _say(f"using the session of seed {number} in {interventions}")
            else:
                _collect(interventions, number)
        _say("2. learning planner parameters and the context classifier from types A and B")
        train_command(interventions, policy, "A,B", seed, False, PolicyOptions())
    _say("3. driving with the default parameters and with what was learned")
    table = plain_table("world", "method", "outcome", "time [s]", "closest [m]", "contexts")
    for world in WORLDS:
        for method, driver in (("dwa", "dwa"), (METHOD, str(policy))):
            result = _drive(TrialSpec(world, driver=driver, seed=seed), out / _file_name(world, method))
            table.add_row(
                world,
                method,
                result.outcome.value,
                f"{result.time:.1f}",
                f"{result.min_clearance:.2f}",
                ", ".join(f"{label} {share:.0%}" for label, share in result.contexts.items()),
            )
        table.add_section()
    print_table(table)
    print(f"Look at it:   .venv/bin/appli view {out / _file_name('training', METHOD)}")
    both = " ".join(str(out / _file_name("training", method)) for method in ("dwa", METHOD))
    print(f"Side by side: .venv/bin/appli view --compare {both}")
    print(f"Go on:        .venv/bin/appli run unseen --driver {policy} --record {out / 'unseen.rrd'}")
    return 0


def _collect(folder: Path, seed: int) -> None:
    """One session, made beside the others and moved to them when it is complete."""
    unfinished = folder.with_suffix(".part")
    shutil.rmtree(unfinished, ignore_errors=True)
    collect_command("training", unfinished, "appli", seed, sessions=1, rewinding=True, record=False)
    with blame(f"cannot use the folder {folder}"):
        folder.mkdir(exist_ok=True)
        for path in unfinished.iterdir():
            path.rename(folder / path.name)
        unfinished.rmdir()


def _drive(spec: TrialSpec, recording: Path) -> TrialResult:
    world = load_world(spec.world)
    began = time.perf_counter()
    driver = make_driver(spec, explain=True)
    with blame(), open_recorder(spec, world, driver, recording) as recorder:
        result = run_trial(spec, world, recorder.add, driver=driver)
    speed = result.ticks * TICK / (time.perf_counter() - began)
    _say(f"   {spec.world} with {Path(spec.driver).stem}: {result.outcome.value}, {speed:.0f} x real time")
    return result


def _file_name(world: str, method: str) -> str:
    return f"{world.replace('/', '-')}-{method}.rrd"


def _say(text: str) -> None:
    print(f"appli demo: {text}", file=sys.stderr, flush=True)
