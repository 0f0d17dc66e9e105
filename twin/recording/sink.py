"""The file under a recording: whole messages only, and a full disk is an error, not a hang.

Rerun's own file sink, when a write fails, loses its writer thread and then blocks for ever in `flush` and again at
exit (measured with rerun-sdk 0.41 on a full tmpfs and under `ulimit -f`). And neither the viewer nor the reader opens a
file that ends inside a message. So Rerun writes to a pipe that never fails, and a thread copies whole messages from the
pipe to the file and keeps the first error for whoever asks.
"""

from __future__ import annotations

import contextlib
import os
import struct
import threading
from pathlib import Path

PREAMBLE = 12  # bytes before the first message: "RRF2", version, options
HEADER = struct.Struct("<QQ")  # before each message: its kind, and the length of what follows
END = 0  # the kind of the last message; the index of the file follows it


class RecordingError(OSError):
    """A recording cannot be written or read; the message is one line that says which file and why."""


class FileSink:
    """Owns the destination file; `rerun_path` is what Rerun is told to write to."""

    def __init__(self, path: Path) -> None:
        """Raises RecordingError when the file cannot be created."""
        self._path = path
        try:
            self._file = path.open("wb", buffering=0)
        except OSError as error:
            raise self._explain(error) from None
        self._read_end, self._write_end = os.pipe()
        self._error: OSError | None = None
        self._size = 0  # bytes of whole messages in the file
        self._thread = threading.Thread(target=self._copy, name=f"recording {path.name}", daemon=True)
        self._thread.start()

    @property
    def rerun_path(self) -> str:
        """The write end of the pipe, as a path (Linux and macOS)."""
        return f"/dev/fd/{self._write_end}"

    def opened(self) -> None:
        """Rerun has opened its own end: drop ours, so that the pipe ends when Rerun closes it."""
        os.close(self._write_end)

    def check(self) -> None:
        """Raises RecordingError when an earlier write failed."""
        if self._error is not None:
            raise self._explain(self._error) from None

    def join(self) -> None:
        """Wait until everything that Rerun wrote before closing its end is in the file."""
        self._thread.join()

    def _copy(self) -> None:
        waiting = bytearray()
        preamble = PREAMBLE
        while data := os.read(self._read_end, 1 << 20):
            if self._error is None:  # after an error keep draining, so that Rerun's writer never blocks
                waiting += data
                whole = whole_messages(waiting, preamble)
                if whole:
                    self._write(waiting[:whole])
                    del waiting[:whole]
                    preamble = 0
        os.close(self._read_end)
        if self._error is None and waiting:
            self._write(waiting)
        try:
            self._file.close()
        except OSError as error:  # some file systems report a full quota only here
            self._error = self._error or error

    def _write(self, data: bytearray) -> None:
        try:
            rest = memoryview(bytes(data))
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            self._error = error
            with contextlib.suppress(OSError):  # a device cannot be cut
                self._file.truncate(self._size)
        self._size += len(data)

    def _explain(self, error: OSError) -> RecordingError:
        reason = (error.strerror or str(error)).lower()
        return RecordingError(f"cannot write the recording {self._path}: {reason}")


def whole_messages(data: bytes | bytearray, start: int) -> int:
    """The length of the part of `data` that holds whole messages, the first of which begins at `start`.

    The last message and the index after it are left to the end of the stream: only together do they make sense.
    """
    end = start
    while end + HEADER.size <= len(data):
        kind, length = HEADER.unpack_from(data, end)
        if kind == END or end + HEADER.size + length > len(data):
            break
        end += HEADER.size + length
    return end if end > start else 0
