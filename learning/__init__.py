"""APPLI: parameters and contexts learned from interventions, and the driver that uses them.

    from pathlib import Path
    from learning import Context, Policy, load_dataset, save_policy
    from learning.fit import fit

    taught = [i for i in load_dataset(Path("out/interventions")) if i.label == "A1"]
    theta = fit(taught).theta  # Eq. 1
    save_policy(Policy((Context("A1", theta),)), Path("out/policy.safetensors"))

The public API is what stands in `__all__`, and `learning.fit.fit`, which has its module's name. Torch, pycma and numba
are loaded with the first name that needs them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from learning.classifier import EvidentialClassifier, Judgement
    from learning.deploy import AppliDriver
    from learning.evidential import ScanDataset, Trained, TrainingOptions, TrainingReport, train
    from learning.fit import FitResult, FitSettings
    from learning.intervener import Demonstration, Intervener, Plea
    from learning.interventions import (
        Intervention,
        InterventionError,
        Metadata,
        Step,
        load_dataset,
        load_intervention,
        save_intervention,
    )
    from learning.policy import Context, Policy, PolicyError, PolicySwitches, Provenance
    from learning.policy_file import load_policy, parse_policy, policy_bytes, save_policy
    from learning.published import published_parameters

__all__ = [
    "AppliDriver",
    "Context",
    "Demonstration",
    "EvidentialClassifier",
    "FitResult",
    "FitSettings",
    "Intervener",
    "Intervention",
    "InterventionError",
    "Judgement",
    "Metadata",
    "Plea",
    "Policy",
    "PolicyError",
    "PolicySwitches",
    "Provenance",
    "ScanDataset",
    "Step",
    "Trained",
    "TrainingOptions",
    "TrainingReport",
    "load_dataset",
    "load_intervention",
    "load_policy",
    "parse_policy",
    "policy_bytes",
    "published_parameters",
    "save_intervention",
    "save_policy",
    "train",
]

_HOMES = {
    "Intervention": "interventions",
    "InterventionError": "interventions",
    "Metadata": "interventions",
    "Step": "interventions",
    "load_dataset": "interventions",
    "load_intervention": "interventions",
    "save_intervention": "interventions",
    "Demonstration": "intervener",
    "Intervener": "intervener",
    "Plea": "intervener",
    "FitResult": "fit",
    "FitSettings": "fit",
    "ScanDataset": "evidential",
    "Trained": "evidential",
    "TrainingOptions": "evidential",
    "TrainingReport": "evidential",
    "train": "evidential",
    "EvidentialClassifier": "classifier",
    "Judgement": "classifier",
    "Context": "policy",
    "Policy": "policy",
    "PolicyError": "policy",
    "PolicySwitches": "policy",
    "Provenance": "policy",
    "load_policy": "policy_file",
    "parse_policy": "policy_file",
    "policy_bytes": "policy_file",
    "save_policy": "policy_file",
    "AppliDriver": "deploy",
    "published_parameters": "published",
}


def __getattr__(name: str) -> Any:
    """A name of the public API, loaded when it is first asked for (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
