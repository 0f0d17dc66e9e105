"""Eq. 1 for every context at once, one process per core, with a bar for each and an early end by Ctrl-C."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import signal
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Event
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from learning.fit import FitResult, FitSettings, fit
from learning.interventions import Intervention

REPORT = 12  # evaluations between two reports of a worker: one generation
POLL = 0.1  # [s]

_News = tuple[str, int, float]  # label, evaluations so far, best loss


def fit_contexts(
    interventions: Sequence[Intervention], settings: FitSettings, workers: int | None = None
) -> dict[str, FitResult]:
    """One fit per context, over all interventions that teach it; the same whatever the number of workers.

    Ctrl-C ends all searches: contexts in work keep the best so far, those not begun the default parameters, and stderr
    says so. Raises ValueError when a context has no labelled steps, OSError when a worker dies.
    """
    taught = {
        label: [i for i in interventions if i.label == label] for label in sorted({i.label for i in interventions})
    }
    workers = max(1, min(len(taught), workers or os.cpu_count() or 1))
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")  # a fork would copy the threads of whatever is loaded here
    news: Queue[_News] = context.Queue()
    stop = context.Event()
    with (
        ProcessPoolExecutor(workers, context, _begin, (news, stop)) as pool,
        _stopping_on_interrupt(stop),
        _Bars(list(taught), settings) as bars,
    ):
        try:
            with _births_undisturbed():
                futures = {label: pool.submit(_fit, label, group, settings) for label, group in taught.items()}
            _watch(futures, news, bars)
            return {label: future.result() for label, future in futures.items()}
        except BrokenProcessPool as error:
            raise ChildProcessError("a process of the search died; is there enough memory?") from error
        except BaseException:  # do not wait for what nobody wants any more
            for process in set(multiprocessing.active_children()) - others:
                process.kill()
            raise


# --- in a worker -----------------------------------------------------------------------------------------------------

_news: Queue[_News]
_stop: Event


def _begin(news: Queue[_News], stop: Event) -> None:
    global _news, _stop
    _news, _stop = news, stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal sends it to all; the main process decides


def _fit(label: str, taught: list[Intervention], settings: FitSettings) -> FitResult:
    def tell(evaluations: int, best: float) -> None:
        if _stop.is_set():
            raise KeyboardInterrupt
        if evaluations % REPORT == 0:
            _news.put((label, evaluations, best))

    return fit(taught, settings, tell)


# --- in the main process ---------------------------------------------------------------------------------------------


@contextlib.contextmanager
def _stopping_on_interrupt(stop: Event) -> Iterator[None]:
    """The first Ctrl-C ends the searches, a second one everything. Only the main thread can listen for it."""

    def interrupt(number: int, frame: Any) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    try:
        before = signal.signal(signal.SIGINT, interrupt)
    except ValueError:  # not the main thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def _births_undisturbed() -> Iterator[None]:
    """Ctrl-C waits meanwhile, here and, since they inherit that, in the workers: it would kill one that still imports.

    The main process hears of it right afterwards.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Bars:
    """What is said on stderr: bars on a terminal, else a line per context."""

    def __init__(self, labels: Sequence[str], settings: FitSettings) -> None:
        self._progress = Progress(
            TextColumn("fitting {task.description}"),
            BarColumn(),
            TextColumn("{task.completed}/{task.total} evaluations, {task.fields[loss]}"),
            TimeElapsedColumn(),
            console=Console(stderr=True),
            disable=not sys.stderr.isatty(),
        )
        self._tasks = {
            label: self._progress.add_task(label, total=settings.max_evaluations, loss="") for label in labels
        }

    def advance(self, label: str, evaluations: int, best: float) -> None:
        """A search is so far."""
        if label in self._tasks:  # news may come later than the result
            self._progress.update(self._tasks[label], completed=evaluations, loss=f"loss {best:.2f}")

    def finish(self, label: str, result: FitResult) -> None:
        """A fit is done."""
        if result.interrupted:
            kept = "the best so far" if result.loss < result.default_loss else "the default"
            ended = f"interrupted: {kept} is kept"
        else:
            ended = f"{result.evaluations} evaluations, {result.seconds:.1f} s"
        line = f"appli train: {label}: loss {result.default_loss:.2f} -> {result.loss:.2f} ({ended})"
        self._progress.remove_task(self._tasks.pop(label))
        self._progress.console.print(line, highlight=False, soft_wrap=True)

    def __enter__(self) -> _Bars:
        labels = ", ".join(self._tasks)
        line = f"appli train: searching parameters for {labels}; Ctrl-C keeps the best so far, a second one stops"
        self._progress.console.print(line, highlight=False, soft_wrap=True)
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()


def _watch(futures: dict[str, Future[FitResult]], news: Queue[_News], bars: _Bars) -> None:
    """Show the searches' progress until all are done."""
    waiting = dict(futures)
    while waiting:
        with contextlib.suppress(queue.Empty):
            bars.advance(*news.get(timeout=POLL))
        for label in [label for label, future in waiting.items() if future.done()]:
            future = waiting.pop(label)
            if future.exception() is None:
                bars.finish(label, future.result())
