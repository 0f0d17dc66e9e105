"""The default planner on real BARN worlds, next to the published figures: `python -m scenarios.fidelity BARN.npz`.

Writes one CSV row per trial, so that an interrupted run goes on where it stopped, and prints the table of
docs/fidelity.md.
"""

from __future__ import annotations

import csv
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from scenarios.statistics import PENALTIES
from scenarios.trials import TrialSpec, run_trial
from scenarios.worlds import load_world
from twin.records import Outcome

FIELDS = ("protocol", "world", "run", "outcome", "time", "recoveries", "touched", "min_clearance")
PROTOCOLS = ("2020", "icra22")


@dataclass(frozen=True, slots=True)
class Options:
    """Drive the default planner through real BARN worlds and compare with the published figures."""

    barn: tyro.conf.Positional[Path]
    """The BARN worlds as barn_100.npz."""
    out: Path = Path("results/fidelity.csv")
    """Results, one row per trial."""
    runs: int = 2
    """Runs per world."""
    workers: int = 2
    """Processes."""


def trials(options: Options) -> list[TrialSpec]:
    """The 100 worlds under the 2020 protocol and the 50 challenge worlds under ICRA22, `runs` times each."""
    with np.load(options.barn, allow_pickle=False) as data:
        indices = [int(i) for i in data["world_index"]]
    sets = {"2020": indices, "icra22": [i for i in indices if i % 6 == 0]}
    return [
        TrialSpec(f"{options.barn}#{index}", protocol, run=run)
        for protocol, worlds in sets.items()
        for index in worlds
        for run in range(options.runs)
    ]


def row_of(spec: TrialSpec) -> dict[str, str]:
    """Run one trial; its CSV row."""
    world = load_world(spec.world, spec.protocol)
    result = run_trial(spec, world)
    return {
        "protocol": spec.protocol,
        "world": spec.world.rsplit("#")[-1],
        "run": str(spec.run),
        "outcome": result.outcome.value,
        "time": f"{result.time:.2f}",
        "recoveries": str(result.recoveries),
        "touched": str(int(result.contact is not None)),
        "min_clearance": f"{result.min_clearance:.4f}",
    }


def table(rows: list[dict[str, str]]) -> str:
    """The figures of docs/fidelity.md as Markdown; late = timed out or gave up."""
    lines = [
        "| protocol | trials | mean s | median s | mean of successes s | success | collision | late | touched |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for protocol in PROTOCOLS:
        of = [row for row in rows if row["protocol"] == protocol]
        if not of:
            continue
        late = {Outcome.TIMED_OUT.value, Outcome.ABORTED.value}
        times = np.array([PENALTIES[protocol] if row["outcome"] in late else float(row["time"]) for row in of])
        reached = np.array([row["outcome"] == Outcome.REACHED.value for row in of])
        collided = np.array([row["outcome"] == Outcome.COLLIDED.value for row in of])
        touched = np.mean([row["touched"] == "1" for row in of])
        lines.append(
            f"| {protocol} | {len(of)} | {times.mean():.1f} | {np.median(times):.1f} | {times[reached].mean():.1f} | "
            f"{reached.mean():.3f} | {collided.mean():.3f} | "
            f"{1 - reached.mean() - collided.mean():.3f} | {touched:.3f} |"
        )
    return "\n".join(lines)


def main(options: Annotated[Options, tyro.conf.OmitArgPrefixes]) -> None:
    """Run what is missing, then print the table."""
    if not options.barn.is_file():
        sys.exit(f"scenarios.fidelity: {options.barn}: no such file")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    rows = list(csv.DictReader(options.out.open())) if options.out.exists() else []
    done = {(row["protocol"], row["world"], row["run"]) for row in rows}
    todo = [s for s in trials(options) if (s.protocol, s.world.rsplit("#")[-1], str(s.run)) not in done]
    if rows:
        print(f"{len(rows)} trials of {options.out} count; remove it after a change of the code", file=sys.stderr)
    with options.out.open("a", newline="") as file, ProcessPoolExecutor(options.workers) as pool:
        writer = csv.DictWriter(file, FIELDS)
        if not rows:
            writer.writeheader()
        for count, future in enumerate(as_completed([pool.submit(row_of, spec) for spec in todo]), 1):
            rows.append(future.result())
            writer.writerow(rows[-1])
            file.flush()
            print(f"{count}/{len(todo)} {rows[-1]}", file=sys.stderr, flush=True)
    print(table(rows))


if __name__ == "__main__":
    tyro.cli(main)
