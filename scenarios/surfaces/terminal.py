"""A raw terminal as a teleop surface, also over SSH: keys in, a picture of text out.

A terminal tells of presses and of auto-repeat, never of releases; `HeldByRepeat` makes held keys of that, and a link
that dies stops the robot after HOLD seconds. Whatever ends the session, the terminal gets its old mode and screen back.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import re
import select
import shutil
import sys
import termios
import time
import tty
from typing import Any, Final

from scenarios.errors import UserError
from scenarios.keyboard import DRIVING, KEYS, QUIT, TURBO, HeldByRepeat, Keys
from scenarios.surfaces.terminal_map import Chart, picture
from scenarios.teleop_view import View
from twin.world import World

PERIOD: Final = 0.1  # [s] between pictures: enough to drive by, little enough for a slow link
ENTER: Final = "\x1b[?1049h\x1b[?25l\x1b[2J"  # the other screen, no cursor
LEAVE: Final = "\x1b[0m\x1b[?25h\x1b[?1049l"
ARROWS: Final = {"A": "up", "B": "down", "C": "right", "D": "left"}
SEQUENCES: Final = {  # what keys send that have no character; CSI 1;2 X is with Shift
    **{f"\x1b{intro}{letter}": (name, False) for letter, name in ARROWS.items() for intro in "[O"},
    **{f"\x1b[1;2{letter}": (name, True) for letter, name in ARROWS.items()},
}
UNFINISHED: Final = re.compile(r"\x1b([\[O][0-9;]*)?\Z")
OTHER: Final = re.compile(r"\x1b(\[[0-9;?]*[ -/]*[@-~]|O[@-~])?")
CHARACTERS: Final = {" ": "space", "\r": "enter", "\n": "enter", "\x7f": "backspace", "\x08": "backspace"}


def parse_keys(text: str) -> tuple[list[tuple[str, bool]], str]:
    """(key, with Shift) of what a terminal sent, and the beginning of a sequence whose end is still to come.

    What is no key of ours is left out.
    """
    found: list[tuple[str, bool]] = []
    rest = UNFINISHED.search(text)
    text, tail = (text, "") if rest is None else (text[: rest.start()], rest.group())
    while text:
        sequence = next((s for s in SEQUENCES if text.startswith(s)), None)
        other = OTHER.match(text)
        if sequence is not None:
            found.append(SEQUENCES[sequence])
            text = text[len(sequence) :]
        elif other is not None:
            text = text[other.end() :]
        else:
            key = CHARACTERS.get(text[0], text[0].lower())
            if key in KEYS:
                found.append((key, text[0].isupper()))
            text = text[1:]
    return found, tail


class TerminalSurface:
    """Owns the terminal from `open` to `close`."""

    def __init__(self, world: World, source: int, sink: int) -> None:
        """Take over the terminal behind two file descriptors."""
        self._source, self._sink = source, sink
        self._chart = Chart.of(world)
        self._hold = HeldByRepeat()
        self._next_picture = 0.0
        self._size = (0, 0)
        self._gone = False
        self._tail = ""
        self._before: list[Any] | None = termios.tcgetattr(source)
        atexit.register(self.close)
        tty.setcbreak(source)  # Ctrl-C still interrupts
        mode = termios.tcgetattr(source)
        mode[6][termios.VSUSP] = b"\x00"  # Ctrl-Z would leave the terminal to the shell in this state
        termios.tcsetattr(source, termios.TCSANOW, mode)
        self._write(ENTER)

    @staticmethod
    def open(world: World) -> TerminalSurface:
        """On this process's terminal. UserError when there is none."""
        if not (sys.stdin.isatty() and sys.stdout.isatty()):
            raise UserError("--surface terminal needs a terminal for input and output; or use --surface web, or --keys")
        sys.stdout.flush()
        return TerminalSurface(world, sys.stdin.fileno(), sys.stdout.fileno())

    def poll(self) -> Keys:
        """What was typed since the last call, and what therefore counts as held."""
        now = time.monotonic()
        pressed: list[str] = []
        typed, self._tail = parse_keys(self._tail + self._read())
        for key, shifted in typed:
            if key not in self._hold.held(now):  # else it is the auto-repeat
                pressed.append(key)
            if shifted:
                self._hold.press(TURBO, now)
            elif key in DRIVING:
                self._hold.release(TURBO)
            self._hold.press(key, now)
        return Keys(self._hold.held(now), (*pressed, QUIT) if self._gone else tuple(pressed))

    def draw(self, view: View) -> None:
        """A new picture ten times a second."""
        now = time.monotonic()
        if now < self._next_picture:
            return
        self._next_picture = now + PERIOD
        size = shutil.get_terminal_size()
        with contextlib.suppress(OSError):
            size = os.get_terminal_size(self._sink)
        wipe = "" if size == self._size else "\x1b[2J"
        self._size = (size.columns, size.lines)
        lines = picture(view, self._chart, size.columns, size.lines)
        self._write(wipe + "\x1b[H" + "\x1b[K\r\n".join(lines) + "\x1b[K\x1b[J")

    def close(self) -> None:
        """The terminal as it was."""
        before, self._before = self._before, None
        if before is not None:
            atexit.unregister(self.close)
            with contextlib.suppress(OSError, termios.error):  # it may have hung up
                self._write(LEAVE)
                termios.tcsetattr(self._source, termios.TCSAFLUSH, before)

    def _read(self) -> str:
        """All that waits, without waiting."""
        content = b""
        while not self._gone and select.select([self._source], [], [], 0.0)[0]:
            try:
                piece = os.read(self._source, 4096)
            except OSError:
                piece = b""
            self._gone = not piece  # hung up
            content += piece
        return content.decode("utf-8", "ignore")

    def _write(self, text: str) -> None:
        """All of it, unless the terminal is gone."""
        content = memoryview(text.encode("utf-8", "replace"))
        try:
            while content:
                content = content[os.write(self._sink, content) :]
        except OSError:
            self._gone = True
