"""A driver of your own against move_base: `python examples/own_driver.py barn-like/100 --plot out/drivers.png`

A driver is two pure functions: what it remembers at the start, and what it does with an observation and its memory.
"""

import math
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from scenarios import TrialSpec, load_world, one_line_errors, run_trial
from scenarios.report.figures.floor_plan import floor_plan
from scenarios.report.figures.style import BLUE, RED
from twin import Command, Decision, MoveBaseDriver, Observation, PlannerParams, Tick


class FollowTheGap:
    """Through the gap that is nearest to the goal's direction; never plans."""

    speed = 0.8  # [m/s] with room ahead
    half_width, look = 0.32, 1.4  # [m] of the way that must be free: to either side, ahead

    def start(self) -> float:
        """Where it steered last [rad, base_link]."""
        return 0.0

    def decide(self, observation: Observation, memory: float) -> tuple[Decision, float]:
        """Takes the direction of least cost: its angles to the goal and to the last one, and how soon it is blocked."""
        pose, goal, scan = observation.pose, observation.goal, observation.scan
        bearing = math.remainder(math.atan2(goal.y - pose.y, goal.x - pose.x) - pose.yaw, math.tau)
        ways = np.linspace(-2.2, 2.2, 89)
        turned = scan.angles[None, :] - ways[:, None]  # (directions, beams)
        in_way = (np.abs(scan.ranges * np.sin(turned)) < self.half_width) & (np.cos(turned) > 0.0)
        free = np.where(in_way, scan.ranges * np.cos(turned), self.look).clip(0.0, self.look).min(axis=1)
        way = int(np.argmin(np.abs(ways - bearing) + 0.4 * np.abs(ways - memory) + 6.0 * (self.look - free)))
        v = self.speed * max(0.0, math.cos(ways[way])) ** 3 * free[way] / self.look
        return Decision(Command(v, 2.0 * ways[way]), PlannerParams(), state="following"), float(ways[way])


def main(world: Annotated[str, tyro.conf.Positional] = "barn-like/100", plot: Path = Path("out/drivers.png")) -> None:
    """Drive both ways, with the same noise, and plot the paths."""
    place = load_world(world)
    with floor_plan(place) as (figure, axes):
        for name, driver, colour in (("move_base", MoveBaseDriver(), BLUE), ("follow the gap", FollowTheGap(), RED)):
            result = run_trial(TrialSpec(world), place, (ticks := list[Tick]()).append, driver=driver)
            print(f"{name:15s}{result.outcome:10s}{result.time:7.2f} s, closest {result.min_clearance:.2f} m")
            path = np.array([(tick.true_pose.x, tick.true_pose.y) for tick in ticks])
            axes.plot(*path.T, color=colour, linewidth=2.2, label=f"{name}: {result.outcome}, {result.time:.1f} s")
        figure.legend(loc="outside upper center", fontsize=8)
    plot.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(plot, dpi=150, bbox_inches="tight")
    print(f"plot: {plot}")


if __name__ == "__main__":
    with one_line_errors():
        tyro.cli(main)
