"""How far a confidence can be trusted: the figures by which a context classifier is judged."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from learning.classifier import EvidentialClassifier, confidence, dirichlet, preprocess
from twin.records import Array

MOST_FACTOR, FACTORS = 4.0, 100  # largest factor on the logits, and how many are tried


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

    def confident_share(self, threshold: float) -> float:
        """Share of scans with u >= threshold; NaN without any scan."""
        return _mean(self.confidence >= threshold)

    @property
    def mean_confidence(self) -> float:
        """Mean u; NaN without any scan."""
        return _mean(self.confidence)


def judge_all(classifier: EvidentialClassifier, scans: Array) -> Judgements:
    """Judge raw scans (n, 720) as the robot would."""
    answers = [classifier.judge(scan) for scan in scans]
    return Judgements(
        np.array([-1 if a is None else a.index for a in answers], dtype=np.int64),
        np.array([0.0 if a is None else a.confidence for a in answers]),
        np.array([0.0 if a is None else a.alpha.max() / a.alpha.sum() for a in answers]),
    )


@dataclass(frozen=True, slots=True)
class Assessment:
    """How a classifier does on scans whose contexts are known. Means are NaN without any scan."""

    scans: int
    accuracy: float  # share judged right
    confidence: float  # mean u
    confident_share: float  # share with u >= threshold
    by_confidence: Reliability  # u against accuracy
    by_probability: Reliability  # alpha_max / sum(alpha) against accuracy


def assess(classifier: EvidentialClassifier, scans: Array, labels: tuple[str, ...], threshold: float) -> Assessment:
    """Judge scans (n, 720) with their true contexts (n,), all among the classifier's."""
    answers = judge_all(classifier, scans)
    truth = np.array([classifier.labels.index(label) for label in labels], dtype=np.int64)
    correct = answers.index == truth
    return Assessment(
        len(labels),
        _mean(correct),
        answers.mean_confidence,
        answers.confident_share(threshold),
        reliability(answers.confidence, correct),
        reliability(answers.probability, correct),
    )


def evidence_factor(classifier: EvidentialClassifier, scans: Array, share: float, threshold: float) -> float:
    """The smallest factor >= 1 on the logits with which so large a share of the scans (n, 720) has u >= threshold.

    How much evidence a network gives depends on the penalties and the length of the training, but the threshold is
    given. A factor on the logits (Guo et al. 2017, temperature scaling) changes no order between contexts. Where no
    factor is enough, the smallest of those that come closest. Raises ValueError without scans.
    """
    if not len(scans):
        raise ValueError("evidence cannot be scaled without scans")
    logits = np.array([classifier.logits(preprocess(scan)) for scan in scans])
    factors = np.geomspace(1.0, MOST_FACTOR, FACTORS)
    passed = [(confidence(dirichlet(factor * logits)) >= threshold).mean() for factor in factors]
    return float(factors[np.argmax(np.minimum(passed, share))])


def sharpened(classifier: EvidentialClassifier, factor: float) -> EvidentialClassifier:
    """The same classifier with its logits times a factor."""
    by = np.float32(factor)
    return replace(classifier, output=classifier.output * by, output_bias=classifier.output_bias * by)


@dataclass(frozen=True, slots=True)
class Round:
    """Losses after so many steps."""

    steps: int
    training: float  # mean over the round
    validation: float  # NaN during the refit


@dataclass(frozen=True, slots=True)
class TrainingReport:
    """What training measured. Shares are of u >= threshold.

    `held_out` judges the classifier before the refit, on the time blocks that it has not seen; the refitted one has
    seen more, so its accuracy is a cautious figure. Its confidence is not: the factor on the evidence was chosen there.
    The others judge the classifier that is deployed.
    """

    contexts: tuple[str, ...]
    training_scans: int
    held_out: Assessment
    unfamiliar_share: float  # confident share of made-up scans held out of training; NaN with ood_weight = 0
    outside_share: float  # confident share of the given scans of no context; NaN without any
    outside_confidence: float  # their mean u; NaN without any
    evidence_factor: float  # by which the logits were multiplied
    best_step: int
    rounds: tuple[Round, ...]
    seconds: float  # wall clock

    def figures(self) -> dict[str, float]:
        """The numbers that a policy keeps about its classifier: finite ones, and no times."""
        named = {
            "held_out_scans": float(self.held_out.scans),
            "held_out_accuracy": self.held_out.accuracy,
            "held_out_confidence": self.held_out.confidence,
            "held_out_confident_share": self.held_out.confident_share,
            "ece_confidence": self.held_out.by_confidence.ece,
            "ece_probability": self.held_out.by_probability.ece,
            "unfamiliar_share": self.unfamiliar_share,
            "outside_share": self.outside_share,
            "evidence_factor": self.evidence_factor,
        }
        return {name: value for name, value in named.items() if math.isfinite(value)}


def _mean(values: NDArray[np.bool_] | Array) -> float:
    return float(np.mean(values)) if len(values) else math.nan
