"""Folders that commands write to."""

from __future__ import annotations

import tempfile
from pathlib import Path

from scenarios.errors import blame


def make_folder(folder: Path) -> None:
    """Make the folder unless it is there, and find out now, not after minutes of work, whether files can be written.

    Raises UserError.
    """
    with blame(f"cannot use the folder {folder}"):
        if folder.is_file():
            raise ValueError("it is a file")
        folder.mkdir(parents=True, exist_ok=True)
        try:
            tempfile.TemporaryFile(dir=folder).close()
        except OSError as error:
            raise OSError(error.errno, error.strerror) from error  # without the temporary name
