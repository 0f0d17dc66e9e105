"""Laws of interventions and their files."""

from __future__ import annotations

import io
import json
import os
import pickle
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import learning.interventions as files
from learning.interventions import (
    Intervention,
    InterventionError,
    Metadata,
    Step,
    load_dataset,
    load_intervention,
    save_intervention,
)
from learning.step_columns import LAYOUT
from learning.steps import pack
from tests.learning.observations import METADATA, random_steps, same, slalom_drive, small_intervention
from twin.planner.params import PlannerParams
from twin.records import Command, Pose2


def test_packing_loses_nothing() -> None:
    steps = random_steps(1, 6)
    packed = pack(steps)
    assert len(packed) == 6
    for one, other, indexed in zip(steps, packed, (packed[k] for k in range(-6, 0)), strict=True):
        assert same(one.observation, other.observation)
        assert same(one.observation, indexed.observation)
        assert (one.action, one.labelled) == (other.action, other.labelled)
    assert [s.observation.time for s in packed[4:1:-2]] == [steps[4].observation.time, steps[2].observation.time]
    assert not packed[0].observation.local_map.cells.flags.writeable


def test_a_saved_intervention_comes_back_byte_for_byte(tmp_path: Path) -> None:
    one = small_intervention()
    path = save_intervention(one, tmp_path / "new" / "folder")
    other = load_intervention(path)
    assert path.name == "A1-training-seed0-001.npz"
    assert (other.kind, other.label, other.metadata) == (one.kind, one.label, one.metadata)
    assert other.digest == one.digest
    assert all(same(a.observation, b.observation) for a, b in zip(one.steps, other.steps, strict=True))


def test_a_real_drive_of_12_s_fits_into_a_few_megabytes(tmp_path: Path) -> None:
    ticks = slalom_drive(PlannerParams(), 240)
    steps = [Step(t.observation, t.decision.command or Command(0.0, 0.0)) for t in ticks]
    one = Intervention("B", "B1", steps, METADATA)
    path = save_intervention(one, tmp_path)
    assert path.stat().st_size < 3e6
    other = load_intervention(path)
    assert all(same(t.observation, s.observation) for t, s in zip(ticks, other.steps, strict=True))
    assert sum(c.nbytes for c in one.packed.columns.values()) < 8e6


def test_content_decides_the_digest() -> None:
    one = small_intervention()
    assert small_intervention().digest == one.digest
    changed = [
        small_intervention(seed=1),
        Intervention("A", "A2", one.steps, METADATA),
        Intervention("A", "A1", one.steps, replace(METADATA, seed=1)),
        Intervention("A", "A1", [replace(s, labelled=not s.labelled) for s in one.steps], METADATA),
        Intervention("A", "A1", one.steps[:2], METADATA),
    ]
    assert len({i.digest for i in [one, *changed]}) == 6


def test_no_file_is_overwritten(tmp_path: Path) -> None:
    paths = [save_intervention(small_intervention(seed), tmp_path) for seed in (0, 1, 2)]
    assert [p.name for p in paths] == [f"A1-training-seed0-{n:03d}.npz" for n in (1, 2, 3)]
    assert len({load_intervention(p).digest for p in paths}) == 3


@pytest.mark.parametrize("world", ["barn-like/150", "../../etc/passwd", "", "/a b/\N{SNOWMAN}.world#3", "x" * 500])
def test_any_world_makes_a_plain_file_name(tmp_path: Path, world: str) -> None:
    one = Intervention("A", "A1", small_intervention().steps, replace(METADATA, world=world))
    path = save_intervention(one, tmp_path)
    assert path.parent == tmp_path
    assert load_intervention(path).metadata.world == world


@pytest.mark.parametrize("broken", ["write", "fsync", "link"])
def test_a_failing_disk_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str) -> None:
    def fail(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    if broken == "write":
        monkeypatch.setattr(files, "open", lambda *_: _FullDisk(tmp_path), raising=False)
    else:
        monkeypatch.setattr(os, "fsync" if broken == "fsync" else "link", fail)
        if broken == "link":
            monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="No space left"):
        save_intervention(small_intervention(), tmp_path)
    assert list(tmp_path.iterdir()) == []


class _FullDisk(io.RawIOBase):
    def __init__(self, folder: Path) -> None:
        (folder / f".A1-{os.getpid()}-x.tmp").touch()
        self.folder = folder

    def write(self, _: Any) -> int:
        raise OSError(28, "No space left on device")

    def close(self) -> None:
        for path in self.folder.glob("*-x.tmp"):
            path.unlink()


def test_a_file_system_without_links_works_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", fail)
    for _ in range(2):
        save_intervention(small_intervention(), tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["A1-training-seed0-001.npz", "A1-training-seed0-002.npz"]


def test_a_dataset_is_sorted_and_filtered(tmp_path: Path) -> None:
    for label in ("D1", "B1", "A2", "A1", "A1"):
        save_intervention(small_intervention(label=label), tmp_path)
    (tmp_path / ".A1-1-00.tmp").write_bytes(b"half")
    (tmp_path / ".A1.npz").write_bytes(b"half")
    (tmp_path / "notes.txt").write_text("mine")
    assert [i.label for i in load_dataset(tmp_path)] == ["A1", "A1", "A2", "B1", "D1"]
    assert [i.label for i in load_dataset(tmp_path, ["B", "D"])] == ["B1", "D1"]


def test_a_useless_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InterventionError, match="no such folder"):
        load_dataset(tmp_path / "missing")
    with pytest.raises(InterventionError, match="no interventions"):
        load_dataset(tmp_path)
    save_intervention(small_intervention(), tmp_path)
    with pytest.raises(InterventionError, match="no interventions of type B, D; it has A"):
        load_dataset(tmp_path, ["B", "D"])
    with pytest.raises(InterventionError, match="unknown intervention type 'C'"):
        load_dataset(tmp_path, ["C"])


@pytest.mark.parametrize(
    ("kind", "label", "message"),
    [("C", "C1", "kind must be"), ("A", "B1", "label must be"), ("A", "A", "label"), ("A", "A1/../x", "label")],
)
def test_a_wrong_label_is_refused(kind: Any, label: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Intervention(kind, label, small_intervention().steps, METADATA)


def test_steps_that_do_not_belong_together_are_refused() -> None:
    a, b = random_steps(0, 2, 16)
    later = replace(b, observation=replace(b.observation, time=0.0))
    other_scan = replace(b, observation=replace(b.observation, scan=replace(b.observation.scan, range_max=20.0)))
    nan_pose = replace(b, observation=replace(b.observation, pose=Pose2(0.0, float("nan"), 0.0)))
    nan_scan = replace(
        b, observation=replace(b.observation, scan=replace(b.observation.scan, ranges=np.full(16, np.nan)))
    )
    inflated = replace(b.observation.local_map, cells=np.full((200, 200), 7, dtype=np.uint8))
    other_map = replace(b.observation.local_map, cells=np.zeros((100, 200), dtype=np.uint8))
    for wrong, message in [
        (later, "time must increase"),
        (other_scan, "one geometry"),
        (nan_pose, "pose must be finite"),
        (nan_scan, "ranges must be numbers"),
        (replace(b, observation=replace(b.observation, local_map=inflated)), "0 \\(free\\), 254"),
        (replace(b, observation=replace(b.observation, local_map=other_map)), "one size"),
        (replace(b, action=Command(float("inf"), 0.0)), "action must be finite"),
    ]:
        with pytest.raises(ValueError, match=message):
            pack([a, wrong])
    with pytest.raises(ValueError, match="at least one step"):
        pack([])


@pytest.mark.parametrize(
    "change",
    [
        {"source": "dream"},
        {"rewound": -1.0},
        {"seed": 1.5},
        {"seed": True},
        {"trouble_time": float("nan")},
        {"trouble_pose": Pose2(0.0, float("inf"), 0.0)},
        {"versions": {"a": 1}},
        {"world": None},
    ],
)
def test_wrong_metadata_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        replace(METADATA, **change)
    assert isinstance(METADATA, Metadata)


# ---- hostile and broken files ------------------------------------------------------------------------------------


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {m.filename: archive.read(m) for m in archive.infolist()}


def write(path: Path, content: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return path


def npy(array: Any, allow_pickle: bool = False) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=allow_pickle)
    return file.getvalue()


@pytest.fixture
def good(tmp_path: Path) -> Path:
    return save_intervention(small_intervention(), tmp_path)


def refused(path: Path, message: str) -> None:
    with pytest.raises(InterventionError, match=message) as error:
        load_intervention(path)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)
    assert len(str(error.value)) < len(str(path)) + 300


def test_a_file_cut_off_anywhere_is_refused(good: Path) -> None:
    whole = good.read_bytes()
    for cut in [0, 1, 10, *range(100, len(whole), max(1, len(whole) // 40)), len(whole) - 1]:
        good.write_bytes(whole[:cut])
        refused(good, "damaged|not a valid")


def test_a_file_with_a_flipped_byte_is_refused_or_equal(good: Path) -> None:
    whole, digest = good.read_bytes(), load_intervention(good).digest
    rng = np.random.default_rng(0)
    for at in rng.integers(0, len(whole), 150).tolist():
        good.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        try:
            assert load_intervention(good).digest == digest  # an unused byte of the archive's own headers
        except InterventionError as error:
            assert "\n" not in str(error)  # noqa: PT017


def test_foreign_files_are_refused(tmp_path: Path, good: Path) -> None:
    path = tmp_path / "x.npz"
    refused(path, "cannot read it: No such file")
    refused(tmp_path, "cannot read it: Is a directory")
    path.write_bytes(b"hello")
    refused(path, "damaged, or not an intervention file")
    path.write_bytes(pickle.dumps({"a": 1}))
    refused(path, "damaged, or not an intervention file")
    np.savez(path, a=np.zeros(3))
    refused(path, "no metadata")
    write(path, {name: data for name, data in members(good).items() if name != "pose.npy"})
    refused(path, "pose is missing")
    write(path, members(good) | {"extra.npy": npy(np.zeros(3))})
    refused(path, "'extra' is not known")


def test_a_pickle_is_never_run(tmp_path: Path, good: Path) -> None:
    class Bomb:
        def __reduce__(self) -> tuple[Any, ...]:
            return os.mkdir, (str(tmp_path / "pwned"),)

    for name in ("meta.npy", "action.npy"):
        for data in (npy(np.array([Bomb()], dtype=object), allow_pickle=True), pickle.dumps(Bomb())):
            refused(write(tmp_path / "x.npz", members(good) | {name: data}), "plain C-ordered|format 1.0")
    assert not (tmp_path / "pwned").exists()


def test_a_zip_bomb_is_not_inflated(tmp_path: Path, good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "MAX_BYTES", 2**20)
    bomb = npy(np.zeros(2**18))
    refused(write(tmp_path / "x.npz", members(good) | {"ranges.npy": bomb}), "more than 1 MB")
    lie = npy(np.zeros((1, 1))).replace(b"'shape': (1, 1), ", b"'shape': (9**9,9),")
    refused(write(tmp_path / "x.npz", members(good) | {"ranges.npy": lie}), "not a valid")
    lie = npy(np.zeros((1, 1))).replace(b"(1, 1), } ", b"(999, 999)}")
    refused(write(tmp_path / "x.npz", members(good) | {"ranges.npy": lie}), "fewer or more numbers")


def test_the_same_name_twice_is_refused(tmp_path: Path, good: Path) -> None:
    with pytest.warns(UserWarning, match="Duplicate"), zipfile.ZipFile(good, "a") as archive:
        archive.writestr("pose.npy", members(good)["pose.npy"])
    refused(good, "comes twice")


def changed_meta(good: Path, **change: Any) -> dict[str, bytes]:
    content = members(good)
    meta = json.loads(np.load(io.BytesIO(content["meta.npy"])).tobytes()) | change
    text = json.dumps({k: v for k, v in meta.items() if v != "DROP"}).encode()
    return content | {"meta.npy": npy(np.frombuffer(text, dtype=np.uint8))}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": 2, "surprise": 1}, r"newer version \(schema 2, this one reads 1\)"),
        ({"schema": 0}, "never existed"),
        ({"schema": "1"}, "no schema version"),
        ({"kind": ["A"]}, "kind must be"),
        ({"label": 5}, "label must be"),
        ({"seed": "DROP"}, "seed"),
        ({"colour": "red"}, "colour"),
        ({"trouble_pose": [1, 2, 3]}, "x, y and yaw"),
        ({"trouble_pose": {"x": "1", "y": 2, "yaw": 3}}, "finite numbers"),
        ({"rewound": float("nan")}, "finite"),
        ({"versions": [1]}, "versions"),
    ],
)
def test_wrong_metadata_in_a_file_is_refused(tmp_path: Path, good: Path, change: dict[str, Any], message: str) -> None:
    refused(write(tmp_path / "x.npz", changed_meta(good, **change)), message)


def test_a_newer_file_with_new_members_is_called_newer(tmp_path: Path, good: Path) -> None:
    content = changed_meta(good, schema=7) | {"tactile.npy": npy(np.zeros(3))}
    refused(write(tmp_path / "x.npz", content), "schema 7")


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("time", lambda a: a[::-1].copy(), "time must increase"),
        ("time", lambda a: a[:-1], "wrong shape"),
        ("pose", lambda a: a * np.nan, "pose must be finite"),
        ("pose", lambda a: a + 1e9, "pose is beyond"),
        ("pose", lambda a: a[0], "dimensions"),
        ("action", lambda a: a.astype(np.int32), "action must be float64"),
        ("ranges", lambda a: -a, "ranges must be numbers"),
        ("ranges", lambda a: a[:, :0], "beams"),
        ("scan_frame", lambda a: -a, "angles or range limits"),
        ("global_value", lambda a: a + np.uint8(1), "0 \\(free\\), 254"),
        ("global_length", lambda a: a + np.int32(2**30), "leave the map"),
        ("global_length", lambda a: a * 0, "overlap"),
        ("global_gap", lambda a: a * 0 - 1, "overlap"),
        ("local_runs", lambda a: a + 1, "do not add up"),
        ("local_runs", lambda a: -a, "do not add up"),
        ("local_shape", lambda a: a * 100, "impossible size"),
        ("local_resolution", lambda a: a * 0, "impossible resolution"),
        ("labelled", lambda a: a.view(np.uint8) + 7, "plain C-ordered|labelled must be bool"),
    ],
)
def test_wrong_columns_in_a_file_are_refused(tmp_path: Path, good: Path, name: str, change: Any, message: str) -> None:
    content = members(good)
    array = np.load(io.BytesIO(content[f"{name}.npy"]))
    refused(write(tmp_path / "x.npz", content | {f"{name}.npy": npy(np.asarray(change(array)))}), message)


def test_every_column_is_in_the_file(good: Path) -> None:
    assert {name.removesuffix(".npy") for name in members(good)} == {*LAYOUT, "meta"}
