"""What `arc_choice.py` works on. Only data: numba does not notice when code changes in another file than its own."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.planner.arcs import Costs, Motion, step_count
from twin.planner.heap import Heap, empty_heap
from twin.planner.trajectory_state import Limits
from twin.records import Array, Bytes

NO_WAY = 255  # in `around`: there is no way from this cell to the plan or to the local goal
LOOK = 254  # in `around`: an outline may meet a lethal cell, or leave the map

Grid = NDArray[np.uint16] | NDArray[np.int32]


class Stage(NamedTuple):
    """All steps that search an arc, with one inflation radius."""

    step: NDArray[np.int64]  # (m,) which steps these are
    cells: Bytes  # (m, ny, nx) inflated local maps
    around: Bytes  # (m, ny, nx) see `Floor`
    path: Grid  # (m, ny, nx)
    goal: Grid  # (m, ny, nx)
    origin: Array  # (m, 2) [m]
    motion: Array  # (m, 6) `Motion`, as find_best_path rounds it
    goal_distance: Array  # (m,) [m] to the end of the cropped plan


class Scene(NamedTuple):
    """One of them."""

    costs: Costs  # with complete grids
    around: Bytes
    motion: Motion
    goal_distance: float


class Floor(NamedTuple):
    """What a footprint stands on."""

    cells: Bytes  # (ny * nx,)
    around: Bytes  # (ny * nx,) the highest byte that any outline round this cell may meet; or NO_WAY, LOOK
    footprint: Array  # (n, 2) [cells] base_link
    size_x: int
    size_y: int


class Room(NamedTuple):
    """Working memory."""

    heap: Heap
    last: NDArray[np.int32]  # (arcs,) the cell of each forward arc's last point, as `last_cells` numbers cells
    path: Array  # (arcs,) path grid there [cells]
    goal: Array  # (arcs,)
    bound: Array  # (arcs,) cost without obstacles that are not met by all
    obstacle: NDArray[np.int32]  # (arcs,) the byte that an arc is known to meet; -1: its last point was not looked at
    v: Array  # (vx_samples,) [m/s]
    w: Array  # (vtheta_samples,) [rad/s] all rates, for turns in place
    rates: Array  # (vtheta_samples,) [rad/s] those of forward arcs: straight on first, then all but the highest
    points: Array  # (points, 3)


class Best(NamedTuple):
    """The best candidate so far; cost < 0: none."""

    v: float
    w: float
    cost: float


def room_for(limits: Limits, speed: float, rate: float) -> Room:
    """Working memory for any search under these limits from at most |speed| [m/s] and |rate| [rad/s]."""
    fastest = max(limits.max_vel_x, limits.min_vel_x, abs(limits.escape_vel), speed)
    turn = max(limits.max_vel_theta, abs(limits.min_vel_theta), limits.min_in_place, rate)
    points = step_count(limits, fastest, turn) + 2
    arcs = limits.vx_samples * limits.vtheta_samples
    last, obstacle = np.empty(arcs, dtype=np.int32), np.empty(arcs, dtype=np.int32)
    path, goal, bound = np.empty(arcs), np.empty(arcs), np.empty(arcs)
    v, w, rates = np.empty(limits.vx_samples), np.empty(limits.vtheta_samples), np.empty(limits.vtheta_samples)
    return Room(empty_heap(arcs), last, path, goal, bound, obstacle, v, w, rates, np.empty((points, 3)))
