"""Eq. 1 of the paper: the parameters theta that make the planner do what the intervener did, by CMA-ES.

    theta_i = argmin_theta  sum over (x, a) in I_i of  lambda_v (v - v')^2 + lambda_w (w - w')^2,
    where (v', w') = G(x; theta)

The search space is the unit cube that `ParameterSpace` maps to parameters. Searches start in the middle and at the best
of points scattered over the cube; the last, with small steps, at the best of what was found. Of all that is as good as
the best, the parameters nearest to the default are taken, after each has been moved towards it as far as that costs
nothing: what the demonstrations leave open stays as it was. The default parameters always compete, so no fit is worse
than the default on its own data.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

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
PIECE = 100  # [steps] at a time when all are judged
STARTS_APART = 0.5  # [cube sides] between points to search from
NEARER = 20  # points on the way from a parameter's default to its value
FLATNESS_GRID = 21  # values of each parameter that are looked at


@dataclass(frozen=True, slots=True)
class FitSettings:
    """How Eq. 1 is solved. In brackets what the authors' code has (spec: APPLD); their scale is 10 per cube side."""

    lambda_v: float = 1.0  # [s^2/m^2] weight of the linear error (v and omega weighted equally)
    lambda_w: float = 1.0  # [s^2/rad^2] weight of the angular error
    population: int = 12  # (12)
    start: Start = "middle"  # of the first search (the middle)
    sigma: float = 0.2  # [cube sides] first step size (2 of 10)
    scattered: int = 200  # random points, looked at before the restarts (none)
    restarts: int = 8  # further searches, from the best of those points (none)
    last_sigma: float = 0.05  # [cube sides] first step size of the last search, from the best so far (there is none)
    max_steps: int = 300  # search on so many steps, evenly spread; neighbours are much alike (all)
    max_evaluations: int = 8000  # of the sum, by all searches together, whole generations (12 x 800)
    patience: int = 10  # a search ends after so many generations without progress (tolfun 1e-11)
    min_progress: float = 1e-3  # as a share of the default's loss; less in one generation is no progress
    modesty: float = 0.10  # given up for being nearer to the default: a share of what was gained or of what is left (0)
    seed: int = 0
    space: ParameterSpace = field(default_factory=ParameterSpace)
    planner: PlannerSettings = DEFAULT_SETTINGS
    flatness: float = (
        0.05  # a parameter is flat as far as it costs this share of what was gained or, if more, of the rest
    )

    def __post_init__(self) -> None:
        for name in ("lambda_v", "lambda_w"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be a finite number >= 0, not {getattr(self, name)!r}")
        if self.lambda_v == self.lambda_w == 0.0:
            raise ValueError("lambda_v and lambda_w must not both be 0")
        least = {"population": 4, "scattered": 0, "restarts": 0, "max_steps": 1, "max_evaluations": 1, "patience": 1}
        for name, low in least.items():
            if getattr(self, name) < low:
                raise ValueError(f"{name} must be at least {low}, not {getattr(self, name)}")
        if not 0.0 <= self.modesty < 1.0:
            raise ValueError(f"modesty must be in [0, 1), not {self.modesty}")
        for name in ("sigma", "last_sigma"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"{name} must be in (0, 1], not {getattr(self, name)}")
        if self.start not in get_args(Start):
            raise ValueError(f"start must be one of {', '.join(get_args(Start))}, not {self.start!r}")


@dataclass(frozen=True, eq=False, slots=True)
class FitResult:
    """theta_i of the paper, and how well it is determined. Losses are sums over all labelled steps (Eq. 1)."""

    theta: PlannerParams
    loss: float
    default_loss: float
    demonstrated: Array  # (n, 2) v [m/s], w [rad/s] of the intervener, labelled steps
    default_actions: Array  # (n, 2) of G with the default parameters
    actions: Array  # (n, 2) of G with theta
    curve: Array  # (k, 3) evaluations, number of the search, its best loss so far (of the sample, scaled up)
    flatness: dict[str, tuple[float, float]]  # name -> range of values that cost almost nothing, all others held
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
    labels = sorted({i.label for i in taught})
    if len(labels) != 1:
        raise ValueError(f"one fit is for one context, not for {', '.join(labels) or 'none'}")
    steps = LabelledSteps.of([i.packed for i in taught])
    if not len(steps):
        raise ValueError(f"intervention {labels[0]} has no labelled steps to learn from")
    began, fitting = time.perf_counter(), _Fitting(steps, settings, progress)
    interrupted, flatness = False, dict[str, tuple[float, float]]()
    try:
        fitting.run()
    except KeyboardInterrupt:
        interrupted = True
    thetas = [DEFAULT_THETA, fitting.chosen()]
    actions = _judge(steps, fitting.sample, thetas, settings.planner)
    losses = [_loss(a, steps.actions, settings) for a in actions]
    best = losses.index(min(losses))
    try:
        flatness = {} if interrupted else fitting.flatness(thetas[best])
    except KeyboardInterrupt:
        interrupted = True
    return FitResult(
        theta=thetas[best],
        loss=losses[best],
        default_loss=losses[0],
        demonstrated=steps.actions,
        default_actions=actions[0],
        actions=actions[best],
        curve=frozen_array(np.array(fitting.curve, dtype=np.float64).reshape(-1, 3)),
        flatness=flatness,
        evaluations=fitting.evaluations,
        seconds=time.perf_counter() - began,
        settings=settings,
        interrupted=interrupted,
    )


def _loss(actions: Array, demonstrated: Array, settings: FitSettings) -> float:
    """Eq. 1's sum for actions (n, 2)."""
    v, w = ((actions - demonstrated) ** 2).sum(axis=0).tolist()
    return float(settings.lambda_v * v + settings.lambda_w * w)


def _judge(
    steps: LabelledSteps, sample: Imitation, thetas: Sequence[PlannerParams], planner: PlannerSettings
) -> list[Array]:
    """G's actions (n, 2) on all steps for each theta, in pieces, because a step takes 0.25 MB for each R."""
    if len(sample) == len(steps):
        return [sample.actions(theta) for theta in thetas]
    pieces = []
    for chunk in steps.chunks(PIECE):
        imitation = Imitation(chunk, planner)
        pieces.append([imitation.actions(theta) for theta in thetas])
    return [frozen_array(np.concatenate(of_theta)) for of_theta in zip(*pieces, strict=True)]


class _Fitting:
    """A fit in progress."""

    def __init__(self, steps: LabelledSteps, settings: FitSettings, progress: Progress | None) -> None:
        self.settings = settings
        self.progress = progress
        few = steps.spread(settings.max_steps)
        self.sample = Imitation(few, settings.planner)
        self._demonstrated = few.actions
        self._scale = len(steps) / len(few)
        self.default_loss = self.loss(DEFAULT_THETA)
        self.best = self.default_loss, DEFAULT_THETA
        self.seen = [self.best]  # everything that was looked at
        self.searches = 0
        self.evaluations = 0
        self.curve: list[tuple[int, int, float]] = []

    def loss(self, theta: PlannerParams) -> float:
        """Eq. 1's sum for one theta, scaled up to all steps when only a sample is looked at."""
        return _loss(self.sample.actions(theta), self._demonstrated, self.settings) * self._scale

    def chosen(self) -> PlannerParams:
        """Of all that was seen and is as good as the best, the one nearest to the default in the unit cube.

        As good: within a share of what the best gained, and of what it leaves unexplained, the hand's noise. Where the
        best explains everything, nothing is given up.
        """
        encode, allowed = self.settings.space.encode, self.allowed
        origin = encode(DEFAULT_THETA)
        near = [(float(np.linalg.norm(encode(theta) - origin)), loss, theta) for loss, theta in self.seen]
        return min((n for n in near if n[1] <= allowed), key=lambda n: n[:2])[2]

    @property
    def allowed(self) -> float:
        """The largest loss that is as good as the best so far."""
        best = self.best[0]
        return best + self.settings.modesty * min(self.default_loss - best, best)

    def run(self) -> None:
        """All searches, and what lies between their outcome and the default."""
        rng = np.random.default_rng(self.settings.seed)
        for start in self.starts(rng):
            self._search(start, self.settings.sigma, rng)
        self._search(self.settings.space.encode(self.best[1]), self.settings.last_sigma, rng)
        self._draw_nearer()

    def _draw_nearer(self) -> None:
        """Move what is chosen towards the default, one parameter at a time, as far as it stays as good; twice round."""
        space = self.settings.space
        origin, point = space.encode(DEFAULT_THETA), space.encode(self.chosen())
        for _ in range(2):
            for k in np.argsort(-np.abs(point - origin)):
                for share in np.linspace(0.0, 1.0, NEARER, endpoint=False):
                    nearer = point.copy()
                    nearer[k] = origin[k] + share * (point[k] - origin[k])
                    if self.evaluations >= self.settings.max_evaluations:
                        return
                    if self._look(space.decode(nearer)) <= self.allowed:
                        point = nearer
                        break

    def starts(self, rng: np.random.Generator) -> Iterator[Array]:
        """Where to search from: the first, then the best of scattered points, no two of them close to each other."""
        settings, middle = self.settings, np.full(len(PARAMETER_NAMES), 0.5)
        default = settings.space.encode(DEFAULT_THETA)
        yield {"middle": middle, "default": default, "random": rng.uniform(0.1, 0.9, len(middle))}[settings.start]
        left = max(0, settings.max_evaluations - self.evaluations)
        count = min(max(settings.scattered, settings.restarts), left // 2) if settings.restarts else 0
        points = rng.uniform(size=(count, len(middle)))
        worth = [self._look(settings.space.decode(point)) for point in points]
        chosen: list[Array] = []
        for point in points[np.argsort(worth, kind="stable")]:
            if all(np.linalg.norm(point - other) > STARTS_APART for other in chosen):
                chosen.append(point)
                yield point
            if len(chosen) == settings.restarts:
                return

    def _look(self, theta: PlannerParams) -> float:
        """The loss of a candidate, which is kept in mind."""
        loss = self.loss(theta)
        self.seen.append((loss, theta))
        self.evaluations += 1
        if loss < self.best[0]:
            self.best = loss, theta
        if self.progress is not None:
            self.progress(self.evaluations, self.best[0])
        return loss

    def _search(self, start: Array, sigma: float, rng: np.random.Generator) -> None:
        """One CMA-ES search from a point (8,) of the unit cube, until it stops making progress."""
        settings = self.settings
        strategy = cma.CMAEvolutionStrategy(start.tolist(), sigma, _options(settings.population, rng))
        number, self.searches = self.searches, self.searches + 1
        best, stale = self.default_loss, 0
        enough = settings.min_progress * best
        while stale < settings.patience and self.evaluations < settings.max_evaluations and not _is_over(strategy):
            points = strategy.ask()
            before, losses = best, []
            for theta in (settings.space.decode(np.asarray(p)) for p in points):
                losses.append(self._look(theta))
                if losses[-1] < best:
                    best = losses[-1]
                    self.curve.append((self.evaluations, number, best))
            strategy.tell(points, losses)
            stale = 0 if best < before - enough else stale + 1

    def flatness(self, theta: PlannerParams) -> dict[str, tuple[float, float]]:
        """For each parameter the values round theta's that cost almost nothing while the other seven stay."""
        settings, best = self.settings, self.loss(theta)
        allowed = best + settings.flatness * max(best, self.default_loss - best)
        ranges = {}
        for name, low, high in zip(PARAMETER_NAMES, settings.space.lower, settings.space.upper, strict=True):
            values = np.unique(np.linspace(low, high, FLATNESS_GRID).round(0 if name in INTEGERS else 9))
            here = getattr(theta, name)
            ends = []
            for side in (values[values < here][::-1], values[values > here]):
                end = here
                for value in side.tolist():
                    if self.loss(PlannerParams.from_mapping(theta.as_dict() | {name: value})) > allowed:
                        break
                    end = value
                ends.append(end)
            ranges[name] = (ends[0], ends[1])
        return ranges


def _options(population: int, rng: np.random.Generator) -> dict[str, object]:
    """pycma's options: random numbers of our own, no output, no stopping criteria but ours."""
    numbers = np.random.default_rng(rng.integers(2**63))
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
