"""The local planner against recordings of ROS's C++ (spec/move_base.md 7-9): map grids, arcs, flags, control cycles.

Each `check_*` runs every case of an opened golden file through the public functions of `twin.planner` and says which
cases differ. Files may have any number of cases.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from tests.conformance.agreement import Agreement
from twin.planner.controller import ControllerState, compute_velocity, set_plan
from twin.planner.inflation import Costmap, InflationParams
from twin.planner.map_grid import map_grids
from twin.planner.params import PlannerParams
from twin.planner.trajectory import (
    BestPath,
    ControllerSettings,
    LocalPlannerSettings,
    PlannerFlags,
    find_best_path,
    from_ros_values,
)
from twin.records import Array, Bytes, Pose2, Twist2

RESOLUTION = 0.05  # [m]; of all local-planner recordings
COST_TOLERANCE = 1e-9  # relative
COMMAND_TOLERANCE = 1e-15  # absolute; rates pass through quaternions

Golden = Mapping[str, np.ndarray]


def golden_costmap(cells: Bytes, origin: Array) -> Costmap:
    """A costmap of which only the cells and their place matter."""
    return Costmap(
        cells, (float(origin[0]), float(origin[1])), RESOLUTION, InflationParams(0.3), (0.0, 0.0, 0.0, 0.0), None
    )


def check_mapgrid(data: Golden) -> Agreement:
    """Both grids, the within-robot cells and the local goal."""
    differing = []
    cases = len(data["map_index"])
    maps, path_diff, goal_diff = data["costmap"], data["path_grid_diff"], data["goal_grid_diff"]
    within, plan, offset = data["within_robot_bits"], data["plan"], data["plan_offset"]
    for k in range(cases):
        costmap = golden_costmap(maps[data["map_index"][k]], data["origin"][k])
        x, y, yaw = data["pose"][k].astype(np.float32).astype(np.float64)
        grids = map_grids(costmap, Pose2(x, y, yaw), plan[offset[k] : offset[k + 1]])
        shape = costmap.cells.shape
        found = {
            "path": np.array_equal(grids.path, np.cumsum(path_diff[k], axis=1, dtype=np.uint16)),
            "goal": np.array_equal(grids.goal, np.cumsum(goal_diff[k], axis=1, dtype=np.uint16)),
            "within_robot": np.array_equal(
                grids.within_robot, np.unpackbits(within[k], count=shape[0] * shape[1]).reshape(shape)
            ),
            "local_goal": _equal(grids.local_goal or (math.nan, math.nan), data["local_goal"][k]),
        }
        differing += _report(f"case {k}", found)
    return Agreement("mapgrid", cases, differing)


def check_scoring(data: Golden) -> Agreement:
    """Single calls of findBestPath: the fast search and the explained one, with every candidate of the latter."""
    names = [str(n) for n in data["param_names"]]
    cases = len(data["map_index"])
    data = {key: data[key] for key in data}
    differing = []
    for k in range(cases):
        costmap = golden_costmap(data["costmap"][data["map_index"][k]], data["origin"][k])
        plan = data["plan"][data["plan_offset"][k] : data["plan_offset"][k + 1]]
        theta, settings = from_ros_values(dict(zip(names, data["params"][k].tolist(), strict=True)))
        flags = PlannerFlags.from_array(data["state_in"][k])
        for explain in (True, False):
            best, after = _call(costmap, data["pose"][k], data["vel"][k], plan, theta, settings, flags, explain)
            found = _outputs(best, after, data["out"][k], data["state_out"][k])
            last = best.points[-1] if len(best.points) else np.full(3, math.nan)
            found["traj_last"] = _equal(last, data["traj_last"][k])
            if explain:
                found |= _candidates(best, data, slice(data["cand_offset"][k], data["cand_offset"][k + 1]))
            differing += _report(f"case {k} {'explained' if explain else 'searched'}", found)
    return Agreement("scoring", cases, differing)


def check_sequence(data: Golden) -> Agreement:
    """Many calls of one planner object: flags carried along, parameters changing on the way."""
    names = [str(n) for n in data["param_names"]]
    data = {key: data[key] for key in data}
    sequences, steps = data["cost_index"].shape
    differing = []
    for s in range(sequences):
        flags = PlannerFlags()
        for t in range(steps):
            costmap = golden_costmap(data["costmap"][data["cost_index"][s, t]], data["origin"][s, t])
            item = data["plan_index"][s, t]
            plan = data["plan"][data["plan_offset"][item] : data["plan_offset"][item + 1]]
            theta, settings = from_ros_values(dict(zip(names, data["params"][s, t].tolist(), strict=True)))
            pose, velocity = data["pose"][s, t], data["vel"][s, t]
            explained, _ = _call(costmap, pose, velocity, plan, theta, settings, flags, True)
            best, flags = _call(costmap, pose, velocity, plan, theta, settings, flags, False)
            found = _outputs(best, flags, data["out"][s, t], data["state"][s, t])
            assert explained.candidates is not None
            found["ncand"] = len(explained.candidates.table) == data["ncand"][s, t]
            found["explained"] = _same_answer(explained, best)
            differing += _report(f"sequence {s} step {t}", found)
    return Agreement("sequence", sequences * steps, differing)


def check_controller(data: Golden) -> Agreement:
    """Whole control cycles with plans set now and then, up to the goal."""
    names = [str(n) for n in data["param_names"]]
    data = {key: data[key] for key in data}
    sequences, steps = data["set_plan"].shape
    differing = []
    for s in range(sequences):
        costmap = golden_costmap(data["costmap"][data["cost_index"][s]], data["origin"][s])
        wrapper = data["wparams"][s].tolist()
        theta, settings = from_ros_values(
            dict(zip(names, data["params"][s].tolist(), strict=True)),
            ControllerSettings(*wrapper[:8], latch_xy_goal_tolerance=bool(wrapper[8])),
        )
        state = ControllerState()
        for t in range(steps):
            item = data["set_plan"][s, t]
            if item >= 0:
                state = set_plan(state, data["plan"][data["plan_offset"][item] : data["plan_offset"][item + 1]])
            pose, twist = Pose2(*data["pose"][s, t].tolist()), Twist2(data["vel"][s, t, 0], data["vel"][s, t, 2])
            result, state = compute_velocity(costmap, pose, twist, twist, state, theta, settings)
            ok, v, w, reached, rotating, length = data["out"][s, t].tolist()
            found = {
                "ok": result.ok == bool(ok),
                "v": abs(result.command.v - v) <= COMMAND_TOLERANCE,
                "w": abs(result.command.w - w) <= COMMAND_TOLERANCE,
                "reached": state.reached_goal == bool(reached),
                "rotating": state.rotating_to_goal == bool(rotating),
                "plan length": len(state.plan) == int(length),
                "flags": _equal(state.flags.as_array(), data["state"][s, t]),
            }
            differing += _report(f"sequence {s} step {t}", found)
    return Agreement("controller", sequences * steps, differing)


def _call(
    costmap: Costmap,
    pose: Array,
    velocity: Array,
    plan: Array,
    theta: PlannerParams,
    settings: LocalPlannerSettings,
    flags: PlannerFlags,
    explain: bool,
) -> tuple[BestPath, PlannerFlags]:
    x, y, yaw = pose.tolist()
    v, vy, w = velocity.tolist()
    return find_best_path(
        costmap, Pose2(x, y, yaw), Twist2(v, w), plan, theta, settings, flags, explain, lateral_velocity=vy
    )


def _outputs(best: BestPath, after: PlannerFlags, out: Array, state: Array) -> dict[str, bool]:
    """The ten outputs of one call and the ten numbers of state after it."""
    command = best.command
    return {
        "best": (best.v, best.vy, best.w) == tuple(out[:3].tolist()),
        "cost": _cost_equal(np.array([best.cost]), out[3:4]),
        "points": len(best.points) == int(out[4]),
        "command": abs(command.v - out[5]) <= COMMAND_TOLERANCE and abs(command.w - out[7]) <= COMMAND_TOLERANCE,
        "local_goal": _equal(best.local_goal or (math.nan, math.nan), out[8:10]),
        "flags": _equal(after.as_array(), state),
    }


def _candidates(best: BestPath, data: Golden, rows: slice) -> dict[str, bool]:
    """Every candidate in order: sample, cost or the way it was illegal, points; and that the raw parts add up."""
    c = best.candidates
    assert c is not None
    if len(c.table) != rows.stop - rows.start:
        return {"candidates": False}
    return {
        "candidate v": _equal(c.v, data["cand_v"][rows]),
        "candidate w": _equal(c.w, data["cand_w"][rows]),
        "candidate cost": _cost_equal(c.cost, data["cand_cost"][rows]),
        "candidate points": _equal(c.points, data["cand_npts"][rows]),
        "candidate reason": _equal(c.reason == 0, c.cost >= 0.0),
    }


def _same_answer(a: BestPath, b: BestPath) -> bool:
    """Equal in everything but the candidates."""
    names = [f.name for f in dataclasses.fields(BestPath) if f.name not in ("candidates", "points")]
    return all(getattr(a, n) == getattr(b, n) for n in names) and np.array_equal(a.points, b.points)


def _equal(a: object, b: object) -> bool:
    return np.array_equal(np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64), equal_nan=True)


def _cost_equal(a: Array, b: Array) -> bool:
    """Illegal ones must be illegal in the same way, legal ones equal within the tolerance."""
    if not np.array_equal(np.where(a < 0.0, a, 0.0), np.where(b < 0.0, b, 0.0)):
        return False
    return bool(np.all(np.abs(a - b) <= COST_TOLERANCE * np.abs(b)))


def _report(case: str, found: dict[str, bool]) -> list[str]:
    wrong = [name for name, equal in found.items() if not equal]
    return [f"{case}: {', '.join(wrong)}"] if wrong else []
