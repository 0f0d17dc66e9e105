"""Rooms from elsewhere: ROS occupancy maps (map.yaml + image) and triangle meshes (obj, stl, ply, glb)."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from scenarios.world_checks import MAX_OBSTACLES, WorldError
from twin.free_space import FLOOR_SKIN, free_space
from twin.geometry import transform_points
from twin.records import Array, Pose2, frozen_array
from twin.world import Box, Mesh, Obstacle, Rules, World

RULES = Rules("course", goal_tolerance=0.5, time_limit=200.0, stop_on_contact=True)  # those of a course

MAX_YAML_BYTES = 64 * 1024
MAX_PIXELS = 16_000_000  # 4000 x 4000: at 0.05 m a map of 200 m
MAX_MESH_BYTES = 200_000_000
MAX_FACES = 1_000_000
MAP_HEIGHT = 1.0  # [m] of the walls that a map is raised to; above every lidar mount
ROOM_SIDE = (0.5, 200.0)  # [m] shortest and longest plausible side of a scanned room
FLOOR_BAND = 0.5  # [m] above the lowest vertex in which the floor is looked for
ROUND_ROBOT = 0.32  # [m] radius that a suggested start and goal keep free

Mask = NDArray[np.bool_]


# --- ROS maps --------------------------------------------------------------------------------------------------------


def read_map(path: Path, start: Pose2 | None, goal: Pose2 | None) -> World:
    """A map_server map as walls. Occupied cells become boxes; free and unknown cells are floor.

    Start and goal come from the arguments, or from the keys `start: [x, y, yaw]` and `goal: [x, y]` in the file,
    which map_server ignores.
    """
    settings = _read_yaml(path)
    resolution, low = _number(path, settings, "resolution", 0.001, 10.0), _origin(path, settings)
    negate = _number(path, settings, "negate", 0, 1, default=0) != 0
    threshold = _number(path, settings, "occupied_thresh", 0.0, 1.0, default=0.65)
    mode = settings.get("mode", "trinary")
    if mode not in ("trinary", "scale"):
        raise WorldError(f"{path}: mode {_short(mode)} is not supported; write mode: trinary")
    shade = _read_image(_image_path(path, settings))
    occupied = (shade if negate else 1.0 - shade)[::-1] > threshold  # (ny, nx), index [y, x], y up
    boxes = tuple(_map_boxes(path, occupied, resolution, low))
    start = start or _pose(path, settings, "start")
    goal = goal or _pose(path, settings, "goal")
    note = f"map of {occupied.shape[1] * resolution:.1f} x {occupied.shape[0] * resolution:.1f} m"
    return _world(path, boxes, start, goal, note)


def rectangles(occupied: Mask) -> list[tuple[int, int, int, int]]:
    """Rectangles (y0, x0, y1, x1), ends exclusive, that cover the true cells exactly and without overlap.

    Greedy: from each first uncovered cell as far right as possible, then as far up as the whole row fits.
    """
    left = occupied.copy()
    found = []
    for y0, x0 in np.argwhere(occupied):
        if not left[y0, x0]:
            continue
        row = left[y0, x0:]
        x1 = int(x0) + (len(row) if row.all() else int(row.argmin()))
        y1 = int(y0) + 1
        while y1 < len(left) and left[y1, x0:x1].all():
            y1 += 1
        left[y0:y1, x0:x1] = False
        found.append((int(y0), int(x0), y1, x1))
        if len(found) > MAX_OBSTACLES:
            break
    return found


def _map_boxes(path: Path, occupied: Mask, resolution: float, low: Pose2) -> list[Obstacle]:
    found = rectangles(occupied)
    if len(found) > MAX_OBSTACLES:
        raise WorldError(f"{path}: the map needs more than {MAX_OBSTACLES} boxes; use a coarser or cleaner map")
    boxes: list[Obstacle] = []
    for y0, x0, y1, x1 in found:
        centre = np.array([[(x0 + x1) / 2, (y0 + y1) / 2]]) * resolution
        ((x, y),) = transform_points(low, centre).tolist()
        boxes.append(Box(x, y, low.yaw, (x1 - x0) * resolution, (y1 - y0) * resolution, MAP_HEIGHT, style="wall"))
    return boxes


def _read_yaml(path: Path) -> dict[str, Any]:
    if path.stat().st_size > MAX_YAML_BYTES:
        raise WorldError(f"{path} is too large for a map.yaml; it has six lines and names an image")
    try:
        settings = yaml.safe_load(path.read_bytes())
    except (yaml.YAMLError, UnicodeDecodeError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        raise WorldError(f"{path}{line}: not YAML; a map.yaml has lines such as 'resolution: 0.05'") from None
    if not isinstance(settings, dict):
        raise WorldError(f"{path}: not a ROS map; a map.yaml has lines such as 'resolution: 0.05'")
    return settings


def _image_path(path: Path, settings: dict[str, Any]) -> Path:
    """The image, which must lie in the folder of the map or below it."""
    name = settings.get("image")
    if not isinstance(name, str) or not name:
        raise WorldError(f"{path}: image is missing; add a line such as 'image: map.pgm'")
    folder = path.parent.resolve()
    image = (folder / name).resolve()
    if Path(name).is_absolute() or not image.is_relative_to(folder):
        raise WorldError(f"{path}: image {_short(name)} lies outside the map's folder; copy it beside the map")
    if not image.is_file():
        raise WorldError(f"{path}: image {_short(name)} does not exist; put it beside the map or correct the line")
    return image


def _read_image(path: Path) -> Array:
    """(ny, nx) 0 black .. 1 white, top row first: the mean of all channels, as map_server takes it."""
    try:
        with Image.open(path, formats=("PPM", "PNG", "BMP", "JPEG", "TIFF")) as file:
            if file.width * file.height > MAX_PIXELS:
                raise WorldError(f"{path} has {file.width} x {file.height} pixels; {MAX_PIXELS:,} are the limit")
            deep = file.mode.startswith("I")  # 16 bits
            image = file.convert("RGBA") if file.mode == "LA" else file  # as SDL does for map_server
            known = image if deep or image.mode in ("L", "RGB", "RGBA") else image.convert("L")
            shade = np.asarray(known, dtype=np.float64) / (65535.0 if deep else 255.0)
    except WorldError:
        raise
    except (OSError, ValueError, SyntaxError, EOFError, Image.DecompressionBombError) as error:
        raise WorldError(f"{path} cannot be read as an image ({_short(error)}); export it as PGM or PNG") from None
    return np.asarray(shade.mean(axis=2) if shade.ndim == 3 else shade)


def _number(
    path: Path, settings: dict[str, Any], key: str, low: float, high: float, default: float | None = None
) -> float:
    value = settings.get(key, default)
    if value is None:
        raise WorldError(f"{path}: {key} is missing; add a line such as '{key}: 0.05'")
    if not isinstance(value, (int, float)) or not low <= value <= high:
        raise WorldError(f"{path}: {key} must be a number from {low:g} to {high:g}, not {_short(value)}")
    return float(value)


def _origin(path: Path, settings: dict[str, Any]) -> Pose2:
    """World pose of the lower-left corner of the lower-left pixel."""
    pose = _pose(path, settings, "origin")
    if pose is None:
        raise WorldError(f"{path}: origin is missing; add a line such as 'origin: [0.0, 0.0, 0.0]'")
    return pose


def _pose(path: Path, settings: dict[str, Any], key: str) -> Pose2 | None:
    value = settings.get(key)
    if value is None:
        return None
    good = isinstance(value, list) and len(value) in (2, 3)
    if not good or not all(isinstance(v, (int, float)) and math.isfinite(v) for v in value):
        raise WorldError(f"{path}: {key} must be [x, y, yaw] in metres and radians, not {_short(value)}")
    return Pose2(float(value[0]), float(value[1]), float(value[2]) if len(value) == 3 else 0.0)


# --- meshes ----------------------------------------------------------------------------------------------------------


def read_mesh(path: Path, start: Pose2 | None, goal: Pose2 | None) -> World:
    """A scanned room. Metres, z up; shifted so that its floor is z = 0. The floor itself is left out."""
    vertices, faces = _load_mesh(path)
    if path.suffix.lower() == ".glb" and np.ptp(vertices[:, 1]) < np.ptp(vertices[:, 2]):
        # glTF is y-up by its standard, though many tools write z-up: rooms are wider than high, so the flatter is up
        vertices = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1)
    sides = np.ptp(vertices, axis=0)
    if not ROOM_SIDE[0] <= max(sides[0], sides[1]) <= ROOM_SIDE[1] or sides[2] > ROOM_SIDE[1]:
        raise WorldError(
            f"{path} measures {sides[0]:.4g} x {sides[1]:.4g} x {sides[2]:.4g}; a room in metres has sides of "
            f"{ROOM_SIDE[0]:g} to {ROOM_SIDE[1]:g}. Scale it to metres (from millimetres: by 0.001)"
        )
    vertices = vertices - [0.0, 0.0, _floor_height(vertices, faces)]
    faces = faces[vertices[faces][:, :, 2].max(axis=1) > FLOOR_SKIN]  # the wheels stand on the world's own floor
    if not len(faces):
        raise WorldError(f"{path} has nothing that stands above its floor; is z the vertical axis?")
    mesh = Mesh(frozen_array(vertices), frozen_array(faces.astype(np.int32)))
    return _world(path, (mesh,), start, goal, f"mesh of {len(faces)} triangles")


def _load_mesh(path: Path) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (n, 3) and faces (m, 3), all parts joined. Nothing but the file itself is opened."""
    import trimesh  # here, because maps do not need it

    if path.stat().st_size > MAX_MESH_BYTES:
        raise WorldError(f"{path} is larger than {MAX_MESH_BYTES // 10**6} MB; simplify the mesh")
    try:
        # from bytes, without a resolver: material and texture files that the mesh names are not looked for
        loaded = trimesh.load_scene(io.BytesIO(path.read_bytes()), file_type=path.suffix[1:].lower(), process=False)
        mesh = loaded.to_mesh()
        vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    except Exception as error:  # the loaders of four formats raise whatever they stumble over
        raise WorldError(f"{path} cannot be read as a mesh ({_short(error)}); export it again") from None
    if faces.ndim != 2 or not len(faces) or not len(vertices):
        raise WorldError(f"{path} has no triangles; export the room as a triangle mesh, not as points")
    if len(faces) > MAX_FACES:
        raise WorldError(f"{path} has {len(faces):,} triangles; simplify it to at most {MAX_FACES:,}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise WorldError(f"{path} is damaged: triangles name vertices that do not exist; export it again")
    if not np.isfinite(vertices[np.unique(faces)]).all():
        raise WorldError(f"{path} has vertices that are not finite numbers; export it again")
    used, inverse = np.unique(faces, return_inverse=True)
    return vertices[used], inverse.reshape(faces.shape).astype(np.int64)


def _floor_height(vertices: Array, faces: NDArray[np.int64]) -> float:
    """[m] height of the largest level surface close to the lowest point; that point without one."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1) / 2
    height = corners[:, :, 2].mean(axis=1)
    lowest = float(vertices[:, 2].min())
    low = (area > 0) & (height < lowest + FLOOR_BAND)
    up, down = (low & (sign * normal[:, 2] > 1.8 * area) for sign in (1, -1))  # level within 26 degrees
    level = up if up.any() else down  # a slab has two faces: the robot drives on the upper one
    if not level.any():
        return lowest
    order = np.argsort(height[level])
    share = np.cumsum(area[level][order])
    return float(height[level][order][np.searchsorted(share, share[-1] / 2)])  # the median by area


# --- start and goal --------------------------------------------------------------------------------------------------


def _world(path: Path, obstacles: Sequence[Obstacle], start: Pose2 | None, goal: Pose2 | None, note: str) -> World:
    if start is None or goal is None:
        missing = " and ".join(name for name, pose in (("start", start), ("goal", goal)) if pose is None)
        raise WorldError(f"{path} does not say {missing}; type e.g. {_suggestion(path, obstacles, start, goal)}")
    return World(path.stem, tuple(obstacles), start, goal, RULES, note=note)


def _suggestion(path: Path, obstacles: Sequence[Obstacle], start: Pose2 | None, goal: Pose2 | None) -> str:
    """A command line that would work: two free places in one room, far from each other."""
    here = start or goal or _any_point(obstacles)
    space = free_space(World(path.stem, tuple(obstacles), here, here, RULES), 0.1)
    free = space.distance >= ROUND_ROBOT
    rooms, count = ndimage.label(free)
    if count:
        sizes = np.bincount(rooms.ravel(), minlength=count + 1)
        sizes[0] = 0
        closed = sizes.copy()
        closed[np.unique(np.concatenate([rooms[0], rooms[-1], rooms[:, 0], rooms[:, -1]]))] = 0
        cells = np.argwhere(rooms == int((closed if closed.max() > 50 else sizes).argmax()))
        points = (cells[:, ::-1] + 0.5) * space.resolution + space.origin
        far = points[np.linalg.norm(points - points.mean(axis=0), axis=1).argmax()]
        near = points[np.linalg.norm(points - far, axis=1).argmax()]
    else:
        near, far = np.zeros(2), np.ones(2)
    a = start or Pose2(float(near[0]), float(near[1]), math.atan2(far[1] - near[1], far[0] - near[0]))
    b = goal or Pose2(float(far[0]), float(far[1]), 0.0)
    return f"--start={a.x:.2f},{a.y:.2f},{a.yaw:.2f} --goal={b.x:.2f},{b.y:.2f}"


def _any_point(obstacles: Sequence[Obstacle]) -> Pose2:
    if not obstacles:
        return Pose2(0.0, 0.0, 0.0)
    first = obstacles[0]
    x, y = first.vertices[0, :2] if isinstance(first, Mesh) else (first.x, first.y)
    return Pose2(float(x), float(y), 0.0)


def _short(value: object) -> str:
    """A value or error in at most 80 characters of one line."""
    text = repr(value) if not isinstance(value, BaseException) else str(value) or type(value).__name__
    text = " ".join(text.split())
    return text if len(text) <= 80 else text[:77] + "..."
