"""Random calls of the local planner, with more ties, borders and odd settings than a robot ever meets."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from twin.planner.inflation import Costmap, InflationParams, inflate
from twin.planner.params import PlannerParams
from twin.planner.trajectory import LocalPlannerSettings, PlannerFlags
from twin.records import Array, Pose2, Twist2

RESOLUTION = 0.05  # [m]


@dataclass(frozen=True)
class Call:
    """The arguments of one find_best_path."""

    costmap: Costmap
    pose: Pose2
    velocity: Twist2
    plan: Array
    theta: PlannerParams
    settings: LocalPlannerSettings
    flags: PlannerFlags


def random_costmap(rng: np.random.Generator) -> Costmap:
    """A map of any shape with posts, walls and perhaps unknown patches, inflated."""
    ny, nx = rng.integers(30, 121, 2)
    cells = np.zeros((ny, nx), dtype=np.uint8)
    for _ in range(rng.integers(0, 12)):
        y, x = rng.integers(0, ny), rng.integers(0, nx)
        cells[y : y + rng.integers(1, 4), x : x + rng.integers(1, 4)] = 254
    if rng.random() < 0.5:  # a wall with a gap
        y, gap = rng.integers(0, ny), rng.integers(0, nx)
        cells[y, :] = 254
        cells[y, max(0, gap - 10) : gap + 10] = 0
    if rng.random() < 0.2:
        y, x = rng.integers(0, ny), rng.integers(0, nx)
        cells[y : y + 15, x : x + 15] = 255
    inflation = InflationParams(float(rng.choice([0.0, 0.02, 0.24, 0.3, 0.5])))
    cells = inflate(cells, (0, 0, int(nx), int(ny)), RESOLUTION, inflation)
    origin = (float(rng.integers(-100, 100)) * RESOLUTION, float(rng.integers(-100, 100)) * RESOLUTION)
    return Costmap(cells, origin, RESOLUTION, inflation, (0.0, 0.0, 0.0, 0.0), None)


def random_pose(rng: np.random.Generator, costmap: Costmap) -> Pose2:
    """Mostly near the middle of the map; sometimes exactly on a cell border, along an axis, near or off the edge."""
    ny, nx = costmap.cells.shape
    spread = 0.1 if rng.random() < 0.8 else 0.55
    x = (0.5 + rng.uniform(-spread, spread)) * nx
    y = (0.5 + rng.uniform(-spread, spread)) * ny
    yaw = rng.uniform(-math.pi, math.pi)
    if rng.random() < 0.2:
        x, y = round(x), round(y)
    if rng.random() < 0.2:
        yaw = rng.integers(-2, 3) * math.pi / 2
    return Pose2(float(costmap.origin[0] + x * RESOLUTION), float(costmap.origin[1] + y * RESOLUTION), float(yaw))


def random_plan(rng: np.random.Generator, costmap: Costmap, pose: Pose2) -> Array:
    """A walk from near the robot, fine or coarse; sometimes it begins off the map or has one point."""
    count = int(rng.choice([1, 2, 10, 80, 200], p=[0.05, 0.1, 0.15, 0.35, 0.35]))
    step = float(rng.choice([0.025, 0.05, 0.3]))
    headings = rng.uniform(-math.pi, math.pi) + np.cumsum(rng.normal(0.0, 0.1, count))
    moves = step * np.stack([np.cos(headings), np.sin(headings)], axis=1)
    begin = np.array([pose.x, pose.y]) + rng.normal(0.0, 0.1 if rng.random() < 0.9 else 4.0, 2)
    plan: Array = begin + np.cumsum(moves, axis=0)
    return plan


def random_call(seed: int) -> Call:
    """Call number `seed`."""
    rng = np.random.default_rng([7, seed])
    costmap = random_costmap(rng)
    pose = random_pose(rng, costmap)
    top, turn = float(rng.uniform(0.0, 2.0)), float(rng.uniform(0.1, 3.14))
    scales = rng.choice([0.0, 0.25, 0.5, 1.0], 3) if rng.random() < 0.4 else rng.uniform(0.0, 2.0, 3)
    theta = PlannerParams(
        max_vel_x=top,
        max_vel_theta=turn,
        vx_samples=int(rng.integers(1, 20)),
        vtheta_samples=int(rng.integers(1, 30)),
        occdist_scale=float(scales[0]),
        pdist_scale=float(scales[1]),
        gdist_scale=float(scales[2]),
    )
    settings = LocalPlannerSettings(min_vel_theta=-turn)
    if rng.random() < 0.3:
        settings = replace(
            settings,
            acc_lim_x=float(rng.uniform(0.3, 12.0)),
            acc_lim_theta=float(rng.uniform(0.5, 25.0)),
            min_vel_theta=float(rng.uniform(-3.0, 1.0)),
            sim_time=float(rng.uniform(0.3, 3.0)),
            sim_granularity=float(rng.uniform(0.01, 0.3)),
            angular_sim_granularity=float(rng.uniform(0.01, 0.5)),
            meter_scoring_factor=0.05,
        )
    v, w = rng.uniform(-0.6, 2.2), rng.uniform(-4.0, 4.0)
    velocity = Twist2(float(v), float(w)) if rng.random() < 0.7 else Twist2(0.0, 0.0)
    flags = PlannerFlags(*(bool(b) for b in rng.random(5) < 0.2), *rng.normal(0.0, 1.0, 5).tolist())
    return Call(costmap, pose, velocity, random_plan(rng, costmap, pose), theta, settings, flags)
