"""Bag files through `rosbags`, the only import of it: no ROS installation is needed in either direction."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

Stamped = tuple[str, int, Any]  # topic, time [ns], message

# The types used here are the same in every ROS 2 so far. Humble's sqlite3 bags do not bring their definitions along.
TYPES = get_typestore(Stores.ROS2_HUMBLE)

_FOREVER = QosTime(9223372036, 854775807)  # RMW_DURATION_INFINITE; rmw/time.h
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _FOREVER,
    _FOREVER,
    QosLiveliness.AUTOMATIC,
    _FOREVER,
    False,
)
REPAIRS = {".mcap": "mcap recover", ".bag": "rosbag reindex"}  # else a folder: ros2 bag reindex


class BagError(ValueError):
    """A bag that cannot be read, written or used; the message is one line that says which and why."""


def message(type_name: str, *values: Any) -> Any:
    """A ROS 2 message from its fields in order, e.g. message("std_msgs/msg/String", "A1")."""
    return TYPES.types[type_name](*values)


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag to be written."""

    name: str
    type_name: str  # such as sensor_msgs/msg/LaserScan
    latched: bool = False  # late subscribers get the last message, as with tf_static


class BagWriter:
    """Writes one MCAP file. A context manager: afterwards the file is complete and under its name, or not there.

    It is written aside, in a hidden folder next to it, and by a thread: a Ctrl-C, which strikes the main thread, never
    cuts a message in two. An interrupt keeps the bag, a failure to write throws it away.
    """

    def __init__(self, path: Path, topics: Sequence[Topic]) -> None:
        """Raises BagError when the file exists or cannot be created."""
        self.path = path
        if path.exists():
            raise BagError(f"cannot write the bag {path}: it exists already; remove it or take another name")
        self._closed = False
        self._started = False
        self._failed: OSError | None = None
        with self._explained():
            self._aside = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
        try:
            with self._explained():
                # version 8: the newest that Humble's and Iron's ros2 bag read as well
                self._writer = Writer(self._aside / path.stem, version=8, storage_plugin=StoragePlugin.MCAP)
                self._writer.open()
                self._connections = {
                    t.name: self._writer.add_connection(
                        t.name, t.type_name, typestore=TYPES, offered_qos_profiles=[LATCHED] if t.latched else []
                    )
                    for t in topics
                }
        except BaseException:
            shutil.rmtree(self._aside, ignore_errors=True)
            raise
        self._hand = ThreadPoolExecutor(max_workers=1, thread_name_prefix="bag")
        self._pending: Future[None] | None = None

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except BagError:
            if error is None:  # what stopped the run matters more than what that did to the file
                raise

    def write(self, batch: Sequence[Stamped]) -> None:
        """Write messages that belong together. Raises BagError when these or those before cannot be written."""
        self._wait()
        self._started = True
        self._pending = self._hand.submit(self._write_all, tuple(batch))

    def close(self) -> None:
        """Finish the file and give it its name. Raises BagError, and leaves nothing behind, if that fails."""
        if self._closed:
            return
        self._closed = True
        try:
            self._wait()
            if self._started:
                self._run(self._writer.close)
                with self._explained():
                    _publish(self._aside / self.path.stem / self.path.name, self.path)
        finally:
            self._hand.submit(self._abandon).result()
            self._hand.shutdown()
            shutil.rmtree(self._aside, ignore_errors=True)

    def _write_all(self, batch: Sequence[Stamped]) -> None:
        for topic, time, content in batch:
            connection = self._connections[topic]
            self._writer.write(connection, time, TYPES.serialize_cdr(content, connection.msgtype))

    def _abandon(self) -> None:
        """Let go of the file if it is still open."""
        with contextlib.suppress(OSError):
            self._writer.abort()

    def _run(self, action: Callable[[], None]) -> None:
        """In the thread, waiting for it."""
        self._pending = self._hand.submit(action)
        self._wait()

    def _wait(self) -> None:
        """Until the thread is idle; an error of its is told, now and at every later call."""
        if self._failed is None and self._pending is not None:
            try:
                self._pending.result()
            except OSError as error:
                self._failed = error
        if self._failed is not None:
            raise self._explain(self._failed)

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._explain(error) from error

    def _explain(self, error: OSError) -> BagError:
        return BagError(f"cannot write the bag {self.path}: {(error.strerror or str(error)).lower()}")


def _publish(finished: Path, path: Path) -> None:
    """Give a finished file its name, but not that of a file that has appeared since."""
    try:
        os.link(finished, path)  # fails where rename would overwrite
    except FileExistsError:
        raise
    except OSError:  # no hard links on this file system
        if path.exists():
            raise
        os.replace(finished, path)


class BagReader:
    """A ROS 1 bag, a ROS 2 bag (folder, or its .db3 file) or an MCAP file, open for reading. A context manager."""

    def __init__(self, path: Path) -> None:
        """Raises BagError when there is none or it is damaged."""
        self.path = path
        if not path.exists():
            raise BagError(f"{path}: no such file or folder")
        if path.is_dir() and not (path / "metadata.yaml").exists():
            raise BagError(f"{path}: no metadata.yaml in it, so not a ROS 2 bag; try: ros2 bag reindex {path}")
        if path.is_file() and path.suffix not in (".bag", ".db3", ".mcap"):
            raise BagError(f"{path}: not a bag; give a .bag, .mcap or .db3 file, or the folder of a ROS 2 bag")
        with self._explained():
            self._reader = AnyReader([path], default_typestore=TYPES)
            self._reader.open()
        if not self._reader.message_count:
            self._reader.close()
            raise BagError(f"{path}: an empty bag")
        self.start = self._reader.start_time  # [ns] of the first message
        self.end = self._reader.end_time - 1  # [ns] of the last message; rosbags counts one more
        self.topics = {c.topic: c.msgtype for c in self._reader.connections}  # name -> type such as std_msgs/msg/String
        self._counts = {name: info.msgcount for name, info in self._reader.topics.items()}
        self.silent = {name for name, count in self._counts.items() if count == 0}

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.close()

    def seconds(self, time: int) -> float:
        """[s] since the first message of the bag."""
        return (time - self.start) / 1e9

    def messages(self, topics: Sequence[str], until: int | None = None) -> Iterator[Stamped]:
        """The messages of some topics as they were recorded, up to and including a time [ns].

        Raises BagError where the file is damaged.
        """
        connections = [c for c in self._reader.connections if c.topic in topics]
        if not connections:
            return
        latest, count = self.start, 0
        with self._explained():
            for connection, time, data in self._reader.messages(connections, stop=None if until is None else until + 1):
                if time < latest:
                    raise BagError(
                        f"{self.path}: time goes back by {(latest - time) / 1e9:.3f} s at "
                        f"{self.seconds(latest):.2f} s; was the clock reset while recording?"
                    )
                latest, count = time, count + 1
                yield connection.topic, time, self._reader.deserialize(data, connection.msgtype)
            if until is None and count != (
                expected := sum(self._counts[name] for name in {c.topic for c in connections})
            ):
                raise ValueError(f"{expected - count} of {expected} messages are missing")

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        """A stranger's file can fail anywhere in the parser, and in any way."""
        try:
            yield
        except BagError:
            raise
        except OSError as error:
            raise BagError(f"{self.path}: {error.strerror or error}") from error
        except Exception as error:
            reason = " ".join(str(error).split()).rstrip(".")[:160] or type(error).__name__
            repair = REPAIRS.get(self.path.suffix, "ros2 bag reindex")
            raise BagError(f"{self.path}: damaged or truncated ({reason}); `{repair}` may help") from error
