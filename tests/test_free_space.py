"""The true distance map against closed forms and against exact distances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.free_space import HORIZON, free_space, mesh_points, obstacle_distance
from twin.records import Pose2
from twin.world import Box, Cylinder, Mesh, Obstacle, Rules, World

RULES = Rules("course", 0.5, 100.0)


def world(*obstacles: Obstacle) -> World:
    return World("test", obstacles, Pose2(-2.0, -2.0, 0.0), Pose2(2.0, 2.0, 0.0), RULES)


def wall_mesh(x: float, low: float, high: float) -> Mesh:
    """A wall across x, 2 m long, between two heights."""
    vertices = np.array([[x, -1, low], [x, 1, low], [x, 1, high], [x, -1, high]], dtype=float)
    return Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))


numbers = st.floats(-1.5, 1.5)
sizes = st.floats(0.02, 1.0)
obstacles = st.one_of(
    st.builds(Cylinder, numbers, numbers, sizes, st.just(1.0)),
    st.builds(Box, numbers, numbers, st.floats(-4, 4), sizes, sizes, st.just(1.0)),
)


@settings(max_examples=40, deadline=None)
@given(st.lists(obstacles, max_size=4), st.floats(-2.5, 2.5), st.floats(-2.5, 2.5))
def test_grid_agrees_with_exact_distances(some: list[Obstacle], x: float, y: float) -> None:
    point = np.array([[x, y]])
    exact = min(float(obstacle_distance(some, point)[0]), HORIZON)
    # the cell's centre is at most half a diagonal away
    assert free_space(world(*some), 0.04).at(point)[0] == pytest.approx(exact, abs=0.04 / math.sqrt(2) + 1e-9)


@given(numbers, numbers, st.floats(-4, 4), sizes, sizes, st.floats(-4, 4))
def test_box_distance_does_not_depend_on_the_frame(
    x: float, y: float, yaw: float, length: float, width: float, turn: float
) -> None:
    """Turning box and point together about the origin keeps their distance."""
    point = np.array([[0.7, -0.4]])
    c, s = math.cos(turn), math.sin(turn)
    turned = Box(c * x - s * y, s * x + c * y, yaw + turn, length, width, 1.0)
    before = obstacle_distance([Box(x, y, yaw, length, width, 1.0)], point)
    assert obstacle_distance([turned], point @ np.array([[c, s], [-s, c]])) == pytest.approx(before)


def test_closed_forms() -> None:
    points = np.array([[3.0, 0.0], [0.0, 0.0], [3.0, 3.0]])
    assert obstacle_distance([Cylinder(0, 0, 1.0, 1.0)], points) == pytest.approx([2, -1, math.hypot(3, 3) - 1])
    assert obstacle_distance([Box(0, 0, 0, 2, 4, 1)], points) == pytest.approx([2, -1, math.hypot(2, 1)])
    assert np.isinf(obstacle_distance([], points)).all()


def test_only_what_the_robot_can_hit_counts() -> None:
    point = np.array([[0.0, 0.0]])
    assert np.isinf(obstacle_distance([Box(0, 0, 0, 1, 1, 0.1, bottom=0.5)], point))[0]
    assert obstacle_distance([Box(0, 0, 0, 1, 1, 0.5, bottom=0.3)], point)[0] < 0
    assert len(mesh_points(wall_mesh(0, 0.5, 2.0), 0.05)) == 0
    assert len(mesh_points(wall_mesh(0, -1.0, 0.01), 0.05)) == 0
    assert len(mesh_points(wall_mesh(0, 0.0, 2.0), 0.05)) > 0


def test_mesh_is_sampled_without_gaps() -> None:
    points = mesh_points(wall_mesh(1.0, 0.0, 2.5), 0.05)
    assert points[:, 0] == pytest.approx(1.0, abs=0.0125)
    gaps = np.diff(np.unique(points[:, 1]))
    assert gaps.max() <= 0.05
    assert (points[:, 1].min(), points[:, 1].max()) == pytest.approx((-1, 1), abs=0.05)
    assert free_space(world(wall_mesh(1.0, 0.0, 2.5))).at(np.array([[0.0, 0.0]]))[0] == pytest.approx(1.0, abs=0.06)


def test_reachable_needs_room() -> None:
    def door(gap: float) -> World:
        hall = [Box(x, y, 0, *size, 1) for x, y, size in ((3, 0, (0.1, 6)), (-3, 0, (0.1, 6)), (0, 3, (6, 0.1)))]
        half = (6.0 - gap) / 2
        sides = [Box(0, y, 0, 0.1, half, 1) for y in ((gap + half) / 2, -(gap + half) / 2)]
        return world(*hall, Box(0, -3, 0, 6, 0.1, 1), *sides)

    for gap, passes in ((0.9, True), (0.5, False)):
        space = free_space(door(gap))
        cell = tuple(space.cells(np.array([[2.0, 2.0]]))[0])
        assert bool(space.reachable(Pose2(-2, -2, 0), 0.3)[cell]) is passes


def test_start_without_room_reaches_nothing() -> None:
    w = World("test", (Box(0, 0, 0, 1, 1, 1),), Pose2(0, 0, 0), Pose2(2, 2, 0), RULES)
    assert not free_space(w).reachable(w.start, 0.2).any()


def test_enormous_world_is_refused() -> None:
    far = World("test", (), Pose2(0, 0, 0), Pose2(900, 900, 0), RULES)
    with pytest.raises(ValueError, match="too large"):
        free_space(far)
