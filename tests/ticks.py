"""Ticks without a simulator: a robot on a curve between cylinders, under changing contexts and states."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from twin.geometry import compose, invert, transform_points
from twin.planner.params import PlannerParams
from twin.records import (
    DEFAULT_CONTEXT,
    Arc,
    Array,
    Command,
    Contact,
    Decision,
    Observation,
    ObstacleMap,
    Outcome,
    Pose2,
    Scan,
    Tick,
    Twist2,
)
from twin.world import Box, Cylinder, Mesh, Rules, Segment, World

PERIOD = 0.05  # [s]
MOUNT = (0.055, 0.0, 0.2414)  # [m] base_link
LAST_CONTEXT = (("A1", 0.25), ("B2", 0.5), (DEFAULT_CONTEXT, 0.75))  # each until this share of the drive
TENT = Mesh(
    np.array([(2.0, -3.0, 0.0), (3.0, -3.0, 0.0), (3.0, -2.0, 0.0), (2.0, -2.0, 0.0), (2.5, -2.5, 1.0)]),
    np.array([(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)], dtype=np.int32),
)
WORLD = World(
    "posts",
    (
        *(Cylinder(1.5 * k, 1.6 * (-1) ** k, 0.2, 0.8) for k in range(1, 6)),
        Box(4.0, 3.0, 0.0, 10.0, 0.1, 1.0, style="wall"),
        Box(4.0, -3.5, 0.3, 0.6, 0.4, 0.5, style="cardboard"),
        TENT,
    ),
    Pose2(0.0, 0.0, 0.0),
    Pose2(9.0, 0.0, 0.0),
    Rules("course", 0.5, 60.0, finish_line_y=8.0),
    (Segment("A1", ((0.0, -2.0), (3.0, -2.0), (3.0, 2.0), (0.0, 2.0))),),
    note="a few posts",
)


def true_pose(time: float) -> Pose2:
    """World; a gentle slalom at about 0.4 m/s."""
    return Pose2(0.4 * time, 0.5 * math.sin(0.5 * time), math.atan(0.625 * math.cos(0.5 * time)))


def cast(pose: Pose2) -> Scan:
    """A scan of the world's cylinders, exact; everything else is air."""
    angles = np.linspace(-2.35619, 2.35619, 720)
    sensor = compose(pose, Pose2(MOUNT[0], MOUNT[1], 0.0))
    rays = np.column_stack([np.cos(angles + sensor.yaw), np.sin(angles + sensor.yaw)])
    ranges = np.full(720, np.inf)
    for c in (o for o in WORLD.obstacles if isinstance(o, Cylinder)):
        ahead = rays @ np.array([c.x - sensor.x, c.y - sensor.y])
        aside = math.hypot(c.x - sensor.x, c.y - sensor.y) ** 2 - ahead**2
        hit = (ahead > 0.0) & (aside < c.radius**2)
        ranges[hit] = np.minimum(ranges[hit], (ahead - np.sqrt(np.maximum(c.radius**2 - aside, 0.0)))[hit])
    return Scan(ranges, -2.35619, 2.35619, 0.1, 30.0, MOUNT)


def bodies(pose: Pose2) -> Array:
    """(5, 7) chassis and wheels, upright, the wheels turned by the way they rolled."""
    quaternion = (math.cos(pose.yaw / 2), 0.0, 0.0, math.sin(pose.yaw / 2))
    centres = [(0.0, 0.0)] + [(x, y) for x in (0.131, -0.131) for y in (0.188, -0.188)]
    flat = transform_points(pose, np.array(centres))
    heights = [0.0635] + [0.098] * 4
    return np.array([(x, y, z, *quaternion) for (x, y), z in zip(flat, heights, strict=True)])


def local_map(pose: Pose2, cost: int) -> ObstacleMap:
    """A 10 x 10 m map with one block of `cost` straight ahead of odom's origin."""
    cells = np.zeros((200, 200), dtype=np.uint8)
    cells[90:110, 140:150] = cost
    return ObstacleMap(cells, (pose.x - 5.0, pose.y - 5.0), 0.05, (0.0, 0.0, 0.0, 0.0))


def drive(count: int, seed: int = 0) -> Iterator[Tick]:
    """`count` ticks; the last but one recovers, the last touches something and ends the trial."""
    rng = np.random.default_rng(seed)
    drift = Pose2(0.1, -0.05, 0.02)  # world_from_odom
    theta = PlannerParams()
    for k in range(count):
        time, share = k * PERIOD, k / count
        truth = true_pose(time)
        pose = compose(invert(drift), truth)
        scan = cast(truth)
        context = next((name for name, until in LAST_CONTEXT if share < until), "D1")
        v, w = 0.4, 0.3 * math.sin(time)
        ahead = np.array([(0.1 * i, 0.0) for i in range(10)])
        arc = Arc(v, w, 12.5 + share, 3.0, 40.0 - k, 0.0, np.c_[transform_points(pose, ahead), np.full(10, pose.yaw)])
        velocities = np.array([(a, b) for a in np.linspace(0.1, 0.5, 6) for b in np.linspace(-1.57, 1.57, 20)])
        costs = rng.uniform(-5.0, 60.0, len(velocities))
        recovering = k == count - 2
        decision = Decision(
            command=None if recovering else Command(v, w),
            theta=PlannerParams(max_vel_x=0.5 + 0.25 * share) if context == "B2" else theta,
            context=context,
            confidence=0.5 + 0.4 * math.sin(time),
            arc=None if recovering else arc,
            candidates=np.c_[velocities, costs],
            rejected={"obstacle": int((costs < 0).sum())},
            state="rotate_recovery" if recovering else "controlling",
            recoveries=int(recovering or k == count - 1),
            global_path=np.column_stack([np.linspace(pose.x, 9.0, 180), np.linspace(pose.y, 0.0, 180)]),
            local_costmap=local_map(pose, 253),
        )
        last, marks = k == count - 1, local_map(pose, 254)
        yield Tick(
            index=k,
            observation=Observation(time, pose, Twist2(v, w), scan, marks, marks, WORLD.goal),
            decision=decision,
            true_pose=truth,
            body_poses=bodies(truth),
            clearance=1.0 + 0.5 * math.cos(time),
            contact=Contact(time, truth.x, truth.y, "cylinder_0001") if last else None,
            elapsed=time + PERIOD,
            outcome=Outcome.COLLIDED if last else None,
            override=Command(0.2, -0.5) if 0.5 < share < 0.6 else None,
        )
