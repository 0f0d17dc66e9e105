"""How a recording opens: top view, 3-D view, lanes, plots and text, placed so that nothing needs to be touched."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from twin.recording import palette
from twin.recording.palette import RGB
from twin.recording.scenery import bounds
from twin.world import World

TIMELINE = "sim_time"
FIELD_OF_VIEW = math.radians(55.0)  # vertical, of Rerun's 3-D camera
TOP_ASPECT = 1.7  # width over height of the top view in a 16:9 window

PLOTS: dict[str, dict[str, tuple[str, RGB, float]]] = {  # plot: entity: (name, colour, line width)
    "speed [m/s]": {
        "command/planner/v": ("command v", palette.COMMANDED, 1.0),
        "odometry/v": ("measured v", palette.MEASURED, 1.5),
    },
    "turn rate [rad/s]": {
        "command/planner/w": ("command w", palette.COMMANDED, 1.0),
        "odometry/w": ("measured w", palette.MEASURED, 1.5),
    },
    "clearance [m]": {"clearance": ("clearance", palette.CLEARANCE, 1.5)},
    "speed limits": {
        "params/max_vel_x": ("max_vel_x", palette.PARAMETERS[0], 1.5),
        "params/max_vel_theta": ("max_vel_theta", palette.PARAMETERS[1], 1.5),
    },
    "samples": {
        "params/vx_samples": ("vx_samples", palette.PARAMETERS[2], 1.5),
        "params/vtheta_samples": ("vtheta_samples", palette.PARAMETERS[3], 1.5),
    },
    "scales, inflation [m]": {
        "params/occdist_scale": ("occdist_scale", palette.PARAMETERS[4], 1.5),
        "params/pdist_scale": ("pdist_scale", palette.PARAMETERS[5], 1.5),
        "params/gdist_scale": ("gdist_scale", palette.PARAMETERS[6], 1.5),
        "params/inflation_radius": ("inflation_radius", palette.PARAMETERS[7], 1.5),
    },
    "confidence": {"appli/confidence": ("confidence", palette.CONFIDENCE, 1.5)},
    "costs of the chosen arc": {
        "arc/path_cells": ("path [cells]", palette.GLOBAL_PATH, 1.0),
        "arc/goal_cells": ("goal [cells]", palette.GOAL, 1.0),
        "arc/obstacle": ("obstacle [0..253]", palette.CONTACT, 1.0),
    },
}


def layout(world: World) -> rrb.Blueprint:
    """The blueprint of a recording in `world`."""
    left = rrb.Vertical(_top_view(world), _lanes(), row_shares=[5.2, 1.0])
    parameters = rrb.Tabs(_plot("scales, inflation [m]"), _plot("speed limits"), _plot("samples"), name="parameters")
    middle = rrb.Tabs(_plot("clearance [m]"), _plot("costs of the chosen arc"), _plot("confidence"))
    text = rrb.Horizontal(
        rrb.TextDocumentView(origin="run", name="run"),
        rrb.TextLogView(
            origin="events",
            name="events",
            columns=rrb.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["body"]),
        ),
    )
    right = rrb.Vertical(
        _robot_view(world),
        _plot("speed [m/s]"),
        _plot("turn rate [rad/s]"),
        middle,
        parameters,
        text,
        row_shares=[3.0, 1.0, 1.0, 1.0, 1.0, 1.6],
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[1.7, 1.0]),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed", play_state="following"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_layout=False,
        auto_views=False,
    )


def style_plots(stream: Any) -> None:
    """Names, colours and widths of the plotted lines, and the colours of the lanes."""
    for lines in PLOTS.values():
        for entity, (name, colour, width) in lines.items():
            style = rr.SeriesLines.columns(names=[name], colors=np.array([colour], np.uint8), widths=[width])
            stream.send_columns(entity, [], style)
    _style_lane(stream, "planner/state", palette.STATES)
    _style_lane(stream, "appli/context", palette.CONTEXTS)


def _style_lane(stream: Any, entity: str, colours: dict[str, RGB]) -> None:
    style = rr.StateConfiguration.columns(
        values=list(colours), colors=np.array(list(colours.values()), np.uint8)
    ).partition([len(colours)])
    stream.send_columns(entity, [], style)


def _top_view(world: World) -> rrb.Spatial3DView:
    """Straight down on the whole world, its long side across the screen."""
    x0, y0, x1, y1 = bounds(world)
    width, height = x1 - x0, y1 - y0
    upright = width >= height
    across, along = (width, height) if upright else (height, width)
    distance = max(along, across / TOP_ASPECT) / 2.0 / math.tan(FIELD_OF_VIEW / 2.0)
    centre = ((x0 + x1) / 2.0, (y0 + y1) / 2.0)
    return rrb.Spatial3DView(
        origin="world",
        contents=["+ $origin/**", "- $origin/obstacles/**"],
        name="top view",
        background=palette.BACKGROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=(*centre, distance),
            look_target=(*centre, 0.0),
            eye_up=(0.0, 1.0, 0.0) if upright else (-1.0, 0.0, 0.0),
        ),
        overrides={"world/trail": _whole_past()},
    )


def _robot_view(world: World) -> rrb.Spatial3DView:
    """Behind and above the robot, following it."""
    start = world.start
    back = np.array([math.cos(start.yaw), math.sin(start.yaw)]) * 2.2
    return rrb.Spatial3DView(
        origin="world",
        contents=["+ $origin/**", "- $origin/plan/**", "- $origin/local_costmap", "- $origin/segments/**"],
        name="robot",
        background=palette.BACKGROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=(start.x - back[0], start.y - back[1], 1.6),
            look_target=(start.x, start.y, 0.1),
            tracking_entity="world/robot",
        ),
        overrides={"world/trail": _whole_past()},
    )


def _whole_past() -> rrb.VisibleTimeRanges:
    """Everything up to the time cursor, for an entity that logs one piece per tick."""
    return rrb.VisibleTimeRanges(
        timeline=TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )


def _lanes() -> rrb.StateTimelineView:
    return rrb.StateTimelineView(origin="/", contents=["planner/state", "appli/context"], name="states")


def _plot(name: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin="/", contents=list(PLOTS[name]), name=name)
