"""Laws of the global planner."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.plain import navfn as plain
from twin.planner.inflation import Costmap
from twin.planner.navfn import make_plan, navfn
from twin.planner.navfn_wave import cost_tables, field, propagate
from twin.records import Bytes, Pose2


def random_costs(seed: int, ny: int, nx: int, walls: float) -> Bytes:
    random = np.random.default_rng(seed)
    cells = random.choice(np.array([0, 0, 0, 60, 177, 241, 252], dtype=np.uint8), (ny, nx))
    cells[random.random((ny, nx)) < walls] = 254
    cells[random.random((ny, nx)) < 0.02] = 253
    cells[random.random((ny, nx)) < 0.05] = 255
    return cells


def test_cost_translation() -> None:
    enter = cost_tables(True).enter
    assert (enter[0], enter[100], enter[252]) == (50, 130, 251)
    assert (enter[253], enter[254]) == (254, 254)
    assert (enter[255], cost_tables(False).enter[255]) == (253, 254)
    assert (np.diff(enter[:253]) >= 0).all()


def test_the_straight_way_in_open_space() -> None:
    result = navfn(np.zeros((60, 60), dtype=np.uint8), (30, 30), (50, 30))
    assert result.found
    assert result.path[0].tolist() == [50, 30]
    assert result.path[-1].tolist() == [30, 30]
    assert np.allclose(result.path[:, 1], 30)
    steps = np.linalg.norm(np.diff(result.path, axis=0), axis=1)
    assert np.allclose(steps[:-1], 0.5) or steps.max() <= 1.5
    assert result.potential[30, 30] == 0
    assert result.potential[30, 35] == 250


def test_the_wave_stops_when_it_has_reached_the_goal() -> None:
    potential = navfn(np.zeros((200, 200), dtype=np.uint8), (100, 100), (110, 100)).potential
    assert (potential[:, 130:] == np.float32(1e10)).all()


def test_every_reached_cell_costs_more_than_its_cheapest_neighbour() -> None:
    potential = navfn(random_costs(3, 50, 50, 0.1), (25, 25), (48, 48)).potential
    best = np.full((50, 50), np.inf)
    for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        best = np.minimum(best, np.roll(potential, (dy, dx), (0, 1)))
    reached = (potential < 1e10) & (potential > 0)
    assert reached.sum() > 500
    assert (potential[reached] >= best[reached] + 0.704 * 50 - 0.01).all()


def test_a_wall_is_not_crossed_and_its_gap_is_found() -> None:
    cells = np.zeros((60, 60), dtype=np.uint8)
    cells[:, 30] = 254
    assert not navfn(cells, (10, 30), (50, 30)).found
    assert len(navfn(cells, (10, 30), (50, 30)).path) == 0
    cells[50, 30] = 0
    path = navfn(cells, (10, 30), (50, 30)).path
    through = path[np.abs(path[:, 0] - 30) < 0.5]
    assert len(through) > 0
    assert (np.abs(through[:, 1] - 50) < 1).all()


@pytest.mark.parametrize(("byte", "passes"), [(252, True), (253, False), (254, False), (255, True)])
def test_what_may_be_crossed(byte: int, passes: bool) -> None:
    cells = np.zeros((20, 20), dtype=np.uint8)
    cells[:, 10] = byte
    assert navfn(cells, (5, 10), (15, 10)).found is passes
    assert navfn(cells, (5, 10), (15, 10), allow_unknown=False).found is (byte == 252)


def test_the_edge_of_the_map_is_closed() -> None:
    cells = np.zeros((20, 20), dtype=np.uint8)
    assert not navfn(cells, (5, 10), (0, 10)).found
    assert navfn(cells, (0, 10), (5, 10)).found


def test_start_and_goal_in_one_cell() -> None:
    result = navfn(np.zeros((20, 20), dtype=np.uint8), (7, 8), (7, 8))
    assert result.found
    assert result.path.tolist() == [[7, 8]]


def test_mirroring_the_map_mirrors_the_field() -> None:
    cells = random_costs(5, 40, 40, 0.05)
    cells[20, 20] = cells[35, 20] = 0
    one = navfn(cells, (20, 20), (20, 35))
    # The queue order breaks the symmetry, so only the values far from the front agree.
    other = navfn(np.ascontiguousarray(cells[:, ::-1]), (19, 20), (19, 35))
    assert one.found is other.found
    both = (one.potential < 500) & (other.potential[:, ::-1] < 500)
    assert both.sum() > 50
    assert np.allclose(one.potential[both], other.potential[:, ::-1][both], rtol=0.05)


@given(st.integers(0, 2**32 - 1), st.integers(5, 40), st.integers(5, 40), st.booleans(), st.data())
@settings(deadline=None, max_examples=200)
def test_equals_the_plain_version(seed: int, ny: int, nx: int, allow_unknown: bool, data: st.DataObject) -> None:
    cells = random_costs(seed, ny, nx, data.draw(st.sampled_from([0.0, 0.1, 0.3])))
    cell = st.tuples(st.integers(0, nx - 1), st.integers(0, ny - 1))
    robot, goal = data.draw(cell), data.draw(cell)
    before = cells.copy()
    ours = navfn(cells, robot, goal, allow_unknown)
    found, path, potential = plain.plan(cells, robot, goal, allow_unknown)
    assert ours.found == found
    assert np.array_equal(ours.potential, potential)
    assert np.array_equal(ours.path, path)
    assert np.array_equal(cells, before)


@given(st.integers(0, 2**32 - 1), st.integers(4, 40))
@settings(deadline=None, max_examples=60)
def test_full_queues_drop_the_same_cells_as_the_plain_version(seed: int, capacity: int) -> None:
    cells = random_costs(seed, 30, 30, 0.05)
    cost, memory = cost_tables(True), field(30, 30, capacity)
    for source, goal in ((465, 840), (465, 32)):  # twice, so that the second finds clean memory or fails
        propagate(
            cells,
            source,
            goal,
            cost.enter,
            cost.margin,
            memory.potentials,
            memory.vacant,
            memory.queues,
            memory.dirty,
        )
        expected = plain.propagate(plain.translate(cells, True), source, goal, capacity)
        assert np.array_equal(memory.potentials, expected)


@given(st.lists(st.integers(0, 2**32 - 1), min_size=2, max_size=4))
@settings(deadline=None, max_examples=20)
def test_a_plan_does_not_depend_on_the_one_before(seeds: list[int]) -> None:
    def solve(seed: int) -> tuple[bytes, bytes]:
        random = np.random.default_rng(seed)
        robot, goal = random.integers(0, 40, 2).tolist(), random.integers(0, 40, 2).tolist()
        result = navfn(random_costs(seed, 40, 40, 0.2), (robot[0], robot[1]), (goal[0], goal[1]))
        return result.path.tobytes(), result.potential.tobytes()

    forwards = [solve(seed) for seed in seeds]
    backwards = [solve(seed) for seed in reversed(seeds)]
    assert forwards == backwards[::-1]


def costmap(cells: Bytes) -> Costmap:
    return Costmap(cells, (-1.0, -2.0), 0.05)


def test_the_plan_starts_half_a_cell_off_the_robots_cell_and_ends_exactly_at_the_goal() -> None:
    goal = Pose2(0.512, 0.134, 0.7)
    plan, _ = make_plan(costmap(np.zeros((100, 80), dtype=np.uint8)), Pose2(-0.36, -1.07, 2.0), goal)
    assert plan is not None
    assert plan[0].tolist() == pytest.approx([-1.0 + 12 * 0.05, -2.0 + 18 * 0.05, 0.0])
    assert plan[-1].tolist() == [goal.x, goal.y, goal.yaw]
    assert plan[-2].tolist() == pytest.approx([-1.0 + 30 * 0.05, -2.0 + 42 * 0.05, 0.0])
    assert (plan[:-1, 2] == 0).all()
    assert not plan.flags.writeable
    assert len(plan) > math.hypot(18, 24)


def test_the_robots_cell_is_freed_in_the_costmap_left_behind() -> None:
    cells = np.zeros((100, 80), dtype=np.uint8)
    cells[18, 12] = 254
    before = costmap(cells)
    plan, after = make_plan(before, Pose2(-0.36, -1.07, 0.0), Pose2(0.5, 0.1, 0.0))
    assert plan is not None
    assert before.cells[18, 12] == 254
    assert after.cells[18, 12] == 0
    assert np.count_nonzero(after.cells) == 0
    assert make_plan(after, Pose2(-0.36, -1.07, 0.0), Pose2(0.5, 0.1, 0.0))[1] is after


def test_planning_fails_off_the_map_and_without_a_way() -> None:
    cells = np.zeros((100, 80), dtype=np.uint8)
    cells[18, 12] = 254
    inside, outside = Pose2(-0.36, -1.07, 0.0), Pose2(5.0, 0.0, 0.0)
    before = costmap(cells)
    assert make_plan(before, outside, inside) == (None, before)
    plan, after = make_plan(before, inside, outside)
    assert plan is None
    assert after.cells[18, 12] == 0  # freed before the goal is looked at
    walled = costmap(np.full((100, 80), 254, dtype=np.uint8))
    assert make_plan(walled, inside, Pose2(0.5, 0.1, 0.0))[0] is None
