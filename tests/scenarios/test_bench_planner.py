"""The benchmark of find_best_path measures what it says."""

from __future__ import annotations

import numpy as np

from scenarios.bench_planner import CASES, CPP_MS, SCENES, corridor_scene, find_best_path_times
from twin.planner.trajectory import LocalPlannerSettings, PlannerFlags, find_best_path
from twin.records import Twist2


def test_scenes_are_the_same_every_time_and_differ() -> None:
    a, b = corridor_scene(3, 0.3), corridor_scene(3, 0.3)
    assert a.costmap.cells.tobytes() == b.costmap.cells.tobytes()
    assert a.plan.tobytes() == b.plan.tobytes()
    assert a.pose == b.pose
    assert not np.array_equal(a.costmap.cells, corridor_scene(4, 0.3).costmap.cells)


def test_every_scene_can_be_driven_and_has_arcs_that_cannot() -> None:
    case = CASES["fast_19x59"]
    settings = LocalPlannerSettings(min_vel_theta=-case.theta.max_vel_theta)
    for index in range(SCENES):
        scene = corridor_scene(index, case.theta.inflation_radius)
        twist = Twist2(case.v, scene.w)
        best, _ = find_best_path(
            scene.costmap, scene.pose, twist, scene.plan, case.theta, settings, PlannerFlags(), explain=True
        )
        assert best.v > 0.0
        assert best.candidates is not None
        assert len(best.candidates.table) == 19 * 59 + 59
        assert best.candidates.rejected["collision"] > 100


def test_one_time_per_case() -> None:
    times = find_best_path_times(repeats=1)
    assert times.keys() == CASES.keys() == CPP_MS.keys()
    assert all(t > 0.0 for t in times.values())
