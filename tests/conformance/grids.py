"""Costmaps and navfn against recordings of ROS's C++ (spec/move_base.md 2-6): footprint, layers, inflation, wave, path.

Each `check_*` runs every case of an opened golden file through the public functions of `twin.planner` and says which
cases differ. Files may have any number of cases.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping

import numpy as np

from tests.conformance.agreement import Agreement
from twin.planner.footprint import FOOTPRINT, footprint_cost
from twin.planner.inflation import Costmap, InflationParams, inflate, update_costmap
from twin.planner.map_frame import MapSpec
from twin.planner.navfn import navfn
from twin.planner.obstacle_layer import empty_map, update_obstacles
from twin.records import Pose2

Golden = Mapping[str, np.ndarray]

RESOLUTION = 0.05  # [m], where the file does not say
ROLLING = MapSpec(200, 200, RESOLUTION, (0.0, 0.0), rolling=True)  # the two maps of obstacle.npz
FIXED = MapSpec(240, 240, RESOLUTION, (-6.0, -6.0), rolling=False)


def _loaded(data: Golden) -> dict[str, np.ndarray]:
    """All arrays in memory: an opened npz unpacks an array anew at every access."""
    return {name: data[name] for name in data}


def _cells_that_differ(ours: np.ndarray, theirs: np.ndarray) -> str:
    """'' or how many cells differ, and the first of them."""
    if ours.shape != theirs.shape:
        return f"shape {ours.shape}, not {theirs.shape}"
    where = np.argwhere(ours != theirs)
    if len(where) == 0:
        return ""
    y, x = where[0]
    return f"{len(where)} cells, first x={x} y={y}: {ours[y, x]}, not {theirs[y, x]}"


def check_footprint(data: Golden) -> Agreement:
    """`footprint_cost` on every pose; and our constant polygon is the recorded one."""
    golden = _loaded(data)
    differing = [] if np.array_equal(FOOTPRINT, golden["footprint"]) else [f"FOOTPRINT: {FOOTPRINT.tolist()}"]
    for k, (m, pose, recorded) in enumerate(zip(golden["map_index"], golden["pose"], golden["cost"], strict=True)):
        (origin_x, origin_y), (x, y, yaw) = golden["origin"][m], pose
        cost = footprint_cost(golden["costmap"][m], origin_x, origin_y, RESOLUTION, x, y, yaw, FOOTPRINT)
        if cost != recorded:
            differing.append(f"case {k}: cost {cost}, not {recorded:g}")
    return Agreement("footprint", len(golden["cost"]), differing)


def check_inflation(data: Golden) -> Agreement:
    """`inflate` on every grid and window."""
    golden = _loaded(data)
    differing = []
    for k, (shape, params, window) in enumerate(
        zip(golden["shape"].tolist(), golden["params"].tolist(), golden["window"].tolist(), strict=True)
    ):
        cells = slice(golden["offset"][k], golden["offset"][k + 1])
        resolution, radius, scaling, inscribed = params
        inflation = InflationParams(radius, scaling, inscribed, bool(golden["inflate_unknown"][k]))
        ours = inflate(golden["grid_in"][cells].reshape(shape), tuple(window), resolution, inflation)
        if what := _cells_that_differ(ours, golden["grid_out"][cells].reshape(shape)):
            differing.append(f"case {k}: {what}")
    return Agreement("inflation", len(golden["shape"]), differing)


def check_obstacle(data: Golden) -> Agreement:
    """`update_obstacles` and `update_costmap` in turn along every run: layer, master, origin and window."""
    golden = _loaded(data)
    runs, updates = golden["rolling"].shape
    differing = []
    for r in range(runs):
        spec = ROLLING if golden["rolling"][r, 0] else FIXED
        layer = empty_map(spec)
        costmap: Costmap | None = None
        for t in range(updates):
            item = r * updates + t
            points = golden["points"][golden["points_offset"][item] : golden["points_offset"][item + 1]]
            sensor_x, sensor_y, sensor_z = golden["sensor"][r, t].tolist()
            layer = update_obstacles(layer, spec, points, (sensor_x, sensor_y, sensor_z), Pose2(*golden["pose"][r, t]))
            costmap = update_costmap(costmap, layer, spec, float(golden["radius"][r, t]))

            canvas = golden["master"][r, t].shape
            size = (slice(spec.size_y), slice(spec.size_x))
            bits = np.unpackbits(golden["layer_lethal_bits"][r, t], count=canvas[0] * canvas[1]).reshape(canvas)
            x0, xn, y0, yn = golden["bounds"][r, t].tolist()
            faults = {
                "layer": _cells_that_differ((layer.cells == 254).astype(np.uint8), bits[size]),
                "master": _cells_that_differ(costmap.cells, golden["master"][r, t][size]),
                "origin": "" if layer.origin == tuple(golden["origin"][r, t]) else f"{layer.origin}",
                "window": "" if costmap.window == (x0, y0, xn, yn) else f"{costmap.window}, not {(x0, y0, xn, yn)}",
            }
            differing += [f"run {r} update {t}: {name} {what}" for name, what in faults.items() if what]
    return Agreement("obstacle", runs * updates, differing)


def check_navfn(data: Golden) -> Agreement:
    """`navfn` on every map: found, the traced path, the potentials (all of them by checksum)."""
    golden = _loaded(data)
    differing = []
    for k, (shape, robot, goal) in enumerate(
        zip(golden["shape"].tolist(), golden["robot"].tolist(), golden["goal"].tolist(), strict=True)
    ):
        cost = golden["cost"][golden["offset"][k] : golden["offset"][k + 1]].reshape(shape)
        result = navfn(cost, tuple(robot), tuple(goal), bool(golden["allow_unknown"][k]))
        potential = result.potential.ravel()
        faults = []
        if result.found != bool(golden["found"][k]):
            faults.append(f"found {result.found}")
        path = golden["path"][golden["path_offset"][k] : golden["path_offset"][k + 1]]
        if not np.array_equal(result.path, path):
            faults.append(f"path of {len(result.path)} points, recorded {len(path)}")
        if golden["has_pot"][k]:
            recorded = golden["pot"][golden["pot_offset"][k] : golden["pot_offset"][k + 1]]
            if not np.array_equal(potential, recorded):
                faults.append(f"{np.count_nonzero(potential != recorded)} potentials")
        if not np.array_equal(potential[golden["sample_index"][k]], golden["sample_pot"][k]):
            faults.append("sampled potentials")
        if np.count_nonzero(potential < 1e10) != golden["n_finite"][k]:
            faults.append("number of finite potentials")
        if zlib.crc32(potential.astype("<f4").tobytes()) != golden["pot_crc32"][k]:
            faults.append("checksum of the potentials")
        if faults:
            differing.append(f"case {k}: {', '.join(faults)}")
    return Agreement("navfn", len(golden["shape"]), differing)
