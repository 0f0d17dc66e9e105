"""Laws of odometry, without physics."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twin.records import Pose2, Twist2
from twin.robot import odometry
from twin.robot.odometry import OdometryConfig, OdometryState, Reading

EXACT = OdometryConfig(gyro_noise=0.0)


def drive(config: OdometryConfig, v: float, w: float, seconds: float, start: Pose2, seed: int = 0) -> OdometryState:
    """Odometry of a robot that does exactly (v, w) without slip."""
    state, rng = odometry.begin(start), np.random.default_rng(seed)
    state = OdometryState(state.start, state.pose, Twist2(v, w))  # already moving
    for k in range(round(seconds / config.period)):
        yaw = start.yaw + w * config.period * (k + 1)
        truth = Pose2(
            start.x + v / w * (math.sin(yaw) - math.sin(start.yaw)),
            start.y - v / w * (math.cos(yaw) - math.cos(start.yaw)),
            math.remainder(yaw, math.tau),
        )
        state = odometry.advance(state, Reading(np.full(4, v / 0.098), w, truth, Twist2(v, w)), config, rng)
    return state


def test_odom_begins_at_the_start_with_axes_parallel_to_the_world() -> None:
    state = odometry.begin(Pose2(3.0, -2.0, 0.9))
    assert state.pose == Pose2(0.0, 0.0, 0.9)
    assert state.start == (3.0, -2.0)


@pytest.mark.parametrize("config", [EXACT, OdometryConfig(ideal=True)])
def test_exact_sensors_without_slip_give_the_true_circle(config: OdometryConfig) -> None:
    state = drive(config, 0.5, 0.7, 6.0, Pose2(3.0, -2.0, 0.9))
    yaw = 0.9 + 0.7 * 6.0
    assert state.pose.x == pytest.approx(0.5 / 0.7 * (math.sin(yaw) - math.sin(0.9)), abs=1e-4)
    assert state.pose.y == pytest.approx(-0.5 / 0.7 * (math.cos(yaw) - math.cos(0.9)), abs=1e-4)
    assert state.pose.yaw == pytest.approx(math.remainder(yaw, math.tau))
    assert state.twist == Twist2(pytest.approx(0.5), pytest.approx(0.7))


def test_errors_do_what_they_say() -> None:
    start = Pose2(0.0, 0.0, 0.0)
    straight = drive(OdometryConfig(gyro_noise=0.0, wheel_scale=1.1), 1.0, 1e-9, 10.0, start)
    assert straight.pose.x == pytest.approx(11.0, abs=0.01)
    biased = drive(OdometryConfig(gyro_noise=0.0, gyro_bias=0.01), 1.0, 1e-9, 10.0, start)
    assert biased.pose.yaw == pytest.approx(0.1, abs=1e-3)
    spread = np.std([drive(OdometryConfig(), 0.5, 1e-9, 10.0, start, seed).pose.yaw for seed in range(200)])
    assert spread == pytest.approx(0.005 * math.sqrt(0.02 * 10.0), rel=0.2)  # white rate noise integrated


def test_equal_seeds_give_equal_estimates() -> None:
    start = Pose2(0.0, 0.0, 0.0)
    assert drive(OdometryConfig(), 0.5, 0.3, 2.0, start, 4) == drive(OdometryConfig(), 0.5, 0.3, 2.0, start, 4)
    assert drive(OdometryConfig(), 0.5, 0.3, 2.0, start, 4) != drive(OdometryConfig(), 0.5, 0.3, 2.0, start, 5)
