"""The parts of the fast search: arcs in closed form agree with driven ones, doubt is voiced, the heap is a heap."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.planner.arcs import Motion, drive
from twin.planner.heap import empty_heap, pop, push
from twin.planner.params import PlannerParams
from twin.planner.sketch import (
    DOUBT,
    FARTHEST,
    OFF,
    UNCERTAIN,
    Posture,
    Start,
    certain_cell,
    posture,
    sin_cos,
    sketch,
    small_sin_cos,
)
from twin.planner.trajectory import LocalPlannerSettings
from twin.planner.trajectory_state import limits_of

ERROR = DOUBT / 100.0  # [cells] what sketch.py promises
CELLS_PER_METRE = 20.0


@settings(max_examples=300, deadline=None)
@given(
    x=st.floats(-FARTHEST, FARTHEST),
    yaw=st.floats(-math.pi, math.pi),
    v=st.floats(-1.0, 2.5),
    w=st.floats(-4.0, 4.0),
    target_v=st.floats(-0.5, 2.5),
    target_w=st.floats(-4.0, 4.0),
    acc_x=st.floats(0.1, 12.0),
    acc_theta=st.floats(0.5, 25.0),
    sim_time=st.floats(0.3, 3.0),
)
def test_sketched_points_lie_where_driven_ones_do(
    x: float,
    yaw: float,
    v: float,
    w: float,
    target_v: float,
    target_w: float,
    acc_x: float,
    acc_theta: float,
    sim_time: float,
) -> None:
    local = LocalPlannerSettings(acc_lim_x=acc_x, acc_lim_theta=acc_theta, sim_time=sim_time)
    limits = limits_of(PlannerParams(), local)
    points = np.empty((1000, 3))
    count = drive(limits, Motion(x, -x, yaw, v, 0.0, w), target_v, target_w, points)
    start = Start(Posture(0.0, 0.0, math.cos(yaw), math.sin(yaw)), v, w, CELLS_PER_METRE)
    arc = sketch(limits, start, target_v, target_w)
    assert arc.points == count
    if not arc.sane:
        return
    for k in range(count):
        at = posture(limits, start, arc, target_v, target_w, k)
        assert at.x == pytest.approx((points[k, 0] - x) * CELLS_PER_METRE, abs=ERROR)
        assert at.y == pytest.approx((points[k, 1] + x) * CELLS_PER_METRE, abs=ERROR)
        assert (at.c, at.s) == pytest.approx((math.cos(points[k, 2]), math.sin(points[k, 2])), abs=1e-10)


@settings(deadline=None)
@given(st.floats(-20.0, 20.0))
def test_sine_and_cosine(angle: float) -> None:
    assert sin_cos(angle) == pytest.approx((math.sin(angle), math.cos(angle)), abs=2e-12)
    small = angle * 0.005
    assert small_sin_cos(small) == pytest.approx((math.sin(small), math.cos(small)), abs=1e-12)


@settings(deadline=None)
@given(st.floats(-5.0, 55.0), st.floats(-ERROR, ERROR))
def test_a_certain_cell_is_the_cell_of_every_point_within_the_error(position: float, error: float) -> None:
    cell = certain_cell(position, 50)
    true = position + error
    if cell >= 0:
        assert cell == math.floor(true)
    elif cell == OFF:
        assert not 0.0 <= true < 50.0
    else:
        assert abs(position - round(position)) <= DOUBT


def test_borders_and_nonsense_are_uncertain() -> None:
    for position in (0.0, 7.0, 50.0, 7.0 + DOUBT / 2, 8.0 - DOUBT / 2, math.nan):
        assert certain_cell(position, 50) == UNCERTAIN
    assert certain_cell(-0.1, 50) == OFF
    assert certain_cell(math.inf, 50) == OFF


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 1000)), unique_by=lambda item: item[1]))
def test_the_heap_gives_back_in_order(items: list[tuple[int, int]]) -> None:
    heap = empty_heap(len(items) + 1)
    for cost, arc in items:
        push(heap, float(cost), arc)
    assert [pop(heap) for _ in items] == [arc for _, arc in sorted(items)]
