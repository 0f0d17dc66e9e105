"""Observations for tests of learning: made by hand, and from a short real drive."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from learning.interventions import Intervention, Metadata, Step
from twin.planner.move_base import MoveBaseDriver
from twin.planner.obstacle_layer import GLOBAL_MAP, LOCAL_MAP, MapSpec, empty_map
from twin.planner.params import PlannerParams
from twin.records import Command, Observation, ObstacleMap, Pose2, Scan, Tick, Twist2, frozen_array
from twin.rollout import rollout
from twin.simulation import Simulation
from twin.world import Box, Cylinder, Rules, World

METADATA = Metadata("training", 0, "synthetic", "rotate_recovery", 12.5, Pose2(1.0, 2.0, 0.5), 3.0, {"appli-twin": "0"})

SLALOM = World(
    "slalom",
    (
        Cylinder(1.6, 0.45, 0.1, 0.5),
        Cylinder(2.9, -0.25, 0.15, 0.5),
        Box(4.2, 0.75, 0.4, 0.5, 0.3, 0.6),
        Box(3.0, 1.6, 0.0, 8.0, 0.1, 0.6),
        Box(3.0, -1.5, 0.0, 8.0, 0.1, 0.6),
    ),
    Pose2(0.0, 0.0, 0.3),
    Pose2(8.0, 0.0, 0.0),
    Rules("course", 0.5, 30.0),
)


@lru_cache(maxsize=4)
def slalom_drive(theta: PlannerParams, ticks: int) -> tuple[Tick, ...]:
    """The first ticks of a drive through the slalom."""
    ticking = rollout(Simulation(SLALOM, np.random.default_rng(7)), MoveBaseDriver(theta))
    return tuple(tick for tick, _ in zip(ticking, range(ticks), strict=False))


def random_map(rng: np.random.Generator, spec: MapSpec, origin: tuple[float, float]) -> ObstacleMap:
    """A map with scattered lethal and unknown cells."""
    cells = rng.choice(np.array([0, 254, 255], dtype=np.uint8), (spec.size_y, spec.size_x), p=[0.97, 0.02, 0.01])
    bounds = rng.uniform(-5.0, 5.0, 4).tolist()
    return replace(
        empty_map(spec), cells=frozen_array(cells), origin=origin, touched=tuple(bounds), whole=bool(rng.random() < 0.5)
    )


def random_observation(rng: np.random.Generator, time: float, beams: int = 720) -> Observation:
    """Anything that an observation may be."""
    ranges = np.where(rng.random(beams) < 0.2, np.inf, rng.uniform(0.1, 30.0, beams))
    scan = Scan(frozen_array(ranges), -2.35619, 2.35619, 0.1, 30.0, (0.055, 0.0, 0.2414))
    x, y = rng.normal(0.0, 0.2, 2).tolist()
    small = replace(GLOBAL_MAP, size_x=80, size_y=60)
    return Observation(
        time,
        Pose2(x, y, float(rng.uniform(-4.0, 4.0))),
        Twist2(*rng.normal(size=2).tolist()),
        scan,
        random_map(rng, LOCAL_MAP, (0.05 * round(20.0 * x) - 5.0, 0.05 * round(20.0 * y) - 5.0)),
        random_map(rng, small, small.origin),
        Pose2(*rng.normal(size=3).tolist()),
    )


def random_steps(seed: int, count: int, beams: int = 720) -> list[Step]:
    """`count` unrelated steps, 20 per second."""
    rng = np.random.default_rng(seed)
    return [
        Step(random_observation(rng, 0.05 * k, beams), Command(*rng.normal(size=2).tolist()), bool(rng.random() < 0.7))
        for k in range(count)
    ]


def small_intervention(seed: int = 0, count: int = 3, label: str = "A1") -> Intervention:
    """A valid intervention of random content."""
    return Intervention(label[0], label, random_steps(seed, count, 16), METADATA)  # type: ignore[arg-type]


def same(a: Observation, b: Observation) -> bool:
    """Whether two observations are equal to the last byte."""
    maps = all(
        np.array_equal(m.cells, n.cells) and replace(m, cells=None) == replace(n, cells=None)  # type: ignore[arg-type]
        for m, n in ((a.local_map, b.local_map), (a.global_map, b.global_map))
    )
    scans = a.scan.ranges.tobytes() == b.scan.ranges.tobytes() and replace(a.scan, ranges=None) == replace(  # type: ignore[arg-type]
        b.scan,
        ranges=None,  # type: ignore[arg-type]
    )
    return maps and scans and (a.time, a.pose, a.twist, a.goal) == (b.time, b.pose, b.twist, b.goal)
