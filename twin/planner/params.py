"""theta: the eight tuned planner parameters, their bounds, and the map to the unit cube."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields

import numpy as np

from twin.records import Array


@dataclass(frozen=True, slots=True)
class PlannerParams:
    """The eight parameters in the order of the paper's Table I, under their ROS names.

    The defaults are the Jackal's (`jackal_navigation/params`). Raises ValueError when a value is not finite
    or outside the range that ROS itself accepts.
    """

    max_vel_x: float = 0.50  # [m/s]
    max_vel_theta: float = 1.57  # [rad/s]
    vx_samples: int = 6
    vtheta_samples: int = 20
    occdist_scale: float = 0.10
    pdist_scale: float = 0.75
    gdist_scale: float = 1.00
    inflation_radius: float = 0.30  # [m]

    def __post_init__(self) -> None:
        for name, (low, high) in RECONFIGURE_RANGE.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
                raise ValueError(f"{name} must be a finite number, not {value!r}")
            if name in INTEGERS and value != int(value):
                raise ValueError(f"{name} must be a whole number, not {value!r}")
            if not low <= value <= high:
                raise ValueError(f"{name} = {value} is outside [{low}, {high}]")

    @classmethod
    def from_mapping(cls, values: Mapping[str, object]) -> PlannerParams:
        """The defaults with some values replaced. Raises ValueError for an unknown name or a bad value."""
        known = {f.name for f in fields(cls)}
        for name in values:
            if name not in known:
                raise ValueError(f"unknown parameter {name!r}; known: {', '.join(f.name for f in fields(cls))}")
        for name, value in values.items():
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise ValueError(f"{name} must be a number, not {value!r}")
        return cls(**{k: _whole(v) if k in INTEGERS else float(v) for k, v in values.items()})  # type: ignore[arg-type]

    def as_dict(self) -> dict[str, float]:
        """Name to value, in order."""
        return asdict(self)

    def as_array(self) -> Array:
        """(8,) values in order."""
        return np.array(list(asdict(self).values()), dtype=np.float64)


def _whole(value: float) -> float:
    """3.0 -> 3; anything that is not whole stays, to be refused by PlannerParams."""
    return int(value) if math.isfinite(value) and value == int(value) else value


INTEGERS = frozenset({"vx_samples", "vtheta_samples"})

# What dynamic_reconfigure accepts (base_local_planner and costmap_2d .cfg files).
RECONFIGURE_RANGE: dict[str, tuple[float, float]] = {
    "max_vel_x": (0.0, 20.0),
    "max_vel_theta": (0.0, 20.0),
    "vx_samples": (1, 300),
    "vtheta_samples": (1, 300),
    "occdist_scale": (0.0, 5.0),
    "pdist_scale": (0.0, 5.0),
    "gdist_scale": (0.0, 5.0),
    "inflation_radius": (0.0, 50.0),
}

PARAMETER_NAMES = tuple(f.name for f in fields(PlannerParams))


@dataclass(frozen=True, slots=True)
class ParameterSpace:
    """A box of parameters to search, mapped linearly to the unit cube.

    The default bounds are those of the authors' CMA-ES (APPLD code), in the order of `PlannerParams`.
    """

    lower: tuple[float, ...] = (0.2, 0.7, 3, 3, 0.0, 0.0, 0.0, 0.0)
    upper: tuple[float, ...] = (2.0, 2.2, 20, 60, 1.0, 1.0, 1.0, 0.5)

    def decode(self, unit: Array) -> PlannerParams:
        """Unit-cube point (8,) to parameters; values outside are clipped, sample counts truncated as the authors'."""
        low, high = np.array(self.lower), np.array(self.upper)
        values = low + np.clip(unit, 0.0, 1.0) * (high - low)
        return PlannerParams.from_mapping(
            {
                n: math.floor(v + 1e-9) if n in INTEGERS else float(v)
                for n, v in zip(PARAMETER_NAMES, values, strict=True)
            }
        )

    def encode(self, theta: PlannerParams) -> Array:
        """Parameters to the unit cube (8,), clipped to it."""
        low, high = np.array(self.lower), np.array(self.upper)
        unit: Array = np.clip((theta.as_array() - low) / (high - low), 0.0, 1.0)
        return unit
