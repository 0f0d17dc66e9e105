"""The parameters that the paper learned on its robot (Table I); for known-answer tests and diagnosis.

They belong to that robot and those demonstrations: used all the time in the twin, each is slower than the default.
"""

from __future__ import annotations

from twin.planner.params import PlannerParams

# max_vel_x, max_vel_theta, vx_samples, vtheta_samples, occdist_scale, pdist_scale, gdist_scale, inflation_radius
_TABLE_I: dict[str, tuple[float, float, int, int, float, float, float, float]] = {
    "A1": (0.26, 2.00, 13, 44, 0.57, 0.76, 0.94, 0.02),  # a curve
    "A2": (0.22, 0.87, 13, 31, 0.30, 0.36, 0.71, 0.30),  # a narrow corridor
    "B1": (1.91, 1.70, 10, 47, 0.08, 0.71, 0.35, 0.23),  # open space
    "B2": (0.72, 0.73, 19, 59, 0.62, 1.00, 0.32, 0.24),  # a narrow entrance; the table calls it B1 a second time
    "D1": (0.37, 1.33, 9, 6, 0.95, 0.83, 0.93, 0.01),  # ordinary driving, first
    "D2": (0.31, 1.05, 17, 20, 0.45, 0.61, 0.22, 0.23),  # ordinary driving, second
}


def published_parameters() -> dict[str, PlannerParams]:
    """Context label to theta, in the paper's order."""
    return {label: PlannerParams(*row) for label, row in _TABLE_I.items()}
