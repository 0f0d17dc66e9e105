"""`appli train`: a folder of interventions becomes a policy: Eq. 1 for every context, and the classifier."""

from __future__ import annotations

import functools
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Column

from learning.fit import FitResult, FitSettings
from learning.interventions import Intervention, load_dataset
from learning.labelled_scans import background_scans, labelled_scans, split
from learning.policy import Context, Policy, PolicySwitches, Provenance
from learning.policy_file import save_policy
from scenarios.errors import UserError, blame
from scenarios.fitting import fit_contexts
from scenarios.folders import make_folder
from scenarios.policy_options import PolicyOptions
from scenarios.run import compile_kernels
from scenarios.tables import plain_table, print_table
from twin.planner.move_base import MoveBaseSettings
from twin.planner.params import INTEGERS, PARAMETER_NAMES, ParameterSpace

LOOSE = 0.25  # a parameter whose value may change by this share of its range at almost no cost is not determined
RANGE = dict(zip(PARAMETER_NAMES, zip(ParameterSpace().lower, ParameterSpace().upper, strict=True), strict=True))

# The paper's seven methods; "dwa" needs no policy. Name -> (types, with the confidence measure).
METHODS: dict[str, tuple[str, bool]] = {
    "A": ("A", False),
    "A+c": ("A", True),
    "A+B": ("A,B", False),
    "A+B+c": ("A,B", True),
    "A+B+D": ("A,B,D", False),
    "A+B+D+c": ("A,B,D", True),
}


def train_command(folder: Path, out: Path, types: str, seed: int, all_methods: bool, options: PolicyOptions) -> int:
    """Fit, train, save, and print what was learnt. Exit code 0."""
    wanted = ("A,B,D" if all_methods else types).split(",")
    if not set(wanted) <= {"A", "B", "D"}:
        raise UserError(f"--types takes A, B and D with commas between, such as A,B; not {types!r}")
    if not all_methods and out.suffix != ".safetensors":
        raise UserError(f"--out must end in .safetensors, so that it can be driven with, not {out.name!r}")
    if all_methods and (types != "A,B" or not options.confidence):
        raise UserError(
            "--all-methods makes all types, with and without the confidence; leave out --types and --no-confidence"
        )
    if seed < 0:
        raise UserError(f"--seed must be 0 or more, not {seed}")
    with blame():
        planner = bare_policy(options).settings(MoveBaseSettings()).planner
        everything = load_dataset(folder)
        interventions = load_dataset(folder, wanted)
    with blame(str(folder)):
        check_teachable(interventions)
    if absent := sorted(set(wanted) - {i.kind for i in interventions}):
        lacking = f"{folder} has no interventions of type {', '.join(absent)}"
        if all_methods:
            raise UserError(
                f"{lacking}, which --all-methods needs; make some with: appli collect training --out {folder}"
            )
        print(f"appli train: {lacking}; goes on without", file=sys.stderr)
    if not all_methods and out.is_dir():
        raise UserError(f"{out} is a folder; give --out the name of a file")
    make_folder(out if all_methods else out.parent)
    compile_kernels()
    with blame():
        fits = fit_contexts(interventions, FitSettings(seed=seed, planner=planner))
        print_fits(fits)
        if not all_methods:
            _save(make_policy(everything, fits, types, seed, options), out)
            print(f"policy: {out}   drive with it: appli run unseen --driver {out}")
            return 0
        policies: dict[str, Policy] = {}
        for used, names in _methods_by_types().items():
            policy = make_policy(everything, fits, used, seed, options)
            policies |= {name: replace(policy, use_confidence=METHODS[name][1]) for name in names}
        for name, policy in policies.items():  # at the end, so that old and new ones do not mix if it is interrupted
            _save(policy, out / f"{name}.safetensors")
    print(f"{len(METHODS)} policies in {out}")
    return 0


def bare_policy(options: PolicyOptions) -> Policy:
    """A policy that has learnt nothing yet. Raises PolicyError."""
    switches = PolicySwitches(options.path_gate, options.inflation, options.couple_min_vel_theta)
    return Policy((), eps_u=options.eps_u, window=options.window, use_confidence=options.confidence, switches=switches)


def _save(policy: Policy, path: Path) -> None:
    with blame(f"cannot write {path}"):
        save_policy(policy, path)


def _methods_by_types() -> dict[str, list[str]]:
    """Methods that differ in the confidence only share their classifier."""
    return {used: [name for name, (types, _) in METHODS.items() if types == used] for used, _ in METHODS.values()}


def check_teachable(interventions: Sequence[Intervention]) -> None:
    """Find now, not after minutes of searching, what nothing can be learnt from. Raises ValueError."""
    labels = {i.label for i in interventions}
    shown = {i.label for i in interventions if i.packed.labelled.any()}
    if bare := sorted(labels - shown):
        raise ValueError(f"context {bare[0]} has no labelled steps to learn from")
    if len(labels) < 2:
        return  # no classifier
    dataset = labelled_scans(interventions).usable()
    if blind := sorted(labels - set(dataset.contexts)):
        raise ValueError(f"context {blind[0]} has no scan with a return")
    split(dataset, 0.5, np.random.default_rng(0))


def make_policy(
    everything: Sequence[Intervention], fits: dict[str, FitResult], types: str, seed: int, options: PolicyOptions
) -> Policy:
    """The contexts of these types with their theta, and a classifier when there is something to tell apart.

    Interventions of the other types show places of no context, in which the classifier learns to be unsure.
    """
    interventions = [i for i in everything if i.kind in types.split(",")]
    others = [i for i in everything if i.kind not in types.split(",")]
    labels = sorted({i.label for i in interventions})
    fits = {label: fits[label] for label in labels}
    curves = {label: [(float(n), float(loss)) for n, _, loss in best_so_far(fit)] for label, fit in fits.items()}
    classifier, figures = None, {}
    if len(labels) > 1:
        from learning.evidential import PLAIN, TrainingOptions, train

        training = replace(PLAIN if options.plain else TrainingOptions(), seed=seed, threshold=options.eps_u)
        say = functools.partial(print, file=sys.stderr, flush=True)
        background = background_scans(interventions, others if training.ood_weight > 0.0 else [])
        say(f"appli train: classifier for {', '.join(labels)}, {len(background)} scans of other places ...")
        trained = train(labelled_scans(interventions), training, background=background)
        classifier = trained.classifier
        figures = trained.report.figures() | {"background_scans": float(len(background))}
        curves["classifier"] = [
            (float(r.steps), r.validation) for r in trained.report.rounds if math.isfinite(r.validation)
        ]
        accuracy, certain = figures["held_out_accuracy"], figures["held_out_confidence"]
        say(
            f"appli train: held out: accuracy {accuracy:.2f}, confidence {certain:.2f}, "
            f"evidence x {trained.report.evidence_factor:.2f}; {trained.report.seconds:.0f} s"
        )
        if certain < options.eps_u:
            low = f"below {options.eps_u:g} the default parameters are taken"
            say(f"appli train: {low}: more sessions make it surer of itself")
    provenance = Provenance(
        interventions={i.digest: i.label for i in interventions},
        losses={label: (result.default_loss, result.loss) for label, result in fits.items()},
        errors={label: result.rms_error for label, result in fits.items()},
        flatness={label: dict(result.flatness) for label, result in fits.items()},
        curves=curves,
        figures=figures,
        versions={name: version(name) for name in ("appli-twin", "numpy", "torch", "cma")},
        types=types,
        seed=seed,
    )
    contexts = tuple(Context(label, fits[label].theta) for label in labels)
    return replace(bare_policy(options), contexts=contexts, classifier=classifier, provenance=provenance)


def best_so_far(result: FitResult) -> list[tuple[float, float, float]]:
    """The rows of a convergence curve that improved on all searches before them."""
    rows, lowest = [], math.inf
    for evaluations, search, loss in result.curve.tolist():
        if loss < lowest:
            lowest = loss
            rows.append((evaluations, search, loss))
    return rows


def print_fits(fits: dict[str, FitResult]) -> None:
    """Table I: the learned parameters, how well they imitate, and how well they are determined."""
    table = plain_table(Column("", no_wrap=True), *(Column(label, justify="right", no_wrap=True) for label in fits))
    for name in PARAMETER_NAMES:
        table.add_row(name, *(_number(name, result.theta.as_dict()[name]) for result in fits.values()))
    table.add_section()
    table.add_row("Eq. 1, default", *(f"{r.default_loss:.1f}" for r in fits.values()))
    table.add_row("Eq. 1, learned", *(f"{r.loss:.1f}" for r in fits.values()))
    for k, name in enumerate((r"v error \[m/s]", r"w error \[rad/s]")):
        table.add_row(f"{name}, default", *(f"{r.default_rms_error[k]:.2f}" for r in fits.values()))
        table.add_row(f"{name}, learned", *(f"{r.rms_error[k]:.2f}" for r in fits.values()))
    table.add_row("steps", *(str(len(r.demonstrated)) for r in fits.values()))
    print_table(table)
    console = Console()
    for label, result in fits.items():
        loose = [
            f"{name} {_number(name, low)} to {_number(name, high)}"
            for name, (low, high) in result.flatness.items()
            if (high - low) >= LOOSE * (RANGE[name][1] - RANGE[name][0])
        ]
        if loose:
            console.print(f"{label} does not determine: {', '.join(loose)}", highlight=False, soft_wrap=True)


def _number(name: str, value: float) -> str:
    return f"{value:.0f}" if name in INTEGERS else f"{value:.2f}"
