"""`appli view`: recordings in Rerun's viewer, in a window or as a page, one or two side by side."""

from __future__ import annotations

import contextlib
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from scenarios.errors import UserError, blame
from twin.recording import Recording, RecordingError, Viewer, ViewerError, read_recording, write_comparison


def view_command(recordings: tuple[Path, ...], compare: bool, web: bool, port: int) -> int:
    """Show one recording, or two side by side, until the window is closed or Ctrl-C."""
    wanted = 2 if compare else 1
    if len(recordings) != wanted:
        example = "--compare a.rrd b.rrd" if compare or len(recordings) == 2 else "run.rrd"
        shows = "two recordings" if compare else "one recording"
        raise UserError(f"view shows {shows}, not {len(recordings)}; try: appli view {example}")
    if not 0 <= port <= 65535:
        raise UserError(f"--port must be 0 to 65535, not {port}")
    if port and not web:
        raise UserError("--port goes with --web")
    for path in recordings:
        check(path)
    with contextlib.ExitStack() as stack:
        shown = recordings[0]
        if compare:
            shown = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="appli-"))) / "comparison.rrd"
            with blame():
                write_comparison(recordings[0], recordings[1], shown)
        with open_viewer(web, port, [shown]) as viewer:
            with contextlib.suppress(KeyboardInterrupt):  # the way to end a page
                viewer.wait()
            viewer.close()
    return 0


@contextlib.contextmanager
def open_viewer(web: bool, port: int = 0, files: Sequence[Path] = ()) -> Iterator[Viewer]:
    """A viewer, and where its page is. Raises UserError when it cannot be shown: that says what else there is."""
    try:
        with Viewer(files, web, port) as viewer:
            if viewer.page is not None:
                print(
                    f"appli: open {viewer.page}\n       (this machine only; Ctrl-C ends it)",
                    file=sys.stderr,
                    flush=True,
                )
            yield viewer
    except ViewerError as error:
        hint = "try another --port, or none" if port else "try again" if web else "try it with --web"
        raise UserError(f"{error}; {hint}") from error


def stay(viewer: Viewer) -> None:
    """After a run: a window stays by itself, a page until Ctrl-C."""
    if viewer.page is not None:
        _say("the page stays until Ctrl-C")
        with contextlib.suppress(KeyboardInterrupt):
            viewer.wait()


def check(path: Path) -> Recording:
    """Read a recording before it is shown: the viewer would open a window and only then complain. Raises UserError."""
    try:
        recording = read_recording(path)
    except RecordingError as error:
        raise UserError(f"{error}; record one with: appli run training --record run.rrd") from error
    if "world" not in recording.metadata:
        raise UserError(f"{path} is not a recording of appli; record one with: appli run training --record run.rrd")
    return recording


def _say(text: str) -> None:
    print(f"appli: {text}", file=sys.stderr, flush=True)
