"""The courses with their places, a BARN-like world, and the robot."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import distance_transform_edt

from scenarios.pictures.ink import colour_of, label, tinted
from scenarios.pictures.stage import Stage, View
from scenarios.pictures.views import goal_rim, on_floor, whole
from scenarios.worlds import load_world
from twin.records import Array, Pose2
from twin.world import Box, Cylinder, Rules, World

WIDTH = 1280  # [px]
BARN = "barn-like/150"
START, GOAL = (60, 66, 78), (38, 130, 70)  # colours of the labels

STUDIO = World(
    "studio",
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
    Rules("course", goal_tolerance=0.35, time_limit=50.0),
)


def robot() -> Image.Image:
    """The Jackal among what it meets."""
    with Stage(STUDIO, (1280, 800), shadows=4.0) as stage:
        stage.place(STUDIO.start)
        return stage.picture(View((-0.05, 0.0, 0.15), azimuth=208.0, elevation=-16.0, away=1.22))


def course(name: str) -> Image.Image:
    """A course from above; the places, named after the contexts they are built to provoke, are tinted."""
    world, size = load_world(name), (WIDTH, 520)
    view = whole(world, size)
    with Stage(world, size, shadows=24.0) as stage:
        image, floor = stage.picture(view), stage.floor(view)
    areas = [(view.pixels(on_floor(s.polygon), size), colour_of(s.name)) for s in world.segments]
    image = tinted(image, floor, areas)
    goal = view.pixels(on_floor(goal_rim(world)), size)
    ImageDraw.Draw(floor).polygon([tuple(p) for p in goal], fill=0)  # it has a label of its own
    for segment, (outline, colour) in zip(world.segments, areas, strict=True):
        label(image, _middle(outline, floor), segment.name, colour)
    _mark_ends(image, view, world)
    return image


def barn() -> Image.Image:
    """A generated world, the way through from left to right."""
    world, size = load_world(BARN), (WIDTH, 560)
    view = whole(world, size, azimuth=180.0)
    with Stage(world, size, shadows=14.0) as stage:
        image = stage.picture(view)
    _mark_ends(image, view, world)
    return image


def _mark_ends(image: Image.Image, view: View, world: World) -> None:
    for pose, text, colour, lift in ((world.start, "start", START, 34.0), (world.goal, "goal", GOAL, 0.0)):
        x, y = view.pixels(on_floor([(pose.x, pose.y)]), image.size)[0]
        label(image, (x, y + lift), text, colour, 17)


def _middle(outline: Array, floor: Image.Image) -> tuple[float, float]:
    """The pixel of an area that is farthest from everything that is not its bare floor."""
    area = Image.new("L", floor.size, 0)
    ImageDraw.Draw(area).polygon([tuple(p) for p in outline], fill=255)
    inside = np.minimum(np.asarray(area), np.asarray(floor)) > 127
    y, x = np.unravel_index(np.argmax(distance_transform_edt(np.pad(inside, 1))), np.array(inside.shape) + 2)
    return float(x) - 1, float(y) - 1
