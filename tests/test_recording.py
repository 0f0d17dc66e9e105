"""Recordings: what goes in comes out, equal ticks give equal files, and nothing that goes wrong is silent."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from tests.ticks import WORLD, drive
from twin.planner.params import PARAMETER_NAMES
from twin.recording import Recorder, RecordingError, drawing, palette, read_recording
from twin.recording.recorder import BATCH
from twin.recording.scenery import section
from twin.recording.sink import HEADER, PREAMBLE, whole_messages
from twin.records import Command, ObstacleMap, Pose2, Tick
from twin.world import Mesh, Rules, World

METADATA = {"driver": "appli", "seed": 3}


def record(path: Path, ticks: list[Tick], world: World = WORLD) -> Path:
    with Recorder(path, world, METADATA) as recorder:
        for tick in ticks:
            recorder.add(tick)
    return path


def rerun(*arguments: str | Path) -> int:
    """The exit code of Rerun's own command line."""
    command = [sys.executable, "-m", "rerun", "rrd", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, timeout=120, check=False).returncode


def column(path: Path, entity: str, component: str) -> list[Any]:
    """All values of one component, in the order of ticks."""
    rows: list[tuple[int, Any]] = []
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        if chunk.entity_path == f"/{entity}" and component in batch.schema.names and "tick" in batch.schema.names:
            rows += zip(batch.column("tick").to_pylist(), batch.column(component).to_pylist(), strict=True)
    return [value for _, value in sorted(rows, key=lambda row: row[0])]


@pytest.fixture(scope="module")
def ticks() -> list[Tick]:
    return list(drive(240))


@pytest.fixture(scope="module")
def path(ticks: list[Tick], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recording") / "run.rrd", ticks)


# --- what goes in comes out


def test_rerun_finds_no_fault(path: Path) -> None:
    assert rerun("verify", path) == 0
    assert len(RrdReader(path).blueprints()) == 1


def test_scalars_read_back_equal(path: Path, ticks: list[Tick]) -> None:
    scalars = read_recording(path).scalars
    expected: dict[str, Callable[[Tick], float]] = {
        "odometry/v": lambda t: t.observation.twist.v,
        "odometry/w": lambda t: t.observation.twist.w,
        "clearance": lambda t: t.clearance,
        "appli/confidence": lambda t: t.decision.confidence or 0.0,
    }
    for k, name in enumerate(PARAMETER_NAMES):
        expected[f"params/{name}"] = lambda t, k=k: float(t.decision.theta.as_array()[k])  # type: ignore[misc]
    for name, value in expected.items():
        series = scalars[name]
        assert series.ticks.tolist() == [t.index for t in ticks], name
        np.testing.assert_array_equal(series.values, [value(t) for t in ticks], name)
        np.testing.assert_allclose(series.times, [t.observation.time for t in ticks], atol=1e-9)


def test_commands_and_costs_have_gaps_where_there_were_none(path: Path, ticks: list[Tick]) -> None:
    scalars = read_recording(path).scalars
    sources: dict[str, Callable[[Tick], Command | None]] = {
        "planner": lambda t: t.decision.command,
        "human": lambda t: t.override,
        "applied": lambda t: t.applied,
    }
    for source, command in sources.items():
        sent = [(t.index, c) for t in ticks if (c := command(t)) is not None]
        assert 0 < len(sent) < len(ticks)
        for part in ("v", "w"):
            series = scalars[f"command/{source}/{part}"]
            assert series.ticks.tolist() == [index for index, _ in sent]
            assert series.values.tolist() == [getattr(c, part) for _, c in sent]
    chosen = [t for t in ticks if t.decision.arc is not None]
    assert scalars["arc/cost"].values.tolist() == [t.decision.arc.cost for t in chosen if t.decision.arc]


def test_lanes_read_back_equal_at_every_tick(path: Path, ticks: list[Tick]) -> None:
    lanes = read_recording(path).lanes
    assert [lanes["appli/context"].at(t.index) for t in ticks] == [t.decision.context for t in ticks]
    assert [lanes["planner/state"].at(t.index) for t in ticks] == [t.decision.state for t in ticks]
    assert len(lanes["appli/context"].ticks) == 4  # changes only
    assert lanes["appli/context"].at(-1) is None


def test_events_and_metadata(path: Path, ticks: list[Tick]) -> None:
    recording = read_recording(path)
    last = ticks[-1].index
    assert recording.metadata == {"world": "posts", "protocol": "course", "driver": "appli", "seed": "3"}
    assert recording.events[0] == (0, "start, 9.1 m to the goal")
    assert (last - 1, "recovery 1: rotate_recovery") in recording.events
    assert [text for tick, text in recording.events if tick == last][1:] == ["collided after 12.00 s"]
    assert any("contact with cylinder_0001" in text for _, text in recording.events)


def test_only_simulated_time_is_logged(path: Path) -> None:
    """A wall-clock timeline would make two recordings of one run differ."""
    timelines = {name for chunk in RrdReader(path).stream().to_chunks() for name in chunk.timeline_names}
    assert timelines == {"sim_time", "tick"}


def test_what_the_robot_believes_is_drawn_where_it_truly_is(path: Path, ticks: list[Tick]) -> None:
    """odom has drifted away from world by a fixed pose (tests/ticks.py); scans are in the sensor's frame."""
    for entity in ("world/local_costmap", "world/global_path"):
        for translation in column(path, entity, "Transform3D:translation"):
            np.testing.assert_allclose(translation[0], (0.1, -0.05, 0.0), atol=1e-6)
    flat = column(path, "world/plan/scan", "Points3D:positions")
    posts = np.array([(o.x, o.y) for o in WORLD.obstacles[:5]])  # type: ignore[union-attr]
    for points in flat[::20]:
        away = np.linalg.norm(np.array(points)[:, None, :2] - posts, axis=2).min(axis=1)
        np.testing.assert_allclose(away, 0.2, atol=1e-4)
    scans = column(path, "world/robot/scan", "Points3D:positions")
    ranges = [t.observation.scan.ranges[np.isfinite(t.observation.scan.ranges)] for t in ticks]
    for points, expected in zip(scans, ranges, strict=True):
        np.testing.assert_allclose(np.linalg.norm(np.array(points).reshape(-1, 3), axis=1), expected, rtol=1e-6)


def test_a_recording_is_small_and_quick(path: Path, tmp_path: Path) -> None:
    many = list(drive(600))
    with Recorder(tmp_path / "run.rrd", WORLD) as recorder:
        recorder.add(many[0])
        began = time.process_time()
        for tick in many[1:]:
            recorder.add(tick)
        spent = time.process_time() - began
    assert spent / len(many) < 0.003  # s of all threads; a tick of the simulation takes 3 to 5 ms
    assert (tmp_path / "run.rrd").stat().st_size * 1200 / len(many) < 30e6  # bytes a minute


# --- equal ticks, equal files


def test_equal_ticks_give_equal_recordings(path: Path, ticks: list[Tick], tmp_path: Path) -> None:
    again = record(tmp_path / "again.rrd", list(drive(240)))
    assert rerun("compare", path, again) == 0
    other = record(tmp_path / "other.rrd", [*ticks[:-1], replace(ticks[-1], clearance=0.9)])
    assert rerun("compare", path, other) != 0


# --- whatever happens, the file is closed and readable


def test_an_interrupt_closes_the_recording(tmp_path: Path, ticks: list[Tick]) -> None:
    path = tmp_path / "run.rrd"

    def run() -> None:
        with Recorder(path, WORLD) as recorder:
            for tick in ticks[: BATCH + 7]:
                recorder.add(tick)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run()
    assert rerun("verify", path) == 0
    assert read_recording(path).scalars["clearance"].ticks.tolist() == list(range(BATCH + 7))


def test_a_killed_run_leaves_a_readable_file(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    code = (
        "import os, sys, time; from pathlib import Path; from tests.ticks import WORLD, drive\n"
        "from twin.recording import Recorder\n"
        "recorder = Recorder(Path(sys.argv[1]), WORLD)\n"
        f"[recorder.add(tick) for tick in drive({2 * BATCH + 5})]\n"
        "time.sleep(1); os._exit(9)"
    )
    assert subprocess.run([sys.executable, "-c", code, path], timeout=120, check=False).returncode == 9
    assert len(read_recording(path).scalars["clearance"].ticks) == 2 * BATCH


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_is_one_clear_error(ticks: list[Tick]) -> None:
    with pytest.raises(RecordingError, match=r"^cannot write the recording /dev/full: no space left on device$"):
        record(Path("/dev/full"), ticks)


def test_a_disk_that_fills_up_leaves_what_fitted(tmp_path: Path) -> None:
    """Under a limit of the file size, which fails a write just as a full disk does."""
    path = tmp_path / "run.rrd"
    code = (
        "import resource, sys; from pathlib import Path; from tests.ticks import WORLD, drive\n"
        "from twin.recording import Recorder, RecordingError\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, 2_000_000))\n"
        "try:\n"
        "    with Recorder(Path(sys.argv[1]), WORLD) as recorder:\n"
        "        [recorder.add(tick) for tick in drive(400)]\n"
        "except RecordingError as error:\n"
        "    print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code, path], timeout=120, check=True, capture_output=True, text=True)
    assert done.stdout == f"cannot write the recording {path}: file too large\n"
    assert done.stderr == ""
    assert 0 < path.stat().st_size <= 2_000_000
    assert len(read_recording(path).scalars["clearance"].ticks) % BATCH == 0


def test_what_stopped_the_run_is_not_hidden_by_the_disk(ticks: list[Tick]) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full")
    with pytest.raises(ZeroDivisionError), Recorder("/dev/full", WORLD):
        raise ZeroDivisionError


@pytest.mark.parametrize("name", ["missing/run.rrd", "."])
def test_an_unwritable_path_is_refused_at_once(tmp_path: Path, name: str) -> None:
    with pytest.raises(RecordingError, match=r"^cannot write the recording .*: (no such file|is a directory)"):
        Recorder(tmp_path / name, WORLD)
    assert list(tmp_path.iterdir()) == []


def test_closing_twice_and_recording_nothing(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.rrd", WORLD)
    recorder.close()
    recorder.close()
    assert rerun("verify", tmp_path / "run.rrd") == 0
    assert read_recording(tmp_path / "run.rrd").scalars == {}


def test_no_open_files_are_left(tmp_path: Path, ticks: list[Tick]) -> None:
    if not Path("/proc/self/fd").exists():
        pytest.skip("no /proc")
    record(tmp_path / "warm.rrd", ticks[:3])
    before = len(os.listdir("/proc/self/fd"))
    for k in range(5):
        record(tmp_path / f"{k}.rrd", ticks[:3])
    assert len(os.listdir("/proc/self/fd")) <= before


@pytest.mark.parametrize("content", [None, b"", b"RRF2", b"hello " * 100])
def test_reading_something_else_is_one_clear_error(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "x.rrd"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"^cannot read the recording [^\n]*$"):
        read_recording(path)


def test_an_empty_world_can_be_recorded(tmp_path: Path, ticks: list[Tick]) -> None:
    world = World("open", (), Pose2(0.0, 0.0, 0.0), Pose2(6.0, 0.0, 0.0), Rules("course", 0.5, 60.0))
    seen, decision = ticks[0].observation, ticks[0].decision
    seen = replace(seen, scan=replace(seen.scan, ranges=np.full(720, np.inf)))
    decision = replace(decision, candidates=None, global_path=None, local_costmap=None, arc=None)
    bare = replace(ticks[0], clearance=float("inf"), observation=seen, decision=decision)
    assert rerun("verify", record(tmp_path / "run.rrd", [bare], world)) == 0


# --- the shapes that are drawn


def test_arcs_are_those_of_a_unicycle() -> None:
    straight, circle = drawing.roll_out(np.array([(0.5, 0.0), (0.5, 1.0)]))
    np.testing.assert_allclose(straight[-1, :2], (1.0, 0.0), atol=1e-6)
    turn = np.linspace(0.0, drawing.ROLLOUT_TIME, drawing.ROLLOUT_POINTS)
    np.testing.assert_allclose(circle[:, :2], 0.5 * np.column_stack([np.sin(turn), 1.0 - np.cos(turn)]), atol=1e-6)


def test_illegal_arcs_are_red_and_the_cheapest_lies_on_top(ticks: list[Tick]) -> None:
    tries = np.array([(0.3, w, cost) for w, cost in ((0.0, 5.0), (0.4, -1.0), (0.8, 50.0), (1.2, 1.0))])
    arcs = drawing.candidate_arcs(replace(ticks[0].decision, candidates=tries))
    np.testing.assert_array_equal(arcs.colours[0], palette.ILLEGAL_ARC)
    np.testing.assert_allclose(arcs.points[-1], drawing.roll_out(np.array([(0.3, 1.2)]))[0])
    many = np.tile(tries, (400, 1))
    drawn = drawing.candidate_arcs(replace(ticks[0].decision, candidates=many))
    assert 0 < len(drawn.colours) <= drawing.MOST_ARCS


def test_wheels_in_the_chassis_frame(ticks: list[Tick]) -> None:
    wheels = drawing.wheels_on_chassis(np.array([tick.body_poses for tick in ticks]))
    expected = [(x, y, 0.0345, 1.0, 0.0, 0.0, 0.0) for x in (0.131, -0.131) for y in (0.188, -0.188)]
    np.testing.assert_allclose(wheels, np.broadcast_to(expected, wheels.shape), atol=1e-9)


def test_the_costmap_image_is_upright() -> None:
    cells = np.zeros((4, 3), dtype=np.uint8)
    cells[0, 2] = 254  # lower right
    image = drawing.costmap_image(ObstacleMap(cells, (0.0, 0.0), 0.05, (0.0, 0.0, 0.0, 0.0)))
    assert image.shape == (4, 3, 4)
    np.testing.assert_array_equal(image[-1, 2], palette.COSTMAP[254])
    assert image[..., 3].sum() == palette.COSTMAP[254, 3]


def test_the_section_of_a_pyramid_is_a_square() -> None:
    corners = np.array([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.0, 2.0, 0.0), (0.0, 2.0, 0.0), (1.0, 1.0, 1.0)])
    cut = section(Mesh(corners, np.array([(0, 1, 4), (1, 2, 4), (4, 2, 3), (3, 4, 0)])), 0.25)
    assert cut.shape == (4, 2, 2)
    np.testing.assert_allclose(np.abs(cut - 1.0).max(axis=2), 0.75)
    np.testing.assert_allclose(np.linalg.norm(cut[:, 1] - cut[:, 0], axis=1), 1.5)
    assert len(section(Mesh(corners, np.array([(0, 1, 4)])), 1.5)) == 0


def test_messages_are_never_cut() -> None:
    message = HEADER.pack(2, 5) + b"12345"
    stream = b"x" * PREAMBLE + 2 * message
    wholes = [whole_messages(stream[:n], PREAMBLE) for n in range(len(stream) + 1)]
    assert set(wholes) == {0, PREAMBLE + len(message), len(stream)}
    assert whole_messages(message + HEADER.pack(0, 3) + b"end index", 0) == len(message)
