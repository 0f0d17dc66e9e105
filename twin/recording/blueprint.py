"""How a recording opens: everything in sight at once, and the names and colours of what is plotted."""

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
TOP_ASPECT = 2.0  # width over height of the top view in a 16:9 window, a little less to be safe
CAMERA = (-1.15, 0.45, 0.95)  # [m] of the robot view, in base_link

PLOTS: dict[str, dict[str, tuple[str, RGB, float]]] = {  # plot: entity: (name, colour, line width)
    "speed [m/s]": {
        "odometry/v": ("measured", palette.MEASURED, 1.6),
        "command/planner/v": ("planner", palette.COMMANDED, 1.0),
        "command/human/v": ("human", palette.HUMAN, 1.4),
    },
    "turn rate [rad/s]": {
        "odometry/w": ("measured", palette.MEASURED, 1.6),
        "command/planner/w": ("planner", palette.COMMANDED, 1.0),
        "command/human/w": ("human", palette.HUMAN, 1.4),
    },
    "clearance [m]": {"clearance": ("to obstacles", palette.CLEARANCE, 1.6)},
    "confidence": {"appli/confidence": ("confidence", palette.CONFIDENCE, 1.6)},
    "chosen arc": {
        "arc/path_cells": ("path [cells]", palette.GLOBAL_PATH, 1.0),
        "arc/goal_cells": ("goal [cells]", palette.GOAL, 1.0),
        "arc/obstacle": ("obstacle [0..253]", palette.CONTACT, 1.0),
    },
    "parameters": {
        "params/max_vel_x": ("max_vel_x", palette.PARAMETERS[0], 1.6),
        "params/max_vel_theta": ("max_vel_theta", palette.PARAMETERS[1], 1.6),
        "params/occdist_scale": ("occdist_scale", palette.PARAMETERS[4], 1.6),
        "params/pdist_scale": ("pdist_scale", palette.PARAMETERS[5], 1.6),
        "params/gdist_scale": ("gdist_scale", palette.PARAMETERS[6], 1.6),
        "params/inflation_radius": ("inflation_radius", palette.PARAMETERS[7], 1.6),
    },
    "samples": {
        "params/vx_samples": ("vx_samples", palette.PARAMETERS[2], 1.6),
        "params/vtheta_samples": ("vtheta_samples", palette.PARAMETERS[3], 1.6),
    },
}


def layout(world: World, learned: bool) -> rrb.Blueprint:
    """The blueprint of a recording in `world`; `learned`: a context classifier drives, so there is a confidence."""
    scenes = rrb.Horizontal(
        _top_view(world),
        rrb.Vertical(_robot_view(), rrb.TextDocumentView(origin="run", name="run"), row_shares=[1.6, 1.0]),
        column_shares=[2.0, 1.0],
    )
    charts = rrb.Horizontal(
        rrb.Vertical(_lanes(), _events()),
        rrb.Vertical(_plot("speed [m/s]"), _plot("turn rate [rad/s]")),
        rrb.Vertical(_plot("clearance [m]"), _plot("confidence" if learned else "chosen arc")),
        rrb.Vertical(_plot("parameters"), _plot("samples"), row_shares=[1.5, 1.0]),
        column_shares=[1.0, 1.0, 1.0, 1.15],
    )
    return rrb.Blueprint(
        rrb.Vertical(scenes, charts, row_shares=[1.5, 1.0]),
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
    values, shades = list(colours), np.array(list(colours.values()), np.uint8)
    style = rr.StateConfiguration.columns(values=values, colors=shades).partition([len(values)])
    stream.send_columns(entity, [], style)


def _top_view(world: World) -> rrb.Spatial3DView:
    """Straight down on the whole world, its long side across the screen."""
    x0, y0, x1, y1 = bounds(world)
    lying = x1 - x0 >= y1 - y0
    across, along = (x1 - x0, y1 - y0) if lying else (y1 - y0, x1 - x0)
    distance = max(along, across / TOP_ASPECT) / 2.0 / math.tan(FIELD_OF_VIEW / 2.0)
    x, y = (x0 + x1) / 2.0, (y0 + y1) / 2.0
    return rrb.Spatial3DView(
        origin="world",
        contents=["+ $origin/**", "- $origin/obstacles/**", "- $origin/robot/scan"],
        name="top view",
        background=palette.BACKGROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=(x, y, distance),
            look_target=(x, y, 0.0),
            eye_up=(0.0, 1.0, 0.0) if lying else (-1.0, 0.0, 0.0),
        ),
        overrides=_overrides(),
    )


def _robot_view() -> rrb.Spatial3DView:
    """The robot and what stands round it, seen over its shoulder.

    The view lives in the robot's frame. Rerun can also follow an entity, but then places the camera by the entity's
    size, and only next to entities that have one.
    """
    return rrb.Spatial3DView(
        origin="world/robot",
        contents=["+ /world/**", "- /world/plan/**", "- /world/local_costmap", "- /world/segments/**"],
        name="robot",
        background=palette.BACKGROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=CAMERA, look_target=(0.35, 0.0, 0.1)),
        overrides=_overrides(),
    )


def _overrides() -> dict[str, Any]:
    """The trail shows all that was driven up to the time cursor; the ground does not catch the pointer."""
    past = rrb.VisibleTimeRanges(
        timeline=TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    ground = ("world/floor", "world/floor/grid", "world/local_costmap")
    return {"world/trail": past} | {entity: rrb.EntityBehavior(interactive=False) for entity in ground}


def _lanes() -> rrb.StateTimelineView:
    lanes = ["planner/state", "appli/context"]
    return rrb.StateTimelineView(origin="/", contents=lanes, name="states", time_view=_whole_run())


def _events() -> rrb.TextLogView:
    columns = rrb.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["body"])
    return rrb.TextLogView(origin="events", name="events", columns=columns)


def _plot(name: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin="/",
        contents=list(PLOTS[name]),
        name=name,
        axis_x=_whole_run(),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
    )


def _whole_run() -> rrb.TimeAxis:
    """A time axis over everything; left to itself a plot scrolls with the cursor and shows the last minute."""
    everything = rrb.TimeRange(rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.infinite())
    return rrb.TimeAxis(view_range=everything)
