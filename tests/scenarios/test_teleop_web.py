"""The web surface: who may connect, and a drive in headless Chromium with real key presses."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from learning.interventions import load_dataset
from scenarios.errors import UserError
from scenarios.surfaces.studio import open_web
from scenarios.surfaces.web_guard import Guard
from scenarios.worlds import load_world
from tests.scenarios.teleop_browser import chromium, page

SLOW = 3.0  # [s] per picture: a page slower than this would take minutes to drive
MAIN = """
import json, sys, time
from pathlib import Path
from scenarios.surfaces import studio
from scenarios.teleop import teleop_command

studio.SILENT = 10.0  # a page drawn in software on a busy machine may need seconds for a picture
draw = studio.StudioSurface.draw
log = open(sys.argv[2], "w", buffering=1)

def draw_and_log(self, view):
    draw(self, view)
    frame = view.frame
    entry = {"index": frame.index, "x": frame.pose.x, "v": frame.twist.v, "mode": view.mode.name}
    entry |= {"label": view.label, "saved": view.saved, "quiet": time.monotonic() - self._last_sign(self._cockpit)}
    print(json.dumps(entry), file=log)

studio.StudioSurface.draw = draw_and_log
sys.exit(teleop_command(sys.argv[3], Path(sys.argv[1]), "web", port=0))
"""


PLAIN = """
name = "plain"
note = "nothing to hit: a slow browser lets go of a key late"
start = [0.0, 0.0, 0.0]
goal = [18.0, 0.0]
goal_tolerance = 0.5
time_limit = 300.0
"""


def listeners(pid: int) -> set[str]:
    """Addresses [host:port in hex] on which a process listens, from /proc."""
    inodes = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(OSError):
            inodes.add(os.readlink(link))
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            words = line.split()
            if words[3] == "0A" and f"socket:[{words[9]}]" in inodes:
                found.add(words[1])
    return found


# --- who may connect -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def address() -> Iterator[tuple[str, int]]:
    surface, url = open_web(load_world("open"), "ust10", "127.0.0.1", 0)
    host, _, port = url.removeprefix("http://").rstrip("/").rpartition(":")
    yield host, int(port)
    surface.close()


def status(address: tuple[str, int], path: str, **headers: str) -> int:
    connection = http.client.HTTPConnection(*address, timeout=10)
    connection.request("GET", path, headers=headers)
    return connection.getresponse().status


@pytest.mark.skipif(not Path("/proc/self/net/tcp").exists(), reason="needs Linux's /proc")
def test_only_loopback_listens(address: tuple[str, int]) -> None:
    found = listeners(os.getpid())
    assert f"0100007F:{address[1]:04X}" in found
    assert {listener.split(":")[0] for listener in found} == {"0100007F"}


def test_it_serves_the_viewer_and_nothing_else(address: tuple[str, int]) -> None:
    assert status(address, "/") == 200
    assert status(address, "/web_client.js") == 200
    for path in (
        "/../web_server.py",
        "/../../../../../../../../../../etc/passwd",
        "//etc/passwd",
        "/%2e%2e/messages.py",
    ):
        assert status(address, path) in (403, 404)


def test_uploads_other_sites_and_rebound_names_are_refused(address: tuple[str, int]) -> None:
    assert status(address, "/drop?sid=1") == 403
    assert status(address, "/", Host="evil.example:80") == 403
    assert status(address, "/model", Origin="https://evil.example") == 403
    url = f"ws://{address[0]}:{address[1]}/ui?sid=1"
    with pytest.raises(InvalidStatus):
        connect(url, origin="https://evil.example")  # type: ignore[arg-type]
    with connect(url, origin=f"http://{address[0]}:{address[1]}"):  # type: ignore[arg-type]
        pass


def test_a_taken_port_gets_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(UserError, match="--port 0"):
        open_web(load_world("open"), "ust10", "127.0.0.1", taken.getsockname()[1])


def test_when_the_host_is_public_any_name_may_be_typed_but_no_other_site_may_drive() -> None:
    class Asked:
        path = "/ui"

        def __init__(self, **headers: str) -> None:
            self.headers = headers

    public, private = Guard("0.0.0.0"), Guard("127.0.0.1")
    named: Any = Asked(Host="robot.lan:8080")
    assert public.refuses(named) is None
    assert private.refuses(named) is not None
    foreign: Any = Asked(Host="robot.lan:8080", Origin="http://evil.example")
    assert public.refuses(foreign) is not None


# --- a drive ---------------------------------------------------------------------------------------------------------


class Session:
    """`appli teleop` in a process of its own, and what it shows."""

    def __init__(self, folder: Path) -> None:
        self.log, self.out = folder / "log", folder / "out"
        world = folder / "plain.toml"
        world.write_text(PLAIN)
        self.process = subprocess.Popen(
            [sys.executable, "-c", MAIN, self.out, self.log, world], stderr=subprocess.PIPE, text=True
        )
        self.url = ""
        assert self.process.stderr is not None
        for line in self.process.stderr:  # "compiling ..." may come first
            if "http://" in line:
                self.url = next(word for word in line.split() if word.startswith("http://"))
                break

    def now(self) -> dict[str, Any]:
        """What was shown last."""
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        return dict(json.loads(lines[-1])) if lines else {}

    def slowest_picture(self, seconds: float) -> float:
        """[s] the longest that the page was silent during the next `seconds`."""
        longest, until = 0.0, time.monotonic() + seconds
        while time.monotonic() < until:
            with contextlib.suppress(json.JSONDecodeError):
                longest = max(longest, self.now()["quiet"])
            time.sleep(0.05)
        return longest

    def wait(self, condition: Callable[[dict[str, Any]], bool], seconds: float = 40.0) -> dict[str, Any]:
        """Until what is shown fulfils it."""
        deadline = time.monotonic() + seconds
        while True:
            with contextlib.suppress(json.JSONDecodeError):
                now = self.now()
                if now and condition(now):
                    return now
            assert self.process.poll() is None, "the session has ended"
            assert time.monotonic() < deadline, f"still {now}"
            time.sleep(0.05)


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    started = Session(tmp_path)
    yield started
    started.process.kill()
    started.process.communicate()


@pytest.mark.slow
@pytest.mark.skipif(chromium() is None, reason="no chromium here (apt-get install chromium)")
def test_a_whole_intervention_with_rewind_from_the_keyboard_of_a_browser(session: Session, tmp_path: Path) -> None:
    assert session.url.startswith("http://127.0.0.1:")
    assert {listener.split(":")[0] for listener in listeners(session.process.pid)} == {"0100007F"}
    assert session.now().get("index", 0) == 0  # it waits for somebody
    with page(session.url, tmp_path / "profile", size=(320, 240)) as browser:
        session.wait(lambda now: now["index"] > 60, 60.0)
        patience = time.monotonic() + 40.0  # the first pictures are slow anywhere
        while (slowest := session.slowest_picture(2.0)) > SLOW and time.monotonic() < patience:
            pass
        if slowest > SLOW:
            pytest.skip(f"too slow to drive: without a graphics card, this busy, a picture takes {slowest:.1f} s")
        browser.click(160, 120)

        browser.key("r", down=True)
        session.wait(lambda now: now["mode"] == "REWIND")
        browser.key("r", down=False)
        session.wait(lambda now: now["mode"] == "WAITING")
        browser.key("1", down=True)
        armed = session.wait(lambda now: now["label"] == "A1")  # a page sends what is down when it draws a picture
        assert armed["mode"] == "WAITING"
        browser.key("1", down=False)

        browser.key("w", down=True)
        moving = session.wait(lambda now: now["mode"] == "INTERVENTION" and now["v"] > 0.35)
        session.wait(lambda now: now["x"] > moving["x"] + 0.2)
        browser.key("w", down=False)
        session.wait(lambda now: abs(now["v"]) < 0.02)

        browser.key("Enter", down=True)
        session.wait(lambda now: now["saved"] == ["A1"])
        browser.key("Enter", down=False)
        browser.key("w", down=True)
        session.wait(lambda now: now["mode"] == "NUDGE" and now["v"] > 0.35)
    session.wait(lambda now: abs(now["v"]) < 0.02)  # the browser went away with the key down
    session.process.send_signal(signal.SIGTERM)
    assert session.process.wait(20) == 143
    (made,) = load_dataset(session.out)
    assert (made.label, made.metadata.source) == ("A1", "teleop")
    assert made.metadata.rewound > 0.0
    assert made.packed.actions[:, 0].max() == pytest.approx(0.4)
