"""ROS maps and meshes as worlds."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from scenarios.imported import rectangles
from scenarios.worlds import WorldError, load_world
from twin.free_space import free_space
from twin.world import Box, Mesh, World

YAML = "image: map.pgm\nresolution: 0.05\norigin: [{}]\nnegate: {}\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
WALLED = np.full((80, 120), 254, dtype=np.uint8)  # 6 x 4 m, walls 0.05 m round it
WALLED[[0, -1]] = 0
WALLED[:, [0, -1]] = 0


def ros_map(
    tmp_path: Path, image: np.ndarray = WALLED, origin: str = "0, 0, 0", negate: int = 0, more: str = ""
) -> str:
    Image.fromarray(image).save(tmp_path / "map.pgm")
    (tmp_path / "map.yaml").write_text(YAML.format(origin, negate) + more)
    return str(tmp_path / "map.yaml")


def error_of(text: str, start: str | None = "1,1,0", goal: str | None = "4,3") -> str:
    with pytest.raises(WorldError) as caught:
        load_world(text, start=start, goal=goal)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# --- maps ------------------------------------------------------------------------------------------------------------


@settings(max_examples=50, deadline=None)
@given(arrays(np.bool_, st.tuples(st.integers(1, 12), st.integers(1, 12))))
def test_rectangles_cover_exactly_the_occupied_cells_once(occupied: np.ndarray) -> None:
    count = np.zeros(occupied.shape, dtype=int)
    for y0, x0, y1, x1 in rectangles(occupied):
        count[y0:y1, x0:x1] += 1
    assert np.array_equal(count, occupied.astype(int))


def test_map_of_a_room(tmp_path: Path) -> None:
    world = load_world(ros_map(tmp_path), start="1,1,0", goal="5,3")
    assert len(world.obstacles) == 4
    space = free_space(world, 0.01)
    # the free room is 5.9 x 3.9 m: its middle is 1.95 m from the nearest wall
    assert space.at(np.array([[3.0, 2.0]]))[0] == pytest.approx(1.95, abs=0.02)
    assert space.at(np.array([[0.025, 2.0], [5.975, 2.0], [3.0, 0.025], [3.0, 3.975]])).max() < 0
    assert world.rules.protocol == "course"


def test_first_row_of_the_image_is_the_far_side(tmp_path: Path) -> None:
    image = np.full((40, 40), 254, dtype=np.uint8)
    image[2:4, 5:9] = 0  # columns 5..9, third and fourth row from the top
    (box,) = load_world(ros_map(tmp_path, image), start="1,0.5,0", goal="1,1").obstacles
    assert isinstance(box, Box)
    assert (box.x, box.y, box.length, box.width) == pytest.approx((0.35, 0.05 * 37, 0.2, 0.1))


def test_origin_moves_and_turns_the_map(tmp_path: Path) -> None:
    image = np.full((40, 40), 254, dtype=np.uint8)
    image[39, 39] = 0  # lower right: cell centre at (1.975, 0.025) of the map
    (box,) = load_world(ros_map(tmp_path, image, f"10, -5, {np.pi / 2}"), start="8.5,-4,0", goal="9,-4").obstacles
    assert isinstance(box, Box)
    assert (box.x, box.y) == pytest.approx((10 - 0.025, -5 + 1.975))
    assert box.yaw == pytest.approx(np.pi / 2)


def test_threshold_and_negate(tmp_path: Path) -> None:
    image = np.full((40, 40), 254, dtype=np.uint8)
    image[10, 10] = 89  # (255 - 89) / 255 = 0.651: occupied
    image[20, 20] = 90  # 0.647: not
    image[30, 30] = 205  # unknown: floor
    assert len(load_world(ros_map(tmp_path, image), start="1.5,1.9,0", goal="1,1").obstacles) == 1
    assert len(load_world(ros_map(tmp_path, 255 - image, negate=1), start="1.5,1.9,0", goal="1,1").obstacles) == 1


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "LA", "P", "1", "I;16"])
def test_kinds_of_image(tmp_path: Path, mode: str) -> None:
    ros_map(tmp_path)
    image = Image.fromarray(WALLED)
    deep = Image.fromarray(WALLED.astype(np.uint16) * 257)
    (deep if mode == "I;16" else image.convert(mode)).save(tmp_path / "map.png")
    text = (tmp_path / "map.yaml").read_text()
    (tmp_path / "map.yaml").write_text(text.replace("map.pgm", "map.png"))
    assert len(load_world(str(tmp_path / "map.yaml"), start="1,1,0", goal="4,3").obstacles) == 4


def test_start_and_goal_in_the_file(tmp_path: Path) -> None:
    path = ros_map(tmp_path, more="start: [1, 1, 0.5]\ngoal: [5, 3]\n")
    world = load_world(path)
    assert (world.start.x, world.start.yaw, world.goal.x, world.goal.y) == (1.0, 0.5, 5.0, 3.0)
    assert load_world(path, goal="4,2").goal.x == 4.0


def test_what_to_type_when_start_or_goal_is_missing_works(tmp_path: Path) -> None:
    path = ros_map(tmp_path)
    message = error_of(path, None, None)
    options = dict(word[2:].split("=") for word in message.split() if word.startswith("--"))
    world = load_world(path, start=options["start"], goal=options["goal"])
    space = free_space(world)
    assert space.reachable(world.start, 0.25)[tuple(space.cells(np.array([[world.goal.x, world.goal.y]]))[0])]
    assert np.hypot(world.goal.x - world.start.x, world.goal.y - world.start.y) > 3.0
    assert "does not say goal" in error_of(path, "1,1,0", None)
    assert "--start=1.00,1.00,0.00" in error_of(path, "1,1,0", None)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("image: map.pgm", "image: ../map.pgm"), "outside the map's folder"),
        (("image: map.pgm", "image: /etc/passwd"), "outside the map's folder"),
        (("image: map.pgm", "image: link.pgm"), "outside the map's folder"),
        (("image: map.pgm", "image: none.pgm"), "does not exist"),
        (("image: map.pgm", "image: map.yaml"), "cannot be read as an image"),
        (("image: map.pgm", "image: 3"), "image is missing"),
        (("image: map.pgm\n", ""), "image is missing"),
        (("resolution: 0.05\n", ""), "resolution is missing"),
        (("resolution: 0.05", "resolution: 0"), "resolution must be"),
        (("resolution: 0.05", "resolution: .nan"), "resolution must be"),
        (("resolution: 0.05", "resolution: -1"), "resolution must be"),
        (("origin: [0, 0, 0]", "origin: [0, .inf, 0]"), "origin must be"),
        (("origin: [0, 0, 0]", "origin: [99999, 0, 0]"), "up to 1000"),
        (("origin: [0, 0, 0]\n", ""), "origin is missing"),
        (("negate: 0", "negate: maybe"), "negate must be"),
        (("negate: 0", "mode: raw"), "mode"),
        (("negate: 0", "a: ["), "not YAML"),
        (("negate: 0", "a: !!python/object/apply:os.system [ls]"), "not YAML"),
    ],
)
def test_bad_maps(tmp_path: Path, change: tuple[str, str], says: str) -> None:
    (tmp_path / "maps").mkdir()
    Image.fromarray(WALLED).save(tmp_path / "map.pgm")
    (tmp_path / "maps" / "link.pgm").symlink_to(tmp_path / "map.pgm")
    path = Path(ros_map(tmp_path / "maps"))
    path.write_text(path.read_text().replace(*change))
    assert says in error_of(str(path))


def test_maps_that_are_too_large(tmp_path: Path) -> None:
    path = ros_map(tmp_path)
    (tmp_path / "map.pgm").write_bytes(b"P5\n100000 100000\n255\n")
    assert "limit" in error_of(path)
    checkers = np.indices((400, 400)).sum(axis=0) % 2 * 255
    assert "boxes" in error_of(ros_map(tmp_path, checkers.astype(np.uint8)))
    (tmp_path / "map.yaml").write_text("#" * 100_000)
    assert "too large" in error_of(path)


@pytest.mark.parametrize("text", ["", "just text", "- 1\n- 2\n", "\x00"])
def test_files_that_are_no_maps(tmp_path: Path, text: str) -> None:
    (tmp_path / "map.yaml").write_text(text)
    assert "map.yaml has" in error_of(str(tmp_path / "map.yaml"))


def test_truncated_image(tmp_path: Path) -> None:
    path = ros_map(tmp_path)
    whole = (tmp_path / "map.pgm").read_bytes()
    (tmp_path / "map.pgm").write_bytes(whole[: len(whole) // 2])
    assert "cannot be read as an image" in error_of(path)


# --- meshes ----------------------------------------------------------------------------------------------------------


def room(floor: float = 0.0) -> trimesh.Trimesh:
    """8 x 6 x 2.5 m inside, walls and slab 0.1 m thick, a cupboard of 1 x 1 x 1 m in the middle."""

    def box(x: float, y: float, z: float, *size: float) -> trimesh.Trimesh:
        return trimesh.creation.box(size, trimesh.transformations.translation_matrix((x, y, z + floor)))

    return trimesh.util.concatenate(
        [
            box(0, 3.05, 1.25, 8.2, 0.1, 2.5),
            box(0, -3.05, 1.25, 8.2, 0.1, 2.5),
            box(4.05, 0, 1.25, 0.1, 6, 2.5),
            box(-4.05, 0, 1.25, 0.1, 6, 2.5),
            box(0, 0, -0.05, 8.2, 6.2, 0.1),
            box(0, 0, 0.5, 1, 1, 1),
        ]
    )


def the_mesh(world: World) -> Mesh:
    (mesh,) = world.obstacles
    assert isinstance(mesh, Mesh)
    return mesh


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb"])
@pytest.mark.parametrize("floor", [0.0, -1.7])
def test_room(tmp_path: Path, suffix: str, floor: float) -> None:
    room(floor).export(tmp_path / f"room.{suffix}")
    world = load_world(str(tmp_path / f"room.{suffix}"), start="-3,-2,0", goal="3,2")
    mesh = the_mesh(world)
    assert mesh.vertices[:, 2].max() == pytest.approx(2.5, abs=1e-5)
    # nothing that the wheels would stand on is left: every triangle reaches above the floor
    assert mesh.vertices[mesh.faces][:, :, 2].max(axis=1).min() > 0.02
    space = free_space(world, 0.05)
    near = space.at(np.array([[-2.0, 0.0], [0.0, 2.0], [3.5, 0.0]]))
    assert near == pytest.approx([1.5, 1.0, 0.5], abs=0.05)
    assert space.reachable(world.start, 0.3)[tuple(space.cells(np.array([[3.0, 2.0]]))[0])]


def test_glb_as_its_standard_says_y_up(tmp_path: Path) -> None:
    mesh = room()
    mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))
    mesh.export(tmp_path / "room.glb")
    turned = the_mesh(load_world(str(tmp_path / "room.glb"), start="-3,-2,0", goal="3,2"))
    assert turned.vertices.min(axis=0)[:2] == pytest.approx([-4.1, -3.1], abs=1e-5)
    assert turned.vertices[:, 2].max() == pytest.approx(2.5, abs=1e-5)


def test_start_inside_furniture_or_wall(tmp_path: Path) -> None:
    room().export(tmp_path / "room.ply")
    for start in ("0,0,0", "0.6,0,0", "3.95,1,0"):
        assert "start inside an obstacle" in error_of(str(tmp_path / "room.ply"), start)


def test_what_to_type_for_a_mesh_works(tmp_path: Path) -> None:
    room().export(tmp_path / "room.ply")
    message = error_of(str(tmp_path / "room.ply"), None, None)
    options = dict(word[2:].split("=") for word in message.split() if word.startswith("--"))
    world = load_world(str(tmp_path / "room.ply"), start=options["start"], goal=options["goal"])
    assert max(abs(world.start.x), abs(world.goal.x)) < 4
    assert max(abs(world.start.y), abs(world.goal.y)) < 3


def test_scale_must_be_metres(tmp_path: Path) -> None:
    for factor in (1000.0, 0.001):
        mesh = room()
        mesh.apply_scale(factor)
        mesh.export(tmp_path / "room.stl")
        assert "metres" in error_of(str(tmp_path / "room.stl"))


@pytest.mark.parametrize(
    ("name", "data", "says"),
    [
        ("a.obj", b"", "no triangles"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\n", "no triangles"),
        ("a.obj", b"v 0 0 nan\nv 5 0 0\nv 0 5 1\nf 1 2 3\n", "not finite"),
        ("a.obj", b"v 0 0 0\nv 5 0 0\nv 0 5 1\nf 1 2 9\n", "cannot be read"),
        ("a.obj", b"v 0 0 0\nv 5 0 0\nv 0 5 0\nf 1 2 3\n", "nothing that stands above"),
        ("a.stl", b"\0" * 80 + b"\xff\xff\xff\xff" + b"\0" * 100, "no triangles"),
        ("a.stl", b"\xff" * 50, ""),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1000000000\nproperty float x\nend_header\n", ""),
        ("a.ply", b"not a ply", ""),
        ("a.glb", b"glTF" + struct.pack("<II", 2, 10**9) + b"\xff" * 20, "cannot be read"),
        ("a.glb", b"", "cannot be read"),
    ],
)
def test_bad_meshes(tmp_path: Path, name: str, data: bytes, says: str) -> None:
    (tmp_path / name).write_bytes(data)
    message = error_of(str(tmp_path / name))
    assert says in message
    assert name in message


def test_meshes_open_no_other_file(tmp_path: Path) -> None:
    """The material library that an .obj names is not looked for, so it cannot fail either."""
    room().export(tmp_path / "room.obj")
    path = tmp_path / "room.obj"
    path.write_text("mtllib ../../../../etc/passwd\nusemtl x\n" + path.read_text())
    assert the_mesh(load_world(str(path), start="-3,-2,0", goal="3,2"))


def test_too_many_triangles(tmp_path: Path) -> None:
    faces = np.tile([[0, 1, 2]], (1_000_001, 1))
    data = np.zeros(len(faces), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    data["v"] = [[0, 0, 0], [5, 0, 0], [0, 5, 1]]
    (tmp_path / "a.stl").write_bytes(b"\0" * 80 + struct.pack("<I", len(faces)) + data.tobytes())
    assert "simplify" in error_of(str(tmp_path / "a.stl"))


def test_too_large_a_file(tmp_path: Path) -> None:
    with (tmp_path / "a.stl").open("wb") as file:
        file.truncate(300_000_000)
    assert "larger than" in error_of(str(tmp_path / "a.stl"))
