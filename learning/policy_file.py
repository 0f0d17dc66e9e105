"""A policy as one `.safetensors` file: the classifier's weights, and everything else as JSON in the header."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import safetensors.numpy

from learning.classifier import BEAMS, EvidentialClassifier
from learning.policy import Context, Policy, PolicyError, PolicySwitches, Provenance
from twin.planner.params import PARAMETER_NAMES, PlannerParams

ROBOT = "jackal"
KIND = "appli-policy"
SCHEMA = 1
MAX_BYTES = 16 * 1024 * 1024  # a policy has about one megabyte

_Value = TypeVar("_Value")


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
            origin.inside("errors").mapping(_Fields.pair),
            origin.inside("flatness").mapping(lambda fits, label: fits.inside(label).mapping(_Fields.pair)),
            origin.inside("curves").mapping(_Fields.pairs),
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
        return self._pair(key, self.items(key))

    def pairs(self, key: str) -> list[tuple[float, float]]:
        return [self._pair(key, item) for item in self.items(key)]

    def _pair(self, key: str, items: object) -> tuple[float, float]:
        if not isinstance(items, list) or len(items) != 2:
            raise PolicyError(f"damaged policy: {key!r} in {self.name} must hold two numbers")
        both = _Fields({"0": items[0], "1": items[1]}, f"{key!r}")
        return both.number("0"), both.number("1")

    def mapping(self, read: Callable[[_Fields, str], _Value]) -> dict[str, _Value]:
        return {key: read(self, key) for key in self.values}
