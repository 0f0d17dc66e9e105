"""The classifier at run time: preprocessing, the same numbers as torch, what it refuses."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.calibration import assess, judge_all, reliability
from learning.classifier import BEAMS, EvidentialClassifier, confidence, dirichlet, fill_gaps, preprocess
from tests.learning.classifiers import FAR, NEAR, random_classifier, range_classifier, scan_at


def random_scan(seed: int) -> np.ndarray:
    """Walls between 0.1 and 8 m with no-returns of all kinds."""
    rng = np.random.default_rng(seed)
    ranges = np.clip(2.0 + np.cumsum(rng.normal(0.0, 0.2, BEAMS)), 0.1, 8.0)
    ranges[rng.random(BEAMS) < 0.1] = rng.choice([np.inf, np.nan, -np.inf])
    ranges[: rng.integers(0, 80)] = np.inf
    return ranges


# --- preprocessing ---------------------------------------------------------------------------------------------------


def test_inner_gaps_are_interpolated_and_end_gaps_become_short() -> None:
    ranges = np.linspace(1.0, 4.0, BEAMS)
    expected = ranges.copy()
    ranges[100:150] = np.inf  # on a straight line, interpolation restores it
    ranges[300] = np.nan
    ranges[:50], expected[:50] = np.inf, 0.05
    ranges[700:], expected[700:] = -np.inf, 0.05
    np.testing.assert_allclose(fill_gaps(ranges), expected, rtol=1e-12)


def test_input_is_the_centre_clipped_at_five_metres() -> None:
    ranges = np.full(BEAMS, 2.5)
    ranges[:40], ranges[680:] = 0.3, 0.3  # outside the crop
    ranges[300:310] = 12.0
    inputs = preprocess(ranges)
    assert inputs.shape == (640,)
    assert inputs.dtype == np.float32
    assert set(np.unique(inputs).tolist()) == {0.5, 1.0}
    assert np.flatnonzero(inputs == 1.0).tolist() == list(range(260, 270))


@given(st.integers(0, 10**6))
def test_input_is_always_finite_and_leaves_the_scan_alone(seed: int) -> None:
    ranges = random_scan(seed)
    before = ranges.copy()
    inputs = preprocess(ranges)
    assert np.isfinite(inputs).all()
    assert ((inputs >= 0.0) & (inputs <= 1.0)).all()
    np.testing.assert_array_equal(ranges, before)


# --- the network -----------------------------------------------------------------------------------------------------


def torch_logits(classifier: EvidentialClassifier, ranges: np.ndarray) -> np.ndarray:
    """The same network from torch's own layers."""
    w = {name: torch.from_numpy(np.array(value)) for name, value in classifier.weights.items()}
    x = torch.from_numpy(preprocess(ranges))[None, None, :]
    x = torch.relu(torch.nn.functional.conv1d(x, w["kernel"].T[:, None, :], w["kernel_bias"], stride=5))
    x = x.permute(0, 2, 1).flatten(1)
    if "hidden" in w:
        x = torch.relu(torch.nn.functional.linear(x, w["hidden"].T, w["hidden_bias"]))
    return np.asarray(torch.nn.functional.linear(x, w["output"].T, w["output_bias"])[0].numpy())


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**6), st.sampled_from([0, 64]), st.integers(2, 7))
def test_logits_equal_torch(seed: int, hidden: int, contexts: int) -> None:
    classifier, ranges = random_classifier(seed, hidden, contexts), random_scan(seed)
    np.testing.assert_allclose(
        classifier.logits(preprocess(ranges)), torch_logits(classifier, ranges), rtol=1e-5, atol=1e-5
    )


def test_confidence_is_one_minus_vacuity() -> None:
    alpha = dirichlet(np.array([-800.0, -800.0, -800.0]))
    np.testing.assert_allclose(alpha, 1.0)
    assert confidence(alpha) == 0.0
    alpha = dirichlet(np.array([12.0, -800.0, -800.0]))  # evidence 12: sum 15 = 5 N
    assert confidence(alpha) == pytest.approx(0.8, abs=1e-6)


def test_judgement_names_the_context() -> None:
    classifier = range_classifier()
    near, far, between = (classifier.judge(scan_at(d)) for d in (0.5, 4.5, 2.5))
    assert near is not None
    assert far is not None
    assert between is not None
    assert (near.label, near.index) == (NEAR, 0)
    assert (far.label, far.index) == (FAR, 1)
    assert near.confidence > 0.9
    assert far.confidence > 0.9
    assert between.confidence < 0.1


def test_scans_that_cannot_be_judged_give_none() -> None:
    classifier = range_classifier()
    assert classifier.judge(scan_at(np.inf)) is None
    assert classifier.judge(scan_at(np.nan)) is None
    overflowing = {name: np.full_like(w, 3e38) for name, w in random_classifier().weights.items()}
    assert EvidentialClassifier.from_weights(("a", "b", "c", "d"), overflowing).judge(scan_at(1.0)) is None


@pytest.mark.parametrize("size", [0, 1, 640, 719, 1081])
def test_other_scan_sizes_are_refused(size: int) -> None:
    with pytest.raises(ValueError, match=f"720 beams; this scan has {size}$"):
        range_classifier().judge(np.ones(size))


def test_weights_that_do_not_fit_are_refused() -> None:
    weights = dict(random_classifier().weights)
    labels = ("a", "b", "c", "d")
    for change, words in (
        ({"output": weights["output"][:, :3]}, "shape"),
        ({"output": weights["output"].astype(np.float64)}, "float32"),
        ({"kernel": np.full_like(weights["kernel"], np.nan)}, "finite"),
        ({"hidden_bias": np.zeros((0,), dtype=np.float32)}, "shape|hidden"),
        ({"extra": weights["kernel"]}, "unknown"),
    ):
        with pytest.raises(ValueError, match=words):
            EvidentialClassifier.from_weights(labels, {**weights, **change})
    for missing in weights:
        with pytest.raises(ValueError, match=r"missing|belong together"):
            EvidentialClassifier.from_weights(labels, {k: v for k, v in weights.items() if k != missing})
    for wrong in (("a",), ("a", "a", "b", "c"), ("a", "b", "c", "d", "e")):
        with pytest.raises(ValueError, match=r"two or more|shape"):
            EvidentialClassifier.from_weights(wrong, weights)


def test_weights_are_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        random_classifier().kernel[0, 0] = 1.0


def test_one_judgement_takes_well_under_a_millisecond() -> None:
    classifier, ranges = random_classifier(), random_scan(1)
    classifier.judge(ranges)
    times = []
    for _ in range(200):
        began = time.process_time()
        classifier.judge(ranges)
        times.append(time.process_time() - began)
    assert np.median(times) < 1e-3


def test_driving_needs_no_torch() -> None:
    code = "import sys, learning.deploy; sys.exit(any(m in sys.modules for m in ('torch', 'cma', 'mujoco')))"
    assert subprocess.run([sys.executable, "-c", code], timeout=120, check=False).returncode == 0


# --- calibration -----------------------------------------------------------------------------------------------------


def test_reliability_of_an_honest_and_of_a_boastful_judge() -> None:
    rng = np.random.default_rng(0)
    stated = rng.random(20_000)
    honest = reliability(stated, rng.random(20_000) < stated)
    assert honest.ece < 0.02
    assert sum(honest.counts) == 20_000
    assert len(honest.edges) == len(honest.counts) + 1
    boastful = reliability(np.ones(100), np.arange(100) < 50)
    assert boastful.ece == pytest.approx(0.5)
    assert boastful.counts[-1] == 100
    assert reliability(np.empty(0), np.empty(0, dtype=bool)).ece == 0.0


def test_assessment_counts_what_it_says() -> None:
    scans = np.array([scan_at(d) for d in (0.5, 0.5, 4.5, 0.5, np.inf)])
    result = assess(range_classifier(), scans, (NEAR, NEAR, FAR, FAR, FAR), 0.8)
    assert result.scans == 5
    assert result.accuracy == pytest.approx(3 / 5)
    assert result.confident_share == pytest.approx(4 / 5)  # the scan without returns is judged with confidence 0
    assert np.isnan(judge_all(range_classifier(), np.empty((0, BEAMS))).confident_share(0.8))
