"""Laws of the inflated costmap."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.plain import inflation as plain
from twin.planner.inflation import Costmap, InflationParams, inflate, update_costmap
from twin.planner.inflation_wave import spread_tables
from twin.planner.map_frame import MapSpec
from twin.planner.obstacle_layer import clear_outside, empty_map, update_obstacles
from twin.records import Bytes, ObstacleMap, Pose2

FIXED = MapSpec(120, 120, 0.05, (-3.0, -3.0), rolling=False)
ROLLING = MapSpec(120, 120, 0.05, (0.0, 0.0), rolling=True)
RADII = st.sampled_from([0.0, 0.01, 0.05, 0.12, 0.25, 0.3, 0.33, 0.5, 0.7])


def whole(cells: Bytes) -> tuple[int, int, int, int]:
    return (0, 0, cells.shape[1], cells.shape[0])


def around_one_obstacle(radius: float) -> Bytes:
    cells = np.zeros((41, 41), dtype=np.uint8)
    cells[20, 20] = 254
    return inflate(cells, whole(cells), 0.05, InflationParams(radius))


def random_grid(seed: int, ny: int, nx: int, lethal: float) -> Bytes:
    random = np.random.default_rng(seed)
    cells = np.where(random.random((ny, nx)) < lethal, 254, 0).astype(np.uint8)
    cells[random.random((ny, nx)) < 0.03] = 255
    slope = random.random((ny, nx)) < 0.1
    cells[slope] = np.maximum(cells[slope], random.integers(0, 254, slope.sum()))
    return cells


def test_the_default_slope_of_the_jackal() -> None:
    cells = around_one_obstacle(0.30)
    assert set(cells.ravel().tolist()) == {0, 177, 193, 210, 241, 253, 254}
    assert cells[20, 20 + 5] == 253
    assert cells[21, 20 + 5] == 253  # sqrt(26) cells = 0.25495 m is inside the inscribed radius
    assert cells[22, 20 + 5] == 241
    assert cells[20, 20 + 6] == 177
    assert cells[20, 20 + 7] == 0


@pytest.mark.parametrize("radius", [0.23, 0.24, 0.25])
def test_up_to_five_cells_there_is_no_slope(radius: float) -> None:
    assert set(around_one_obstacle(radius).ravel().tolist()) == {0, 253, 254}


@pytest.mark.parametrize(("one", "same"), [(0.23, 0.25), (0.01, 0.05), (0.02, 0.05), (0.26, 0.30)])
def test_the_radius_only_counts_in_whole_cells(one: float, same: float) -> None:
    assert np.array_equal(around_one_obstacle(one), around_one_obstacle(same))


def test_radius_zero_does_nothing() -> None:
    assert np.count_nonzero(around_one_obstacle(0.0)) == 1


@pytest.mark.parametrize("radius", [0.01, 0.3, 0.5])
def test_one_obstacle_is_inflated_to_a_disc_with_the_symmetry_of_the_grid(radius: float) -> None:
    cells = around_one_obstacle(radius)
    y, x = np.mgrid[-20:21, -20:21]
    assert np.array_equal(cells > 0, np.hypot(x, y) <= math.ceil(radius / 0.05))
    for other in (cells.T, cells[::-1], cells[:, ::-1]):
        assert np.array_equal(cells, other)


@given(st.integers(0, 2**32 - 1), RADII)
@settings(deadline=None, max_examples=40)
def test_costs_never_exceed_those_of_the_exact_distance_and_rarely_fall_short(seed: int, radius: float) -> None:
    random = np.random.default_rng(seed)
    cells = np.where(random.random((40, 50)) < 0.03, 254, 0).astype(np.uint8)
    ours = inflate(cells, whole(cells), 0.05, InflationParams(radius))
    tables = spread_tables(math.ceil(radius / 0.05), 0.05, 10.0, InflationParams(radius).inscribed_radius)
    reach, side = tables.reach, 2 * tables.reach + 1
    exact = np.zeros((40 + 2 * reach, 50 + 2 * reach), dtype=np.uint8)
    stamp = tables.cost.reshape(side, side)
    for y, x in np.argwhere(cells == 254):
        part = exact[y : y + side, x : x + side]
        np.maximum(part, stamp, out=part)
    exact = exact[reach : reach + 40, reach : reach + 50]
    assert (ours <= exact).all()
    assert np.count_nonzero(ours != exact) <= 0.02 * exact.size
    assert np.array_equal(ours == 254, cells == 254)


def test_unknown_cells_only_take_inscribed_costs_unless_told() -> None:
    cells = np.full((21, 21), 255, dtype=np.uint8)
    cells[10, 10] = 254
    careful = inflate(cells, whole(cells), 0.05, InflationParams(0.3))
    assert (careful[10, 15], careful[10, 16], careful[10, 17]) == (253, 255, 255)
    eager = inflate(cells, whole(cells), 0.05, InflationParams(0.3, inflate_unknown=True))
    assert (eager[10, 15], eager[10, 16], eager[10, 17]) == (253, 177, 255)


def test_only_obstacles_within_reach_of_the_window_spread_and_not_only_into_it() -> None:
    cells = np.zeros((60, 60), dtype=np.uint8)
    cells[30, [10, 14, 40]] = 254
    out = inflate(cells, (20, 20, 30, 40), 0.05, InflationParams(0.3))
    assert out[30, 4:9].tolist() == [0, 0, 0, 0, 177]  # of the obstacles at 10 and 14 only the second is near enough
    assert out[30, 40 - 1] == 0
    assert out[30, 20] == 177


@given(st.integers(0, 2**32 - 1), st.integers(1, 33), st.integers(1, 41), RADII, st.booleans(), st.data())
@settings(deadline=None, max_examples=120)
def test_equals_the_plain_version(
    seed: int, ny: int, nx: int, radius: float, inflate_unknown: bool, data: st.DataObject
) -> None:
    cells = random_grid(seed, ny, nx, data.draw(st.sampled_from([0.01, 0.1, 0.5])))
    x0, x1 = sorted(data.draw(st.tuples(st.integers(0, nx), st.integers(0, nx))))
    y0, y1 = sorted(data.draw(st.tuples(st.integers(0, ny), st.integers(0, ny))))
    inflation = InflationParams(radius, data.draw(st.sampled_from([10.0, 3.0])), 0.13, inflate_unknown)
    before = cells.copy()
    ours = inflate(cells, (x0, y0, x1, y1), 0.05, inflation)
    assert np.array_equal(ours, plain.inflate(cells, (x0, y0, x1, y1), 0.05, inflation))
    assert np.array_equal(cells, before)


def test_a_reach_beyond_sixteen_bits_works() -> None:
    cells = np.zeros((5, 450), dtype=np.uint8)
    cells[2, 0] = 254
    out = inflate(cells, whole(cells), 0.05, InflationParams(22.0, cost_scaling_factor=0.1))
    assert np.count_nonzero(out[2]) == 441
    assert (np.diff(out[2].astype(int)) <= 0).all()


def drive(spec: MapSpec, radii: list[float], seed: int = 1) -> list[tuple[ObstacleMap, Costmap]]:
    """A robot that wanders among random returns, one update per radius."""
    random = np.random.default_rng(seed)
    layer, costmap, steps = empty_map(spec), None, []
    x = y = 0.0
    for radius in radii:
        x, y = x + random.uniform(-0.2, 0.2), y + random.uniform(-0.2, 0.2)
        angle, r = random.uniform(-2.3, 2.3, 40), random.uniform(0.5, 2.8, 40)
        points = np.stack([x + r * np.cos(angle), y + r * np.sin(angle), np.full(40, 0.2)], axis=1).astype(np.float32)
        layer = update_obstacles(layer, spec, points, (x, y, 0.2), Pose2(x, y, 0.3))
        costmap = update_costmap(costmap, layer, spec, radius)
        steps.append((layer, costmap))
    return steps


@pytest.mark.parametrize("spec", [FIXED, ROLLING])
def test_the_costmap_remembers_but_its_obstacles_are_the_layers(spec: MapSpec) -> None:
    for layer, costmap in drive(spec, [0.3] * 12):
        assert costmap.origin == layer.origin
        x0, y0, x1, y1 = costmap.window or (0, 0, 0, 0)
        lethal = costmap.cells[y0:y1, x0:x1] == 254
        assert np.array_equal(lethal, layer.cells[y0:y1, x0:x1] == 254)


def test_the_first_update_and_every_change_of_radius_cover_the_whole_map() -> None:
    windows = [costmap.window for _, costmap in drive(FIXED, [0.3, 0.3, 0.23, 0.23, 0.25, 0.25])]
    everything = (0, 0, 120, 120)
    assert [w == everything for w in windows] == [True, False, True, False, True, False]


def test_a_window_spans_this_update_and_the_last_one_and_the_radius() -> None:
    (first, _), (second, costmap) = drive(FIXED, [0.3, 0.3], seed=4)
    assert costmap.window is not None
    low_x = min(first.touched[0], second.touched[0]) - 0.3
    high_y = max(first.touched[3], second.touched[3]) + 0.3
    assert 0 < int((low_x + 3.0) / 0.05) == costmap.window[0]
    assert costmap.window[3] == int((high_y + 3.0) / 0.05) + 1 < 120


def test_outside_the_window_the_old_costs_stay() -> None:
    layer, costmap = drive(FIXED, [0.3])[-1]
    stale = Costmap(np.full_like(costmap.cells, 7), costmap.origin, 0.05, costmap.inflation, costmap.bounds)
    still = update_obstacles(layer, FIXED, np.empty((0, 3), np.float32), (0.0, 0.0, 0.2), Pose2(0.0, 0.0, 0.0))
    updated = update_costmap(stale, still, FIXED, 0.3)
    x0, y0, x1, y1 = updated.window or (0, 0, 0, 0)
    outside = np.ones((120, 120), dtype=bool)
    outside[y0 - 6 : y1 + 6, x0 - 6 : x1 + 6] = False
    assert outside.any()
    assert (updated.cells[outside] == 7).all()
    assert np.count_nonzero(updated.cells[y0:y1, x0:x1] == 7) == 0
    assert (stale.cells == 7).all()


def test_an_update_that_touched_nothing_leaves_the_costs() -> None:
    layer = empty_map(FIXED)
    first = update_costmap(None, layer, FIXED, 0.3)
    again = update_costmap(first, layer, FIXED, 0.3)
    assert again.window is None
    assert np.array_equal(again.cells, first.cells)


def test_updates_are_pure_and_repeatable() -> None:
    steps = drive(ROLLING, [0.3, 0.3, 0.1])
    (_, before), (layer, after) = steps[1], steps[2]
    assert np.array_equal(update_costmap(before, layer, ROLLING, 0.1).cells, after.cells)
    assert not after.cells.flags.writeable


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=15)
def test_a_rolling_map_shows_the_same_costs_as_a_fixed_one(seed: int) -> None:
    # A reset of everything: then neither map has a past, and only their frames differ.
    layer, fixed = drive(FIXED, [0.3] * 3, seed)[-1]
    fixed = update_costmap(None, layer, FIXED, 0.3)
    rolled, rolling = drive(ROLLING, [0.3] * 3, seed)[-1]
    rolling = update_costmap(None, rolled, ROLLING, 0.3)
    shift_x = round((rolled.origin[0] + 3.0) / 0.05)
    shift_y = round((rolled.origin[1] + 3.0) / 0.05)
    a = fixed.cells[max(0, shift_y) : 120 + min(0, shift_y), max(0, shift_x) : 120 + min(0, shift_x)]
    b = rolling.cells[max(0, -shift_y) : 120 + min(0, -shift_y), max(0, -shift_x) : 120 + min(0, -shift_x)]
    assume(((a == 254) == (b == 254)).all())  # points within an ulp of a cell border may change sides
    assert np.count_nonzero(a != b) <= 4


def test_after_the_clearing_recovery_the_whole_map_is_written_again() -> None:
    layer, costmap = drive(FIXED, [0.3])[-1]
    cleared = clear_outside(layer, Pose2(0.0, 0.0, 0.0), 1.0)
    blind = update_obstacles(cleared, FIXED, np.empty((0, 3), np.float32), (0.0, 0.0, 0.2), Pose2(0.0, 0.0, 0.0))
    updated = update_costmap(costmap, blind, FIXED, 0.3)
    assert updated.window == (0, 0, 120, 120)
    y, x = np.argwhere(updated.cells == 254).T
    assert (np.maximum(np.abs(x - 60), np.abs(y - 60)) <= 10).all()
    assert not (updated.cells == 255).any()
