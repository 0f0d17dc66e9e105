"""The one doorway to dm_control's PyMJCF, so that its import stays quiet.

dm_control probes GLFW when it is imported and warns where there is no display. We compile with plain MuJoCo and never
ask dm_control to draw, so the warning tells our users nothing.
"""

from __future__ import annotations

import warnings

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from dm_control import mjcf

__all__ = ["mjcf"]
