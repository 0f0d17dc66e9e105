"""Arcs in closed form: where point k of a candidate lies, without driving there step by step.

ROS integrates every arc with Euler steps and libm's sine and cosine. Once the velocity has reached its target those
steps are the corners of a regular polygon, so that any point is one formula away. It differs from ROS's sum of
roundings by less than 1e-8 cells. What is asked of a point is which cell it is in, and the two can only disagree about
that when a cell border lies between them: within `DOUBT` of a border `certain_cell` refuses to answer, and the caller
drives the arc step by step instead. So the answers are ROS's, bit for bit.

Positions here are in cells of the costmap: (x - origin_x) / resolution.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.compiled import compiled
from twin.planner.arcs import Motion, ramp, step_count
from twin.planner.trajectory_state import Limits
from twin.records import Array

DOUBT = 1e-6  # [cells] a hundred times the error; one arc in a thousand or so passes so close to a border
FARTHEST = 1e4  # [m] from the frame's zero; beyond it f64 is too coarse for DOUBT

OFF, UNCERTAIN = -1, -2
"""What `certain_cell` answers when there is no cell, or it cannot tell."""


class Posture(NamedTuple):
    """A position [cells] and direction (cosine, sine)."""

    x: float
    y: float
    c: float
    s: float


class Start(NamedTuple):
    """Where and how fast all arcs of a call begin."""

    at: Posture
    v: float  # [m/s]
    w: float  # [rad/s]
    per_metre: float  # [cells]


class Sketch(NamedTuple):
    """One arc. The velocity changes during the first `ramp_steps` steps; the others are all alike."""

    points: int
    dt: float  # [s]
    ramp_steps: int
    after_ramp: Posture
    step: float  # [cells]
    half_s: float  # sine and cosine of half the turn of one such step
    half_c: float
    sane: bool  # False: the formula does not hold, drive the arc


@compiled
def start_of(motion: Motion, origin_x: float, origin_y: float, resolution: float) -> Start:
    """The start of all arcs, on a costmap with this origin and resolution [m]."""
    per_metre = 1.0 / resolution
    x, y = (motion.x - origin_x) * per_metre, (motion.y - origin_y) * per_metre
    return Start(Posture(x, y, math.cos(motion.yaw), math.sin(motion.yaw)), motion.v, motion.w, per_metre)


@compiled
def sin_cos(angle: float) -> tuple[float, float]:
    """Sine and cosine to about 1e-12, without libm. For a few turns at most."""
    quarter = math.floor(angle * (2.0 / math.pi) + 0.5)
    a = angle - quarter * (0.5 * math.pi)
    b = a * a
    b2 = b * b
    sine = a * (
        (1.0 - b * (1.0 / 6.0)) + b2 * ((1.0 / 120.0 - b * (1.0 / 5040.0)) + b2 * (1.0 / 362880.0 - b / 39916800.0))
        + b2 * b2 * b2 * (1.0 / 6227020800.0)
    )  # fmt: skip
    cosine = (
        (1.0 - b * 0.5) + b2 * ((1.0 / 24.0 - b * (1.0 / 720.0)) + b2 * (1.0 / 40320.0 - b / 3628800.0))
        + b2 * b2 * b2 * (1.0 / 479001600.0)
    )  # fmt: skip
    turns = int(quarter) & 3
    if turns & 1:
        sine, cosine = cosine, -sine
    return (-sine, -cosine) if turns & 2 else (sine, cosine)


@compiled
def small_sin_cos(angle: float) -> tuple[float, float]:
    """Sine and cosine of an angle below 0.1 to 1e-12."""
    b = angle * angle
    return angle * (1.0 - b * (1.0 / 6.0 - b * (1.0 / 120.0 - b / 5040.0))), 1.0 - b * (
        0.5 - b * (1.0 / 24.0 - b * (1.0 / 720.0))
    )


@compiled
def sketch(limits: Limits, start: Start, target_v: float, target_w: float) -> Sketch:
    """The arc of a candidate (target_v [m/s], target_w [rad/s])."""
    points = step_count(limits, target_v, target_w)
    dt = limits.sim_time / points
    ramp_steps, after_ramp = _ramp(limits, start, target_v, target_w, dt, points)
    half = 0.5 * target_w * dt
    half_s, half_c = small_sin_cos(half)
    step = target_v * dt * start.per_metre
    return Sketch(points, dt, ramp_steps, after_ramp, step, half_s, half_c, abs(half) < 0.1)


@compiled
def _ramp(limits: Limits, start: Start, target_v: float, target_w: float, dt: float, most: int) -> tuple[int, Posture]:
    """How many steps, up to `most`, have a velocity that is not the target, and the posture after them."""
    x, y, c, s = start.at
    v, w = start.v, start.w
    for k in range(most):
        v, w = ramp(v, target_v, limits.acc_x * dt), ramp(w, target_w, limits.acc_theta * dt)
        if v == target_v and w == target_w:
            return k, Posture(x, y, c, s)
        step = v * dt * start.per_metre
        x, y = x + step * c, y + step * s
        turn = w * dt
        turn_s, turn_c = small_sin_cos(turn) if abs(turn) < 0.1 else sin_cos(turn)
        c, s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
    return most, Posture(x, y, c, s)


@compiled
def posture(limits: Limits, start: Start, arc: Sketch, target_v: float, target_w: float, k: int) -> Posture:
    """Point k of an arc."""
    if k < arc.ramp_steps:
        return _ramp(limits, start, target_v, target_w, arc.dt, k)[1]
    return after_ramp(arc, 0.5 * target_w * arc.dt, k - arc.ramp_steps)


@compiled
def after_ramp(arc: Sketch, half: float, steps: int) -> Posture:
    """The point so many steps after the ramp; `half` [rad] is half the turn of one step."""
    at = arc.after_ramp
    # The sum of m unit steps, each turned by 2h, is sin(m h) / sin(h) long and points along (m - 1) h.
    s, c = sin_cos(steps * half)
    length = arc.step * (s / arc.half_s if abs(arc.half_s) > 1e-12 else float(steps))
    along_c, along_s = c * arc.half_c + s * arc.half_s, s * arc.half_c - c * arc.half_s
    turn_c, turn_s = 1.0 - 2.0 * s * s, 2.0 * s * c
    return Posture(
        at.x + length * (at.c * along_c - at.s * along_s),
        at.y + length * (at.s * along_c + at.c * along_s),
        at.c * turn_c - at.s * turn_s,
        at.s * turn_c + at.c * turn_s,
    )


@compiled
def certain_cell(position: float, size: int) -> int:
    """The cell of a coordinate [cells] on an axis of `size` cells; OFF or UNCERTAIN."""
    if not DOUBT < position < size - DOUBT:
        return OFF if position < -DOUBT or position > size + DOUBT else UNCERTAIN
    cell = int(position)
    return cell if DOUBT < position - cell < 1.0 - DOUBT else UNCERTAIN


@compiled
def last_cell(limits: Limits, start: Start, v: float, w: float, size_x: int, size_y: int) -> tuple[int, int]:
    """The cell (x, y) of a candidate's last point; each may be OFF or UNCERTAIN."""
    arc = sketch(limits, start, v, w)
    if not arc.sane:
        return UNCERTAIN, UNCERTAIN
    end = posture(limits, start, arc, v, w, arc.points - 1)
    return certain_cell(end.x, size_x), certain_cell(end.y, size_y)


@compiled
def last_cells(
    limits: Limits, start: Start, v: Array, w: Array, size_x: int, size_y: int, found: NDArray[np.int32]
) -> None:
    """The wave cell (see `wave.py`) of the last point of every candidate (v[i], w[j]), to `found`[i * len(w) + j].

    OFF the map or UNCERTAIN where there is none. This loop sees every arc: it gets numbers only, because handing arrays
    on to a function costs more than all it does here.
    """
    for i in range(len(v)):
        for j in range(len(w)):
            arc = sketch(limits, start, v[i], w[j])
            cell = UNCERTAIN
            if arc.sane:
                at = posture(limits, start, arc, v[i], w[j], arc.points - 1)
                cx, cy = certain_cell(at.x, size_x), certain_cell(at.y, size_y)
                if cx == OFF or cy == OFF:
                    cell = OFF
                elif cx >= 0 and cy >= 0:
                    cell = (cy + 1) * (size_x + 2) + cx + 1
            found[i * len(w) + j] = cell
