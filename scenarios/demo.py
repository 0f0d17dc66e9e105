"""`appli demo`: the default planner through the training course and one generated BARN-like world."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from rich.console import Console
from rich.table import Column, Table

from scenarios.errors import blame
from scenarios.run import compile_kernels, recording_metadata
from scenarios.trials import TrialSpec, run_trial
from scenarios.worlds import load_world
from twin.recording import Recorder

WORLDS = ("training", "barn-like/150")


def demo_command(out: Path, seed: int) -> int:
    """Run, record, print a table and what to open next. Exit code 0 once both drives have been recorded."""
    with blame(f"cannot use the folder {out}"):
        out.mkdir(parents=True, exist_ok=True)
    compile_kernels()
    world_column = Column("world", no_wrap=True)
    table = Table(world_column, "outcome", "time [s]", "driven [m]", "recoveries", "closest [m]", "x real time")
    recordings = []
    for name in WORLDS:
        print(f"appli demo: driving {name} ...", file=sys.stderr, flush=True)
        spec, world = TrialSpec(name, seed=seed), load_world(name)
        path = out / f"{name.replace('/', '-')}.rrd"
        began = time.perf_counter()
        metadata = recording_metadata(spec, world)
        with blame(), Recorder(path, world, metadata) as recorder:
            result = run_trial(spec, world, recorder.add, explain=True)
        wall = time.perf_counter() - began
        table.add_row(
            world.name,
            result.outcome.value,
            f"{result.time:.1f}",
            f"{result.distance:.1f}",
            str(result.recoveries),
            f"{result.min_clearance:.2f}",
            f"{result.ticks * 0.05 / wall:.0f}",
        )
        recordings.append(path)
    Console().print(table)
    print("Open a recording:   " + "\n                    ".join(f".venv/bin/rerun {path}" for path in recordings))
    print("Then try:           .venv/bin/appli worlds")
    print("                    .venv/bin/appli run unseen --record out/unseen.rrd")
    return 0
