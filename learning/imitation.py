"""G(x; theta) over all labelled steps at once, with everything that theta does not touch computed once per step.

Theta reaches the costmaps only through the inflation radius, and that only through R, the radius in whole cells (11
values in the search space). So there is a *stage* per R: for each step the inflated local map, the global plan (navfn
on the inflated global map), what cropping and pruning leave of it, and both map grids. What is left per theta is to
find the cheapest arc (`arc_choice.py`).

G is `plan(x, theta)` with a fresh memory at every step: both maps inflated as a whole, no oscillation flags, no escape.
Whatever a real drive would carry over from tick to tick, it would carry over from G's own earlier actions, and these
steps come from somebody else's. Blocked counts as stop.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from learning.arc_choice import choose_arcs
from learning.arc_scene import LOOK, NO_WAY, Stage, room_for
from learning.steps import PackedSteps, Step
from twin.geometry import normalize_angle
from twin.planner.arcs import Motion
from twin.planner.controller import ControllerState, compute_velocity, crop_plan, prune_count, set_plan
from twin.planner.footprint import CIRCUMSCRIBED_RADIUS, FOOTPRINT
from twin.planner.grid import cell_distance
from twin.planner.inflation import Costmap, update_costmap
from twin.planner.map_grid import map_grids
from twin.planner.navfn import make_plan
from twin.planner.obstacle_layer import GLOBAL_MAP, LOCAL_MAP
from twin.planner.params import PlannerParams
from twin.planner.plan import DEFAULT_THETA, PlannerSettings
from twin.planner.sketch import FARTHEST
from twin.planner.trajectory_state import limits_of
from twin.records import Array, Bytes, Observation, ObstacleMap, Pose2, frozen_array


@dataclass(frozen=True, slots=True)
class LabelledSteps:
    """Labelled steps of some interventions. Every pass unpacks them anew: a global map alone has 640 kB."""

    picks: tuple[tuple[PackedSteps, tuple[int, ...]], ...]  # rising indices

    @classmethod
    def of(cls, interventions: Sequence[PackedSteps]) -> LabelledSteps:
        """All there are."""
        return cls(tuple((steps, tuple(np.flatnonzero(steps.labelled).tolist())) for steps in interventions))

    def __len__(self) -> int:
        return sum(len(indices) for _, indices in self.picks)

    def __iter__(self) -> Iterator[Step]:
        for steps, indices in self.picks:
            wanted = set(indices)
            through = islice(steps, max(indices, default=-1) + 1)
            yield from (step for k, step in enumerate(through) if k in wanted)

    @property
    def actions(self) -> Array:
        """(n, 2) v [m/s], w [rad/s] of the intervener."""
        return frozen_array(np.concatenate([steps.actions[list(indices)] for steps, indices in self.picks]))

    def spread(self, most: int | None) -> LabelledSteps:
        """At most so many of them, evenly spread over all, first and last included."""
        if most is None or len(self) <= most:
            return self
        return self._only(np.linspace(0, len(self) - 1, most).round().astype(np.int64).tolist())

    def chunks(self, size: int) -> Iterator[LabelledSteps]:
        """All of them, at most so many at a time."""
        for first in range(0, len(self), size):
            yield self._only(range(first, min(first + size, len(self))))

    def _only(self, numbers: Iterable[int]) -> LabelledSteps:
        kept = set(numbers)
        picks, before = [], 0
        for steps, indices in self.picks:
            picks.append((steps, tuple(i for k, i in enumerate(indices, before) if k in kept)))
            before += len(indices)
        return LabelledSteps(tuple(picks))


class _Other(NamedTuple):
    """A step that G ends otherwise, mostly by turning in place at the goal."""

    step: int
    x: Observation
    costmap: Costmap
    state: ControllerState


class Imitation:
    """The right-hand side of Eq. 1 for a set of steps."""

    def __init__(self, steps: LabelledSteps, settings: PlannerSettings) -> None:
        frames = {(*_frame(s.observation.local_map), *_frame(s.observation.global_map)) for s in steps}
        if len(frames) != 1:
            raise ValueError("the maps of all interventions must have one size and resolution")
        (frame,) = frames
        self._resolutions = frame[2], frame[5]  # [m] local, global
        self._steps = steps
        self._settings = settings
        self._plans: dict[int, list[Array | None]] = {}
        self._stages: dict[tuple[int, int], tuple[Stage, tuple[_Other, ...]]] = {}

    def __len__(self) -> int:
        return len(self._steps)

    def actions(self, theta: PlannerParams) -> Array:
        """(n, 2) v [m/s], w [rad/s] of G(x; theta) at every step."""
        stage, others = self._stage(theta)
        settings = self._settings.local_for(theta)
        limits = limits_of(theta, settings)
        actions = np.zeros((len(self), 2))
        if len(stage.step):
            speed, rate = np.abs(stage.motion[:, [3, 5]]).max(axis=0).tolist()
            choose_arcs(stage, self._resolutions[0], FOOTPRINT, limits, room_for(limits, speed, rate), actions)
        for k in np.flatnonzero(np.abs(actions[:, 1]) > math.pi).tolist():
            actions[k, 1] = normalize_angle(actions[k, 1])  # on its way through a quaternion, as in BestPath.command
        for k, x, costmap, state in others:
            result, _ = compute_velocity(costmap, x.pose, x.twist, x.twist, state, theta, settings)
            actions[k] = (result.command.v, result.command.w) if result.ok else (0.0, 0.0)
        return frozen_array(actions)

    def _stage(self, theta: PlannerParams) -> tuple[Stage, tuple[_Other, ...]]:
        radius = theta.inflation_radius
        global_radius = radius if self._settings.inflation == "both" else DEFAULT_THETA.inflation_radius
        radii = zip((radius, global_radius), self._resolutions, strict=True)
        reach, global_reach = (cell_distance(r, resolution) for r, resolution in radii)
        if global_reach not in self._plans:
            self._plans[global_reach] = [_plan_globally(s.observation, global_radius) for s in self._steps]
        if (reach, global_reach) not in self._stages:
            plans, settings = self._plans[global_reach], self._settings
            self._stages[reach, global_reach] = _set_stage(self._steps, plans, radius, settings)
        return self._stages[reach, global_reach]


def _frame(m: ObstacleMap) -> tuple[int, int, float]:
    return (*m.cells.shape, m.resolution)


def _plan_globally(x: Observation, radius: float) -> Array | None:
    costmap = update_costmap(None, x.global_map, GLOBAL_MAP, radius)
    return make_plan(costmap, x.pose, x.goal)[0]


def _set_stage(
    steps: LabelledSteps, plans: Sequence[Array | None], radius: float, settings: PlannerSettings
) -> tuple[Stage, tuple[_Other, ...]]:
    """Everything that the local planner needs, up to the search itself (see `controller.compute_velocity`)."""
    others, count = [], 0
    stage: Stage | None = None
    for k, (step, path) in enumerate(zip(steps, plans, strict=True)):
        x = step.observation
        if stage is None:
            stage = _empty_stage(len(plans), x.local_map.cells.shape)
        if path is None:
            continue
        costmap = update_costmap(None, x.local_map, LOCAL_MAP, radius)
        plan = crop_plan(path, x.pose, max(costmap.cells.shape) * costmap.resolution / 2.0)
        plan = plan[prune_count(plan, x.pose) :]
        if len(plan) == 0:
            continue
        motion, (goal_x, goal_y) = _motion(x), plan[-1, :2].tolist()
        arrived = math.hypot(goal_x - x.pose.x, goal_y - x.pose.y) <= settings.local.controller.xy_goal_tolerance
        if arrived or max(map(abs, (motion.x, motion.y, *costmap.origin))) >= FARTHEST:
            others.append(_Other(k, x, costmap, set_plan(ControllerState(), path)))
            continue
        grids = map_grids(costmap, Pose2(motion.x, motion.y, motion.yaw), plan)
        no_way = np.maximum(grids.path, grids.goal) >= costmap.cells.size
        stage.step[count] = k
        stage.cells[count] = costmap.cells
        stage.around[count] = surroundings(costmap.cells, no_way, int(CIRCUMSCRIBED_RADIUS / costmap.resolution) + 1)
        stage.path[count] = grids.path
        stage.goal[count] = grids.goal
        stage.origin[count] = costmap.origin
        stage.motion[count] = motion
        stage.goal_distance[count] = math.hypot(goal_x - motion.x, goal_y - motion.y)
        count += 1
    assert stage is not None  # there is at least one step
    return Stage(*(frozen_array(column[:count]) for column in stage)), tuple(others)


def _empty_stage(steps: int, shape: tuple[int, ...]) -> Stage:
    size = math.prod(shape)
    grid = np.uint16 if size + 1 <= np.iinfo(np.uint16).max else np.int32  # ny * nx + 1 is the highest value
    return Stage(
        np.empty(steps, np.int64),
        *(np.empty((steps, *shape), kind) for kind in (np.uint8, np.uint8, grid, grid)),
        *(np.empty((steps, *rest)) for rest in ((2,), (6,), ())),
    )


def _motion(x: Observation) -> Motion:
    """Pose and velocity as `find_best_path` rounds them."""
    pose, twist = x.pose, x.twist
    values = (pose.x, pose.y, _wrapped(pose.yaw), twist.v, 0.0, _wrapped(twist.w))
    return Motion(*np.array(values, dtype=np.float32).astype(np.float64).tolist())


def _wrapped(angle: float) -> float:
    return angle if abs(angle) <= math.pi else normalize_angle(angle)


def surroundings(cells: Bytes, no_way: NDArray[np.bool_], reach: int) -> Bytes:
    """`Floor.around`, as (ny, nx), for outlines that stay within `reach` cells of their centre on each axis."""
    ny, nx = cells.shape
    padded = np.full((ny + 2 * reach, nx + 2 * reach), LOOK, dtype=np.uint8)
    padded[reach : ny + reach, reach : nx + reach] = np.minimum(cells, LOOK)
    highest = _running_max(_running_max(padded, 2 * reach + 1).T, 2 * reach + 1).T
    return np.where(no_way, np.uint8(NO_WAY), highest)


def _running_max(array: Bytes, length: int) -> Bytes:
    """(n - length + 1, m): the maximum of every `length` rows in sequence, in log2(length) passes."""
    covered = 1
    while 2 * covered <= length:
        array = np.maximum(array[:-covered], array[covered:])
        covered *= 2
    rest = length - covered
    return np.maximum(array[: len(array) - rest], array[rest:])
