"""Where a person sits: a terminal, a browser page, a window, or a script of keys. One small protocol."""

from __future__ import annotations

from typing import Protocol

from scenarios.keyboard import Keys
from scenarios.teleop_view import View


class Surface(Protocol):
    """Tells which keys are down, and shows how things stand."""

    def poll(self) -> Keys:
        """The keys held now, and those pressed since the last call. Called at 20 Hz."""

    def draw(self, view: View) -> None:
        """Show it; returns at once."""

    def close(self) -> None:
        """Give back the terminal, the port or the window; may be called twice."""
