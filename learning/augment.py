"""Scans as the robot could have seen them a little differently: mirrored, turned, moved, noisier.

Everything acts on raw scans (n, 720) [m], right to left, no-return = inf, and takes its randomness as an argument.
The magnitudes are the authors' (`APPLX/APPLI_policy.py`). A context does not change under any of these.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from learning.classifier import BEAMS, CROP, MAX_RANGE, Floats, crop, fill_gaps
from twin.records import Array

FIELD_OF_VIEW = 2 * 2.35619  # [rad] first to last beam (hokuyo_ust10.urdf.xacro)
BEARINGS = np.linspace(-FIELD_OF_VIEW / 2, FIELD_OF_VIEW / 2, BEAMS)  # (720,) [rad] sensor frame
EDGE = 0.3  # [m] neighbouring returns farther apart than this are two surfaces, not one


@dataclass(frozen=True, slots=True)
class Augmentation:
    """How much a training scan may be changed."""

    mirror: float = 0.5  # probability
    shift: float = math.radians(10.0)  # [rad] largest turn, by shifting the crop
    noise: float = 0.05  # [m] largest change of a range, uniform
    translation: float = 0.10  # [m] largest move of the sensor along each axis

    @property
    def beams(self) -> int:
        """The largest crop shift in beams, never beyond the scan."""
        return min(int(self.shift / FIELD_OF_VIEW * BEAMS), (BEAMS - CROP) // 2)


def mirror(ranges: Array) -> Array:
    """The scan of the mirrored place: left and right exchanged."""
    return ranges[..., ::-1]


def translate(ranges: Array, dx: float, dy: float) -> Array:
    """The scan (720,) after the sensor moves by dx forward and dy left [m]; the place stays.

    Returns become points, neighbouring ones of the same surface are joined, and the joined line is scanned again
    from the new position: every beam takes the nearest crossing. What comes into view from behind an edge was never
    seen and is no return.
    """
    moved: Array = np.full(len(ranges), np.inf)
    _rescan(np.ascontiguousarray(ranges, dtype=np.float64), BEARINGS, dx, dy, moved)
    seen = np.flatnonzero(np.isfinite(moved))
    if len(seen):  # the scan's ends, where nothing outside the field of view could be moved in
        if np.isfinite(ranges[0]):
            moved[: seen[0]] = moved[seen[0]]
        if np.isfinite(ranges[-1]):
            moved[seen[-1] + 1 :] = moved[seen[-1]]
    return moved


@njit(cache=True)  # type: ignore[misc]
def _rescan(ranges: Array, bearings: Array, dx: float, dy: float, moved: Array) -> None:
    """Fill `moved` with the nearest crossing per beam; see translate()."""
    n = len(ranges)
    first, step = bearings[0], (bearings[n - 1] - bearings[0]) / (n - 1)
    previous_x = previous_y = previous_beam = 0.0
    previous = False
    for i in range(n):
        if not math.isfinite(ranges[i]):
            previous = False
            continue
        x = ranges[i] * math.cos(bearings[i]) - dx
        y = ranges[i] * math.sin(bearings[i]) - dy
        beam = (math.atan2(y, x) - first) / step
        nearest = round(beam)
        if 0 <= nearest < n:
            moved[nearest] = min(moved[nearest], math.hypot(x, y))
        if previous and math.hypot(x - previous_x, y - previous_y) < EDGE and abs(beam - previous_beam) < n // 3:
            low, high = min(beam, previous_beam), max(beam, previous_beam)
            for k in range(max(0, math.ceil(low)), min(n - 1, math.floor(high)) + 1):
                # Crossing of the ray (c, s) r with the line through both points.
                c, s = math.cos(bearings[k]), math.sin(bearings[k])
                across = c * (y - previous_y) - s * (x - previous_x)
                if abs(across) > 1e-9:
                    r = (previous_x * (y - previous_y) - previous_y * (x - previous_x)) / across
                    if r > 0.0:
                        moved[k] = min(moved[k], r)
        previous, previous_x, previous_y, previous_beam = True, x, y, beam


def augmented(scans: Array, rng: np.random.Generator, how: Augmentation) -> Floats:
    """Raw scans (n, 720) to varied network inputs (n, 640)."""
    n = len(scans)
    flipped = rng.random(n) < how.mirror
    moves = rng.uniform(-how.translation, how.translation, (n, 2))
    shifts = rng.integers(-how.beams, how.beams, n, endpoint=True)
    inputs = np.empty((n, CROP), dtype=np.float32)
    for i, ranges in enumerate(scans):
        if how.translation > 0.0:
            ranges = translate(ranges, moves[i, 0], moves[i, 1])
        inputs[i] = crop(fill_gaps(mirror(ranges) if flipped[i] else ranges), int(shifts[i]))
    noise = how.noise / MAX_RANGE  # the authors add it after clipping, so it stays visible at 5 m
    return inputs + rng.uniform(-noise, noise, inputs.shape).astype(np.float32)
