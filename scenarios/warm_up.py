"""Loads (or compiles) every numba kernel of the closed loop by running a few ticks."""

from __future__ import annotations

from itertools import islice

import numpy as np

from twin.planner.move_base import MoveBase, MoveBaseDriver
from twin.records import Pose2
from twin.rollout import rollout
from twin.simulation import Simulation
from twin.world import Box, Cylinder, Rules, World


def warm_up() -> None:
    """Two ticks in a tiny world, plain and explained."""
    obstacles = (Cylinder(2.0, 1.0, 0.1, 0.5), Box(2.0, -1.0, 0.3, 0.5, 0.5, 0.5))
    world = World("warm-up", obstacles, Pose2(0, 0, 0), Pose2(4, 0, 0), Rules("course", 0.5, 10.0))
    for explain in (False, True):
        driver = MoveBaseDriver(base=MoveBase(explain=explain))
        for _ in islice(rollout(Simulation(world, np.random.default_rng(0)), driver), 2):
            pass
