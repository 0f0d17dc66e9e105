"""Rewinding: a tape of the last seconds of a closed loop that can be wound back to any tick, exactly.

A full state holds two 800 x 800 maps, so the tape keeps one per second and, for the ticks in between, only the
commands of the person, if any. To reach a tick it restores the state before it and drives the few ticks again, which
gives the same bits because the loop is deterministic.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

from twin.records import Command, Tick
from twin.rollout import Loop, LoopState
from twin.simulation import TICK

KEYFRAME = 20  # ticks between full states


class Tape:
    """Steps a loop and remembers how to get back."""

    def __init__(self, loop: Loop, seconds: float = 30.0) -> None:
        """Keep at least the last `seconds` of the drive; about 1.4 MB for each of them."""
        self.loop = loop
        self._keyframes: deque[LoopState] = deque(maxlen=int(seconds / TICK) // KEYFRAME + 2)
        self._overrides: dict[int, Command | None] = {}  # by tick
        self._next = 0

    @property
    def oldest(self) -> int:
        """The earliest tick that can be wound back to."""
        return self._keyframes[0].index if self._keyframes else self._next

    @property
    def position(self) -> int:
        """The index of the next tick."""
        return self._next

    def step(self, override: Command | None = None) -> Tick:
        """One tick of the loop."""
        if not self._keyframes or self._next - self._keyframes[-1].index >= KEYFRAME:
            self._keyframes.append(self.loop.save())
            self._overrides = {k: c for k, c in self._overrides.items() if k >= self.oldest}
        self._overrides[self._next] = override
        tick = self.loop.step(override)
        self._next = tick.index + 1
        return tick

    def rewind(self, index: int) -> None:
        """Wind back to just before tick `index`; later ticks are forgotten. ValueError if the tape does not reach."""
        if not self.oldest <= index <= self._next:
            raise ValueError(f"tick {index} is not on the tape, which holds {self.oldest} to {self._next}")
        if index == self._next:
            return
        while self._keyframes[-1].index > index:
            self._keyframes.pop()
        self.loop.restore(self._keyframes[-1])
        for k in range(self._keyframes[-1].index, index):
            self.loop.step(self._overrides[k])
        self._overrides = {k: c for k, c in self._overrides.items() if k < index}
        self._next = index

    @contextmanager
    def excursion(self, index: int) -> Iterator[None]:
        """Wind back to `index`, drive anew inside the `with`, and return afterwards as if nothing had been."""
        state, keyframes, overrides, position = self.loop.save(), self._keyframes.copy(), self._overrides, self._next
        self.rewind(index)
        try:
            yield
        finally:
            self.loop.restore(state)
            self._keyframes, self._overrides, self._next = keyframes, overrides, position
