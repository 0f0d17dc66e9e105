"""BARN: geometry, files and protocols, against the published worlds and against hostile files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenarios.barn import (
    SIZE,
    PathEnds,
    c_space,
    cell_centres,
    estimated_ends,
    filled,
    hollow,
    start_and_goal,
    wall_centres,
)
from scenarios.barn_generator import generated_world, random_grid
from scenarios.worlds import WorldError, load_world
from twin.records import Pose2
from twin.world import Cylinder, World

SHARED = Path(__file__).resolve().parents[3] / "shared" / "barn"
ARCHIVE = SHARED / "barn_100.npz"
needs_barn = pytest.mark.skipif(not ARCHIVE.is_file(), reason="BARN's data (../shared/barn) is not here")


def error_of(text: str | Path, **options: str) -> str:
    """The one line that loading it raises."""
    with pytest.raises(WorldError) as caught:
        load_world(str(text), **options)
    line = str(caught.value)
    assert "\n" not in line
    assert len(line) < 400
    return line


def centres(world: World) -> np.ndarray:
    assert all(isinstance(o, Cylinder) for o in world.obstacles)
    return np.array([(o.x, o.y) for o in world.obstacles if isinstance(o, Cylinder)])


# --- against the published data --------------------------------------------------------------------------------------


@needs_barn
def test_cylinders_are_the_published_ones() -> None:
    with np.load(ARCHIVE) as data:
        assert np.allclose(sorted(wall_centres().tolist()), sorted(data["wall_xy"].tolist()), atol=1e-12)
        for grid, mask in zip(data["grids"], data["cylinder_mask"], strict=True):
            assert np.array_equal(hollow(grid), mask)


@needs_barn
def test_grids_are_recovered_from_cylinders() -> None:
    with np.load(ARCHIVE) as data:
        for grid, mask in zip(data["grids"], data["cylinder_mask"], strict=True):
            assert np.array_equal(filled(mask), grid)


@needs_barn
@pytest.mark.parametrize("index", [0, 150, 264])
def test_world_file_grid_file_and_archive_give_equal_worlds(index: int, tmp_path: Path) -> None:
    from_world = load_world(str(SHARED / "worlds" / f"world_{index}.world"))
    from_archive = load_world(f"{ARCHIVE}#{index}")
    with np.load(ARCHIVE) as data:
        row = int(np.flatnonzero(data["world_index"] == index)[0])
        path = data["path_cells"][data["path_offsets"][row] : data["path_offsets"][row + 1]]
        np.save(tmp_path / f"grid_{index}.npy", data["grids"][row])
        np.save(tmp_path / f"path_{index}.npy", path)
    from_grid = load_world(str(tmp_path / f"grid_{index}.npy"))
    assert from_world == from_archive == from_grid
    assert from_world.index == index


@needs_barn
def test_world_file_holds_what_gazebo_would_show() -> None:
    """Against the file's text, read with another parser."""
    import re

    text = (SHARED / "worlds" / "world_264.world").read_text()
    models = text.split("<state")[0].split("<model name='unit_cylinder")[1:]
    poses = [re.search(r"<pose[^>]*>([^<]*)</pose>", m) for m in models]
    published = np.array([[float(v) for v in p.group(1).split()[:2]] for p in poses if p])
    ours = centres(load_world(str(SHARED / "worlds" / "world_264.world")))
    assert len(ours) == len(published) > 96
    assert np.allclose(sorted(ours.round(6).tolist()), sorted(published.tolist()), atol=2e-6)


@needs_barn
def test_without_its_path_a_world_file_starts_in_the_middle_of_the_opening(tmp_path: Path) -> None:
    alone = tmp_path / "world_150.world"
    alone.write_bytes((SHARED / "worlds" / "world_150.world").read_bytes())
    world, exact = load_world(str(alone)), load_world(f"{ARCHIVE}#150")
    assert world.obstacles == exact.obstacles
    assert "path unknown" in world.note
    assert load_world(str(alone), "icra22").start == load_world(f"{ARCHIVE}#150", "icra22").start


@needs_barn
def test_a_file_beside_the_archive_is_recognised_by_its_cylinders(tmp_path: Path) -> None:
    (tmp_path / "barn_100.npz").write_bytes(ARCHIVE.read_bytes())
    np.save(tmp_path / "renamed.npy", load_grid(297))
    world = load_world(str(tmp_path / "renamed.npy"))
    assert (world.start, world.goal) == (load_world(f"{ARCHIVE}#297").start, load_world(f"{ARCHIVE}#297").goal)


def load_grid(index: int) -> np.ndarray:
    with np.load(ARCHIVE) as data:
        grid: np.ndarray = data["grids"][int(np.flatnonzero(data["world_index"] == index)[0])]
    return grid


@needs_barn
def test_how_far_the_estimated_start_is_off() -> None:
    """docs/worlds.md states these figures."""
    with np.load(ARCHIVE) as data:
        paths = np.split(data["path_cells"], data["path_offsets"][1:-1])
        truth = np.array([[p[0, 0], p[-1, 0]] for p in paths])
        guess = np.array([[e.first, e.last] for e in map(estimated_ends, data["grids"])])
    error = np.abs(guess - truth) * 0.15
    assert (guess == truth).mean(axis=0) == pytest.approx([0.16, 0.18])
    assert error.mean(axis=0) == pytest.approx([0.54, 0.48], abs=0.005)


# --- protocols -------------------------------------------------------------------------------------------------------


def test_protocol_table() -> None:
    ends = PathEnds(first=18, last=21)
    assert start_and_goal(ends, "2020") == (
        Pose2(pytest.approx(0.15 * 18 - 4.575), 4.075, 1.5708),
        Pose2(pytest.approx(0.15 * 21 - 4.575), pytest.approx(9.725), math.pi / 2),
    )
    assert start_and_goal(ends, "appli") == start_and_goal(ends, "2020")
    start, goal = start_and_goal(ends, "icra22")
    assert (start.x, start.y, goal.x, goal.y) == (-2.0, 3.0, -2.0, 13.0)
    assert start_and_goal(ends, "apprl")[1].y == pytest.approx(14.425)
    assert start_and_goal(PathEnds(1, 5), "2020")[0].x == -3.9
    assert start_and_goal(PathEnds(29, 5), "2020")[0].x == -0.5


@pytest.mark.parametrize(
    ("protocol", "tolerance", "limit", "clock", "stops", "line"),
    [
        ("2020", 0.15**0.5, 50.0, 0.1**0.5, False, None),
        ("appli", 0.15**0.5, 50.0, 0.1**0.5, False, None),
        ("icra22", 1.0, 100.0, 0.1, True, None),
        ("apprl", 0.4, 100.0, 0.0, False, 10.0),
    ],
)
def test_rules(protocol: str, tolerance: float, limit: float, clock: float, stops: bool, line: float | None) -> None:
    rules = load_world("barn-like/7", protocol).rules
    assert rules.protocol == protocol
    assert (rules.goal_tolerance, rules.time_limit, rules.clock_distance) == pytest.approx((tolerance, limit, clock))
    assert rules.stop_on_contact is stops
    assert rules.finish_line_y == line


def test_unknown_protocol_names_the_known_ones() -> None:
    assert "icra22" in error_of("barn-like/0", protocol="icra99")


# --- laws ------------------------------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([0.15, 0.2, 0.25, 0.3]))
def test_hollowing_and_filling_keep_what_the_robot_can_reach(seed: int, fill: float) -> None:
    """The cylinders stay the same; the grid may differ in closed pockets, which nothing can reach."""
    grid = random_grid(np.random.default_rng(seed), fill, 3)
    again = filled(hollow(grid))
    assert np.array_equal(hollow(again), hollow(grid))
    assert np.array_equal(_reachable(again), _reachable(grid))


def _reachable(grid: np.ndarray) -> np.ndarray:
    from scipy import ndimage

    regions, _ = ndimage.label(c_space(grid) == 0)
    return np.isin(regions, np.unique(regions[:, 0])) & (regions > 0)


def test_row_runs_along_x_and_column_along_y() -> None:
    assert cell_centres(np.array([[0, 0], [29, 0], [0, 29]])).tolist() == pytest.approx(
        np.array([[-4.425, 5.175], [-0.075, 5.175], [-4.425, 9.525]])
    )


# --- bad files -------------------------------------------------------------------------------------------------------

SDF = "<sdf version='1.6'><world name='default'>{}</world></sdf>"
CYLINDER = (
    "<model name='a'><pose>{} 0 0 0 0</pose><link><collision><geometry><cylinder><radius>{}</radius>"
    "<length>1</length></cylinder></geometry></collision></link></model>"
)
BOMB = "<!DOCTYPE a [<!ENTITY x 'ha'>" + "".join(
    f"<!ENTITY x{k} '{f'&x{k - 1 if k else str()};' * 10}'>" for k in range(20)
)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (BOMB + "]><sdf>&x19;</sdf>", "document types"),
        ("<!DOCTYPE a [<!ENTITY x SYSTEM 'file:///etc/passwd'>]><sdf>&x;</sdf>", "document types"),
        ("<!DOCTYPE a SYSTEM 'http://127.0.0.1:9/x.dtd'><sdf/>", "document types"),
        ("<sdf>&undefined;</sdf>", "not a complete"),
        (SDF.format("")[:40], "not a complete"),
        ("", "not a complete"),
        ("<html/>", "<html>"),
        (SDF.format(""), "no cylinders"),
        ("<sdf>" + "<a>" * 100_000, "nested too deeply"),
        (SDF.format(CYLINDER.format("nan 0", 0.075)), "six finite numbers"),
        (SDF.format(CYLINDER.format("1e400 0", 0.075)), "six finite numbers"),
        (SDF.format(CYLINDER.format("1 2", 0.5)), "radius"),
        (SDF.format(CYLINDER.format("1 2", 0.075)), "not a BARN world"),
    ],
)
def test_hostile_and_foreign_world_files(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "world_1.world"
    path.write_text(text)
    assert says in error_of(path)


@needs_barn
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_truncated_world_file(share: float, tmp_path: Path) -> None:
    whole = (SHARED / "worlds" / "world_0.world").read_bytes()
    path = tmp_path / "world_0.world"
    path.write_bytes(whole[: int(len(whole) * share)])
    assert "world_0.world:" in error_of(path)


def test_enormous_world_file(tmp_path: Path) -> None:
    path = tmp_path / "world_0.world"
    with path.open("wb") as file:
        file.truncate(30_000_000)
    assert "larger than" in error_of(path)


class Payload:
    """Would create a file when unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return Path.touch, (self.path,)  # type: ignore[return-value]


def test_pickled_arrays_are_not_opened(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    array = np.array([[Payload(victim)]], dtype=object)
    np.save(tmp_path / "grid_1.npy", array, allow_pickle=True)
    np.savez(tmp_path / "a.npz", grids=array, world_index=[0], path_cells=[[0, 0]], path_offsets=[0, 1])
    assert "cannot be read" in error_of(tmp_path / "grid_1.npy")
    assert "cannot be read" in error_of(f"{tmp_path / 'a.npz'}#0")
    assert not victim.exists()


@pytest.mark.parametrize(
    ("array", "says"),
    [
        (np.zeros((30, 29)), "shape (30, 29)"),
        (np.zeros((1, 30, 30)), "shape (1, 30, 30)"),
        (np.zeros(0), "shape (0,)"),
        (np.full((30, 30), 2), "other than 0"),
        (np.full((30, 30), np.nan), "other than 0"),
        (np.full((30, 30), "1"), "other than 0"),
    ],
)
def test_grids_that_are_none(array: np.ndarray, says: str, tmp_path: Path) -> None:
    np.save(tmp_path / "grid_3.npy", array)
    assert says in error_of(tmp_path / "grid_3.npy")


def test_truncated_and_empty_arrays(tmp_path: Path) -> None:
    grid = generated_world(0).grid
    np.save(tmp_path / "grid_0.npy", grid)
    np.savez(tmp_path / "a.npz", grids=grid)
    for name in ("grid_0.npy", "a.npz"):
        path = tmp_path / name
        whole = path.read_bytes()
        for size in (0, 5, len(whole) // 2, len(whole) - 1):
            path.write_bytes(whole[:size])
            assert "cannot be read" in error_of(f"{path}#0" if name == "a.npz" else path)


def test_archive_must_have_the_layout_and_the_world(tmp_path: Path) -> None:
    path = tmp_path / "worlds.npz"
    good = {
        "grids": generated_world(3).grid[None],
        "world_index": np.array([3]),
        "path_cells": generated_world(3).path,
        "path_offsets": np.array([0, len(generated_world(3).path)]),
    }
    np.savez(path, **good)
    assert load_world(f"{path}#3").obstacles == load_world("barn-like/3").obstacles
    assert load_world(f"{path}#3").start == load_world("barn-like/3").start
    assert "#3" in error_of(path)
    assert "index 4" in error_of(f"{path}#4")
    assert "as in" in error_of(f"{path}#-1")
    for key in good:
        np.savez(path, **{k: v for k, v in good.items() if k != key})
        assert key in error_of(f"{path}#3")
        np.savez(path, **good | {key: np.zeros((2, 2, 2))})
        assert "shape" in error_of(f"{path}#3")
    np.savez(path, **good | {"path_offsets": np.array([90, 7])})
    assert "reference path" in error_of(f"{path}#3")


def test_index_must_be_within_the_grid() -> None:
    assert "barn-like/299" in error_of("barn-like/300")
    assert "barn-like/299" in error_of("barn-like/-1")
    assert "barn-like/299" in error_of("barn-like")
    assert SIZE == 30
