"""Bags: a drive of the twin comes back as the interventions that its ticks make, whatever the format."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from learning.interventions import Intervention, Step, load_dataset
from learning.steps import pack
from scenarios.bags.files import BagError, Stamped, message
from scenarios.bags.importing import Source, read_interventions
from scenarios.bags.options import BagOptions
from scenarios.bags.recording import BEGIN, ODOM, TOPICS
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
from twin.records import STOP

FLOAT32 = 2.0**-24  # relative rounding error of a float32


def read(path: Path, out: Path | None = None, **options: Any) -> list[Intervention]:
    """The interventions of a bag."""
    return read_interventions(BagOptions(bag=path, **options), Source("room", 0), out or path.parent / "none")[0]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("bags") / "drive.mcap")


def test_a_range_of_a_bag_is_the_intervention_that_the_ticks_make(bag: Path) -> None:
    (made,) = read(bag, range=("2.5:4.5:B",))
    ticks = drive()[50:90]
    direct = pack([Step(t.observation, t.applied or STOP) for t in ticks])
    assert (made.kind, made.label, made.metadata.source, made.metadata.world) == ("B", "B1", "bag", "room")
    assert np.abs(made.packed.times - direct.times).max() < 1e-9
    # A LaserScan holds float32: a range of 30 m is off by at most 2 micrometres, a thousandth of the lidar's noise.
    assert np.array_equal(made.packed.ranges, direct.ranges.astype(np.float32).astype(np.float64))
    near = np.isfinite(direct.ranges)
    assert np.allclose(made.packed.ranges[near], direct.ranges[near], rtol=FLOAT32, atol=0.0)
    assert np.array_equal(made.packed.columns["scan_frame"], direct.columns["scan_frame"]), "of short decimals"
    assert np.array_equal(made.packed.poses[:, :2], direct.poses[:, :2])
    assert np.abs(made.packed.poses - direct.poses).max() < 1e-12, "a yaw goes through a quaternion"
    assert np.abs(made.packed.columns["goal"] - direct.columns["goal"]).max() < 1e-12
    assert np.array_equal(made.packed.columns["twist"], direct.columns["twist"])
    assert np.array_equal(made.packed.actions, direct.actions)
    for step, tick in zip(made.steps, ticks, strict=True):
        for ours, twins in (
            (step.observation.local_map, tick.observation.local_map),
            (step.observation.global_map, tick.observation.global_map),
        ):
            assert ours.origin == twins.origin
            assert np.array_equal(ours.cells, twins.cells)
    assert np.count_nonzero(made.steps[-1].observation.global_map.cells == 254) > 100


def test_ros_1_and_sqlite_bags_give_the_same_interventions(bag: Path, tmp_path: Path) -> None:
    content = said(drive())
    paths = (bag, write_sqlite(tmp_path / "ros2", content), write_ros1(tmp_path / "ros1.bag", content))
    digests = {read(path, range=("1:2:D", "2.5:3:A7"))[k].digest for path in paths for k in (0, 1)}
    assert len(digests) == 2


def test_equal_drives_give_byte_equal_bags(bag: Path, tmp_path: Path) -> None:
    assert record(tmp_path / bag.name).read_bytes() == bag.read_bytes()


def test_a_command_holds_until_its_time_out_and_then_nobody_drives(tmp_path: Path) -> None:
    content = spoilt(said(drive()), "/cmd_vel", lambda t, sent: sent if t < 3.0 else None)
    (made,) = read(write_mcap(tmp_path / "b.mcap", content), range=("2.5:4:A",))
    moving = made.packed.actions[:, 0] > 0.0
    assert moving.sum() == 15, "0.5 s of commands, the last of which holds for another 0.25 s"
    assert np.all(moving[:15])


def test_odom_begins_where_the_bag_begins(tmp_path: Path, bag: Path) -> None:
    def far(_: float, sent: Any) -> Any:
        pose = sent.pose.pose if hasattr(sent.pose, "pose") else sent.pose
        point = message("geometry_msgs/msg/Point", pose.position.x + 64.0, pose.position.y - 32.0, 0.0)
        pose = dataclasses.replace(pose, position=point)
        return dataclasses.replace(
            sent, pose=dataclasses.replace(sent.pose, pose=pose) if hasattr(sent.pose, "pose") else pose
        )

    content = spoilt(spoilt(said(drive()), "/odometry", far), "/goal", far)
    (moved,), (made,) = (read(p, range=("3:4:A",)) for p in (write_mcap(tmp_path / "b.mcap", content), bag))
    assert np.abs(moved.packed.poses - made.packed.poses).max() < 1e-12
    assert np.abs(moved.packed.columns["goal"] - made.packed.columns["goal"]).max() < 1e-12


def test_markers_say_the_same_as_ranges(tmp_path: Path, bag: Path) -> None:
    texts = [(0.0, ""), (2.5, "A1"), (3.0, "A1"), (3.5, "B"), (4.0, ""), (4.5, "B")]  # the last one until the end
    path = write_mcap(tmp_path / "b.mcap", said(drive()) + marked(texts))
    by_marker = read(path, marker="marker")
    assert [i.label for i in by_marker] == ["A1", "B1", "B2"]
    by_range = read(bag, range=("4.5:4.95:B", "2.5:3.5:A1", "3.5:4:B"))
    for a, b in zip(by_marker, by_range, strict=True):
        assert all(np.array_equal(a.packed.columns[name], b.packed.columns[name]) for name in b.packed.columns)


def test_a_bool_marks_interventions_of_one_type(tmp_path: Path) -> None:
    topics = (*TOPICS, dataclasses.replace(TOPICS[0], name="/human", type_name="std_msgs/msg/Bool"))
    flags: list[Stamped] = [
        ("/human", BEGIN + round(at * 1e9), message("std_msgs/msg/Bool", on))
        for at, on in ((0.0, False), (2.5, True), (3.5, False))
    ]
    path = write_mcap(tmp_path / "b.mcap", said(drive()) + flags, topics)
    (made,) = read(path, marker="/human", type="B", label="B4")
    assert (made.label, len(made.steps)) == ("B4", 20)
    with pytest.raises(Exception, match="--type A"):
        read(path, marker="/human")


def test_numbers_go_on_where_the_folder_ends(tmp_path: Path, bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    for _ in range(2):
        with pytest.raises(SystemExit) as stop:
            main(["collect", "--bag", str(bag), "--out", str(out), "--range", "3:3.5:A", "--range", "3.5:4:A"])
        assert stop.value.code == 0
    assert "2 interventions" in capsys.readouterr().out
    assert [i.label for i in load_dataset(out)] == ["A1", "A2", "A3", "A4"]
    assert (out / "A1-drive-seed0-001.npz").exists()


def test_a_path_leads_to_the_goal(tmp_path: Path, bag: Path) -> None:
    content = spoilt(said(drive()), "/goal", lambda *_: None)
    path = write_mcap(tmp_path / "b.mcap", content)
    for options in ({}, {"goal": "plan"}):
        (made,) = read(path, range=("3:4:A",), **options)
        assert np.abs(made.packed.columns["goal"][0] - _goal_of_the_twin()).max() < 1e-12


def test_a_goal_in_the_map_is_moved_to_odom(tmp_path: Path) -> None:
    def elsewhere(_: float, sent: Any) -> Any:
        # map_from_odom is (1, 2) and a quarter turn to the left
        x, y, yaw = _goal_of_the_twin()
        header = dataclasses.replace(sent.header, frame_id="map")
        return dataclasses.replace(sent, header=header, pose=flat_pose(1.0 - y, 2.0 + x, yaw + math.pi / 2))

    header = message("std_msgs/msg/Header", message("builtin_interfaces/msg/Time", 0, 0), "map")
    quarter = message("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
    transform = message("geometry_msgs/msg/Transform", message("geometry_msgs/msg/Vector3", 1.0, 2.0, 0.0), quarter)
    link = message("geometry_msgs/msg/TransformStamped", header, ODOM, transform)
    located: list[Stamped] = [("/tf", BEGIN, message("tf2_msgs/msg/TFMessage", [link]))]
    content = spoilt(said(drive()), "/goal", elsewhere)
    (made,) = read(write_mcap(tmp_path / "b.mcap", located + content), range=("3:4:A",))
    assert np.abs(made.packed.columns["goal"][0] - _goal_of_the_twin()).max() < 1e-9
    with pytest.raises(BagError, match="frame map"):
        read(write_mcap(tmp_path / "c.mcap", content), range=("3:4:A",))


def _goal_of_the_twin() -> np.ndarray:
    goal = drive()[0].observation.goal
    return np.array([goal.x, goal.y, goal.yaw])


def test_a_late_scan_marks_what_it_saw_from_where_it_was_taken(tmp_path: Path) -> None:
    late = [(name, at + 30_000_000 * (name == "/scan"), sent) for name, at, sent in said(drive())]
    (made,) = read(write_mcap(tmp_path / "b.mcap", late), range=("2.5:4.5:A",))
    # Ticks come 30 ms after those of the twin, and each has the scan and the pose of the twin's.
    for step, tick in zip(made.steps, drive()[50:90], strict=True):
        assert np.array_equal(step.observation.global_map.cells, tick.observation.global_map.cells)


def test_a_scan_between_two_odometry_messages_is_placed_between_their_poses(tmp_path: Path) -> None:
    # Odometry at 10 Hz instead of 20, and scans 130 ms late: every second one was taken between two poses.
    sparse = [
        (name, at + 130_000_000 * (name == "/scan"), sent)
        for name, at, sent in said(drive())
        if name != "/odometry" or at % 100_000_000 == 0
    ]
    (made,) = read(write_mcap(tmp_path / "b.mcap", sparse), range=("2.5:4.5:A",))
    pairs = [(s.observation, t.observation) for s, t in zip(made.steps, drive()[48:88], strict=True)]
    moved = [np.count_nonzero(ours.global_map.cells != twins.global_map.cells) for ours, twins in pairs]
    assert np.mean(moved) < 15, "of 238 marked cells; the older pose would move 50, the latest 180"


def test_a_jackal_under_ros_2_is_recognised(tmp_path: Path, bag: Path) -> None:
    """Its topics have a namespace, its commands a stamp."""
    names = {
        "/scan": "/j100_0042/sensors/lidar2d_0/scan",
        "/odometry": "/j100_0042/platform/odom/filtered",
        "/cmd_vel": "/j100_0042/platform/cmd_vel",
        "/tf": "/j100_0042/tf",
        "/tf_static": "/j100_0042/tf_static",
        "/plan": "/j100_0042/plan",
        "/goal": "/j100_0042/goal_pose",
    }
    stamped = "geometry_msgs/msg/TwistStamped"
    topics = [
        dataclasses.replace(t, name=names[t.name], type_name=stamped if t.name == "/cmd_vel" else t.type_name)
        for t in TOPICS
    ]
    header = message("std_msgs/msg/Header", message("builtin_interfaces/msg/Time", 0, 0), "base_link")
    content = spoilt(said(drive()), "/cmd_vel", lambda _, sent: message(stamped, header, sent))
    path = write_mcap(tmp_path / "b.mcap", [(names[name], at, sent) for name, at, sent in content], topics)
    assert read(path, range=("3:4:A",))[0].digest == read(bag, range=("3:4:A",))[0].digest


def test_without_tf_the_lidar_is_barns(tmp_path: Path, bag: Path) -> None:
    path = write_mcap(tmp_path / "b.mcap", spoilt(said(drive()), "/tf_static", lambda *_: None))
    options = BagOptions(bag=path, range=("3:4:A",))
    (made,), (remark,) = read_interventions(options, Source("room", 0), tmp_path)
    assert "front_laser" in remark
    assert made.digest == read(bag, range=("3:4:A",))[0].digest
