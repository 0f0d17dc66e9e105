"""The scan against geometry, against mj_ray, and against its own data sheet."""

from __future__ import annotations

import math
import time

import mujoco
import numpy as np
import pytest

from tests.robot.worlds import cylinders, world
from twin.arena import compile_world
from twin.robot.handles import RobotHandles
from twin.robot.lidar import Lidar, LidarConfig
from twin.world import Box, Cylinder, Obstacle

EXACT = LidarConfig(noise=0.0)
SENSOR = (0.055, 0.0)


def look(
    *obstacles: Obstacle, config: LidarConfig = EXACT, tilt: float = 0.0, mount: str = "ust10"
) -> tuple[Lidar, mujoco.MjData]:
    """The lidar of a robot at the origin, pitched nose down by `tilt` [rad]."""
    model = compile_world(world("look", *obstacles), lidar_mount=mount)
    robot, data = RobotHandles.resolve(model), mujoco.MjData(model)
    data.qpos[3:7] = (math.cos(tilt / 2), 0, math.sin(tilt / 2), 0)
    mujoco.mj_forward(model, data)
    return Lidar(model, robot, config), data


def bearings(config: LidarConfig = EXACT) -> np.ndarray:
    return np.linspace(-config.angle, config.angle, config.beams)


def test_the_scan_has_the_shape_of_its_driver() -> None:
    lidar, data = look(Cylinder(2.0, 0.0, 0.1, 0.5))
    scan = lidar.scan(data, np.random.default_rng(0))
    assert scan.ranges.shape == (720,)
    assert (scan.angle_min, scan.angle_max) == (-2.35619, 2.35619)
    assert (scan.range_min, scan.range_max) == (0.1, 30.0)
    assert scan.mount == pytest.approx((0.055, 0.0, 0.2414))
    assert not scan.ranges.flags.writeable
    np.testing.assert_allclose(scan.angles, bearings())


def test_beams_run_from_right_to_left() -> None:
    lidar, data = look(Cylinder(0.055, 2.0, 0.2, 0.5))
    seen = np.flatnonzero(np.isfinite(lidar.cast(data)))
    np.testing.assert_allclose(bearings()[seen].mean(), math.pi / 2, atol=0.01)


def test_a_cylinder_is_seen_as_a_circle() -> None:
    x, y, r = 1.7, 0.6, 0.3
    lidar, data = look(Cylinder(x, y, r, 0.5))
    dx, dy = x - SENSOR[0], y - SENSOR[1]
    along = dx * np.cos(bearings()) + dy * np.sin(bearings())
    square = along**2 - (dx * dx + dy * dy - r * r)
    expected = np.where((square > 0) & (along > 0), along - np.sqrt(np.maximum(square, 0)), np.inf)
    np.testing.assert_allclose(lidar.cast(data), expected, atol=1e-9)


def test_a_box_is_seen_as_a_turned_rectangle() -> None:
    box = Box(1.5, -0.8, 0.6, 0.8, 0.4, 0.5)
    lidar, data = look(box)
    c, s = math.cos(-box.yaw), math.sin(-box.yaw)
    turn = np.array([[c, -s], [s, c]])
    origin = turn @ (np.array(SENSOR) - (box.x, box.y))
    rays = np.column_stack([np.cos(bearings()), np.sin(bearings())]) @ turn.T
    half = np.array([box.length, box.width]) / 2
    near, far = np.sort([(-half - origin) / rays, (half - origin) / rays], axis=0)  # slabs
    enter, leave = near.max(axis=1), far.min(axis=1)
    expected = np.where((enter < leave) & (enter > 0), enter, np.inf)
    np.testing.assert_allclose(lidar.cast(data), expected, atol=1e-9)


def test_the_beam_passes_over_what_is_lower_and_under_what_is_higher() -> None:
    height = 0.0635 + 0.2414
    lidar, data = look(Cylinder(2.0, 0.0, 0.3, height - 0.01), Box(0.0, 2.0, 0.0, 1.0, 1.0, 2.0, bottom=height + 0.01))
    assert np.all(np.isinf(lidar.cast(data)))


@pytest.mark.parametrize("mount", ["ust10", "lms1xx"])
def test_the_robot_never_sees_itself(mount: str) -> None:
    lidar, data = look(mount=mount)
    assert np.all(np.isinf(lidar.cast(data)))
    robot = lidar.handles
    assert not np.any(np.isin(lidar.model.geom_group[robot.is_robot], np.flatnonzero(lidar.visible)))
    rng = np.random.default_rng(0)
    for _ in range(50):  # nor at any joint angle or attitude: only the floor remains
        data.qpos[:3] = (0, 0, 1.0)
        data.qpos[3:] = rng.normal(size=len(data.qpos) - 3)
        mujoco.mj_forward(lidar.model, data)
        lidar.cast(data)
        assert set(lidar.geoms[lidar.geoms >= 0].tolist()) <= {robot.floor}


@pytest.mark.parametrize("tilt", [0.02, 0.1, 0.3])
def test_a_tilted_robot_sees_the_floor_where_it_is(tilt: float) -> None:
    lidar, data = look(tilt=tilt)
    sensor = data.site_xpos[lidar.handles.lidar]
    slope = math.sin(tilt) * np.cos(bearings())  # descent per metre along each beam
    with np.errstate(divide="ignore"):
        expected = np.where(slope > 1e-9, sensor[2] / slope, np.inf)
    np.testing.assert_allclose(lidar.cast(data), expected, rtol=1e-6)
    scan = lidar.scan(data, np.random.default_rng(0))
    np.testing.assert_allclose(scan.ranges, np.where(expected <= 30.0, expected, np.inf), rtol=1e-6)


def test_returns_outside_the_range_are_none() -> None:
    # the near one starts 5 cm ahead of the sensor, the far one beyond 30 m but with its bounding sphere within
    lidar, data = look(Box(0.155, 0.0, 0.0, 0.1, 0.3, 0.5), Box(31.055, 0.0, 0.0, 1.0, 0.2, 0.5))
    exact, scan = lidar.cast(data), lidar.scan(data, np.random.default_rng(0))
    assert exact.min() == pytest.approx(0.05, abs=1e-6)
    assert np.all(np.isinf(scan.ranges[exact < 0.1]))
    assert np.all(scan.ranges[np.isfinite(scan.ranges)] >= 0.1)
    lidar, data = look(Box(31.055, 0.0, 0.0, 1.0, 0.2, 0.5))
    assert np.all(np.isinf(lidar.scan(data, np.random.default_rng(0)).ranges))


def test_noise_is_a_millimetre_and_comes_from_the_generator() -> None:
    lidar, data = look(*(Cylinder(3 * math.cos(a), 3 * math.sin(a), 0.5, 0.5) for a in np.arange(-2.3, 2.4, 0.2)))
    noisy = Lidar(lidar.model, lidar.handles)
    rng = np.random.default_rng(2)
    errors = np.concatenate([noisy.scan(data, rng).ranges - lidar.cast(data) for _ in range(20)])
    errors = errors[np.isfinite(errors)]
    assert len(errors) > 5000
    assert errors.std() == pytest.approx(0.001, rel=0.05)
    assert abs(errors.mean()) < 1e-4
    first, again = (noisy.scan(data, np.random.default_rng(9)).ranges for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_a_scan_of_400_cylinders_is_quick() -> None:
    model = compile_world(cylinders(400))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    lidar, rng = Lidar(model, RobotHandles.resolve(model)), np.random.default_rng(0)
    fastest = np.inf
    for _ in range(30):
        begin = time.perf_counter()
        lidar.scan(data, rng)
        fastest = min(fastest, time.perf_counter() - begin)
    assert fastest < 2e-3  # 0.5 ms on a quiet core
