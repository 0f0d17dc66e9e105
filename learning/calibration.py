"""How far a confidence can be trusted: the figures by which a context classifier is judged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from learning.classifier import EvidentialClassifier
from twin.records import Array


@dataclass(frozen=True, slots=True)
class Reliability:
    """A reliability diagram: stated confidence against accuracy, in equal bins of [0, 1]."""

    edges: tuple[float, ...]  # (bins + 1,)
    counts: tuple[int, ...]  # (bins,) scans in each bin
    confidences: tuple[float, ...]  # (bins,) mean stated confidence; 0 where a bin is empty
    accuracies: tuple[float, ...]  # (bins,) share judged right; 0 where a bin is empty

    @property
    def ece(self) -> float:
        """Expected calibration error: the mean gap between confidence and accuracy, weighted by count."""
        total = sum(self.counts)
        gaps = zip(self.counts, self.confidences, self.accuracies, strict=True)
        return sum(n * abs(c - a) for n, c, a in gaps) / total if total else 0.0


def reliability(confidences: Array, correct: NDArray[np.bool_], bins: int = 10) -> Reliability:
    """The diagram of stated confidences (n,) in [0, 1] and whether each judgement was right (n,)."""
    edges = np.linspace(0.0, 1.0, bins + 1)
    index = np.clip(np.digitize(confidences, edges) - 1, 0, bins - 1)
    counts = np.bincount(index, minlength=bins)
    filled = np.maximum(counts, 1)
    return Reliability(
        tuple(edges.tolist()),
        tuple(counts.tolist()),
        tuple((np.bincount(index, confidences, bins) / filled).tolist()),
        tuple((np.bincount(index, correct.astype(float), bins) / filled).tolist()),
    )


@dataclass(frozen=True, slots=True)
class Judgements:
    """A classifier's answers for n scans."""

    index: NDArray[np.int64]  # (n,) context; -1 where a scan could not be judged
    confidence: Array  # (n,) u; 0 where a scan could not be judged
    probability: Array  # (n,) expected probability of that context, alpha_max / sum(alpha); 0 likewise


def judge_all(classifier: EvidentialClassifier, scans: Array) -> Judgements:
    """Judge raw scans (n, 720) as the robot would."""
    answers = [classifier.judge(scan) for scan in scans]
    return Judgements(
        np.array([-1 if a is None else a.index for a in answers], dtype=np.int64),
        np.array([0.0 if a is None else a.confidence for a in answers]),
        np.array([0.0 if a is None else a.alpha.max() / a.alpha.sum() for a in answers]),
    )


def accuracy(judgements: Judgements, truth: NDArray[np.int64]) -> float:
    """Share judged right, of all scans; NaN without any."""
    return float(np.mean(judgements.index == truth)) if len(truth) else float("nan")


def mean_confidence(judgements: Judgements) -> float:
    """Mean u; NaN without any scan."""
    return float(np.mean(judgements.confidence)) if len(judgements.confidence) else float("nan")


def confident_share(judgements: Judgements, threshold: float) -> float:
    """Share of scans with u >= threshold; NaN without any scan."""
    return float(np.mean(judgements.confidence >= threshold)) if len(judgements.confidence) else float("nan")
