"""Recordings of trials and interventions say what was driven: contexts, confidence, evidence, phases."""

from __future__ import annotations

from pathlib import Path

import pytest

from learning.deploy import AppliDriver
from scenarios.collect import Collected, Session
from scenarios.recorded import judge_of, method_name, open_recorder, record_intervention
from scenarios.trials import TrialSpec, make_driver, run_trial
from scenarios.worlds import load_world
from tests.test_recording import rerun
from twin.recording import read_recording
from twin.recording.plots import evidence_entity
from twin.records import Tick

POLICIES = Path(__file__).resolve().parents[2] / "results" / "policies"


def test_a_policys_recording_holds_its_contexts_confidence_and_evidence(tmp_path: Path) -> None:
    spec = TrialSpec("doorway", driver=str(POLICIES / "A+B+c.safetensors"))
    world, path = load_world(spec.world), tmp_path / "run.rrd"
    driver = make_driver(spec, explain=True)
    assert isinstance(driver, AppliDriver)
    ticks: list[Tick] = []
    with open_recorder(spec, world, driver, path) as recorder:
        run_trial(spec, world, lambda tick: (ticks.append(tick), recorder.add(tick)), driver=driver)
    assert rerun("verify", path) == 0
    recording = read_recording(path)
    assert recording.metadata["method"] == "A+B+c"
    lane, indices = recording.lanes["appli/context"], [tick.index for tick in ticks]
    assert [lane.at(k) for k in indices] == [tick.decision.context for tick in ticks]
    confidence = recording.scalars["appli/confidence"]
    assert confidence.ticks.tolist() == indices
    assert confidence.values.tolist() == [tick.decision.confidence for tick in ticks]
    assert set(recording.scalars["appli/threshold"].values) == {driver.policy.eps_u}
    classifier = driver.policy.classifier
    assert classifier is not None
    evidence = [recording.scalars[evidence_entity(label)].values for label in classifier.labels]
    for k in range(0, len(ticks), 50):
        judgement = classifier.judge(ticks[k].observation.scan.ranges)
        assert judgement is not None
        assert [series[k] + 1.0 for series in evidence] == pytest.approx(judgement.alpha.tolist())
        total = sum(series[k] for series in evidence) + len(evidence)
        assert 1.0 - len(evidence) / total == pytest.approx(confidence.values[k])  # u = 1 - N / sum(alpha)


def test_only_what_asks_for_confidence_has_a_threshold() -> None:
    def threshold(name: str) -> float | None:
        judge = judge_of(make_driver(TrialSpec("open", driver=str(POLICIES / f"{name}.safetensors"))))
        assert judge is not None
        return judge.threshold

    assert threshold("A+B+c") == 0.8
    assert threshold("A+B") is None
    assert judge_of(make_driver(TrialSpec("open"))) is None


def test_a_method_is_named_in_brief() -> None:
    assert method_name("dwa") == "dwa"
    assert method_name("theta:B2") == "theta:B2"
    assert method_name("some/where/A+B+c.safetensors") == "A+B+c"


@pytest.mark.slow
def test_an_intervention_is_failure_rewind_and_demonstration_on_one_time_line(tmp_path: Path) -> None:
    world = load_world("doorway")
    kept: list[Collected] = []
    bare: list[Collected] = []
    Session(TrialSpec("doorway", seed=3), world, explain=True).run(kept.append)
    Session(TrialSpec("doorway", seed=3), world).run(bare.append)
    assert [c.intervention.digest for c in kept] == [c.intervention.digest for c in bare], "recording changes nothing"
    for number, collected in enumerate(kept):
        path = tmp_path / f"{number}.rrd"
        record_intervention(path, world, collected)
        assert rerun("verify", path) == 0
        recording = read_recording(path)
        lane = recording.lanes["phase"]
        assert lane.states == ("default", "rewound", "demonstration")
        clearance = recording.scalars["clearance"]
        assert (clearance.ticks[1:] > clearance.ticks[:-1]).all()
        assert clearance.values.tolist() == [tick.clearance for tick in (*collected.before, *collected.ticks)]
        failed = [k for k in clearance.ticks if lane.at(int(k)) == "default"]
        assert failed == [tick.index for tick in collected.before]
        assert failed[0] < collected.start <= failed[-1], "seen before the place that was wound back to, and after it"
        human = recording.scalars["command/human/v"]
        assert {lane.at(int(k)) for k in human.ticks} == {"demonstration"}
        assert human.values.tolist() == [tick.override.v for tick in collected.ticks if tick.override]
        assert recording.metadata["intervention"] == collected.intervention.label
        minutes = (clearance.times[-1] - clearance.times[0]) / 60.0
        assert path.stat().st_size < 30e6 * minutes + 3e6  # beside the robot's shape
