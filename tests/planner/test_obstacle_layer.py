"""Laws of the obstacle layer."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.plain import obstacle_layer as plain
from twin.planner.map_frame import rolled_origin, shifted
from twin.planner.obstacle_layer import (
    LOCAL_MAP,
    MapSpec,
    Points,
    ScanSource,
    clear_outside,
    empty_map,
    scan_points,
    update_obstacles,
)
from twin.records import ObstacleMap, Pose2, Scan

FIXED = MapSpec(160, 160, 0.05, (-4.0, -4.0), rolling=False)
HERE = Pose2(0.01, 0.01, 0.0)
SENSOR = (0.01, 0.01, 0.2)
NO_FOOTPRINT = ScanSource(footprint_clearing_enabled=False)


def points(*rows: tuple[float, float]) -> Points:
    return np.array([(x, y, 0.2) for x, y in rows], dtype=np.float32).reshape(-1, 3)


def see(before: ObstacleMap, *rows: tuple[float, float], source: ScanSource = NO_FOOTPRINT) -> ObstacleMap:
    return update_obstacles(before, FIXED, points(*rows), SENSOR, HERE, source)


def cell(layer: ObstacleMap, x: float, y: float) -> int:
    return int(layer.cells[int((y - layer.origin[1]) / 0.05), int((x - layer.origin[0]) / 0.05)])


def full(value: int = 254) -> ObstacleMap:
    blank = empty_map(FIXED)
    return ObstacleMap(np.full_like(blank.cells, value), blank.origin, blank.resolution, blank.touched)


def test_a_return_is_marked_and_its_ray_cleared() -> None:
    layer = see(full(), (1.02, 0.01))
    assert cell(layer, 1.02, 0.01) == 254
    assert {cell(layer, x / 100, 0.01) for x in range(1, 100)} == {0}
    assert cell(layer, 1.07, 0.01) == 254  # beyond the hit nothing is known
    assert np.count_nonzero(layer.cells == 0) == 20


def test_rays_are_cleared_before_any_return_is_marked() -> None:
    near, far = (1.02, 0.01), (2.02, 0.01)
    assert cell(see(empty_map(FIXED), near, far), *near) == 254
    assert cell(see(empty_map(FIXED), far, near), *near) == 254


def test_nothing_is_marked_from_obstacle_range_on_nor_cleared_beyond_raytrace_range() -> None:
    assert cell(see(empty_map(FIXED), (2.505, 0.01)), 2.505, 0.01) == 254
    assert cell(see(empty_map(FIXED), (2.52, 0.01)), 2.52, 0.01) == 0
    layer = see(full(), (3.9, 0.01))
    assert cell(layer, 3.02, 0.01) == 0  # 60 cells from the sensor's
    assert cell(layer, 3.07, 0.01) == 254


def test_the_reach_of_clearing_is_euclidean() -> None:
    layer = see(full(), (3.9, 3.9))
    free = np.argwhere(layer.cells == 0) - 80
    assert free.max() == int(60 / math.hypot(77, 77) * 77)


@pytest.mark.parametrize("height", [-2.1, 2.1])
def test_points_at_other_heights_are_not_seen(height: float) -> None:
    point = np.array([[1.0, 0.0, height]], dtype=np.float32)
    layer = update_obstacles(full(), FIXED, point, SENSOR, HERE, NO_FOOTPRINT)
    assert (layer.cells == 254).all()


def test_the_squared_range_is_three_dimensional() -> None:
    point = np.array([[2.4, 0.0, 1.2]], dtype=np.float32)
    assert not update_obstacles(empty_map(FIXED), FIXED, point, SENSOR, HERE, NO_FOOTPRINT).cells.any()


def test_a_sensor_off_the_map_clears_nothing_but_marks() -> None:
    off = update_obstacles(full(0), FIXED, points((-3.99, 0.01)), (-4.2, 0.01, 0.2), HERE, NO_FOOTPRINT)
    assert cell(off, -3.99, 0.01) == 254
    assert off.touched == (np.float32(-3.99), np.float32(0.01), np.float32(-3.99), np.float32(0.01))
    assert (update_obstacles(full(), FIXED, points((-3.0, 0.01)), (-4.2, 0.01, 0.2), HERE, NO_FOOTPRINT).cells).all()


def test_a_ray_that_leaves_the_map_is_cleared_to_its_edge() -> None:
    sensor = (3.5, 0.01, 0.2)
    layer = update_obstacles(full(), FIXED, points((4.5, 0.01)), sensor, HERE, NO_FOOTPRINT)
    assert (layer.cells[80, 150:] == 0).all()
    assert layer.touched[2] == 4.0 - 0.001
    assert (update_obstacles(full(), FIXED, points((4.5, 9.01)), sensor, HERE, NO_FOOTPRINT).cells[:80]).all()


def test_touched_holds_the_sensor_the_rays_ends_and_the_footprint() -> None:
    layer = see(empty_map(FIXED), (1.5, 0.5), (-3.99, 0.01))
    assert layer.touched == pytest.approx((0.01 - 3.0, 0.01, 1.5, 0.5), abs=1e-6)
    with_footprint = see(empty_map(FIXED), source=ScanSource())
    assert with_footprint.touched == pytest.approx((-0.30, -0.255, 0.32, 0.275), abs=1e-6)


def test_what_gets_under_the_footprint_vanishes_unless_a_corner_is_off_the_map() -> None:
    layer = see(full(), source=ScanSource())
    assert not layer.cells[76:85, 75:86].any()
    assert np.count_nonzero(layer.cells == 0) < 200
    at_edge = update_obstacles(full(), FIXED, points(), SENSOR, Pose2(3.9, 0.0, 0.0))
    assert (at_edge.cells == 254).all()
    assert at_edge.touched[2] == 3.9 + 0.3099999949336052  # its corners count all the same


def test_updates_are_pure() -> None:
    before = full()
    copy = before.cells.copy()
    first, second = see(before, (1.0, 1.0)), see(before, (1.0, 1.0))
    assert np.array_equal(before.cells, copy)
    assert np.array_equal(first.cells, second.cells)
    assert first.touched == second.touched
    assert not first.cells.flags.writeable


@given(st.lists(st.tuples(st.floats(-6, 6), st.floats(-6, 6)), max_size=30))
def test_marks_last_until_a_ray_passes(seen: list[tuple[float, float]]) -> None:
    before = see(empty_map(FIXED), (1.0, 1.0))
    assert np.array_equal(see(before).cells, before.cells)  # a scan without returns neither marks nor clears
    again = see(see(before, *seen), *seen)
    assert np.array_equal(again.cells, see(before, *seen).cells)  # seeing the same twice changes nothing


def test_the_window_follows_by_whole_cells_towards_zero() -> None:
    origin, shift_x, shift_y = rolled_origin((0.0, 0.0), LOCAL_MAP, Pose2(0.0, 10.0, 0.0))
    assert (shift_x, shift_y) == (-99, 100)
    assert origin == (-99 * 0.05, 100 * 0.05)
    for dx in (0.0, -0.012, 0.087):  # the desired origin is 0.75 cells below the one reached, and may get to +-1
        same, *shift = rolled_origin(origin, LOCAL_MAP, Pose2(dx, 10.0, 0.0))
        assert (same, shift) == (origin, [0, 0]), dx
    assert rolled_origin(origin, LOCAL_MAP, Pose2(0.088, 10.0, 0.0))[1] == 1
    assert rolled_origin(origin, LOCAL_MAP, Pose2(-0.013, 10.0, 0.0))[1] == -1


@given(st.integers(-9, 9), st.integers(-9, 9))
def test_shifting_keeps_the_overlap_and_nothing_else(shift_x: int, shift_y: int) -> None:
    cells = np.arange(1, 49, dtype=np.uint8).reshape(6, 8)
    moved = shifted(cells, shift_x, shift_y)
    for y in range(6):
        for x in range(8):
            inside = 0 <= y + shift_y < 6 and 0 <= x + shift_x < 8
            assert moved[y, x] == (cells[y + shift_y, x + shift_x] if inside else 0)


def test_marks_stay_where_they_are_in_odom_while_the_window_rolls() -> None:
    layer = empty_map(LOCAL_MAP)
    for x in (0.0, 0.4, 0.8, 1.2):
        scan = points((2.02, 0.02)) if x == 0.0 else points()
        layer = update_obstacles(layer, LOCAL_MAP, scan, (x, 0.0, 0.2), Pose2(x, 0.0, 0.0))
    assert cell(layer, 2.02, 0.02) == 254
    assert np.count_nonzero(layer.cells) == 1


def test_the_clearing_recovery_keeps_the_square_and_marks_the_whole_map_once() -> None:
    layer = see(empty_map(FIXED), (0.5, 0.5), (1.5, 1.5))
    cleared = clear_outside(layer, HERE, 1.84)
    assert cell(cleared, 0.5, 0.5) == 254
    assert cell(cleared, 1.5, 1.5) == 255
    # From cell trunc((0.01 - 0.92 + 4) / 0.05) = 61 to trunc((0.01 + 0.92 + 4) / 0.05) = 98, both excluded.
    kept = np.argwhere(cleared.cells != 255)
    assert (kept.min(), kept.max()) == (62, 97)
    after = see(cleared)
    assert after.touched[:2] == (-4.0, -4.0)
    assert after.touched[2:] == pytest.approx((3.975, 3.975))
    assert see(after).touched == (0.01, 0.01, 0.01, 0.01)


def test_beams_without_a_return_give_no_point() -> None:
    ranges = np.array([0.05, 0.1, 1.0, 30.0, np.inf, np.nan])
    scan = Scan(ranges, -0.5, 0.5, 0.1, 30.0, (0.055, 0.0, 0.2))
    found, _ = scan_points(scan, Pose2(0.0, 0.0, 0.0))
    assert found.dtype == np.float32
    assert len(found) == 2


@given(st.floats(-20, 20), st.floats(-20, 20), st.floats(-4, 4))
def test_points_lie_at_their_range_and_bearing_from_the_sensor(x: float, y: float, yaw: float) -> None:
    scan = Scan(np.linspace(0.5, 5.0, 11), -2.0, 2.0, 0.1, 30.0, (0.055, 0.01, 0.2))
    found, sensor = scan_points(scan, Pose2(x, y, yaw))
    offset = found[:, :2].astype(np.float64) - sensor[:2]
    assert np.allclose(np.hypot(*offset.T), scan.ranges, atol=1e-5)
    turn = np.arctan2(offset[:, 1], offset[:, 0]) - yaw - scan.angles
    assert np.allclose(np.cos(turn), 1.0, atol=1e-6)
    assert math.hypot(sensor[0] - x, sensor[1] - y) == pytest.approx(math.hypot(0.055, 0.01))


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.floats(-4.5, 4.5), st.floats(-4.5, 4.5))
def test_equals_the_plain_version(seed: int, x: float, y: float) -> None:
    random = np.random.default_rng(seed)
    # Clustered, so that neighbouring beams share cells, and some of it off the map.
    angles = np.sort(random.uniform(-math.pi, math.pi, 60))
    ranges = random.uniform(0.2, 9.0, 60) * (random.random(60) < 0.5) + 2.0
    scan = np.zeros((60, 3), dtype=np.float32)
    scan[:, 0], scan[:, 1] = x + ranges * np.cos(angles), y + ranges * np.sin(angles)
    before = ObstacleMap(random.choice([0, 254, 255], (160, 160)).astype(np.uint8), (-4.0, -4.0), 0.05, (0, 0, 0, 0))
    cells, touched = plain.apply_scan(before.cells, FIXED, scan, (x, y, 0.2), ScanSource())
    layer = update_obstacles(before, FIXED, scan, (x, y, 0.2), HERE, NO_FOOTPRINT)
    assert np.array_equal(layer.cells, cells)
    assert layer.touched == touched
