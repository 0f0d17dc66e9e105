"""navfn's descent through the potential field (`NavFn::calcPath`), in f32 and f64 as the C++ mixes them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.compiled import compiled
from twin.planner.navfn_wave import UNREACHED, Potentials

NEUTRAL = 50.0  # COST_NEUTRAL: below it the trace has arrived
STEP = np.float32(0.5)  # pathStep [cells]


@compiled
def _potential(potentials: Potentials, n: int) -> np.float32:
    """Potential of the cell index n; beyond the first and last row nothing was reached."""
    return potentials[n] if 0 <= n < len(potentials) else UNREACHED


@compiled
def _round(value: np.float32) -> int:
    """C's round() of a value in (-2, 2): half away from zero."""
    return math.floor(abs(value) + 0.5) if value > 0 else -math.floor(abs(value) + 0.5)


@compiled
def _gradient(potentials: Potentials, nx: int, n: int) -> tuple[np.float32, np.float32]:
    """`gradCell`: the normalised uphill-to-downhill direction (x, y) at cell n; (0, 0) where it has none.

    ROS caches it per cell. Potentials do not change during a trace, so computing it anew gives the same.
    """
    zero = np.float32(0.0)
    if n < nx or n > len(potentials) - nx:
        return zero, zero
    here = potentials[n]
    left, right = potentials[n - 1], _potential(potentials, n + 1)
    low, high = potentials[n - nx], _potential(potentials, n + nx)
    dx, dy = zero, zero
    if here >= UNREACHED:
        if left < UNREACHED:
            dx = np.float32(-254.0)
        elif right < UNREACHED:
            dx = np.float32(254.0)
        if low < UNREACHED:
            dy = np.float32(-254.0)
        elif high < UNREACHED:
            dy = np.float32(254.0)
    else:
        if left < UNREACHED:
            dx += left - here
        if right < UNREACHED:
            dx += here - right
        if low < UNREACHED:
            dy += low - here
        if high < UNREACHED:
            dy += here - high
    norm = _hypot(dx, dy)
    if norm > 0.0:
        scale = np.float32(1.0) / norm
        return scale * dx, scale * dy
    return zero, zero


@compiled
def _hypot(x: np.float32, y: np.float32) -> np.float32:
    """`hypotf`: through f64, rounded once."""
    return np.float32(math.sqrt(np.float64(x) * np.float64(x) + np.float64(y) * np.float64(y)))


@compiled
def _mix(t: np.float32, a: np.float32, b: np.float32) -> np.float32:
    """(1.0 - t) * a + t * b as C++ promotes it: the first product in f64, the second in f32, the sum rounded."""
    return np.float32((1.0 - np.float64(t)) * np.float64(a) + np.float64(t * b))


@compiled
def _grid_step(potentials: Potentials, nx: int, at: int) -> int:
    """The lowest of the eight neighbours, or `at` itself; the best so far is truncated to an int, as in ROS."""
    best, lowest = at, int(potentials[at])
    for row in (-nx, 0, nx):
        for column in (-1, 0, 1):
            n = at + row + column
            value = _potential(potentials, n)
            if n != at and value < lowest:
                best, lowest = n, int(value)
    return best


@compiled
def _block_is_reached(potentials: Potentials, nx: int, at: int) -> bool:
    """Whether all nine cells round `at` have a potential."""
    for row in (-nx, 0, nx):
        for column in (-1, 0, 1):
            if _potential(potentials, at + row + column) >= UNREACHED:
                return False
    return True


@compiled
def trace(potentials: Potentials, nx: int, start: int, source: int, path: NDArray[np.float32]) -> int:
    """Descend from the cell index `start` to `source`, at most len(path) steps of half a cell.

    Writes the points (x, y) [cells] into `path` (k, 2) and returns how many. A trace that fails half-way leaves the
    points it has, as in ROS, where nobody reads the failure.
    """
    ns = len(potentials)
    at = start
    dx = dy = np.float32(0.0)
    one = np.float32(1.0)
    gradients_at = -1
    x00 = y00 = x01 = y01 = x10 = y10 = x11 = y11 = np.float32(0.0)
    k = 0
    for _ in range(len(path)):
        near = max(0, min(ns - 1, at + _round(dx) + nx * _round(dy)))
        if potentials[near] < NEUTRAL:
            path[k, 0], path[k, 1] = source % nx, source // nx
            return k + 1
        if at < nx or at > ns - nx:
            return k
        path[k, 0] = np.float32(at % nx) + dx
        path[k, 1] = np.float32(at // nx) + dy
        k += 1
        oscillates = k > 2 and path[k - 1, 0] == path[k - 3, 0] and path[k - 1, 1] == path[k - 3, 1]
        if oscillates or (at != gradients_at and not _block_is_reached(potentials, nx, at)):
            # An unreached cell is beyond the ints: C++ gets INT_MIN, no neighbour is lower, and the trace fails.
            if potentials[at] >= UNREACHED:
                return k
            at = _grid_step(potentials, nx, at)
            dx = dy = np.float32(0.0)
            continue
        if at != gradients_at:  # about every other step stays in its cell
            x00, y00 = _gradient(potentials, nx, at)
            x01, y01 = _gradient(potentials, nx, at + 1)
            x10, y10 = _gradient(potentials, nx, at + nx)
            x11, y11 = _gradient(potentials, nx, at + nx + 1)
            gradients_at = at
        x = _mix(dy, _mix(dx, x00, x01), _mix(dx, x10, x11))
        y = _mix(dy, _mix(dx, y00, y01), _mix(dx, y10, y11))
        if x == 0.0 and y == 0.0:
            return k
        scale = STEP / _hypot(x, y)
        dx += x * scale
        dy += y * scale
        if dx > 1.0:
            at += 1
            dx -= one
        if dx < -1.0:
            at -= 1
            dx += one
        if dy > 1.0:
            at += nx
            dy -= one
        if dy < -1.0:
            at -= nx
            dy += one
    return k
