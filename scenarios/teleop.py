"""`appli teleop`: a person drives the twin, shows the planner how, and writes interventions."""

from __future__ import annotations

import ipaddress
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from types import FrameType
from typing import Literal

from scenarios.errors import UserError, blame
from scenarios.folders import make_folder
from scenarios.run import compile_kernels
from scenarios.surfaces import Surface
from scenarios.teaching import TAPE
from scenarios.teleop_session import TeleopSession
from scenarios.trials import TrialSpec, make_driver, make_simulation
from scenarios.worlds import check_protocol, load_world
from twin.rewind import Tape
from twin.rollout import Loop
from twin.simulation import TICK
from twin.world import World

SurfaceName = Literal["web", "window", "terminal"]
BEHIND = 0.25  # [s] a delay longer than this is not caught up with: the twin goes slower rather than in leaps


def teleop_command(
    world_name: str,
    out: Path,
    surface: SurfaceName = "web",
    driver: str = "dwa",
    protocol: str = "appli",
    seed: int = 0,
    keys: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
) -> int:
    """Drive until the person quits; see `appli teleop --help`. Exit code 0."""
    if seed < 0:
        raise UserError(f"--seed must be 0 or more, not {seed}")
    if not 0 <= port <= 65535:
        raise UserError(f"--port must be 0 (any free one) to 65535, not {port}")
    spec = TrialSpec(world_name, protocol, driver, seed)
    with blame():
        world = load_world(world_name, protocol)
        check_protocol(world, protocol)
        make_driver(spec)  # a wrong name or file is told before anything is opened
    with ExitStack() as stack:
        stack.enter_context(_signals_unwind())
        shown = stack.enter_context(closing(_open(surface, world, spec, keys, host, port)))
        make_folder(out)
        compile_kernels()
        with blame():
            tape = Tape(Loop(make_simulation(spec, world), make_driver(spec)), TAPE)
        session = TeleopSession(tape, out, world_name, seed)
        with blame(f"cannot write to {out}"):
            drive(session, shown, paced=keys is None)
    files = ", ".join(path.name for path in session.saved)
    print(f"{len(session.saved)} interventions in {out}" + (f": {files}" if files else ""))
    return 0


def drive(session: TeleopSession, surface: Surface, paced: bool) -> None:
    """Let the session live at 20 Hz, or as fast as it can, until it is finished."""
    surface.draw(session.view())
    due = time.monotonic()
    while not session.finished:
        surface.draw(session.frame(surface.poll()))
        if paced:
            due = max(due + TICK, time.monotonic() - BEHIND)
            time.sleep(max(0.0, due - time.monotonic()))


def _open(surface: SurfaceName, world: World, spec: TrialSpec, keys: Path | None, host: str, port: int) -> Surface:
    """The surface that was asked for. Heavy imports happen here, one surface at a time."""
    if keys is not None:
        from scenarios.surfaces.script import ScriptSurface, read_script

        return ScriptSurface(read_script(keys))
    if surface == "terminal":
        from scenarios.surfaces.terminal import TerminalSurface

        return TerminalSurface.open(world)
    compile_kernels()  # before the page is there: a twin that does not answer looks broken
    from scenarios.surfaces.studio import open_web, open_window

    if surface == "window":
        return open_window(world, spec.switches.lidar_mount)
    if surface != "web":
        raise UserError(f"unknown surface {surface!r}; there are web, window and terminal")
    address = _address(host)
    if not address.is_loopback:
        print(
            f"appli teleop: WARNING: --host {host} lets anyone who can reach this machine drive; there is no password. "
            "Without --host only this machine can connect (from elsewhere: ssh -L).",
            file=sys.stderr,
        )
    shown, url = open_web(world, spec.switches.lidar_mount, str(address), port)
    print(f"appli teleop: open {url} in a browser and click into the page (Ctrl-C ends)", file=sys.stderr, flush=True)
    return shown


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """An address to listen on, from what was typed."""
    try:
        return ipaddress.ip_address("127.0.0.1" if host == "localhost" else host)
    except ValueError:
        raise UserError(f"--host must be an address such as 127.0.0.1 or 0.0.0.0, not {host!r}") from None


@contextmanager
def _signals_unwind() -> Iterator[None]:
    """Being told to stop runs the `finally`s, as Ctrl-C does, so that the terminal is given back."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    try:
        before = {number: signal.signal(number, stop) for number in (signal.SIGTERM, signal.SIGHUP)}
    except ValueError:  # not in the main thread (a test)
        yield
        return
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
