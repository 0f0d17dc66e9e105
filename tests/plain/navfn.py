"""navfn word for word: translated copy of the costmap, whole potential field, cached gradients.

Compiled, because the golden file has maps of 800 x 800, but without any of the package's shortcuts.
"""

from __future__ import annotations

import math

import numba
import numpy as np

HIGH = np.float32(1e10)


@numba.njit(cache=True)
def translate(costmap, allow_unknown):
    """(ny, nx) costmap bytes to navfn's cost array."""
    out = np.empty_like(costmap)
    ny, nx = costmap.shape
    for y in range(ny):
        for x in range(nx):
            c = costmap[y, x]
            if y in (0, ny - 1) or x in (0, nx - 1):
                out[y, x] = 254
            elif c == 255:
                out[y, x] = 253 if allow_unknown else 254
            elif c >= 253:
                out[y, x] = 254
            else:
                out[y, x] = min(253, int(50 + 0.8 * c))
    return out


@numba.njit(cache=True)
def propagate(cost_grid, source, goal, capacity=10000):
    """The potential (ny*nx,) f32 after the wave from the cell index `source` has reached `goal`."""
    ny, nx = cost_grid.shape
    ns = nx * ny
    cost = cost_grid.ravel()
    pot = np.full(ns, HIGH, dtype=np.float32)
    pending = np.zeros(ns, dtype=np.bool_)
    buffers = np.empty((3, capacity), dtype=np.int64)
    cur, nxt, over = 0, 1, 2
    count = np.zeros(3, dtype=np.int64)
    pot[source] = 0.0
    for n in (source + 1, source - 1, source - nx, source + nx):
        if 0 <= n < ns and not pending[n] and cost[n] < 254:
            pending[n] = True
            buffers[cur, count[cur]] = n
            count[cur] += 1
    threshold = np.float32(254.0)
    for _ in range(max(ns // 20, nx + ny)):
        if count[cur] == 0 and count[nxt] == 0:
            break
        for i in range(count[cur]):
            pending[buffers[cur, i]] = False
        for i in range(count[cur]):
            n = buffers[cur, i]
            left, right, low, high = pot[n - 1], pot[n + 1], pot[n - nx], pot[n + nx]
            tc = left if left < right else right
            ta = low if low < high else high
            hf = np.float32(cost[n])
            dc = tc - ta
            if dc < 0:
                dc = -dc
                ta = tc
            if dc >= hf:
                new = ta + hf
            else:
                x = dc / hf
                v = np.float32(-0.2301 * x * x + 0.5307 * x + 0.7040)
                new = ta + hf * v
            if not new < pot[n]:
                continue
            pot[n] = new
            to = nxt if new < threshold else over
            for nb, old in ((n - 1, left), (n + 1, right), (n - nx, low), (n + nx, high)):
                e = np.float32(0.707106781 * np.float64(np.float32(cost[nb])))
                if old > new + e and not pending[nb] and cost[nb] < 254 and count[to] < capacity:
                    pending[nb] = True
                    buffers[to, count[to]] = nb
                    count[to] += 1
        count[cur] = 0
        cur, nxt = nxt, cur
        if count[cur] == 0:
            threshold += np.float32(100.0)
            cur, over = over, cur
        if pot[goal] < HIGH:
            break
    return pot


@numba.njit(cache=True)
def gradient(pot, nx, n, gx, gy):
    """Fill the cache gx, gy (ns,) at cell n, unless it is there already."""
    ns = len(pot)
    if gx[n] + gy[n] > 0 or n < nx or n > ns - nx:
        return
    cv = pot[n]
    dx = np.float32(0)
    dy = np.float32(0)
    if cv >= HIGH:
        if pot[n - 1] < HIGH:
            dx = np.float32(-254)
        elif pot[n + 1] < HIGH:
            dx = np.float32(254)
        if pot[n - nx] < HIGH:
            dy = np.float32(-254)
        elif pot[n + nx] < HIGH:
            dy = np.float32(254)
    else:
        if pot[n - 1] < HIGH:
            dx += pot[n - 1] - cv
        if pot[n + 1] < HIGH:
            dx += cv - pot[n + 1]
        if pot[n - nx] < HIGH:
            dy += pot[n - nx] - cv
        if pot[n + nx] < HIGH:
            dy += cv - pot[n + nx]
    norm = np.float32(math.sqrt(np.float64(dx) * dx + np.float64(dy) * dy))
    if norm > 0:
        norm = np.float32(1.0 / norm)
        gx[n] = norm * dx
        gy[n] = norm * dy


@numba.njit(cache=True)
def round_away(v):
    """C's round(): half away from zero."""
    return math.floor(abs(v) + 0.5) * (1 if v > 0 else -1)


@numba.njit(cache=True)
def trace(pot, nx, start, source, steps):
    """The traced points (k, 2) f32 from the cell index `start` down to `source`."""
    ns = len(pot)
    gx = np.zeros(ns + 2 * nx, dtype=np.float32)
    gy = np.zeros(ns + 2 * nx, dtype=np.float32)
    path = np.empty((steps, 2), dtype=np.float32)
    k = 0
    stc = start
    dx = np.float32(0)
    dy = np.float32(0)
    for _ in range(steps):
        near = max(0, min(ns - 1, stc + int(round_away(dx)) + int(nx * round_away(dy))))
        if pot[near] < 50:
            path[k, 0], path[k, 1] = source % nx, source // nx
            return path[: k + 1]
        if stc < nx or stc > ns - nx:
            break
        path[k, 0] = np.float32(stc % nx) + dx
        path[k, 1] = np.float32(stc // nx) + dy
        k += 1
        grid_step = k > 2 and path[k - 1, 0] == path[k - 3, 0] and path[k - 1, 1] == path[k - 3, 1]
        block = (-nx - 1, -nx, -nx + 1, -1, 1, nx - 1, nx, nx + 1)
        if pot[stc] >= HIGH:
            break  # no neighbour is below INT_MIN, and the trace fails
        for step in block:
            grid_step = grid_step or pot[stc + step] >= HIGH
        if grid_step:
            best, bp = stc, int(pot[stc])
            for step in block:
                if pot[stc + step] < bp:
                    best, bp = stc + step, int(pot[stc + step])
            stc = best
            dx = np.float32(0)
            dy = np.float32(0)
            if pot[stc] >= HIGH:
                break
            continue
        for n in (stc, stc + 1, stc + nx, stc + nx + 1):
            gradient(pot, nx, n, gx, gy)
        x1 = np.float32((1.0 - dx) * gx[stc] + dx * gx[stc + 1])
        x2 = np.float32((1.0 - dx) * gx[stc + nx] + dx * gx[stc + nx + 1])
        x = np.float32((1.0 - dy) * x1 + dy * x2)
        y1 = np.float32((1.0 - dx) * gy[stc] + dx * gy[stc + 1])
        y2 = np.float32((1.0 - dx) * gy[stc + nx] + dx * gy[stc + nx + 1])
        y = np.float32((1.0 - dy) * y1 + dy * y2)
        if x == 0 and y == 0:
            break
        s = np.float32(0.5) / np.float32(math.sqrt(np.float64(x) * x + np.float64(y) * y))
        dx += x * s
        dy += y * s
        if dx > 1:
            stc += 1
            dx -= np.float32(1)
        if dx < -1:
            stc -= 1
            dx += np.float32(1)
        if dy > 1:
            stc += nx
            dy -= np.float32(1)
        if dy < -1:
            stc -= nx
            dy += np.float32(1)
    return path[:k]


def plan(costmap, robot, goal, allow_unknown=True):
    """(found, path (k, 2) f32, potential (ny, nx) f32) on a costmap (ny, nx) between two cells (x, y)."""
    ny, nx = costmap.shape
    source, start = robot[1] * nx + robot[0], goal[1] * nx + goal[0]
    pot = propagate(translate(costmap, allow_unknown), source, start)
    found = bool(pot[start] < HIGH)
    path = trace(pot, nx, start, source, 4 * nx) if found else np.empty((0, 2), dtype=np.float32)
    return found, path, pot.reshape(ny, nx)
