"""Draws `interventions.png`, an A and a B on the training course: `python docs/pictures/interventions.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from courses import OBSTACLES
from matplotlib.patches import Circle, Polygon

from scenarios.collect import Collected, Session
from scenarios.trials import TrialSpec, run_trial
from scenarios.worlds import load_world
from twin.geometry import transform_points
from twin.records import Pose2, Tick
from twin.world import Box, Cylinder

HERE = Path(__file__).parent
SEED = 3
VIEWS = {"A1": (4.8, 9.2, -3.1, 3.1), "B1": (-1.1, 6.6, -3.1, 3.1)}  # x0, x1, y0, y1 [m]
COLOURS = {"A1": "#d62728", "B1": "#1f77b4"}


def main() -> None:
    """Collect, drive the default for the grey line, draw."""
    world = load_world("training")
    before: list[Tick] = []
    run_trial(TrialSpec("training", seed=SEED), world, before.append)
    kept: list[Collected] = []
    Session(TrialSpec("training", seed=SEED), world).run(kept.append)
    chosen = {c.intervention.label: c for c in kept if c.intervention.label in VIEWS}
    figure, axes = plt.subplots(1, len(VIEWS), figsize=(12, 5.6))
    for axis, (label, (x0, x1, y0, y1)) in zip(axes, VIEWS.items(), strict=True):
        for obstacle in world.obstacles:
            colour = OBSTACLES.get(getattr(obstacle, "style", ""), "#7a4a2b")
            if isinstance(obstacle, Box):
                half = np.array([obstacle.length, obstacle.width]) / 2
                corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half
                pose = Pose2(obstacle.x, obstacle.y, obstacle.yaw)
                axis.add_patch(Polygon(transform_points(pose, corners), color=colour))
            elif isinstance(obstacle, Cylinder):
                axis.add_patch(Circle((obstacle.x, obstacle.y), obstacle.radius, color=colour))
        made, ticks = chosen[label].intervention, chosen[label].ticks
        noticed = ticks[0].observation.time + made.metadata.rewound
        grey = np.array([[t.true_pose.x, t.true_pose.y] for t in before if t.observation.time <= noticed])
        axis.plot(grey[:, 0], grey[:, 1], color="#888888", lw=1.5, label="default, until it was noticed")
        drive = np.array([[t.true_pose.x, t.true_pose.y] for t in ticks])
        axis.plot(drive[:, 0], drive[:, 1], color=COLOURS[label], lw=2.5, label="demonstration")
        axis.plot(*drive[0], "o", mfc="none", mec="black", ms=10, label="rewound to")
        began = made.metadata.trouble_pose
        if began is not None:
            axis.plot(began.x + world.start.x, began.y + world.start.y, "kx", ms=9, mew=2, label="trouble began")
        axis.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal", xlabel="x [m]", ylabel="y [m]")
        axis.set_title(f"{label}: {made.metadata.trigger}, rewound {made.metadata.rewound:.1f} s")
        axis.legend(loc="lower left" if label == "B1" else "upper right", fontsize=8)
    figure.tight_layout()
    figure.savefig(HERE / "interventions.png", dpi=80)


if __name__ == "__main__":
    main()
