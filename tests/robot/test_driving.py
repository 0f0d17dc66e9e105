"""How the simulated Jackal follows its commands.

The yaw ratios that skid steering should give come from rigid-body mechanics with Coulomb friction: turning on the spot
1.04 of the command (the controller's multiplier is 1.5, the ideal 1 + (wheelbase/track)^2 = 1.487 with even loads), and
more the more centripetal force the tyres have to find: 1.18 at (0.5 m/s, 1 rad/s), 1.41 at (0.5, 1.57).
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tests.robot.driving import Track, held, run
from twin.records import Command
from twin.robot.odometry import OdometryConfig

STEPS = (0.002, 0.005)  # [s] physics steps that must agree


def steady(v: float, w: float, timestep: float = 0.002) -> Track:
    """The last 3 of 4 s under one command."""
    track = run(held(v, w, 4.0), timestep)
    return Track(track.poses[50:], track.twists[50:], track.estimates[50:], track.tilt[50:])


@pytest.mark.parametrize("timestep", STEPS)
@pytest.mark.parametrize("w", [0.5, 1.0, 1.57, 2.0, -1.57])
def test_turning_on_the_spot_follows_the_command(w: float, timestep: float) -> None:
    rates = steady(0.0, w, timestep).twists[:, 1]
    assert rates.mean() / w == pytest.approx(1.0, abs=0.10)
    assert rates.std() < 0.05  # pyramidal cones: 0.2


@pytest.mark.parametrize("timestep", STEPS)
@pytest.mark.parametrize("v", [0.1, 0.5, 1.0, 2.0, -0.3])
def test_driving_straight_is_straight_and_as_fast_as_told(v: float, timestep: float) -> None:
    track = steady(v, 0.0, timestep)
    assert track.twists[:, 0].mean() / v == pytest.approx(1.0, abs=0.001)
    along, across = track.poses[-1, :2] - track.poses[0, :2]
    assert abs(across) < 0.015 * abs(along)
    assert np.ptp(track.poses[:, 2]) < 1e-3


def test_an_arc_has_about_the_commanded_radius_and_is_the_mirror_of_its_mirror() -> None:
    left, right = steady(0.5, 0.5), steady(0.5, -0.5)
    assert left.twists[:, 0].mean() == pytest.approx(0.5, rel=0.02)
    assert left.twists[:, 1].mean() == pytest.approx(0.5, rel=0.10)
    assert right.twists[:, 1].mean() == pytest.approx(-left.twists[:, 1].mean(), rel=0.02)


@pytest.mark.parametrize(("v", "w", "coulomb"), [(0.5, 1.0, 1.18), (0.5, 1.57, 1.41)])
def test_tight_arcs_turn_faster_than_told_but_no_faster_than_coulomb_friction_allows(
    v: float, w: float, coulomb: float
) -> None:
    assert 1.0 < steady(v, w).twists[:, 1].mean() / w < coulomb


@pytest.mark.parametrize(("v", "w"), [(0.5, 0.0), (0.0, 1.57), (0.5, 0.5), (0.3, 1.0), (0.5, 1.57)])
def test_results_do_not_hinge_on_the_step_size(v: float, w: float) -> None:
    small, large = (steady(v, w, timestep).twists.mean(axis=0) for timestep in STEPS)
    np.testing.assert_allclose(large, small, rtol=0.06, atol=0.01)


def test_the_robot_stops_when_commands_stop() -> None:
    track = run([*held(0.5, 0.8, 1.0), *itertools.repeat(None, 50)])
    assert abs(track.twists[-1, 0]) < 1e-3
    assert abs(track.twists[-1, 1]) < 1e-3
    stopped = np.flatnonzero(np.abs(track.twists[:, 0]) > 0.01).max() - 49  # periods after the last command
    assert 0.25 / 0.02 <= stopped <= 0.45 / 0.02


@pytest.mark.parametrize("timestep", STEPS)
def test_the_scan_stays_level_when_the_robot_starts_and_stops(timestep: float) -> None:
    track = run([*held(0.5, 0.0, 0.5), *held(0.0, 0.0, 0.5)], timestep)
    assert track.tilt.max() < 0.02  # 0.02 rad is 1.5 m from the lidar before the floor comes within 0.27 m


def wandering(seed: int) -> list[Command]:
    """20 s of what a local planner sends: mostly 0.5 m/s with gentle turns, some hard ones."""
    rng = np.random.default_rng(seed)
    commands: list[Command] = []
    for _ in range(40):
        v = 0.5 if rng.random() < 0.8 else rng.uniform(0.0, 0.5)
        w = rng.normal(0.0, 0.5) if rng.random() < 0.8 else rng.uniform(-1.57, 1.57)
        commands += held(v, w, 0.5)
    return commands


@pytest.mark.parametrize("seed", range(3))
def test_odometry_drifts_little(seed: int) -> None:
    track = run(wandering(seed), seed=seed)
    error = track.estimates - track.poses
    assert np.linalg.norm(error[:, :2], axis=1).max() < 0.025 * track.length
    assert np.abs(error[:, 2]).max() < 0.05
    assert np.abs(error).max() > 1e-4  # but it does drift


def test_ideal_odometry_is_the_truth() -> None:
    track = run(wandering(0)[:200], config=OdometryConfig(ideal=True))
    np.testing.assert_allclose(track.estimates, track.poses, atol=1e-12)
