"""A policy as parameters of ROS 1's `move_base` (names of melodic and noetic): start-up files, and two per context."""

from __future__ import annotations

from typing import Any

from learning.policy import Policy
from scenarios.export_files import Export, NamedContext, YamlFile, named_contexts
from twin.planner.footprint import FOOTPRINT_PADDING, JACKAL_FOOTPRINT
from twin.planner.inflation import COST_SCALING_FACTOR, InflationParams
from twin.planner.map_frame import MapSpec
from twin.planner.move_base import CONTROLLER_PATIENCE, PLANNER_PATIENCE, RECOVERIES, MoveBaseSettings
from twin.planner.obstacle_layer import GLOBAL_MAP, JACKAL_SCAN, LOCAL_MAP
from twin.planner.plan import DEFAULT_THETA, PlannerSettings

# theta's names in the twin -> the planner's parameter and dynamic_reconfigure names (BaseLocalPlanner.cfg, melodic and
# noetic). kinetic's reconfigure still says pdist_scale and gdist_scale.
RECONFIGURE_NAMES: dict[str, str] = {
    "max_vel_x": "max_vel_x",
    "max_vel_theta": "max_vel_theta",
    "vx_samples": "vx_samples",
    "vtheta_samples": "vtheta_samples",
    "occdist_scale": "occdist_scale",
    "pdist_scale": "path_distance_bias",
    "gdist_scale": "goal_distance_bias",
}
PLANNER = "TrajectoryPlannerROS"
LAYER = "inflater_layer"  # the Jackal's name of the inflation layer (costmap_common_params.yaml)

PUBLISH_FREQUENCY = 5.0  # [Hz] (jackal costmap yaml); without effect on driving
TRANSFORM_TOLERANCE = 0.5  # [s] (jackal costmap_common_params.yaml)
OSCILLATION_TIMEOUT, OSCILLATION_DISTANCE = 0.0, 0.5  # [s] 0 = off, [m] (jackal move_base_params.yaml)
HEADING_SCORING_TIMESTEP = 0.8  # [s] (jackal base_local_planner_params.yaml); unused while heading_scoring is off

PLANNER_COMMENT = """\
Local planner of the Jackal, everything but theta: what the twin drove with while theta was learned.
Load at start-up into move_base's namespace:  rosparam load base_local_planner.yaml /move_base
Then load the files of the default context (contexts.yaml names them): theta is set there.
Names are those of melodic and noetic. acc_lim_*, min_in_place_vel_theta, max_rotational_vel, the goal tolerances and
controller_frequency are (also) read once, at start-up.
meter_scoring: the twin weighs path and goal distance per cell (factor 1). On the robot the parameter does not
decide that alone: TrajectoryPlanner reads a member that is never initialised. See docs/real_robot.md."""

COSTMAP_COMMENT = """\
Both costmaps of the Jackal (odometry variant, without a static map), everything but theta's inflation_radius.
Load at start-up into move_base's namespace:  rosparam load costmaps.yaml /move_base
Adapt the scan's topic and frame to your robot.
The obstacle layer keeps the Jackal's name obstacles_layer, so the clearing recoveries, which look for "obstacles",
clear nothing: as in the twin."""

MOVE_BASE_COMMENT = """\
move_base itself. Load at start-up:  rosparam load move_base.yaml /move_base
In the twin planner, controller and both costmaps run once per tick."""

THETA_COMMENT = """\
Context {label}: the local planner's part of theta.
At start-up:  rosparam load {path} /move_base
While driving: dynamic_reconfigure, server /move_base/TrajectoryPlannerROS (docs/real_robot.md, "Export").
path_distance_bias is theta's pdist_scale, goal_distance_bias its gdist_scale."""

INFLATION_COMMENT = """\
Context {label}: the costmaps' part of theta ({which}).
At start-up:  rosparam load {path} /move_base
While driving: dynamic_reconfigure, server(s) {servers}.
Only whole cells count: the radius is rounded up to multiples of {resolution} m."""


def move_base_export(policy: Policy) -> Export:
    """Start-up files, and per context one for the planner and one for the costmaps."""
    settings = policy.settings(MoveBaseSettings())
    return Export(
        shared={
            "base_local_planner": YamlFile("base_local_planner.yaml", PLANNER_COMMENT, _planner(settings.planner)),
            "costmaps": YamlFile("costmaps.yaml", COSTMAP_COMMENT, _costmaps(settings.planner)),
            "move_base": YamlFile("move_base.yaml", MOVE_BASE_COMMENT, _move_base(settings)),
        },
        contexts={context.label: _context(context, settings.planner) for context in named_contexts(policy)},
    )


def _context(context: NamedContext, settings: PlannerSettings) -> dict[str, YamlFile]:
    values = context.values
    planner = {ros: values[ours] for ours, ros in RECONFIGURE_NAMES.items()}
    if settings.couple_min_vel_theta:
        planner["min_vel_theta"] = settings.local_for(context.theta).min_vel_theta
    obeying = ("local_costmap", "global_costmap") if settings.inflation == "both" else ("local_costmap",)
    inflation = {costmap: {LAYER: {"inflation_radius": values["inflation_radius"]}} for costmap in obeying}
    planner_path, inflation_path = f"{context.name}/base_local_planner.yaml", f"{context.name}/inflation.yaml"
    comment = INFLATION_COMMENT.format(
        label=context.label,
        which="both of them" if settings.inflation == "both" else "the local one; the global one keeps its radius",
        path=inflation_path,
        servers=", ".join(f"/move_base/{costmap}/{LAYER}" for costmap in obeying),
        resolution=LOCAL_MAP.resolution,
    )
    return {
        "base_local_planner": YamlFile(
            planner_path, THETA_COMMENT.format(label=context.label, path=planner_path), {PLANNER: planner}
        ),
        "inflation": YamlFile(inflation_path, comment, inflation),
    }


def _planner(settings: PlannerSettings) -> dict[str, Any]:
    """TrajectoryPlannerROS without theta. The wrapper's values (ControllerSettings) and the planner's share names."""
    s, wrapper = settings.local, settings.local.controller
    return {
        PLANNER: {
            "acc_lim_x": s.acc_lim_x,
            "acc_lim_y": s.acc_lim_y,
            "acc_lim_theta": s.acc_lim_theta,
            "min_vel_x": s.min_vel_x,
            "min_vel_theta": s.min_vel_theta,
            "min_in_place_vel_theta": s.min_in_place_vel_theta,
            "max_rotational_vel": wrapper.max_rotational_vel,
            "holonomic_robot": s.holonomic_robot,
            "escape_vel": s.escape_vel,
            "yaw_goal_tolerance": wrapper.yaw_goal_tolerance,
            "xy_goal_tolerance": wrapper.xy_goal_tolerance,
            "latch_xy_goal_tolerance": wrapper.latch_xy_goal_tolerance,
            "sim_time": s.sim_time,
            "sim_granularity": s.sim_granularity,
            "angular_sim_granularity": s.angular_sim_granularity,
            "controller_frequency": 1.0 / s.sim_period,
            "meter_scoring": s.meter_scoring_factor != 1.0,
            "heading_lookahead": s.heading_lookahead,
            "heading_scoring": False,
            "heading_scoring_timestep": HEADING_SCORING_TIMESTEP,
            "dwa": True,
            "simple_attractor": False,
            "prune_plan": True,
            "oscillation_reset_dist": s.oscillation_reset_dist,
            "escape_reset_dist": s.escape_reset_dist,
            "escape_reset_theta": s.escape_reset_theta,
        }
    }


def _costmaps(settings: PlannerSettings) -> dict[str, Any]:
    local, global_ = _costmap(LOCAL_MAP, settings), _costmap(GLOBAL_MAP, settings)
    if settings.inflation == "local":  # theta does not reach the global costmap
        global_[LAYER]["inflation_radius"] = DEFAULT_THETA.inflation_radius
    return {"local_costmap": local, "global_costmap": global_}


def _costmap(spec: MapSpec, settings: PlannerSettings) -> dict[str, Any]:
    return {
        "global_frame": "odom",
        "robot_base_frame": "base_link",
        "update_frequency": 1.0 / settings.local.sim_period,
        "publish_frequency": PUBLISH_FREQUENCY,
        "transform_tolerance": TRANSFORM_TOLERANCE,
        "rolling_window": spec.rolling,
        "width": spec.size_x * spec.resolution,
        "height": spec.size_y * spec.resolution,
        "resolution": spec.resolution,
        "origin_x": spec.origin[0],
        "origin_y": spec.origin[1],
        "track_unknown_space": False,
        "footprint": [list(corner) for corner in JACKAL_FOOTPRINT],
        "footprint_padding": FOOTPRINT_PADDING,
        "plugins": [
            {"name": "obstacles_layer", "type": "costmap_2d::ObstacleLayer"},
            {"name": LAYER, "type": "costmap_2d::InflationLayer"},
        ],
        "obstacles_layer": {
            "footprint_clearing_enabled": JACKAL_SCAN.footprint_clearing_enabled,
            "max_obstacle_height": JACKAL_SCAN.max_obstacle_height,
            "combination_method": 1,
            "observation_sources": "scan",
            "scan": {
                "topic": "front/scan",
                "sensor_frame": "front_laser",
                "data_type": "LaserScan",
                "marking": True,
                "clearing": True,
                "inf_is_valid": False,
                "min_obstacle_height": JACKAL_SCAN.min_obstacle_height,
                "max_obstacle_height": JACKAL_SCAN.max_obstacle_height,
                "obstacle_range": JACKAL_SCAN.obstacle_range,
                "raytrace_range": JACKAL_SCAN.raytrace_range,
            },
        },
        LAYER: {
            "cost_scaling_factor": COST_SCALING_FACTOR,
            "inflate_unknown": InflationParams(DEFAULT_THETA.inflation_radius).inflate_unknown,
        },
    }


def _move_base(settings: MoveBaseSettings) -> dict[str, Any]:
    frequency = 1.0 / settings.planner.local.sim_period
    return {
        "base_global_planner": "navfn/NavfnROS",
        "base_local_planner": "base_local_planner/TrajectoryPlannerROS",
        "controller_frequency": frequency,
        "controller_patience": CONTROLLER_PATIENCE,
        "planner_frequency": frequency,
        "planner_patience": PLANNER_PATIENCE,
        "oscillation_timeout": OSCILLATION_TIMEOUT,
        "oscillation_distance": OSCILLATION_DISTANCE,
        "recovery_behavior_enabled": True,
        "clearing_rotation_allowed": True,
        "conservative_reset_dist": RECOVERIES[0].clear_beyond,
        "shutdown_costmaps": False,
    }
