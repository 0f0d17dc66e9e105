"""BARN's files: Gazebo worlds (*.world), grids (*.npy) and many worlds in one archive (*.npz). All are distrusted."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from scenarios.barn import (
    CELL,
    COLUMN0_Y,
    RADIUS,
    ROW0_X,
    SIZE,
    Grid,
    PathEnds,
    estimated_ends,
    filled,
    hollow,
    wall_centres,
)
from scenarios.world_checks import WorldError
from twin.records import Array

MAX_WORLD_BYTES = 20_000_000  # the largest of the 300 published files has 0.8 MB
MAX_ARRAY_BYTES = 200_000_000  # an archive of 300 worlds unpacks to 0.6 MB
MAX_CYLINDERS = 5_000
_TOLERANCE = 1e-3  # [m] world files carry six decimals

NPZ_ARRAYS = ("grids", "world_index", "path_cells", "path_offsets")


def read_world_file(path: Path) -> tuple[Grid, PathEnds, int]:
    """Grid, path ends and world index of a Gazebo world as BARN publishes it (world_N.world)."""
    centres = read_cylinders(path)
    grid = _grid_of(path, centres)
    index = file_index(path)
    return grid, find_ends(path, index, grid), index


def read_grid_file(path: Path) -> tuple[Grid, PathEnds, int]:
    """Grid, path ends and world index of one of BARN's own grid files (grid_N.npy)."""
    grid = _as_grid(path, read_npy(path))
    index = file_index(path)
    return grid, find_ends(path, index, grid), index


def read_archive(path: Path, fragment: str) -> tuple[Grid, PathEnds, int]:
    """Grid, path ends and world index of world `#K` in an archive laid out like barn_100.npz."""
    arrays = _load_npz(path)
    indices = arrays["world_index"]
    first, last = int(indices[0]), int(indices[-1])
    if not fragment:
        raise WorldError(f"{path} holds {len(indices)} worlds; name one, as in {path}#{first}")
    if not re.fullmatch(r"\d{1,6}", fragment):
        raise WorldError(f"{path}#{fragment}: after # comes a BARN world index, as in {path}#{first}")
    index = int(fragment)
    rows = np.flatnonzero(indices == index)
    if not len(rows):
        near = sorted(indices.tolist(), key=lambda k: abs(k - index))[:3]
        raise WorldError(
            f"{path} has no world with index {index} (it has {len(indices)} of {first}..{last}); "
            f"the nearest are {', '.join(f'#{k}' for k in sorted(near))}"
        )
    row = int(rows[0])
    return _as_grid(path, arrays["grids"][row]), _ends_in_archive(path, arrays, row), index


def archive_indices(path: Path) -> list[int]:
    """The world indices in an archive laid out like barn_100.npz, in its order."""
    return [int(index) for index in _load_npz(path)["world_index"]]


def file_index(path: Path) -> int:
    """The number at the end of the name, as in world_150.world; 0 without one."""
    match = re.search(r"(\d{1,6})$", path.stem)
    return int(match.group(1)) if match else 0


def find_ends(path: Path, index: int, grid: Grid) -> PathEnds:
    """Ends of the reference path from files beside this one, else estimated.

    Looked for: path_N.npy in the same folder, in ../path_files and in ./path_files (BARN's own layout), and
    barn_100.npz in the same folder or the one above, where the world is recognised by its cylinders.
    """
    name = f"path_{index}.npy"
    for candidate in (path.parent / name, path.parent.parent / "path_files" / name, path.parent / "path_files" / name):
        if candidate.is_file():
            return _ends_of_path(candidate, read_npy(candidate))
    for candidate in (path.parent / "barn_100.npz", path.parent.parent / "barn_100.npz"):
        if candidate.is_file():
            arrays = _load_npz(candidate)
            cylinders = hollow(grid)  # not the grid: it may differ in a closed pocket (`filled`)
            for row, known in enumerate(arrays["grids"]):
                if np.array_equal(hollow(_as_grid(candidate, known)), cylinders):
                    return _ends_in_archive(candidate, arrays, row)
    return estimated_ends(grid)


# --- Gazebo worlds ---------------------------------------------------------------------------------------------------


def read_cylinders(path: Path) -> Array:
    """(n, 2) [m] centres of the collision cylinders in a Gazebo world.

    Document types are refused, so that no entity can be defined: no expansion bombs, no external files.
    """
    if path.stat().st_size > MAX_WORLD_BYTES:
        raise WorldError(f"{path} is larger than {MAX_WORLD_BYTES // 10**6} MB; BARN's world files have below 1 MB")
    reader = _WorldReader()
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = reader.refuse
    parser.EntityDeclHandler = reader.refuse
    parser.StartElementHandler = reader.start
    parser.EndElementHandler = reader.end
    parser.CharacterDataHandler = reader.text
    try:
        parser.Parse(path.read_bytes(), True)
    except expat.ExpatError as error:
        what = expat.ErrorString(error.code)
        raise WorldError(f"{path}:{error.lineno}: not a complete Gazebo world ({what}); copy the file again") from None
    except _RefusedError as error:
        line = parser.CurrentLineNumber
        raise WorldError(f"{path}:{line}: {error}; use a world file as BARN publishes it") from None
    if not reader.centres:
        raise WorldError(f"{path} has no cylinders; use a BARN world (world_0.world ... world_299.world)")
    return np.array(reader.centres)


class _RefusedError(Exception):
    pass


class _WorldReader:
    """Collects sdf/world/model with pose and collision cylinder; everything else is ignored."""

    def __init__(self) -> None:
        self.centres: list[tuple[float, float]] = []
        self._path: list[str] = []
        self._text = ""
        self._values: dict[str, str] = {}

    def refuse(self, *_: object) -> None:
        raise _RefusedError("document types and entities are refused")

    def start(self, tag: str, _: Mapping[str, str]) -> None:
        if not self._path and tag != "sdf":
            raise _RefusedError(f"the file begins with <{tag}> instead of <sdf>")
        if len(self._path) > 50:
            raise _RefusedError("elements are nested too deeply")
        self._path.append(tag)
        self._text = ""
        if self._path == ["sdf", "world", "model"]:
            self._values = {}

    def text(self, data: str) -> None:
        if len(self._text) < 1000:
            self._text += data

    def end(self, _: str) -> None:
        if self._path[:3] == ["sdf", "world", "model"]:
            place = "/".join(self._path[3:])
            if place in ("pose", "link/collision/geometry/cylinder/radius"):
                self._values[place] = self._text
            elif place == "" and "link/collision/geometry/cylinder/radius" in self._values:
                self._add_model()
        self._path.pop()
        self._text = ""

    def _add_model(self) -> None:
        pose = _numbers(self._values.get("pose", ""))
        radius = _numbers(self._values["link/collision/geometry/cylinder/radius"])
        if len(pose) != 6 or len(radius) != 1:
            raise _RefusedError("a cylinder has no pose of six finite numbers")
        if abs(radius[0] - RADIUS) > _TOLERANCE or max(map(abs, pose[2:])) > _TOLERANCE:
            raise _RefusedError(f"a cylinder is not BARN's (radius {RADIUS} m, upright, at z = 0)")
        self.centres.append((pose[0], pose[1]))
        if len(self.centres) > MAX_CYLINDERS:
            raise _RefusedError(f"there are more than {MAX_CYLINDERS} cylinders")


def _numbers(text: str) -> list[float]:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        return []
    return values if np.isfinite(values).all() else []


def _grid_of(path: Path, centres: Array) -> Grid:
    """The grid behind the cylinders; WorldError when they are not exactly a BARN field and its containment wall."""
    cells = (centres - [ROW0_X, COLUMN0_Y]) / CELL
    near = np.rint(cells).astype(np.int64)
    off = np.abs(cells - near).max(axis=1) > _TOLERANCE / CELL
    inside = ~off & ((near >= 0) & (near < SIZE)).all(axis=1)
    wall = set(map(tuple, np.rint((wall_centres() - [ROW0_X, COLUMN0_Y]) / CELL).astype(int).tolist()))
    outside = set(map(tuple, near[~inside & ~off].tolist()))
    if off.any() or outside != wall:
        raise WorldError(
            f"{path} is not a BARN world: its cylinders do not stand on BARN's grid with its containment wall; "
            "write other worlds as a course (*.toml, see docs/worlds.md)"
        )
    mask = np.zeros((SIZE, SIZE), dtype=np.uint8)
    mask[tuple(near[inside].T)] = 1
    return filled(mask)


# --- numpy files -----------------------------------------------------------------------------------------------------


def read_npy(path: Path) -> NDArray[np.generic]:
    """The array of an .npy file; never unpickles."""
    if path.stat().st_size > MAX_ARRAY_BYTES:
        raise WorldError(f"{path} is larger than {MAX_ARRAY_BYTES // 10**6} MB; a BARN grid has 30 x 30 cells")
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError, MemoryError) as error:
        raise WorldError(f"{path} cannot be read as a plain .npy array ({_one_line(error)}); copy it again") from None
    if not isinstance(array, np.ndarray):
        raise WorldError(f"{path} is an archive; rename it to .npz and name a world, as in {path.stem}.npz#0")
    return array


def _load_npz(path: Path) -> dict[str, NDArray[np.generic]]:
    """The four arrays that are needed, with their shapes checked; never unpickles."""
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > MAX_ARRAY_BYTES:
                raise WorldError(f"{path} unpacks to more than {MAX_ARRAY_BYTES // 10**6} MB; it is not a BARN archive")
        with np.load(path, allow_pickle=False) as archive:
            missing = [name for name in NPZ_ARRAYS if name not in archive]
            if missing:
                raise WorldError(
                    f"{path} has no array {missing[0]!r}; a BARN archive has {', '.join(NPZ_ARRAYS)} (docs/worlds.md)"
                )
            arrays = {name: archive[name] for name in NPZ_ARRAYS}
    except (ValueError, OSError, EOFError, MemoryError, zipfile.BadZipFile, NotImplementedError) as error:
        if isinstance(error, WorldError):
            raise
        raise WorldError(f"{path} cannot be read as an .npz archive ({_one_line(error)}); copy it again") from None
    count = len(np.atleast_1d(arrays["world_index"]))
    shapes = {
        "grids": (count, SIZE, SIZE),
        "world_index": (count,),
        "path_cells": (len(np.atleast_1d(arrays["path_cells"])), 2),
        "path_offsets": (count + 1,),
    }
    for name, shape in shapes.items():
        if arrays[name].shape != shape or arrays[name].dtype.kind not in "iub" or not count:
            raise WorldError(f"{path}: {name} has shape {arrays[name].shape}; integers of shape {shape} are needed")
    return arrays


def _as_grid(path: Path, array: NDArray[np.generic]) -> Grid:
    if array.shape != (SIZE, SIZE):
        raise WorldError(f"{path} has shape {array.shape}; a BARN grid has shape ({SIZE}, {SIZE}), index [row, col]")
    if array.dtype.kind not in "iubf" or not np.isin(array, (0, 1)).all():
        raise WorldError(f"{path} holds values other than 0 (free) and 1 (obstacle); it is not a BARN grid")
    return array.astype(np.uint8)


def _ends_in_archive(path: Path, arrays: Mapping[str, NDArray[np.generic]], row: int) -> PathEnds:
    begin, end = int(arrays["path_offsets"][row]), int(arrays["path_offsets"][row + 1])  # type: ignore[call-overload]
    return _ends_of_path(path, arrays["path_cells"][max(begin, 0) : max(end, 0)])


def _ends_of_path(path: Path, cells: NDArray[np.generic]) -> PathEnds:
    """From a reference path (n, 2) of [row, col] that goes from column 0 to column 29."""
    good = cells.ndim == 2 and len(cells) > 1 and cells.shape[1] == 2 and cells.dtype.kind in "iuf"
    ends = np.asarray(cells[[0, -1]], dtype=np.float64) if good else np.full((2, 2), np.nan)
    if not (np.isin(ends, np.arange(SIZE)).all() and ends[0, 1] == 0 and ends[1, 1] == SIZE - 1):
        raise WorldError(f"{path}: the reference path must be [row, col] cells from column 0 to column {SIZE - 1}")
    return PathEnds(int(ends[0, 0]), int(ends[1, 0]))


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__
