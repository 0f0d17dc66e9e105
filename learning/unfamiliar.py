"""Scans of places that belong to no context, made up: what the classifier must be unsure about.

Plain Evidential Deep Learning only ever sees scans of known contexts and is free to be sure of itself elsewhere.
These scans get the uniform Dirichlet, alpha = 1, as their target (as in prior networks, Malinin & Gales 2018, and
generative evidential networks, Sensoy et al. 2020). Two kinds, in equal parts:

* composed places: corridors, rooms, doorways, obstacle fields of random measures, scanned in closed form;
* distorted training scans: pieces of different contexts spliced, ranges scaled, directions turned.

Where there are scans of real places that belong to none of the contexts (the background), those count as well.

What comes out as close to a context's scans as augmentation moves those is in that context, and is dropped: a context
reaches as far as augmentation does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from learning.augment import BEARINGS, Augmentation, augmented, inputs_of, mirror
from learning.classifier import BEAMS, CROP, Floats
from learning.labelled_scans import Integers, ScanDataset
from twin.compiled import compiled
from twin.records import Array

MAX_SCAN_RANGE = 30.0  # [m] of the lidar; beyond is no return
FREE_RADIUS = 0.25  # [m] kept clear round the sensor: the robot stands there
FAMILIAR_QUANTILE = 0.9  # of the distances by which augmentation moves a context's scans: inside is familiar
NO_SCANS: Array = np.empty((0, BEAMS))
MOST_MOVED = 400  # scans of a context from which that quantile is taken


@dataclass(frozen=True, slots=True, eq=False)
class Unfamiliar:
    """Scans for the uniform target."""

    made_up: Array  # (m, 720) [m], used as they are
    background: Array  # (k, 720) [m] scans of real places that belong to no context, augmented like labelled ones
    share: float = 0.5  # of made-up ones when there are both

    @property
    def empty(self) -> bool:
        """Whether there is none of either."""
        return not (len(self.made_up) or len(self.background))

    def split(self, share: float, rng: np.random.Generator) -> tuple[Unfamiliar, Unfamiliar]:
        """A share of both, and the rest."""
        made_up, background = rng.permutation(self.made_up), rng.permutation(self.background)
        m, k = round(share * len(made_up)), round(share * len(background))
        return (
            Unfamiliar(made_up[:m], background[:k], self.share),
            Unfamiliar(made_up[m:], background[k:], self.share),
        )

    def draw(self, count: int, how: Augmentation, rng: np.random.Generator) -> Floats:
        """(count, 640) network inputs in random order."""
        if self.empty:
            return np.empty((0, CROP), dtype=np.float32)
        made = count if not len(self.background) else round(self.share * count) if len(self.made_up) else 0
        chosen = inputs_of(self.made_up[rng.integers(0, max(1, len(self.made_up)), made)])
        if made == count:
            return chosen
        real = augmented(self.background, rng.integers(0, len(self.background), count - made), rng, how)
        return rng.permutation(np.concatenate([chosen, real]))


def unfamiliar_scans(
    dataset: ScanDataset,
    count: int,
    background: Array | None,
    share: float,
    how: Augmentation,
    rng: np.random.Generator,
) -> Unfamiliar:
    """About `count` made-up scans, and the usable ones of a background (k, 720)."""
    made = made_up_scans(dataset.scans, dataset.indices(dataset.contexts), count, how, rng) if count else NO_SCANS
    real = NO_SCANS if background is None else background[np.isfinite(background).any(axis=1)]
    return Unfamiliar(made, real, share)


def made_up_scans(scans: Array, labels: Integers, count: int, how: Augmentation, rng: np.random.Generator) -> Array:
    """About `count` unfamiliar scans (m, 720) for training scans (n, 720) with context indices (n,)."""
    composed = np.array([scan_of(*compose_place(rng)) for _ in range(count - count // 2)]).reshape(-1, BEAMS)
    distorted = np.array([distort(scans, labels, rng) for _ in range(count // 2)]).reshape(-1, BEAMS)
    made = np.concatenate([composed, distorted])
    return made[~familiar(made, scans, labels, how, rng)]


def scan_of(segments: Array, circles: Array) -> Array:
    """Exact ranges (720,) [m] of a lidar at the origin; inf beyond 30 m.

    segments: (n, 4) x0, y0, x1, y1; circles: (m, 3) x, y, radius; sensor frame [m].
    """
    ranges: Array = np.full(BEAMS, np.inf)
    _cast(segments.reshape(-1, 4), circles.reshape(-1, 3), BEARINGS, ranges)
    ranges[ranges > MAX_SCAN_RANGE] = np.inf
    return ranges


@compiled
def _cast(segments: Array, circles: Array, bearings: Array, ranges: Array) -> None:
    for k in range(len(bearings)):
        c, s = math.cos(bearings[k]), math.sin(bearings[k])
        best = ranges[k]
        for i in range(len(segments)):
            x, y = segments[i, 0], segments[i, 1]
            ex, ey = segments[i, 2] - x, segments[i, 3] - y
            across = c * ey - s * ex
            if across != 0.0:
                r, t = (x * ey - y * ex) / across, (x * s - y * c) / across
                if r > 0.0 and 0.0 <= t <= 1.0 and r < best:
                    best = r
        for i in range(len(circles)):
            x, y, radius = circles[i, 0], circles[i, 1], circles[i, 2]
            along, aside = c * x + s * y, c * y - s * x
            if abs(aside) < radius and along > 0.0:
                r = along - math.sqrt(radius * radius - aside * aside)
                if 0.0 < r < best:
                    best = r
        ranges[k] = best


def compose_place(rng: np.random.Generator) -> tuple[Array, Array]:
    """A random place round the sensor: (n, 4) wall segments and (m, 3) circles [m]."""
    segments: list[tuple[float, float, float, float]] = []
    if rng.random() < 0.8:
        segments += _room(rng)
    if rng.random() < 0.5:
        segments += _corridor(rng)
    if rng.random() < 0.4:
        segments += _screen(rng)
    for _ in range(rng.integers(0, 7) if rng.random() < 0.7 else 0):
        segments += _box(rng)
    circles = np.empty((0, 3))
    if rng.random() < 0.5:
        circles = _pillars(rng)
    yaw = rng.uniform(-math.pi, math.pi)
    c, s = math.cos(yaw), math.sin(yaw)
    walls = np.array(segments).reshape(-1, 2, 2) @ np.array([[c, s], [-s, c]])
    walls = walls.reshape(-1, 4)
    return walls[_distance_to_origin(walls) > FREE_RADIUS], circles


def _rectangle(x0: float, y0: float, x1: float, y1: float) -> list[tuple[float, float, float, float]]:
    return [(x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)]


def _room(rng: np.random.Generator) -> list[tuple[float, float, float, float]]:
    west, south, east, north = 0.4 + rng.gamma(1.5, 1.5, 4)
    return _rectangle(-west, -south, east, north)


def _corridor(rng: np.random.Generator) -> list[tuple[float, float, float, float]]:
    right, left = rng.uniform(0.3, 2.0, 2)
    back, front = rng.uniform(-6.0, 0.0, 2), rng.uniform(0.0, 6.0, 2)
    slant = rng.normal(0.0, 0.1, 2)
    walls = [
        (back[0], -right + slant[0] * back[0], front[0], -right + slant[0] * front[0]),
        (back[1], left + slant[1] * back[1], front[1], left + slant[1] * front[1]),
    ]
    if rng.random() < 0.5:  # a bend or a dead end
        walls.append((front[0], -right - rng.uniform(0.0, 3.0), front[0], rng.uniform(-right, left + 2.0)))
    return walls


def _screen(rng: np.random.Generator) -> list[tuple[float, float, float, float]]:
    """A wall with a doorway in it."""
    x, door, width = rng.uniform(0.3, 4.0), rng.normal(0.0, 1.0), rng.uniform(0.5, 2.0)
    return [(x, -6.0, x, door - width / 2), (x, door + width / 2, x, 6.0)]


def _box(rng: np.random.Generator) -> list[tuple[float, float, float, float]]:
    bearing, distance = rng.uniform(-math.pi, math.pi), rng.uniform(0.6, 5.0)
    length, width = rng.uniform(0.2, 1.5, 2)
    x, y = distance * math.cos(bearing), distance * math.sin(bearing)
    return _rectangle(x - length / 2, y - width / 2, x + length / 2, y + width / 2)


def _pillars(rng: np.random.Generator) -> Array:
    """An obstacle field of any density, from a few pillars to a thicket."""
    count, radius = rng.integers(3, 120), rng.uniform(0.05, 0.3)
    places = rng.uniform(-5.0, 5.0, (count, 2))
    clear = np.hypot(places[:, 0], places[:, 1]) > radius + FREE_RADIUS + rng.uniform(0.0, 0.5)
    return np.column_stack([places, np.full(count, radius)])[clear]


def _distance_to_origin(segments: Array) -> Array:
    """(n,) [m]."""
    start, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
    length2 = np.maximum((along**2).sum(axis=1), 1e-12)
    t = np.clip(-(start * along).sum(axis=1) / length2, 0.0, 1.0)
    return np.asarray(np.linalg.norm(start + t[:, None] * along, axis=1))


def distort(scans: Array, labels: Integers, rng: np.random.Generator) -> Array:
    """A scan (720,) of no place: pieces of two contexts, scaled ranges, or a turn by more than 45 degrees."""
    i, j = rng.integers(0, len(scans), 2)
    others = np.flatnonzero(labels != labels[i])
    kind = rng.integers(0, 3)
    if kind == 0 and len(others):
        j = others[rng.integers(0, len(others))]
        cut = rng.integers(BEAMS // 4, BEAMS - BEAMS // 4)
        other = scans[j] if rng.random() < 0.5 else scans[j][::-1]
        return np.concatenate([scans[i][:cut], other[cut:]])
    if kind == 1:
        return np.asarray(scans[i] * math.exp(rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.2)))
    return np.roll(scans[i], rng.integers(BEAMS // 6, BEAMS - BEAMS // 6))


def familiar(
    candidates: Array, scans: Array, labels: Integers, how: Augmentation, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """(m,) whether a scan, or its mirror image, is as close to a context's scans as augmentation moves those.

    Close: root mean square of the difference of the network's inputs. The radius of a context is a quantile of the
    distances between its scans and themselves after augmentation.
    """
    made = inputs_of(candidates)
    inside = np.zeros(len(made), dtype=np.bool_)
    for k in np.unique(labels):
        own = scans[labels == k]
        known = inputs_of(own)
        some = rng.permutation(len(own))[:MOST_MOVED]
        moved = augmented(own, some, rng, replace(how, mirror=0.0))
        radius = float(np.quantile(np.sqrt(((moved - known[some]) ** 2).mean(axis=1)), FAMILIAR_QUANTILE))
        closest = np.minimum(_distances(made, known).min(axis=1), _distances(mirror(made), known).min(axis=1))
        inside |= closest <= radius
    return inside


def _distances(a: Floats, b: Floats) -> Array:
    """(n, m) root mean square differences of inputs (n, 640) and (m, 640)."""
    squares = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1)[None, :] - 2.0 * (a @ b.T)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) / a.shape[1]), dtype=np.float64)
