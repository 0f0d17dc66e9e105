"""A surface without a person: timed key presses from a text file, for CI and for the docs.

One event per line, `SECONDS down|up|press KEY`, times not decreasing; `#` begins a comment:

    2.0 down w          # hold W from here ...
    3.5 up w            # ... to here
    4.0 press 1         # tap a key: down and up within one frame
    60  press q

Seconds count frames of 50 ms since the session began; they go on while the twin waits or is wound back. After its last
line the session is quit as with Q. Keys: w a s d up down left right shift space 1 2 3 r enter backspace q.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from scenarios.errors import UserError, blame
from scenarios.keyboard import KEYS, QUIT, Keys
from scenarios.teleop_view import View
from twin.simulation import TICK

LIMIT = 1 << 20  # bytes of a script
LONGEST = 3600.0  # [s] of a script


@dataclass(frozen=True, slots=True)
class KeyEvent:
    """One line of a script."""

    time: float  # [s] since the session began
    action: str  # "down", "up" or "press"
    key: str


def read_script(path: Path) -> tuple[KeyEvent, ...]:
    """The events of a script. Raises UserError with file and line."""
    with blame(f"cannot read the key script {path}"):
        with open(path, "rb") as file:
            content = file.read(LIMIT + 1)
        if len(content) > LIMIT:
            raise ValueError("too large for a key script")
        text = content.decode("utf-8")
    events: list[KeyEvent] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].lower().split()
        if words:
            try:
                events.append(_event(words, events[-1].time if events else 0.0))
            except ValueError as error:
                raise UserError(f"{path}:{number}: {error}") from None
    if not events:
        raise UserError(f"{path}: no key events; write lines such as '2.0 down w'")
    return tuple(events)


def _event(words: list[str], before: float) -> KeyEvent:
    if len(words) != 3:
        raise ValueError("expected 'SECONDS down|up|press KEY', such as '2.0 down w'")
    try:
        time = float(words[0])
    except ValueError:
        raise ValueError(f"{words[0]!r} is not a time in seconds") from None
    if not math.isfinite(time) or not before <= time <= LONGEST:
        raise ValueError(f"times must not decrease and lie between 0 and {LONGEST:.0f} s")
    if words[1] not in ("down", "up", "press"):
        raise ValueError(f"{words[1]!r} is none of down, up, press")
    if words[2] not in KEYS:
        raise ValueError(f"unknown key {words[2]!r}; there are {' '.join(sorted(KEYS))}")
    return KeyEvent(time, words[1], words[2])


class ScriptSurface:
    """Plays a script, one frame per poll."""

    def __init__(self, events: tuple[KeyEvent, ...]) -> None:
        """At the start of the script."""
        self._events = list(events)
        self._held: set[str] = set()
        self._frame = 0

    def poll(self) -> Keys:
        """The keys of the next frame; Q after the last line."""
        if not self._events:
            return Keys(pressed=(QUIT,))
        pressed: list[str] = []
        now = self._frame * TICK + 1e-9
        self._frame += 1
        while self._events and self._events[0].time <= now:
            event = self._events.pop(0)
            if event.action == "up":
                self._held.discard(event.key)
                continue
            pressed.append(event.key)
            if event.action == "down":
                self._held.add(event.key)
        return Keys(frozenset(self._held), tuple(pressed))

    def draw(self, view: View) -> None:
        """Nobody looks."""

    def close(self) -> None:
        """Nothing to give back."""
