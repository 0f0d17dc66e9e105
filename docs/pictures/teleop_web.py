"""Takes the picture `teleop_web.png`: `python docs/pictures/teleop_web.py [SECONDS]` from the repository's root.

It needs chromium. A session is driven by a key script to a moment in an intervention, and shown by the web surface;
drawing that in software takes some seconds.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

from scenarios.surfaces.script import KeyEvent, ScriptSurface
from scenarios.surfaces.studio import open_web
from scenarios.teaching import TAPE
from scenarios.teleop_session import TeleopSession
from scenarios.trials import TrialSpec, make_driver, make_simulation
from scenarios.worlds import load_world
from tests.scenarios.teleop_browser import page
from twin.rewind import Tape
from twin.rollout import Loop

HERE = Path(__file__).parent
WORLD = "training"
SIZE = (1280, 887)  # [px] of the browser, whose own bars take 87
DRIVE = (
    KeyEvent(5.0, "down", "r"),
    KeyEvent(6.0, "up", "r"),
    KeyEvent(6.1, "press", "1"),
    KeyEvent(6.1, "down", "w"),
    KeyEvent(6.3, "down", "a"),
    KeyEvent(7.1, "up", "a"),
    KeyEvent(9.5, "down", "d"),
    KeyEvent(10.2, "up", "w"),  # the picture is taken here
)


def main(patience: float) -> None:
    """Drive, show, wait until the page has drawn, and take the picture."""
    world, spec = load_world(WORLD), TrialSpec(WORLD)
    keys = ScriptSurface(DRIVE)
    with tempfile.TemporaryDirectory() as folder:
        tape = Tape(Loop(make_simulation(spec, world), make_driver(spec)), TAPE)
        session = TeleopSession(tape, Path(folder), WORLD, spec.seed)
        surface, url = open_web(world, spec.switches.lidar_mount, "127.0.0.1", 0)
        try:
            for _ in range(round(DRIVE[-1].time / 0.05)):
                view = session.frame(keys.poll())
            surface.draw(view)
            print(view.mode, view.frame.pose, view.message)
            with page(url, Path(folder) / "profile", SIZE) as browser:
                time.sleep(patience / 2)
                browser.click(900, 700)  # closes the viewer's own box
                browser.click(900, 700)
                time.sleep(patience / 2)
                browser.screenshot(HERE / "teleop_web.png")
        finally:
            surface.close()
    with Image.open(HERE / "teleop_web.png") as image:  # a palette would falsify the floor
        image.convert("RGB").save(HERE / "teleop_web.png", optimize=True)


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 40.0)
