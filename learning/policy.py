"""What a training leaves behind: parameters per context, the classifier, and how they are used."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from learning.classifier import EvidentialClassifier
from twin.planner.move_base import MoveBaseSettings
from twin.planner.params import PlannerParams
from twin.records import DEFAULT_CONTEXT

EPS_U = 0.8  # (paper, section IV)
WINDOW = 20  # steps = 1 s at 20 Hz; the paper leaves w open
GATE_ANGLE = math.radians(60.0)  # (authors' deployed node)
MAX_WINDOW = 10_000
MAX_CONTEXTS = 64
MAX_LABEL = 64  # characters

Inflation = Literal["both", "local"]


class PolicyError(ValueError):
    """One line that says why a policy cannot be used."""


@dataclass(frozen=True, slots=True)
class Context:
    """One learned context: M(i) = theta_i."""

    label: str  # A1, A2, B1, ...
    theta: PlannerParams


@dataclass(frozen=True, slots=True)
class PolicySwitches:
    """What paper and code leave open; they belong to the policy because theta was fitted under them."""

    path_gate: bool = False  # confidence 0 while the path leads 60 degrees or more to the side (authors' node: on)
    inflation: Inflation = "both"  # which costmaps obey theta's inflation_radius (authors' node: local)
    couple_min_vel_theta: bool = False  # min_vel_theta = -max_vel_theta with every theta


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a policy comes from. Says nothing about how to drive.

    `curves`: label -> (evaluations, best loss of Eq. 1 so far); "classifier" -> (steps, loss on held-out scans).
    """

    interventions: dict[str, str] = field(default_factory=dict)  # digest -> context label
    losses: dict[str, tuple[float, float]] = field(default_factory=dict)  # label -> Eq. 1 of (default, theta_i)
    errors: dict[str, tuple[float, float]] = field(default_factory=dict)  # label -> rms of v [m/s], w [rad/s], theta_i
    flatness: dict[str, dict[str, tuple[float, float]]] = field(default_factory=dict)  # label -> FitResult.flatness
    curves: dict[str, list[tuple[float, float]]] = field(default_factory=dict)  # see below
    figures: dict[str, float] = field(default_factory=dict)  # of the classifier, e.g. accuracy on held-out blocks
    versions: dict[str, str] = field(default_factory=dict)  # package -> version
    types: str = ""  # intervention types used, e.g. "A,B"
    seed: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Policy:
    """theta_0 .. theta_N and f_phi, ready to drive. Raises PolicyError when the parts do not fit together."""

    contexts: tuple[Context, ...]
    classifier: EvidentialClassifier | None = None  # None only with fewer than two contexts
    default: PlannerParams = field(default_factory=PlannerParams)  # theta_0
    eps_u: float = EPS_U  # confidence below which the default context is taken; 0 = never, above 1 = always
    window: int = WINDOW  # w, steps of the mode filter; 1 = no filter
    use_confidence: bool = True  # False: the paper's variants without "+c", which never take the default context
    switches: PolicySwitches = field(default_factory=PolicySwitches)
    provenance: Provenance = field(default_factory=Provenance)

    def __post_init__(self) -> None:
        labels = self.labels
        for label in labels:
            if not label or len(label) > MAX_LABEL or not label.isprintable() or label == DEFAULT_CONTEXT:
                raise PolicyError(f"a context cannot be called {label!r}")
        if len(set(labels)) != len(labels) or len(labels) > MAX_CONTEXTS:
            raise PolicyError(f"contexts must have different names and be at most {MAX_CONTEXTS}, not {list(labels)}")
        if self.classifier is None and len(labels) > 1:
            raise PolicyError(f"contexts {', '.join(labels)} need a classifier to choose between them")
        if self.classifier is not None and sorted(self.classifier.labels) != sorted(labels):
            raise PolicyError(f"the classifier knows {', '.join(self.classifier.labels)}, not {', '.join(labels)}")
        if not math.isfinite(self.eps_u) or self.eps_u < 0.0:
            raise PolicyError(f"eps_u must be 0 or more, not {self.eps_u}")
        if not 1 <= self.window <= MAX_WINDOW:
            raise PolicyError(f"window must be 1 to {MAX_WINDOW} steps, not {self.window}")
        if self.switches.inflation not in ("both", "local"):
            raise PolicyError(f"inflation must be 'both' or 'local', not {self.switches.inflation!r}")

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the contexts 1 .. N."""
        return tuple(context.label for context in self.contexts)

    def theta(self, label: str) -> PlannerParams:
        """M: the parameters of a context, theta_0 for the default one."""
        return next((c.theta for c in self.contexts if c.label == label), self.default)

    def settings(self, base: MoveBaseSettings) -> MoveBaseSettings:
        """`base` under this policy's switches."""
        s = self.switches
        planner = replace(base.planner, inflation=s.inflation, couple_min_vel_theta=s.couple_min_vel_theta)
        return replace(base, planner=planner)
