"""The terminal surface: its pure parts, and a whole session in a pseudo-terminal."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from learning.interventions import load_dataset
from scenarios.keyboard import HOLD, HeldByRepeat
from scenarios.surfaces.terminal import CHARACTERS, ENTER, LEAVE, SEQUENCES, parse_keys

MAIN = """
import sys
from pathlib import Path
from scenarios.errors import UserError
from scenarios.teleop import teleop_command
try:
    sys.exit(teleop_command("open", Path(sys.argv[1]), "terminal"))
except UserError as error:
    print(error, file=sys.stderr)
    sys.exit(2)
"""
FIRST_PICTURE = 240.0  # [s] the planner may have to be compiled first


# --- keys ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        ("w", [("w", False)]),
        ("W", [("w", True)]),
        ("\x1b[A\x1b[D", [("up", False), ("left", False)]),
        ("\x1bOB", [("down", False)]),
        ("\x1b[1;2A", [("up", True)]),
        ("\r \x7f1", [("enter", False), ("space", False), ("backspace", False), ("1", False)]),
        ("\x1b[15~x\x1b[3;5~zw", [("w", False)]),  # F5, x, Ctrl-Delete, z: none of ours
        ("\x1bw", [("w", False)]),  # Escape, then w
    ],
)
def test_what_a_terminal_sends(text: str, keys: list[tuple[str, bool]]) -> None:
    assert parse_keys(text) == (keys, "")


@given(st.lists(st.sampled_from([*SEQUENCES, *CHARACTERS, *"wasdr123q", "\x1b[15~", "\x1b[1;5C"])), st.data())
def test_cutting_the_stream_anywhere_changes_nothing(pieces: list[str], data: st.DataObject) -> None:
    text = "".join(pieces)
    whole, rest = parse_keys(text)
    cut = data.draw(st.integers(0, len(text)))
    before, tail = parse_keys(text[:cut])
    after, end = parse_keys(tail + text[cut:])
    assert (before + after, end) == (whole, rest)


def test_a_key_is_held_for_half_a_second_after_its_last_sign() -> None:
    hold = HeldByRepeat()
    for k in range(10):
        hold.press("w", 0.04 * k)
    assert hold.held(0.36 + HOLD - 0.01) == {"w"}
    assert hold.held(0.36 + HOLD) == set()


def test_a_key_that_stopped_repeating_lives_on_with_the_one_that_interrupted_it() -> None:
    hold = HeldByRepeat()
    hold.press("w", 0.0)
    hold.press("w", 0.4)
    for k in range(50):  # d goes down while w is down: from now on only d repeats
        hold.press("d", 0.45 + 0.04 * k)
    assert hold.held(2.45) == {"w", "d"}
    assert hold.held(2.45 + HOLD) == set()


def test_a_key_let_go_before_the_next_went_down_does_not_live_on() -> None:
    hold = HeldByRepeat()
    hold.press("w", 0.0)
    for k in range(50):
        hold.press("d", 0.3 + 0.04 * k)
    assert hold.held(2.3) == {"d"}


# --- a session in a pseudo-terminal ----------------------------------------------------------------------------------


class Terminal:
    """A session on the far side of a pseudo-terminal."""

    def __init__(self, out: Path) -> None:
        self.master, self.slave = pty.openpty()
        termios.tcsetwinsize(self.slave, (30, 100))
        self.before = termios.tcgetattr(self.slave)
        command = [sys.executable, "-c", MAIN, str(out)]
        self.process = subprocess.Popen(command, stdin=self.slave, stdout=self.slave, stderr=subprocess.PIPE)
        self.seen = ""

    def read(self) -> None:
        """Take what the session has written."""
        while select.select([self.master], [], [], 0.02)[0]:
            self.seen += os.read(self.master, 65536).decode("utf-8", "replace")

    def wait_for(self, text: str, seconds: float) -> None:
        """Until it is on the screen, as last drawn."""
        deadline = time.monotonic() + seconds
        while text not in self.seen[-9000:]:
            assert self.process.poll() is None, self.process.communicate()[1].decode()
            assert time.monotonic() < deadline, f"never saw {text!r} in {self.seen[-3000:]!r}"
            self.read()

    def hold(self, key: str, seconds: float) -> None:
        """Auto-repeat a key as a keyboard does."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            os.write(self.master, key.encode())
            self.read()
            time.sleep(0.02)

    def finish(self) -> int:
        """Read on until it has ended."""
        deadline = time.monotonic() + 30.0
        while self.process.poll() is None:
            self.read()
            assert time.monotonic() < deadline, "the session does not end"
        self.read()
        return self.process.returncode

    @property
    def restored(self) -> bool:
        """Whether the terminal is as it was."""
        return termios.tcgetattr(self.slave) == self.before and self.seen.rindex(LEAVE) > self.seen.rindex(ENTER)


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    shown = Terminal(tmp_path / "out")
    yield shown
    with contextlib.suppress(ProcessLookupError):
        shown.process.kill()
    shown.process.communicate()
    os.close(shown.master)
    os.close(shown.slave)


def test_a_whole_intervention_with_rewind(terminal: Terminal, tmp_path: Path) -> None:
    terminal.wait_for("THE PLANNER DRIVES", FIRST_PICTURE)
    terminal.wait_for("~", 10.0)  # its path
    terminal.hold("r", 0.4)
    terminal.wait_for("REWINDING", 5.0)
    terminal.wait_for("THE TWIN WAITS", 5.0)
    terminal.hold("1", 0.05)
    terminal.hold("w", 1.5)
    terminal.wait_for("YOU DRIVE, RECORDING", 5.0)
    terminal.wait_for("+0.4", 5.0)  # [m/s]
    terminal.wait_for("+0.00 m/s", 5.0)  # let go, and it stops
    os.write(terminal.master, b"\r")
    terminal.wait_for("A1 saved", 10.0)
    os.write(terminal.master, b"q")
    assert terminal.finish() == 0
    assert terminal.restored
    (made,) = load_dataset(tmp_path / "out")
    assert (made.kind, made.label, made.metadata.source) == ("A", "A1", "teleop")
    assert made.metadata.rewound > 0.0
    assert made.packed.actions[:, 0].max() == pytest.approx(0.4)
    assert made.packed.actions[-1].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 1), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_the_terminal_is_given_back_when_told_to_stop(
    terminal: Terminal, number: int, code: int, tmp_path: Path
) -> None:
    terminal.wait_for("THE PLANNER DRIVES", FIRST_PICTURE)
    terminal.hold("1", 0.1)
    terminal.wait_for("YOU DRIVE, RECORDING", 5.0)
    terminal.process.send_signal(number)
    ended = terminal.finish()
    assert ended in (code, -number)  # a bare Python says of SIGINT that it died of it; `appli` says 130
    assert terminal.restored
    assert list((tmp_path / "out").iterdir()) == []


def test_without_a_terminal_there_is_one_line(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", MAIN, str(tmp_path)], stdin=subprocess.DEVNULL, capture_output=True)
    assert done.returncode == 2
    assert len(done.stderr.decode().strip().splitlines()) == 1
    assert b"--surface web" in done.stderr
