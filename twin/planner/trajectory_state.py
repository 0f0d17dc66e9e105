"""What the local planner is told and what it answers (`base_local_planner::TrajectoryPlanner`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.geometry import normalize_angle
from twin.planner.params import PlannerParams
from twin.records import STOP, Array, Command


@dataclass(frozen=True, slots=True)
class ControllerSettings:
    """What `TrajectoryPlannerROS` keeps for itself from start-up; dynamic reconfigure never reaches it."""

    acc_lim_x: float = 10.0  # [m/s^2] (jackal base_local_planner_params.yaml)
    acc_lim_y: float = 2.5  # [m/s^2] code default, the yaml is silent
    acc_lim_theta: float = 20.0  # [rad/s^2] (yaml)
    sim_period: float = 0.05  # [s] 1 / controller_frequency
    min_in_place_vel_theta: float = 0.314  # [rad/s] (yaml)
    max_rotational_vel: float = 1.0  # [rad/s] code default; only when rotating to the goal
    xy_goal_tolerance: float = 0.25  # [m] (yaml)
    yaw_goal_tolerance: float = 0.157  # [rad] (yaml)
    latch_xy_goal_tolerance: bool = False  # (yaml)


@dataclass(frozen=True, slots=True)
class LocalPlannerSettings:
    """Everything of the local planner that is not theta. The defaults are the Jackal's.

    `min_vel_theta` does not follow theta's `max_vel_theta`: in ROS they are two parameters.
    """

    acc_lim_x: float = 10.0  # [m/s^2] (jackal base_local_planner_params.yaml)
    acc_lim_y: float = 2.5  # [m/s^2] code default
    acc_lim_theta: float = 20.0  # [rad/s^2] (yaml)
    min_vel_x: float = 0.1  # [m/s] (yaml)
    min_vel_theta: float = -1.57  # [rad/s] (yaml)
    min_in_place_vel_theta: float = 0.314  # [rad/s] (yaml)
    sim_time: float = 2.0  # [s] (yaml)
    sim_granularity: float = 0.02  # [m] (yaml)
    angular_sim_granularity: float = 0.02  # [rad] (yaml)
    escape_vel: float = -0.5  # [m/s] (yaml)
    heading_lookahead: float = 0.325  # [m] (yaml)
    oscillation_reset_dist: float = 0.05  # [m] (yaml)
    escape_reset_dist: float = 0.1  # [m] (yaml)
    escape_reset_theta: float = 0.1  # [rad] (yaml)
    sim_period: float = 0.05  # [s] 1 / controller_frequency (yaml: 20 Hz)
    meter_scoring_factor: float = 1.0  # times pdist_scale and gdist_scale; 0.05 is the other reading (spec 8.6)
    holonomic_robot: bool = False  # (yaml); the only value there is
    controller: ControllerSettings = field(default_factory=ControllerSettings)

    def __post_init__(self) -> None:
        if self.holonomic_robot:
            raise ValueError("holonomic_robot must be False: the Jackal cannot strafe")
        for name in ("sim_time", "sim_granularity", "angular_sim_granularity", "sim_period"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be above 0, not {getattr(self, name)!r}")


def from_ros_values(
    values: Mapping[str, float], controller: ControllerSettings | None = None
) -> tuple[PlannerParams, LocalPlannerSettings]:
    """theta and settings from values under the names of the planner's members, as a recording of ROS has them.

    `path_bias` and `goal_bias` are the effective multipliers (already times 0.05 where meter scoring was on), so the
    settings get a factor of 1. Names that are neither theta's nor the settings' raise ValueError.
    """
    renamed = {"path_bias": "pdist_scale", "goal_bias": "gdist_scale"}
    theta_names = {f.name for f in fields(PlannerParams)}
    setting_names = {f.name for f in fields(LocalPlannerSettings)} - {"controller", "meter_scoring_factor"}
    theta: dict[str, object] = {}
    settings: dict[str, float] = {}
    for name, value in values.items():
        name = renamed.get(name, name)
        if name in theta_names:
            theta[name] = float(value)
        elif name in setting_names:
            settings[name] = float(value)
        else:
            raise ValueError(f"unknown local planner value {name!r}")
    return (
        PlannerParams.from_mapping(theta),
        LocalPlannerSettings(**settings, controller=controller or ControllerSettings()),  # type: ignore[arg-type]
    )


class Limits(NamedTuple):
    """Theta and settings as the compiled loops read them: one flat tuple of f64 and counts."""

    acc_x: float
    acc_y: float
    acc_theta: float
    max_vel_x: float
    min_vel_x: float
    max_vel_theta: float
    min_vel_theta: float
    min_in_place: float
    sim_time: float
    sim_granularity: float
    angular_sim_granularity: float
    sim_period: float
    escape_vel: float
    heading_lookahead: float
    path_bias: float
    goal_bias: float
    occdist_scale: float
    vx_samples: int
    vtheta_samples: int


def limits_of(theta: PlannerParams, settings: LocalPlannerSettings) -> Limits:
    """The values that the arcs of one call depend on. Meter scoring multiplies the biases once, in f64."""
    return Limits(
        acc_x=settings.acc_lim_x,
        acc_y=settings.acc_lim_y,
        acc_theta=settings.acc_lim_theta,
        max_vel_x=theta.max_vel_x,
        min_vel_x=settings.min_vel_x,
        max_vel_theta=theta.max_vel_theta,
        min_vel_theta=settings.min_vel_theta,
        min_in_place=settings.min_in_place_vel_theta,
        sim_time=settings.sim_time,
        sim_granularity=settings.sim_granularity,
        angular_sim_granularity=settings.angular_sim_granularity,
        sim_period=settings.sim_period,
        escape_vel=settings.escape_vel,
        heading_lookahead=settings.heading_lookahead,
        path_bias=theta.pdist_scale * settings.meter_scoring_factor,
        goal_bias=theta.gdist_scale * settings.meter_scoring_factor,
        occdist_scale=theta.occdist_scale,
        vx_samples=int(theta.vx_samples),
        vtheta_samples=int(theta.vtheta_samples),
    )


LEGAL, COLLISION, OFF_MAP, NO_PATH = 0, 1, 2, 3
"""How a candidate ended: legal, outline on an obstacle or unknown cell, off the map, or no way to path or goal."""

REASONS = ("legal", "collision", "off_map", "no_path")


@dataclass(frozen=True, slots=True)
class Candidates:
    """Every candidate of one call in the order tried: forward arcs, turns in place, the backup if it was needed."""

    table: Array  # (n, 8) one row each; the columns are the properties below

    @property
    def v(self) -> Array:
        """(n,) [m/s] forward."""
        return self.table[:, 0]

    @property
    def w(self) -> Array:
        """(n,) [rad/s]."""
        return self.table[:, 1]

    @property
    def cost(self) -> Array:
        """(n,) total; -1 in collision or off the map, -2 without a way to path or goal."""
        return self.table[:, 2]

    @property
    def points(self) -> NDArray[np.int64]:
        """(n,) points scored before it ended."""
        return self.table[:, 3].astype(np.int64)

    @property
    def path_cells(self) -> Array:
        """(n,) path grid at the last point looked at."""
        return self.table[:, 4]

    @property
    def goal_cells(self) -> Array:
        """(n,) goal grid at the last point looked at."""
        return self.table[:, 5]

    @property
    def obstacle(self) -> Array:
        """(n,) highest cost byte met, 0..253."""
        return self.table[:, 6]

    @property
    def reason(self) -> NDArray[np.int64]:
        """(n,) index into REASONS."""
        return self.table[:, 7].astype(np.int64)

    @property
    def rejected(self) -> dict[str, int]:
        """How many candidates ended for each reason other than being legal."""
        return {name: int(np.count_nonzero(self.reason == k)) for k, name in enumerate(REASONS) if k != LEGAL}


@dataclass(frozen=True, slots=True)
class BestPath:
    """The answer of `find_best_path`, with the raw parts of its cost."""

    v: float  # [m/s]
    vy: float  # [m/s] 0 on the Jackal
    w: float  # [rad/s]
    cost: float  # >= 0: drive it (the backup in collision has 1); < 0: no command is possible
    points: Array  # (n, 3) x, y, yaw of the scored points, map frame [m, rad]; empty when the first was illegal
    path_cells: float  # path grid at the last scored point
    goal_cells: float  # goal grid at the last scored point
    obstacle: float  # highest cost byte over the arc, 0..253
    local_goal: tuple[float, float] | None  # centre of its cell [m]; None: no plan point is on the map
    candidates: Candidates | None = None  # with explain=True

    @property
    def legal(self) -> bool:
        """Whether there is a command."""
        return self.cost >= 0.0

    @property
    def command(self) -> Command:
        """The command: zero unless legal. The rate passes through a quaternion in ROS, which wraps it to +-pi."""
        if not self.legal:
            return STOP
        return Command(self.v, self.w if abs(self.w) <= math.pi else normalize_angle(self.w))
