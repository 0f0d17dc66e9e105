"""The columns that the steps of an intervention are packed into, and what must be true of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[Any]]

MAPS = ("local", "global")

MAX_STEPS = 20_000  # 1000 s at 20 Hz
MAX_BEAMS = 10_000
MAX_MAP_SIDE = 4096  # [cells]
MAX_COORDINATE = 1e6  # [m] or [s]
MAX_RUNS = 20_000_000

# name -> (dtype, shape); T = steps, N = beams, any other letter = a length of its own.
LAYOUT: dict[str, tuple[type[np.generic], tuple[str | int, ...]]] = {
    "time": (np.float64, ("T",)),  # [s]
    "pose": (np.float64, ("T", 3)),  # odom_from_base x, y [m], yaw [rad]
    "twist": (np.float64, ("T", 2)),  # base_link v [m/s], w [rad/s]
    "goal": (np.float64, ("T", 3)),  # odom x, y [m], yaw [rad]
    "action": (np.float64, ("T", 2)),  # the intervener's v [m/s], w [rad/s]
    "labelled": (np.bool_, ("T",)),
    "ranges": (np.float64, ("T", "N")),  # [m]; inf = no return
    "scan_frame": (np.float64, (7,)),  # angle_min, angle_max [rad], range_min, range_max [m], mount x, y, z [m]
} | {
    f"{name}_{column}": layout
    for name in MAPS
    for column, layout in {
        "shape": (np.int32, (2,)),  # ny, nx
        "resolution": (np.float64, ()),  # [m]
        "origin": (np.float64, ("T", 2)),  # odom [m]
        "touched": (np.float64, ("T", 4)),  # odom [m]
        "whole": (np.bool_, ("T",)),
        "runs": (np.int32, ("T",)),  # how many runs of changed cells each step has
        "gap": (np.int32, (f"{name} runs",)),  # [cells] unchanged since the end of the run before
        "length": (np.int32, (f"{name} runs",)),  # [cells] changed, all to the same value
        "value": (np.uint8, (f"{name} runs",)),
    }.items()
}


def check_columns(columns: Columns) -> None:
    """Raise ValueError unless the columns are complete, of the right types and sizes, finite and consistent."""
    if missing := LAYOUT.keys() - columns.keys():
        raise ValueError(f"{min(missing)} is missing")
    if strange := columns.keys() - LAYOUT.keys():
        raise ValueError(f"{min(strange)} is not known")
    sizes: dict[str, int] = {}
    for name, (dtype, shape) in LAYOUT.items():
        column = columns[name]
        if column.dtype != dtype:
            raise ValueError(f"{name} must be {np.dtype(dtype)}, not {column.dtype}")
        if column.ndim != len(shape):
            raise ValueError(f"{name} must have {len(shape)} dimensions, not {column.ndim}")
        for n, wanted in zip(column.shape, shape, strict=True):
            if n != (sizes.setdefault(wanted, n) if isinstance(wanted, str) else wanted):
                raise ValueError(f"{name} has the wrong shape {column.shape}")
        if name != "ranges" and column.dtype == np.float64 and not np.isfinite(column).all():
            raise ValueError(f"{name} must be finite")
    if not 1 <= sizes["T"] <= MAX_STEPS:
        raise ValueError(f"there must be 1 to {MAX_STEPS} steps, not {sizes['T']}")
    if not 1 <= sizes["N"] <= MAX_BEAMS:
        raise ValueError(f"there must be 1 to {MAX_BEAMS} beams, not {sizes['N']}")
    if np.any(np.diff(columns["time"]) <= 0.0):
        raise ValueError("time must increase from step to step")
    if not np.all(columns["ranges"] >= 0.0):
        raise ValueError("ranges must be numbers >= 0 (inf = no return)")
    low, high, near, far = columns["scan_frame"][:4].tolist()
    if not (-math.tau <= low < high <= math.tau and 0.0 <= near < far):
        raise ValueError("the scan's angles or range limits make no sense")
    for name in ("time", "pose", "goal", "twist", "action", "local_origin", "global_origin"):
        if np.abs(columns[name]).max() > MAX_COORDINATE:
            raise ValueError(f"{name} is beyond +-{MAX_COORDINATE:g}")
    for name in MAPS:
        _check_map(columns, name)


def _check_map(columns: Columns, name: str) -> None:
    ny, nx = columns[f"{name}_shape"].tolist()
    if not (1 <= ny <= MAX_MAP_SIDE and 1 <= nx <= MAX_MAP_SIDE):
        raise ValueError(f"the {name} map has an impossible size {ny} x {nx}")
    if not 1e-3 <= columns[f"{name}_resolution"] <= 10.0:
        raise ValueError(f"the {name} map has an impossible resolution")
    runs, gap, length = (columns[f"{name}_{c}"].astype(np.int64) for c in ("runs", "gap", "length"))
    if len(gap) > MAX_RUNS or np.any(runs < 0) or runs.sum() != len(gap):
        raise ValueError(f"the {name} map's runs do not add up")
    if np.any(gap < 0) or np.any(length < 1):
        raise ValueError(f"the {name} map's runs must not overlap")
    covered = np.concatenate([[0], np.cumsum(gap + length)])
    ends = np.cumsum(runs)
    if np.any(covered[ends] - covered[ends - runs] > ny * nx):
        raise ValueError(f"the {name} map's runs leave the map")
    if not np.isin(columns[f"{name}_value"], (0, 254, 255)).all():
        raise ValueError(f"the {name} map must hold 0 (free), 254 (lethal) and 255 (unknown) only")
