"""SE(2) and angles."""

from __future__ import annotations

import math

import numpy as np

from twin.records import Array, Pose2


def normalize_angle(angle: float) -> float:
    """The equal angle in [-pi, pi] [rad]."""
    return math.remainder(angle, math.tau)


def shortest_angle(start: float, end: float) -> float:
    """The signed turn [rad] from `start` to `end`, in [-pi, pi]."""
    return normalize_angle(end - start)


def compose(a_from_b: Pose2, b_from_c: Pose2) -> Pose2:
    """a_from_c."""
    c, s = math.cos(a_from_b.yaw), math.sin(a_from_b.yaw)
    return Pose2(
        a_from_b.x + c * b_from_c.x - s * b_from_c.y,
        a_from_b.y + s * b_from_c.x + c * b_from_c.y,
        normalize_angle(a_from_b.yaw + b_from_c.yaw),
    )


def invert(a_from_b: Pose2) -> Pose2:
    """b_from_a."""
    c, s = math.cos(a_from_b.yaw), math.sin(a_from_b.yaw)
    return Pose2(-c * a_from_b.x - s * a_from_b.y, s * a_from_b.x - c * a_from_b.y, normalize_angle(-a_from_b.yaw))


def transform_points(a_from_b: Pose2, points: Array) -> Array:
    """Points (n, 2) [m] given in b, expressed in a."""
    c, s = math.cos(a_from_b.yaw), math.sin(a_from_b.yaw)
    rotation = np.array([[c, s], [-s, c]])
    moved: Array = points @ rotation + np.array([a_from_b.x, a_from_b.y])
    return moved


def distance(a: Pose2, b: Pose2) -> float:
    """Euclidean distance of the two positions [m]."""
    return math.hypot(a.x - b.x, a.y - b.y)
