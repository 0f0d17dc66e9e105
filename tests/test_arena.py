"""Worlds as compiled models: what is where, what the rays meet, what the robot bumps into."""

from __future__ import annotations

import time
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from tests.robot.worlds import WORLDS, boxes, cylinders, everything, room, world
from twin.arena import compile_world
from twin.columns import mesh_columns
from twin.records import Pose2
from twin.robot.handles import RobotHandles
from twin.robot.lidar import Lidar
from twin.world import Box, Cylinder, Mesh, World


def place(model: mujoco.MjModel, data: mujoco.MjData, pose: Pose2, roll: float = 0.0, pitch: float = 0.0) -> None:
    """Put the robot somewhere, tilted a little."""
    robot = RobotHandles.resolve(model)
    quaternion = np.zeros(4)
    mujoco.mju_euler2Quat(quaternion, np.array([roll, pitch, pose.yaw]), "XYZ")
    data.qpos[robot.free_qpos : robot.free_qpos + 7] = (pose.x, pose.y, 0.0635, *quaternion)
    mujoco.mj_forward(model, data)


@pytest.mark.parametrize("build", WORLDS, ids=lambda build: build.__name__)
def test_multi_ray_equals_single_rays(build: Callable[[], World]) -> None:
    model = compile_world(build())
    data = mujoco.MjData(model)
    lidar = Lidar(model, RobotHandles.resolve(model))
    rng = np.random.default_rng(1)
    hits = 0
    for k in range(25):
        tilt = rng.normal(0.0, 0.05, size=2) if k % 2 else (0.0, 0.0)
        place(model, data, Pose2(*rng.uniform((-3.5, -2.5, -3.0), (8.0, 3.5, 3.0))), *tilt)
        seen = lidar.cast(data)
        sensor, turn = data.site_xpos[lidar.handles.lidar], data.site_xmat[lidar.handles.lidar].reshape(3, 3)
        single = np.array(
            [mujoco.mj_ray(model, data, sensor, turn @ ray, lidar.visible, True, -1, None) for ray in lidar.rays]
        )
        within = (single >= 0) & (single <= lidar.config.range_max)  # beyond, multiRay may drop whole geoms
        np.testing.assert_allclose(seen[within], single[within], rtol=0, atol=1e-9)
        assert np.all(seen[~within] > lidar.config.range_max)
        hits += int(within.sum())
    assert hits > 2000


@pytest.mark.parametrize("build", WORLDS, ids=lambda build: build.__name__)
def test_every_obstacle_has_a_name_of_its_own(build: Callable[[], World]) -> None:
    built = build()
    model = compile_world(built)
    names = [model.geom(g).name for g in range(model.ngeom) if not RobotHandles.resolve(model).is_robot[g]]
    assert all(names)
    assert len(set(names)) == len(names)
    for index, obstacle in enumerate(built.obstacles):
        assert f"{type(obstacle).__name__.lower()}_{index:04d}" in names


def test_obstacles_stand_where_the_world_says() -> None:
    built = boxes()
    model = compile_world(built)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for index, box in enumerate(built.obstacles):
        assert isinstance(box, Box)
        geom = data.geom(f"box_{index:04d}")
        np.testing.assert_allclose(geom.xpos, (box.x, box.y, box.bottom + box.height / 2), atol=1e-9)
        np.testing.assert_allclose(geom.xmat.reshape(3, 3)[:2, 0], (np.cos(box.yaw), np.sin(box.yaw)), atol=1e-9)


def test_goal_marker_is_only_drawn() -> None:
    model = compile_world(world("open"))
    goal = model.geom("goal")
    assert goal.contype[0] == goal.conaffinity[0] == 0
    assert goal.group[0] not in (0, 3)


def touched(built: World, pose: Pose2) -> str | None:
    """Name of what the robot touches at a pose."""
    model = compile_world(built)
    data = mujoco.MjData(model)
    place(model, data, pose)
    hit = RobotHandles.resolve(model).touched(data)
    return None if hit is None else model.geom(hit[0]).name


def test_the_robot_touches_what_it_overlaps_and_nothing_else() -> None:
    built = world("two", Cylinder(1.0, 0.0, 0.1, 0.5), Box(0.0, 1.0, 0.3, 0.5, 0.3, 0.4))
    assert touched(built, Pose2(0.0, 0.0, 0.0)) is None
    assert touched(built, Pose2(0.66, 0.0, 0.0)) is None  # 1 cm short of the cylinder with the wheels' front
    assert touched(built, Pose2(0.72, 0.0, 0.0)) == "cylinder_0000"
    assert touched(built, Pose2(0.0, 0.7, 0.0)) == "box_0001"


def test_a_scanned_room_is_hollow_to_the_touch() -> None:
    built = room()
    assert touched(built, Pose2(-2.0, 1.0, 0.5)) is None
    assert touched(built, Pose2(3.0, -1.0, 0.0)) is None
    assert touched(built, Pose2(-0.5, -0.5, 0.0)) is None  # under the table: its top is higher than the robot
    assert touched(built, Pose2(-1.0, -0.9, 0.0)).startswith("mesh_0000_part")  # a table leg
    assert touched(built, Pose2(-3.65, 1.0, 3.0)) is None
    assert touched(built, Pose2(-3.8, 1.0, 3.1)).startswith("mesh_0000_part")  # the wall at x = -4
    assert touched(built, Pose2(2.4, -2.0, 0.0)) == "cylinder_0001"


def test_contact_boxes_of_a_mesh_cover_its_surface_by_at_most_a_cell() -> None:
    a, b, c, d = (0.0, 0.0, 0.0), (3.0, 1.0, 0.0), (3.0, 1.0, 1.0), (0.0, 0.0, 1.0)
    mesh = Mesh(np.array([a, b, c, d]), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))
    columns = mesh_columns(mesh)
    wall = np.linspace(a[:2], b[:2], 500)
    gaps = [min(_distance(column, point) for column in columns) for point in wall]
    assert max(gaps) < 0.01
    for column in columns:  # every corner of a box lies within a cell's diagonal of the wall
        for sx in (-1, 1):
            for sy in (-1, 1):
                corner = (column.x + sx * column.length / 2, column.y + sy * column.width / 2)
                assert abs(corner[0] - 3 * corner[1]) / np.sqrt(10) <= 0.05 * np.sqrt(2) + 1e-9
        assert column.bottom <= 0.05  # reaches below the chassis
        assert column.bottom + column.height >= 0.25  # and as high as it


def _distance(box: Box, point: np.ndarray) -> float:
    """From a point to a box in the plane [m]; zero inside."""
    dx = max(abs(point[0] - box.x) - box.length / 2, 0.0)
    dy = max(abs(point[1] - box.y) - box.width / 2, 0.0)
    return float(np.hypot(dx, dy))


def test_a_mesh_of_floor_alone_is_nothing_to_bump_into() -> None:
    corners = np.array([(0, 0, 0.01), (1, 0, 0.02), (0, 1, 0.01)], dtype=float)
    assert mesh_columns(Mesh(corners, np.array([[0, 1, 2]], dtype=np.int32))) == []


def test_compiling_400_cylinders_takes_well_under_a_second() -> None:
    built = cylinders(400)
    compile_world(built)
    begin = time.perf_counter()
    compile_world(built)
    assert time.perf_counter() - begin < 1.0


def test_the_same_world_compiles_to_the_same_model() -> None:
    first, second = (compile_world(everything()) for _ in range(2))
    sizes = [mujoco.mj_sizeModel(model) for model in (first, second)]
    assert sizes[0] == sizes[1]
    np.testing.assert_array_equal(first.geom_pos, second.geom_pos)
    np.testing.assert_array_equal(first.geom_size, second.geom_size)


def test_a_remembered_world_is_handed_out_as_a_copy() -> None:
    first = compile_world(cylinders(20))
    first.opt.timestep = 0.5
    assert compile_world(cylinders(20)).opt.timestep == 0.002
    assert compile_world(cylinders(20), timestep=0.005).opt.timestep == 0.005
