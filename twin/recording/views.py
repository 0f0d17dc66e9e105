"""The views of a recording, one function each. `at` is where the recording lies in the file: "" or a folder and "/"."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from twin.recording import palette
from twin.recording.plots import LANES, Lines

TIMELINE = "sim_time"
FIELD_OF_VIEW = math.radians(55.0)  # vertical, of Rerun's 3-D camera
CAMERA = (-1.0, 0.4, 1.55)  # [m] of the robot view, in base_link; higher than a wall behind the robot

Box = tuple[float, float, float, float]  # min x, min y, max x, max y [m]


def top_view(box: Box, aspect: float, at: str = "", name: str = "top view") -> rrb.Spatial3DView:
    """Straight down on all of `box`, its long side across the screen; `aspect`: width over height of the view."""
    x0, y0, x1, y1 = box
    lying = x1 - x0 >= y1 - y0
    across, along = (x1 - x0, y1 - y0) if lying else (y1 - y0, x1 - x0)
    distance = max(along, across / aspect) / 2.0 / math.tan(FIELD_OF_VIEW / 2.0)
    x, y = (x0 + x1) / 2.0, (y0 + y1) / 2.0
    return rrb.Spatial3DView(
        origin=f"/{at}world",
        contents=["+ $origin/**", "- $origin/obstacles/**", "- $origin/robot/scan"],
        name=name,
        background=palette.BACKGROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=(x, y, distance),
            look_target=(x, y, 0.0),
            eye_up=(0.0, 1.0, 0.0) if lying else (-1.0, 0.0, 0.0),
        ),
        overrides=_overrides(at),
    )


def robot_view(at: str = "", name: str = "robot") -> rrb.Spatial3DView:
    """The robot and what stands round it, seen over its shoulder.

    The view lives in the robot's frame. Rerun can also follow an entity, but then places the camera by the entity's
    size, and only next to entities that have one.
    """
    world = f"/{at}world"
    return rrb.Spatial3DView(
        origin=f"{world}/robot",
        contents=[f"+ {world}/**", f"- {world}/plan/**", f"- {world}/local_costmap", f"- {world}/segments/**"],
        name=name,
        background=palette.BACKGROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=CAMERA, look_target=(0.35, 0.0, 0.1)),
        overrides=_overrides(at),
    )


def _overrides(at: str) -> dict[str, Any]:
    """The trail shows all that was driven up to the time cursor; the ground does not catch the pointer."""
    past = rrb.VisibleTimeRanges(
        timeline=TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    ground = ("world/floor", "world/floor/grid", "world/local_costmap")
    still = {f"{at}{entity}": rrb.EntityBehavior(interactive=False) for entity in ground}
    return {f"{at}world/trail": past} | still


def lanes(ats: Sequence[str] = ("",), name: str = "states") -> rrb.StateTimelineView:
    """Context, phase of an intervention, and planner state, of one recording or several."""
    contents = [f"/{at}{lane}" for at in ats for lane in LANES]
    return rrb.StateTimelineView(origin="/", contents=contents, name=name, time_view=whole_run())


def events(at: str = "", name: str = "events") -> rrb.TextLogView:
    """What happened, line by line."""
    columns = rrb.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["body"])
    return rrb.TextLogView(origin=f"/{at}events", name=name, columns=columns)


def summary(at: str = "", name: str = "run") -> rrb.TextDocumentView:
    """The text panel: world, driver, seed, outcome."""
    return rrb.TextDocumentView(origin=f"/{at}run", name=name)


def plot(name: str, lines: Lines, styled: bool = False, legend: bool = True) -> rrb.TimeSeriesView:
    """Lines over the whole run; `styled`: with these names and colours instead of those in the file."""
    styles = {
        f"/{entity}": rr.SeriesLines(names=[label], colors=np.array([colour], np.uint8), widths=[width])
        for entity, (label, colour, width) in lines.items()
    }
    return rrb.TimeSeriesView(
        origin="/",
        contents=[f"/{entity}" for entity in lines],
        name=name,
        axis_x=whole_run(),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
        overrides=styles if styled else None,
    )


def whole_run() -> rrb.TimeAxis:
    """A time axis over everything; left to itself a plot scrolls with the cursor and shows the last minute."""
    everything = rrb.TimeRange(rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.infinite())
    return rrb.TimeAxis(view_range=everything)


def opened(content: Any) -> rrb.Blueprint:
    """A blueprint that shows `content` and nothing else, at the end of the recording, following what comes in."""
    return rrb.Blueprint(
        content,
        rrb.TimePanel(timeline=TIMELINE, state="collapsed", play_state="following"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_layout=False,
        auto_views=False,
    )
