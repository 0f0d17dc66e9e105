"""`make pictures`: the pictures of docs/, all or those that are named, as in `make pictures ONLY="robot drive"`."""

from __future__ import annotations

import argparse
import io
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

from PIL import Image

from scenarios.pictures.animation import animation
from scenarios.pictures.intervention import intervention
from scenarios.pictures.recording import CannotShowError, comparison, recording, rewind
from scenarios.pictures.worlds import barn, course, robot

POLICY = Path("results/policies/A+B+c.safetensors")


def png(image: Image.Image) -> bytes:
    """As a PNG file."""
    data = io.BytesIO()
    image.save(data, "PNG", optimize=True)
    return data.getvalue()


PICTURES: dict[str, Callable[[], bytes]] = {
    "robot.png": lambda: png(robot()),
    "training.png": lambda: png(course("training")),
    "unseen.png": lambda: png(course("unseen")),
    "barn_world.png": lambda: png(barn()),
    "intervention.png": lambda: png(intervention()),
    "drive.webp": lambda: animation(POLICY),
    "recording.png": lambda: recording(POLICY),
    "comparison.png": lambda: comparison(POLICY),
    "rewind.png": rewind,
}


def main() -> int:
    """Exit code 0 once all is made; every file is replaced at once or not at all."""
    parser = argparse.ArgumentParser(prog="python -m scenarios.pictures", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", metavar="NAME")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - {Path(name).stem for name in PICTURES}:
        parser.error(f"no picture is called {', '.join(sorted(unknown))}; there are {', '.join(PICTURES)}")
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for name, make in PICTURES.items():
        if arguments.names and Path(name).stem not in arguments.names:
            continue
        began = time.perf_counter()
        part = arguments.folder / f".{name}.part"
        try:
            part.write_bytes(make())
        except CannotShowError as reason:
            print(f"{name}: left as it is: {reason}", file=sys.stderr, flush=True)
            continue
        os.replace(part, arguments.folder / name)
        size = (arguments.folder / name).stat().st_size / 1000
        print(f"{name}: {size:.0f} kB, {time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
