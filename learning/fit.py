"""Eq. 1 of the paper: the parameters theta that make the planner do what the intervener did, by CMA-ES.

    theta_i = argmin_theta  sum over (x, a) in I_i of  lambda_v (v - v')^2 + lambda_w (w - w')^2,
    where (v', w') = G(x; theta)

The search space is the unit cube that `ParameterSpace` maps to parameters. The default parameters always compete, so
no fit is worse than the default on its own data.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import cma
import numpy as np

from learning.imitation import Imitation, LabelledSteps
from learning.interventions import Intervention
from twin.planner.params import INTEGERS, PARAMETER_NAMES, ParameterSpace, PlannerParams
from twin.planner.plan import DEFAULT_SETTINGS, DEFAULT_THETA, PlannerSettings
from twin.records import Array, frozen_array

Progress = Callable[[int, float], None]  # evaluations so far, best loss so far
Start = Literal["middle", "default", "random"]

MARGIN = 0.02  # [cube sides] how far the search may leave the cube; out there is the bound, which is so hit exactly
SMALLEST_STEP = 1e-5  # [cube sides] a search whose steps are smaller is over
MOST_SKEWED = 1e14  # condition number of the covariance (pycma's own limit)
FLATNESS_GRID = 21  # values of each parameter that are looked at


@dataclass(frozen=True, slots=True)
class FitSettings:
    """How Eq. 1 is solved. In brackets what the authors' code has (spec: APPLD); their scale is 10 per cube side."""

    lambda_v: float = 1.0  # [s^2/m^2] weight of the linear error (v and omega weighted equally)
    lambda_w: float = 1.0  # [s^2/rad^2] weight of the angular error
    population: int = 12  # (12)
    sigma: float = 0.2  # [cube sides] first step size (2 of 10)
    start: Start = "middle"  # where the first search starts (the middle); later ones start at random points
    restarts: int = 2  # further searches after the first (none)
    max_evaluations: int = 3000  # of the loss, over all searches (12 x 800)
    patience: int = 25  # a search ends after so many generations without progress (tolfun 1e-11)
    min_progress: float = 1e-3  # relative to the default's loss; less over `patience` generations is no progress
    seed: int = 0
    max_steps: int | None = 120  # search on so many steps, evenly spread; None: all. Losses are reported on all
    space: ParameterSpace = field(default_factory=ParameterSpace)
    planner: PlannerSettings = DEFAULT_SETTINGS
    flatness: float = 0.05  # a parameter is flat as far as it costs no more than this share of what the fit gained

    def __post_init__(self) -> None:
        for name in ("lambda_v", "lambda_w"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be a finite number >= 0, not {getattr(self, name)!r}")
        if self.lambda_v == self.lambda_w == 0.0:
            raise ValueError("lambda_v and lambda_w must not both be 0")
        for name, least in (("population", 4), ("restarts", 0), ("max_evaluations", 1), ("patience", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be at least {least}, not {getattr(self, name)}")
        if self.max_steps is not None and self.max_steps < 1:
            raise ValueError(f"max_steps must be at least 1, not {self.max_steps}")
        if not 0.0 < self.sigma <= 1.0:
            raise ValueError(f"sigma must be in (0, 1], not {self.sigma}")


@dataclass(frozen=True, eq=False, slots=True)
class FitResult:
    """theta_i of the paper, and how well it is determined. Losses are sums over all labelled steps (Eq. 1)."""

    theta: PlannerParams
    loss: float
    default_loss: float
    demonstrated: Array  # (n, 2) v [m/s], w [rad/s] of the intervener, labelled steps
    default_actions: Array  # (n, 2) of G with the default parameters
    actions: Array  # (n, 2) of G with theta
    curve: Array  # (k, 2) evaluations, best loss so far, on the steps that were searched on
    flatness: dict[str, tuple[float, float]]  # name -> range of values that cost almost nothing, all others held
    steps: int  # searched on
    evaluations: int
    seconds: float  # of wall time
    settings: FitSettings
    interrupted: bool = False  # by Ctrl-C; theta is the best so far

    @property
    def rms_error(self) -> tuple[float, float]:
        """Root mean square error of v [m/s] and of w [rad/s] with theta."""
        v, w = np.sqrt(np.mean((self.actions - self.demonstrated) ** 2, axis=0)).tolist()
        return v, w

    @property
    def default_rms_error(self) -> tuple[float, float]:
        """The same with the default parameters."""
        v, w = np.sqrt(np.mean((self.default_actions - self.demonstrated) ** 2, axis=0)).tolist()
        return v, w


def fit(
    interventions: Intervention | Sequence[Intervention],
    settings: FitSettings | None = None,
    progress: Progress | None = None,
) -> FitResult:
    """Solve Eq. 1 for one intervention, or for several that teach the same context (one sum over all their steps).

    The same arguments give the same theta. Raises ValueError when no step is labelled. Ctrl-C ends the search early
    and keeps the best so far.
    """
    settings = settings or FitSettings()
    taught = [interventions] if isinstance(interventions, Intervention) else list(interventions)
    labels = {i.label for i in taught}
    if len(labels) != 1:
        raise ValueError(f"one fit is for one context, not for {', '.join(sorted(labels)) or 'none'}")
    everything = LabelledSteps.of([i.packed for i in taught])
    if len(everything) == 0:
        raise ValueError(f"intervention {labels.pop()} has no labelled steps to learn from")
    began = time.perf_counter()
    search = _Search(everything.spread(settings.max_steps), settings, progress)
    interrupted, flatness = False, {}
    try:
        search.evaluate(DEFAULT_THETA)
        rng = np.random.default_rng(settings.seed)
        for k in range(1 + settings.restarts):
            search.run(_start_point(settings, k, rng), int(rng.integers(1, 2**31)))
        flatness = search.flatness()
    except KeyboardInterrupt:
        interrupted = True

    whole = search.imitation if len(search.imitation) == len(everything) else Imitation(everything, settings.planner)
    default_actions, actions = whole.actions(DEFAULT_THETA), whole.actions(search.best_theta)
    default_loss, loss = (whole.loss(a, settings.lambda_v, settings.lambda_w) for a in (default_actions, actions))
    theta = search.best_theta
    if loss > default_loss:  # only possible where the search saw a part of the steps
        theta, actions, loss = DEFAULT_THETA, default_actions, default_loss
    return FitResult(
        theta=theta,
        loss=loss,
        default_loss=default_loss,
        demonstrated=whole.demonstrated,
        default_actions=default_actions,
        actions=actions,
        curve=frozen_array(np.array(search.curve, dtype=np.float64).reshape(-1, 2)),
        flatness=flatness,
        steps=len(search.imitation),
        evaluations=search.evaluations,
        seconds=time.perf_counter() - began,
        settings=settings,
        interrupted=interrupted,
    )


def _start_point(settings: FitSettings, number: int, rng: np.random.Generator) -> Array:
    """(8,) in the unit cube: where search `number` starts."""
    random = rng.uniform(0.1, 0.9, len(PARAMETER_NAMES))
    if number > 0 or settings.start == "random":
        return random
    return settings.space.encode(DEFAULT_THETA) if settings.start == "default" else np.full(len(random), 0.5)


class _Search:
    """One fit in progress: counts evaluations and keeps the best."""

    def __init__(self, steps: LabelledSteps, settings: FitSettings, progress: Progress | None) -> None:
        self.imitation = Imitation(steps, settings.planner)
        self.settings = settings
        self.progress = progress
        self.evaluations = 0
        self.best_theta, self.best_loss = DEFAULT_THETA, math.inf
        self.default_loss = math.inf
        self.curve: list[tuple[int, float]] = []

    def loss(self, theta: PlannerParams) -> float:
        """Eq. 1's sum for one theta."""
        actions = self.imitation.actions(theta)
        return self.imitation.loss(actions, self.settings.lambda_v, self.settings.lambda_w)

    def evaluate(self, theta: PlannerParams) -> float:
        """The loss of a candidate, which may become the best."""
        loss = self.loss(theta)
        self.evaluations += 1
        if loss < self.best_loss:
            self.best_theta, self.best_loss = theta, loss
            self.curve.append((self.evaluations, loss))
        if theta == DEFAULT_THETA:
            self.default_loss = loss
        if self.progress is not None:
            self.progress(self.evaluations, self.best_loss)
        return loss

    def run(self, start: Array, seed: int) -> None:
        """One CMA-ES search from a point (8,) of the unit cube, until it stops making progress."""
        settings = self.settings
        strategy = cma.CMAEvolutionStrategy(start.tolist(), settings.sigma, _options(settings.population, seed))
        best, stale = math.inf, 0
        while stale < settings.patience and self.evaluations < settings.max_evaluations and not _is_over(strategy):
            points = strategy.ask()
            losses = [self.evaluate(settings.space.decode(np.asarray(p))) for p in points]
            strategy.tell(points, losses)
            stale = 0 if min(losses) < best - settings.min_progress * self.default_loss else stale + 1
            best = min(best, *losses)

    def flatness(self) -> dict[str, tuple[float, float]]:
        """For each parameter the values round the best that cost almost nothing while the other seven stay."""
        settings = self.settings
        allowed = self.best_loss + settings.flatness * max(self.best_loss, self.default_loss - self.best_loss)
        ranges = {}
        for name, low, high in zip(PARAMETER_NAMES, settings.space.lower, settings.space.upper, strict=True):
            values = np.unique(np.linspace(low, high, FLATNESS_GRID).round(0 if name in INTEGERS else 9))
            here = getattr(self.best_theta, name)
            ends = []
            for side in (values[values < here][::-1], values[values > here]):
                end = here
                for value in side.tolist():
                    theta = PlannerParams.from_mapping(self.best_theta.as_dict() | {name: value})
                    if self.loss(theta) > allowed:
                        break
                    end = value
                ends.append(end)
            ranges[name] = (ends[0], ends[1])
        return ranges


def _options(population: int, seed: int) -> dict[str, object]:
    """pycma's options: random numbers of our own, no output, no stopping criteria but ours."""
    numbers = np.random.default_rng(seed)
    return {
        "bounds": [-MARGIN, 1.0 + MARGIN],
        "popsize": population,
        "randn": lambda *size: numbers.standard_normal(size),
        "seed": math.nan,  # leave numpy's global generator alone
        "verbose": -9,
    }


def _is_over(strategy: cma.CMAEvolutionStrategy) -> bool:
    """Whether steps have become so small or so skewed that nothing more can come."""
    return bool(strategy.sigma * max(strategy.D) < SMALLEST_STEP or strategy.condition_number > MOST_SKEWED)
