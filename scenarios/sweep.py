"""`appli sweep`: many trials through dask.distributed, on this machine or on a cluster, into one results file.

Only a few trials per worker are handed out at a time, so that neither the scheduler nor a Ctrl-C has to deal with
thousands. The scheduler does the trials of a lost worker again. Equal trials give equal rows wherever they run, and
what is stored is never done twice: a sweep that was stopped in whatever way goes on when the command is repeated.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import queue
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import dask
from distributed import Client, Future, KilledWorker, LocalCluster, WorkerPlugin

from scenarios.agenda import Agenda, Job, check_names, make_agenda, missing, other_versions, read_methods, read_worlds
from scenarios.errors import UserError
from scenarios.identity import code_digest
from scenarios.job import OtherCodeError, do, equip, failed
from scenarios.progress import Display, Pace, duration
from scenarios.run import compile_kernels
from scenarios.store import Store, StoredTrial
from twin.compiled import FIRST_TIME

MOST_RUNS = 10_000  # per world and method
AHEAD = 2  # jobs handed out per worker thread: one in work, one waiting
MEMORY = 1024**3  # bytes per local worker; one needs a third of it, and is started anew when it takes more
COUNT_EVERY = 5.0  # [s] between looks at how many workers there are
CONNECT = 5.0  # [s] to reach a scheduler; one that has gone has forgotten its jobs, so waiting longer gains nothing
REPLIES = 0.2  # [s] between looks at the keyboard

SETTINGS = {
    "distributed.worker.profile.enabled": False,  # samples the stack a hundred times a second
}


def sweep_command(
    out: Path,
    worlds: str,
    methods: str,
    policies: Path | None,
    runs: int,
    seed: int,
    protocol: str,
    workers: int | None,
    scheduler: str | None,
) -> int:
    """Do what is missing in `out`. Exit code 0 = all done, 1 = some trials failed, 130 = stopped by Ctrl-C."""
    if not 1 <= runs <= MOST_RUNS or seed < 0:
        raise UserError(f"--runs must be 1 to {MOST_RUNS}, and --seed 0 or more")
    if workers is not None and (workers < 1 or scheduler is not None):
        raise UserError("--workers must be 1 or more, and goes without --scheduler")
    agenda = make_agenda(read_worlds(worlds, protocol), read_methods(methods, policies), runs, seed, code_digest())
    with Store.open(out, write=True) as store:
        rows = store.rows()
        check_names(agenda, rows)
        jobs = missing(agenda.jobs, store.keys())
        pace = Pace(len(jobs))
        with Display(pace) as display:
            for line in other_versions(agenda, rows):
                display.note(line)
            stored = len(agenda.jobs) - len(jobs)
            display.note(f"{len(agenda.jobs)} trials, {stored} of them stored already, {len(jobs)} to do")
            stopped = False
            if jobs:
                with _cluster(agenda, workers, scheduler) as client, _stop_on_ctrl_c() as stop:
                    stopped = Sweep(client, store, pace, display, stop).run(jobs)
    print(_summary(out, pace, stopped))
    return 130 if stopped else 1 if pace.outcomes["error"] else 0


def _summary(out: Path, pace: Pace, stopped: bool) -> str:
    shares = ", ".join(f"{name} {n}" for name, n in pace.outcomes.most_common())
    lines = [f"{pace.count} trials done in {duration(pace.elapsed)}{': ' if shares else ''}{shares}"]
    if pace.outcomes["error"]:
        lines.append(f"the tracebacks of the failed ones are in {out}; the same command tries them again")
    if stopped:
        lines.append(f"{pace.total - pace.count} left; the same command goes on")
    else:
        lines.append(f"results: {out}   tables: appli report {out} --out DIR")
    return "\n".join(lines)


# --- the loop --------------------------------------------------------------------------------------------------------


@dataclass
class Sweep:
    """Hands out jobs and stores what comes back."""

    client: Client
    store: Store
    pace: Pace
    display: Display
    stop: threading.Event  # set: hand out nothing more
    replies: queue.SimpleQueue[Future] = field(default_factory=queue.SimpleQueue)
    flying: dict[str, tuple[Future, Job]] = field(default_factory=dict)  # by key of the future

    def run(self, jobs: list[Job]) -> bool:
        """Until nothing is left to do. Returns whether it was stopped before that."""
        waiting = iter(jobs)
        room, counted, told = -1, -COUNT_EVERY, False
        while True:
            if time.monotonic() - counted > COUNT_EVERY:
                before, room, counted = room, self._room(), time.monotonic()
                if room == 0 and before != 0:
                    self.display.note("waiting for workers; start some with: dask worker ADDRESS --nthreads 1")
            while len(self.flying) < room and not self.stop.is_set():
                job = next(waiting, None)
                if job is None:
                    break
                self._hand_out(job)
            if not self.flying and (room or self.stop.is_set()):
                return self.pace.count < self.pace.total
            if self.stop.is_set() and not told:
                told = True
                self.display.note(f"finishing {len(self.flying)} trials; Ctrl-C again stops at once")
            self._collect()
            self.display.update()

    def _room(self) -> int:
        """How many jobs may be out: none while there is no worker."""
        with _lost_scheduler():
            return AHEAD * int(sum(self.client.nthreads().values()))

    def _hand_out(self, job: Job) -> None:
        future = self.client.submit(do, job, key=f"trial-{job.key}")
        self.flying[future.key] = (future, job)
        future.add_done_callback(self.replies.put)

    def _collect(self) -> None:
        """Store what has come back; waits a moment for the first."""
        rows: list[StoredTrial] = []
        try:
            while True:
                future = self.replies.get(timeout=0.0 if rows else REPLIES)
                _, job = self.flying.pop(future.key)
                rows.append(_row(future, job))
        except queue.Empty:
            pass
        finally:  # what came back before a mistake was found is kept
            if rows:
                self.store.add(rows)
        for row in rows:
            self.pace.add(row.outcome or row.status)


def _row(future: Future, job: Job) -> StoredTrial:
    """What a future has brought. Raises UserError when its worker cannot do jobs at all."""
    if future.cancelled():
        raise UserError("the scheduler has gone; start it again, then give the same command")
    with _lost_scheduler():
        error = future.exception()
    if error is None:
        with _lost_scheduler():
            row: StoredTrial = future.result()
        return row
    if isinstance(error, KilledWorker):  # died under this job again and again
        return failed(job, f"every worker that was given this trial died: {error}")
    if isinstance(error, OtherCodeError):
        raise UserError(
            "a worker runs other code, or other versions of Python, mujoco, numpy or numba, than this process; "
            "install the same everywhere, and start the workers anew"
        )
    raise UserError(f"a worker cannot do trials ({type(error).__name__}: {error}); is appli-twin installed there?")


@contextmanager
def _lost_scheduler() -> Iterator[None]:
    try:
        yield
    except (OSError, TimeoutError) as error:
        raise UserError("the scheduler does not answer; start it again, then give the same command") from error


# --- where it runs ---------------------------------------------------------------------------------------------------


class Equipment(WorkerPlugin):  # type: ignore[misc]
    """Brings worlds and policies to every worker, once, to those that join later too. No shared files are needed."""

    def __init__(self, agenda: Agenda, local: bool) -> None:
        self.worlds, self.policies, self.local = dict(agenda.worlds), dict(agenda.policies), local

    def setup(self, worker: Any) -> None:
        """Runs in the worker process."""
        equip(self.worlds, self.policies)
        if self.local and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C goes to all; only the sweep obeys


@contextmanager
def _cluster(agenda: Agenda, workers: int | None, scheduler: str | None) -> Iterator[Client]:
    """A client of the scheduler at that address, or of one of our own with a process per core."""
    with ExitStack() as stack, dask.config.set(SETTINGS):
        logging.disable(logging.CRITICAL)  # what matters of dask's many words reaches the user as one line
        stack.callback(logging.disable, logging.NOTSET)
        if scheduler is None:
            if FIRST_TIME:  # once here rather than in every worker at the same time
                compile_kernels()
            cluster = stack.enter_context(_local_cluster(workers or _cores()))
            client = stack.enter_context(Client(cluster))
        else:
            try:
                client = stack.enter_context(Client(scheduler, timeout=CONNECT))
            except (OSError, TimeoutError, ValueError) as error:
                raise UserError(f"no scheduler answers at {scheduler}; start one with: dask scheduler") from error
        name = f"appli-{os.getpid()}-{time.time_ns()}"
        try:
            client.register_plugin(Equipment(agenda, scheduler is None), name=name)
        except Exception as error:  # whatever the workers say
            raise UserError(f"the workers refuse ({error}); is appli-twin installed there?") from error
        if scheduler is not None:
            stack.callback(_unequip, client, name)
        try:
            yield client
        except BaseException:  # stop at once: do not ask busy workers to finish
            for child in multiprocessing.active_children() if scheduler is None else ():
                child.kill()
            raise


def _unequip(client: Client, name: str) -> None:
    with suppress(Exception):
        client.unregister_worker_plugin(name)


def _local_cluster(workers: int) -> LocalCluster:
    """Single-threaded processes that talk over loopback; each is started anew when it takes too much memory."""
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # any free port: without it two sweeps want the same
        memory_limit=MEMORY,
        silence_logs=logging.CRITICAL,
    )


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _stop_on_ctrl_c() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C sets; the second interrupts."""
    stop = threading.Event()

    def handle(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    before = signal.signal(signal.SIGINT, handle)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, before)
