"""The policies behind the trials: Table I and the provenance of what was learned."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from learning.policy import Policy, PolicyError
from learning.policy_file import parse_policy
from learning.published import published_parameters
from scenarios.errors import UserError, blame
from scenarios.identity import policy_digest
from scenarios.report.facts import Facts
from scenarios.report.paper import in_order
from scenarios.report.sheet import BOUNDS, CHANGE, COUNT, ERRORS, SHORT, Column, Sheet
from twin.planner.params import PARAMETER_NAMES, PlannerParams


@dataclass(frozen=True, slots=True)
class PolicyFile:
    """A policy, and the bytes that it was read from."""

    policy: Policy
    data: bytes
    digest: str


def read_policies(folder: Path, facts: Facts) -> dict[str, PolicyFile]:
    """Method -> policy. Raises UserError for a folder that has none, or others than the trials were driven with."""
    paths = {path.stem: path for path in sorted(folder.glob("*.safetensors"))}
    if not paths:
        what = "has no *.safetensors" if folder.is_dir() else "is not a folder"
        raise UserError(f"{folder} {what}; give the folder that appli train wrote")
    found = {}
    for name in in_order(set(paths)):
        with blame():
            data = paths[name].read_bytes()
        try:
            found[name] = PolicyFile(parse_policy(data), data, policy_digest(data))
        except PolicyError as error:
            raise UserError(f"{paths[name]}: {error}") from error
        driven = facts.policies.get(name, found[name].digest)
        if driven != found[name].digest:
            raise UserError(
                f"{paths[name]} is not the policy that the trials of {name} were driven with "
                f"({found[name].digest[:8]}, not {driven[:8]}); give their folder, or sweep again with this one"
            )
    if facts.policies and not set(found) & set(facts.policies):
        raise UserError(f"{folder} has none of the policies {', '.join(facts.policies)}; give the folder of the sweep")
    return found


def learned(files: Mapping[str, PolicyFile]) -> dict[str, tuple[str, PlannerParams]]:
    """Context label -> (method it was taken from, theta); the methods of a training share their thetas."""
    thetas: dict[str, tuple[str, PlannerParams]] = {}
    for name in sorted(files, key=lambda name: -len(files[name].policy.labels)):
        for context in files[name].policy.contexts:
            thetas.setdefault(context.label, (name, context.theta))
    return dict(sorted(thetas.items()))


def differing(files: Mapping[str, PolicyFile]) -> list[str]:
    """Methods whose thetas are not those of Table I."""
    thetas = learned(files)
    return [n for n, f in files.items() if any(thetas[c.label][1] != c.theta for c in f.policy.contexts)]


def parameters_sheet(files: Mapping[str, PolicyFile]) -> Sheet:
    """Table I: the learned parameters, each next to the published row of the same name."""
    thetas, published = learned(files), published_parameters()
    columns = (
        Column("context", "context"),
        Column("source", "from"),
        *(Column(name, name, SHORT) for name in PARAMETER_NAMES),
        Column("loss", "loss (Eq. 1)", CHANGE),
        Column("error", "rms error v [m/s], ω [rad/s]", ERRORS),
        Column("interventions", "interventions", COUNT),
    )
    rows: list[tuple[object, ...]] = [("default", "Jackal", *PlannerParams().as_dict().values(), None, None, None)]
    for label in sorted({*thetas, *published}):
        if label in thetas:
            method, theta = thetas[label]
            origin = files[method].policy.provenance
            count = Counter(origin.interventions.values())[label]
            rows.append(
                (
                    label,
                    "twin",
                    *theta.as_dict().values(),
                    origin.losses.get(label),
                    origin.errors.get(label),
                    count or None,
                )
            )
        if label in published:
            rows.append((label, "paper", *published[label].as_dict().values(), None, None, None))
    note = "A loss is that of the default parameters → that of the learned ones, on the interventions of the context."
    if others := differing(files):
        note += f" Not these parameters: {', '.join(others)}."
    return Sheet("parameters", "Table I: parameters, learned and published", columns, tuple(rows), note)


def flatness_sheet(files: Mapping[str, PolicyFile]) -> Sheet | None:
    """How far each learned parameter is determined by the demonstrations; None without any that tells."""
    rows: list[tuple[object, ...]] = []
    for label, (method, _) in learned(files).items():
        if ranges := files[method].policy.provenance.flatness.get(label):
            rows.append((label, *(ranges.get(name) for name in PARAMETER_NAMES)))
    if not rows:
        return None
    columns = (Column("context", "context"), *(Column(name, name, BOUNDS) for name in PARAMETER_NAMES))
    note = "Values that cost at most 5 % of what Eq. 1 gained or, if more, of what is left, while the others stay."
    return Sheet("flatness", "How far the demonstrations determine the parameters", columns, tuple(rows), note)


def classifiers_sheet(files: Mapping[str, PolicyFile]) -> Sheet | None:
    """How every policy decides, and what its classifier was measured at; None without any classifier."""
    chosen = {name: file.policy for name, file in files.items() if file.policy.classifier is not None}
    figures = sorted({key for policy in chosen.values() for key in policy.provenance.figures})
    if not chosen:
        return None
    columns = (
        Column("method", "method"),
        Column("types", "types"),
        Column("contexts", "contexts"),
        Column("eps_u", "threshold ε_u", SHORT),
        Column("window", "window [steps]", COUNT),
        Column("switches", "switches"),
        *(Column(key, key.replace("_", " "), SHORT) for key in figures),
    )
    rows = []
    for name, policy in chosen.items():
        s, p = policy.switches, policy.provenance
        switches = ", ".join(
            [f"inflation {s.inflation}", *(["path gate"] if s.path_gate else [])]
            + (["min_vel_theta coupled"] if s.couple_min_vel_theta else [])
        )
        threshold = policy.eps_u if policy.use_confidence else None
        values = [p.figures.get(key) for key in figures]
        rows.append((name, p.types, ", ".join(policy.labels), threshold, policy.window, switches, *values))
    return Sheet("classifiers", "Classifiers and switches of the policies", columns, tuple(rows))


def curves(files: Mapping[str, PolicyFile]) -> dict[str, dict[str, list[tuple[float, float]]]]:
    """ "fits": context -> (evaluations, best loss of Eq. 1); "classifiers": method -> (steps, validation loss)."""
    found: dict[str, dict[str, list[tuple[float, float]]]] = {"fits": {}, "classifiers": {}}
    known: list[object] = []
    for name in sorted(files, key=lambda name: -len(files[name].policy.labels)):
        for label, points in files[name].policy.provenance.curves.items():
            line = [(float(x), float(y)) for x, y in points]
            if label != "classifier":
                found["fits"].setdefault(label, line)
            elif line not in known:  # with and without confidence are one classifier
                known.append(line)
                found["classifiers"][name.removesuffix("+c")] = line
    return found
