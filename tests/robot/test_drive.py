"""Laws of the base controller."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.records import Command
from twin.robot import drive

CONFIG = drive.DriveConfig()
speeds = st.floats(-6.0, 6.0)


def settle(command: Command, periods: int = 60) -> tuple[drive.DriveState, drive.WheelCommand]:
    """The controller after a command has been held."""
    state, wheels = drive.DriveState(), drive.WheelCommand(0.0, 0.0)
    for _ in range(periods):
        state, wheels = drive.advance(drive.receive(state, command), CONFIG)
    return state, wheels


def test_straight_ahead_turns_both_sides_alike() -> None:
    _, wheels = settle(Command(0.49, 0.0))
    assert wheels.left == pytest.approx(0.49 / 0.098)
    assert wheels.right == wheels.left


def test_a_turn_is_driven_with_one_and_a_half_times_the_track() -> None:
    _, wheels = settle(Command(0.0, 1.0))
    assert wheels.right == pytest.approx(1.5 * 0.37559 / 2 / 0.098)
    assert wheels.left == -wheels.right


@given(speeds, speeds)
def test_held_commands_end_at_the_limits(v: float, w: float) -> None:
    state, _ = settle(Command(v, w))
    assert state.v == pytest.approx(max(-2.0, min(2.0, v)))
    assert state.w == pytest.approx(max(-4.0, min(4.0, w)))


@given(st.lists(st.tuples(speeds, speeds), min_size=1, max_size=20))
def test_acceleration_is_limited(commands: list[tuple[float, float]]) -> None:
    state = drive.DriveState()
    for v, w in commands:
        before = state
        state, _ = drive.advance(drive.receive(state, Command(v, w)), CONFIG)
        assert abs(state.v - before.v) <= 20.0 * 0.02 + 1e-12
        assert abs(state.w - before.w) <= 25.0 * 0.02 + 1e-12
        assert abs(state.v) <= 2.0
        assert abs(state.w) <= 4.0


def test_a_command_lasts_a_quarter_of_a_second() -> None:
    state, _ = settle(Command(0.5, 1.0))
    seconds = 0.0
    while state.v == 0.5:
        state, _ = drive.advance(state, CONFIG)
        seconds += CONFIG.period
    assert 0.24 <= seconds <= 0.30
    for _ in range(5):
        state, wheels = drive.advance(state, CONFIG)
    assert wheels == drive.WheelCommand(0.0, 0.0)
