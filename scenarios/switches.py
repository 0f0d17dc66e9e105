"""The choices that ROS, the paper and the authors' code leave open, as one flat record for the command line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Switches:
    """The defaults are explained in docs/fidelity.md."""

    meter_scoring_factor: Literal["1.0", "0.05"] = "1.0"
    """What path and goal biases are multiplied by (undefined in ROS; 1.0 fits the published runs)."""
    inflation: Literal["both", "local"] = "both"
    """Which costmaps obey the parameter set's inflation_radius."""
    couple_min_vel_theta: bool = False
    """Set min_vel_theta = -max_vel_theta with every parameter set (off: the Jackal's -1.57 rad/s stays)."""
    clearing_works: bool = False
    """Let the clearing recoveries clear (off: on the Jackal they look for a layer that does not exist)."""
    lidar_mount: Literal["ust10", "lms1xx"] = "ust10"
    """Where the lidar sits: BARN's UST-10, or the Jackal's front LMS1xx."""
