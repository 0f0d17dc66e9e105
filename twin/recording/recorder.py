"""A fold over ticks that writes a `.rrd` file: geometry once, then poses and what the robot saw, tried and chose."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType

import numpy as np
import rerun as rr

from twin.recording import palette
from twin.recording.blueprint import layout
from twin.recording.channels import Rows, drawings_of, phase_of, rows_of, style_drawings
from twin.recording.judge import Judge
from twin.recording.plots import evidence_lines, style_lane, style_lines, style_plots
from twin.recording.robot_shape import draw_lidar, draw_robot
from twin.recording.scenery import draw_world
from twin.recording.sink import FileSink, RecordingError
from twin.records import Tick
from twin.world import World

APPLICATION = "appli_twin"
PERIOD = 0.05  # [s] between ticks
REWIND_TICKS = 20  # at most, that winding back takes in the recording: one second
BATCH = 50  # ticks per write: at most 2.5 s are lost when the process is killed; smaller batches make larger files


class Recorder:
    """Writes ticks to `path`. A context manager: however the block ends, the file is closed and readable.

    `metadata` (world, driver, seed, ...) is shown beside the run and can be read back. It also identifies the
    recording, so that two runs of one spec compare equal; a value that differs between equal runs, such as a
    wall-clock time, must not be in it.

    A drive that was wound back is recorded in phases: `begin`, ticks, `rewind`, `begin`, ticks. The recording's clock
    is that of the first phase and never goes back.
    """

    def __init__(
        self,
        path: Path | str | None,
        world: World,
        metadata: Mapping[str, object] | None = None,
        *,
        judge: Judge | None = None,
        viewer: str | None = None,
        headline: str = "",
    ) -> None:
        """Create the file and draw what never moves. Raises RecordingError when it cannot be written.

        path: None = no file. judge: the context classifier that drives. viewer: URL of a viewer that watches
        (twin.recording.viewer). headline: stands over the text panel instead of the outcome.
        """
        self.path = None if path is None else Path(path)
        self.world = world
        self.metadata = {"world": world.name} | dict(metadata or {}) | {"protocol": world.rules.protocol}
        self._names = "method" if "method" in self.metadata else "driver"  # what says who drives, in brief
        self._judge, self._headline = judge, headline
        self._pending: list[Tick] = []
        self._last: Tick | None = None  # the last tick already written
        self._before: Tick | None = None  # the same, unless a phase has begun since
        self._next: int | None = None  # the next tick on the recording's clock; None = that of the tick itself
        self._shift = 0  # ticks from the clock of the drive to that of the recording
        self._phase: tuple[str, str] | None = None  # that begins with the next tick, and what the log says of it
        self._closed = False
        self._sink = None if self.path is None else FileSink(self.path)
        self._stream = rr.RecordingStream(APPLICATION, recording_id=self._identity(), send_properties=False)
        sinks = [] if self._sink is None else [rr.FileSink(self._sink.rerun_path)]
        self._stream.set_sinks(*sinks, *([] if viewer is None else [rr.GrpcSink(viewer)]))
        if self._sink is not None:
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
        self._check()
        if self._phase is not None:
            self._shift = 0 if self._next is None else self._next - tick.index
        tick = _later(tick, self._shift)
        if self._phase is not None:
            for rows in phase_of(tick, *self._phase):
                self._send(rows)
            self._phase = None
        self._pending.append(tick)
        self._next = tick.index + 1
        if len(self._pending) >= BATCH:
            self._write()

    def begin(self, phase: str, event: str) -> None:
        """What is added next is a phase of its own, from wherever it sets out; `event` says so in the log."""
        self._write()
        if self._last is None:
            style_lane(self._stream, "phase", palette.PHASES)
        self._before, self._phase = None, (phase, event)

    def rewind(self, ticks: Sequence[Tick], event: str) -> None:
        """Show the way back over `ticks`, oldest first, of the phase that is over. Only drawn: nothing is driven."""
        self.begin("rewound", event)
        backwards = ticks[::-1][:: max(1, math.ceil(len(ticks) / REWIND_TICKS))]
        at = self._next or 0
        shown = [_later(tick, at + k - tick.index) for k, tick in enumerate(backwards)]
        if shown:
            for rows in (*phase_of(shown[0], "rewound", event), *drawings_of(shown, None)):
                self._send(rows)
            self._next = at + len(shown)

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
            if self._sink is not None:
                self._sink.join()
        self._check()

    def _check(self) -> None:
        if self._sink is not None:
            self._sink.check()

    def _write(self) -> None:
        ticks, self._pending = self._pending, []  # first, so that an interrupt in here writes no tick twice
        if ticks:
            if self._last is None:
                self._begin(ticks[0])
            before, self._before, self._last = self._before, ticks[-1], ticks[-1]
            for rows in rows_of(ticks, before, self._judge):
                self._send(rows)

    def _begin(self, first: Tick) -> None:
        """What only the first tick tells: which lidar the robot carries, and whether a classifier drives."""
        draw_lidar(self._stream, first.observation.scan.mount)
        labels = () if self._judge is None else self._judge.labels
        style_lines(self._stream, evidence_lines(labels))
        self._stream.send_blueprint(layout(self.world, first.decision.confidence is not None, labels))

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
        shown = {name: value for name, value in self.metadata.items() if name != "driver" or self._names == "driver"}
        lines = [" · ".join(f"{name} **{value}**" for name, value in shown.items()), "", self.world.note]
        if self._headline:
            lines = [f"### {self._headline}", "", *lines]
        elif (last := self._last) is not None:
            how = "interrupted" if last.outcome is None else last.outcome.value
            lines = [f"### {how} after {last.elapsed:.2f} s, {last.decision.recoveries} recoveries", "", *lines]
        return "\n".join(lines)

    def _title(self) -> str:
        keys = ("world", "intervention", self._names, "seed")
        return " · ".join(str(self.metadata[key]) for key in keys if key in self.metadata)

    def _identity(self) -> str:
        """The same for equal metadata."""
        text = json.dumps(self.metadata, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:32]


def _later(tick: Tick, shift: int) -> Tick:
    """The same tick, so many ticks later on the clock; earlier for a negative shift."""
    if shift == 0:
        return tick
    observation = replace(tick.observation, time=tick.observation.time + shift * PERIOD)
    return replace(tick, index=tick.index + shift, observation=observation)
