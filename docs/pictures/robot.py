"""Takes the pictures `robot.png` and `robot_course.png`: `MUJOCO_GL=egl python docs/pictures/robot.py`."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from twin.arena import compile_world
from twin.records import Pose2
from twin.robot.handles import RobotHandles
from twin.world import Box, Cylinder, Rules, World

HERE = Path(__file__).parent
SIZE = (1280, 800)  # [px]
SUPERSAMPLED = 2

RULES = Rules("course", goal_tolerance=0.35, time_limit=50.0)
STAGE = World(
    "stage",
    (
        *(Cylinder(-1.75, -1.75 - 0.15 * k, 0.075, 0.5) for k in range(6)),
        *(Cylinder(-1.9 - 0.15 * k, 0.25 + 0.04 * k, 0.075, 0.5) for k in range(7)),
        *(Cylinder(-2.05 - 0.15 * k, 0.10 + 0.04 * k, 0.075, 0.5) for k in range(4)),
        Box(-1.55, -0.62, 0.3, 0.42, 0.34, 0.36, style="cardboard"),
        Box(-2.1, -0.95, -0.2, 0.55, 0.40, 0.48, style="cardboard"),
        Box(-1.57, -0.60, 0.55, 0.30, 0.26, 0.20, bottom=0.36, style="cardboard"),
        Box(-3.6, 0.0, 0.0, 0.15, 12.0, 1.1, style="wall"),
    ),
    Pose2(0.0, 0.0, 0.0),
    Pose2(5.0, 0.0, 0.0),
    RULES,
)


def course() -> World:
    """A BARN-like field: two side walls of cylinders, and clumps between them."""
    rng = np.random.default_rng(11)
    walls = [Cylinder(0.15 * k, y, 0.075, 0.5) for k in range(-6, 40) for y in (-2.2, 2.2)]
    clumps = []
    for x, y in ((1.6, 1.1), (2.2, -1.2), (3.0, 0.55), (3.9, -0.5), (4.6, 1.3), (5.2, -1.5)):
        cells = {(int(i), int(j)) for i, j in np.round(rng.normal(0, 1.6, (16, 2)))}
        clumps += [Cylinder(x + 0.15 * i, y + 0.15 * j, 0.075, 0.5) for i, j in cells if abs(y + 0.15 * j) < 2.05]
    return World("course", (*walls, *clumps), Pose2(0.0, 0.1, 0.15), Pose2(6.2, 0.0, 0.0), RULES)


def take(
    world: World,
    name: str,
    look: tuple[float, float, float],
    azimuth: float,
    elevation: float,
    away: float,
    shadow: float,
) -> None:
    """Render a world from `away` metres (angles in degrees) with sharp shadows over `shadow` metres, and save it."""
    model = compile_world(world)
    robot, data = RobotHandles.resolve(model), mujoco.MjData(model)
    data.qpos[[model.jnt_qposadr[model.body_jntadr[body]] for body in robot.bodies[1:]]] = (0.2, 0.5, 0.9, 0.3)
    mujoco.mj_forward(model, data)
    width, height = SIZE[0] * SUPERSAMPLED, SIZE[1] * SUPERSAMPLED
    view = model.vis.global_
    view.offwidth, view.offheight, view.fovy = width, height, 36
    model.vis.quality.shadowsize = 8192
    model.vis.map.shadowclip = shadow / model.stat.extent
    camera = mujoco.MjvCamera()
    camera.lookat[:] = look
    camera.azimuth, camera.elevation, camera.distance = azimuth, elevation, away
    with mujoco.Renderer(model, height, width) as renderer:
        renderer.update_scene(data, camera)
        Image.fromarray(renderer.render()).resize(SIZE, Image.Resampling.LANCZOS).save(HERE / name, optimize=True)


if __name__ == "__main__":
    take(STAGE, "robot.png", look=(-0.05, 0.0, 0.15), azimuth=208, elevation=-16, away=1.22, shadow=4.0)
    take(course(), "robot_course.png", look=(2.2, 0.0, 0.0), azimuth=22, elevation=-30, away=6.2, shadow=12.0)
