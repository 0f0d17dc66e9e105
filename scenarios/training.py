"""`appli train`: a folder of interventions becomes a policy: Eq. 1 for every context, and the classifier."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from learning.fit import FitResult, FitSettings, fit
from learning.interventions import Intervention, load_dataset
from learning.labelled_scans import ScanDataset, time_blocks
from learning.policy import Context, Policy, Provenance, save_policy
from scenarios.errors import UserError, blame
from twin.planner.params import PARAMETER_NAMES

# The paper's seven methods; "dwa" needs no policy. Name -> (types, with the confidence measure).
METHODS: dict[str, tuple[str, bool]] = {
    "A": ("A", False),
    "A+c": ("A", True),
    "A+B": ("A,B", False),
    "A+B+c": ("A,B", True),
    "A+B+D": ("A,B,D", False),
    "A+B+D+c": ("A,B,D", True),
}


def train_command(folder: Path, out: Path, types: str, seed: int, confidence: bool, all_methods: bool) -> int:
    """Fit, train, save, and print what was learnt. Exit code 0."""
    wanted = ("A,B,D" if all_methods else types).split(",")
    if not set(wanted) <= {"A", "B", "D"}:
        raise UserError(f"--types takes A, B and D with commas between, such as A,B; not {types!r}")
    with blame():
        interventions = load_dataset(folder, wanted)
    target = out if all_methods else out.parent
    with blame(f"cannot use the folder {target}"):
        target.mkdir(parents=True, exist_ok=True)
    with blame():
        fits = fit_contexts(interventions, seed)
        print_fits(fits)
        if not all_methods:
            save_policy(replace(make_policy(interventions, fits, types, seed), use_confidence=confidence), out)
            print(f"policy: {out}   drive with it: appli run unseen --driver {out}")
            return 0
        made: dict[str, Policy] = {}
        for name, (used, confident) in METHODS.items():
            if used not in made:
                chosen = [i for i in interventions if i.kind in used.split(",")]
                made[used] = make_policy(chosen, {i.label: fits[i.label] for i in chosen}, used, seed)
            save_policy(replace(made[used], use_confidence=confident), out / f"{name}.safetensors")
    print(f"{len(METHODS)} policies in {out}")
    return 0


def fit_contexts(interventions: Sequence[Intervention], seed: int) -> dict[str, FitResult]:
    """Eq. 1 once per context, over all interventions that teach it; Ctrl-C keeps the best so far of the one in work."""
    fits = {}
    for label in sorted({i.label for i in interventions}):
        taught = [i for i in interventions if i.label == label]
        print(f"appli train: fitting {label} ...", end="", file=sys.stderr, flush=True)
        result = fit(taught, FitSettings(seed=seed), _fit_progress)
        ended = "interrupted, best so far kept" if result.interrupted else f"{result.seconds:.1f} s"
        print(f"  loss {result.default_loss:.2f} -> {result.loss:.2f} ({ended})", file=sys.stderr, flush=True)
        fits[label] = result
    return fits


def _fit_progress(*_: object) -> None:
    if sys.stderr.isatty():
        print(".", end="", file=sys.stderr, flush=True)


def make_policy(interventions: Sequence[Intervention], fits: dict[str, FitResult], types: str, seed: int) -> Policy:
    """The contexts with their theta, and a classifier when there is something to tell apart."""
    contexts = tuple(Context(label, fits[label].theta) for label in sorted(fits))
    classifier, figures = None, {}
    if len(contexts) > 1:
        from learning.evidential import TrainingOptions, train

        print(f"appli train: classifier for {', '.join(c.label for c in contexts)} ...", file=sys.stderr, flush=True)
        trained = train(labelled_scans(interventions), TrainingOptions(seed=seed))
        classifier, figures = trained.classifier, trained.report.figures()
        print(
            f"appli train: held out: accuracy {figures['held_out_accuracy']:.2f}, confidence "
            f"{figures['held_out_confidence']:.2f}; {trained.report.seconds:.0f} s",
            file=sys.stderr,
        )
    provenance = Provenance(
        interventions={i.digest: i.label for i in interventions},
        losses={label: (result.default_loss, result.loss) for label, result in fits.items()},
        figures=figures,
        versions={name: version(name) for name in ("appli-twin", "numpy", "torch", "cma")},
        types=types,
        seed=seed,
    )
    return Policy(contexts, classifier, provenance=provenance)


def labelled_scans(interventions: Sequence[Intervention]) -> ScanDataset:
    """The scans of all labelled steps, in blocks of time."""
    scans, labels, times, sources = [], [], [], []
    for source, intervention in enumerate(interventions):
        for step in intervention.steps:
            if step.labelled:
                scans.append(step.observation.scan.ranges)
                labels.append(intervention.label)
                times.append(step.observation.time)
                sources.append(source)
    if len({len(ranges) for ranges in scans}) > 1:
        raise ValueError("the interventions come from lidars of different sizes")
    return ScanDataset(np.array(scans), tuple(labels), time_blocks(np.array(times), np.array(sources)))


def print_fits(fits: dict[str, FitResult]) -> None:
    """Table I: the learned parameters, and how well they are determined."""
    table = Table("parameter", *fits)
    for name in PARAMETER_NAMES:
        row = []
        for result in fits.values():
            value = result.theta.as_dict()[name]
            low, high = result.flatness.get(name, (value, value))
            row.append(f"{value:g}" if isinstance(value, int) else f"{value:.2f}  [{low:.2f}, {high:.2f}]")
        table.add_row(name, *row)
    table.add_row("loss of default", *(f"{r.default_loss:.2f}" for r in fits.values()))
    table.add_row("loss", *(f"{r.loss:.2f}" for r in fits.values()))
    Console().print(table)
    print("In brackets: the values that cost almost nothing while the others stay.")
