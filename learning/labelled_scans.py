"""What the classifier learns from: scans with the names of their contexts, kept apart by stretches of time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from learning.classifier import BEAMS
from learning.interventions import Intervention
from twin.records import Array

Integers = NDArray[np.int64]

APART = 1.0  # [m] from where a context was shown: elsewhere


@dataclass(frozen=True, slots=True)
class ScanDataset:
    """Labelled scans. Raises ValueError when the arrays do not fit together."""

    scans: Array  # (n, 720) [m], right to left; no return = inf
    labels: tuple[str, ...]  # (n,) context of each scan
    blocks: Integers  # (n,) id of a stretch of time in one intervention; a block is never split

    def __post_init__(self) -> None:
        n = len(self.labels)
        if self.scans.ndim != 2 or self.scans.shape[1] != BEAMS:
            raise ValueError(f"scans must have the shape (n, {BEAMS}), not {self.scans.shape}")
        if len(self.scans) != n or self.blocks.shape != (n,):
            raise ValueError(f"{len(self.scans)} scans, {n} labels and {len(self.blocks)} block ids do not match")

    @property
    def contexts(self) -> tuple[str, ...]:
        """The contexts, in alphabetical order: the order of the classifier's outputs."""
        return tuple(sorted(set(self.labels)))

    def indices(self, contexts: tuple[str, ...]) -> Integers:
        """(n,) position of each scan's label in `contexts`."""
        return np.array([contexts.index(label) for label in self.labels], dtype=np.int64)

    def usable(self) -> ScanDataset:
        """Without the scans that have no return at all: what cannot be judged cannot teach either."""
        return self.pick(np.flatnonzero(np.isfinite(self.scans).any(axis=1)))

    def pick(self, positions: Integers) -> ScanDataset:
        """The scans at these positions."""
        return ScanDataset(self.scans[positions], tuple(self.labels[i] for i in positions), self.blocks[positions])


def time_blocks(times: Array, sources: Integers, seconds: float = 1.0) -> Integers:
    """Block ids (n,) for steps at `times` [s] of interventions `sources`: stretches of `seconds` each."""
    pairs = np.column_stack([sources, np.floor(times / seconds).astype(np.int64)])
    return np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def split(dataset: ScanDataset, share: float, rng: np.random.Generator) -> tuple[ScanDataset, ScanDataset]:
    """For training, and held out: `share` of each context's time blocks is held out, whole, one at least.

    Shuffled steps would put neighbours 50 ms apart, all but equal, on both sides. Raises ValueError for a context
    with a single block.
    """
    truth = dataset.indices(dataset.contexts)
    held = np.zeros(len(truth), dtype=bool)
    for k, label in enumerate(dataset.contexts):
        own = np.unique(dataset.blocks[truth == k])
        if len(own) < 2:
            raise ValueError(f"context {label!r} has one time block with usable scans; two or more are needed")
        count = min(max(1, round(share * len(own))), len(own) - 1)
        held |= (truth == k) & np.isin(dataset.blocks, rng.permutation(own)[:count])
    return dataset.pick(np.flatnonzero(~held)), dataset.pick(np.flatnonzero(held))


def balanced(truth: Integers, count: int, rng: np.random.Generator) -> Integers:
    """`count` positions in random order, every context equally often (to within one), its scans in turn."""
    present = np.unique(truth)
    drawn = []
    for k in present:
        own = np.flatnonzero(truth == k)
        each = math.ceil(count / len(present))
        rounds = [rng.permutation(own) for _ in range(math.ceil(each / len(own)))]
        drawn.append(np.concatenate(rounds)[:each])
    return rng.permutation(np.concatenate(drawn))[:count]


def labelled_scans(interventions: Sequence[Intervention]) -> ScanDataset:
    """The scans of all labelled steps, in blocks of time. Raises ValueError for lidars of different sizes."""
    packed = [i.packed for i in interventions]
    if len({p.ranges.shape[1] for p in packed}) > 1:
        raise ValueError("the interventions come from lidars of different sizes")
    sources = np.concatenate([np.full(int(p.labelled.sum()), k) for k, p in enumerate(packed)])
    return ScanDataset(
        np.concatenate([p.ranges[p.labelled] for p in packed]),
        tuple(i.label for i in interventions for _ in range(int(i.packed.labelled.sum()))),
        time_blocks(np.concatenate([p.times[p.labelled] for p in packed]), sources),
    )


def background_scans(taught: Sequence[Intervention], others: Sequence[Intervention]) -> Array:
    """Scans (k, 720) of `others` that show none of the places where `taught` shows its contexts.

    That is: labelled steps in another world, or farther than APART from every labelled step of `taught`.
    """
    scans: list[Array] = [np.empty((0, BEAMS))]
    for other in others:
        here = [i.packed for i in taught if i.metadata.world == other.metadata.world]
        places = np.concatenate([np.empty((0, 2)), *(p.poses[p.labelled, :2] for p in here)])
        packed = other.packed
        far = cKDTree(places).query(packed.poses[:, :2])[0] > APART if len(places) else True
        if packed.ranges.shape[1] == BEAMS:
            scans.append(packed.ranges[packed.labelled & far])
    return np.concatenate(scans)
