"""Rewinding is exact: what is driven again from an earlier tick is the same, byte for byte."""

from __future__ import annotations

import numpy as np
import pytest

from scenarios.trials import tick_bytes
from twin.planner.move_base import MoveBaseDriver
from twin.records import Command, Pose2
from twin.rewind import KEYFRAME, Tape
from twin.rollout import Loop, rollout
from twin.simulation import Simulation
from twin.world import Box, Cylinder, Rules, World

WORLD = World(
    "test",
    (Cylinder(1.6, 0.2, 0.1, 0.5), Box(3.0, -0.6, 0.3, 0.5, 0.5, 0.5), Box(3.0, 0.9, 0.0, 0.5, 0.5, 0.5)),
    Pose2(0.0, 0.0, 0.0),
    Pose2(6.0, 0.0, 0.0),
    Rules("course", 0.5, 60.0),
)


def tape(seconds: float = 30.0) -> Tape:
    return Tape(Loop(Simulation(WORLD, np.random.default_rng(5)), MoveBaseDriver()), seconds)


@pytest.mark.parametrize("index", [0, 7, KEYFRAME, 53])
def test_a_rewound_drive_replays_bit_for_bit(index: int) -> None:
    recorder = tape()
    first = [tick_bytes(recorder.step()) for _ in range(70)]
    recorder.rewind(index)
    assert recorder.position == index
    assert [tick_bytes(recorder.step()) for _ in range(index, 70)] == first[index:]


def test_a_tape_changes_nothing() -> None:
    plain = []
    for tick in rollout(Simulation(WORLD, np.random.default_rng(5)), MoveBaseDriver()):
        plain.append(tick_bytes(tick))
        if len(plain) == 45:
            break
    recorder = tape()
    assert [tick_bytes(recorder.step()) for _ in range(45)] == plain


def test_a_persons_commands_are_replayed_too() -> None:
    recorder = tape()
    human = [Command(0.3, 0.4) if 15 <= k < 35 else None for k in range(60)]
    first = [tick_bytes(recorder.step(c)) for c in human]
    recorder.rewind(30)
    assert [tick_bytes(recorder.step(c)) for c in human[30:]] == first[30:]
    recorder.rewind(30)
    other = [tick_bytes(recorder.step()) for _ in range(30)]
    assert other != first[30:], "without the person it goes elsewhere"


def test_the_tape_is_bounded_but_long_enough() -> None:
    recorder = tape(seconds=3.0)
    for _ in range(150):
        recorder.step()
    assert recorder.position - recorder.oldest >= 60
    assert recorder.position - recorder.oldest <= 60 + 2 * KEYFRAME
    with pytest.raises(ValueError, match="not on the tape"):
        recorder.rewind(0)
    with pytest.raises(ValueError, match="not on the tape"):
        recorder.rewind(151)


def test_the_override_goes_before_the_driver() -> None:
    recorder = tape()
    for _ in range(20):
        tick = recorder.step(Command(0.0, 1.0))
    assert tick.applied == Command(0.0, 1.0)
    assert tick.decision.command is not None
    assert tick.decision.command != tick.applied
    assert tick.observation.twist.w == pytest.approx(1.0, abs=0.15)


def test_an_excursion_leaves_no_trace() -> None:
    plain = tape()
    expected = [tick_bytes(plain.step()) for _ in range(80)]
    recorder = tape()
    first = [tick_bytes(recorder.step()) for _ in range(50)]
    with recorder.excursion(20):
        elsewhere = [tick_bytes(recorder.step(Command(0.2, -0.8))) for _ in range(45)]
    rest = [tick_bytes(recorder.step()) for _ in range(30)]
    assert first + rest == expected
    assert elsewhere[:30] != expected[20:50]
    recorder.rewind(35)
    assert [tick_bytes(recorder.step()) for _ in range(10)] == expected[35:45]
