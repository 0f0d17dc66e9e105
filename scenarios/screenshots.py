"""Pictures of recordings as the viewer shows them, on machines without a screen too.

Where there is no display a virtual one is used: Xvfb, and Mesa's software Vulkan (`xvfb mesa-vulkan-drivers`).
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from PIL import Image

from twin.recording.viewer import has_display, viewer_program

SIZE = (1600, 900)  # [px]
SCALE = 2  # the viewer draws that much larger, which is averaged: thin lines stay lines
PATIENCE = 300.0  # [s]
COLOURS = 255  # of the palette; a picture takes a quarter of the room then


def screenshot(rrd: Path, png: Path, size: tuple[int, int] = SIZE) -> str | None:
    """Write what the viewer shows of `rrd` when it has just opened it. None, or the reason why there is no picture."""
    with tempfile.TemporaryDirectory() as folder:
        large = Path(folder) / "large.png"
        # The pointer rests in the middle of the screen, which must not be within the window: things would be hovered.
        screen = f"{2 * SCALE * size[0] + 100}x{2 * SCALE * size[1] + 100}x24"
        command = [viewer_program(), str(rrd), "--bind", "127.0.0.1", "--port", "auto"]
        command += ["--screenshot-to", str(large), "--window-size", f"{size[0]}x{size[1]}"]
        if not has_display():
            if shutil.which("xvfb-run") is None:
                return "no display, and no xvfb-run (apt-get install xvfb mesa-vulkan-drivers)"
            command = ["xvfb-run", "-a", "-s", f"-screen 0 {screen}", *command]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
        except subprocess.TimeoutExpired:
            return f"the viewer took longer than {PATIENCE:.0f} s"
        if not large.is_file():
            said = [line.strip() for line in done.stderr.splitlines() if line.strip()]
            return f"the viewer gave no picture: {said[-1] if said else 'it said nothing'}"
        with Image.open(large) as image:
            small = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
        palette = small.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
        palette.save(png, optimize=True)
    return None
