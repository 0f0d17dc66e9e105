"""The best arc with little work: the same answer as `arcs.search_all`, bit for bit, without scoring every candidate."""

from __future__ import annotations

import threading
from functools import lru_cache

import numpy as np

from twin.compiled import compiled
from twin.planner.arc_check import Ground, Scratch, check_driven
from twin.planner.arcs import Motion, Score, Window, drive
from twin.planner.footprint import footprint_cost
from twin.planner.forward_search import Best, best_forward, wave_cell
from twin.planner.heap import empty_heap
from twin.planner.map_grid import raster_scratch, start_waves
from twin.planner.sketch import start_of
from twin.planner.trajectory_state import LEGAL, Limits
from twin.planner.turn_search import best_turn
from twin.planner.wave import BLOCKED, Cells, Wave, empty_wave
from twin.records import Array


@compiled
def search(
    ground: Ground,
    limits: Limits,
    window: Window,
    motion: Motion,
    escaping: bool,
    stuck_left: bool,
    stuck_right: bool,
    plan: Array,
    raster: Cells,
    scratch: Scratch,
) -> tuple[float, float, Score, bool, int]:
    """What `search_all` chooses, for a start without lateral velocity.

    Returns v, w, how the arc ended, whether it is the backup, and the flat index of the local goal's cell or -1. The
    arc's points are left in `scratch.points`; the waves are where the search had no more need of them.
    """
    local_goal = start_waves(
        ground.path, ground.goal, ground.cells, ground.origin_x, ground.origin_y, ground.resolution,
        motion.x, motion.y, motion.yaw, ground.footprint, raster, plan,
    )  # fmt: skip
    start = start_of(motion, ground.origin_x, ground.origin_y, ground.resolution)
    for k in range(len(ground.footprint)):
        scratch.footprint[k, 0] = ground.footprint[k, 0] * start.per_metre
        scratch.footprint[k, 1] = ground.footprint[k, 1] * start.per_metre
    best = Best(0.0, 0.0, -1.0, 0, 0)
    here, obstacle = _first_point(ground, motion)
    if obstacle >= 0:  # otherwise no candidate is legal, because all begin here
        scratch.visited[0] = here
        if not escaping:
            best = best_forward(ground, limits, window, motion, start, obstacle, scratch)
        best = best_turn(ground, limits, window, motion, start, obstacle, stuck_left, stuck_right, best, scratch)
    if best.cost < 0.0:
        count = drive(limits, motion, limits.escape_vel, 0.0, scratch.points)
        return limits.escape_vel, 0.0, check_driven(ground, limits, scratch.points, count), True, local_goal
    count = drive(limits, motion, best.v, best.w, scratch.points)
    path, goal = float(ground.path.value[best.last]), float(ground.goal.value[best.last])
    return best.v, best.w, Score(best.cost, count, path, goal, float(best.obstacle), LEGAL), False, local_goal


@compiled
def _first_point(ground: Ground, motion: Motion) -> tuple[int, int]:
    """The wave cell and the cost byte of the point where all arcs begin; a negative byte if it is certainly illegal."""
    here = wave_cell(ground, motion.x, motion.y)
    if here < 0 or ground.path.value[here] == BLOCKED or ground.goal.value[here] == BLOCKED:
        return here, -1
    outline = footprint_cost(
        ground.cells, ground.origin_x, ground.origin_y, ground.resolution, motion.x, motion.y, motion.yaw,
        ground.footprint,
    )  # fmt: skip
    width = ground.path.width
    return here, -1 if outline < 0 else max(outline, int(np.int64(ground.cells[here // width - 1, here % width - 1])))


def scratch_for(
    shape: tuple[int, int], resolution: float, limits: Limits, points: int, corners: int
) -> tuple[Wave, Wave, Cells, Scratch]:
    """Both waves, the raster and the scratch for maps (ny, nx) and searches of at least that size.

    They are kept from call to call, for each thread its own; sizes are rounded up, so that a search over parameters
    does not allocate anew for each.
    """
    arcs = limits.vx_samples * limits.vtheta_samples
    return _room(threading.get_ident(), shape, resolution, _rounded_up(arcs), _rounded_up(points), corners)


def _rounded_up(count: int) -> int:
    """The next power of two, at least 512."""
    return max(512, 1 << (count - 1).bit_length())


@lru_cache(maxsize=8)
def _room(
    thread: int, shape: tuple[int, int], resolution: float, arcs: int, points: int, corners: int
) -> tuple[Wave, Wave, Cells, Scratch]:
    ny, nx = shape
    scratch = Scratch(
        v=np.empty(arcs),
        w=np.empty(arcs),
        last=np.empty(arcs, dtype=np.int32),
        following=np.empty(arcs, dtype=np.int32),
        first=np.full((ny + 2) * (nx + 2), -1, dtype=np.int32),
        heap=empty_heap(arcs),
        visited=np.empty(points, dtype=np.int32),
        points=np.empty((points, 3)),
        footprint=np.empty((corners, 2)),
    )
    return empty_wave(ny, nx), empty_wave(ny, nx), raster_scratch(resolution), scratch
