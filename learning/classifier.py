"""f_phi of the paper at run time: one scan in, a context and a confidence out. Numpy only.

The network and its preprocessing are the authors' (`Daffan/APPLR`, `APPLX/classifier.py`): the central 640 of 720
beams, clipped at 5 m, one convolution, dense output. Ours has a dense layer of 64 units in between: without it the
network is too nearly linear to tell the contexts from everything else (figures in docs/learning.md). The authors' own
has none. The logits are read as evidence for a Dirichlet distribution (Sensoy et al. 2018): e = softplus(logits),
alpha = e + 1, expected probability alpha_k / sum(alpha), confidence u = 1 - N / sum(alpha).
Training is in `learning.evidential`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

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


def preprocess(ranges: Array) -> Floats:
    """A raw scan (720,) [m] to the network's input (640,): central beams, clipped at 5 m and divided by it."""
    start = (len(ranges) - CROP) // 2
    filled = fill_gaps(ranges)[start : start + CROP]
    return (np.clip(filled, 0.0, MAX_RANGE) / MAX_RANGE).astype(np.float32)


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
    output: Floats  # (H, N) dense; H = 121 * 32 inputs by place, then filter, without a hidden layer
    output_bias: Floats  # (N,)
    hidden: Floats | None = None  # (121 * 32, H) dense layer in between; None = the authors' network
    hidden_bias: Floats | None = None  # (H,)
    beams: int = BEAMS

    def __post_init__(self) -> None:
        if len(self.labels) < 2 or len(set(self.labels)) != len(self.labels):
            raise ValueError(f"a classifier needs two or more different contexts, not {list(self.labels)}")
        if self.beams != BEAMS:
            raise ValueError(f"the classifier is for scans of {self.beams} beams; this robot's have {BEAMS}")
        if (self.hidden is None) != (self.hidden_bias is None):
            raise ValueError("classifier weights 'hidden' and 'hidden_bias' belong together")
        units = 0 if self.hidden_bias is None else len(np.atleast_1d(self.hidden_bias))
        for name, shape in weight_shapes(len(self.labels), units).items():
            weights = getattr(self, name)
            if not isinstance(weights, np.ndarray) or weights.dtype != np.float32:
                raise ValueError(f"classifier weights {name!r} must be float32")
            if weights.shape != shape:
                raise ValueError(f"classifier weights {name!r} have shape {weights.shape}, not {shape}")
            if not np.isfinite(weights).all():
                raise ValueError(f"classifier weights {name!r} hold values that are not finite")
            object.__setattr__(self, name, frozen_array(np.ascontiguousarray(weights)))

    @classmethod
    def from_weights(cls, labels: tuple[str, ...], weights: Mapping[str, Floats]) -> EvidentialClassifier:
        """The classifier with weights by name, as `weights` returns them. Raises ValueError."""
        if unknown := set(weights) - set(WEIGHT_NAMES):
            raise ValueError(f"unknown classifier weights {sorted(unknown)}")
        if missing := set(WEIGHT_NAMES) - set(weights) - {"hidden", "hidden_bias"}:
            raise ValueError(f"classifier weights {sorted(missing)} are missing")
        return cls(
            labels,
            weights["kernel"],
            weights["kernel_bias"],
            weights["output"],
            weights["output_bias"],
            weights.get("hidden"),
            weights.get("hidden_bias"),
        )

    @property
    def weights(self) -> dict[str, Floats]:
        """Name to array."""
        return {name: weights for name in WEIGHT_NAMES if (weights := getattr(self, name)) is not None}

    def check(self, scan_size: int) -> None:
        """Raises ValueError unless scans of this many beams fit."""
        if scan_size != self.beams:
            raise ValueError(f"the classifier was trained on scans of {self.beams} beams; this scan has {scan_size}")

    def logits(self, inputs: Floats) -> Array:
        """Preprocessed scan (640,) to logits (N,)."""
        windows = sliding_window_view(inputs, KERNEL)[::STRIDE]  # (121, 40)
        features = np.maximum(windows @ self.kernel + self.kernel_bias, 0.0).ravel()
        if self.hidden is not None and self.hidden_bias is not None:
            features = np.maximum(features @ self.hidden + self.hidden_bias, 0.0)
        return np.asarray(features @ self.output + self.output_bias, dtype=np.float64)

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


def weight_shapes(contexts: int, hidden: int) -> dict[str, tuple[int, ...]]:
    """Name to shape of the weights of a classifier of so many contexts and hidden units (0 = no hidden layer)."""
    features = STEPS * FILTERS
    shapes: dict[str, tuple[int, ...]] = {"kernel": (KERNEL, FILTERS), "kernel_bias": (FILTERS,)}
    if hidden:
        shapes |= {"hidden": (features, hidden), "hidden_bias": (hidden,)}
    return shapes | {"output": (hidden or features, contexts), "output_bias": (contexts,)}


WEIGHT_NAMES = ("kernel", "kernel_bias", "hidden", "hidden_bias", "output", "output_bias")
