"""Does a policy beat the default planner? `python examples/evaluate_policy.py results/policies/A+c.safetensors`

Both drive ten BARN-like worlds, from the easiest to the hardest, under the same noise; who does not arrive is charged
the 50 s of the paper. For many worlds and runs there is `appli sweep` and `appli report`.
"""

from concurrent.futures import ProcessPoolExecutor
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from learning import load_policy
from scenarios import TrialSpec, one_line_errors, run_trial
from scenarios.report.figures.style import BLUE, GREY, INK, drawing
from scenarios.run import compile_kernels
from scenarios.statistics import PENALTIES
from twin import Outcome


def main(
    policy: Annotated[str, tyro.conf.Positional] = "results/policies/A+c.safetensors",
    worlds: int = 10,  # how many of the 300
    runs: int = 1,  # drives in each of them by each of the two
    plot: Path = Path("out/policy.png"),
) -> None:
    """Drive, print a line per world and the means, plot."""
    if min(worlds, runs) < 1:
        raise ValueError("--worlds and --runs must be 1 or more")
    load_policy(Path(policy))  # a wrong one is told before anything is driven
    names = [f"barn-like/{k:.0f}" for k in np.linspace(0, 299, worlds).round()]
    specs = [TrialSpec(n, driver=d, run=k) for n, d, k in product(names, ("dwa", policy), range(runs))]
    with ProcessPoolExecutor(None, get_context("spawn"), compile_kernels) as pool:
        results = list(pool.map(run_trial, specs))
    arrived = np.array([r.outcome is Outcome.REACHED for r in results]).reshape(-1, 2, runs)
    seconds = np.array([r.time for r in results]).reshape(-1, 2, runs)
    means = np.where(arrived, seconds, PENALTIES["appli"]).mean(2)
    print(f"{'world':16s}{'default [s]':>12s}{'policy [s]':>12s}")
    for name, (default, ours) in zip(names, means, strict=True):
        print(f"{name:16s}{default:12.1f}{ours:12.1f}")
    print(f"{'mean':16s}{means[:, 0].mean():12.1f}{means[:, 1].mean():12.1f}")
    print(f"{'arrived':16s}{arrived[:, 0].mean():12.0%}{arrived[:, 1].mean():12.0%}")
    with drawing(6.5, 1.2 + 0.32 * worlds) as (figure, axes):
        axes.hlines(names, means.min(1), means.max(1), color=INK, linewidth=1.0, alpha=0.4)
        for side, (label, colour) in enumerate((("default", GREY), (Path(policy).stem, BLUE))):
            axes.plot(means[:, side], names, "o", color=colour, markersize=7, label=label)
        axes.set(xlabel="traversal time [s]", xlim=(0, None), ylim=(worlds - 0.5, -0.5))
        figure.legend(loc="outside upper center", ncols=2)
    plot.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(plot, dpi=150, bbox_inches="tight")
    print(f"plot: {plot}")


if __name__ == "__main__":
    with one_line_errors():
        tyro.cli(main)
