"""A fold over ticks that writes a `.rrd` file: geometry once, then poses and what the robot saw, tried and chose."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

import numpy as np
import rerun as rr

from twin.recording.blueprint import layout, style_plots
from twin.recording.channels import Rows, rows_of, style_drawings
from twin.recording.robot_shape import draw_lidar, draw_robot
from twin.recording.scenery import draw_world
from twin.recording.sink import FileSink, RecordingError
from twin.records import Tick
from twin.world import World

APPLICATION = "appli_twin"
BATCH = 50  # ticks per write: at most 2.5 s are lost when the process is killed; smaller batches make larger files


class Recorder:
    """Writes ticks to `path`. A context manager: however the block ends, the file is closed and readable.

    `metadata` (world, driver, seed, ...) is shown beside the run and can be read back. It also identifies the
    recording, so that two runs of one spec compare equal; a value that differs between equal runs, such as a
    wall-clock time, must not be in it.
    """

    def __init__(self, path: Path | str, world: World, metadata: Mapping[str, object] | None = None) -> None:
        """Create the file and draw what never moves. Raises RecordingError when it cannot be written."""
        self.path = Path(path)
        self.world = world
        self.metadata = {"world": world.name, "protocol": world.rules.protocol} | dict(metadata or {})
        self._pending: list[Tick] = []
        self._last: Tick | None = None  # the last tick already written
        self._closed = False
        self._sink = FileSink(self.path)
        self._stream = rr.RecordingStream(APPLICATION, recording_id=self._identity(), send_properties=False)
        self._stream.save(self._sink.rerun_path)
        self._sink.opened()
        self._stream.send_recording_name(self._title())
        self._stream.flush()  # properties go through a batcher: without this their order in the file would vary
        self._stream.send_property("run", rr.AnyValues(**{k: str(v) for k, v in self.metadata.items()}))
        self._stream.flush()
        draw_world(self._stream, world)
        draw_robot(self._stream)
        style_plots(self._stream)
        style_drawings(self._stream)
        self._describe()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except RecordingError:
            if error is None:  # what stopped the run matters more than what that did to the file
                raise

    def add(self, tick: Tick) -> None:
        """Record one tick. Raises RecordingError when the file cannot be written any more."""
        self._sink.check()
        self._pending.append(tick)
        if len(self._pending) >= BATCH:
            self._write()

    def close(self) -> None:
        """Write what is pending and finish the file. Raises RecordingError if it is not complete on disk."""
        if self._closed:
            return
        self._closed = True
        try:
            self._write()
            self._describe()
        finally:
            self._stream.disconnect()
            self._sink.join()
        self._sink.check()

    def _write(self) -> None:
        ticks, self._pending = self._pending, []  # first, so that an interrupt in here writes no tick twice
        if ticks:
            if self._last is None:
                self._begin(ticks[0])
            before, self._last = self._last, ticks[-1]
            for rows in rows_of(ticks, before):
                self._send(rows)

    def _begin(self, first: Tick) -> None:
        """What only the first tick tells: which lidar the robot carries, and whether a classifier drives."""
        draw_lidar(self._stream, first.observation.scan.mount)
        self._stream.send_blueprint(layout(self.world, learned=first.decision.confidence is not None))

    def _send(self, rows: Rows) -> None:
        # send_columns and not log: its chunks are ours, so equal ticks give equal files, and no wall-clock timeline
        seconds = np.array([tick.observation.time for tick in rows.ticks])
        indexes = [
            rr.TimeColumn("sim_time", duration=np.rint(seconds * 1e9).astype("timedelta64[ns]")),
            rr.TimeColumn("tick", sequence=[tick.index for tick in rows.ticks]),
        ]
        self._stream.send_columns(rows.entity, indexes, rows.columns)

    def _describe(self) -> None:
        """The text panel. It is static: the one written last is shown at every time."""
        text = rr.TextDocument.columns(text=[self._summary()], media_type=[rr.MediaType.MARKDOWN])
        self._stream.send_columns("run", [], text)

    def _summary(self) -> str:
        lines = [" · ".join(f"{name} **{value}**" for name, value in self.metadata.items()), "", self.world.note]
        if (last := self._last) is not None:
            how = "interrupted" if last.outcome is None else last.outcome.value
            lines = [f"### {how} after {last.elapsed:.2f} s, {last.decision.recoveries} recoveries", "", *lines]
        return "\n".join(lines)

    def _title(self) -> str:
        return " · ".join(str(self.metadata[key]) for key in ("world", "driver", "seed") if key in self.metadata)

    def _identity(self) -> str:
        """The same for equal metadata."""
        text = json.dumps(self.metadata, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:32]
