"""What the classifier learns from: labelled scans, and scans of elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from learning.augment import Augmentation
from learning.classifier import preprocess
from learning.interventions import Intervention, Kind, Step
from learning.labelled_scans import APART, background_scans, labelled_scans
from learning.unfamiliar import NO_SCANS, Unfamiliar
from tests.learning.observations import METADATA, slalom_drive
from twin.planner.params import PlannerParams
from twin.records import Command, Pose2

STILL = Augmentation(mirror=0.0, shift=0.0, noise=0.0, translation=0.0)


def shown(label: str, places: list[float], world: str = "training", labelled: bool = True) -> Intervention:
    """Steps at x = places; every beam of a scan reads 1 + x."""
    kind: Kind = label[0]  # type: ignore[assignment]
    seen = slalom_drive(PlannerParams(), 2)[0].observation
    steps = []
    for k, x in enumerate(places):
        scan = replace(seen.scan, ranges=np.full(720, 1.0 + x))
        steps.append(
            Step(replace(seen, time=0.05 * k, pose=Pose2(x, 0.0, 0.0), scan=scan), Command(0.3, 0.0), labelled)
        )
    return Intervention(kind, label, steps, replace(METADATA, world=world))


def test_background_is_what_others_show_elsewhere() -> None:
    taught = [shown("A1", [0.0, 0.5]), shown("B1", [9.0], labelled=False)]
    near, far = 0.5 + 0.9 * APART, 0.5 + 1.1 * APART
    others = [shown("D1", [near, far, 9.0]), shown("D2", [0.2], world="unseen"), shown("D3", [7.0], labelled=False)]
    assert background_scans(taught, others)[:, 0].tolist() == [1.0 + far, 10.0, 1.2]
    assert background_scans(taught, []).shape == (0, 720)


def test_labelled_scans_are_those_of_labelled_steps_in_blocks_of_a_second() -> None:
    long = shown("A1", [0.1 * k for k in range(30)])  # 1.5 s
    data = labelled_scans([long, shown("B1", [5.0], labelled=False), shown("B2", [6.0])])
    assert data.contexts == ("A1", "B2")
    assert data.scans[-1, 0] == 7.0
    assert [len(set(data.blocks[:20])), len(set(data.blocks[:30])), len(set(data.blocks))] == [1, 2, 3]


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_unfamiliar_scans_are_made_up_and_real_in_the_share_asked_for(share: float) -> None:
    rng = np.random.default_rng(0)
    both = Unfamiliar(np.full((5, 720), 1.0), np.full((7, 720), 2.0), share)
    drawn = both.draw(40, STILL, rng)
    assert (drawn == preprocess(np.full(720, 1.0))).all(axis=1).sum() == round(40 * share)
    assert (drawn == preprocess(np.full(720, 2.0))).all(axis=1).sum() == 40 - round(40 * share)


def test_one_kind_of_unfamiliar_scans_is_enough() -> None:
    rng = np.random.default_rng(0)
    ones = np.full((5, 720), 1.0)
    assert (Unfamiliar(ones, NO_SCANS).draw(8, STILL, rng) == np.float32(0.2)).all()
    assert (Unfamiliar(NO_SCANS, ones).draw(8, STILL, rng) == np.float32(0.2)).all()
    assert Unfamiliar(NO_SCANS, NO_SCANS).draw(8, STILL, rng).shape == (0, 640)


def test_a_split_keeps_every_unfamiliar_scan_once() -> None:
    made, real = np.arange(10.0)[:, None] * np.ones(720), np.arange(20.0, 40.0)[:, None] * np.ones(720)
    aside, rest = Unfamiliar(made, real).split(0.1, np.random.default_rng(0))
    assert (len(aside.made_up), len(aside.background)) == (1, 2)
    assert sorted([*aside.made_up[:, 0], *rest.made_up[:, 0]]) == made[:, 0].tolist()
    assert sorted([*aside.background[:, 0], *rest.background[:, 0]]) == real[:, 0].tolist()
