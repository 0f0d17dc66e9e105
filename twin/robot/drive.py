"""The base controller: ROS's diff_drive_controller as the Jackal configures it (command -> wheel speeds).

State in, state out, once per period. The limiter follows `SpeedLimiter`: first the acceleration against the last
command sent, then the velocity; a command older than the time-out counts as zero, braked within the same limits.
Source of every number: jackal_control/config/control.yaml of github.com/jackal/jackal.
"""

from __future__ import annotations

from dataclasses import dataclass

from twin.records import STOP, Command
from twin.robot.jackal import TRACK, WHEEL_RADIUS


@dataclass(frozen=True, slots=True)
class DriveConfig:
    """Limits and geometry of the controller."""

    period: float = 0.02  # [s]; publish_rate 50
    timeout: float = 0.25  # [s]; cmd_vel_timeout
    max_v: float = 2.0  # [m/s]; linear.x.max_velocity
    max_w: float = 4.0  # [rad/s]; angular.z.max_velocity
    max_v_rate: float = 20.0  # [m/s2]; linear.x.max_acceleration
    max_w_rate: float = 25.0  # [rad/s2]; angular.z.max_acceleration
    separation: float = 1.5 * TRACK  # [m]; wheel_separation_multiplier: what a skid turn takes on top of the track
    radius: float = 1.0 * WHEEL_RADIUS  # [m]; wheel_radius_multiplier


@dataclass(frozen=True, slots=True)
class DriveState:
    """What the controller remembers between two periods."""

    v: float = 0.0  # [m/s] last speed sent to the wheels
    w: float = 0.0  # [rad/s]
    command: Command = STOP  # the last command received
    age: float = 0.0  # [s] since it was received


@dataclass(frozen=True, slots=True)
class WheelCommand:
    """Angular speeds for the two sides [rad/s], positive forward."""

    left: float
    right: float


def receive(state: DriveState, command: Command) -> DriveState:
    """A new `cmd_vel` arrives."""
    return DriveState(state.v, state.w, command, 0.0)


def advance(state: DriveState, config: DriveConfig) -> tuple[DriveState, WheelCommand]:
    """One controller period: the wheel speeds to hold until the next."""
    wanted = state.command if state.age <= config.timeout else STOP
    v = _limit(wanted.v, state.v, config.max_v_rate * config.period, config.max_v)
    w = _limit(wanted.w, state.w, config.max_w_rate * config.period, config.max_w)
    wheels = WheelCommand(
        left=(v - w * config.separation / 2) / config.radius,
        right=(v + w * config.separation / 2) / config.radius,
    )
    return DriveState(v, w, state.command, state.age + config.period), wheels


def _limit(wanted: float, last: float, step: float, most: float) -> float:
    """`wanted`, at most `step` from `last`, within +-`most`."""
    return max(-most, min(most, max(last - step, min(last + step, wanted))))
