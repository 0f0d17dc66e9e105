"""The results of a sweep: one SQLite file, one row per trial, only facts.

The file keeps SQLite's rollback journal instead of the write-ahead log: a commit that returns is on the disk, a process
killed in the middle of one leaves a journal that the next reader rolls back, a report may read while a sweep writes,
and between commits the result is a single file, on network file systems too. A sweep holds a lock beside the file,
which the kernel releases when the process dies.
"""

from __future__ import annotations

import fcntl
import json
import os
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from scenarios.errors import UserError

KIND = "appli-results"
SCHEMA = 1
CONFIDENCE_BINS = 20  # equal bins of [0, 1], the last one closed
BUSY = 30.0  # [s] to wait for somebody who reads
HEADER = b"SQLite format 3\0"


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredTrial:
    """One row. What a trial that raised does not have is None or empty."""

    key: str  # hash of all that decides the trial (scenarios.identity)
    world: str  # name, such as training or world_3
    world_digest: str  # of the world's contents: obstacles, start, goal, rules
    protocol: str  # course, appli, 2020, icra22
    method: str  # dwa, A, A+c, ...
    seed: int
    run: int
    policy: str  # digest of the policy file's bytes; "" without one
    code: str  # digest of the sources and package versions that decide a trial
    status: Literal["done", "error"]
    outcome: str | None = None  # reached, collided, timed_out, aborted
    time: float | None = None  # [s] on the trial's clock; no penalty in it
    distance: float | None = None  # [m] driven
    recoveries: int | None = None  # recovery behaviours started
    min_clearance: float | None = None  # [m]; None = nothing ever near
    contexts: dict[str, float] | None = None  # label -> share of ticks
    confidence: tuple[int, ...] | None = None  # ticks per bin of the classifier's confidence; None without a classifier
    ticks: int | None = None
    digest: str | None = None  # of the tick stream
    wall: float = 0.0  # [s] that it took
    error: str | None = None  # traceback
    finished: str = ""  # UTC, ISO 8601

    def facts(self) -> StoredTrial:
        """The row without what differs from one run of the program to the next."""
        return replace(self, wall=0.0, finished="")


COLUMNS = tuple(f.name for f in fields(StoredTrial))
_TYPES = {
    "key": "TEXT PRIMARY KEY",
    **dict.fromkeys(("seed", "run"), "INTEGER NOT NULL"),
    **dict.fromkeys(("recoveries", "ticks"), "INTEGER"),
    **dict.fromkeys(("time", "distance", "min_clearance", "wall"), "REAL"),
    **dict.fromkeys(("outcome", "contexts", "confidence", "digest", "error"), "TEXT"),
}
_TABLE = ", ".join(f"{name} {_TYPES.get(name, 'TEXT NOT NULL')}" for name in COLUMNS)
_ORDER = "world, protocol, method, seed, run, policy, code, key"


class Store:
    """An open results file. Use as a context manager."""

    def __init__(self, path: Path, connection: sqlite3.Connection, lock: int | None) -> None:
        """Use Store.open."""
        self.path = path
        self._connection = connection
        self._lock = lock

    @classmethod
    def open(cls, path: Path, write: bool = False) -> Store:
        """Open a results file; `write` makes it if need be and keeps other writers out.

        Raises UserError for a file that is missing, damaged, foreign, newer, or in use by another sweep.
        """
        _check_header(path, write)
        lock = _acquire(path) if write else None
        try:
            with _blame(path):
                connection = _connect(path, write)
            try:
                with _blame(path):
                    if write:
                        _create(connection)
                    _check(path, connection)
            except BaseException:
                connection.close()
                raise
        except BaseException:
            if lock is not None:
                _release(path, lock)
            raise
        return cls(path, connection, lock)

    def rows(
        self,
        *,
        world: str | None = None,
        protocol: str | None = None,
        method: str | None = None,
        status: str | None = None,
        policy: str | None = None,
        code: str | None = None,
    ) -> list[StoredTrial]:
        """The rows with these values, in the order of world, protocol, method, seed and run. Raises UserError."""
        wanted = {"world": world, "protocol": protocol, "method": method, "status": status}
        wanted |= {"policy": policy, "code": code}
        given = {name: value for name, value in wanted.items() if value is not None}
        where = " AND ".join(f"{name} = ?" for name in given) or "1"
        query = f"SELECT {', '.join(COLUMNS)} FROM trials WHERE {where} ORDER BY {_ORDER}"
        with _blame(self.path):
            return [_from_row(row) for row in self._connection.execute(query, tuple(given.values()))]

    def keys(self, status: str | None = "done") -> set[str]:
        """The keys of the rows with this status; None means all rows. Raises UserError."""
        where, values = ("", ()) if status is None else (" WHERE status = ?", (status,))
        with _blame(self.path):
            return {str(key) for (key,) in self._connection.execute(f"SELECT key FROM trials{where}", values)}

    def add(self, trials: Iterable[StoredTrial]) -> None:
        """Write rows in one transaction, all or none; a row of the same key is replaced. Raises UserError."""
        rows = [_to_row(trial) for trial in trials]
        marks = ", ".join("?" * len(COLUMNS))
        with _blame(self.path), self._connection:
            self._connection.executemany(f"INSERT OR REPLACE INTO trials ({', '.join(COLUMNS)}) VALUES ({marks})", rows)

    def close(self) -> None:
        """Close the file and let others write."""
        self._connection.close()
        if self._lock is not None:
            _release(self.path, self._lock)
            self._lock = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


# --- rows ------------------------------------------------------------------------------------------------------------


def _to_row(trial: StoredTrial) -> tuple[Any, ...]:
    values = {name: getattr(trial, name) for name in COLUMNS}
    for name in ("contexts", "confidence"):
        values[name] = None if values[name] is None else json.dumps(values[name], sort_keys=True, allow_nan=False)
    return tuple(values.values())


def _from_row(row: tuple[Any, ...]) -> StoredTrial:
    values = dict(zip(COLUMNS, row, strict=True))
    if values["contexts"] is not None:
        values["contexts"] = {str(k): float(v) for k, v in json.loads(values["contexts"]).items()}
    if values["confidence"] is not None:
        values["confidence"] = tuple(int(n) for n in json.loads(values["confidence"]))
    return StoredTrial(**values)


# --- the file --------------------------------------------------------------------------------------------------------


@contextmanager
def _blame(path: Path) -> Iterator[None]:
    """SQLite's complaints as one line that says what to do."""
    try:
        yield
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        if code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
            raise UserError(
                f"{path}: cannot write ({error}): is the disk full? What was stored before is kept; "
                "free some space and give the same command again"
            ) from error
        if code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
            raise UserError(_damaged(path, str(error))) from error
        raise UserError(f"{path}: {error}") from error
    except (ValueError, TypeError, AttributeError) as error:  # JSON or types that no sweep writes
        raise UserError(_damaged(path, str(error))) from error


def _damaged(path: Path, what: str) -> str:
    return f"{path} is damaged ({' '.join(what.split())[:100]}); restore a copy, or move it away and sweep again"


def _check_header(path: Path, write: bool) -> None:
    """Refuse what is no SQLite file before SQLite touches it."""
    try:
        with path.open("rb") as file:
            start = file.read(len(HEADER))
    except FileNotFoundError:
        if not write:
            raise UserError(f"{path} does not exist; make one with: appli sweep --out {path} ...") from None
        if not path.parent.is_dir():
            raise UserError(f"{path.parent} is not a folder; make it first, or give another --out") from None
        return
    except IsADirectoryError:
        raise UserError(f"{path} is a folder; give a file, such as {path / 'results.sqlite'}") from None
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror or error}") from error
    if start != HEADER and not (write and not start):  # an empty file: a sweep was killed before its first commit
        raise UserError(f"{path} is not a results file of appli sweep; give another name")


def _connect(path: Path, write: bool) -> sqlite3.Connection:
    """A reader may write too, where it is allowed to: it has to roll back what a killed sweep left half-done."""
    mode = "rwc" if write else "rw" if os.access(path, os.W_OK) and os.access(path.parent, os.W_OK) else "ro"
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", timeout=BUSY, uri=True)
    try:
        connection.execute("PRAGMA synchronous = FULL")
        if not write:
            connection.execute("PRAGMA query_only = ON")
    except BaseException:
        connection.close()
        raise
    return connection


def _create(connection: sqlite3.Connection) -> None:
    """The tables, in one transaction, in a file that is still empty."""
    if connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
        return
    with connection:
        connection.execute("BEGIN IMMEDIATE")
        connection.execute("CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT NOT NULL)")
        connection.execute(f"CREATE TABLE trials ({_TABLE}) WITHOUT ROWID")
        connection.executemany("INSERT INTO meta VALUES (?, ?)", [("kind", KIND), ("schema", str(SCHEMA))])


def _check(path: Path, connection: sqlite3.Connection) -> None:
    """Refuse a damaged, foreign or newer file."""
    verdict = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
    if verdict != "ok":
        raise UserError(_damaged(path, verdict))
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    meta = dict(connection.execute("SELECT name, value FROM meta")) if "meta" in tables else {}
    if meta.get("kind") != KIND:
        raise UserError(f"{path} is a database, but not of appli sweep; give another name")
    schema = str(meta.get("schema"))
    if schema != str(SCHEMA):
        newer = schema.isdigit() and int(schema) > SCHEMA
        hint = "a newer version of appli-twin wrote it; update appli-twin" if newer else "sweep again into a new file"
        raise UserError(f"{path} has format {schema}, this version reads {SCHEMA}: {hint}")
    columns = tuple(name for _, name, *_ in connection.execute("PRAGMA table_info(trials)"))
    if columns != COLUMNS:
        raise UserError(_damaged(path, "its table is not that of appli sweep"))


# --- one writer ------------------------------------------------------------------------------------------------------


def _lock_path(path: Path) -> Path:
    return path.with_name(f"{path.name}.lock")


def _acquire(path: Path) -> int:
    """A lock that lives as long as this process, whatever ends it."""
    name = _lock_path(path)
    while True:
        try:
            descriptor = os.open(name, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise UserError(f"{name} cannot be made: {error.strerror or error}") from error
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(descriptor)
            if not isinstance(error, BlockingIOError):
                raise UserError(f"{name} cannot be locked: {error.strerror or error}") from error
            raise UserError(f"another sweep is writing to {path}; wait for it, or give another --out") from None
        with suppress(FileNotFoundError):  # the holder before us may have deleted the file between our two steps
            if os.path.samestat(os.fstat(descriptor), name.stat()):
                return descriptor
        os.close(descriptor)


def _release(path: Path, descriptor: int) -> None:
    """Delete the lock file while it is still ours, then let go."""
    with suppress(OSError):
        _lock_path(path).unlink()
    os.close(descriptor)
