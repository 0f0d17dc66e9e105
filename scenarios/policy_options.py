"""What the paper and the authors' code leave open about a policy, as one flat record for the command line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class PolicyOptions:
    """They are kept in the policy (docs/learning.md)."""

    confidence: bool = True
    """--no-confidence never falls back to the default parameters."""
    eps_u: float = 0.8
    """Confidence below which the default parameters are taken."""
    window: int = 20
    """Steps of the mode filter, 20 a second; 1 = no filter."""
    path_gate: bool = False
    """No confidence while the path bends by 60 degrees or more, as in the authors' node."""
    inflation: Literal["both", "local"] = "both"
    """Which costmaps obey a context's inflation_radius; the authors' node: local."""
    couple_min_vel_theta: bool = False
    """Set min_vel_theta = -max_vel_theta with every context's parameters."""
    plain: bool = False
    """Train the classifier as published, without what docs/learning.md adds."""
