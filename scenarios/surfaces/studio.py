"""MuJoCo Studio as a teleop surface, in a browser or in a window. The only doorway to `mujoco.experimental.studio`.

Studio's viewer runs on a thread of its own with a copy of the model, and gets the twin's physics state after every
tick. Its usual tools (pausing, dragging, loading models) are not plugged in: they would work behind the session's back.

Studio's web server is meant for trusted networks: it listens everywhere, takes models from anyone, and answers any
page. Here it listens on one address, takes nothing, and answers its own page only (`web_guard.py`).
"""

from __future__ import annotations

import collections.abc
import contextlib
import io
import logging
import math
import os
import socket
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, Final

import mujoco
import numpy as np
from mujoco.experimental.dear_imgui import dear_imgui as imgui
from mujoco.experimental.studio import launch_thread, messages, plugin, ux, viewer_protocol

from scenarios.errors import UserError
from scenarios.keyboard import CAMERA, QUIT, STOP, Keys
from scenarios.surfaces.overlay import NAMES, Rgba, panel_lines, strokes
from scenarios.surfaces.web_guard import Guard, listen
from scenarios.teleop_view import View
from twin.arena import compile_world
from twin.records import Array, Pose2
from twin.world import World

START: Final = 30.0  # [s] for the viewer to come up
SILENT: Final = 2.0  # [s] a page sends its input with every picture it draws, slow machines one a second; hidden, none
STATE: Final = int(mujoco.mjtState.mjSTATE_INTEGRATION)

KEY_NAMES: Final = {
    **{getattr(imgui.Key, letter.upper()): letter for letter in "wasdrqc"},
    imgui.Key.N1: "1", imgui.Key.N2: "2", imgui.Key.N3: "3",
    imgui.Key.Keypad1: "1", imgui.Key.Keypad2: "2", imgui.Key.Keypad3: "3",
    imgui.Key.UpArrow: "up", imgui.Key.DownArrow: "down", imgui.Key.LeftArrow: "left", imgui.Key.RightArrow: "right",
    imgui.Key.LeftShift: "shift", imgui.Key.RightShift: "shift", imgui.Key.Space: STOP,
    imgui.Key.Enter: "enter", imgui.Key.KeypadEnter: "enter", imgui.Key.Backspace: "backspace",
}  # fmt: skip


class Cockpit(plugin.ViewerPlugin):  # type: ignore[misc]
    """Lives on the viewer's thread: reads keys, follows the robot with the camera, draws panel and lines."""

    def __init__(self, start: Pose2) -> None:
        """Before the viewer exists; the camera begins behind `start` (world)."""
        self._start = start
        self.ready = threading.Event()
        self.last_frame = -math.inf  # [s] time.monotonic
        self._lock = threading.Lock()
        self._held: frozenset[str] = frozenset()
        self._pressed: list[str] = []
        self._view: View | None = None
        self._drawn: View | None = None
        self._from_above = False
        self._azimuth: float | None = None  # [deg]

    def take(self) -> Keys:
        """For the session's thread: the keys since the last call."""
        with self._lock:
            pressed, self._pressed = tuple(self._pressed), []
            return Keys(self._held, pressed)

    def show(self, view: View) -> None:
        """For the session's thread: what to draw from now on."""
        with self._lock:
            self._view = view

    @messages.handler  # type: ignore[untyped-decorator]
    def on_init(self, event: plugin.ViewerInitEvent) -> None:
        """The viewer is up."""
        ux.setup_theme(ux.GuiTheme.DARK)
        event.viewer.camera.type = int(mujoco.mjtCamera.mjCAMERA_FREE)
        self._aim(self._start)
        self.ready.set()

    @messages.handler  # type: ignore[untyped-decorator]
    def on_build_gui(self, _: messages.BuildGuiEvent) -> None:
        """Once per picture."""
        held = {name for key, name in KEY_NAMES.items() if imgui.IsKeyDown(key)}
        pressed = [name for key, name in KEY_NAMES.items() if imgui.IsKeyPressed(key, False)]
        self._from_above ^= CAMERA in pressed
        with self._lock:
            self._held = frozenset(held)
            self._pressed += pressed
            view = self._view
        self.last_frame = time.monotonic()
        if view is not None:
            self._aim(view.frame.pose)
            if view is not self._drawn:
                self._drawn = view
                self.viewer.extra_geoms[:] = [_stroke(a, b, width, rgba) for a, b, width, rgba in strokes(view)]
            _panel(view)

    def _aim(self, pose: Pose2) -> None:
        """The camera behind the robot, or high above it."""
        camera = self.viewer.camera
        if self._azimuth is None:
            self._azimuth = math.degrees(pose.yaw)
        turn = math.remainder(math.degrees(pose.yaw) - self._azimuth, 360.0)
        self._azimuth += 0.06 * turn  # lags behind, so that turning looks like turning
        above = self._from_above
        ahead = 0.0 if above else 0.9
        camera.lookat[:] = (pose.x + ahead * math.cos(pose.yaw), pose.y + ahead * math.sin(pose.yaw), 0.0)
        camera.azimuth = 90.0 if above else self._azimuth
        camera.elevation, camera.distance = (-89.0, 10.0) if above else (-33.0, 4.8)


def _stroke(a: Array, b: Array, width: float, rgba: Rgba) -> Any:
    """A round line from a to b, (3,) world [m]."""
    geom = mujoco.MjvGeom()
    kind = mujoco.mjtGeom.mjGEOM_CAPSULE
    mujoco.mjv_initGeom(geom, kind, [width, width, width], [0, 0, 0], [1, 0, 0, 0, 1, 0, 0, 0, 1], list(rgba))
    mujoco.mjv_connector(geom, kind, width, a, b)
    return geom


def _panel(view: View) -> None:
    """The status panel; it takes no input, so that no key is swallowed."""
    flag = imgui.WindowFlags
    flags = [flag.NoDecoration, flag.NoInputs, flag.NoNav, flag.NoSavedSettings, flag.NoFocusOnAppearing, flag.NoMove]
    imgui.SetNextWindowPos(imgui.Vec2(16, 16))
    imgui.SetNextWindowSize(imgui.Vec2(372, 0))
    imgui.SetNextWindowBgAlpha(0.84)
    imgui.Begin("appli teleop", None, sum(int(f) for f in flags))
    for line in panel_lines(view):
        if line.rule:
            imgui.Separator()
        if line.name:
            imgui.TextColored(imgui.Vec4(*NAMES), line.name)
            imgui.SameLine(line.column)
        imgui.PushStyleColor(imgui.Col.Text, imgui.Vec4(*line.rgba))
        imgui.SetWindowFontScale(line.scale)
        imgui.TextWrapped(line.text)
        imgui.SetWindowFontScale(1.0)
        imgui.PopStyleColor()
    imgui.End()


class StudioSurface:
    """A running viewer, seen from the session's thread."""

    def __init__(
        self, start: Pose2, run: Callable[[Any, Cockpit], None], last_sign: Callable[[Cockpit], float]
    ) -> None:
        """Start the viewer and wait until it is up. `last_sign`: when [s] there last was somebody at the keys."""
        self._cockpit = Cockpit(start)
        self._last_sign = last_sign
        self._error: Exception | None = None
        viewer_end, self._end = launch_thread.make_thread_endpoints()

        def target() -> None:
            try:
                run(viewer_end, self._cockpit)
            except Exception as error:
                self._error = error

        self._thread = threading.Thread(target=target, daemon=True)
        deadline = time.monotonic() + START
        # Studio prints a banner of its own and logs to stdout; the command says what there is to say.
        with contextlib.redirect_stdout(io.StringIO()):
            logging.getLogger("WebServer").setLevel(logging.WARNING)
            self._thread.start()
            while not self._cockpit.ready.wait(0.05) and self._thread.is_alive() and time.monotonic() < deadline:
                pass
        if not self._cockpit.ready.is_set():
            self.close()
            raise UserError(f"the viewer does not start: {self._error or 'no answer'}; try --surface terminal")

    def poll(self) -> Keys:
        """The keys; none, and `lost`, when the page is gone or hidden. A closed window means Q."""
        if not self._thread.is_alive():
            if self._error is not None:
                raise UserError(f"the viewer stopped: {self._error}") from self._error
            return Keys(pressed=(QUIT,))
        keys = self._cockpit.take()
        if time.monotonic() - self._last_sign(self._cockpit) > SILENT:
            return Keys(lost=True)
        return keys

    def draw(self, view: View) -> None:
        """Send the twin's state and the words about it."""
        self._cockpit.show(view)
        with contextlib.suppress(RuntimeError):  # the viewer has just closed; poll will tell
            self._end.send_to_viewer(messages.StateSnapshot(state=view.frame.physics, state_sig=STATE))

    def close(self) -> None:
        """Stop viewer and server."""
        with contextlib.suppress(RuntimeError):
            self._end.send_to_viewer(messages.ExitEvent())
        self._thread.join(5.0)
        self._end.close()


def open_window(world: World, lidar_mount: str) -> StudioSurface:
    """A window on this machine's display."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise UserError("no display for a window here; use --surface web (a browser page) or --surface terminal")
    model = compile_world(world, lidar_mount)
    # Studio 3.17's mode "opengl" fails ("Target not found"); this one draws to pixels and shows them.
    config = viewer_protocol.ViewerConfig(title="appli teleop", gfx="opengl_software", width=1280, height=800)

    def run(end: Any, cockpit: Cockpit) -> None:
        if not hasattr(collections.abc, "Buffer"):  # MuJoCo 3.17's renderer names it in annotations; Python 3.12 has it
            collections.abc.Buffer = np.ndarray  # type: ignore[attr-defined]
        from mujoco.experimental.studio import native_viewer  # loads OpenGL

        viewer_protocol.run_viewer_loop(native_viewer.NativeViewer(config, end, model=model, plugins=[cockpit]))

    return StudioSurface(world.start, run, lambda cockpit: cockpit.last_frame)


def open_web(world: World, lidar_mount: str, address: str, port: int) -> tuple[StudioSurface, str]:
    """A page that any browser can show, and its URL. Port 0 takes any free one."""
    os.environ.pop("MUJOCO_WEB_VIEWER_DIST", None)  # Studio would serve any folder named here
    from mujoco.experimental.studio import web_viewer
    from mujoco.experimental.studio.web import web_server

    public = listen(address, port)
    port = public.getsockname()[1]
    guard = Guard(address)
    # Studio 3.17 has no option for the address; these two names are where its server gets its socket and its manners.
    web_server.bind_public_socket = lambda host, port=0: public
    web_server.serve = guard.serve
    model = compile_world(world, lidar_mount)
    config = viewer_protocol.ViewerConfig(title="appli teleop", gfx="web", http_port=port)

    def run(end: Any, cockpit: Cockpit) -> None:
        viewer_protocol.run_viewer_loop(web_viewer.WebViewer(config, end, model=model, plugins=[cockpit]))

    surface = StudioSurface(world.start, run, lambda cockpit: min(guard.last_input, cockpit.last_frame))
    name = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname()}.get(address, address)
    return surface, f"http://{f'[{name}]' if ':' in name else name}:{port}/"
