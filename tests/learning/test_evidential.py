"""Training: the losses against their definitions, augmentation against geometry, and what a classifier learns."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.augment import BEARINGS, Augmentation, augmented, mirror, translate
from learning.calibration import MOST_FACTOR, evidence_factor, judge_all, sharpened
from learning.classifier import BEAMS, CROP, EvidentialClassifier, preprocess
from learning.evidential import (
    PLAIN,
    TENTH,
    Network,
    Round,
    ScanDataset,
    Trained,
    TrainingOptions,
    evidential_loss,
    expected_cross_entropy,
    expected_squared_error,
    time_blocks,
    train,
    uniform_kl,
)
from learning.labelled_scans import balanced, split
from learning.unfamiliar import compose_place, familiar, made_up_scans, scan_of
from tests.learning.classifiers import range_classifier, scan_at

NO_CIRCLES = np.empty((0, 3))


def rectangle(x0: float, y0: float, x1: float, y1: float) -> list[tuple[float, float, float, float]]:
    """Four walls [m]."""
    return [(x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)]


def room_scan(x: float, y: float, yaw: float, walls: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
    """The scan (720,) from a pose in a place of wall segments (n, 4) [m]."""
    c, s = math.cos(yaw), math.sin(yaw)
    local = (walls.reshape(-1, 2, 2) - np.array([x, y])) @ np.array([[c, -s], [s, c]])
    return scan_of(local.reshape(-1, 4), NO_CIRCLES) + noise * rng.standard_normal(BEAMS)


# --- losses ----------------------------------------------------------------------------------------------------------

ALPHA = torch.tensor([[1.0, 1.0, 1.0], [9.0, 2.0, 1.0], [1.5, 40.0, 3.0]], dtype=torch.float64)
LABEL = torch.tensor([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)


def test_expected_losses_are_expectations_over_the_dirichlet() -> None:
    torch.manual_seed(0)
    p = torch.distributions.Dirichlet(ALPHA).sample((400_000,))
    entropy = -(LABEL * p.log()).sum(-1).mean(0)
    torch.testing.assert_close(expected_cross_entropy(ALPHA, LABEL), entropy, rtol=0.02, atol=0.01)
    squared = ((LABEL - p) ** 2).sum(-1).mean(0)
    torch.testing.assert_close(expected_squared_error(ALPHA, LABEL), squared, rtol=0.02, atol=0.01)


def test_uniform_kl_equals_torchs() -> None:
    uniform = torch.distributions.Dirichlet(torch.ones_like(ALPHA))
    expected = torch.distributions.kl_divergence(torch.distributions.Dirichlet(ALPHA), uniform)
    torch.testing.assert_close(uniform_kl(ALPHA), expected)
    assert uniform_kl(ALPHA)[0] == pytest.approx(0.0, abs=1e-12)


def test_kl_term_sees_misleading_evidence_only() -> None:
    y = torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64)
    for right in (1.0, 10.0, 100.0):  # evidence for the label costs nothing
        alpha = torch.tensor([[right, 1.0, 1.0]], dtype=torch.float64)
        assert evidential_loss(alpha, y, 1.0) == pytest.approx(float(evidential_loss(alpha, y, 0.0)))
    wrong = torch.tensor([[1.0, 5.0, 1.0]], dtype=torch.float64)
    assert evidential_loss(wrong, y, 1.0) > evidential_loss(wrong, y, 0.0)


# --- data ------------------------------------------------------------------------------------------------------------


def test_time_blocks_never_join_interventions_or_distant_times() -> None:
    times = np.array([0.0, 0.4, 0.6, 1.2, 0.1, 0.2])
    sources = np.array([0, 0, 0, 0, 1, 1])
    assert time_blocks(times, sources, 0.5).tolist() == [0, 0, 1, 2, 3, 3]


@given(st.integers(0, 10**6), st.floats(0.05, 0.9))
def test_split_keeps_blocks_whole_and_every_context_on_both_sides(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    blocks = np.sort(rng.integers(0, 20, 200))
    blocks[:2], blocks[-2:] = (0, 1), (18, 19)
    labels = tuple("A1" if b < 10 else "B1" for b in blocks)
    dataset = ScanDataset(rng.uniform(1.0, 2.0, (200, BEAMS)), labels, blocks)
    taught, held = split(dataset, share, rng)
    assert not set(taught.blocks.tolist()) & set(held.blocks.tolist())
    assert len(taught.labels) + len(held.labels) == 200
    assert set(taught.labels) == set(held.labels) == {"A1", "B1"}


@given(st.integers(0, 10**6), st.integers(1, 300))
def test_balanced_draws_every_context_equally_often(seed: int, count: int) -> None:
    truth = np.array([0] * 50 + [1] * 7 + [2] * 13)
    drawn = balanced(truth, count, np.random.default_rng(seed))
    assert len(drawn) == count
    counts = np.bincount(truth[balanced(truth, 300, np.random.default_rng(seed))], minlength=3)
    assert counts.tolist() == [100, 100, 100]


def test_arrays_that_do_not_match_are_refused() -> None:
    scans, blocks = np.ones((3, BEAMS)), np.arange(3)
    with pytest.raises(ValueError, match="shape"):
        ScanDataset(np.ones((3, 640)), ("A1",) * 3, blocks)
    with pytest.raises(ValueError, match="do not match"):
        ScanDataset(scans, ("A1",) * 2, blocks)
    with pytest.raises(ValueError, match="two contexts"):
        train(ScanDataset(scans, ("A1",) * 3, blocks))
    with pytest.raises(ValueError, match="'B1' has one time block"):
        train(ScanDataset(scans, ("A1", "A1", "B1"), blocks))
    with pytest.raises(ValueError, match="two contexts"):  # scans without any return do not count
        train(ScanDataset(np.array([scans[0], scans[0], np.full(BEAMS, np.inf)]), ("A1", "A1", "B1"), blocks))
    pair = ScanDataset(np.ones((4, BEAMS)), ("A1", "A1", "B1", "B1"), np.arange(4))
    with pytest.raises(ValueError, match="ood_weight"):
        train(pair, TrainingOptions(ood_weight=0.0), background=scans)


# --- augmentation ----------------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=25)
@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-3.0, 3.0))
def test_translation_is_what_the_moved_sensor_sees(dx: float, dy: float, yaw: float) -> None:
    walls, rng = np.array(rectangle(-2.0, -1.2, 3.0, 1.5)), np.random.default_rng(0)
    here = room_scan(0.3, 0.1, yaw, walls, 0.0, rng)
    c, s = math.cos(yaw), math.sin(yaw)
    there = room_scan(0.3 + c * dx - s * dy, 0.1 + s * dx + c * dy, yaw, walls, 0.0, rng)
    moved = translate(here, dx, dy)
    centre = slice(40, 680)  # the ends have moved out of what was seen
    assert np.median(np.abs(moved - there)[centre]) < 1e-3
    assert np.quantile(np.abs(moved - there)[centre], 0.95) < 0.02  # corners


def test_translation_keeps_a_pillar_in_front_of_the_wall() -> None:
    circles = np.array([[1.0, 0.0, 0.15]])
    walls = np.array(rectangle(-3.0, -3.0, 3.0, 3.0)) + 0.0
    here, there = scan_of(walls, circles), scan_of(walls + np.array([0.0, -0.1] * 2), circles - [0.0, 0.1, 0.0])
    moved = translate(here, 0.0, 0.1)
    seen = np.isfinite(moved)
    assert seen.mean() > 0.95
    assert np.mean(np.abs(moved - there)[seen] < 0.05) > 0.97


def test_no_translation_is_the_same_scan() -> None:
    ranges = scan_of(np.array(rectangle(-1.0, -1.0, 4.0, 1.3)), np.array([[1.0, 0.4, 0.2]]))
    ranges[100:120] = np.inf
    np.testing.assert_allclose(translate(ranges, 0.0, 0.0), ranges, atol=1e-9)


def test_mirror_twice_is_the_same_scan() -> None:
    ranges = np.random.default_rng(0).uniform(0.1, 8.0, (3, BEAMS))
    np.testing.assert_array_equal(mirror(mirror(ranges)), ranges)
    np.testing.assert_array_equal(mirror(ranges)[:, 0], ranges[:, -1])


NOTHING = Augmentation(0.0, 0.0, 0.0, 0.0)


def test_each_augmentation_alone() -> None:
    rng = np.random.default_rng(0)
    scans = rng.uniform(0.5, 4.5, (5, BEAMS))
    order = np.array([0, 1, 2, 3, 4, 4])
    plain = np.array([preprocess(scan) for scan in scans[order]])
    np.testing.assert_allclose(augmented(scans, order, rng, NOTHING), plain, atol=1e-6)
    flipped = augmented(scans, order, rng, replace(NOTHING, mirror=1.0))
    np.testing.assert_allclose(flipped, plain[:, ::-1], atol=1e-6)
    noisy = augmented(scans, order, rng, replace(NOTHING, noise=0.05)) - plain
    assert 0.0099 < np.abs(noisy).max() <= 0.0100001  # 0.05 m of 5 m
    turned = augmented(scans, np.zeros(300, dtype=np.int64), rng, replace(NOTHING, shift=math.radians(10.0)))
    starts = {int(np.argmin(np.abs(scans[0] / 5.0 - row[0]))) for row in turned}
    assert (min(starts), max(starts)) == (40 - 26, 40 + 26)  # 10 degrees are 26 beams
    assert Augmentation(shift=math.radians(90.0)).beams == 40  # never beyond the scan


# --- unfamiliar scans ------------------------------------------------------------------------------------------------


def test_cast_scans_equal_closed_forms() -> None:
    wall = scan_of(np.array([[2.0, -50.0, 2.0, 50.0]]), NO_CIRCLES)
    facing = np.abs(BEARINGS) < 1.5
    np.testing.assert_allclose(wall[facing], 2.0 / np.cos(BEARINGS[facing]), rtol=1e-9)
    assert np.isinf(wall[np.abs(BEARINGS) > 1.58]).all()
    pillar = scan_of(np.empty((0, 4)), np.array([[3.0, 0.0, 0.5]]))
    assert pillar[BEAMS // 2] == pytest.approx(2.5, abs=1e-3)
    assert np.isinf(pillar[np.abs(BEARINGS) > math.asin(0.5 / 3.0) + 0.01]).all()


def test_composed_places_leave_room_for_the_robot() -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        ranges = scan_of(*compose_place(rng))
        assert ranges.shape == (BEAMS,)
        assert ranges.min() > 0.24


# In the small rooms of these tests the default's reach of 0.4 m and 15 degrees would be most of a room.
NEAR = Augmentation(shift=math.radians(10.0), translation=0.2)


def test_training_scans_and_their_mirror_images_are_familiar() -> None:
    dataset = three_places(8.0, 0)
    truth = dataset.indices(dataset.contexts)
    how, rng = NEAR, np.random.default_rng(0)
    assert familiar(dataset.scans[::7], dataset.scans, truth, how, rng).all()
    assert familiar(mirror(dataset.scans)[::7], dataset.scans, truth, how, rng).all()
    made = made_up_scans(dataset.scans, truth, 200, how, rng)
    assert 100 < len(made) <= 200
    assert familiar(made, dataset.scans, truth, how, rng).mean() < 0.02, "but for the radius, which is drawn anew"
    nothing = replace(how, shift=0.0, noise=0.0, translation=0.0)
    assert familiar(made, dataset.scans, truth, replace(how, translation=2.0), rng).sum() > len(made) // 20
    assert not familiar(made, dataset.scans, truth, nothing, rng).any()


# --- learning --------------------------------------------------------------------------------------------------------

Place = tuple[np.ndarray, Callable[[float], tuple[float, float, float]]]  # walls; pose at 0 .. 1 of the drive

PLACES: dict[str, Place] = {
    "A2": (np.array(rectangle(-3.0, -0.4, 9.0, 0.4)), lambda s: (4.0 * s, 0.05 * math.sin(9 * s), 0.05)),
    "B1": (np.array(rectangle(-3.0, -4.0, 9.0, 4.0)), lambda s: (4.0 * s, math.sin(3 * s), 0.6 * math.cos(3 * s))),
    "B2": (
        np.array([(3.0, -6.0, 3.0, -0.5), (3.0, 0.5, 3.0, 6.0), (3.0, 0.5, 8.0, 0.5), (3.0, -0.5, 8.0, -0.5)]),
        lambda s: (2.5 * s, 0.8 * (1 - s), -0.25 + 0.25 * s),
    ),
}  # fmt: skip
ELSEWHERE = np.array([*rectangle(-2.0, -1.3, 2.2, 1.5), *rectangle(1.0, -0.9, 1.5, -0.2), *rectangle(-1.0, 0.5, 0, 1)])


def three_places(seconds: float, seed: int) -> ScanDataset:
    """A drive through three places, 20 scans per second each."""
    rng, scans, labels, times = np.random.default_rng(seed), [], [], []
    for label, (walls, pose) in PLACES.items():
        for t in np.arange(0.0, seconds, 0.05):
            x, y, yaw = pose(t / seconds)
            scans.append(room_scan(x + 0.03 * rng.normal(), y, yaw + 0.03 * rng.normal(), walls, 0.001, rng))
            labels.append(label)
            times.append(t)
    sources = np.array([sorted(PLACES).index(label) for label in labels])
    return ScanDataset(np.array(scans), tuple(labels), time_blocks(np.array(times), sources, 0.5))


def scans_elsewhere(count: int) -> np.ndarray:
    """Scans from a furnished room that no context knows."""
    rng = np.random.default_rng(1)
    poses = rng.uniform((-0.8, -0.8, -3.0), (0.6, 0.3, 3.0), (count, 3))
    return np.array([room_scan(*pose, ELSEWHERE, 0.001, rng) for pose in poses])


@lru_cache(maxsize=2)
def trained(ood_weight: float) -> Trained:
    """A short training on the three places."""
    options = TrainingOptions(
        steps=500, ood_scans=800, ood_weight=ood_weight, annealing_steps=100, patience=500, augmentation=NEAR
    )
    return train(three_places(6.0, 0), options, outside=scans_elsewhere(150))


@pytest.mark.slow
def test_known_places_are_recognised_with_confidence_and_others_are_not() -> None:
    report = trained(0.1).report
    assert report.held_out.accuracy >= 0.9
    assert report.held_out.confidence >= 0.8
    assert report.outside_share <= 0.2
    assert report.unfamiliar_share <= 0.2
    assert report.held_out.scans + report.training_scans == 360
    assert [r.steps for r in report.rounds if math.isnan(r.validation)][-1:] == [report.best_step]
    assert json.dumps(report.figures(), allow_nan=False)


@pytest.mark.slow
def test_plain_edl_is_surer_of_itself_where_it_has_no_reason() -> None:
    assert trained(0.0).report.outside_share > trained(0.1).report.outside_share
    assert math.isnan(trained(0.0).report.unfamiliar_share)


@pytest.mark.slow
def test_the_trained_classifier_recognises_another_drive_and_the_mirrored_places() -> None:
    classifier, again = trained(0.1).classifier, three_places(3.0, 5)
    for scans in (again.scans, mirror(again.scans)):
        answers = [classifier.judge(scan) for scan in scans]
        assert np.mean([a is not None and a.label == y for a, y in zip(answers, again.labels, strict=True)]) >= 0.9


def test_run_time_network_equals_the_trained_one() -> None:
    rng = np.random.default_rng(0)
    network = Network(3, 16, rng)
    classifier = EvidentialClassifier.from_weights(("a", "b", "c"), network.copy())
    scans = rng.uniform(0.2, 6.0, (10, BEAMS))
    inputs = np.array([preprocess(scan) for scan in scans])
    assert inputs.shape == (10, CROP)
    with torch.no_grad():
        expected = network.alpha(torch.from_numpy(inputs)).numpy()
    found = [classifier.judge(scan) for scan in scans]
    np.testing.assert_allclose([a.alpha for a in found if a is not None], expected, rtol=1e-5)


@pytest.mark.parametrize("options", [TrainingOptions(), replace(PLAIN, loss="squared_error")])
def test_equal_seeds_give_equal_weights_and_others_do_not(options: TrainingOptions) -> None:
    options = replace(options, steps=30, ood_scans=60)
    dataset, rounds = three_places(2.0, 0), list[Round]()
    first = train(dataset, options, progress=rounds.append)
    torch.rand(3)  # no global state matters
    second = train(dataset, options)
    other = train(dataset, replace(options, seed=1))
    for name, weights in first.classifier.weights.items():
        assert weights.tobytes() == second.classifier.weights[name].tobytes()
    assert first.classifier.weights["output"].tobytes() != other.classifier.weights["output"].tobytes()
    assert tuple(rounds) == first.report.rounds
    assert [r.training for r in rounds] == [r.training for r in second.report.rounds]
    assert [r.steps for r in rounds] == [30, 30]


def test_a_mean_network_forgets_all_but_the_last_tenth() -> None:
    rng = np.random.default_rng(0)
    mean, network = Network(2, 4, rng), Network(2, 4, rng)
    steps, before = 1000, mean.copy()
    for step in range(steps):
        with torch.no_grad():
            network.weights["output_bias"].fill_(float(step))
        mean.approach(network, TENTH / (step + TENTH))
    # weights n (n + 1) .. (n + 8) of step n have the mean 10 / 11 of all steps
    np.testing.assert_allclose(mean.copy()["output_bias"], steps * 10 / 11, rtol=0.01)
    np.testing.assert_allclose(mean.copy()["output"], network.copy()["output"], rtol=1e-4, atol=1e-6)
    assert not np.allclose(before["output"], network.copy()["output"])


def test_the_smallest_factor_that_lets_enough_scans_pass() -> None:
    plain = range_classifier(gain=20.0)
    scans = np.array([scan_at(distance) for distance in np.linspace(0.5, 4.5, 41)])
    shares = []
    for wanted in (0.0, 0.4, 0.5):
        factor = evidence_factor(plain, scans, wanted, 0.8)
        after, before = judge_all(sharpened(plain, factor), scans), judge_all(plain, scans)
        shares.append(before.confident_share(0.8))
        assert after.confident_share(0.8) >= wanted
        assert after.index.tolist() == before.index.tolist()
        if factor > 1.0:
            assert judge_all(sharpened(plain, 0.98 * factor), scans).confident_share(0.8) < wanted
    assert evidence_factor(plain, scans, 0.0, 0.8) == 1.0
    assert shares[0] < 0.4  # so that there was something to do
    hopeless = evidence_factor(plain, scans, 1.0, 0.8)  # in the middle no factor is enough
    assert 1.0 < hopeless <= MOST_FACTOR
    most = judge_all(sharpened(plain, MOST_FACTOR), scans).confident_share(0.8)
    assert judge_all(sharpened(plain, hopeless), scans).confident_share(0.8) == most < 1.0
    assert judge_all(sharpened(plain, 0.98 * hopeless), scans).confident_share(0.8) < most
    with pytest.raises(ValueError, match="without scans"):
        evidence_factor(plain, scans[:0], 0.5, 0.8)


def test_training_scales_the_evidence_of_what_is_deployed() -> None:
    options = TrainingOptions(steps=60, ood_scans=60, annealing_steps=10)
    scaled, as_trained = (train(three_places(2.0, 0), replace(options, confident=c)) for c in (0.95, 0.0))
    factor = scaled.report.evidence_factor
    assert factor > 1.0
    assert as_trained.report.evidence_factor == 1.0
    for name, weights in as_trained.classifier.weights.items():
        by = np.float32(factor if name.startswith("output") else 1.0)
        np.testing.assert_array_equal(scaled.classifier.weights[name], weights * by)
    assert scaled.report.held_out.confidence > as_trained.report.held_out.confidence
    assert scaled.report.held_out.accuracy == as_trained.report.held_out.accuracy


@pytest.mark.parametrize("change", [{"confident": 1.5}, {"confident": -0.1}, {"steps": 0}])
def test_training_options_that_make_no_sense_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        replace(TrainingOptions(), **change)


@pytest.mark.slow
def test_background_scans_lower_the_confidence_there() -> None:
    rng = np.random.default_rng(2)
    wider = np.array(rectangle(-3.0, -0.6, 9.0, 0.6))  # much like A2, but the default was fine there
    poses = rng.uniform((0.0, -0.1, -0.1), (4.0, 0.1, 0.1), (80, 3))
    fine = np.array([room_scan(*pose, wider, 0.001, rng) for pose in poses])
    options = TrainingOptions(steps=300, ood_scans=300, annealing_steps=100)
    without = train(three_places(4.0, 0), options, outside=fine[1::2])
    taught = train(three_places(4.0, 0), options, background=fine[::2], outside=fine[1::2])
    assert taught.report.outside_confidence < without.report.outside_confidence - 0.1
