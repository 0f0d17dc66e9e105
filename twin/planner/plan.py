"""G, the navigation system as a pure function: `plan(x, theta, memory) -> (Plan | Blocked, memory)`.

One call is one tick of move_base's two halves with everything serialised: bring both inflated costmaps up to date,
plan globally on one, follow the plan on the other. `move_base.py` runs the same stages under its state machine.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from twin.planner.controller import ControllerState, ControlResult, compute_velocity, set_plan
from twin.planner.inflation import Costmap, update_costmap
from twin.planner.navfn import make_plan
from twin.planner.obstacle_layer import GLOBAL_MAP, LOCAL_MAP
from twin.planner.params import PlannerParams
from twin.planner.trajectory import LocalPlannerSettings
from twin.records import Array, Command, Observation


@dataclass(frozen=True, slots=True)
class PlannerSettings:
    """The switches that ROS, the paper and the authors' code leave open; none of them is tuned.

    inflation: which maps obey theta's inflation_radius. "both" is how the authors' later code sets it, "local" how
        their APPLI node does (the global map then keeps the Jackal's 0.30 m).
    couple_min_vel_theta: True sets min_vel_theta = -max_vel_theta with every theta; False leaves the Jackal's -1.57.
    local: the rest of TrajectoryPlanner's settings, among them `meter_scoring_factor`.
    """

    inflation: Literal["both", "local"] = "both"
    couple_min_vel_theta: bool = False
    local: LocalPlannerSettings = field(default_factory=LocalPlannerSettings)

    def local_for(self, theta: PlannerParams) -> LocalPlannerSettings:
        """The local planner's settings while theta is in force."""
        return replace(self.local, min_vel_theta=-theta.max_vel_theta) if self.couple_min_vel_theta else self.local


DEFAULT_SETTINGS = PlannerSettings()
DEFAULT_THETA = PlannerParams()


@dataclass(frozen=True, slots=True)
class PlanMemory:
    """What one call leaves for the next: both inflated costmaps and the controller's state. Immutable."""

    local: Costmap | None = None
    global_: Costmap | None = None
    controller: ControllerState = field(default_factory=ControllerState)


FRESH = PlanMemory()


@dataclass(frozen=True, slots=True)
class Plan:
    """A legal command, and how it came about."""

    command: Command
    control: ControlResult
    global_path: Array  # (n, 3) odom x, y, yaw [m, m, rad]


@dataclass(frozen=True, slots=True)
class Blocked:
    """No command: the reasons, in words; the robot is told to stop."""

    reasons: tuple[str, ...]


def update_costmaps(x: Observation, theta: PlannerParams, memory: PlanMemory, settings: PlannerSettings) -> PlanMemory:
    """Both layered costmaps after this scan, inflated by theta's radius."""
    global_radius = theta.inflation_radius if settings.inflation == "both" else DEFAULT_THETA.inflation_radius
    return replace(
        memory,
        local=update_costmap(memory.local, x.local_map, LOCAL_MAP, theta.inflation_radius),
        global_=update_costmap(memory.global_, x.global_map, GLOBAL_MAP, global_radius),
    )


def plan_globally(x: Observation, memory: PlanMemory) -> tuple[Array | None, PlanMemory]:
    """navfn from the robot to the goal on the global costmap: (n, 3) path or None, and the memory after it."""
    assert memory.global_ is not None  # update_costmaps comes first
    path, costmap = make_plan(memory.global_, x.pose, x.goal)
    return path, replace(memory, global_=costmap)


def control(
    x: Observation, theta: PlannerParams, memory: PlanMemory, settings: PlannerSettings, explain: bool
) -> tuple[ControlResult, PlanMemory]:
    """`computeVelocityCommands` on the local costmap."""
    assert memory.local is not None  # update_costmaps comes first
    result, state = compute_velocity(
        memory.local, x.pose, x.twist, x.twist, memory.controller, theta, settings.local_for(theta), explain=explain
    )
    return result, replace(memory, controller=state)


def plan(
    x: Observation,
    theta: PlannerParams,
    memory: PlanMemory = FRESH,
    settings: PlannerSettings = DEFAULT_SETTINGS,
    explain: bool = False,
) -> tuple[Plan | Blocked, PlanMemory]:
    """The action of the navigation system for one observation under theta (the paper's G).

    Depends on nothing but its arguments. Blocked where ROS would publish a zero command: no global plan, or no legal
    trajectory.
    """
    memory = update_costmaps(x, theta, memory, settings)
    path, memory = plan_globally(x, memory)
    if path is None:
        return Blocked(("no global plan",)), memory
    memory = replace(memory, controller=set_plan(memory.controller, path))
    result, memory = control(x, theta, memory, settings, explain)
    if not result.ok:
        return Blocked(("no legal trajectory",)), memory
    return Plan(result.command, result, path), memory
