"""Laws of the footprint on a grid."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.planner.footprint import (
    CIRCUMSCRIBED_RADIUS,
    FOOTPRINT,
    HITS_OBSTACLE,
    HITS_UNKNOWN,
    INSCRIBED_RADIUS,
    OFF_MAP,
    footprint_cells,
    footprint_cost,
    footprint_radii,
    line_cells,
    raster_capacity,
)
from twin.planner.grid import cell_distance, cell_to_world, clamped_axis_cell, size_in_metres, world_to_cell

SIZE = 60  # cells
RESOLUTION = 0.05
CENTRE = SIZE * RESOLUTION / 2
COORDINATE = st.integers(0, SIZE - 1)


def cost_at(cells: np.ndarray, x: float, y: float, yaw: float, footprint: np.ndarray = FOOTPRINT) -> int:
    return footprint_cost(cells, 0.0, 0.0, RESOLUTION, x, y, yaw, footprint)


def rastered(x: float, y: float, yaw: float, footprint: np.ndarray = FOOTPRINT) -> tuple[np.ndarray, bool]:
    buffer = np.empty(raster_capacity(footprint, RESOLUTION), dtype=np.int32)
    raster = footprint_cells(0.0, 0.0, RESOLUTION, SIZE, SIZE, x, y, yaw, footprint, buffer)
    return buffer[: raster.length], raster.complete


def corner_cells(x: float, y: float, yaw: float) -> list[tuple[int, int]]:
    c, s = math.cos(yaw), math.sin(yaw)
    return [
        world_to_cell(x + (px * c - py * s), y + (px * s + py * c), 0.0, 0.0, RESOLUTION, SIZE, SIZE)
        for px, py in FOOTPRINT
    ]


def test_constants_are_the_f32_ones_of_a_running_jackal() -> None:
    assert FOOTPRINT.tolist()[2] == [0.3099999949336052, 0.26500000804662704]
    assert np.sign(FOOTPRINT).tolist() == [[-1, -1], [-1, 1], [1, 1], [1, -1]]
    assert INSCRIBED_RADIUS == 0.26500000804662704
    assert CIRCUMSCRIBED_RADIUS == 0.4078296226655779


def test_radii_of_a_polygon_whose_nearest_point_is_a_corner() -> None:
    assert footprint_radii(np.array([[1.0, 0.0], [3.0, 4.0], [3.0, -4.0]])) == (1.0, 5.0)


@pytest.mark.parametrize(
    ("metres", "cells"),
    [(0.30, 6), (0.02, 1), (0.01, 1), (0.23, 5), (0.24, 5), (0.15, 3), (0.35, 7), (3.0, 60), (0.0, 0), (-1.0, 0)],
)
def test_cell_distance_rounds_up(metres: float, cells: int) -> None:
    assert cell_distance(metres, RESOLUTION) == cells


def test_a_map_is_half_a_cell_short() -> None:
    assert size_in_metres(200, 0.05) == pytest.approx(9.975)


@settings(deadline=None)  # the first example compiles
@given(COORDINATE, COORDINATE, st.floats(-50, 50))
def test_a_cells_centre_lies_in_the_cell(mx: int, my: int, origin: float) -> None:
    x, y = cell_to_world(mx, origin, RESOLUTION), cell_to_world(my, -origin, RESOLUTION)
    assert world_to_cell(x, y, origin, -origin, RESOLUTION, SIZE, SIZE) == (mx, my)


@pytest.mark.parametrize("w", [-1e-9, -1e30, 3.0, 1e30, math.nan])
def test_points_off_the_map_have_no_cell_on_either_axis(w: float) -> None:
    assert world_to_cell(w, 1.0, 0.0, 0.0, RESOLUTION, SIZE, SIZE) == (-1, -1)
    assert world_to_cell(1.0, w, 0.0, 0.0, RESOLUTION, SIZE, SIZE) == (-1, -1)


@pytest.mark.parametrize(("w", "cell"), [(-1e30, 0), (-0.01, 0), (0.26, 5), (2.99, 59), (3.0, 59), (1e30, 59)])
def test_enforced_bounds_clamp(w: float, cell: int) -> None:
    assert clamped_axis_cell(w, 0.0, RESOLUTION, SIZE) == cell


@settings(deadline=None)  # the first example compiles
@given(COORDINATE, COORDINATE, COORDINATE, COORDINATE)
def test_a_line_is_connected_and_as_long_as_its_longer_side(x0: int, y0: int, x1: int, y1: int) -> None:
    buffer = np.empty(3 + SIZE, dtype=np.int32)
    end = line_cells(x0, y0, x1, y1, SIZE, buffer, 3)
    xs, ys = buffer[3:end] % SIZE, buffer[3:end] // SIZE
    assert end - 3 == max(abs(x1 - x0), abs(y1 - y0)) + 1
    assert (xs[0], ys[0], xs[-1], ys[-1]) == (x0, y0, x1, y1)
    assert np.abs(np.diff(xs)).max(initial=0) <= 1
    assert np.abs(np.diff(ys)).max(initial=0) <= 1
    off_line = np.abs((x1 - x0) * (ys - y0) - (y1 - y0) * (xs - x0))
    assert off_line.max() <= max(abs(x1 - x0), abs(y1 - y0)) / 2 + 0.5


@settings(deadline=None)  # the first example compiles
@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-7, 7))
def test_the_raster_is_convex_by_column_and_counts_each_cell_once(dx: float, dy: float, yaw: float) -> None:
    cells, complete = rastered(CENTRE + dx, CENTRE + dy, yaw)
    assert complete
    assert len(set(cells.tolist())) == len(cells)
    grid = np.zeros((SIZE, SIZE), dtype=bool)
    grid.reshape(-1)[cells] = True
    for column in grid.T:
        assert len(np.flatnonzero(np.diff(column.astype(int)))) in (0, 2)
    # About as many cells as the polygon covers, and at most those its outline cuts besides.
    area = 4 * 0.31 * 0.265 / RESOLUTION**2
    assert area < len(cells) < area + 2 * (2 * 0.31 + 2 * 0.265) / RESOLUTION + 4


def test_an_axis_aligned_raster_is_the_rectangle_of_its_corner_cells() -> None:
    cells, _ = rastered(CENTRE + 0.025, CENTRE + 0.025, 0.0)
    assert sorted(set((cells % SIZE).tolist())) == list(range(24, 37))
    assert len(cells) == 13 * 11


@pytest.mark.parametrize(
    ("x", "yaw", "first_off"), [(0.1, 0.0, 0), (0.1, math.pi / 2, 1), (0.1, math.pi, 2), (0.3, math.radians(220.5), 3)]
)
def test_with_a_corner_off_the_map_only_the_edges_before_it_are_walked(x: float, yaw: float, first_off: int) -> None:
    cells, complete = rastered(x, CENTRE, yaw)
    assert not complete
    corners = corner_cells(x, CENTRE, yaw)
    assert corners.index((-1, -1)) == first_off
    expected: list[int] = []
    buffer = np.empty(100, dtype=np.int32)
    for k in range(1, first_off):
        expected += buffer[: line_cells(*corners[k - 1], *corners[k], SIZE, buffer, 0)].tolist()
    assert cells.tolist() == expected


def test_only_the_outline_counts_and_253_on_it_is_legal() -> None:
    cells = np.zeros((SIZE, SIZE), dtype=np.uint8)
    cells[30, 30] = 254  # under the robot's centre
    assert cost_at(cells, CENTRE + 0.025, CENTRE + 0.025, 0.0) == 0
    cells[30, 36] = 253  # on the front edge
    assert cost_at(cells, CENTRE + 0.025, CENTRE + 0.025, 0.0) == 253
    cells[31, 36] = 254
    assert cost_at(cells, CENTRE + 0.025, CENTRE + 0.025, 0.0) == HITS_OBSTACLE
    cells[31, 36] = 255
    assert cost_at(cells, CENTRE + 0.025, CENTRE + 0.025, 0.0) == HITS_UNKNOWN


def test_the_first_thing_the_walk_meets_decides() -> None:
    cells = np.zeros((SIZE, SIZE), dtype=np.uint8)
    y = 10.5 * RESOLUTION
    cells[10, 0] = 254  # on the first edge, left of the robot, before the walk leaves the map
    assert cost_at(cells, 0.31, y, 0.0) == HITS_OBSTACLE
    cells[10, 0] = 255
    assert cost_at(cells, 0.31, y, 0.0) == HITS_UNKNOWN
    assert cost_at(cells, 0.30, y, 0.0) == OFF_MAP  # a corner is off the map before anything is walked
    assert cost_at(cells, -0.01, y, 0.0) == OFF_MAP


@pytest.mark.parametrize(("byte", "cost"), [(0, 0), (252, 252), (253, HITS_OBSTACLE), (254, HITS_OBSTACLE), (255, -2)])
def test_without_a_polygon_the_centre_decides(byte: int, cost: int) -> None:
    cells = np.zeros((SIZE, SIZE), dtype=np.uint8)
    cells[30, 30] = byte
    assert cost_at(cells, CENTRE + 0.025, CENTRE + 0.025, 0.3, np.empty((0, 2))) == cost


@settings(deadline=None)  # the first example compiles
@given(st.floats(0.0, 3.0), st.floats(0.0, 3.0), st.floats(-7, 7), st.integers(0, 2**32 - 1))
def test_the_cost_is_that_of_the_worst_outline_cell(x: float, y: float, yaw: float, seed: int) -> None:
    cells = np.random.default_rng(seed).integers(0, 254, (SIZE, SIZE), dtype=np.uint8)
    cost = cost_at(cells, x, y, yaw)
    corners = corner_cells(x, y, yaw)
    if (-1, -1) in corners:
        assert cost == OFF_MAP
        return
    buffer = np.empty(400, dtype=np.int32)
    n = 0
    for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
        n = line_cells(x0, y0, x1, y1, SIZE, buffer, n)
    assert cost == cells.reshape(-1)[buffer[:n]].max()
