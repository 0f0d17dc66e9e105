"""Fit the planner's parameters to one better drive (Eq. 1): `python examples/fit_intervention.py --plot out/fit.png`

In the course `corridor` the default planner hesitates at the mouth for more than a minute. Somebody drives through by
hand; with what Eq. 1 makes of that the planner goes through like them.
"""

import math
from pathlib import Path

import tyro

from learning import FitSettings, Intervention, Metadata, Step
from learning.fit import fit
from scenarios import TrialSpec, load_world, make_simulation, one_line_errors, run_trial
from scenarios.report.figures.style import BLUE, GREY, INK, drawing
from twin import Command, Loop, MoveBaseDriver, PlannerParams, Pose2


def by_hand(pose: Pose2, speed: float) -> Command:
    """What somebody does at the keyboard: along the centre line y = 0, always towards a point 1 m ahead."""
    return Command(speed, 2.0 * (math.atan2(-pose.y, 1.0) - pose.yaw))


def main(speed: float = 0.8, evaluations: int = 200, steps: int = 60, plot: Path = Path("out/fit.png")) -> None:
    """Demonstrate at `speed` [m/s], fit, drive before and after. `appli train` takes 8000 evaluations, 300 steps."""
    world = load_world("corridor")
    loop = Loop(make_simulation(TrialSpec("corridor"), world), MoveBaseDriver())
    ticks = [loop.step(by_hand(world.start, speed))]
    while ticks[-1].outcome is None:
        ticks.append(loop.step(by_hand(loop.simulation.true_pose, speed)))
    shown = [Step(tick.observation, tick.override) for tick in ticks]
    intervention = Intervention("B", "B1", shown, Metadata("corridor", seed=0, source="teleop"))
    result = fit(intervention, FitSettings(max_evaluations=evaluations, max_steps=steps, restarts=0))
    print(f"{len(shown)} steps shown; error of Eq. 1: default {result.default_loss:.1f}, fitted {result.loss:.1f}")
    for name, theta in (("default", PlannerParams()), ("fitted", result.theta)):
        drive = run_trial(TrialSpec("corridor", params=theta), world)
        values = ", ".join(f"{key} {value:.2f}" for key, value in theta.as_dict().items())
        print(f"{name:8s}{drive.outcome} after {drive.time:.2f} s: {values}")
    with drawing(7.0, 3.2) as (figure, axes):
        time = [tick.observation.time for tick in ticks]
        curves = {"the planner with its defaults": (result.default_actions, GREY), "fitted": (result.actions, BLUE)}
        for label, (actions, colour) in ({"shown": (result.demonstrated, INK)} | curves).items():
            axes.plot(time, actions[:, 0], color=colour, label=label, linewidth=1.6)
        axes.set(xlabel="time [s]", ylabel="v [m/s]", title="What is done with the same observations")
        figure.legend(loc="outside upper center", ncols=3)
    plot.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(plot, dpi=150, bbox_inches="tight")
    print(f"plot: {plot}")


if __name__ == "__main__":
    with one_line_errors():
        tyro.cli(main)
