"""True distance between the robot's outline and the obstacles: a judgement of the referee, not a sensor."""

from __future__ import annotations

import math

import numpy as np

from twin.compiled import compiled
from twin.free_space import ROBOT_TOP, mesh_points
from twin.records import Array, Pose2
from twin.world import Box, Cylinder, Mesh, World

HALF_LENGTH = 0.131 + 0.098  # [m] wheel centre plus wheel radius: the wheels lead the chassis (jackal.urdf.xacro)
HALF_WIDTH = 0.187795 + 0.020  # [m] wheel centre plus half a wheel (jackal.urdf.xacro)
MESH_SPACING = 0.02  # [m] a mesh is judged by points of its surface at this spacing


class ClearanceGauge:
    """Measures the clearance in one world. Exact for cylinders and boxes; within 0.02 m for meshes."""

    def __init__(self, world: World) -> None:
        cylinders = [(c.x, c.y, c.radius) for c in world.obstacles if isinstance(c, Cylinder)]
        boxes = [
            (b.x, b.y, math.cos(b.yaw), math.sin(b.yaw), b.length / 2, b.width / 2)
            for b in world.obstacles
            if isinstance(b, Box) and b.bottom < ROBOT_TOP
        ]
        meshes = [mesh_points(m, MESH_SPACING) for m in world.obstacles if isinstance(m, Mesh)]
        points = np.concatenate(meshes) if meshes else np.empty((0, 2))
        discs = np.array(cylinders, dtype=np.float64).reshape(-1, 3)
        self._discs = np.concatenate([discs, np.c_[points, np.zeros(len(points))]])
        self._boxes = np.array(boxes, dtype=np.float64).reshape(-1, 6)

    def __call__(self, pose: Pose2) -> float:
        """Clearance [m] of the robot at `pose` (world); 0 when touching, inf in an empty world."""
        return float(_clearance(self._discs, self._boxes, pose.x, pose.y, math.cos(pose.yaw), math.sin(pose.yaw)))


@compiled
def _clearance(discs: Array, boxes: Array, x: float, y: float, c: float, s: float) -> float:
    best = np.inf
    for i in range(discs.shape[0]):
        rx, ry = discs[i, 0] - x, discs[i, 1] - y
        dx = max(abs(c * rx + s * ry) - HALF_LENGTH, 0.0)
        dy = max(abs(-s * rx + c * ry) - HALF_WIDTH, 0.0)
        best = min(best, math.sqrt(dx * dx + dy * dy) - discs[i, 2])
    for i in range(boxes.shape[0]):
        rx, ry = boxes[i, 0] - x, boxes[i, 1] - y
        # the box in the robot's frame, and the robot in the box's frame: the smaller corner distance is exact
        bc, bs = c * boxes[i, 2] + s * boxes[i, 3], c * boxes[i, 3] - s * boxes[i, 2]
        px, py = c * rx + s * ry, -s * rx + c * ry
        qx, qy = -(bc * px + bs * py), -(-bs * px + bc * py)
        best = min(best, _rectangles(px, py, bc, bs, boxes[i, 4], boxes[i, 5], HALF_LENGTH, HALF_WIDTH, qx, qy))
    return max(best, 0.0)


@compiled
def _rectangles(
    px: float, py: float, c: float, s: float, l1: float, w1: float, l0: float, w0: float, qx: float, qy: float
) -> float:
    """Distance of rectangle 0 (at the origin) and rectangle 1 (at p, turned by atan2(s, c)); q = origin seen from 1."""
    overlap = (
        abs(px) <= l0 + abs(c) * l1 + abs(s) * w1
        and abs(py) <= w0 + abs(s) * l1 + abs(c) * w1
        and abs(qx) <= l1 + abs(c) * l0 + abs(s) * w0
        and abs(qy) <= w1 + abs(s) * l0 + abs(c) * w0
    )
    if overlap:
        return 0.0
    best = np.inf
    for i in range(4):
        a, b = (1.0 if i < 2 else -1.0), (1.0 if i % 2 else -1.0)
        x1, y1 = px + c * a * l1 - s * b * w1, py + s * a * l1 + c * b * w1
        best = min(best, math.hypot(max(abs(x1) - l0, 0.0), max(abs(y1) - w0, 0.0)))
        x0, y0 = qx + c * a * l0 + s * b * w0, qy - s * a * l0 + c * b * w0
        best = min(best, math.hypot(max(abs(x0) - l1, 0.0), max(abs(y0) - w1, 0.0)))
    return best
