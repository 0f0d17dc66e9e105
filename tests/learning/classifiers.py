"""Classifiers whose answers are known, and scans for them."""

from __future__ import annotations

import numpy as np

from learning.classifier import BEAMS, EvidentialClassifier, weight_shapes
from twin.records import Array

NEAR, FAR, UNSURE = "A1", "B1", "default"  # what the classifier below says


def random_classifier(seed: int = 0, hidden: int = 64, contexts: int = 4) -> EvidentialClassifier:
    """Any weights."""
    rng = np.random.default_rng(seed)
    shapes = weight_shapes(contexts, hidden)
    weights = {
        name: (rng.standard_normal(shape) / np.sqrt(shape[0])).astype(np.float32) for name, shape in shapes.items()
    }
    return EvidentialClassifier.from_weights(tuple(f"C{k}" for k in range(contexts)), weights)


def range_classifier(labels: tuple[str, str] = (NEAR, FAR), gain: float = 200.0) -> EvidentialClassifier:
    """Evidence for the first context below a mean range of 2 m, for the second above 3 m, little in between."""
    weights = {name: np.zeros(shape, dtype=np.float32) for name, shape in weight_shapes(2, 0).items()}
    weights["kernel"][:, 0] = 1.0 / 40.0  # filter 0: mean of 40 beams, in units of 5 m
    places = weights["output"].reshape(121, 32, 2)[:, 0, :]
    places[:, 0], places[:, 1] = -gain / 121.0, gain / 121.0
    weights["output_bias"][:] = 0.4 * gain, -0.6 * gain
    return EvidentialClassifier.from_weights(labels, weights)


def scan_at(distance: float) -> Array:
    """A scan (720,) with every return at one distance [m]."""
    return np.full(BEAMS, distance)
