"""Rerun's viewer as a process of its own: a window, or a page that only this machine can open."""

from __future__ import annotations

import contextlib
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from urllib.parse import quote

import rerun_cli  # type: ignore[import-untyped]

LOOPBACK = "127.0.0.1"  # Rerun's own default is 0.0.0.0: everybody on the network
ANSI = r"\x1b\[[0-9;]*m"  # colours in what it says
PATIENCE = 30.0  # [s] for the viewer to start


class ViewerError(RuntimeError):
    """The viewer cannot be shown; the message is one line that says why and what to do instead."""


class Viewer:
    """A running viewer. A context manager; leaving it ends a page, but leaves a window to the person who looks at it.

    `url` is where a recorder sends what it records; `page` is the address for a browser, None for a window.
    """

    def __init__(self, files: Sequence[Path] = (), web: bool = False, port: int = 0) -> None:
        """Show `files`, or wait for a recorder. `port`: of the page; 0 takes a free one. Raises ViewerError."""
        if not web and not has_display():
            raise ViewerError("no display to open a window on")
        if not _is_free(port):
            raise ViewerError(f"port {port} is taken")  # Rerun would take another one, and not say so
        self._web = web
        grpc, http = _free_port(), port or _free_port()
        self.url = f"rerun+http://{LOOPBACK}:{grpc}/proxy"
        self.page = f"http://{LOOPBACK}:{http}/?url={quote(self.url, safe='')}" if web else None
        command = [viewer_program(), *map(str, files), "--bind", LOOPBACK, "--port", str(grpc)]
        command += ["--serve-web", "--web-viewer-port", str(http)] if web else ["--hide-welcome-screen"]
        if not files and not web:
            command.append("--expect-data-soon")
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 (not a pipe: a window outlives us)
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._said,
            env=os.environ | {"RUST_LOG": "error"},
            start_new_session=True,  # Ctrl-C is ours to answer
        )
        self._wait_for(http if web else grpc)

    def __enter__(self) -> Viewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._web or error is not None:
            self.close()

    def wait(self) -> None:
        """Until the window is closed; a page is served until an interrupt. Raises ViewerError when it fails."""
        if self._process.wait() != 0:
            raise ViewerError(self._reason())

    def close(self) -> None:
        """End the viewer."""
        self._process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(5.0)
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    def _wait_for(self, port: int) -> None:
        """Until it listens."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            if self._process.poll() is not None:
                raise ViewerError(self._reason())
            with contextlib.suppress(OSError), socket.create_connection((LOOPBACK, port), timeout=1.0):
                return
            time.sleep(0.05)
        self.close()
        raise ViewerError(f"the viewer does not start within {PATIENCE:.0f} s")

    def _reason(self) -> str:
        """The last thing that the viewer said, in one line."""
        self._said.seek(0)
        lines = [line.strip() for line in self._said.read().decode(errors="replace").splitlines() if line.strip()]
        return f"the viewer ended: {re.sub(ANSI, '', lines[-1])}" if lines else "the viewer ended at once"


def has_display() -> bool:
    """Whether there is a screen to open a window on."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def viewer_program() -> str:
    """The viewer that comes with the package, not whichever `rerun` is found first."""
    folder = Path(rerun_cli.__file__).parent
    bundled = folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun"
    return str(bundled if bundled.exists() else folder / "rerun")


def _free_port() -> int:
    with socket.socket() as listener:
        listener.bind((LOOPBACK, 0))
        return int(listener.getsockname()[1])


def _is_free(port: int) -> bool:
    """Whether a port can be listened on; 0 stands for any."""
    with socket.socket() as listener, contextlib.suppress(OSError):
        listener.bind((LOOPBACK, port))
        return True
    return False
