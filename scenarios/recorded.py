"""Recordings of trials and of interventions: what they say of themselves, and what they ask of who drives."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from learning.deploy import AppliDriver
from scenarios.trials import TrialSpec
from twin.recording import Judge, Recorder
from twin.records import Scan
from twin.rollout import Driver
from twin.world import World

if TYPE_CHECKING:
    from scenarios.collect import Collected


def open_recorder(
    spec: TrialSpec, world: World, driver: Driver, path: Path | None, viewer: str | None = None
) -> Recorder:
    """A recorder for a trial that `driver` drives; `viewer`: URL of a viewer that watches. Raises RecordingError."""
    return Recorder(path, world, metadata(spec, world), judge=judge_of(driver), viewer=viewer)


def metadata(spec: TrialSpec, world: World) -> dict[str, str | int]:
    """What a recording says of itself."""
    method = method_name(spec.driver)
    facts: dict[str, str | int] = {"world": world.name, "method": method, "seed": spec.seed}
    return facts if spec.driver == method else facts | {"driver": spec.driver}


def method_name(driver: str) -> str:
    """A policy goes by the name of its file."""
    return Path(driver).name.removesuffix(".safetensors")


def judge_of(driver: Driver) -> Judge | None:
    """The classifier of a driver, for the evidence and the threshold in its recording; None without one."""
    if not isinstance(driver, AppliDriver) or driver.policy.classifier is None:
        return None
    policy, classifier = driver.policy, driver.policy.classifier

    def evidence(scan: Scan) -> dict[str, float]:
        judgement = classifier.judge(scan.ranges)
        if judgement is None:
            return {}
        return dict(zip(classifier.labels, (judgement.alpha - 1.0).tolist(), strict=True))

    return Judge(classifier.labels, policy.eps_u if policy.use_confidence else None, evidence)


def record_intervention(path: Path, world: World, collected: Collected) -> None:
    """The default's drive, the rewind and the demonstration, on one time line. Raises RecordingError."""
    made = collected.intervention
    said = {"world": world.name, "intervention": made.label, "method": "dwa", "seed": made.metadata.seed}
    headline = f"intervention {made.label}: {made.metadata.trigger}"
    with Recorder(path, world, said, headline=headline) as recorder:
        recorder.begin("default", "the default drives")
        for tick in collected.before:
            recorder.add(tick)
        undone = [tick for tick in collected.before if tick.index >= collected.start]
        if undone:
            recorder.rewind(undone, f"{made.metadata.trigger}: wound back {made.metadata.rewound:.1f} s")
        recorder.begin("demonstration", f"a person shows {made.label}")
        for tick in collected.ticks:
            recorder.add(tick)
