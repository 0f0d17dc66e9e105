"""f_phi of the paper at run time: one scan in, a context and a confidence out. Numpy only.

The network and its preprocessing are the authors' (`Daffan/APPLR`, `APPLX/classifier.py`): the central 640 of 720
beams, clipped at 5 m, one convolution, one dense layer. The logits are read as evidence for a Dirichlet distribution
(Sensoy et al. 2018): e = softplus(logits), alpha = e + 1, expected probability alpha_k / sum(alpha),
confidence u = 1 - N / sum(alpha). Training is in `learning.evidential`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from twin.records import Array, frozen_array

Floats = NDArray[np.float32]

BEAMS = 720  # of the scan (UST-10 as BARN simulates it)
CROP = 640  # central beams that the network sees (authors' Dx)
MAX_RANGE = 5.0  # [m] clip (authors' clipping)
END_RANGE = 0.05  # [m] stands for no-returns at either end of the scan (authors' preprocess_scan)
FILTERS, KERNEL, STRIDE = 32, 40, 5  # authors' filter_sizes, kernel_sizes, strides
STEPS = (CROP - KERNEL) // STRIDE + 1  # places at which the kernel is applied: 121


def fill_gaps(ranges: Array) -> Array:
    """The scan (720,) [m] with every beam a number: the authors' treatment of no-returns.

    Whatever is not finite (inf, -inf, NaN) counts as no return. Inner runs are interpolated between their neighbours,
    runs at the ends become 0.05 m. Without any return all beams are 0.05 m.
    """
    valid = np.isfinite(ranges)
    if valid.all():
        return ranges
    if not valid.any():
        return np.full(len(ranges), END_RANGE)
    beams = np.arange(len(ranges))
    return np.interp(beams, beams[valid], ranges[valid], left=END_RANGE, right=END_RANGE)


def crop(filled: Array, shift: int = 0) -> Floats:
    """The network's input (640,): central beams, `shift` of them to the left, clipped at 5 m and divided by it."""
    start = (len(filled) - CROP) // 2 + shift
    return (np.clip(filled[start : start + CROP], 0.0, MAX_RANGE) / MAX_RANGE).astype(np.float32)


def preprocess(ranges: Array) -> Floats:
    """A raw scan (720,) [m] to the network's input (640,)."""
    return crop(fill_gaps(ranges))


def dirichlet(logits: Array) -> Array:
    """(..., N) logits to the Dirichlet's alpha = softplus(logits) + 1."""
    return np.logaddexp(0.0, logits) + 1.0


def confidence(alpha: Array) -> Array:
    """(..., N) alpha to u = 1 - N / sum(alpha), in [0, 1): one minus the vacuity of subjective logic."""
    return np.asarray(1.0 - alpha.shape[-1] / alpha.sum(axis=-1))


@dataclass(frozen=True, slots=True)
class Judgement:
    """The classifier's answer for one scan."""

    index: int  # of the context, 0 .. N - 1
    label: str
    confidence: float  # the paper's u
    alpha: Array  # (N,) Dirichlet parameters


@dataclass(frozen=True, slots=True, eq=False)
class EvidentialClassifier:
    """Weights of the network with the names of the contexts. Raises ValueError when they do not fit together."""

    labels: tuple[str, ...]
    kernel: Floats  # (40, 32) convolution: beam, filter
    kernel_bias: Floats  # (32,)
    dense: Floats  # (121 * 32, N), inputs by place, then filter
    dense_bias: Floats  # (N,)
    beams: int = BEAMS

    def __post_init__(self) -> None:
        if len(self.labels) < 2 or len(set(self.labels)) != len(self.labels):
            raise ValueError(f"a classifier needs two or more different contexts, not {list(self.labels)}")
        if self.beams != BEAMS:
            raise ValueError(f"the classifier is for scans of {self.beams} beams; this robot's have {BEAMS}")
        for name, shape in weight_shapes(len(self.labels)).items():
            weights = getattr(self, name)
            if not isinstance(weights, np.ndarray) or weights.dtype != np.float32:
                raise ValueError(f"classifier weights {name!r} must be float32")
            if weights.shape != shape:
                raise ValueError(f"classifier weights {name!r} have shape {weights.shape}, not {shape}")
            if not np.isfinite(weights).all():
                raise ValueError(f"classifier weights {name!r} hold values that are not finite")
            object.__setattr__(self, name, frozen_array(np.ascontiguousarray(weights)))

    @property
    def weights(self) -> dict[str, Floats]:
        """Name to array."""
        return {name: getattr(self, name) for name in WEIGHT_NAMES}

    def check(self, scan_size: int) -> None:
        """Raises ValueError unless scans of this many beams fit."""
        if scan_size != self.beams:
            raise ValueError(f"the classifier was trained on scans of {self.beams} beams; this scan has {scan_size}")

    def logits(self, inputs: Floats) -> Array:
        """Preprocessed scan (640,) to logits (N,)."""
        windows = sliding_window_view(inputs, KERNEL)[::STRIDE]  # (121, 40)
        hidden = windows @ self.kernel
        hidden += self.kernel_bias
        np.maximum(hidden, 0.0, out=hidden)
        return (hidden.ravel() @ self.dense + self.dense_bias).astype(np.float64)

    def judge(self, ranges: Array) -> Judgement | None:
        """A raw scan (720,) [m] to (c, u) = f_phi(x); None when it cannot be judged.

        That is: no beam has a return, or the network's answer is not finite. Raises ValueError for another scan size.
        """
        self.check(len(ranges))
        if not np.isfinite(ranges).any():
            return None
        with np.errstate(over="ignore", invalid="ignore"):
            alpha = dirichlet(self.logits(preprocess(ranges)))
            certain = float(confidence(alpha))
        if not (np.isfinite(alpha).all() and math.isfinite(certain)):
            return None
        index = int(np.argmax(alpha))
        return Judgement(index, self.labels[index], certain, frozen_array(alpha))


def weight_shapes(contexts: int) -> dict[str, tuple[int, ...]]:
    """Name to shape of the weights of a classifier of so many contexts."""
    return {
        "kernel": (KERNEL, FILTERS),
        "kernel_bias": (FILTERS,),
        "dense": (STEPS * FILTERS, contexts),
        "dense_bias": (contexts,),
    }


WEIGHT_NAMES = tuple(f.name for f in fields(EvidentialClassifier) if f.name not in ("labels", "beams"))
