"""How a sweep is going: a bar in a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections import Counter, deque
from collections.abc import Callable
from types import TracebackType
from typing import Self, TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

WINDOW = 300.0  # [s] over which the rate is taken
LINE_EVERY = 30.0  # [s] between plain lines


class Pace:
    """Counts what has ended, and how fast."""

    def __init__(self, total: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.total = total
        self.outcomes: Counter[str] = Counter()
        self._clock = clock
        self._began = clock()
        self._recent: deque[float] = deque()  # times at which trials ended

    @property
    def count(self) -> int:
        """Trials that have ended, failed ones included."""
        return self.outcomes.total()

    def add(self, outcome: str) -> None:
        """One more has ended."""
        self.outcomes[outcome] += 1
        self._recent.append(self._clock())

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return self._clock() - self._began

    def per_minute(self) -> float:
        """Trials per minute over the last minutes; 0 before the first."""
        now = self._clock()
        while self._recent and now - self._recent[0] > WINDOW:
            self._recent.popleft()
        span = min(WINDOW, now - self._began)
        return 60.0 * len(self._recent) / span if span > 0.0 else 0.0

    def words(self) -> str:
        """One line: rate, time left, shares of outcomes."""
        rate = self.per_minute()
        left = f"{duration(60.0 * (self.total - self.count) / rate)} left" if rate > 0.0 else "time left unknown"
        shares = ", ".join(f"{name} {100.0 * n / self.count:.0f} %" for name, n in self.outcomes.most_common())
        return f"{rate:.0f}/min, {left}{'; ' if shares else ''}{shares}"


def duration(seconds: float) -> str:
    """For people: 45 s, 12 min, 3 h 05 min."""
    minutes = round(seconds / 60.0)
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60:02} min"


class Display:
    """Shows a pace on stderr while it is open. `note` says something beside it."""

    def __init__(self, pace: Pace, stream: TextIO | None = None) -> None:
        self._pace = pace
        self._stream = sys.stderr if stream is None else stream
        self._last_line = time.monotonic()
        self._bar: Progress | None = None
        if self._stream.isatty():
            columns = (BarColumn(), TextColumn("{task.completed:.0f} of {task.total:.0f}  {task.fields[words]}"))
            self._bar = Progress(*columns, console=Console(file=self._stream), refresh_per_second=4)
            self._task = self._bar.add_task("", total=pace.total, words="")

    def update(self) -> None:
        """Show the present state, not too often."""
        if self._bar is not None:
            self._bar.update(self._task, completed=self._pace.count, words=self._pace.words())
        elif time.monotonic() - self._last_line >= LINE_EVERY:
            self._last_line = time.monotonic()
            pace = self._pace
            self.note(f"{pace.count} of {pace.total} ({100.0 * pace.count / pace.total:.1f} %), {pace.words()}")

    def note(self, text: str) -> None:
        """A line of its own, above the bar."""
        line = f"appli sweep: {text}"
        if self._bar is None:
            print(line, file=self._stream, flush=True)
        else:
            self._bar.console.print(line, markup=False, highlight=False)

    def __enter__(self) -> Self:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.update(self._task, completed=self._pace.count, words=self._pace.words())
            self._bar.stop()
