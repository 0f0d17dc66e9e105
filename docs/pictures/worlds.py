"""Renders a BARN-like world: `MUJOCO_GL=egl python docs/pictures/worlds.py`."""

from __future__ import annotations

from robot import take

from scenarios.worlds import load_world

if __name__ == "__main__":
    take(load_world("barn-like/150"), "barn_like_150.png", (-2.2, 6.0, 0.0), 0.0, -52.0, 11.0, 4.0)
