"""Recordings of a drive that is wound back, and of what a classifier thinks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.test_recording import column, rerun
from tests.ticks import WORLD, drive
from twin.recording import Judge, Recorder, read_recording
from twin.recording.plots import evidence_entity
from twin.recording.recorder import PERIOD, REWIND_TICKS
from twin.records import Command, Scan, Tick

FIRST, BACK_TO, LAST = 40, 60, 120  # ticks of the default's drive; wound back to
LABELS = ("A1", "a / b", "B2")


def failed_and_shown() -> tuple[list[Tick], list[Tick]]:
    """The default's drive, and a person's from earlier on."""
    ticks = [replace(tick, override=None) for tick in drive(200)]
    shown = [replace(tick, override=Command(0.3, 0.1), clearance=2.0) for tick in ticks[BACK_TO : BACK_TO + 70]]
    return ticks[FIRST : LAST + 1], shown


def record(path: Path) -> tuple[list[Tick], list[Tick]]:
    failed, shown = failed_and_shown()
    with Recorder(path, WORLD, {"driver": "dwa", "seed": 0}, headline="intervention A1: stuck") as recorder:
        recorder.begin("default", "the default drives")
        for tick in failed:
            recorder.add(tick)
        recorder.rewind([tick for tick in failed if tick.index >= BACK_TO], "wound back")
        recorder.begin("demonstration", "a person shows A1")
        for tick in shown:
            recorder.add(tick)
    return failed, shown


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("phases") / "run.rrd"
    record(path)
    return path


def test_the_clock_never_goes_back_and_nothing_is_lost(path: Path) -> None:
    failed, shown = failed_and_shown()
    recording = read_recording(path)
    clearance, again = recording.scalars["clearance"], recording.lanes["phase"].ticks[2]  # the demonstration's first
    assert LAST + 1 < again <= LAST + 1 + REWIND_TICKS
    assert clearance.ticks.tolist() == [*range(FIRST, LAST + 1), *range(again, again + len(shown))]
    np.testing.assert_allclose(clearance.times, clearance.ticks * PERIOD, atol=1e-9)
    assert clearance.values.tolist() == [tick.clearance for tick in failed + shown]


def test_the_lane_says_who_drives_when(path: Path) -> None:
    recording = read_recording(path)
    lane = recording.lanes["phase"]
    assert lane.states == ("default", "rewound", "demonstration")
    assert [lane.at(FIRST), lane.at(LAST), lane.at(LAST + 1)] == ["default", "default", "rewound"]
    human = recording.scalars["command/human/v"]
    assert lane.at(int(human.ticks[0])) == "demonstration"
    assert lane.ticks[2] == human.ticks[0]
    assert [text for _, text in recording.events if "context" not in text] == [
        "the default drives",
        "wound back",
        "a person shows A1",
    ]


def test_the_way_back_is_shown(path: Path) -> None:
    """The robot goes back along its drive, and no line is drawn for that."""
    failed, shown = failed_and_shown()
    poses = [value[0][:2] for value in column(path, "world/robot", "Transform3D:translation")]
    back = poses[len(failed) : len(poses) - len(shown)]
    assert 2 <= len(back) <= REWIND_TICKS
    xs = [x for x, _ in back]
    assert xs == sorted(xs, reverse=True)
    assert failed[-1].true_pose.x == pytest.approx(xs[0])
    assert shown[0].true_pose.x <= xs[-1] < failed[-1].true_pose.x
    strips = [np.array(line[0]) for line in column(path, "world/trail", "LineStrips3D:strips")]
    assert len(strips) == len(failed) - 1 + len(shown) - 1
    assert max(np.linalg.norm(strip[1] - strip[0]) for strip in strips) < 0.1


def test_what_was_recorded_verifies_and_is_equal_twice(path: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.rrd"
    record(again)
    assert rerun("verify", path) == 0
    assert rerun("compare", path, again) == 0


def test_a_phase_without_a_rewind_goes_on_where_the_last_ended(tmp_path: Path) -> None:
    failed, shown = failed_and_shown()
    with Recorder(tmp_path / "run.rrd", WORLD) as recorder:
        recorder.begin("default", "the default drives")
        for tick in failed:
            recorder.add(tick)
        recorder.rewind([], "nothing to wind back")
        recorder.begin("demonstration", "a person takes over")
        for tick in shown:
            recorder.add(tick)
    recording = read_recording(tmp_path / "run.rrd")
    assert recording.lanes["phase"].states == ("default", "demonstration")
    assert recording.scalars["clearance"].ticks.tolist() == list(range(FIRST, LAST + 1 + len(shown)))


def test_a_drive_without_phases_has_no_lane_for_them(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run.rrd", WORLD) as recorder:
        for tick in drive(5):
            recorder.add(tick)
    assert "phase" not in read_recording(tmp_path / "run.rrd").entities


# --- what a classifier thinks


def evidence(scan: Scan) -> dict[str, float]:
    """Something that depends on the scan; sometimes nothing at all."""
    near = float(np.min(scan.ranges))
    return {} if near < 1.6 else {label: near * (k + 1) for k, label in enumerate(LABELS)}


def test_evidence_and_threshold_read_back_equal(tmp_path: Path) -> None:
    ticks = list(drive(120))
    with Recorder(tmp_path / "run.rrd", WORLD, judge=Judge(LABELS, 0.8, evidence)) as recorder:
        for tick in ticks:
            recorder.add(tick)
    scalars = read_recording(tmp_path / "run.rrd").scalars
    judged = [(tick.index, found) for tick in ticks if (found := evidence(tick.observation.scan))]
    assert 0 < len(judged) < len(ticks)
    for label in LABELS:
        series = scalars[evidence_entity(label)]
        assert series.ticks.tolist() == [index for index, _ in judged]
        assert series.values.tolist() == [found[label] for _, found in judged]
    assert scalars["appli/threshold"].values.tolist() == [0.8] * len(ticks)


def test_without_a_threshold_there_is_no_line(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run.rrd", WORLD, judge=Judge(LABELS, None, evidence)) as recorder:
        for tick in drive(5):
            recorder.add(tick)
    assert "appli/threshold" not in read_recording(tmp_path / "run.rrd").scalars
