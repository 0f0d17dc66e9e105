"""`appli demo` from one end to the other, small."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import scenarios.demo as demo
import scenarios.training as training
from learning.fit import FitSettings
from learning.policy_file import load_policy
from scenarios.cli import main
from twin.recording import read_recording


@pytest.mark.slow
def test_demo_collects_learns_drives_and_uses_what_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    quick = FitSettings(max_evaluations=24, restarts=0, max_steps=8)
    monkeypatch.setattr(training, "FitSettings", lambda **changes: replace(quick, **changes))
    monkeypatch.setattr(demo, "WORLDS", ("open",))
    monkeypatch.setattr("learning.evidential.TrainingOptions", _few_steps)
    arguments = ["demo", "--out", str(tmp_path), "--sessions", "1"]
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 0
    policy = load_policy(tmp_path / "A+B+c.safetensors")
    assert policy.labels == ("A1", "A2", "B1", "B2")
    for method in ("dwa", "A+B+c"):
        recording = read_recording(tmp_path / f"open-{method}.rrd")
        assert len(recording.scalars["command/planner/v"].values) > 50
    before = (tmp_path / "A+B+c.safetensors").stat().st_mtime_ns
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 0
    assert (tmp_path / "A+B+c.safetensors").stat().st_mtime_ns == before, "not learned twice"
    assert len(list((tmp_path / "interventions").glob("*.npz"))) == 6, "nor collected twice"
    assert "A+B+c" in capsys.readouterr().out


def _few_steps() -> object:
    from learning.evidential import PLAIN

    return replace(PLAIN, steps=40, least_steps=0, refit=False)
