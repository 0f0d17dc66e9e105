"""Courses: rooms of walls, corridors, rows of bins, boxes and cylinders, written in TOML (format: docs/worlds.md)."""

from __future__ import annotations

import itertools
import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenarios.walls import Point, Points, corridor_walls, cylinder_row, wall_boxes
from scenarios.world_checks import MAX_COORDINATE, MAX_OBSTACLES, WorldError
from twin.records import Pose2
from twin.world import Box, Cylinder, Obstacle, Rules, Segment, World

BUILT_IN = Path(__file__).parent / "courses"
MAX_COURSE_BYTES = 1_000_000
GOAL_TOLERANCE = 0.5  # [m]
TIME_LIMIT = 200.0  # [s] the paper's penalty for a stuck run on a physical course


def course_names() -> list[str]:
    """Names of the built-in courses."""
    return sorted(path.stem for path in BUILT_IN.glob("*.toml"))


def read_course(path: Path) -> World:
    """The world in a course file. WorldError names the line and the key."""
    if path.stat().st_size > MAX_COURSE_BYTES:
        raise WorldError(f"{path} is larger than {MAX_COURSE_BYTES // 10**6} MB; a course has some hundred lines")
    try:
        text = path.read_bytes().decode("utf-8")
        data = tomllib.loads(text)
    except UnicodeDecodeError as error:
        line = path.read_bytes()[: error.start].count(b"\n") + 1
        raise WorldError(f"{path}:{line}: not UTF-8 text; save the file as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        where = re.search(r"at line (\d+)", str(error))
        line_number = where.group(1) if where else str(text.count("\n") + 1)
        reason = re.sub(r" \(at .*\)$", "", " ".join(str(error).split()))
        raise WorldError(f"{path}:{line_number}: not TOML: {reason}; see docs/worlds.md for the format") from None
    except RecursionError:
        raise WorldError(f"{path}: not a course: values are nested too deeply; see docs/worlds.md") from None
    return _Reader(path, text).world(data)


_HEADER = re.compile(r"\s*\[\[?\s*[\"']?([A-Za-z_][\w-]*)[\"']?\s*[].]")

# --- fields ----------------------------------------------------------------------------------------------------------


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= MAX_COORDINATE:
        raise ValueError(f"must be a number within +-{MAX_COORDINATE:g}")
    return float(value)


def _positive(value: Any) -> float:
    if (number := _number(value)) <= 0:
        raise ValueError("must be greater than 0")
    return number


def _not_negative(value: Any) -> float:
    if (number := _number(value)) < 0:
        raise ValueError("must be 0 or more")
    return number


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError("must be true or false")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str) or not value or len(value) > 400 or not value.isprintable():
        raise ValueError("must be a line of text in quotes")
    return value


STYLES = ("wall", "cardboard", "furniture", "box", "cylinder")  # looks only


def _style(value: Any) -> str:
    if value not in STYLES:
        raise ValueError(f"must be one of {', '.join(STYLES)}")
    return str(value)


def _list_of(value: Any, lengths: Sequence[int], form: str) -> list[float]:
    if not isinstance(value, list) or len(value) not in lengths:
        raise ValueError(f"must be {form}")
    try:
        return [_number(v) for v in value]
    except ValueError:
        raise ValueError(f"must be {form}, numbers within +-{MAX_COORDINATE:g}") from None


def _point(value: Any) -> Point:
    x, y = _list_of(value, (2,), "[x, y] in metres")
    return x, y


def _pose(value: Any) -> Pose2:
    x, y, yaw = [*_list_of(value, (2, 3), "[x, y] or [x, y, yaw] in metres and radians"), 0.0][:3]
    return Pose2(x, y, yaw)


def _size(value: Any) -> tuple[float, float, float]:
    length, width, height = _list_of(value, (3,), "[length, width, height] in metres")
    if min(length, width, height) <= 0:
        raise ValueError("must be three sizes greater than 0")
    return length, width, height


def _points(least: int) -> Callable[[Any], Points]:
    def convert(value: Any) -> Points:
        if not isinstance(value, list) or not least <= len(value) <= 1000:
            raise ValueError(f"must be a list of at least {least} points [x, y]")
        points = tuple(_point(p) for p in value)
        if any(math.dist(a, b) < 1e-6 for a, b in itertools.pairwise(points)):
            raise ValueError("must not repeat a point")
        return points

    return convert


@dataclass(frozen=True, slots=True)
class _Key:
    """One key of a table: how its value is read, and its default (None = must be given)."""

    read: Callable[[Any], Any]
    default: Any = None


_HEIGHT = _Key(_positive, 0.8)
_THICKNESS = _Key(_positive, 0.04)
TOP_LEVEL = {
    "name": _Key(_text, ""),
    "note": _Key(_text, ""),
    "start": _Key(_pose),
    "goal": _Key(_pose),
    "goal_tolerance": _Key(_positive, GOAL_TOLERANCE),
    "time_limit": _Key(_positive, TIME_LIMIT),
}
TABLES: dict[str, dict[str, _Key]] = {
    "walls": {
        "points": _Key(_points(2)),
        "closed": _Key(_flag, False),
        "thickness": _THICKNESS,
        "height": _HEIGHT,
        "style": _Key(_style, "wall"),
    },
    "corridors": {
        "centre": _Key(_points(2)),
        "width": _Key(_positive),
        "thickness": _THICKNESS,
        "height": _HEIGHT,
        "style": _Key(_style, "cardboard"),
    },
    "rows": {
        "points": _Key(_points(2)),
        "radius": _Key(_positive),
        "height": _HEIGHT,
        "style": _Key(_style, "cylinder"),
    },
    "boxes": {
        "at": _Key(_point),
        "size": _Key(_size),
        "yaw": _Key(_number, 0.0),
        "bottom": _Key(_not_negative, 0.0),
        "style": _Key(_style, "box"),
    },
    "cylinders": {
        "at": _Key(_point),
        "radius": _Key(_positive),
        "height": _HEIGHT,
        "style": _Key(_style, "cylinder"),
    },
    "segments": {
        "name": _Key(_text),
        "polygon": _Key(_points(3)),
        "note": _Key(_text, ""),
    },
}


class _Reader:
    """Reads one file, and knows where in it every key stands."""

    def __init__(self, path: Path, text: str) -> None:
        self._path = path
        self._lines = text.splitlines()

    def world(self, data: Mapping[str, Any]) -> World:
        """The whole file."""
        top = self._table({k: v for k, v in data.items() if k not in TABLES}, TOP_LEVEL, "", 0)
        tables = {name: self._tables(name, data.get(name, [])) for name in TABLES}
        obstacles: list[Obstacle] = []
        for wall in tables["walls"]:
            obstacles += wall_boxes(wall["points"], wall["thickness"], wall["height"], wall["style"], wall["closed"])
        for k, corridor in enumerate(tables["corridors"]):
            obstacles += self._corridor(corridor, k)
        for row in tables["rows"]:
            obstacles += cylinder_row(row["points"], row["radius"], row["height"], row["style"])
        for box in tables["boxes"]:
            (x, y), (length, width, height) = box["at"], box["size"]
            obstacles.append(Box(x, y, box["yaw"], length, width, height, box["bottom"], box["style"]))
        for cylinder in tables["cylinders"]:
            (x, y) = cylinder["at"]
            obstacles.append(Cylinder(x, y, cylinder["radius"], cylinder["height"], cylinder["style"]))
        rules = Rules("course", top["goal_tolerance"], top["time_limit"], stop_on_contact=True)
        segments = tuple(Segment(s["name"], s["polygon"], s["note"]) for s in tables["segments"])
        name = top["name"] or self._path.stem
        return World(name, tuple(obstacles), top["start"], top["goal"], rules, segments, note=top["note"])

    def _corridor(self, corridor: Mapping[str, Any], k: int) -> list[Obstacle]:
        try:
            walls = corridor_walls(corridor["centre"], corridor["width"] + corridor["thickness"])
        except ValueError as error:
            raise self._error("corridors", k, "centre", str(error)) from None
        return [b for w in walls for b in wall_boxes(w, corridor["thickness"], corridor["height"], corridor["style"])]

    def _tables(self, name: str, value: Any) -> list[dict[str, Any]]:
        if not isinstance(value, list) or not all(isinstance(v, dict) for v in value):
            raise self._error("", 0, name, f"must be tables that begin with [[{name}]]")
        if len(value) > MAX_OBSTACLES:
            raise self._error("", 0, name, f"must be at most {MAX_OBSTACLES}")
        return [self._table(v, TABLES[name], name, k) for k, v in enumerate(value)]

    def _table(self, values: Mapping[str, Any], keys: Mapping[str, _Key], table: str, k: int) -> dict[str, Any]:
        for key in values:
            if key not in keys:
                known = [*keys, *(f"[[{t}]]" for t in TABLES if not table)]
                raise self._error(table, k, key, f"is not a key here; the keys are {', '.join(known)}")
        result = {}
        for key, spec in keys.items():
            if key in values:
                try:
                    result[key] = spec.read(values[key])
                except ValueError as error:
                    raise self._error(table, k, key, str(error)) from None
            elif spec.default is None:
                raise self._error(table, k, key, "is missing; add it (docs/worlds.md shows every key)")
            else:
                result[key] = spec.default
        return result

    def _error(self, table: str, k: int, key: str, reason: str) -> WorldError:
        name = f"{table}[{k + 1}].{key}" if table else key
        return WorldError(f"{self._path}:{self._line(table, k, key)}: {name} {reason}")

    def _line(self, table: str, k: int, key: str) -> int:
        """1-based line of a key in the k-th [[table]]; of the table's header when the key is not in it."""
        headers = [(n, m.group(1)) for n, line in enumerate(self._lines) if (m := _HEADER.match(line))]
        ends = [n for n, _ in headers[1:]] + [len(self._lines)]
        own = [i for i, (_, name) in enumerate(headers) if name == table]
        if k < len(own):
            begin, end = headers[own[k]][0], ends[own[k]]
        else:  # the lines before the first header; an inline table is found by its own name
            begin, end = 0, headers[0][0] if headers else len(self._lines)
            key = table or key
        for number in range(begin, end):
            if re.match(rf"\s*[\"']?{re.escape(key)}[\"']?\s*[.=]", self._lines[number]):
                return number + 1
        return next((n for n, name in headers if name == key and not table), begin) + 1
