"""Recordings as the viewer shows them when it has just opened them."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

WORLD = "training"


class CannotShowError(Exception):
    """There is no viewer, or nothing for it to draw with; the text says what is missing."""


def recording(policy: Path) -> bytes:
    """APPLI on `training`, seed 0, recorded as users do. Raises CannotShowError."""
    with tempfile.TemporaryDirectory() as folder:
        return _shown(_drive(str(policy), Path(folder)))


def comparison(policy: Path) -> bytes:
    """The default planner and APPLI on `training`, seed 0, side by side. Raises CannotShowError."""
    from twin.recording import write_comparison

    with tempfile.TemporaryDirectory() as folder:
        both = Path(folder) / "both.rrd"
        write_comparison(_drive("dwa", Path(folder)), _drive(str(policy), Path(folder)), both)
        return _shown(both)


def rewind() -> bytes:
    """An intervention of type A on `training`, seed 0: failure, rewind, demonstration. Raises CannotShowError."""
    with tempfile.TemporaryDirectory() as folder:
        _appli("collect", WORLD, "--sessions", "1", "--record", "--out", folder)
        return _shown(min(Path(folder).glob("A*.rrd")))


def _drive(driver: str, folder: Path) -> Path:
    rrd = folder / f"{Path(driver).stem}.rrd"
    _appli("run", WORLD, "--driver", driver, "--record", str(rrd))
    return rrd


def _appli(*arguments: str) -> None:
    command = [sys.executable, "-m", "scenarios", *arguments]
    # Exit code 1: recorded, but did not arrive.
    subprocess.run(command, stdout=subprocess.DEVNULL, check=False)


def _shown(rrd: Path) -> bytes:
    from scenarios.screenshots import screenshot

    png = rrd.with_suffix(".png")
    if (reason := screenshot(rrd, png)) is not None:
        raise CannotShowError(reason)
    return png.read_bytes()
