"""What is plotted and which lanes there are: names, colours and widths of the lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr

from twin.recording import palette
from twin.recording.palette import RGB

Lines = Mapping[str, tuple[str, RGB, float]]  # entity: (name, colour, line width)

PLOTS: dict[str, Lines] = {
    "speed [m/s]": {
        "command/applied/v": ("applied", palette.APPLIED, 4.0),  # first: Rerun draws by name, so it lies below
        "command/human/v": ("human", palette.HUMAN, 1.6),
        "command/planner/v": ("planner", palette.COMMANDED, 1.0),
        "odometry/v": ("measured", palette.MEASURED, 1.6),
    },
    "turn rate [rad/s]": {
        "command/applied/w": ("applied", palette.APPLIED, 4.0),
        "command/human/w": ("human", palette.HUMAN, 1.6),
        "command/planner/w": ("planner", palette.COMMANDED, 1.0),
        "odometry/w": ("measured", palette.MEASURED, 1.6),
    },
    "clearance [m]": {"clearance": ("to obstacles", palette.CLEARANCE, 1.6)},
    "confidence": {
        "appli/confidence": ("confidence", palette.CONFIDENCE, 1.6),
        "appli/threshold": ("threshold", palette.THRESHOLD, 1.2),
    },
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

LANES: dict[str, Mapping[str, RGB]] = {
    "appli/context": palette.CONTEXTS,
    "phase": palette.PHASES,
    "planner/state": palette.STATES,
}


def evidence_entity(label: str) -> str:
    """The entity of a context's evidence; a label may hold characters that mean something in a path."""
    return f"appli/evidence/{rr.escape_entity_path_part(label)}"


def evidence_lines(labels: Sequence[str]) -> Lines:
    """A line per context, in its colour."""
    return {evidence_entity(label): (label, palette.context_colour(label), 1.2) for label in labels}


def style_plots(stream: Any) -> None:
    """Names, colours and widths of the plotted lines, and the colours of the lanes."""
    for lines in PLOTS.values():
        style_lines(stream, lines)
    for entity, colours in LANES.items():
        if entity != "phase":  # an empty lane would be shown for every drive without phases
            style_lane(stream, entity, colours)


def style_lines(stream: Any, lines: Lines) -> None:
    """Names, colours and widths of some lines."""
    for entity, (name, colour, width) in lines.items():
        style = rr.SeriesLines.columns(names=[name], colors=np.array([colour], np.uint8), widths=[width])
        stream.send_columns(entity, [], style)


def style_lane(stream: Any, entity: str, colours: Mapping[str, RGB]) -> None:
    """The colours of a lane's states."""
    values, shades = list(colours), np.array(list(colours.values()), np.uint8)
    style = rr.StateConfiguration.columns(values=values, colors=shades).partition([len(values)])
    stream.send_columns(entity, [], style)
