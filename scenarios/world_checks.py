"""What every world must satisfy before a robot is put into it, and the error that says so."""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np

from twin.free_space import free_space, obstacle_distance
from twin.geometry import transform_points
from twin.records import Array, Pose2
from twin.world import Mesh, Obstacle, World

MAX_OBSTACLES = 20_000  # MuJoCo's broad phase and the lidar both go through all of them
MAX_COORDINATE = 1_000.0  # [m] beyond this, metres were probably not meant
HALF_LENGTH = 0.131 + 0.098  # [m] wheel centre plus wheel radius, as in twin/clearance.py (which would load numba)
HALF_WIDTH = 0.187795 + 0.020  # [m] wheel centre plus half a wheel (jackal.urdf.xacro)
ROOM_TO_MOVE = 1.0  # [m2] a start with less ground than this within reach is inside something
START_GAP = 0.01  # [m] the outline is tested by points this close to each other


class WorldError(ValueError):
    """The world cannot be used. The text is one line: what is wrong, and what to type next."""


def checked(world: World) -> World:
    """The same world, or WorldError when no robot could be simulated in it."""
    if len(world.obstacles) > MAX_OBSTACLES:
        raise WorldError(
            f"{world.name} has {len(world.obstacles)} obstacles; at most {MAX_OBSTACLES} can be simulated. "
            "Use a smaller part of it, or a coarser map"
        )
    for obstacle in world.obstacles:
        _check_numbers(world.name, obstacle)
    for what, pose in (("start", world.start), ("goal", world.goal)):
        if not all(math.isfinite(v) and abs(v) <= MAX_COORDINATE for v in (pose.x, pose.y, pose.yaw)):
            raise WorldError(
                f"{world.name}: {what} = {pose.x}, {pose.y}, {pose.yaw} is not a place; give finite metres"
            )
    gap = obstacle_distance(world.obstacles, _outline_points(world.start)).min()
    if gap < START_GAP or _locked_in(world):
        raise WorldError(
            f"{world.name}: the robot would start inside an obstacle at x={world.start.x:g}, y={world.start.y:g}; "
            "give a free place with --start=x,y,yaw"
        )
    return world


def _locked_in(world: World) -> bool:
    """Whether the start lies inside a closed mesh, such as a cupboard: a surface has no inside to test."""
    if not any(isinstance(obstacle, Mesh) for obstacle in world.obstacles):
        return False
    space = free_space(world, 0.05)
    return float(space.reachable(world.start, HALF_WIDTH).sum()) * space.resolution**2 < ROOM_TO_MOVE


def _check_numbers(name: str, obstacle: Obstacle) -> None:
    if isinstance(obstacle, Mesh):
        if not np.isfinite(obstacle.vertices).all() or np.abs(obstacle.vertices).max(initial=0.0) > MAX_COORDINATE:
            raise WorldError(f"{name}: the mesh has vertices that are not finite or beyond {MAX_COORDINATE:g} m")
        return
    values = {f.name: getattr(obstacle, f.name) for f in fields(obstacle) if f.name != "style"}
    for key, value in values.items():
        if not math.isfinite(value) or abs(value) > MAX_COORDINATE:
            raise WorldError(f"{name}: an obstacle has {key} = {value}; give finite metres up to {MAX_COORDINATE:g}")
        if key in ("radius", "height", "length", "width") and value <= 0:
            raise WorldError(f"{name}: an obstacle has {key} = {value}; sizes must be greater than 0")


def _outline_points(pose: Pose2) -> Array:
    """(n, 2) [m] points that fill the robot's rectangle at `pose`, world frame."""
    x = np.arange(-HALF_LENGTH, HALF_LENGTH + 1e-9, START_GAP)
    y = np.append(np.arange(-HALF_WIDTH, HALF_WIDTH, START_GAP), HALF_WIDTH)
    return transform_points(pose, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
