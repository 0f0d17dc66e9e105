"""Scans as the robot could have seen them a little differently: mirrored, turned, moved, noisier.

Everything acts on raw scans (n, 720) [m], right to left, no-return = inf, and takes its randomness as an argument.
The magnitudes are the authors' (`APPLX/APPLI_policy.py`). A context does not change under any of these.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from learning.classifier import BEAMS, CROP, MAX_RANGE, Floats, fill_gaps, preprocess
from learning.labelled_scans import Integers
from twin.compiled import compiled
from twin.records import Array

FIELD_OF_VIEW = 2 * 2.35619  # [rad] first to last beam (hokuyo_ust10.urdf.xacro)
BEARINGS = np.linspace(-FIELD_OF_VIEW / 2, FIELD_OF_VIEW / 2, BEAMS)  # (720,) [rad] sensor frame
DIRECTIONS = np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS)])  # (720, 2) unit vectors
EDGE = 0.3  # [m] neighbouring returns farther apart than this are two surfaces, not one


@dataclass(frozen=True, slots=True)
class Augmentation:
    """How much a training scan may be changed."""

    mirror: float = 0.5  # probability
    shift: float = math.radians(15.0)  # [rad] largest turn, by shifting the crop: all that it allows; the authors' 10
    noise: float = 0.05  # [m] largest change of a range, uniform
    translation: float = 0.40  # [m] largest move of the sensor along each axis; the authors' 0.10 leaves gaps between
    # the scans of a single brisk demonstration (2 m/s are 0.10 m per scan)

    @property
    def beams(self) -> int:
        """The largest crop shift in beams, never beyond the scan."""
        return min(int(self.shift / FIELD_OF_VIEW * BEAMS), (BEAMS - CROP) // 2)


def mirror(ranges: NDArray[Any]) -> NDArray[Any]:
    """The scans (..., n) of the mirrored place: left and right exchanged."""
    return ranges[..., ::-1]


def translate(ranges: Array, dx: float, dy: float) -> Array:
    """The scan (720,) after the sensor moves by dx forward and dy left [m]; the place stays.

    Returns become points, neighbouring ones of the same surface are joined, and the joined line is scanned again
    from the new position: every beam takes the nearest crossing. What comes into view from behind an edge was never
    seen and is no return.
    """
    moved: Array = np.full(len(ranges), np.inf)
    _rescan(np.ascontiguousarray(ranges, dtype=np.float64), DIRECTIONS, dx, dy, moved)
    seen = np.flatnonzero(np.isfinite(moved))
    if len(seen):  # the scan's ends, where nothing outside the field of view could be moved in
        if np.isfinite(ranges[0]):
            moved[: seen[0]] = moved[seen[0]]
        if np.isfinite(ranges[-1]):
            moved[seen[-1] + 1 :] = moved[seen[-1]]
    return moved


@compiled
def _rescan(ranges: Array, directions: Array, dx: float, dy: float, moved: Array) -> None:
    """Fill `moved` with the nearest crossing per beam; see translate(). directions: (n, 2) cosine and sine."""
    n = len(ranges)
    first, step = -FIELD_OF_VIEW / 2, FIELD_OF_VIEW / (n - 1)
    previous_x = previous_y = previous_beam = 0.0
    previous = False
    for i in range(n):
        if not math.isfinite(ranges[i]):
            previous = False
            continue
        x, y = ranges[i] * directions[i, 0] - dx, ranges[i] * directions[i, 1] - dy
        beam = (math.atan2(y, x) - first) / step
        nearest = round(beam)
        if 0 <= nearest < n:
            moved[nearest] = min(moved[nearest], math.hypot(x, y))
        ex, ey = x - previous_x, y - previous_y
        if previous and ex * ex + ey * ey < EDGE * EDGE and abs(beam - previous_beam) < n // 3:
            low, high = min(beam, previous_beam), max(beam, previous_beam)
            for k in range(max(0, math.ceil(low)), min(n - 1, math.floor(high)) + 1):
                # Crossing of the ray r (c, s) with the line through both points.
                across = directions[k, 0] * ey - directions[k, 1] * ex
                if abs(across) > 1e-9:
                    r = (previous_x * ey - previous_y * ex) / across
                    if r > 0.0:
                        moved[k] = min(moved[k], r)
        previous, previous_x, previous_y, previous_beam = True, x, y, beam


def inputs_of(scans: Array) -> Floats:
    """The raw scans (n, 720) as the network takes them, without augmentation: (n, 640)."""
    return np.array([preprocess(scan) for scan in scans], dtype=np.float32).reshape(-1, CROP)


def augmented(scans: Array, order: Integers, rng: np.random.Generator, how: Augmentation) -> Floats:
    """Varied network inputs (m, 640) of the raw scans (n, 720) at positions `order` (m,).

    Mirror, shift and noise differ from entry to entry; a scan that comes several times is moved once.
    """
    used, where = np.unique(order, return_inverse=True)
    moves = rng.uniform(-how.translation, how.translation, (len(used), 2))
    filled = np.empty((len(used), BEAMS))
    for i, (ranges, (dx, dy)) in enumerate(zip(scans[used], moves, strict=True)):
        filled[i] = fill_gaps(translate(ranges, dx, dy) if how.translation > 0.0 else ranges)
    m = len(order)
    shifts = rng.integers(-how.beams, how.beams, m, endpoint=True)
    beams = shifts[:, None] + (np.arange(CROP) + (BEAMS - CROP) // 2)
    flipped = rng.random(m) < how.mirror
    beams[flipped] = BEAMS - 1 - beams[flipped]
    inputs: Floats = np.clip(filled[where[:, None], beams] / MAX_RANGE, 0.0, 1.0).astype(np.float32)
    noise = how.noise / MAX_RANGE  # the authors add it after clipping, so it stays visible at 5 m
    inputs += (2.0 * noise) * (rng.random(inputs.shape, dtype=np.float32) - np.float32(0.5))
    return inputs
