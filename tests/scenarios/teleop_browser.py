"""A headless Chromium with real key presses, over its DevTools protocol."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run",
    "--disable-background-timer-throttling", "--disable-backgrounding-occluded-windows",
    "--disable-renderer-backgrounding", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--remote-debugging-port=0",
)  # fmt: skip
CODES = {" ": "Space", "Enter": "Enter", "Backspace": "Backspace", "Shift": "ShiftLeft"}
VIRTUAL = {"Enter": 13, "Backspace": 8, "Shift": 16}


def chromium() -> str | None:
    """Its path, or None."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Page:
    """One page of the browser."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection, self._id = connection, 0

    def send(self, method: str, **params: Any) -> None:
        """A DevTools call without waiting: input is answered only after the page's next picture."""
        self._id += 1
        self._connection.send(json.dumps({"id": self._id, "method": method, "params": params}))

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """One DevTools call and its result."""
        self.send(method, **params)
        while True:
            answer = json.loads(self._connection.recv(timeout=60.0))
            if answer.get("id") == self._id:
                return dict(answer.get("result", {}))

    def click(self, x: int = 700, y: int = 500) -> None:
        """A left click, which gives the page the keyboard."""
        for kind in ("mousePressed", "mouseReleased"):
            self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def key(self, key: str, down: bool) -> None:
        """A key goes down or up, named as in KeyboardEvent.key."""
        code = CODES.get(key) or (f"Digit{key}" if key.isdigit() else f"Key{key.upper()}")
        params: dict[str, Any] = {
            "key": key,
            "code": code,
            "windowsVirtualKeyCode": VIRTUAL.get(key, ord(key.upper()[0])),
        }
        if down and len(key) == 1:
            params["text"] = key
        self.send("Input.dispatchKeyEvent", type="keyDown" if down else "keyUp", **params)

    def hold(self, key: str, seconds: float) -> None:
        """Press, wait, release."""
        self.key(key, down=True)
        time.sleep(seconds)
        self.key(key, down=False)

    def screenshot(self, path: Path) -> None:
        """A PNG of what the page shows."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))


@contextmanager
def page(url: str, profile: Path, size: tuple[int, int] = (1280, 800)) -> Iterator[Page]:
    """Open `url` in a fresh browser."""
    command = [chromium() or "chromium", *FLAGS, f"--window-size={size[0]},{size[1]}", f"--user-data-dir={profile}"]
    browser = subprocess.Popen([*command, "about:blank"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        port_file = profile / "DevToolsActivePort"
        deadline = time.monotonic() + 30.0
        while not (port_file.is_file() and port_file.read_text().count("\n")):
            assert time.monotonic() < deadline, "chromium does not start"
            time.sleep(0.1)
        port, path = port_file.read_text().split()[:2]
        with connect(f"ws://127.0.0.1:{port}{path}", max_size=None) as root:
            target = Page(root).call("Target.createTarget", url=url)["targetId"]
            with connect(f"ws://127.0.0.1:{port}/devtools/page/{target}", max_size=None) as connection:
                shown = Page(connection)
                shown.call("Page.bringToFront")  # a page behind another draws next to nothing
                yield shown
    finally:
        browser.terminate()
        browser.wait(10)
