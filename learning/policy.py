"""What a training leaves behind: parameters per context, the classifier, and how they are used. One file."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import safetensors.numpy

from learning.classifier import BEAMS, EvidentialClassifier
from twin.planner.move_base import MoveBaseSettings
from twin.planner.params import PARAMETER_NAMES, PlannerParams
from twin.records import DEFAULT_CONTEXT

ROBOT = "jackal"
KIND = "appli-policy"
SCHEMA = 1
EPS_U = 0.8  # (paper, section IV)
WINDOW = 20  # steps = 1 s at 20 Hz; the paper leaves w open
GATE_ANGLE = math.radians(60.0)  # (authors' deployed node)
MAX_BYTES = 16 * 1024 * 1024  # a policy has well under one megabyte
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
    """Where a policy comes from. Says nothing about how to drive."""

    interventions: dict[str, str] = field(default_factory=dict)  # digest -> context label
    losses: dict[str, tuple[float, float]] = field(default_factory=dict)  # label -> Eq. 1 of (default, theta_i)
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


# --- to a file -------------------------------------------------------------------------------------------------------


def policy_bytes(policy: Policy) -> bytes:
    """The file's contents; equal policies give equal bytes."""
    metadata = {
        "kind": KIND,
        "schema": SCHEMA,
        "robot": ROBOT,
        "beams": BEAMS,
        "contexts": [{"label": c.label, "theta": c.theta.as_dict()} for c in policy.contexts],
        "default": policy.default.as_dict(),
        "eps_u": policy.eps_u,
        "window": policy.window,
        "use_confidence": policy.use_confidence,
        "switches": asdict(policy.switches),
        "provenance": asdict(policy.provenance),
        "classifier": None if policy.classifier is None else list(policy.classifier.labels),
    }
    weights = {} if policy.classifier is None else policy.classifier.weights
    text = json.dumps(metadata, sort_keys=True, allow_nan=False)
    return bytes(safetensors.numpy.save(weights, {"appli": text}))


def save_policy(policy: Policy, path: Path) -> None:
    """Write the policy; a file of that name is replaced at once or not at all. Raises OSError."""
    data = policy_bytes(policy)
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        mask = os.umask(0)  # mkstemp makes private files; a policy is an ordinary one
        os.umask(mask)
        os.chmod(name, 0o666 & ~mask)
        os.replace(name, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(name)
        raise


# --- from a file -----------------------------------------------------------------------------------------------------


def load_policy(path: Path) -> Policy:
    """Read a policy file, trusting nothing in it. Raises PolicyError with one line that names the file."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise PolicyError(f"not a policy: larger than {MAX_BYTES // 2**20} MiB")
        data = path.read_bytes()
    except OSError as error:
        raise PolicyError(f"{path}: {error.strerror or error}") from error
    except PolicyError as error:
        raise PolicyError(f"{path}: {error}") from None
    try:
        return parse_policy(data)
    except PolicyError as error:
        raise PolicyError(f"{path}: {error}") from error


def parse_policy(data: bytes) -> Policy:
    """The policy in a file's contents. Raises PolicyError."""
    try:
        tensors = safetensors.numpy.load(data)
        header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
        text = header.get("__metadata__", {}).get("appli")
    except Exception as error:  # whatever a foreign file makes of the parser
        raise PolicyError("not a policy, or a truncated one; make one with: appli train DIR --out FILE") from error
    if not isinstance(text, str):
        raise PolicyError("a safetensors file, but not a policy; make one with: appli train DIR --out FILE")
    try:
        values = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise PolicyError("damaged policy: its metadata is not JSON") from error
    fields = _Fields(values, "policy")
    if fields.text("kind") != KIND:
        raise PolicyError("a safetensors file, but not a policy; make one with: appli train DIR --out FILE")
    if (schema := fields.whole("schema")) != SCHEMA:
        age = "a newer version of appli-twin wrote it; update appli-twin" if schema > SCHEMA else "train it again"
        raise PolicyError(f"policy format {schema}, this version reads {SCHEMA}: {age}")
    if (robot := fields.text("robot")) != ROBOT:
        raise PolicyError(f"a policy for the robot {robot!r}; this one is a {ROBOT!r}")
    if (beams := fields.whole("beams")) != BEAMS:
        raise PolicyError(f"a policy for scans of {beams} beams; this robot's have {BEAMS}")
    try:
        return _policy(fields, tensors)
    except PolicyError:
        raise
    except ValueError as error:
        raise PolicyError(f"damaged policy: {' '.join(str(error).split())}") from error


def _policy(fields: _Fields, tensors: Mapping[str, Any]) -> Policy:
    switches, origin = fields.inside("switches"), fields.inside("provenance")
    contexts = tuple(
        Context(entry.text("label"), _theta(entry.inside("theta")))
        for entry in (_Fields(item, "a context") for item in fields.items("contexts"))
    )
    classifier = None
    if (labels := fields.values.get("classifier")) is not None:
        if not isinstance(labels, list) or not all(isinstance(label, str) for label in labels):
            raise ValueError("'classifier' must list the names of its contexts")
        classifier = EvidentialClassifier.from_weights(tuple(labels), {k: np.array(v) for k, v in tensors.items()})
    elif tensors:
        raise ValueError("weights without a classifier")
    return Policy(
        contexts,
        classifier,
        default=_theta(fields.inside("default")),
        eps_u=fields.number("eps_u"),
        window=fields.whole("window"),
        use_confidence=fields.flag("use_confidence"),
        switches=PolicySwitches(
            switches.flag("path_gate"),
            switches.text("inflation"),  # type: ignore[arg-type]  # Policy checks it
            switches.flag("couple_min_vel_theta"),
        ),
        provenance=Provenance(
            origin.inside("interventions").mapping(_Fields.text),
            origin.inside("losses").mapping(_Fields.pair),
            origin.inside("figures").mapping(_Fields.number),
            origin.inside("versions").mapping(_Fields.text),
            origin.text("types"),
            origin.whole("seed"),
        ),
    )


def _theta(fields: _Fields) -> PlannerParams:
    if set(fields.values) != set(PARAMETER_NAMES):
        raise ValueError(f"{fields.name} must hold {', '.join(PARAMETER_NAMES)}")
    return PlannerParams.from_mapping({name: fields.number(name) for name in PARAMETER_NAMES})


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} in JSON")


class _Fields:
    """A JSON object whose values are asked for by type; ValueError names what is missing or wrong."""

    def __init__(self, values: object, name: str) -> None:
        if not isinstance(values, dict):
            raise PolicyError(f"damaged policy: {name} is not a JSON object")
        self.values, self.name = values, name

    def _get(self, key: str, kind: type | tuple[type, ...], words: str) -> Any:
        value = self.values.get(key)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise PolicyError(f"damaged policy: {key!r} in {self.name} must be {words}")
        return value

    def text(self, key: str) -> str:
        return str(self._get(key, str, "text"))

    def flag(self, key: str) -> bool:
        return bool(self._get(key, bool, "true or false"))

    def whole(self, key: str) -> int:
        return int(self._get(key, int, "a whole number"))

    def number(self, key: str) -> float:
        try:
            value = float(self._get(key, (int, float), "a number"))
        except OverflowError:
            value = math.inf
        if not math.isfinite(value):
            raise PolicyError(f"damaged policy: {key!r} in {self.name} must be finite")
        return value

    def items(self, key: str) -> list[object]:
        return list(self._get(key, list, "a list"))

    def inside(self, key: str) -> _Fields:
        return _Fields(self.values.get(key), f"{key!r}")

    def pair(self, key: str) -> tuple[float, float]:
        if len(items := self.items(key)) != 2:
            raise PolicyError(f"damaged policy: {key!r} in {self.name} must be two numbers")
        both = _Fields({"0": items[0], "1": items[1]}, f"{key!r}")
        return both.number("0"), both.number("1")

    def mapping(self, read: Any) -> dict[str, Any]:
        return {key: read(self, key) for key in self.values}
