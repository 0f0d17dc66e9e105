"""Interventions I_i = {x_t, a_t} of the paper, and their files: one `.npz` each, a data set is a folder of them.

A file holds the columns of `step_columns.LAYOUT` and `meta`, a JSON text in bytes. No pickle in either direction.
Files come from strangers (a colleague's robot, a download), so loading trusts nothing in them.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import io
import json
import math
import os
import re
import secrets
import struct
import zipfile
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from learning.step_columns import LAYOUT
from learning.steps import PackedSteps, Step, pack
from twin.records import Pose2

__all__ = ["Intervention", "InterventionError", "Kind", "Metadata", "Source", "Step", "load_dataset",
           "load_intervention", "save_intervention"]  # fmt: skip

SCHEMA = 1
MAX_BYTES = 256 * 2**20  # of one file, inflated; a minute of driving has about 8 MB
MAX_META_BYTES = 2**20

Kind = Literal["A", "B", "D"]
Source = Literal["synthetic", "teleop", "bag"]


class InterventionError(ValueError):
    """A file or folder that holds no valid interventions; the text is one line and names it."""


@dataclass(frozen=True, slots=True)
class Metadata:
    """Where an intervention comes from."""

    world: str  # as on the command line
    seed: int
    source: Source
    trigger: str = ""  # what made the intervener act, in words
    trouble_time: float | None = None  # [s] when the trouble began; None: there was none (type D) or nobody knows
    trouble_pose: Pose2 | None = None  # odom_from_base at that time
    rewound: float = 0.0  # [s] how far back from where the trouble was noticed; 0 = not rewound
    versions: Mapping[str, str] = field(default_factory=dict)  # of appli-twin, mujoco, ...

    def __post_init__(self) -> None:
        for name, types in _METADATA_TYPES.items():
            value = getattr(self, name)
            if not isinstance(value, types) or isinstance(value, bool):
                raise ValueError(f"{name} has the wrong type ({type(value).__name__})")
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"{name} must be finite")
        if self.source not in get_args(Source):
            raise ValueError(f"source must be one of {', '.join(get_args(Source))}, not {self.source!r}")
        if self.rewound < 0.0:
            raise ValueError("rewound must be >= 0")
        pose = self.trouble_pose
        if pose is not None and not all(isinstance(v, float) and math.isfinite(v) for v in (pose.x, pose.y, pose.yaw)):
            raise ValueError("trouble_pose must be finite numbers")
        if not all(isinstance(k, str) and isinstance(v, str) for k, v in self.versions.items()):
            raise ValueError("versions must map names to texts")


_METADATA_TYPES: dict[str, tuple[type, ...]] = {
    "world": (str,),
    "seed": (int,),
    "source": (str,),
    "trigger": (str,),
    "trouble_time": (float, int, type(None)),
    "trouble_pose": (Pose2, type(None)),
    "rewound": (float, int),
    "versions": (Mapping,),
}


@dataclass(frozen=True, eq=False, slots=True)
class Intervention:
    """I_i of the paper. Any sequence of steps is taken and packed; equal content has an equal `digest`."""

    kind: Kind  # A: had to intervene, B: could improve, D: the default works here
    label: str  # the context it teaches: the kind and a number, e.g. "A1"
    steps: Sequence[Step]
    metadata: Metadata

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise ValueError(f"kind must be A, B or D, not {self.kind!r}")
        if not isinstance(self.label, str) or not re.fullmatch(rf"{self.kind}[0-9]{{1,4}}", self.label):
            raise ValueError(f"label must be {self.kind} and a number, such as {self.kind}1, not {self.label!r}")
        if not isinstance(self.steps, PackedSteps):
            object.__setattr__(self, "steps", pack(self.steps))

    @property
    def packed(self) -> PackedSteps:
        """The steps, with their columns."""
        assert isinstance(self.steps, PackedSteps)  # since __post_init__
        return self.steps

    @property
    def start_time(self) -> float:
        """[s] of the first step on the simulation's or the bag's clock."""
        return float(self.packed.times[0])

    @property
    def duration(self) -> float:
        """[s] from the first step to the last."""
        return float(self.packed.times[-1] - self.packed.times[0])

    @property
    def digest(self) -> str:
        """SHA-256 of the content, however it was compressed; a policy names its interventions by it."""
        sha = hashlib.sha256(_meta_json(self))
        for name in sorted(LAYOUT):
            column = self.packed.columns[name]
            sha.update(f"\n{name} {column.dtype.str} {column.shape}\n".encode())
            sha.update(np.ascontiguousarray(column).data)
        return sha.hexdigest()


def save_intervention(intervention: Intervention, folder: Path) -> Path:
    """Write one new file such as `A1-training-seed0-001.npz`; never overwrites, never leaves half a file.

    Raises OSError (disk full, no permission) and then leaves nothing behind.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    meta = np.frombuffer(_meta_json(intervention), dtype=np.uint8)
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, meta=meta, **intervention.packed.columns)
    temporary = folder / f".{intervention.label}-{os.getpid()}-{secrets.token_hex(4)}.tmp"
    try:
        with open(temporary, "xb") as file:
            file.write(content.getbuffer())
            file.flush()
            os.fsync(file.fileno())
        path = _publish(temporary, folder, _stem(intervention))
    finally:
        temporary.unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # not every file system can sync a folder
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    return path


def _stem(intervention: Intervention) -> str:
    world = re.sub(r"[^A-Za-z0-9_.]+", "_", intervention.metadata.world).strip("._")[-60:] or "world"
    return f"{intervention.label}-{world}-seed{intervention.metadata.seed}"


def _publish(temporary: Path, folder: Path, stem: str) -> Path:
    """Give a finished file the first free numbered name, also when other processes are doing the same."""
    for number in range(1, 1_000_000):
        path = folder / f"{stem}-{number:03d}.npz"
        if path.exists():
            continue
        try:
            os.link(temporary, path)  # fails where rename would overwrite
        except FileExistsError:
            continue
        except OSError:  # no hard links on this file system
            os.replace(temporary, path)
        return path
    raise OSError(f"{folder} has no free name for {stem}")


def _meta_json(intervention: Intervention) -> bytes:
    about = {"schema": SCHEMA, "kind": intervention.kind, "label": intervention.label}
    metadata = {f.name: getattr(intervention.metadata, f.name) for f in fields(Metadata)}
    pose = intervention.metadata.trouble_pose
    metadata["trouble_pose"] = None if pose is None else {"x": pose.x, "y": pose.y, "yaw": pose.yaw}
    metadata["versions"] = dict(intervention.metadata.versions)
    return json.dumps(about | metadata, sort_keys=True, allow_nan=False).encode()


def load_intervention(path: Path) -> Intervention:
    """Read one file. Raises InterventionError, one line, for anything that is not a valid intervention."""
    path = Path(path)
    try:
        columns = _read_members(path)
        kind, label, metadata = _parse_meta(columns.pop("meta"))
        return Intervention(kind, label, PackedSteps(columns), metadata)
    except OSError as error:
        raise InterventionError(f"{path}: cannot read it: {error.strerror or error}") from error
    except (zipfile.BadZipFile, zlib.error, EOFError, struct.error, NotImplementedError, RuntimeError) as error:
        raise InterventionError(f"{path}: damaged, or not an intervention file") from error
    except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError) as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise InterventionError(f"{path}: not a valid intervention: {text[:200]}") from error


def load_dataset(folder: Path, kinds: Iterable[str] | None = None) -> tuple[Intervention, ...]:
    """All interventions of a folder in the order of their file names, or those of some kinds ("A", "B", "D").

    Raises InterventionError when there are none. Left-over temporary files are not looked at.
    """
    folder = Path(folder)
    wanted = set(get_args(Kind)) if kinds is None else set(kinds)
    if unknown := wanted - set(get_args(Kind)):
        raise InterventionError(f"unknown intervention type {min(unknown)!r}; there are A, B and D")
    if not folder.is_dir():
        is_file = "that is a file; " if folder.is_file() else ""
        raise InterventionError(f"{folder}: {is_file}no such folder; `appli collect training --out DIR` makes one")
    paths = sorted(p for p in folder.glob("*.npz") if not p.name.startswith("."))
    if not paths:
        hint = f"`appli collect training --out {folder}` makes some"
        raise InterventionError(f"{folder}: no interventions (*.npz); {hint}")
    interventions = tuple(load_intervention(p) for p in paths)
    chosen = tuple(i for i in interventions if i.kind in wanted)
    if not chosen:
        there = ", ".join(sorted({i.kind for i in interventions}))
        raise InterventionError(f"{folder}: no interventions of type {', '.join(sorted(wanted))}; it has {there}")
    return chosen


def _read_members(path: Path) -> dict[str, NDArray[Any]]:
    """Every array of the archive by name, after its declared size has been found acceptable."""
    with open(path, "rb") as file, zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        names = [m.filename.removesuffix(".npy") for m in members]
        if "meta" not in names:
            raise ValueError("it has no metadata")
        if len(set(names)) != len(names):
            raise ValueError("a name comes twice")
        if sum(m.file_size for m in members) > MAX_BYTES:
            raise ValueError(f"it would inflate to more than {MAX_BYTES // 2**20} MB")
        _refuse_newer(_read_array(archive, members[names.index("meta")]))  # its other members may be new ones
        if strange := set(names) - LAYOUT.keys() - {"meta"}:
            raise ValueError(f"{min(strange)!r} is not known")
        return {name: _read_array(archive, member) for name, member in zip(names, members, strict=True)}


def _read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """One `.npy` member. Its own header is not trusted with an allocation: the bytes that are there must fit it."""
    content = archive.read(member)  # at most the declared size, checked against the CRC
    magic, length = content[:8], int.from_bytes(content[8:10], "little")
    if magic != b"\x93NUMPY\x01\x00":
        raise ValueError(f"{member.filename!r} is not an array of format 1.0")
    header = ast.literal_eval(content[10 : 10 + length].decode("latin1").strip())
    if not isinstance(header, dict) or header.keys() != {"descr", "fortran_order", "shape"}:
        raise ValueError(f"{member.filename!r} has a strange header")
    descr, shape = header["descr"], header["shape"]
    if descr not in ("<f8", "<i4", "|u1", "|b1") or header["fortran_order"] not in (False, 0):
        raise ValueError(f"{member.filename!r} must be a plain C-ordered array, not {str(descr)[:20]!r}")
    if not isinstance(shape, tuple) or not all(type(n) is int and 0 <= n <= MAX_BYTES for n in shape) or len(shape) > 2:
        raise ValueError(f"{member.filename!r} has an impossible shape")
    data = content[10 + length :]
    if math.prod(shape) * np.dtype(descr).itemsize != len(data):
        raise ValueError(f"{member.filename!r} holds fewer or more numbers than it says")
    if descr == "|b1" and data.strip(b"\x00\x01"):
        raise ValueError(f"{member.filename!r} must hold truth values")
    return np.frombuffer(data, dtype=descr).reshape(shape)


def _meta_of(column: NDArray[Any]) -> dict[str, Any]:
    if column.dtype != np.uint8 or column.ndim != 1 or len(column) > MAX_META_BYTES:
        raise ValueError("its metadata is no text")
    meta = json.loads(column.tobytes())
    if not isinstance(meta, dict) or type(meta.get("schema")) is not int:
        raise ValueError("its metadata has no schema version")
    return meta


def _refuse_newer(column: NDArray[Any]) -> None:
    schema = _meta_of(column)["schema"]
    if schema > SCHEMA:
        raise ValueError(f"written by a newer version (schema {schema}, this one reads {SCHEMA}); update appli-twin")
    if schema < 1:
        raise ValueError(f"schema {schema} never existed")


def _parse_meta(column: NDArray[Any]) -> tuple[Kind, str, Metadata]:
    meta = _meta_of(column)
    expected = {"schema", "kind", "label"} | {f.name for f in fields(Metadata)}
    if meta.keys() != expected:
        raise ValueError(f"its metadata should have {', '.join(sorted(expected ^ meta.keys()))} (or should not)")
    del meta["schema"]
    kind, label, pose = meta.pop("kind"), meta.pop("label"), meta.pop("trouble_pose")
    if pose is not None:
        if not isinstance(pose, dict) or pose.keys() != {"x", "y", "yaw"}:
            raise ValueError("trouble_pose must have x, y and yaw")
        pose = Pose2(**{k: float(v) if isinstance(v, int) else v for k, v in pose.items()})
    return kind, label, Metadata(trouble_pose=pose, **meta)
