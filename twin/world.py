"""A world as data: obstacles, start, goal, and the rules by which a trial in it ends."""

from __future__ import annotations

from dataclasses import dataclass, field

from numpy.typing import NDArray

from twin.records import Array, Pose2


@dataclass(frozen=True, slots=True)
class Cylinder:
    """An upright cylinder standing on the floor."""

    x: float  # centre, world [m]
    y: float
    radius: float  # [m]
    height: float  # top above the floor [m]
    style: str = "cylinder"


@dataclass(frozen=True, slots=True)
class Box:
    """A box turned about the vertical axis."""

    x: float  # centre, world [m]
    y: float
    yaw: float  # [rad]
    length: float  # full extent along its own x [m]
    width: float  # full extent along its own y [m]
    height: float  # full extent along z [m]
    bottom: float = 0.0  # lower face above the floor [m]
    style: str = "box"  # appearance: box, wall, cardboard, furniture, ...


@dataclass(frozen=True, slots=True)
class Mesh:
    """A triangle mesh in world coordinates (a scanned room)."""

    vertices: Array  # (n, 3) [m], world
    faces: NDArray  # type: ignore[type-arg]  # (m, 3) int32
    style: str = "mesh"


Obstacle = Cylinder | Box | Mesh


@dataclass(frozen=True, slots=True)
class Segment:
    """A named stretch of a course: the convex or concave polygon that holds it."""

    name: str  # the context it is built to provoke, e.g. "A1"
    polygon: tuple[tuple[float, float], ...]  # world [m]
    note: str = ""


@dataclass(frozen=True, slots=True)
class Rules:
    """When a trial ends, and when its clock starts."""

    protocol: str  # "course", "2020", "icra22", "appli"
    goal_tolerance: float  # reached when the true distance to the goal is below this [m]
    time_limit: float  # [s] on the clock
    clock_distance: float = 0.0  # the clock starts once the robot is this far from its start [m]
    stop_on_contact: bool = True  # a contact ends the trial as a collision
    finish_line_y: float | None = None  # reached also when the true y exceeds this [m]


@dataclass(frozen=True, slots=True)
class World:
    """Where a trial happens. Obstacles, start and goal are in the world frame; the floor is z = 0."""

    name: str
    obstacles: tuple[Obstacle, ...]
    start: Pose2
    goal: Pose2
    rules: Rules
    segments: tuple[Segment, ...] = ()
    index: int = 0  # enters the seed of a trial
    note: str = field(default="", compare=False)
