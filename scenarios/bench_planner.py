"""How long one `find_best_path` takes: twelve corridor scenes, four sizes of the search, medians in ms.

The four cases are those that were timed with ROS's C++ on one core (`CPP_MS`), with 200 x 200 cells and both map grids
included.
"""

from __future__ import annotations

import math
import statistics
import time
from dataclasses import dataclass

import numpy as np

from twin.planner.inflation import Costmap, update_costmap
from twin.planner.obstacle_layer import LOCAL_MAP
from twin.planner.params import PlannerParams
from twin.planner.trajectory import LocalPlannerSettings, PlannerFlags, find_best_path
from twin.records import Array, ObstacleMap, Pose2, Twist2, frozen_array

SIZE, RESOLUTION = 200, 0.05  # cells per side, [m]
SCENES = 12
WALL = 0.1  # [m] thickness
SEEN = 2.6  # [m] ahead, in every other scene (obstacle_range is 2.5)
RADIUS_OF_PASSAGE = 0.36  # [m] round the plan that obstacles leave free

CPP_MS = {"default": 1.5, "default_19x59": 10.0, "b2": 11.5, "fast_19x59": 28.0}
"""ROS's own findBestPath on similar scenes [ms] (shared/golden/README.md; AMD EPYC, one core)."""


@dataclass(frozen=True, slots=True)
class Case:
    """One row of the benchmark."""

    theta: PlannerParams
    v: float  # [m/s] current speed


CASES = {
    "default": Case(PlannerParams(), 0.5),
    "default_19x59": Case(PlannerParams(vx_samples=19, vtheta_samples=59), 0.5),
    "b2": Case(
        PlannerParams(
            max_vel_x=0.72,
            max_vel_theta=0.73,
            vx_samples=19,
            vtheta_samples=59,
            occdist_scale=0.62,
            pdist_scale=1.0,
            gdist_scale=0.32,
            inflation_radius=0.24,
        ),
        0.72,
    ),
    "fast_19x59": Case(PlannerParams(max_vel_x=1.9, max_vel_theta=3.14, vx_samples=19, vtheta_samples=59), 1.5),
}


@dataclass(frozen=True, slots=True)
class Scene:
    """A robot in a winding corridor with things standing along its walls."""

    costmap: Costmap
    pose: Pose2  # map frame
    w: float  # [rad/s] current rate
    plan: Array  # (n, 2) [m]


def corridor_scene(index: int, radius: float) -> Scene:
    """Scene number `index`: corridor of 1.2 to 2 m, turned by any angle, inflated by `radius` [m]."""
    rng = np.random.default_rng([2026, index])
    width = rng.uniform(1.2, 2.0)
    bend, wave, phase = rng.uniform(0.0, 0.4), rng.uniform(3.0, 6.0), rng.uniform(0.0, math.tau)
    turn = rng.uniform(-math.pi, math.pi)
    side = SIZE * RESOLUTION
    robot = np.array([side / 2, side / 2]) + rng.uniform(0.0, RESOLUTION, 2)

    def centre(along: Array | float) -> Array:
        """Lateral position of the corridor's middle [m]; 0 at the robot."""
        return np.asarray(bend * (np.sin(along * math.tau / wave + phase) - math.sin(phase)))

    ys, xs = (np.mgrid[0:SIZE, 0:SIZE] + 0.5) * RESOLUTION
    along = math.cos(turn) * (xs - robot[0]) + math.sin(turn) * (ys - robot[1])
    across = -math.sin(turn) * (xs - robot[0]) + math.cos(turn) * (ys - robot[1])
    beside = np.abs(across - centre(along))
    lethal = (beside >= width / 2) & (beside < width / 2 + WALL)
    if index % 2:  # what lies further ahead has not been seen yet: the robot is new here
        lethal &= along < SEEN
    for _ in range(8):  # posts along the walls
        a, b = rng.uniform(-4.0, 4.5), rng.choice([-1.0, 1.0]) * rng.uniform(width / 4, width / 2)
        post = rng.uniform(0.06, 0.15)
        if abs(b) - post > RADIUS_OF_PASSAGE and abs(a) > 0.6:
            lethal |= np.hypot(along - a, across - centre(a) - b) < post

    s = np.arange(0.0, 5.2, RESOLUTION / 2)
    t = centre(s)
    plan = np.stack(
        [robot[0] + math.cos(turn) * s - math.sin(turn) * t, robot[1] + math.sin(turn) * s + math.cos(turn) * t], axis=1
    )
    slope = bend * math.tau / wave * math.cos(phase)
    pose = Pose2(float(robot[0]), float(robot[1]), turn + math.atan(slope) + rng.uniform(-0.2, 0.2))
    layer = ObstacleMap(
        frozen_array(np.where(lethal, 254, 0).astype(np.uint8)), (0.0, 0.0), RESOLUTION, (0.0, 0.0, side, side), True
    )
    return Scene(update_costmap(None, layer, LOCAL_MAP, radius), pose, rng.uniform(-0.3, 0.3), frozen_array(plan))


def find_best_path_times(repeats: int = 15, explain: bool = False) -> dict[str, float]:
    """ms per call for each case of `CASES`: the median over the scenes of the fastest of `repeats` calls.

    The machine code is built before the clock starts. `explain` times the search that scores every candidate.
    """
    return {name: statistics.median(scene_times(case, repeats, explain)) for name, case in CASES.items()}


def scene_times(case: Case, repeats: int = 15, explain: bool = False) -> list[float]:
    """ms per call of one case in each scene: the fastest of `repeats`, so that other processes count for little."""
    settings, flags = LocalPlannerSettings(min_vel_theta=-case.theta.max_vel_theta), PlannerFlags()
    times = []
    for index in range(SCENES):
        scene = corridor_scene(index, case.theta.inflation_radius)
        twist = Twist2(case.v, scene.w)
        best = math.inf
        for _ in range(repeats + 1):  # one more, to compile and to fill the caches
            start = time.perf_counter()
            find_best_path(scene.costmap, scene.pose, twist, scene.plan, case.theta, settings, flags, explain)
            best = min(best, time.perf_counter() - start)
        times.append(best * 1000.0)
    return times
