"""A policy as parameters of ROS 2's Nav2: DWB, the nearest relative of the planner that theta was learned for.

Not the same planner: the comment of the files says what does not carry over. Names and scaling are from
nav2_dwb_controller and nav2_costmap_2d (github.com/ros-navigation/navigation2) and docs.nav2.org.
"""

from __future__ import annotations

from typing import Any

from learning.policy import Policy
from scenarios.export_files import Export, NamedContext, YamlFile, named_contexts
from twin.planner.controller import PRUNE_DISTANCE, STOPPED_V
from twin.planner.footprint import FOOTPRINT_PADDING, JACKAL_FOOTPRINT
from twin.planner.inflation import COST_SCALING_FACTOR, InflationParams
from twin.planner.map_frame import MapSpec
from twin.planner.move_base import CONTROLLER_PATIENCE, MoveBaseSettings
from twin.planner.obstacle_layer import GLOBAL_MAP, JACKAL_SCAN, LOCAL_MAP
from twin.planner.plan import DEFAULT_THETA, PlannerSettings

CONTROLLER = "FollowPath"  # nav2's usual name of the controller plugin
# What DWB multiplies its critics' scales by; divided out, so that a cell or a cost byte weighs as much as in the twin.
MAP_GRID_FACTOR = 0.5 * LOCAL_MAP.resolution  # PathDist, GoalDist (dwb_critics/map_grid.hpp: getScale)
FOOTPRINT_FACTOR = LOCAL_MAP.resolution  # ObstacleFootprint (dwb_critics/obstacle_footprint.hpp: getScale)

PUBLISH_FREQUENCY = 5.0  # [Hz] (jackal costmap yaml); without effect on driving
ROTATE_TO_GOAL_SCALE = 32.0  # (nav2_bringup/params/nav2_params.yaml); nothing in theta corresponds to it
OSCILLATION_RESET_ANGLE = -1.0  # [rad] below 0 = never by turning: TrajectoryPlanner clears its flags by distance only

LOSSES = """\
NOT THE PLANNER THAT THETA WAS LEARNED FOR. DWB is a descendant of TrajectoryPlanner; take these values as a start,
and drive slowly first. Nothing here was tried on a robot. What does not carry over:
* Path and goal distance: the scales are converted so that one cell weighs what it weighs in the twin (DWB multiplies
  by resolution / 2). But TrajectoryPlanner measures the way round obstacles, DWB the Manhattan distance through them.
* Obstacles: converted likewise (DWB multiplies by the resolution), for ObstacleFootprint: the highest cost byte on the
  padded outline. DWB takes it at the last pose of an arc, TrajectoryPlanner the highest along the whole arc, centre
  included. (BaseObstacle would look at the centre alone, and is not multiplied by anything.)
* min_vel_theta: DWB always turns between -max_vel_theta and max_vel_theta; {coupling}
* Samples: vx_samples spread over 0 .. max_vel_x instead of min_vel_x .. max_vel_x (DWB cannot turn in place unless
  min_vel_x is 0); min_speed_xy and min_speed_theta stand in for min_vel_x and min_in_place_vel_theta. DWB tries the
  highest rate too, drives an arc at its final speed from the start, and counts points along turns by sim_time.
* No separate turns in place with a look-ahead (heading_lookahead), no escape backwards (escape_vel): Nav2's behavior
  server backs up and spins instead. No lower speed near the goal. Oscillation is judged by another rule.
* Turning to the goal's yaw is limited by max_vel_theta, not by max_rotational_vel ({rotational} rad/s).
* Inflation: the same slope and the same rounding up to whole cells (inflation_layer.cpp), so theta's radius means the
  same; newer versions warn when it is below the inscribed radius, which learned radii often are.
* Nav2 replans about once a second (behavior tree), the twin in every tick. Its progress checker gives up on a robot
  that hardly moves, the twin has none."""

BASE_COMMENT = """\
Nav2 parameters of the Jackal that hold in every context: controller_server without a controller, both costmaps without
inflation_radius. Give it to the nodes first and a context's file second (later files win). Adapt the scan's topic.

"""

CONTEXT_COMMENT = """\
Context {label}: DWB as {controller}, and the inflation radius ({which}).

"""

ALL_COMMENT = """\
All contexts at once, one DWB controller each, to switch while driving. DWB reads samples and critics' scales only when
it is configured, so setting parameters is not enough: send the controller's name as controller_id of FollowPath, or
through the ControllerSelector node of the behavior tree. The costmaps have one radius each; set it with the context:
  ros2 param set /local_costmap/local_costmap inflation_layer.inflation_radius 0.23
Here it is the default context's.

"""


def nav2_export(policy: Policy) -> Export:
    """Parameters for all contexts, and per context a file that stands on its own after them."""
    settings = policy.settings(MoveBaseSettings()).planner
    contexts = named_contexts(policy)
    losses = LOSSES.format(
        coupling="as under this policy (couple_min_vel_theta)."
        if settings.couple_min_vel_theta
        else f"theta was learned with the lower end at {settings.local.min_vel_theta} rad/s.",
        rotational=settings.local.controller.max_rotational_vel,
    )
    return Export(
        shared={
            "base": YamlFile("base.yaml", BASE_COMMENT + losses, _base(settings)),
            "all_contexts": YamlFile("all_contexts.yaml", ALL_COMMENT + losses, _all_contexts(contexts, settings)),
        },
        contexts={context.label: {"nav2": _context(context, settings, losses)} for context in contexts},
    )


def _context(context: NamedContext, settings: PlannerSettings, losses: str) -> YamlFile:
    comment = CONTEXT_COMMENT.format(
        label=context.label,
        controller=CONTROLLER,
        which="both costmaps" if settings.inflation == "both" else "the local costmap; the global one keeps its own",
    )
    server = {"controller_plugins": [CONTROLLER], CONTROLLER: _dwb(context, settings)}
    values = {"controller_server": {"ros__parameters": server}, **_inflation(context, settings)}
    return YamlFile(f"{context.name}.yaml", comment + losses, values)


def _all_contexts(contexts: tuple[NamedContext, ...], settings: PlannerSettings) -> dict[str, Any]:
    server: dict[str, Any] = {"controller_plugins": [context.name for context in contexts]}
    server.update({context.name: _dwb(context, settings) for context in contexts})
    return {"controller_server": {"ros__parameters": server}, **_inflation(contexts[0], settings)}


def _inflation(context: NamedContext, settings: PlannerSettings) -> dict[str, Any]:
    obeying = ("local_costmap", "global_costmap") if settings.inflation == "both" else ("local_costmap",)
    radius = {"inflation_radius": context.values["inflation_radius"]}
    return {name: {name: {"ros__parameters": {"inflation_layer": dict(radius)}}} for name in obeying}


def _dwb(context: NamedContext, settings: PlannerSettings) -> dict[str, Any]:
    """One DWB controller. Floats stay floats: Nav2 refuses a whole number where it declares a double."""
    theta, s, wrapper = context.values, settings.local, settings.local.controller
    return {
        "plugin": "dwb_core::DWBLocalPlanner",
        "trajectory_generator_name": "dwb_plugins::LimitedAccelGenerator",  # dwa: true
        "sim_period": s.sim_period,
        "sim_time": s.sim_time,
        "linear_granularity": s.sim_granularity,
        "angular_granularity": s.angular_sim_granularity,
        "min_vel_x": 0.0,  # or DWB could not turn in place
        "max_vel_x": theta["max_vel_x"],
        "min_vel_y": 0.0,
        "max_vel_y": 0.0,
        "max_vel_theta": theta["max_vel_theta"],
        "min_speed_xy": s.min_vel_x,
        "max_speed_xy": theta["max_vel_x"],
        "min_speed_theta": s.min_in_place_vel_theta,
        "acc_lim_x": s.acc_lim_x,
        "acc_lim_y": 0.0,
        "acc_lim_theta": s.acc_lim_theta,
        "decel_lim_x": -s.acc_lim_x,
        "decel_lim_y": 0.0,
        "decel_lim_theta": -s.acc_lim_theta,
        "vx_samples": theta["vx_samples"],
        "vy_samples": 1,
        "vtheta_samples": theta["vtheta_samples"],
        "xy_goal_tolerance": wrapper.xy_goal_tolerance,
        "trans_stopped_velocity": STOPPED_V,
        "prune_plan": True,
        "prune_distance": PRUNE_DISTANCE,
        "forward_prune_distance": max(LOCAL_MAP.size_x, LOCAL_MAP.size_y) * LOCAL_MAP.resolution / 2,  # crop_plan's
        "critics": ["RotateToGoal", "Oscillation", "ObstacleFootprint", "PathDist", "GoalDist"],
        "RotateToGoal": {"scale": ROTATE_TO_GOAL_SCALE},
        "Oscillation": {
            "oscillation_reset_dist": s.oscillation_reset_dist,
            "oscillation_reset_angle": OSCILLATION_RESET_ANGLE,
        },
        "ObstacleFootprint": {"scale": theta["occdist_scale"] / FOOTPRINT_FACTOR, "sum_scores": False},
        "PathDist": {"scale": theta["pdist_scale"] * s.meter_scoring_factor / MAP_GRID_FACTOR},
        "GoalDist": {"scale": theta["gdist_scale"] * s.meter_scoring_factor / MAP_GRID_FACTOR},
    }


def _base(settings: PlannerSettings) -> dict[str, Any]:
    wrapper = settings.local.controller
    local, global_ = _costmap(LOCAL_MAP, settings), _costmap(GLOBAL_MAP, settings)
    if settings.inflation == "local":  # theta does not reach the global costmap
        global_["inflation_layer"]["inflation_radius"] = DEFAULT_THETA.inflation_radius
    server = {
        "controller_frequency": 1.0 / settings.local.sim_period,
        "failure_tolerance": CONTROLLER_PATIENCE,
        "goal_checker_plugins": ["goal_checker"],
        "goal_checker": {
            "plugin": "nav2_controller::SimpleGoalChecker",
            "xy_goal_tolerance": wrapper.xy_goal_tolerance,
            "yaw_goal_tolerance": wrapper.yaw_goal_tolerance,
            "stateful": wrapper.latch_xy_goal_tolerance,
        },
    }
    return {
        "controller_server": {"ros__parameters": server},
        "local_costmap": {"local_costmap": {"ros__parameters": local}},
        "global_costmap": {"global_costmap": {"ros__parameters": global_}},
    }


def _costmap(spec: MapSpec, settings: PlannerSettings) -> dict[str, Any]:
    return {
        "global_frame": "odom",
        "robot_base_frame": "base_link",
        "update_frequency": 1.0 / settings.local.sim_period,
        "publish_frequency": PUBLISH_FREQUENCY,
        "rolling_window": spec.rolling,
        "width": round(spec.size_x * spec.resolution),  # [m] whole, says nav2_costmap_2d
        "height": round(spec.size_y * spec.resolution),
        "resolution": spec.resolution,
        "origin_x": spec.origin[0],
        "origin_y": spec.origin[1],
        "track_unknown_space": False,
        "footprint": str([list(corner) for corner in JACKAL_FOOTPRINT]),  # a string, says nav2_costmap_2d
        "footprint_padding": FOOTPRINT_PADDING,
        "plugins": ["obstacle_layer", "inflation_layer"],
        "obstacle_layer": {
            "plugin": "nav2_costmap_2d::ObstacleLayer",
            "enabled": True,
            "footprint_clearing_enabled": JACKAL_SCAN.footprint_clearing_enabled,
            "max_obstacle_height": JACKAL_SCAN.max_obstacle_height,
            "combination_method": 1,
            "observation_sources": "scan",
            "scan": {
                "topic": "/front/scan",
                "data_type": "LaserScan",
                "marking": True,
                "clearing": True,
                "inf_is_valid": False,
                "min_obstacle_height": JACKAL_SCAN.min_obstacle_height,
                "max_obstacle_height": JACKAL_SCAN.max_obstacle_height,
                "obstacle_max_range": JACKAL_SCAN.obstacle_range,
                "raytrace_max_range": JACKAL_SCAN.raytrace_range,
            },
        },
        "inflation_layer": {
            "plugin": "nav2_costmap_2d::InflationLayer",
            "enabled": True,
            "cost_scaling_factor": COST_SCALING_FACTOR,
            "inflate_unknown": InflationParams(DEFAULT_THETA.inflation_radius).inflate_unknown,
        },
    }
