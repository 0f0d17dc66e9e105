"""Recordings: ticks to `.rrd` and back. The only package that imports Rerun, so import it only where one is needed."""

from twin.recording.comparison import write_comparison
from twin.recording.judge import Judge
from twin.recording.reading import Recording, read_recording
from twin.recording.recorder import Recorder
from twin.recording.sink import RecordingError
from twin.recording.viewer import Viewer, ViewerError

__all__ = [
    "Judge",
    "Recorder",
    "Recording",
    "RecordingError",
    "Viewer",
    "ViewerError",
    "read_recording",
    "write_comparison",
]
