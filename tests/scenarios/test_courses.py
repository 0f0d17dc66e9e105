"""Courses: the TOML format, its errors, and the geometry of the built-in courses."""

from __future__ import annotations

import heapq
import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from scenarios.courses import BUILT_IN, course_names
from scenarios.walls import corridor_walls, cylinder_row, wall_boxes
from scenarios.worlds import WorldError, list_worlds, load_world
from twin.free_space import free_space
from twin.world import Box, Cylinder, World

PRODUCT_WIDTH = 0.43  # [m] of the robot
SPARE = 0.10  # [m] promised on each side
NEED = PRODUCT_WIDTH / 2 + SPARE  # [m] from the centre of the robot to the nearest obstacle

MINIMAL = "start = [0, 0]\ngoal = [3, 0.5, 1.0]\n"


def course(tmp_path: Path, text: str) -> World:
    path = tmp_path / "my-course.toml"
    path.write_text(text, encoding="utf-8")
    return load_world(str(path))


def error_of(tmp_path: Path, text: str) -> str:
    with pytest.raises(WorldError) as caught:
        course(tmp_path, text)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# --- the built-in courses --------------------------------------------------------------------------------------------


def shortest_path(world: World, clearance: float) -> np.ndarray:
    """(n, 2) [m] the shortest way of a disc over a fine grid (Dijkstra, 8 neighbours); empty without one."""
    space = free_space(world, 0.02)
    start, goal = (tuple(int(v) for v in space.cells(np.array([[p.x, p.y]]))[0]) for p in (world.start, world.goal))
    free = space.distance >= clearance
    best, came_from, queue = {start: 0.0}, {start: start}, [(0.0, start)]
    while queue:
        length, cell = heapq.heappop(queue)
        if cell == goal:
            way = [cell]
            while way[-1] != start:
                way.append(came_from[way[-1]])
            return (np.array(way[::-1])[:, ::-1] + 0.5) * space.resolution + space.origin
        if length > best[cell]:
            continue
        for i, j in ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            near = (cell[0] + i, cell[1] + j)
            if free[near] and length + math.hypot(i, j) < best.get(near, math.inf):
                best[near], came_from[near] = length + math.hypot(i, j), cell
                heapq.heappush(queue, (best[near], near))
    return np.empty((0, 2))


def holds(polygon: tuple[tuple[float, float], ...], x: float, y: float) -> bool:
    """Whether a point lies in a polygon (even-odd rule)."""
    edges = zip(polygon, (*polygon[1:], polygon[0]), strict=True)
    return (
        sum((a[1] > y) != (b[1] > y) and x < a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]) for a, b in edges) % 2
        == 1
    )


@pytest.mark.parametrize(
    ("name", "order"),
    [("training", ["B1", "B2", "A1", "D1", "A2", "D2"]), ("unseen", ["D1", "A2", "B1", "B2", "A1", "D2"])],
)
def test_course_is_passable_long_and_meets_its_places_in_order(name: str, order: list[str]) -> None:
    world = load_world(name)
    way = shortest_path(world, NEED)
    assert 20.0 <= np.hypot(*np.diff(way, axis=0).T).sum() <= 25.0
    inside = [[s.name for s in world.segments if holds(s.polygon, x, y)] for x, y in way]
    assert max(map(len, inside)) == 1  # segments do not overlap
    assert sum(not names for names in inside) < 0.05 * len(inside)  # and leave nothing out
    visited = [names[0] for names in inside if names]
    assert [a for a, b in itertools.pairwise([*visited, ""]) if a != b] == order
    # no way round outside the hall, and the narrow corridor is really narrow
    assert len(shortest_path(world, 0.45)) == 0


@pytest.mark.parametrize("name", ["training", "unseen"])
def test_rules_of_a_course(name: str) -> None:
    world = load_world(name)
    assert world.rules.protocol == "course"
    assert (world.rules.goal_tolerance, world.rules.time_limit, world.rules.stop_on_contact) == (1.0, 200.0, True)
    assert world.start.yaw == 0.0


def test_a_row_of_bins_has_no_gap_and_ends_where_it_says() -> None:
    row = [(c.x, c.y) for c in cylinder_row([(0.0, 0.0), (1.0, 0.0), (1.0, -0.5)], 0.07, 0.8, "cylinder")]
    assert row[0] == (0.0, 0.0)
    assert (1.0, 0.0) in row
    assert row[-1] == (1.0, -0.5)
    steps = [math.dist(a, b) for a, b in itertools.pairwise(row)]
    assert max(steps) <= 0.14 + 1e-9
    assert min(steps) > 0.12


@pytest.mark.parametrize("name", ["open", "corridor", "doorway", "u-trap"])
def test_small_worlds_can_be_crossed(name: str) -> None:
    world = load_world(name)
    space = free_space(world)
    assert space.reachable(world.start, 0.3)[tuple(space.cells(np.array([[world.goal.x, world.goal.y]]))[0])]
    assert world.name == name


def test_u_trap_blocks_the_straight_way() -> None:
    world = load_world("u-trap")
    line = np.linspace((world.start.x, world.start.y), (world.goal.x, world.goal.y), 200)
    assert free_space(world).at(line).min() <= 0.02


def test_list_of_worlds() -> None:
    entries = {e.name: e for e in list_worlds()}
    assert {"training", "unseen", "open", "corridor", "doorway", "u-trap"} <= set(course_names()) <= set(entries)
    assert any(name.startswith("barn-like/") for name in entries)
    assert entries["open"].distance == 6.0
    for entry in entries.values():
        assert entry.note
        assert entry.as_dict()["name"] == entry.name


def test_names_of_files_and_worlds_agree() -> None:
    for name in course_names():
        assert load_world(name).name == name
        assert load_world(str(BUILT_IN / f"{name}.toml")) == load_world(name)


def test_the_example_in_the_docs_is_a_course(tmp_path: Path) -> None:
    text = (Path(__file__).resolve().parents[2] / "docs" / "worlds.md").read_text()
    blocks = [part.split("```")[0] for part in text.split("```toml\n")[1:]]
    world = course(tmp_path, "".join(blocks))
    assert len(blocks) == 2
    assert len(world.obstacles) == 2 + 4 + 11 + 1 + 1
    assert len(world.segments) == 1


# --- the format ------------------------------------------------------------------------------------------------------


def test_every_table(tmp_path: Path) -> None:
    world = course(
        tmp_path,
        MINIMAL
        + """
goal_tolerance = 0.3
time_limit = 90
[[walls]]
points = [[-1, -2], [5, -2]]
thickness = 0.1
[[corridors]]
centre = [[1, 0], [2, 0]]
width = 1.0
[[boxes]]
at = [4, 1]
size = [0.5, 0.4, 0.3]
yaw = 0.1
bottom = 0.2
style = "furniture"
[[cylinders]]
at = [4, -1]
radius = 0.2
[[segments]]
name = "A1"
polygon = [[0, 0], [1, 0], [1, 1]]
""",
    )
    assert world.name == "my-course"
    assert world.goal.yaw == 1.0
    assert (world.rules.goal_tolerance, world.rules.time_limit) == (0.3, 90.0)
    assert Box(2.0, -2.0, 0.0, 6.0, 0.1, 0.8, style="wall") in world.obstacles
    assert Box(4.0, 1.0, 0.1, 0.5, 0.4, 0.3, 0.2, "furniture") in world.obstacles
    assert Cylinder(4.0, -1.0, 0.2, 0.8) in world.obstacles
    assert world.segments[0].polygon == ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))


def test_width_of_a_corridor_is_the_free_width() -> None:
    world = load_world("corridor")
    ys = np.linspace(-0.6, 0.6, 1201)
    distance = free_space(world, 0.005).at(np.stack([np.full(1201, 4.0), ys], axis=1))
    assert 2 * distance.max() == pytest.approx(1.0, abs=0.006)


@pytest.mark.parametrize("bend", [-1.2, -0.5, 0.3, 1.5])
def test_corridor_keeps_its_width_round_a_bend(bend: float) -> None:
    centre = [(0.0, 0.0), (2.0, 0.0), (2.0 + 2 * math.cos(bend), 2 * math.sin(bend))]
    for wall in corridor_walls(centre, 0.8):
        for (a, b), (p, q) in zip(itertools.pairwise(wall), itertools.pairwise(centre), strict=True):
            along = np.subtract(q, p) / math.dist(p, q)
            for point in (a, b):
                offset = np.subtract(point, p)
                assert abs(along[0] * offset[1] - along[1] * offset[0]) == pytest.approx(0.4)


def test_walls_leave_no_slit_at_corners() -> None:
    boxes = wall_boxes([(0, 0), (2, 0), (2, 2)], 0.1, 1.0, "wall")
    world = World("w", tuple(boxes), load_world("open").start, load_world("open").goal, load_world("open").rules)
    # the outer corner itself is covered, and free ends do not stick out
    assert free_space(world, 0.01).at(np.array([[2.04, -0.04]]))[0] < 0
    assert free_space(world, 0.01).at(np.array([[-0.02, 0.0]]))[0] > 0


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        ("start = [0, 0\ngoal = 1", 2, "not TOML"),
        ("start = [0, 0]\n", 1, "goal is missing"),
        ("start = [0, nan]\ngoal = [1, 1]", 1, "start must be"),
        ("start = [0, 0]\ngoal = [1, inf]", 2, "goal must be"),
        ("start = [0, 0]\ngoal = [1, true]", 2, "goal must be"),
        ("start = [0, 0]\ngoal = [1]", 2, "goal must be"),
        ("start = [0, 0]\n# goal = [9, 9]\ngoal = [1, 1e9]", 3, "goal must be"),
        (MINIMAL + "gaol_tolerance = 1", 3, "gaol_tolerance is not a key"),
        (MINIMAL + "time_limit = -1", 3, "time_limit must be greater than 0"),
        (MINIMAL + "time_limit = '9'", 3, "time_limit must be a number"),
        (MINIMAL + 'name = ""', 3, "name must be"),
        (MINIMAL + "[[wals]]\n", 3, "wals is not a key"),
        (MINIMAL + "[walls]\npoints = [[0, 0], [1, 1]]", 3, "walls must be tables"),
        (MINIMAL + "[[walls]]\npoints = [[0, 1], [1, 1]]\n\n[[walls]]\nthickness = 1", 6, "walls[2].points is missing"),
        (MINIMAL + "[[walls]]\n[[walls]]\npoints = [\n  [0, 1],\n  [0, 1]]", 3, "walls[1].points is missing"),
        (MINIMAL + "[[walls]]\npoints = [\n  [0, 1],\n  [0, 1]]", 4, "walls[1].points must not repeat"),
        (MINIMAL + "[[walls]]\npoints = [[0, 1]]", 4, "walls[1].points must be a list of at least 2"),
        (MINIMAL + "[[boxes]]\nat = [3, 3]\nsize = [1, 1, 0]", 5, "boxes[1].size must be three sizes greater"),
        (MINIMAL + "[[boxes]]\nat = [3, 3]\nsize = [1, 1]", 5, "boxes[1].size must be [length"),
        (MINIMAL + "[[cylinders]]\nat = [3, 3]\nradius = 0", 5, "cylinders[1].radius must be greater"),
        (MINIMAL + "[[cylinders]]\nat = [3, 3]\nradius = 1\ncolour = 'red'", 6, "cylinders[1].colour is not a key"),
        (MINIMAL + "[[corridors]]\ncentre = [[0, 0], [1, 0], [0, 0.01]]\nwidth = 1", 4, "bends too sharply"),
        (MINIMAL + "[[corridors]]\ncentre = [[0, 0], [1, 0], [1, 0.5], [0, 0.5]]\nwidth = 1", 4, "too short"),
        (MINIMAL + "[[cylinders]]\nat = [3, 3]\nradius = 1\nstyle = 'a/b'", 6, "cylinders[1].style must be"),
        (MINIMAL + "[[segments]]\nname = 'A1'\npolygon = [[0, 0], [1, 1]]", 5, "segments[1].polygon must be"),
        (MINIMAL + "walls = 3", 3, "walls must be tables"),
        (MINIMAL + "walls = [{points = 1}]", 3, "walls[1].points must be"),
    ],
)
def test_errors_name_line_and_key(tmp_path: Path, text: str, line: int, says: str) -> None:
    message = error_of(tmp_path, text)
    assert f"my-course.toml:{line}: " in message
    assert says in message


def test_broken_files(tmp_path: Path) -> None:
    path = tmp_path / "my-course.toml"
    path.write_bytes(MINIMAL.encode() + b"name = '\xff'")
    with pytest.raises(WorldError, match=r"toml:3: not UTF-8"):
        load_world(str(path))
    assert "nested too deeply" in error_of(tmp_path, "start = " + "[" * 100_000)
    assert "larger than" in error_of(tmp_path, "#" * 1_100_000)


# --- what every world must satisfy -----------------------------------------------------------------------------------


def test_start_inside_an_obstacle(tmp_path: Path) -> None:
    for at in ("[0, 0]", "[0.35, 0.0]", "[-0.2, 0.25]"):
        message = error_of(tmp_path, MINIMAL + f"[[boxes]]\nat = {at}\nsize = [0.3, 0.2, 0.2]")
        assert "start inside an obstacle" in message
        assert "--start" in message
    assert course(tmp_path, MINIMAL + "[[boxes]]\nat = [0.41, 0.0]\nsize = [0.3, 0.2, 0.2]")
    # above the robot there may be something
    assert course(tmp_path, MINIMAL + "[[boxes]]\nat = [0, 0]\nsize = [1, 1, 0.1]\nbottom = 0.6")


def test_goal_inside_an_obstacle_is_allowed(tmp_path: Path) -> None:
    """It cannot be reached: that is a trial's result, not a mistake."""
    assert course(tmp_path, MINIMAL + "[[boxes]]\nat = [3, 0.5]\nsize = [1, 1, 1]")


def test_enormous_numbers_of_obstacles(tmp_path: Path) -> None:
    text = MINIMAL + "[[cylinders]]\nat=[9,9]\nradius=1\n" * 21_000
    assert "cylinders must be at most 20000" in error_of(tmp_path, text)


def test_start_and_goal_can_be_given(tmp_path: Path) -> None:
    world = load_world("open", start="1,2,0.5", goal="3,4")
    assert (world.start.x, world.start.y, world.start.yaw) == (1.0, 2.0, 0.5)
    assert (world.goal.x, world.goal.y) == (3.0, 4.0)
    for bad in ("1", "1,2,3,4", "a,b", "nan,1", "1,inf", ""):
        with pytest.raises(WorldError, match="--start"):
            load_world("open", start=bad)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("traning", "training"),
        ("Unseen", "unseen"),
        ("barnlike/3", "barn-like"),
        ("u_trap", "u-trap"),
        ("zzzzzz", "appli worlds|barn-like/K"),
        ("", "unknown world"),
        ("nowhere.toml", "does not exist"),
        ("nowhere.world", "does not exist"),
        (".", "is a folder"),
        ("a\x00b.toml", "toml"),
    ],
)
def test_unknown_worlds(text: str, says: str) -> None:
    with pytest.raises(WorldError, match=says) as caught:
        load_world(text)
    assert "\n" not in str(caught.value)


def test_folder_and_fragment(tmp_path: Path) -> None:
    (tmp_path / "x.toml").mkdir()
    with pytest.raises(WorldError, match="is a folder"):
        load_world(str(tmp_path / "x.toml"))
    with pytest.raises(WorldError, match="leave out #3"):
        load_world(f"{BUILT_IN / 'open.toml'}#3")
