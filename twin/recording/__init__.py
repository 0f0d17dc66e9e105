"""Recordings: ticks to `.rrd` and back. The only package that imports Rerun, so import it only where one is needed."""

from twin.recording.reading import Recording, read_recording
from twin.recording.recorder import Recorder
from twin.recording.sink import RecordingError

__all__ = ["Recorder", "Recording", "RecordingError", "read_recording"]
