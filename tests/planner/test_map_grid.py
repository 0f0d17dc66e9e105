"""Laws of the path and goal grids."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.plain import map_grid as plain
from tests.planner.random_scenes import RESOLUTION, random_call
from twin.planner.footprint import FOOTPRINT
from twin.planner.inflation import Costmap, InflationParams
from twin.planner.map_grid import MapGrids, map_grids
from twin.planner.wave import BLOCKED, UNMET, at_least, clear, empty_wave, finish, grid_value, reach, seed
from twin.records import Pose2


def costmap_of(cells: np.ndarray, origin: tuple[float, float] = (0.0, 0.0)) -> Costmap:
    """A costmap with these cells."""
    return Costmap(cells.astype(np.uint8), origin, RESOLUTION, InflationParams(0.3), (0.0, 0.0, 0.0, 0.0), None)


def centre(x: int, y: int) -> tuple[float, float]:
    """World position of the middle of a cell, for a map at the origin."""
    return ((x + 0.5) * RESOLUTION, (y + 0.5) * RESOLUTION)


FAR = Pose2(0.5, 1.5, 0.0)  # a robot that is not in the way


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**9))
def test_equal_to_the_plain_version(seed_: int) -> None:
    call = random_call(seed_)
    grids = map_grids(call.costmap, call.pose, call.plan)
    within = grids.within_robot.astype(bool)
    targets = plain.plan_cells(call.costmap, call.plan)
    assert np.array_equal(grids.path, plain.grid(call.costmap, targets, within))
    assert np.array_equal(grids.goal, plain.grid(call.costmap, targets[-1:], np.zeros_like(within)))
    if targets:
        x, y = targets[-1]
        assert grids.local_goal == pytest.approx(
            (call.costmap.origin[0] + (x + 0.5) * RESOLUTION, call.costmap.origin[1] + (y + 0.5) * RESOLUTION)
        )
    else:
        assert grids.local_goal is None


def test_free_cells_count_manhattan_steps() -> None:
    grids = map_grids(costmap_of(np.zeros((40, 60))), FAR, np.array([centre(50, 10)]))
    ys, xs = np.mgrid[0:40, 0:60]
    expected = np.abs(xs - 50) + np.abs(ys - 10)
    assert np.array_equal(grids.goal, expected)
    assert np.array_equal(grids.path, expected)
    assert grids.local_goal == pytest.approx(centre(50, 10))


def test_grids_turn_with_the_world() -> None:
    """A quarter turn of map and plan turns the grids."""
    rng = np.random.default_rng(1)
    cells = np.where(rng.random((50, 50)) < 0.2, 254, 0)
    plan = np.array([centre(x, 12) for x in range(5, 45)])
    turned = np.stack([50 * RESOLUTION - plan[:, 1], plan[:, 0]], axis=1)
    middle = 25 * RESOLUTION + 0.001  # off the cell borders
    a = map_grids(costmap_of(cells), Pose2(middle, middle, 0.3), plan)
    b = map_grids(
        costmap_of(np.rot90(cells, -1).copy()),
        Pose2(50 * RESOLUTION - middle, middle, 0.3 + math.pi / 2),
        turned,
    )
    assert np.array_equal(np.rot90(a.goal, -1), b.goal)
    assert np.array_equal(np.rot90(a.path, -1), b.path)


def walled() -> tuple[MapGrids, np.ndarray]:
    """A robot standing on a wall that cuts the map; the plan crosses the wall under the robot."""
    cells = np.zeros((60, 60))
    cells[:, 30] = 253
    plan = np.array([centre(x, 30) for x in range(20, 41)])
    return map_grids(costmap_of(cells), Pose2(*centre(30, 30), 0.0), plan), cells


def test_only_the_path_grid_passes_under_the_robot() -> None:
    grids, _ = walled()
    assert grids.within_robot[30, 30] == 1
    assert grids.path[33, 30] == 3  # beside the plan, on the wall, under the robot
    assert grids.goal[30, 30] == 3600  # an obstacle to the goal grid
    assert grids.goal[30, 20] == 3601  # and nothing behind it is reached
    assert grids.path[50, 30] == 3600  # beyond the footprint the wall stops the path wave as well


def test_targets_are_zero_even_on_obstacles() -> None:
    cells = np.zeros((40, 40))
    cells[20, :] = 254
    grids = map_grids(costmap_of(cells), FAR, np.array([centre(10, 20)]))
    assert grids.goal[20, 10] == 0
    assert grids.goal[21, 10] == 1
    assert grids.goal[20, 11] == 1600


def test_the_run_of_plan_points_ends_where_it_leaves_the_map_and_never_resumes() -> None:
    out_and_back = np.array([(-0.1, 0.5), centre(0, 10), centre(1, 10), (-0.3, 0.5), centre(5, 30)])
    grids = map_grids(costmap_of(np.zeros((40, 40))), FAR, out_and_back)
    assert grids.goal[10, 0] == 0  # the last cell before leaving: dense points fill the gap back to the edge
    assert grids.path[30, 5] > 0


def test_unknown_cells_end_the_run() -> None:
    cells = np.zeros((40, 40))
    cells[:, 20] = 255
    grids = map_grids(costmap_of(cells), FAR, np.array([centre(x, 10) for x in range(5, 35)]))
    assert grids.goal[10, 19] == 0
    assert (grids.path[:, 21:] == 1601).all()


def test_no_point_on_the_map_leaves_everything_unreached() -> None:
    grids = map_grids(costmap_of(np.zeros((40, 40))), FAR, np.array([[-5.0, -5.0], [-4.0, -5.0]]))
    assert grids.local_goal is None
    assert (grids.path == 1601).all()
    assert (grids.goal == 1601).all()


def test_the_plan_is_made_dense() -> None:
    grids = map_grids(costmap_of(np.zeros((40, 60))), FAR, np.array([centre(5, 20), centre(45, 20)]))
    assert (grids.path[20, 5:46] == 0).all()


def test_within_robot_is_the_padded_footprint() -> None:
    grids = map_grids(costmap_of(np.zeros((60, 60))), Pose2(*centre(30, 30), 0.0), np.array([centre(1, 1)]))
    ys, xs = np.nonzero(grids.within_robot)
    half_x, half_y = FOOTPRINT[2]
    assert (xs.min(), xs.max()) == (int((1.525 - half_x) / RESOLUTION), int((1.525 + half_x) / RESOLUTION))
    assert (ys.min(), ys.max()) == (int((1.525 - half_y) / RESOLUTION), int((1.525 + half_y) / RESOLUTION))
    assert len(xs) == (xs.max() - xs.min() + 1) * (ys.max() - ys.min() + 1)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**9), st.lists(st.integers(0, 10**6), min_size=1, max_size=20))
def test_a_wave_asked_bit_by_bit_tells_what_a_finished_one_does(seed_: int, picks: list[int]) -> None:
    cells = random_call(seed_).costmap.cells
    ny, nx = cells.shape
    whole, stepwise = empty_wave(ny, nx), empty_wave(ny, nx)
    begin = (picks[0] // nx % ny + 1) * (nx + 2) + picks[0] % nx + 1
    for wave in (whole, stepwise):
        clear(wave, cells)
        seed(wave, begin)
    finish(whole)
    for pick in picks:
        index = (pick // nx % ny + 1) * (nx + 2) + pick % nx + 1
        bound = at_least(stepwise, index)
        final = int(whole.value[index])
        assert bound <= final if final >= 0 else bound < 0 or final == UNMET
        assert grid_value(stepwise, index, ny * nx) == grid_value(whole, index, ny * nx)
        assert reach(stepwise, index) == final
        assert final in (UNMET, BLOCKED) or final >= 0
