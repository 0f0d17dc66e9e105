"""The robot's shape, logged once; its poses follow per tick."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from twin.robot.jackal import ASSETS, COLOURS, LIDAR_MOUNTS, WHEEL_CENTRES, WHEELS

HALF_TURN = (0.0, 0.0, 1.0, 0.0)  # quaternion (x, y, z, w) about z
GLOW = 0.62  # exponent on MuJoCo's colours: Rerun's light is dimmer, and black on a dark floor would not be seen


def draw_robot(stream: Any) -> None:
    """Chassis and wheels: the meshes of twin/assets, as in the simulator."""
    _dress(stream, "world/robot/chassis", "chassis")
    for name, centre in zip(WHEELS, WHEEL_CENTRES, strict=True):
        _dress(stream, f"world/robot/wheels/{name}", "wheel", turned=centre[1] < 0.0)


def draw_lidar(stream: Any, mount: tuple[float, float, float]) -> None:
    """The lidar that sits at `mount` [m, base_link]."""
    places = {name: np.linalg.norm(np.subtract(m.position, mount)) for name, m in LIDAR_MOUNTS.items()}
    _dress(stream, "world/robot/scan/lidar", min(places, key=lambda name: places[name]))


def _dress(stream: Any, entity: str, part: str, turned: bool = False) -> None:
    """The meshes `<part>_<colour>.stl`, which lie in the entity's own frame; `turned` by half a turn about z."""
    for colour, look in COLOURS.items():
        path = ASSETS / f"{part}_{colour}.stl"
        if path.exists():
            rgb = np.rint(255.0 * np.array(look["rgba"][:3]) ** GLOW).astype(np.uint8)
            columns = rr.Asset3D.columns(blob=[path.read_bytes()], media_type=["model/stl"], albedo_factor=rgb[None])
            placed = rr.InstancePoses3D.columns(quaternions=[HALF_TURN]) if turned else []
            stream.send_columns(f"{entity}/{colour}", [], [*columns, *placed])
