"""A recording as the viewer shows it when it has just opened it."""

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
    from scenarios.screenshots import screenshot

    with tempfile.TemporaryDirectory() as folder:
        rrd, png = Path(folder) / "drive.rrd", Path(folder) / "drive.png"
        run = [sys.executable, "-m", "scenarios", "run", WORLD, "--driver", str(policy), "--record", str(rrd)]
        subprocess.run(run, stdout=subprocess.DEVNULL, check=False)  # exit code 1: recorded, but did not arrive
        if (reason := screenshot(rrd, png)) is not None:
            raise CannotShowError(reason)
        return png.read_bytes()
