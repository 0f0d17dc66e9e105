"""The lidar: rays cast into the compiled world on demand, turned into a `Scan`.

`mj_multiRay` once per scan; 720 rangefinder sensors would cast on every physics step. The robot hides from its own scan
because only `OBSTACLE_GROUP` is visible to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from twin.records import Array, Scan, frozen_array
from twin.robot.handles import RobotHandles
from twin.robot.jackal import OBSTACLE_GROUP


@dataclass(frozen=True, slots=True)
class LidarConfig:
    """The Hokuyo UST-10 as BARN simulates it; every default from hokuyo_ust10.urdf.xacro (jackal_description)."""

    beams: int = 720
    angle: float = 2.35619  # [rad] first beam at -angle (right), last at +angle (left)
    range_min: float = 0.1  # [m] nearer returns are dropped
    range_max: float = 30.0  # [m] farther ones too
    noise: float = 0.001  # [m] standard deviation, Gaussian; 0 for an exact scan


class Lidar:
    """Casts one fan of rays from the robot's lidar; holds the buffers that MuJoCo fills."""

    def __init__(self, model: mujoco.MjModel, handles: RobotHandles, config: LidarConfig | None = None) -> None:
        self.config = config or LidarConfig()
        self.model = model
        self.handles = handles
        bearings = np.linspace(-self.config.angle, self.config.angle, self.config.beams)
        # (n, 3) unit rays in the sensor frame
        self.rays = np.column_stack([np.cos(bearings), np.sin(bearings), np.zeros(self.config.beams)])
        self._directions = np.empty_like(self.rays)  # the same in the world frame, for one scan
        self._distances = np.empty(self.config.beams)
        self.geoms = np.empty(self.config.beams, dtype=np.int32)
        self.visible = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
        self.visible[OBSTACLE_GROUP] = 1

    def cast(self, data: mujoco.MjData) -> Array:
        """(n,) exact distance along each beam [m], inf without a hit; needs the kinematics of the current state."""
        site = self.handles.lidar
        np.matmul(self.rays, data.site_xmat[site].reshape(3, 3).T, out=self._directions)
        mujoco.mj_multiRay(
            self.model,
            data,
            data.site_xpos[site],
            self._directions.ravel(),
            self.visible,
            True,  # static bodies too
            -1,  # exclude no body: the group does that
            self.geoms,
            self._distances,
            None,  # no normals
            self.config.beams,
            self.config.range_max,  # only prunes whole geoms, by their bounding spheres: scan() clips
        )
        return np.where(self._distances < 0, np.inf, self._distances)

    def scan(self, data: mujoco.MjData, rng: np.random.Generator) -> Scan:
        """What the driver publishes: noisy ranges, inf where nothing returns between range_min and range_max."""
        config = self.config
        ranges = self.cast(data) + config.noise * rng.standard_normal(config.beams)
        ranges[(ranges < config.range_min) | (ranges > config.range_max)] = np.inf
        return Scan(
            ranges=frozen_array(ranges),
            angle_min=-config.angle,
            angle_max=config.angle,
            range_min=config.range_min,
            range_max=config.range_max,
            mount=self.handles.mount,
        )
