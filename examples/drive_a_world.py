"""Drive a world from Python and plot the path: `python examples/drive_a_world.py barn-like/150 --plot out/path.png`"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from matplotlib.collections import LineCollection

from scenarios import TrialSpec, load_world, make_simulation, one_line_errors
from scenarios.report.figures.floor_plan import floor_plan
from twin import MoveBaseDriver, PlannerParams, Tick, World, rollout


@dataclass(frozen=True, slots=True)
class Options:
    """Drive a world with move_base and plot the path, coloured by speed."""

    world: Annotated[str, tyro.conf.Positional] = "barn-like/150"  # as for `appli run`
    max_vel_x: float = 0.5  # [m/s] one of the eight parameters; the others keep the Jackal's defaults
    seed: int = 0  # of the noise
    plot: Path = Path("out/path.png")  # .png, .svg or .pdf


def main(options: Options) -> None:
    """Drive, print, plot."""
    world = load_world(options.world)
    simulation = make_simulation(TrialSpec(options.world, seed=options.seed), world)
    ticks = list(rollout(simulation, MoveBaseDriver(PlannerParams(max_vel_x=options.max_vel_x))))
    last, clearance = ticks[-1], min(tick.clearance for tick in ticks)
    speed = np.mean([tick.observation.twist.v for tick in ticks])
    print(f"{world.name}: {last.outcome} after {last.elapsed:.2f} s, {len(ticks)} ticks")
    print(f"mean speed {speed:.2f} m/s, closest {clearance:.2f} m, {last.decision.recoveries} recoveries")
    plot(world, ticks, options.plot)


def plot(world: World, ticks: list[Tick], path: Path) -> None:
    """The path on the world's floor."""
    points = np.array([(tick.true_pose.x, tick.true_pose.y) for tick in ticks])
    speeds = np.array([tick.observation.twist.v for tick in ticks])
    path.parent.mkdir(parents=True, exist_ok=True)
    with floor_plan(world) as (figure, axes):
        pieces = np.stack([points[:-1], points[1:]], axis=1)
        line = axes.add_collection(LineCollection(pieces, array=speeds[:-1], cmap="viridis", linewidths=3))
        axes.set_title(f"{world.name}: {ticks[-1].outcome} after {ticks[-1].elapsed:.1f} s")
        figure.colorbar(line, label="speed [m/s]", shrink=0.8)
    figure.savefig(path, dpi=150, bbox_inches="tight")
    print(f"plot: {path}")


if __name__ == "__main__":
    with one_line_errors():
        main(tyro.cli(Options))
