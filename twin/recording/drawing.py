"""From ticks to the shapes that are drawn: plain arrays, no Rerun.

Frames: what the robot carries is given in base_link, what the planner believes in odom, and odom is placed in the world
by `world_from_odom`, so that scan, costmap and plan line up with where the robot truly is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.geometry import compose, invert, transform_points
from twin.recording.palette import COSTMAP, arc_colours
from twin.records import Array, Bytes, Decision, ObstacleMap, Pose2, Scan, Tick

Floats = NDArray[np.float32]

FLOOR = -0.0635 + 0.012  # [m] just above the floor, seen from base_link (ride height, twin/robot/jackal.py)
ROLLOUT_TIME = 2.0  # [s] how far an arc is drawn; move_base's sim_time on the Jackal
ROLLOUT_POINTS = 9  # points per arc: at most 0.4 rad of turn between two of them
MOST_ARCS = 160  # arcs drawn per tick; B2 tries over a thousand, which nobody can tell apart


@dataclass(frozen=True, slots=True)
class Arcs:
    """Candidate arcs as polylines."""

    points: Floats  # (n, ROLLOUT_POINTS, 3) [m], base_link
    colours: NDArray[np.uint8]  # (n, 3) RGB


NO_ARCS = Arcs(np.zeros((0, ROLLOUT_POINTS, 3), np.float32), np.zeros((0, 3), np.uint8))


def world_from_odom(tick: Tick) -> Pose2:
    """Where the odom frame truly is."""
    return compose(tick.true_pose, invert(tick.observation.pose))


def on_plane(points: Array, height: float) -> Floats:
    """(n, 3) of planar points (n, 2) [m] at one height [m]."""
    return np.column_stack([points[:, :2], np.full(len(points), height)]).astype(np.float32)


def scan_points(scan: Scan) -> Floats:
    """(n, 3) returns [m] in the sensor's frame; beams without a return are left out."""
    hit = np.isfinite(scan.ranges)
    ranges, angles = scan.ranges[hit], scan.angles[hit]
    return np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles), np.zeros(len(ranges))]).astype(np.float32)


def scan_in_world(tick: Tick) -> Array:
    """(n, 2) returns [m] in the world, seen from above."""
    x, y, _ = tick.observation.scan.mount
    world_from_sensor = compose(tick.true_pose, Pose2(x, y, 0.0))
    return transform_points(world_from_sensor, scan_points(tick.observation.scan)[:, :2].astype(np.float64))


def roll_out(velocities: Array) -> Floats:
    """(n, ROLLOUT_POINTS, 3) base_link: unicycle arcs from the robot under constant v [m/s], w [rad/s] (n, 2)."""
    times = np.linspace(0.0, ROLLOUT_TIME, ROLLOUT_POINTS)
    v, half_turn = velocities[:, :1], velocities[:, 1:2] * times / 2.0
    chord = v * times * np.sinc(half_turn / np.pi)  # an arc's chord leaves at half the turn
    points = np.empty((len(velocities), ROLLOUT_POINTS, 3), np.float32)
    points[..., 0], points[..., 1], points[..., 2] = chord * np.cos(half_turn), chord * np.sin(half_turn), FLOOR
    return points


def candidate_arcs(decision: Decision) -> Arcs:
    """The arcs the local planner tried, thinned to MOST_ARCS; the dearest first, so that the cheapest lie on top."""
    candidates = decision.candidates
    if candidates is None or len(candidates) == 0:
        return NO_ARCS
    moving = candidates[np.abs(candidates[:, 0]) > 1e-6]  # a turn on the spot has no length
    thinned = moving[:: math.ceil(len(moving) / MOST_ARCS) or 1]
    colours = arc_colours(thinned[:, 2])
    cost = np.where(thinned[:, 2] < 0.0, np.inf, thinned[:, 2])
    order = np.argsort(-cost, kind="stable")
    return Arcs(roll_out(thinned[order, :2]), colours[order])


def chosen_arc(tick: Tick) -> Floats:
    """(n, 3) base_link: the chosen arc; empty when none was chosen."""
    arc = tick.decision.arc
    if arc is None or len(arc.points) < 2:
        return np.zeros((0, 3), np.float32)
    return on_plane(transform_points(invert(tick.observation.pose), arc.points[:, :2]), FLOOR + 0.01)


def costmap_of(tick: Tick) -> ObstacleMap:
    """The inflated local costmap where the driver explains itself, else the bare obstacle marks."""
    return tick.decision.local_costmap or tick.observation.local_map


def costmap_image(costmap: ObstacleMap) -> Bytes:
    """(ny, nx, 4) RGBA, top row first: images have y down, maps have it up."""
    return COSTMAP.view(np.uint32)[:, 0][costmap.cells[::-1]].view(np.uint8).reshape(*costmap.cells.shape, 4)


def wheels_on_chassis(body_poses: Array) -> Array:
    """(n, 4, 7) wheels in the chassis frame from (n, 5, 7) bodies in the world: position, quaternion (w, x, y, z)."""
    chassis, wheels = body_poses[:, :1], body_poses[:, 1:]
    inverse = chassis[..., 3:] * np.array([1.0, -1.0, -1.0, -1.0])
    offset = wheels[..., :3] - chassis[..., :3]
    vector = np.concatenate([np.zeros((*offset.shape[:-1], 1)), offset], axis=-1)
    turned = _multiply(_multiply(inverse, vector), chassis[..., 3:])
    return np.concatenate([turned[..., 1:], _multiply(inverse, wheels[..., 3:])], axis=-1)


def _multiply(a: Array, b: Array) -> Array:
    """Hamilton product of quaternions (..., 4), scalar first."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )
