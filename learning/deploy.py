"""APPLI driving: which context the robot is in, and move_base under that context's parameters.

    g(x) = c if u >= eps_u else 0,  (c, u) = f_phi(x)          context, or the default where the classifier is unsure
    B(x_t) = mode of g over the last w steps                    ties: the context in force stays
    theta = M(B(x_t))                                           M(0) = theta_0

Special cases. Before w steps have passed, B is the mode of those there are. With one context and no classifier that
context is always in force, with none the default. A scan that cannot be judged (no return at all, or the classifier
fails) counts as g = 0 and as a fault, also without confidence.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from learning.policy import GATE_ANGLE, Policy
from twin.planner.move_base import Memory, MoveBase
from twin.records import DEFAULT_CONTEXT, Array, Decision, Observation, Pose2

WAYPOINTS, SPACING = 5, 0.2  # [1], [m] of the path that the gate looks at (authors' preprocess_gp)


@dataclass(frozen=True, slots=True)
class AppliMemory:
    """What the driver carries from tick to tick. Immutable."""

    base: Memory
    recent: tuple[str, ...] = ()  # g of the last w steps, oldest first
    current: str = DEFAULT_CONTEXT  # B of the last step
    faults: int = 0  # scans so far that could not be judged


@dataclass(frozen=True, slots=True)
class Belief:
    """What one scan alone says about the context."""

    context: str  # g(x)
    confidence: float | None  # u of this scan, 0 where gated or not judged; None without a classifier
    fault: bool = False  # could not be judged


@dataclass(frozen=True, slots=True)
class AppliDriver:
    """A driver (`twin.rollout.Driver`) that runs move_base under a policy.

    The policy's switches replace those of `base`: theta was fitted under them.
    """

    policy: Policy
    base: MoveBase = field(default_factory=MoveBase)

    def __post_init__(self) -> None:
        object.__setattr__(self, "base", replace(self.base, settings=self.policy.settings(self.base.settings)))

    def start(self) -> AppliMemory:
        """The memory of a driver that has just been given its goal: default context, nothing seen."""
        return AppliMemory(Memory())

    def decide(self, observation: Observation, memory: AppliMemory) -> tuple[Decision, AppliMemory]:
        """One tick. Raises ValueError for scans of a size that the policy was not trained on."""
        belief = self.believe(observation, memory.base.path)
        recent = (*memory.recent, belief.context)[-self.policy.window :]
        current = mode(recent, memory.current)
        base = memory.base if current == memory.current else _reconfigured(memory.base)
        decision, base = self.base.step(observation, self.policy.theta(current), base)
        decision = replace(decision, context=current, confidence=belief.confidence)
        return decision, AppliMemory(base, recent, current, memory.faults + belief.fault)

    def believe(self, x: Observation, path: Array | None) -> Belief:
        """g(x): the context that this scan alone speaks for. `path` (n, 3): the plan of the last tick, odom, if any."""
        policy = self.policy
        if policy.classifier is None:
            return Belief(policy.labels[0] if policy.labels else DEFAULT_CONTEXT, None)
        policy.classifier.check(len(x.scan.ranges))
        try:
            judgement = policy.classifier.judge(x.scan.ranges)
        except Exception:  # whatever fails in there, the robot drives on under the default
            judgement = None
        if judgement is None:
            return Belief(DEFAULT_CONTEXT, 0.0, fault=True)
        certain = judgement.confidence
        if policy.switches.path_gate and path is not None and abs(path_bearing(path, x.pose)) >= GATE_ANGLE:
            certain = 0.0
        trusted = certain >= policy.eps_u or not policy.use_confidence
        return Belief(judgement.label if trusted else DEFAULT_CONTEXT, certain)


def mode(recent: tuple[str, ...], current: str) -> str:
    """The most frequent entry; of several, `current` if it is one of them, else the latest. `recent` is not empty."""
    counts = Counter(recent)
    most = max(counts.values())
    if counts[current] == most:
        return current
    return next(context for context in reversed(recent) if counts[context] == most)


def path_bearing(path: Array, pose: Pose2) -> float:
    """Mean bearing [rad] from the robot's heading of the first five waypoints, 0.2 m apart along the path.

    path: (n, 2+) x, y [m], odom, n >= 1; a path shorter than 1 m repeats its last point, as in the authors' code. The
    mean is that of directions, so that it has no seam behind the robot.
    """
    points = path[:, :2]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    picked = np.minimum(np.searchsorted(along, SPACING * np.arange(1, WAYPOINTS + 1)), len(points) - 1)
    offsets = points[picked] - np.array([pose.x, pose.y])
    bearings = np.arctan2(offsets[:, 1], offsets[:, 0]) - pose.yaw
    return math.atan2(np.sin(bearings).sum(), np.cos(bearings).sum())


def _reconfigured(memory: Memory) -> Memory:
    """Changing theta is a dynamic_reconfigure, which makes the local planner forget that it reached the goal."""
    if not memory.plan.controller.reached_goal:
        return memory
    controller = replace(memory.plan.controller, reached_goal=False)
    return replace(memory, plan=replace(memory.plan, controller=controller))
