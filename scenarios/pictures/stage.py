"""A world to be photographed: the compiled model, and a camera. No physics runs here."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from twin.arena import compile_world
from twin.records import Array, Pose2
from twin.robot.handles import RobotHandles
from twin.world import World

NEAR = 0.05  # [m] in front of the camera nothing is drawn
SAMPLES = 2  # rendered pixels per pixel of the picture, along each side


@dataclass(frozen=True, slots=True)
class View:
    """Where the camera looks from. With `height` the view is parallel: no wall hides more than its own depth."""

    at: tuple[float, float, float]  # world [m] in the middle of the picture
    azimuth: float  # [deg] direction of view; 90 = along +y, so that +x points right
    elevation: float  # [deg]; -90 = straight down
    away: float = 30.0  # [m] from the camera to `at`
    height: float | None = None  # [m] of world from the picture's lower to its upper edge
    angle: float = 36.0  # [deg] vertical field of view of a view that is not parallel

    def pixels(self, points: Array, size: tuple[int, int]) -> Array:
        """(n, 2) where points (n, 3) [m] of the world are in a picture, y down; nan behind the camera."""
        a, e = math.radians(self.azimuth), math.radians(self.elevation)
        forward = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
        right = np.array([math.sin(a), -math.cos(a), 0.0])
        offsets = np.asarray(points, dtype=np.float64) - np.array(self.at)
        if self.height is None:
            depth = offsets @ forward + self.away
            focal = size[1] / 2 / math.tan(math.radians(self.angle) / 2)
            scale = np.divide(focal, depth, out=np.full(len(depth), np.nan), where=depth > NEAR)
        else:
            scale = np.full(len(offsets), size[1] / self.height)
        across, up = offsets @ right * scale, offsets @ np.cross(right, forward) * scale
        return np.column_stack([size[0] / 2 + across, size[1] / 2 - up])


class Stage:
    """One world with its robot, photographed as often as needed. Close it, or use it in a `with`."""

    def __init__(self, world: World, size: tuple[int, int], shadows: float = 12.0, fine: int = 8192) -> None:
        """Pictures have `size` [px]; shadows fall within `shadows` metres of the robot, on a map of `fine` squared."""
        self.size = size
        self._model = compile_world(world)
        self._data = mujoco.MjData(self._model)
        self._robot = RobotHandles.resolve(self._model)
        width, height = size[0] * SAMPLES, size[1] * SAMPLES
        view = self._model.vis.global_
        view.offwidth, view.offheight = width, height
        self._model.vis.quality.shadowsize = fine
        self._model.vis.map.shadowclip = shadows / self._model.stat.extent
        self._renderer = mujoco.Renderer(self._model, height, width)

    def place(self, pose: Pose2, wheels: Sequence[float] = (0.2, 0.5, 0.9, 0.3)) -> None:
        """Put the robot at a pose, with its wheels turned by some angles [rad]: fl, fr, rl, rr."""
        start, qpos = self._robot.free_qpos, self._data.qpos
        qpos[start : start + 2] = pose.x, pose.y
        qpos[start + 3 : start + 7] = math.cos(pose.yaw / 2), 0.0, 0.0, math.sin(pose.yaw / 2)
        joints = self._model.body_jntadr[self._robot.bodies[1:]]
        qpos[self._model.jnt_qposadr[joints]] = wheels

    def picture(self, view: View) -> Image.Image:
        """What the camera sees."""
        self._look(view)
        return Image.fromarray(self._renderer.render()).resize(self.size, Image.Resampling.LANCZOS)

    def floor(self, view: View) -> Image.Image:
        """The same view as a mask (mode L): white where the bare floor, or the goal on it, is seen."""
        self._renderer.enable_segmentation_rendering()
        try:
            self._look(view)
            seen = self._renderer.render()[..., 0]
        finally:
            self._renderer.disable_segmentation_rendering()
        flat = np.isin(seen, [self._robot.floor, self._model.geom("goal").id])
        mask: NDArray[np.uint8] = np.where(flat, 255, 0).astype(np.uint8)
        return Image.fromarray(mask).resize(self.size, Image.Resampling.LANCZOS)

    def hide_goal(self) -> None:
        """Leave the goal's disc out: in the shade it flickers from picture to picture."""
        self._model.geom("goal").rgba[3] = 0.0

    def close(self) -> None:
        """Give the graphics back."""
        self._renderer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _look(self, view: View) -> None:
        mujoco.mj_forward(self._model, self._data)
        settings = self._model.vis.global_
        settings.orthographic = int(view.height is not None)
        settings.fovy = view.angle if view.height is None else view.height
        camera = mujoco.MjvCamera()
        camera.lookat[:] = view.at
        camera.azimuth, camera.elevation, camera.distance = view.azimuth, view.elevation, view.away
        self._renderer.update_scene(self._data, camera)
