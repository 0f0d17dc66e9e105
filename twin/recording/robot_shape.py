"""The robot's shape, logged once; its poses follow per tick."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import rerun as rr

from twin.robot.jackal import CHASSIS_SIZE, WHEEL_RADIUS, WHEEL_WIDTH, WHEELS


def draw_robot(stream: Any) -> None:
    """Chassis and wheels."""
    length, width, height = CHASSIS_SIZE
    chassis = rr.Boxes3D.columns(
        half_sizes=[(length / 2, width / 2, height / 2)],
        centers=[(0.0, 0.0, height / 2)],
        colors=np.array([(230, 180, 40)], np.uint8),
        fill_mode=[rr.components.FillMode.Solid],
    )
    stream.send_columns("world/robot/chassis", [], chassis)
    half = math.sqrt(0.5)
    for name in WHEELS:
        wheel = rr.Cylinders3D.columns(
            lengths=[WHEEL_WIDTH],
            radii=[WHEEL_RADIUS],
            quaternions=[(half, 0.0, 0.0, half)],
            colors=np.array([(40, 40, 44)], np.uint8),
            fill_mode=[rr.components.FillMode.Solid],
        )
        stream.send_columns(f"world/robot/wheels/{name}", [], wheel)
