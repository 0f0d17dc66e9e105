"""One key map for every surface, and how held keys become a velocity: pure values, no devices.

Keys go by lower-case names: the letters and digits themselves, and up, down, left, right, shift, space, enter,
backspace. A surface says which are held and which were pressed since it was last asked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from learning.interventions import Kind
from twin.records import Command, Twist2

SPEED: Final = 0.4  # [m/s] teleop_ps4.yaml, scale_linear
TURBO_SPEED: Final = 2.0  # [m/s] teleop_ps4.yaml, scale_linear_turbo
TURN: Final = 1.4  # [rad/s] teleop_ps4.yaml, scale_angular
HOLD: Final = 0.5  # [s] twist_mux.yaml, time-out of the joystick

# A key is on or off where a joystick's stick has a way in between, so the keyboard's stick moves at a finite rate.
SPEED_RISE: Final = 1.2  # [m/s2] our choice: 0.4 m/s after a third of a second
SPEED_FALL: Final = 2.0  # [m/s2] our choice: from turbo to rest in a second
TURN_RISE: Final = 4.0  # [rad/s2] our choice
TURN_FALL: Final = 6.0  # [rad/s2] our choice

FORWARD: Final = frozenset({"w", "up"})
BACK: Final = frozenset({"s", "down"})
LEFT: Final = frozenset({"a", "left"})
RIGHT: Final = frozenset({"d", "right"})
TURBO: Final = "shift"
STOP: Final = "space"
DRIVING: Final = FORWARD | BACK | LEFT | RIGHT | {STOP}
REWIND: Final = "r"
SAVE: Final = "enter"
DISCARD: Final = "backspace"
QUIT: Final = "q"
KINDS: Final[dict[str, Kind]] = {"1": "A", "2": "B", "3": "D"}
CAMERA: Final = "c"  # web and window only
KEYS: Final = DRIVING | {TURBO, REWIND, SAVE, DISCARD, QUIT, CAMERA} | KINDS.keys()

KEY_HELP: Final = (  # (key, what it does), in the order of a drive
    ("W S / up down", "forward, back"),
    ("A D / left right", "turn"),
    ("Shift", "turbo, with the above"),
    ("Space", "stop"),
    ("R (hold)", "rewind; Shift: faster"),
    ("1", "intervene: type A, it failed"),
    ("2", "intervene: type B, could be better"),
    ("3", "show: type D, the default is fine"),
    ("Enter", "save, hand back to the planner"),
    ("Backspace", "discard this intervention"),
    ("Q", "save and quit"),
)


@dataclass(frozen=True, slots=True)
class Keys:
    """What a surface saw since it was last asked."""

    held: frozenset[str] = frozenset()
    pressed: tuple[str, ...] = ()  # in order; a key that was tapped and let go may be here without being held
    lost: bool = False  # nobody can be at the keys: the page is gone, hidden, or not there yet

    @property
    def driving(self) -> bool:
        """Whether a person wants to move, or to stop, the robot."""
        return bool(DRIVING & self.held) or not DRIVING.isdisjoint(self.pressed)


@dataclass(frozen=True, slots=True)
class Stick:
    """Where the keyboard's imaginary joystick stands, as the velocity that it commands."""

    v: float = 0.0  # [m/s]
    w: float = 0.0  # [rad/s]

    @staticmethod
    def matching(twist: Twist2) -> Stick:
        """The stick that goes on as the robot moves now (base_link), so that taking over does not jerk."""
        return Stick(min(max(twist.v, -TURBO_SPEED), TURBO_SPEED), min(max(twist.w, -TURN), TURN))

    @property
    def command(self) -> Command:
        """What the base is told."""
        return Command(self.v, self.w)

    @property
    def at_rest(self) -> bool:
        """Whether it stands in the middle."""
        return self.v == 0.0 and self.w == 0.0

    def advance(self, keys: Keys, period: float) -> Stick:
        """Where it stands `period` seconds later; a released axis goes back to the middle."""
        if STOP in keys.held or STOP in keys.pressed:
            return Stick()
        down = keys.held | set(keys.pressed)
        top = TURBO_SPEED if TURBO in down else SPEED
        ahead = bool(FORWARD & down) - bool(BACK & down)
        turning = bool(LEFT & down) - bool(RIGHT & down)
        return Stick(
            _towards(self.v, ahead * top, SPEED_RISE * period, SPEED_FALL * period),
            _towards(self.w, turning * TURN, TURN_RISE * period, TURN_FALL * period),
        )


def _towards(value: float, target: float, rise: float, fall: float) -> float:
    """`value` moved to `target` by at most `rise` away from zero and at most `fall` towards it."""
    speeding_up = value * target >= 0.0 and abs(target) > abs(value)
    limit = rise if speeding_up else fall
    if abs(target - value) <= limit:
        return target
    moved = value + math.copysign(limit, target - value)
    return 0.0 if moved * value < 0.0 else moved  # through the middle, not past it


@dataclass
class HeldByRepeat:
    """Guesses which keys are held from a terminal, which tells of presses and of auto-repeat but not of releases.

    A key counts as held for HOLD seconds after its last sign: this is the dead-man switch. A terminal repeats only the
    key that went down last, so a key that was fresh when another went down lives on as long as that one repeats: hold
    W, then D as well, and the robot drives a bend.
    """

    fresh: float = 0.15  # [s] longer than the repeat period of keyboards, shorter than a change of mind
    _seen: dict[str, float] = field(default_factory=dict)  # [s] the last sign of each key
    _carried: dict[str, frozenset[str]] = field(default_factory=dict)  # keys that live on with it

    def press(self, key: str, now: float) -> None:
        """A sign of `key` at time `now` [s], any clock that does not jump."""
        held = self.held(now)
        if key not in held:
            self._carried[key] = frozenset(k for k in held if now - self._seen[k] <= self.fresh and k in DRIVING)
        for other in {key} | (self._carried[key] & held):
            self._seen[other] = now

    def held(self, now: float) -> frozenset[str]:
        """The keys that count as held at time `now` [s]."""
        return frozenset(key for key, seen in self._seen.items() if now - seen < HOLD)

    def release(self, key: str) -> None:
        """Forget a key, e.g. turbo when a driving key comes without it."""
        self._seen.pop(key, None)
