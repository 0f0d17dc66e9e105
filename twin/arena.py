"""World -> MJCF arena -> compiled MuJoCo model with the robot at its start.

How an obstacle becomes geometry:

* Cylinders and boxes stand for themselves, for the lidar and for contact.
* A mesh (a scanned room) is split in two, because MuJoCo lets rays hit a mesh's true triangles but collides with its
  convex hull, which for a room is a solid block. Its triangles are for eyes and lidar only; contact meets the boxes
  of `columns.py`, over the 5 cm cells that its surface occupies at the robot's height.

Obstacles are grouped into one static body per 2 m cell, so that `mj_multiRay` can reject whole cells per ray: half the
time of obstacles straight in the worldbody. Each such body carries an explicit inertial frame parallel to the world.
`mj_multiRay` places a body's bounding sphere as if that frame were not rotated; the frame MuJoCo would infer, the
principal axes of an arbitrary heap of obstacles, puts the sphere in the wrong place, and rays pass through things.
(tests/test_arena.py holds mj_multiRay equal to mj_ray on every kind of world.)
"""

from __future__ import annotations

import copy
import math
from functools import lru_cache
from typing import Any, Final

import mujoco
import numpy as np

from twin.columns import mesh_columns
from twin.robot.jackal import (
    COLLISION_GROUP,
    DECORATION_GROUP,
    NO_CONTACT,
    OBSTACLE_GROUP,
    RIDE_HEIGHT,
    WORLD_CONTACT,
    build_jackal,
)
from twin.robot.pymjcf import mjcf
from twin.world import Box, Cylinder, Mesh, World

CELL: Final = 2.0  # [m] edge of the static bodies; 1.5 to 3 are equally fast, 1 and 4 slower
MESH_FACES: Final = 150_000  # triangles per mesh geom; MuJoCo's STL reader takes 200,000

STYLES: Final[dict[str, tuple[float, float, float]]] = {  # rgb by Obstacle.style
    "cylinder": (0.83, 0.36, 0.22),
    "box": (0.36, 0.50, 0.64),
    "wall": (0.87, 0.84, 0.78),
    "cardboard": (0.76, 0.58, 0.38),
    "furniture": (0.55, 0.36, 0.22),
    "mesh": (0.76, 0.75, 0.72),
}
ROUND: Final = ("cylinder", "mesh")  # styles without marked edges
SHADOW_RADIUS: Final = 10.0  # [m] round the robot: a shadow map of a large world would be too coarse


def build_arena(world: World) -> mjcf.RootElement:
    """Floor, light, obstacles and goal marker as a PyMJCF model, without the robot.

    Geoms are named after their place in `world.obstacles`: `cylinder_0007`, `box_0012`, and for the contact boxes of a
    mesh `mesh_0003_part_0041`.
    """
    root = mjcf.RootElement(model="arena")
    _add_looks(root, world)
    root.worldbody.add(
        "geom",
        name="floor",
        type="plane",  # a plane, not a box: the wheel cylinders bounce on box floors
        size=(0, 0, 1),
        material="floor",
        group=OBSTACLE_GROUP,
        **WORLD_CONTACT,
    )
    cells: dict[tuple[int, int], Any] = {}
    for index, obstacle in enumerate(world.obstacles):
        if isinstance(obstacle, Mesh):
            _add_mesh(root, cells, f"mesh_{index:04d}", obstacle)
        else:
            kind = "cylinder" if isinstance(obstacle, Cylinder) else "box"
            _add_solid(root, cells, f"{kind}_{index:04d}", obstacle, group=OBSTACLE_GROUP)
    _add_goal(root, world)
    return root


def build_scene(world: World, lidar_mount: str = "ust10") -> mjcf.RootElement:
    """The arena with the robot standing at `world.start`."""
    root = build_arena(world)
    frame = root.attach(build_jackal(lidar_mount))
    frame.pos = (world.start.x, world.start.y, RIDE_HEIGHT)
    frame.quat = (math.cos(world.start.yaw / 2), 0, 0, math.sin(world.start.yaw / 2))
    frame.add("freejoint", name="base")
    return root


def compile_world(world: World, lidar_mount: str = "ust10", timestep: float = 0.002) -> mujoco.MjModel:
    """A plain MuJoCo model of `world` with the robot at its start, the caller's own; `timestep` in seconds.

    The last few worlds are remembered: PyMJCF takes 0.1 to 0.2 s for 300 obstacles, a copy of the outcome 0.2 ms.
    """
    if any(isinstance(obstacle, Mesh) for obstacle in world.obstacles):  # arrays cannot be compared cheaply
        return _compile(world, lidar_mount, timestep)
    return copy.copy(_remembered(world, lidar_mount, timestep))


def _compile(world: World, lidar_mount: str, timestep: float) -> mujoco.MjModel:
    root = build_scene(world, lidar_mount)
    root.option.timestep = timestep
    return mujoco.MjModel.from_xml_string(root.to_xml_string(), root.get_assets())


_remembered = lru_cache(maxsize=4)(_compile)


def _cell(root: Any, cells: dict[tuple[int, int], Any], x: float, y: float) -> tuple[Any, float, float]:
    """The static body that holds world point x, y [m], and the point in that body's frame."""
    key = (math.floor(x / CELL), math.floor(y / CELL))
    centre = ((key[0] + 0.5) * CELL, (key[1] + 0.5) * CELL)
    if key not in cells:
        body = root.worldbody.add("body", name=f"cell_{key[0]}_{key[1]}", pos=(*centre, 0))
        body.add("inertial", mass=1, pos=(0, 0, 0), diaginertia=(1, 1, 1))  # only its axes matter: see the module
        cells[key] = body
    return cells[key], x - centre[0], y - centre[1]


def _add_solid(root: Any, cells: Any, name: str, obstacle: Cylinder | Box, group: int) -> None:
    """A cylinder or box that the robot can hit; the lidar sees it when `group` says so."""
    body, x, y = _cell(root, cells, obstacle.x, obstacle.y)
    shape: dict[str, Any]
    if isinstance(obstacle, Cylinder):
        half = obstacle.height / 2
        shape = {"type": "cylinder", "size": (obstacle.radius, half), "pos": (x, y, half)}
    else:
        half = obstacle.height / 2
        shape = {
            "type": "box",
            "size": (obstacle.length / 2, obstacle.width / 2, half),
            "pos": (x, y, obstacle.bottom + half),
            "quat": (math.cos(obstacle.yaw / 2), 0, 0, math.sin(obstacle.yaw / 2)),
        }
    body.add("geom", name=name, material=_material(root, obstacle.style), group=group, **shape, **WORLD_CONTACT)


def _add_mesh(root: Any, cells: Any, name: str, mesh: Mesh) -> None:
    """True triangles for the lidar, straight in the worldbody, and boxes for contact, hidden from it."""
    for part, first in enumerate(range(0, len(mesh.faces), MESH_FACES)):
        label = name if part == 0 else f"{name}_{part}"
        asset = root.asset.add(
            "mesh",
            name=label,
            file=mjcf.Asset(_stl(mesh, slice(first, first + MESH_FACES)), ".stl"),
            inertia="shell",  # an open surface has no volume
        )
        root.worldbody.add(
            "geom",
            name=label,
            type="mesh",
            mesh=asset,
            material=_material(root, mesh.style),
            group=OBSTACLE_GROUP,
            **NO_CONTACT,
        )
    for index, column in enumerate(mesh_columns(mesh)):
        _add_solid(root, cells, f"{name}_part_{index:04d}", column, group=COLLISION_GROUP)


def _stl(mesh: Mesh, faces: slice) -> bytes:
    """Binary STL of some of the faces."""
    corners = np.asarray(mesh.vertices, dtype="<f4")[mesh.faces[faces]]
    record = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["corners"] = corners
    return bytes(80) + len(corners).to_bytes(4, "little") + record.tobytes()


def _material(root: Any, style: str) -> Any:
    """The material of a style, made when first asked for; an unknown style looks like a box."""
    found = root.find("material", style)
    if found is not None:
        return found
    rgb = STYLES.get(style, STYLES["box"])
    texture = root.asset.add(
        "texture", name=style, type="cube", builtin="flat", rgb1=rgb, rgb2=rgb, width=96, height=96
    )
    if style not in ROUND:  # dark edges keep boxes of one colour apart
        texture.set_attributes(mark="edge", markrgb=tuple(0.72 * c for c in rgb))
    return root.asset.add("material", name=style, texture=texture, specular=0.15, shininess=0.2)


def _add_looks(root: Any, world: World) -> None:
    """Sky, floor material and light; nothing that physics or lidar can tell."""
    reach = max(4.0, math.hypot(world.goal.x - world.start.x, world.goal.y - world.start.y) / 2)
    root.statistic.extent = reach
    root.statistic.center = ((world.start.x + world.goal.x) / 2, (world.start.y + world.goal.y) / 2, 0.3)
    root.visual.map.znear = 0.02 / reach
    root.visual.map.zfar = 100 / reach
    root.visual.map.shadowclip = SHADOW_RADIUS / reach
    root.visual.quality.shadowsize = 4096
    root.visual.quality.offsamples = 8
    view = getattr(root.visual, "global")
    view.offwidth, view.offheight = 1920, 1080
    root.visual.headlight.set_attributes(
        ambient=(0.33, 0.33, 0.35), diffuse=(0.26, 0.26, 0.26), specular=(0.1, 0.1, 0.1)
    )
    root.visual.rgba.haze = (0.93, 0.95, 0.97, 1)
    root.asset.add(
        "texture",
        name="sky",
        type="skybox",
        builtin="gradient",
        rgb1=(0.62, 0.76, 0.90),
        rgb2=(0.95, 0.96, 0.97),
        width=64,
        height=384,
    )
    checker = root.asset.add(
        "texture",
        name="floor",
        type="2d",
        builtin="checker",
        rgb1=(0.66, 0.68, 0.70),
        rgb2=(0.61, 0.63, 0.65),
        mark="edge",
        markrgb=(0.70, 0.72, 0.74),
        width=256,
        height=256,
    )
    root.asset.add("material", name="floor", texture=checker, texuniform=True, texrepeat=(0.5, 0.5), specular=0.1)


def _add_goal(root: Any, world: World) -> None:
    """A translucent disc as wide as the goal tolerance; drawn only."""
    root.worldbody.add(
        "geom",
        name="goal",
        type="cylinder",
        size=(world.rules.goal_tolerance, 0.002),
        pos=(world.goal.x, world.goal.y, 0.003),
        rgba=(0.15, 0.7, 0.3, 0.45),
        group=DECORATION_GROUP,
        **NO_CONTACT,
    )
