"""Bags that cannot be read, used or written: one line each, and nothing half-done."""

from __future__ import annotations

import dataclasses
import errno
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.bags.files import BagError, BagReader, BagWriter, Stamped, message
from scenarios.bags.recording import BEGIN, TOPICS
from scenarios.cli import main
from tests.scenarios.bag_writing import (
    drive,
    flat_pose,
    marked,
    record,
    said,
    spoilt,
    write_mcap,
    write_ros1,
    write_sqlite,
)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("bags") / "drive.mcap")


def complaint(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line of a refused command."""
    with pytest.raises(SystemExit) as stop:
        main([*arguments])
    said_so = capsys.readouterr()
    assert (stop.value.code, said_so.out) == (2, ""), said_so.err
    lines = said_so.err.strip().splitlines()
    assert len(lines) == 1, said_so.err
    assert lines[0].startswith("appli: ")
    return lines[0]


def without(topic: str, start: float = 0.0, end: float = math.inf) -> Callable[[list[Stamped]], list[Stamped]]:
    return lambda content: [s for s in content if not (s[0] == topic and start <= (s[1] - BEGIN) / 1e9 < end)]


def replaced(topic: str, since: float, **fields: Any) -> Callable[[list[Stamped]], list[Stamped]]:
    return lambda content: spoilt(
        content, topic, lambda t, sent: dataclasses.replace(sent, **fields) if t >= since else sent
    )


def _nan(content: list[Stamped]) -> list[Stamped]:
    return replaced("/scan", 2.7, ranges=np.full(720, np.nan, dtype=np.float32))(content)


def _backwards(content: list[Stamped]) -> list[Stamped]:
    header = message("std_msgs/msg/Header", message("builtin_interfaces/msg/Time", 1, 0), "front_laser")
    return replaced("/scan", 2.0, header=header)(content)


def _other_clock(content: list[Stamped]) -> list[Stamped]:
    header = message("std_msgs/msg/Header", message("builtin_interfaces/msg/Time", 1000, 0), "front_laser")
    return replaced("/scan", 0.0, header=header)(content)


def _broken_pose(content: list[Stamped]) -> list[Stamped]:
    pose = message("geometry_msgs/msg/PoseWithCovariance", flat_pose(math.nan, 0.0, 0.0), np.zeros(36))
    return replaced("/odometry", 2.0, pose=pose)(content)


def _far_goal(content: list[Stamped]) -> list[Stamped]:
    return replaced("/goal", 0.0, pose=flat_pose(31.0, 0.0, 0.0))(content)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (without("/scan"), "no lidar .*it has .*odometry .nav_msgs/Odometry"),
        (without("/odometry"), "no odometry"),
        (without("/cmd_vel"), "no commands"),
        (lambda content: without("/goal")(without("/plan")(content)), "no goal"),
        (without("/scan", 2.0, 3.2), "/scan is silent at 2.5"),
        (without("/odometry", 2.0, 3.2), "/odometry is silent at 2.5"),
        (without("/cmd_vel", 1.0), "/cmd_vel is silent within"),
        (without("/scan", 0.0, 2.7), "before lidar and odometry"),
        (lambda c: [(n, t + 2_700_000_000 * (n == "/goal"), m) for n, t, m in c], "before the first goal, at 2.70 s"),
        (_nan, "at 2.70 s /scan has 720 ranges"),
        (_backwards, "/scan at 2.00 s has a stamp 1.950 s before"),
        (_other_clock, "clocks synchronised"),
        (_broken_pose, "/odometry at 2.00 s holds nan"),
        (_far_goal, "the goal is at"),
        (lambda content: content[:0], "an empty bag|no such file"),
    ],
)
def test_a_spoilt_bag_is_refused_with_one_line(
    spoil: Callable[[list[Stamped]], list[Stamped]], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "b.mcap"
    write_mcap(path, spoil(said(drive()[:64])))
    line = complaint(capsys, "collect", "--bag", str(path), "--out", str(tmp_path / "out"), "--range", "2.5:3:A")
    assert re.search(words, line), line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "--range START:END:TYPE or --marker TOPIC"),
        (["--range", "1:2:A", "--marker", "/marker"], "one of the two"),
        (["--range", "1:2"], "--type A"),
        (["--range", "2:1:A"], "START:END"),
        (["--range", "1:2:C"], "START:END"),
        (["--range", "one:2:A"], "START:END"),
        (["--range", "0:500:A"], "at most 40 s"),
        (["--range", "3:30:A"], "4.95 s long"),
        (["--range", "1.01:1.02:A"], "no step"),
        (["--range", "1:2:A", "--label", "C1"], "A1"),
        (["--range", "1:2", "--label", "A1", "--type", "B"], "contradict"),
        (["--range", "1:2:A", "--scan", "/front/scan"], "/scan (sensor_msgs/LaserScan)"),
        (["--range", "1:2:A", "--scan", "/tf"], "takes sensor_msgs/LaserScan"),
        (["--range", "1:2:A", "--goal", "/cmd_vel"], "geometry_msgs/PoseStamped or nav_msgs/Path"),
        (["--marker", "/human"], "no topic /human"),
        (["--range", "1:2:A", "--record"], "--record"),
        (["--range", "1:2:A", "--no-rewind"], "--no-rewind"),
    ],
)
def test_mistakes_on_the_command_line(
    arguments: list[str], words: str, bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = complaint(capsys, "collect", "--bag", str(bag), "--out", str(tmp_path / "out"), *arguments)
    assert words in line, line


def test_collect_needs_a_world_or_a_bag(capsys: pytest.CaptureFixture[str]) -> None:
    assert "WORLD or --bag" in complaint(capsys, "collect", "--out", "out")
    assert "--bag FILE" in complaint(capsys, "collect", "open", "--out", "out", "--marker", "/m")


def test_markers_that_mark_nothing_or_nonsense(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, text, words in (("a", "", "no intervention in it"), ("b", "hello", "'hello' at 2.00 s")):
        path = write_mcap(tmp_path / f"{name}.mcap", said(drive()[:60]) + marked([(0.0, ""), (2.0, text)]))
        assert words in complaint(capsys, "collect", "--bag", str(path), "--out", "out", "--marker", "/marker")


def test_files_that_are_no_whole_bags(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = said(drive()[:40])
    (tmp_path / "text.bag").write_text("no bag")
    (tmp_path / "cut.mcap").write_bytes(bag.read_bytes()[: bag.stat().st_size // 2])
    (tmp_path / "cut.bag").write_bytes(write_ros1(tmp_path / "whole.bag", content).read_bytes()[:20_000])
    (tmp_path / "folder").mkdir()
    (tmp_path / "drive.txt").write_text("no bag")
    cut = next(write_sqlite(tmp_path / "cut", content).glob("*.db3"))
    cut.write_bytes(cut.read_bytes()[:30_000])
    damaged = bytearray(bag.read_bytes())
    damaged[1000:3000] = bytes(2000)
    (tmp_path / "damaged.mcap").write_bytes(damaged)
    for name, words in {
        "missing.bag": "no such file",
        "text.bag": "rosbag reindex",
        "cut.mcap": "mcap recover",
        "cut.bag": "rosbag reindex",
        "folder": "metadata.yaml",
        "drive.txt": "not a bag",
        "cut": "ros2 bag reindex",
        "damaged.mcap": "mcap recover",
    }.items():
        line = complaint(capsys, "collect", "--bag", str(tmp_path / name), "--out", "out", "--range", "1:2:A")
        assert words in line, line


def test_places_where_no_bag_can_be_written(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = bag.read_bytes()
    for path, words in (
        (str(bag), "exists already"),
        ("/dev/null/at/all.mcap", "cannot use the folder /dev/null/at"),
        ("/proc/all.mcap", "cannot use the folder /proc"),
        ("drive.bag", ".mcap"),
    ):
        assert words in complaint(capsys, "run", "open", "--record-bag", path)
    assert bag.read_bytes() == before


def test_an_interrupt_leaves_a_whole_bag_and_a_failure_none(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        record(tmp_path / "b.mcap", interrupted_at=30)
    with BagReader(tmp_path / "b.mcap") as written:
        assert sum(1 for _ in written.messages(["/scan"])) == 30
    with BagWriter(tmp_path / "empty.mcap", TOPICS):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["b.mcap"], "nothing aside, and no bag without a message"


@pytest.mark.parametrize("fails", ["write", "close"])
def test_a_full_disk_is_one_line_and_leaves_nothing(
    fails: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(f"rosbags.rosbag2.storage_mcap.McapWriter.{fails}", full)
    with pytest.raises(BagError, match="no space left"):
        record(tmp_path / "b.mcap")
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_full_at_the_very_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("rosbags.rosbag2.storage_mcap.McapWriter.close", full)
    assert "no space left" in complaint(capsys, "run", "open", "--record-bag", str(tmp_path / "b.mcap"))
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_closes_the_bag(tmp_path: Path) -> None:
    path = tmp_path / "b.mcap"
    child = subprocess.Popen(
        [sys.executable, "-m", "scenarios", "run", "training", "--record-bag", str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and not any(p.stat().st_size > 10_000 for p in tmp_path.rglob("*.mcap")):
        time.sleep(0.02)
    child.send_signal(signal.SIGINT)
    _, err = child.communicate(timeout=60)
    assert child.returncode == 130, err
    assert [p.name for p in tmp_path.iterdir()] == ["b.mcap"]
    with BagReader(path) as written:
        assert sum(1 for _ in written.messages(["/scan", "/odometry", "/tf"])) % 3 == 0, "whole ticks only"
