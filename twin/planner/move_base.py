"""move_base: the state machine and the recovery behaviours round G (spec: ROS noetic, Jackal parameters).

ROS runs planner, controller and costmaps in threads of their own; here a tick serialises them: maps, planner thread,
control cycle. Two consequences are documented choices: success is checked right after the velocity is computed (in
ROS a new plan may hide it for a cycle or two), and a CLEARING state survives until the next control cycle.
The oscillation timeout is 0 on the Jackal (off), so nothing of it is modelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum

from twin.compiled import compiled
from twin.geometry import shortest_angle
from twin.planner.controller import set_plan
from twin.planner.footprint import FOOTPRINT, footprint_cost
from twin.planner.inflation import Costmap
from twin.planner.params import PlannerParams
from twin.planner.plan import (
    DEFAULT_SETTINGS,
    FRESH,
    PlanMemory,
    PlannerSettings,
    control,
    plan_globally,
    update_costmaps,
)
from twin.records import STOP, Array, Bytes, Command, Decision, Observation, ObstacleMap, Pose2

PLANNER_PATIENCE = 5.0  # [s] jackal_navigation/params/move_base_params.yaml
CONTROLLER_PATIENCE = 15.0  # [s] same

# Rotate recovery: read once at start-up from the planner's namespace (rotate_recovery, noetic).
ROTATE_ACCELERATION = 20.0  # [rad/s2] acc_lim_theta
ROTATE_MAX = 1.57  # [rad/s] max_vel_theta at start-up
ROTATE_MIN = 0.314  # [rad/s] min_in_place_vel_theta
ROTATE_TOLERANCE = 0.157  # [rad] yaw_goal_tolerance
ROTATE_STEP = 0.017  # [rad] sim_granularity of the behaviour


@dataclass(frozen=True, slots=True)
class Recovery:
    """One entry of the recovery list."""

    name: str
    clear_beyond: float | None = None  # side of the square that stays [m]; None = a rotation


RECOVERIES = (
    Recovery("conservative_reset", 3.0),  # conservative_reset_dist
    Recovery("rotate_recovery"),
    Recovery("aggressive_reset", 1.84),  # 4 * 0.46, the default circumscribed radius nobody sets
    Recovery("rotate_recovery"),
)


class State(StrEnum):
    """move_base's states; while CLEARING a rotation, `Memory.rotation` is set."""

    PLANNING = "planning"
    CONTROLLING = "controlling"
    CLEARING = "clearing"


class Trigger(StrEnum):
    """What asked for the last recovery."""

    PLANNING = "planning"
    CONTROLLING = "controlling"


@dataclass(frozen=True, slots=True)
class Rotation:
    """A rotate recovery in progress."""

    start_yaw: float  # [rad] odom
    half_turn_seen: bool = False


@dataclass(frozen=True, slots=True)
class MoveBaseSettings:
    """move_base's own switches.

    clearing_works: False is the Jackal as shipped: the clearing recovery looks for a layer "obstacles", the layer is
        called "obstacles_layer", and nothing is ever cleared. True clears.
    """

    planner: PlannerSettings = DEFAULT_SETTINGS
    clearing_works: bool = False


@dataclass(frozen=True, slots=True)
class Memory:
    """Everything move_base carries from tick to tick. Immutable."""

    plan: PlanMemory = FRESH
    state: State = State.PLANNING
    trigger: Trigger = Trigger.PLANNING
    recovery_index: int = 0
    recoveries: int = 0  # run so far
    last_valid_plan: float | None = None  # [s]; None before the first tick
    last_valid_control: float = 0.0  # [s]; not renewed by a recovery, as in ROS
    rotation: Rotation | None = None
    path: Array | None = None  # (n, 3) the plan the controller follows, odom
    finished: bool = False  # reached or aborted: nothing more is published


@dataclass(frozen=True, slots=True)
class MoveBase:
    """One move_base with a fixed goal, as a pure step function."""

    settings: MoveBaseSettings = field(default_factory=MoveBaseSettings)
    explain: bool = False  # fill Decision.candidates, .rejected and .local_costmap

    def step(self, x: Observation, theta: PlannerParams, memory: Memory) -> tuple[Decision, Memory]:
        """One 50 ms tick under theta: the decision and the memory for the next tick."""
        if memory.last_valid_plan is None:  # a new goal: all timers start now
            memory = replace(memory, last_valid_plan=x.time, last_valid_control=x.time)
        memory = replace(memory, plan=update_costmaps(x, theta, memory.plan, self.settings.planner))
        if memory.finished:
            return self._decision(memory, theta, STOP), memory
        if memory.rotation is not None:
            return self._rotate(x, theta, memory)
        gave_up = False
        if memory.state is not State.CLEARING:
            memory, gave_up = self._planner_thread(x, memory)
        if gave_up:  # the planner's thread itself publishes the stop; the behaviour runs in the next cycle
            return self._decision(memory, theta, STOP), memory
        if memory.state is State.CLEARING:
            return self._recover(x, theta, memory)
        if memory.state is State.PLANNING:
            return self._decision(memory, theta, None), memory
        return self._control(x, theta, memory)

    def _planner_thread(self, x: Observation, memory: Memory) -> tuple[Memory, bool]:
        """makePlan at 20 Hz; True when patience ran out."""
        path, plan_memory = plan_globally(x, memory.plan)
        memory = replace(memory, plan=plan_memory)
        if path is not None:
            index = 0 if memory.trigger is Trigger.PLANNING else memory.recovery_index
            controller = set_plan(memory.plan.controller, path)
            return (
                replace(
                    memory,
                    plan=replace(memory.plan, controller=controller),
                    path=path,
                    state=State.CONTROLLING,
                    last_valid_plan=x.time,
                    recovery_index=index,
                ),
                False,
            )
        assert memory.last_valid_plan is not None
        if memory.state is State.PLANNING and x.time > memory.last_valid_plan + PLANNER_PATIENCE:
            return replace(memory, state=State.CLEARING, trigger=Trigger.PLANNING), True
        return memory, False

    def _control(self, x: Observation, theta: PlannerParams, memory: Memory) -> tuple[Decision, Memory]:
        result, plan_memory = control(x, theta, memory.plan, self.settings.planner, self.explain)
        memory = replace(memory, plan=plan_memory)
        if result.ok:
            index = 0 if memory.trigger is Trigger.CONTROLLING else memory.recovery_index
            reached = plan_memory.controller.reached_goal
            memory = replace(memory, last_valid_control=x.time, recovery_index=index, finished=reached)
            decision = self._decision(memory, theta, result.command, state="controlling")
            return replace(
                decision,
                arc=result.arc,
                candidates=result.candidates,
                rejected=result.rejected,
                goal_reached=reached,
            ), memory
        decision = replace(self._decision(memory, theta, STOP), candidates=result.candidates, rejected=result.rejected)
        if x.time > memory.last_valid_control + CONTROLLER_PATIENCE:
            return decision, replace(memory, state=State.CLEARING, trigger=Trigger.CONTROLLING)
        return decision, replace(memory, state=State.PLANNING, last_valid_plan=x.time)

    def _recover(self, x: Observation, theta: PlannerParams, memory: Memory) -> tuple[Decision, Memory]:
        """Start the next behaviour, or give up when all have been tried."""
        if memory.recovery_index >= len(RECOVERIES):
            memory = replace(memory, finished=True, state=State.PLANNING)
            return replace(self._decision(memory, theta, STOP, state="aborted"), aborted=True), memory
        behaviour = RECOVERIES[memory.recovery_index]
        memory = replace(memory, recoveries=memory.recoveries + 1)
        if behaviour.clear_beyond is None:
            return self._rotate(x, theta, replace(memory, rotation=Rotation(x.pose.yaw)))
        memory = self._recovered(x, memory)
        clear = behaviour.clear_beyond if self.settings.clearing_works else None
        return replace(self._decision(memory, theta, None, state=behaviour.name), clear_beyond=clear), memory

    def _rotate(self, x: Observation, theta: PlannerParams, memory: Memory) -> tuple[Decision, Memory]:
        """One cycle of the rotate recovery; it ends without a stop command, as in ROS."""
        assert memory.rotation is not None
        assert memory.plan.local is not None
        rotation, left = _turn_left(memory.rotation, x.pose.yaw)
        if _rotation_is_legal(memory.plan.local, x.pose, left):
            command = Command(0.0, min(max(math.sqrt(2.0 * ROTATE_ACCELERATION * left), ROTATE_MIN), ROTATE_MAX))
            done = rotation.half_turn_seen and abs(shortest_angle(x.pose.yaw, rotation.start_yaw)) <= ROTATE_TOLERANCE
        else:
            command, done = None, True
        memory = self._recovered(x, memory) if done else replace(memory, rotation=rotation)
        return self._decision(memory, theta, command, state="rotate_recovery"), memory

    @staticmethod
    def _recovered(x: Observation, memory: Memory) -> Memory:
        """After a behaviour: plan again, and take the next one if that fails too."""
        return replace(
            memory,
            rotation=None,
            state=State.PLANNING,
            last_valid_plan=x.time,
            recovery_index=memory.recovery_index + 1,
        )

    def _decision(
        self, memory: Memory, theta: PlannerParams, command: Command | None, state: str | None = None
    ) -> Decision:
        path = None if memory.path is None else memory.path[:, :2]
        shown = _as_map(memory.plan.local) if self.explain and memory.plan.local is not None else None
        return Decision(
            command,
            theta,
            state=state or memory.state.value,
            recoveries=memory.recoveries,
            global_path=path,
            local_costmap=shown,
        )


def _as_map(costmap: Costmap) -> ObstacleMap:
    return ObstacleMap(costmap.cells, costmap.origin, costmap.resolution, (0.0, 0.0, 0.0, 0.0))


def _turn_left(rotation: Rotation, yaw: float) -> tuple[Rotation, float]:
    """The angle still to turn [rad], and whether the half turn has been seen by now."""
    if rotation.half_turn_seen:
        return rotation, abs(shortest_angle(yaw, rotation.start_yaw))
    to_half = abs(shortest_angle(yaw, rotation.start_yaw + math.pi))
    return replace(rotation, half_turn_seen=to_half < ROTATE_TOLERANCE), math.pi + to_half


def _rotation_is_legal(local: Costmap, pose: Pose2, left: float) -> bool:
    """Whether the footprint stays legal over the rest of the turn on the local costmap."""
    x, y = local.origin
    return bool(_turn_is_legal(local.cells, x, y, local.resolution, pose.x, pose.y, pose.yaw, left, FOOTPRINT))


@compiled
def _turn_is_legal(
    cells: Bytes,
    origin_x: float,
    origin_y: float,
    resolution: float,
    x: float,
    y: float,
    yaw: float,
    left: float,
    footprint: Array,
) -> bool:
    turned = 0.0
    while turned < left:
        if footprint_cost(cells, origin_x, origin_y, resolution, x, y, yaw + turned, footprint) < 0:
            return False
        turned += ROTATE_STEP
    return True


@dataclass(frozen=True, slots=True)
class MoveBaseDriver:
    """A driver that runs move_base with one fixed theta: the paper's DWA baseline with the default parameters."""

    theta: PlannerParams = field(default_factory=PlannerParams)
    base: MoveBase = field(default_factory=MoveBase)

    def start(self) -> Memory:
        """The memory of a move_base that has just been given its goal."""
        return Memory()

    def decide(self, observation: Observation, memory: Memory) -> tuple[Decision, Memory]:
        """One tick."""
        return self.base.step(observation, self.theta, memory)
