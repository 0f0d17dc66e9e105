"""What never moves, logged once: the floor, the obstacles in 3-D and as a flat plan, the marks, the robot's shape.

The 3-D view shows the obstacles standing; the top view shows their plan, because Rerun has no orthographic camera and
walls seen from above would lean outwards and cover the floor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from twin.recording import palette
from twin.recording.palette import RGB, obstacle_colour
from twin.records import Array, Pose2
from twin.world import Box, Cylinder, Mesh, World

MARGIN = 1.0  # [m] of floor round everything
GRID_STEP = 1.0  # [m]
SIDES = 24  # of a disc in the plan
LIDAR_HEIGHT = 0.305  # [m] above the floor: a mesh's plan is its section there (twin/robot/jackal.py: 0.0635 + 0.2414)

# Heights [m] of flat things above the floor; far enough apart for the depth buffer of a camera 30 m up.
GRID_AT, SEGMENT_AT, PLAN_AT, MARK_AT = 0.002, 0.004, 0.03, 0.035


def bounds(world: World) -> tuple[float, float, float, float]:
    """min x, min y, max x, max y [m] of all that is in the world, with a margin."""
    corners = [np.array([[p.x, p.y] for p in (world.start, world.goal)])]
    corners += [_outline(obstacle) for obstacle in world.obstacles]
    points = np.concatenate(corners)
    low, high = points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def draw_world(stream: Any, world: World) -> None:
    """Floor, obstacles, segments, start and goal."""
    stream.send_columns("world", [], rr.ViewCoordinates.columns(xyz=[rr.components.ViewCoordinates.RIGHT_HAND_Z_UP]))
    _draw_floor(stream, bounds(world))
    _draw_solids(stream, world)
    _draw_plan(stream, world)
    _draw_segments(stream, world)
    _draw_marks(stream, world)


def _draw_floor(stream: Any, box: tuple[float, float, float, float]) -> None:
    x0, y0, x1, y1 = box
    corners = np.array([(x0, y0, -0.01), (x1, y0, -0.01), (x1, y1, -0.01), (x0, y1, -0.01)])
    _send_mesh(stream, "world/floor", corners, np.array([(0, 1, 2), (0, 2, 3)]), palette.FLOOR)
    xs = np.arange(math.ceil(x0 / GRID_STEP), math.floor(x1 / GRID_STEP) + 1) * GRID_STEP
    ys = np.arange(math.ceil(y0 / GRID_STEP), math.floor(y1 / GRID_STEP) + 1) * GRID_STEP
    lines = [[(x, y0, GRID_AT), (x, y1, GRID_AT)] for x in xs] + [[(x0, y, GRID_AT), (x1, y, GRID_AT)] for y in ys]
    _send_lines(stream, "world/floor/grid", lines, palette.GRID, 0.004)


def _draw_solids(stream: Any, world: World) -> None:
    """The obstacles as they stand."""
    cylinders = [o for o in world.obstacles if isinstance(o, Cylinder)]
    if cylinders:
        columns = rr.Cylinders3D.columns(
            lengths=[c.height for c in cylinders],
            radii=[c.radius for c in cylinders],
            colors=_rgb([obstacle_colour(c.style) for c in cylinders]),
        )
        centres = rr.InstancePoses3D.columns(translations=[(c.x, c.y, c.height / 2) for c in cylinders])
        fill = rr.Cylinders3D.columns(fill_mode=[rr.components.FillMode.Solid])
        one = [len(cylinders)]
        stream.send_columns(
            "world/obstacles/cylinders", [], [*columns.partition(one), *centres.partition(one), *fill.partition([1])]
        )
    boxes = [o for o in world.obstacles if isinstance(o, Box)]
    if boxes:
        columns = rr.Boxes3D.columns(
            half_sizes=[(b.length / 2, b.width / 2, b.height / 2) for b in boxes],
            colors=_rgb([obstacle_colour(b.style) for b in boxes]),
        )
        centres = rr.InstancePoses3D.columns(
            translations=[(b.x, b.y, b.bottom + b.height / 2) for b in boxes],
            quaternions=[(0.0, 0.0, math.sin(b.yaw / 2), math.cos(b.yaw / 2)) for b in boxes],
        )
        fill = rr.Boxes3D.columns(fill_mode=[rr.components.FillMode.Solid])
        one = [len(boxes)]
        stream.send_columns(
            "world/obstacles/boxes", [], [*columns.partition(one), *centres.partition(one), *fill.partition([1])]
        )
    for k, mesh in enumerate(o for o in world.obstacles if isinstance(o, Mesh)):
        _send_mesh(stream, f"world/obstacles/mesh_{k}", mesh.vertices, mesh.faces, obstacle_colour(mesh.style))


def _draw_plan(stream: Any, world: World) -> None:
    """The obstacles' outlines, filled; of a mesh its section at the lidar's height."""
    vertices: list[Array] = []
    faces: list[NDArray[np.int64]] = []
    colours: list[NDArray[np.uint8]] = []
    count = 0
    for obstacle in world.obstacles:
        if isinstance(obstacle, Mesh):
            continue
        ring = _outline(obstacle)
        n = len(ring)
        fan = np.array([(0, k, k + 1) for k in range(1, n - 1)])
        vertices.append(np.column_stack([ring, np.full(n, PLAN_AT)]))
        faces.append(fan + count)
        colours.append(np.tile(np.array(obstacle_colour(obstacle.style), np.uint8), (n, 1)))
        count += n
    if vertices:
        _send_mesh(
            stream, "world/plan/solids", np.concatenate(vertices), np.concatenate(faces), np.concatenate(colours)
        )
    for k, mesh in enumerate(o for o in world.obstacles if isinstance(o, Mesh)):
        cut = section(mesh, LIDAR_HEIGHT)
        if len(cut):
            strips = np.concatenate([cut, np.full((len(cut), 2, 1), PLAN_AT)], axis=2)
            _send_lines(stream, f"world/plan/mesh_{k}", strips, obstacle_colour(mesh.style), 0.02)


def _draw_segments(stream: Any, world: World) -> None:
    for segment in world.segments:
        ring = [(x, y, SEGMENT_AT) for x, y in (*segment.polygon, segment.polygon[0])]
        _send_lines(
            stream, f"world/segments/{segment.name}", [ring], palette.dimmed(segment.name), 0.015, label=segment.name
        )


def _draw_marks(stream: Any, world: World) -> None:
    goal = _circle(world.goal, world.rules.goal_tolerance)
    _send_lines(stream, "world/goal", [goal], palette.GOAL, 0.03, label="goal")
    _send_lines(stream, "world/start", [_circle(world.start, 0.25)], palette.START, 0.015, label="start")
    if world.rules.finish_line_y is not None:
        x0, _, x1, _ = bounds(world)
        y = world.rules.finish_line_y
        _send_lines(stream, "world/goal/line", [[(x0, y, MARK_AT), (x1, y, MARK_AT)]], palette.GOAL, 0.02)


def section(mesh: Mesh, height: float) -> Array:
    """(n, 2, 2) the segments [m] in which the mesh's triangles cut the plane z = height."""
    triangles = mesh.vertices[mesh.faces]
    above = triangles[..., 2] > height
    cut = triangles[above.any(axis=1) & ~above.all(axis=1)]
    above = cut[..., 2] > height
    lone = np.where(above.sum(axis=1) == 1, np.argmax(above, axis=1), np.argmin(above, axis=1))
    apex = cut[np.arange(len(cut)), lone]
    ends = []
    for step in (1, 2):  # the two edges that leave the corner on its own side of the plane
        other = cut[np.arange(len(cut)), (lone + step) % 3]
        along = (height - apex[:, 2]) / (other[:, 2] - apex[:, 2])
        ends.append(apex[:, :2] + along[:, None] * (other - apex)[:, :2])
    return np.stack(ends, axis=1)


def _outline(obstacle: Box | Cylinder | Mesh) -> Array:
    """(n, 2) [m] the outline seen from above; of a mesh, the corners of its bounding box."""
    if isinstance(obstacle, Cylinder):
        return _circle(Pose2(obstacle.x, obstacle.y, 0.0), obstacle.radius)[:-1, :2]
    if isinstance(obstacle, Box):
        c, s = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
        signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        corners = signs * np.array([obstacle.length / 2, obstacle.width / 2])
        return np.asarray(corners @ np.array([[c, s], [-s, c]]) + np.array([obstacle.x, obstacle.y]))
    low, high = obstacle.vertices[:, :2].min(axis=0), obstacle.vertices[:, :2].max(axis=0)
    return np.array([low, high])


def _circle(pose: Pose2, radius: float) -> Array:
    """(SIDES + 1, 3) a closed circle [m] on the floor."""
    turn = np.linspace(0.0, math.tau, SIDES + 1)
    x, y = pose.x + radius * np.cos(turn), pose.y + radius * np.sin(turn)
    return np.column_stack([x, y, np.full(len(turn), MARK_AT)])


def _rgb(colours: Sequence[RGB]) -> NDArray[np.uint8]:
    return np.array(colours, dtype=np.uint8)


def _send_mesh(stream: Any, entity: str, vertices: Array, faces: Any, colour: RGB | NDArray[np.uint8]) -> None:
    """A mesh in one colour, or with one colour per vertex (n, 3)."""
    colours = np.broadcast_to(np.asarray(colour, np.uint8), (len(vertices), 3))
    columns = rr.Mesh3D.columns(
        vertex_positions=vertices.astype(np.float32), vertex_colors=np.ascontiguousarray(colours)
    ).partition([len(vertices)])
    triangles = rr.Mesh3D.columns(triangle_indices=faces.astype(np.uint32)).partition([len(faces)])
    stream.send_columns(entity, [], [*columns, *triangles])


def _send_lines(stream: Any, entity: str, strips: Any, colour: RGB, radius: float, label: str | None = None) -> None:
    """Polylines in one colour; `radius` [m] is half the line's width."""
    shapes = rr.LineStrips3D.columns(strips=strips).partition([len(strips)])
    style = rr.LineStrips3D.columns(colors=_rgb([colour]), radii=[radius]).partition([1])
    text = [] if label is None else rr.LineStrips3D.columns(labels=[label]).partition([1])
    stream.send_columns(entity, [], [*shapes, *style, *text])
