"""The viewer as a process: on loopback only, fed while a drive is running, and two recordings side by side in it."""

from __future__ import annotations

import socket
import subprocess
import time
import urllib.request
from contextlib import suppress
from pathlib import Path

import pytest
from rerun.chunk import RrdReader

from tests.test_recording import rerun
from tests.ticks import WORLD, drive
from twin.recording import Recorder, RecordingError, Viewer, ViewerError, read_recording, write_comparison
from twin.recording.comparison import first_tick
from twin.recording.viewer import LOOPBACK, viewer_program
from twin.world import World


def record(path: Path, method: str = "dwa", seed: int = 0, count: int = 60, world: World = WORLD) -> Path:
    with Recorder(path, world, {"method": method, "seed": seed}) as recorder:
        for tick in drive(count, seed):
            recorder.add(tick)
    return path


# --- side by side


def test_a_comparison_holds_all_of_both(tmp_path: Path) -> None:
    a, b = record(tmp_path / "a.rrd", count=60), record(tmp_path / "b.rrd", "A+B+c", count=90)
    both = tmp_path / "both.rrd"
    write_comparison(a, b, both)
    assert rerun("verify", both) == 0
    found = read_recording(both)
    for side, source in (("a/", a), ("b/", b)):
        alone = read_recording(source)
        assert {side + entity for entity in alone.entities if not entity.startswith("__")} <= found.entities
        for name, series in alone.scalars.items():
            assert found.scalars[side + name].ticks.tolist() == series.ticks.tolist()
            assert found.scalars[side + name].values.tolist() == series.values.tolist()
        for name, lane in alone.lanes.items():
            assert found.lanes[side + name] == lane
    reader = RrdReader(both)
    order = [(first_tick(chunk), chunk.entity_path[:3]) for chunk in reader.stream().to_chunks()]
    begins = [tick for tick, side in order if side in ("/a/", "/b/")]
    assert begins == sorted(begins), "both sides come in together"
    assert len(reader.recordings()) == 1
    assert len(reader.blueprints()) == 1
    applications = {store.application_id for store in (*reader.recordings(), *reader.blueprints())}
    assert len(applications) == 1, "the layout belongs to the comparison"
    assert applications != {store.application_id for store in RrdReader(a).recordings()}, "and to nothing else"


def test_a_comparison_opens_with_both_in_sight(tmp_path: Path) -> None:
    a, b = record(tmp_path / "a.rrd"), record(tmp_path / "b.rrd", "A+B+c")
    write_comparison(a, b, tmp_path / "both.rrd")
    reader = RrdReader(tmp_path / "both.rrd")
    text = ""
    for chunk in reader.stream(store=reader.blueprints()[0]).to_chunks():
        text += str(chunk.to_record_batch().to_pydict())
    for title in ("a: dwa", "b: A+B+c", "/a/world", "/b/world", "/a/odometry/v", "/b/odometry/v"):
        assert title in text


def test_recordings_of_two_worlds_are_not_compared(tmp_path: Path) -> None:
    other = World("elsewhere", WORLD.obstacles, WORLD.start, WORLD.goal, WORLD.rules)
    a, b = record(tmp_path / "a.rrd"), record(tmp_path / "b.rrd", world=other)
    with pytest.raises(RecordingError, match=r"posts.*elsewhere"):
        write_comparison(a, b, tmp_path / "both.rrd")
    assert not (tmp_path / "both.rrd").exists()


# --- the process


def refused(port: int, address: str) -> bool:
    try:
        socket.create_connection((address, port), timeout=2.0).close()
    except OSError:
        return True
    return False


def test_a_page_is_served_to_this_machine_only_and_ends_with_the_viewer(tmp_path: Path) -> None:
    with Viewer([record(tmp_path / "run.rrd")], web=True) as viewer:
        assert viewer.page is not None
        with urllib.request.urlopen(viewer.page, timeout=20.0) as answer:
            assert b"rerun" in answer.read().lower()
        ports = [int(url.split(":")[-1].split("/")[0]) for url in (viewer.url, viewer.page.split("/?")[0])]
        assert len(set(ports)) == 2
        for port in ports:
            assert not refused(port, LOOPBACK)
            assert refused(port, "127.0.0.2"), "all of 127.0.0.0/8 reaches whoever listens on every interface"
    assert all(refused(port, LOOPBACK) for port in ports)


def test_a_taken_port_is_one_clear_error() -> None:
    with socket.socket() as taken:
        taken.bind((LOOPBACK, 0))
        taken.listen()
        with pytest.raises(ViewerError, match=r"^port \d+ is taken$"):
            Viewer(web=True, port=taken.getsockname()[1])


def test_without_a_display_there_is_no_window(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twin.recording.viewer.has_display", lambda: False)
    with pytest.raises(ViewerError, match="no display"):
        Viewer()


def test_a_viewer_gets_what_is_recorded_and_the_file_is_the_same(tmp_path: Path) -> None:
    """The receiver is Rerun itself, which writes down what comes in."""
    with socket.socket() as free:
        free.bind((LOOPBACK, 0))
        port = free.getsockname()[1]
    received = tmp_path / "received.rrd"
    command = [viewer_program(), "--save", str(received), "--bind", LOOPBACK, "--port", str(port)]
    receiver = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 20.0
        while refused(port, LOOPBACK):
            assert time.monotonic() < deadline, "the receiver does not start"
            time.sleep(0.1)
        with Recorder(tmp_path / "watched.rrd", WORLD, viewer=f"rerun+http://{LOOPBACK}:{port}/proxy") as recorder:
            for tick in drive(60):
                recorder.add(tick)
        time.sleep(1.0)
    finally:
        receiver.send_signal(2)
        with suppress(subprocess.TimeoutExpired):
            receiver.wait(10.0)
        receiver.kill()
    assert read_recording(received).scalars["clearance"].ticks.tolist() == list(range(60))
    with Recorder(tmp_path / "alone.rrd", WORLD) as recorder:
        for tick in drive(60):
            recorder.add(tick)
    assert rerun("compare", tmp_path / "watched.rrd", tmp_path / "alone.rrd") == 0


def test_a_viewer_that_goes_away_does_not_stop_the_recording(tmp_path: Path) -> None:
    ticks = list(drive(120))
    with Viewer(web=True) as viewer, Recorder(tmp_path / "run.rrd", WORLD, viewer=viewer.url) as recorder:
        for tick in ticks[:60]:
            recorder.add(tick)
        viewer.close()
        for tick in ticks[60:]:
            recorder.add(tick)
    assert rerun("verify", tmp_path / "run.rrd") == 0
    assert read_recording(tmp_path / "run.rrd").scalars["clearance"].ticks.tolist() == list(range(120))
