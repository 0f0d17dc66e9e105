"""WORLD as typed on the command line -> World."""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenarios import barn_files
from scenarios.barn import barn_world, protocol_rules
from scenarios.barn_generator import COUNT, generated_world
from scenarios.courses import BUILT_IN, course_names, read_course
from scenarios.world_checks import WorldError, checked
from twin.geometry import distance
from twin.records import Pose2
from twin.world import Mesh, World

__all__ = ["WorldEntry", "WorldError", "check_protocol", "list_worlds", "load_world"]

MESH_SUFFIXES = (".obj", ".stl", ".ply", ".glb")
FILE_SUFFIXES = (".world", ".npz", ".npy", ".toml", ".yaml", ".yml", *MESH_SUFFIXES)


@dataclass(frozen=True, slots=True)
class WorldEntry:
    """One line of `appli worlds`."""

    name: str
    kind: str
    size: str  # of the ground the obstacles stand on, e.g. "12.0 x 8.0 m"
    distance: float  # start to goal, straight [m]
    note: str

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def load_world(
    text: str, protocol: str = "appli", *, start: str | Pose2 | None = None, goal: str | Pose2 | None = None
) -> World:
    """The world that `text` names: a built-in name, barn-like/K, or a file with an optional #index.

    `protocol` picks start, goal and rules of BARN worlds. `start` ("x,y" or "x,y,yaw") and `goal` ("x,y"), in metres
    and radians, replace those of the world; maps and meshes need both. Raises WorldError.
    """
    protocol_rules(protocol)
    start_pose, goal_pose = _pose(start, "--start"), _pose(goal, "--goal")
    world = _resolve(text, protocol, start_pose, goal_pose)
    if start_pose is not None:
        world = dataclasses.replace(world, start=start_pose)
    if goal_pose is not None:
        world = dataclasses.replace(world, goal=goal_pose)
    return checked(world)


def check_protocol(world: World, protocol: str) -> None:
    """Refuse a protocol other than the default for a world that is not BARN's. Raises WorldError."""
    if protocol != "appli" and world.rules.protocol == "course":
        raise WorldError(f"--protocol {protocol} is for BARN worlds; {world.name} has a start and a goal of its own")


def list_worlds() -> list[WorldEntry]:
    """The built-in worlds, and one line for the generated ones."""
    entries = [_entry(load_world(name), "course") for name in course_names()]
    example = load_world("barn-like/0")
    note = "30 x 30 cells of cylinders by BARN's recipe, 300 of them; they get harder with K"
    return [*entries, dataclasses.replace(_entry(example, "BARN-like"), name=f"barn-like/0..{COUNT - 1}", note=note)]


def _entry(world: World, kind: str) -> WorldEntry:
    corners = []
    for obstacle in world.obstacles:
        if not isinstance(obstacle, Mesh):
            corners.append((obstacle.x, obstacle.y))
    extent = np.ptp(np.array([*corners, (world.start.x, world.start.y), (world.goal.x, world.goal.y)]), axis=0)
    size = f"{extent[0]:.1f} x {extent[1]:.1f} m"
    return WorldEntry(world.name, kind, size, round(distance(world.start, world.goal), 3), world.note)


# --- resolving -------------------------------------------------------------------------------------------------------


def _resolve(text: str, protocol: str, start: Pose2 | None, goal: Pose2 | None) -> World:
    if text in course_names():
        return read_course(BUILT_IN / f"{text}.toml")
    if text.startswith("barn-like"):
        return _generated(text, protocol)
    name, _, fragment = text.partition("#")
    path = Path(name)
    suffix = path.suffix.lower()
    if suffix not in FILE_SUFFIXES:
        raise WorldError(_unknown(text))
    if fragment and suffix != ".npz":
        raise WorldError(f"{text}: only .npz archives hold numbered worlds; leave out #{fragment}")
    try:
        if not path.is_file():
            what = "is a folder" if path.is_dir() else "does not exist"
            raise WorldError(f"{path} {what}; check the path, or list the built-in worlds with: appli worlds")
        return _read(path, suffix, fragment, protocol, start, goal)
    except OSError as error:
        raise WorldError(f"{path} cannot be read: {error.strerror or error}") from None


def _read(path: Path, suffix: str, fragment: str, protocol: str, start: Pose2 | None, goal: Pose2 | None) -> World:
    if suffix == ".toml":
        return read_course(path)
    if suffix in (".yaml", ".yml", *MESH_SUFFIXES):
        from scenarios.imported import read_map, read_mesh  # loads pillow and trimesh: only when asked for

        return (read_mesh if suffix in MESH_SUFFIXES else read_map)(path, start, goal)
    if suffix == ".npz":
        grid, ends, index = barn_files.read_archive(path, fragment)
    elif suffix == ".npy":
        grid, ends, index = barn_files.read_grid_file(path)
    else:
        grid, ends, index = barn_files.read_world_file(path)
    return barn_world(f"world_{index}", index, grid, ends, protocol)


def _generated(text: str, protocol: str) -> World:
    match = re.fullmatch(r"barn-like/(\d{1,6})", text)
    if not match or int(match.group(1)) >= COUNT:
        raise WorldError(f"{text}: generated worlds are barn-like/0 to barn-like/{COUNT - 1}; type e.g. barn-like/150")
    world = generated_world(int(match.group(1)))
    note = f"fill {world.fill:.2f}, {world.smoothing} smoothing steps"
    return barn_world(f"barn-like/{world.index}", world.index, world.grid, world.ends, protocol, note)


def _unknown(text: str) -> str:
    if text and Path(text).is_dir():
        return f"{text} is a folder; give a file in it, or list the built-in worlds with: appli worlds"
    if text.endswith(".safetensors"):
        return f"{text} is a policy; give a world, and the policy as --driver"
    known = [*course_names(), "barn-like/0"]
    near = difflib.get_close_matches(text.lower(), known, n=3, cutoff=0.5)
    if near:
        return f"unknown world {text!r}; did you mean {' or '.join(near)}? `appli worlds` lists all"
    kinds = ", ".join("map.yaml" if s == ".yaml" else f"*{s}" for s in FILE_SUFFIXES if s != ".yml")
    return f"unknown world {text!r}; use {', '.join(known[:-1])}, barn-like/K, or a file ({kinds})"


def _pose(value: str | Pose2 | None, option: str) -> Pose2 | None:
    """A pose from "x,y" or, for the start, "x,y,yaw"."""
    if value is None or isinstance(value, Pose2):
        return value
    try:
        numbers = [float(word) for word in value.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in ((2, 3) if option == "--start" else (2,)) or not all(math.isfinite(v) for v in numbers):
        form = "x,y in metres and, if wanted, yaw in radians" if option == "--start" else "x,y in metres"
        raise WorldError(f"{option} {value}: give {form}, as in {option}=1.5,0")
    return Pose2(numbers[0], numbers[1], numbers[2] if len(numbers) == 3 else 0.0)
