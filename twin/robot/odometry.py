"""Odometry: what the Jackal's EKF publishes as odom -> base_link.

The robot_localization filter fuses wheel speed with the IMU; the gyro's variance (0.005 rad/s)^2 is a thousandth of
the wheels' 0.03, so the result is, to a good approximation, wheel speed along a gyro heading. That is what is computed
here, with one trapezoid per period. Sideways slip is invisible to it, as it is to the real one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.geometry import normalize_angle
from twin.records import Array, Pose2, Twist2
from twin.robot.jackal import WHEEL_RADIUS


@dataclass(frozen=True, slots=True)
class OdometryConfig:
    """Errors of the sensors; `ideal` publishes the truth instead."""

    period: float = 0.02  # [s]; robot_localization.yaml: frequency 50
    gyro_noise: float = 0.005  # [rad/s] per sample; jackal.gazebo: rateGaussianNoise
    gyro_bias: float = 0.0  # [rad/s] constant; the EKF also fuses the IMU's heading, which holds a bias down
    wheel_noise: float = 0.0  # [m/s] per sample; Gazebo reads the joints exactly
    wheel_scale: float = 1.0  # believed over true wheel radius
    ideal: bool = False  # True: the truth, without noise or slip


@dataclass(frozen=True, slots=True)
class Reading:
    """What the sensors show at the end of one period, and the truth they stand for."""

    wheel_speeds: Array  # (4,) [rad/s] fl, fr, rl, rr
    yaw_rate: float  # [rad/s] gyro z
    pose: Pose2  # world_from_base, true
    twist: Twist2  # base_link, true


@dataclass(frozen=True, slots=True)
class OdometryState:
    """The estimate; also what it takes to turn truth into odom coordinates."""

    start: tuple[float, float]  # world position of odom's origin [m]; odom's axes are parallel to world's
    pose: Pose2  # odom_from_base
    twist: Twist2  # base_link


def begin(start: Pose2) -> OdometryState:
    """At rest at `start` (world): odom's origin lies there, its axes parallel to world's."""
    return OdometryState((start.x, start.y), Pose2(0.0, 0.0, start.yaw), Twist2(0.0, 0.0))


def advance(state: OdometryState, reading: Reading, config: OdometryConfig, rng: np.random.Generator) -> OdometryState:
    """The estimate one period later."""
    if config.ideal:
        x, y = reading.pose.x - state.start[0], reading.pose.y - state.start[1]
        return OdometryState(state.start, Pose2(x, y, reading.pose.yaw), reading.twist)
    speed_error, rate_error = rng.standard_normal(2).tolist()
    v = WHEEL_RADIUS * config.wheel_scale * float(np.mean(reading.wheel_speeds)) + config.wheel_noise * speed_error
    w = reading.yaw_rate + config.gyro_bias + config.gyro_noise * rate_error
    distance = config.period * (state.twist.v + v) / 2
    turn = config.period * (state.twist.w + w) / 2
    heading = state.pose.yaw + turn / 2
    pose = Pose2(
        state.pose.x + distance * math.cos(heading),
        state.pose.y + distance * math.sin(heading),
        normalize_angle(state.pose.yaw + turn),
    )
    return OdometryState(state.start, pose, Twist2(v, w))
