"""`appli train`: one fit per context whatever the workers, mistakes told at once, Ctrl-C, the paper's six policies."""

from __future__ import annotations

import errno
import functools
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from learning.fit import FitResult, FitSettings, fit
from learning.interventions import Intervention, Kind, Step, save_intervention
from learning.policy import EPS_U, WINDOW, Policy, PolicySwitches
from learning.policy_file import load_policy
from scenarios import training
from scenarios.cli import main
from scenarios.fitting import fit_contexts
from scenarios.report import paper
from scenarios.tables import plain_table, print_table
from scenarios.training import METHODS, labelled_scans
from tests.learning.observations import METADATA, slalom_drive
from tests.learning.test_policy import POLICY, changed
from twin.planner.params import PlannerParams
from twin.planner.plan import PlannerSettings
from twin.records import Command

QUICK = FitSettings(max_evaluations=24, restarts=0, max_steps=4)
ROOT = Path(__file__).resolve().parents[2]


def made_up(label: str, count: int = 6, labelled: bool = True, spacing: float = 0.6) -> Intervention:
    """An intervention from a drive with the default parameters and actions of no planner; blocks of one second."""
    kind: Kind = label[0]  # type: ignore[assignment]
    rng = np.random.default_rng([ord(label[0]), int(label[1:])])
    ticks = slalom_drive(PlannerParams(), 160)
    steps = [
        Step(
            replace(ticks[k].observation, time=spacing * n),
            Command(*rng.uniform((0.1, -0.5), (0.6, 0.5)).tolist()),
            labelled,
        )
        for n, k in enumerate(np.linspace(0, 159, count).astype(int).tolist())
    ]
    return Intervention(kind, label, steps, METADATA)


def folder_of(path: Path, *interventions: Intervention) -> Path:
    for intervention in interventions:
        save_intervention(intervention, path)
    return path


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Searches and trainings of a second."""
    from learning import evidential

    monkeypatch.setattr(training, "FitSettings", functools.partial(FitSettings, max_evaluations=12, restarts=0))
    options = functools.partial(evidential.TrainingOptions, steps=100, least_steps=0, ood_scans=20, refit=False)
    monkeypatch.setattr(evidential, "TrainingOptions", options)
    monkeypatch.setattr(evidential, "PLAIN", replace(evidential.PLAIN, steps=100, least_steps=0, refit=False))


@pytest.fixture
def no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mistake has to be told before the minutes of a search."""

    def refuse(*_: object) -> None:
        raise AssertionError("searched in spite of the mistake")

    monkeypatch.setattr(training, "fit_contexts", refuse)


def train(*arguments: object) -> int:
    """The exit code of `appli train`."""
    with pytest.raises(SystemExit) as stop:
        main(["train", *map(str, arguments)])
    return int(stop.value.code or 0)


# ---- one fit per context --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_any_number_of_workers_finds_what_a_fit_alone_finds(capfd: pytest.CaptureFixture[str]) -> None:
    interventions = [made_up("A1"), made_up("B1"), made_up("A1", 3)]
    alone = {"A1": fit([interventions[0], interventions[2]], QUICK), "B1": fit(interventions[1], QUICK)}
    assert alone["A1"].theta != alone["B1"].theta
    for workers in (1, 2):
        together = fit_contexts(interventions, QUICK, workers)
        assert list(together) == ["A1", "B1"]
        assert {k: (f.theta, f.loss, f.flatness, f.evaluations) for k, f in together.items()} == {
            k: (f.theta, f.loss, f.flatness, f.evaluations) for k, f in alone.items()
        }
        said = capfd.readouterr().err
        assert [f"{label}: loss" in said for label in alone] == [True, True]
        assert "searching parameters for A1, B1" in said
        assert "interrupted" not in said


# ---- Ctrl-C ---------------------------------------------------------------------------------------------------------

ENDLESS = """
import functools, signal, sys, time
from learning import evidential
from scenarios import training
from learning.fit import FitSettings

if __name__ == "__main__":
    training.FitSettings = functools.partial(
        FitSettings, max_evaluations=10**9, patience=10**9, min_progress=0.0, restarts=10**6
    )
    evidential.TrainingOptions = functools.partial(
        evidential.TrainingOptions, steps=100, least_steps=0, ood_scans=20, refit=False
    )
    if sys.argv.pop(1) == "stuck":  # what the second Ctrl-C ends: nothing heeds the first one
        from scenarios import fitting
        fitting._watch = lambda *_: time.sleep(600)
    from scenarios.cli import main
    main()
"""


def searching(tmp_path: Path, how: str) -> subprocess.Popen[str]:
    """`appli train` with searches without end, in a process group of its own."""
    script = tmp_path / "endless.py"
    script.write_text(ENDLESS)
    data = folder_of(tmp_path / "iv", made_up("A1"), made_up("B1"), made_up("B2"))
    return subprocess.Popen(
        [sys.executable, str(script), how, "train", str(data), "--out", str(tmp_path / "out" / "p.safetensors")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        start_new_session=True,  # a terminal's Ctrl-C goes to all processes of a group
    )


def wait_for_workers(child: subprocess.Popen[str], number: int) -> None:
    """Until so many workers have been born; they need seconds more to import what they need."""
    children = Path(f"/proc/{child.pid}/task/{child.pid}/children")
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        commands = [Path(f"/proc/{pid}/cmdline") for pid in children.read_text().split()]
        if sum(b"spawn_main" in command.read_bytes() for command in commands if command.exists()) >= number:
            return
        time.sleep(0.05)
    raise AssertionError("no workers")


needs_proc = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks for workers in /proc")


@pytest.mark.slow
@needs_proc
@pytest.mark.parametrize("delay", [0.0, 6.0], ids=["while workers start", "while they search"])
def test_ctrl_c_ends_the_searches_and_keeps_the_best(tmp_path: Path, delay: float) -> None:
    child = searching(tmp_path, "plain")
    wait_for_workers(child, min(3, os.cpu_count() or 1))
    time.sleep(delay)
    os.killpg(child.pid, signal.SIGINT)
    out, err = child.communicate(timeout=120)
    assert child.returncode == 0, err
    assert "Traceback" not in err
    lines = [line for line in err.splitlines() if "interrupted" in line]
    assert [line.split(":")[1].strip() for line in sorted(lines)] == ["A1", "B1", "B2"]
    assert all(line.endswith(("the best so far is kept)", "the default is kept)")) for line in lines)
    policy = load_policy(tmp_path / "out" / "p.safetensors")
    assert policy.labels == ("A1", "B1", "B2")
    for before, after in policy.provenance.losses.values():
        assert after <= before
    assert "policy:" in out


@pytest.mark.slow
@needs_proc
def test_a_second_ctrl_c_ends_everything_and_writes_nothing(tmp_path: Path) -> None:
    child = searching(tmp_path, "stuck")
    wait_for_workers(child, 2)
    os.killpg(child.pid, signal.SIGINT)
    time.sleep(1.0)
    assert child.poll() is None
    os.killpg(child.pid, signal.SIGINT)
    out, err = child.communicate(timeout=60)
    assert child.returncode == 130, err
    assert out == ""
    assert err.splitlines()[-1] == "appli: interrupted"
    assert "Traceback" not in err
    assert list((tmp_path / "out").iterdir()) == []


# ---- mistakes -------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("no_search")
@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--types", "D"], "no interventions of type D; it has A, B"),
        (["--types", ""], "--types takes A, B and D"),
        (["--types", "A,C"], "--types takes A, B and D"),
        (["--types", "a"], "--types takes A, B and D"),
        (["--seed", "-1"], "--seed must be 0 or more"),
        (["--eps-u", "-0.1"], "eps_u must be 0 or more"),
        (["--window", "0"], "window must be 1 to"),
        (["--all-methods"], "no interventions of type D, which --all-methods needs"),
        (["--all-methods", "--types", "A"], "leave out --types"),
        (["--all-methods", "--no-confidence"], "leave out --types and --no-confidence"),
        (["--out", "p.policy"], "--out must end in .safetensors"),
        (["--out", "/proc/p.safetensors"], "cannot use the folder /proc: "),
        (["--out", "/proc/none/p.safetensors"], "cannot use the folder /proc/none: "),
        (["--out", "iv/A1-training-seed0-001.npz/p.safetensors"], "cannot use the folder iv/A1"),
        (["--out", "taken.safetensors"], "taken.safetensors is a folder"),
    ],
)
def test_wrong_options_get_one_line_before_anything_is_searched(
    options: list[str],
    word: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    folder_of(tmp_path / "iv", made_up("A1"), made_up("B1"))
    (tmp_path / "taken.safetensors").mkdir()
    before = sorted(tmp_path.rglob("*"))
    assert train("iv", *([] if "--out" in options else ["--out", "new/p.safetensors"]), *options) == 2
    err = capsys.readouterr().err
    assert err.startswith("appli: ")
    assert word in err
    assert ".part" not in err
    assert len(err.splitlines()) == 1
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.usefixtures("no_search")
@pytest.mark.parametrize(
    ("case", "word"),
    [
        ("missing", "no such folder"),
        ("empty", "no interventions (*.npz)"),
        ("truncated", "damaged, or not an intervention file"),
        ("unlabelled", "context B1 has no labelled steps"),
        ("short", "context 'B1' has one time block"),
    ],
)
def test_data_that_teach_nothing_get_one_line_before_anything_is_searched(
    case: str, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tmp_path / "iv"
    if case == "empty":
        data.mkdir()
    elif case != "missing":
        folder_of(data, made_up("A1"))
        bad = made_up("B1", labelled=case != "unlabelled", spacing=0.05 if case == "short" else 0.6)
        path = save_intervention(bad, data)
        if case == "truncated":
            path.write_bytes(path.read_bytes()[:-200])
    assert train(data, "--out", tmp_path / "new" / "p.safetensors") == 2
    err = capsys.readouterr().err
    assert str(data) in err
    assert word in err
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_one_context_makes_a_policy_that_always_uses_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, out = folder_of(tmp_path / "iv", made_up("A1")), tmp_path / "p.safetensors"
    assert train(data, "--out", out) == 0
    said = capsys.readouterr()
    assert "no interventions of type B; goes on without" in said.err
    assert "classifier" not in said.err
    assert "v error [m/s]" in said.out
    assert "w error [rad/s]" in said.out
    policy = load_policy(out)
    assert (policy.labels, policy.classifier) == (("A1",), None)
    with pytest.raises(SystemExit) as stop:
        main(["run", "open", "--driver", str(out), "--json"])
    assert stop.value.code in (0, 1)
    assert '"contexts": {"A1": 1.0}' in capsys.readouterr().out


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "not a policy, or a truncated one"),
        (changed(lambda _: None)[:-100], "not a policy, or a truncated one"),
        (changed(lambda _: None)[:100], "not a policy, or a truncated one"),
        (changed(lambda values: values.update(robot="husky")), "a policy for the robot 'husky'"),
        (changed(lambda values: values.update(beams=1080)), "a policy for scans of 1080 beams"),
    ],
)
@pytest.mark.parametrize("command", [["run", "open", "--driver"], ["export", "--out", "yaml"]])
def test_a_policy_that_cannot_be_used_gets_one_line(
    command: list[str],
    content: bytes,
    word: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("p.safetensors").write_bytes(content)
    with pytest.raises(SystemExit) as stop:
        main([*command, "p.safetensors"])
    assert stop.value.code == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("appli: ")
    assert word in said.err
    assert len(said.err.splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["p.safetensors"]


# ---- what comes out -------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_all_methods_are_the_papers_six(tmp_path: Path) -> None:
    labels = ("A1", "A2", "B1", "D1")
    data = folder_of(tmp_path / "iv", *(made_up(label) for label in labels))
    assert train(data, "--out", tmp_path / "out", "--all-methods") == 0
    policies = {path.stem: load_policy(path) for path in (tmp_path / "out").iterdir()}
    assert ("dwa", *METHODS) == paper.METHODS
    assert sorted(policies) == sorted(METHODS) == ["A", "A+B", "A+B+D", "A+B+D+c", "A+B+c", "A+c"]
    for name, policy in policies.items():
        types, confidence = METHODS[name]
        assert types == name.replace("+c", "").replace("+", ",")
        assert policy.use_confidence == confidence == name.endswith("+c")
        assert policy.labels == tuple(label for label in labels if label[0] in types)
        assert policy.classifier is not None
        assert policy.classifier.labels == policy.labels
        assert policy.provenance.types == types
        assert sorted(policy.provenance.interventions.values()) == list(policy.labels)
        for label in policy.labels:
            assert policy.theta(label) == policies["A+B+D"].theta(label), "every context is fitted once"


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_a_policy_is_made_and_driven_under_its_options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    planners = []

    def fitted(interventions: list[Intervention], settings: FitSettings) -> dict[str, FitResult]:
        planners.append(settings.planner)
        return {i.label: fit(i, QUICK) for i in interventions}

    monkeypatch.setattr(training, "fit_contexts", fitted)
    monkeypatch.setattr(training, "print_fits", lambda _: None)
    data, out = folder_of(tmp_path / "iv", made_up("A1"), made_up("B1")), tmp_path / "p.safetensors"
    switches = ["--path-gate", "--inflation", "local", "--couple-min-vel-theta", "--no-confidence"]
    assert train(data, "--out", out, "--eps-u", "0.7", "--window", "5", "--plain", *switches) == 0
    policy = load_policy(out)
    assert (policy.eps_u, policy.window, policy.use_confidence) == (0.7, 5, False)
    assert policy.switches == PolicySwitches(path_gate=True, inflation="local", couple_min_vel_theta=True)
    assert (planners[0].inflation, planners[0].couple_min_vel_theta) == ("local", True)
    assert policy.classifier is not None
    assert policy.classifier.hidden is None
    assert train(data, "--out", out) == 0
    policy = load_policy(out)
    assert (policy.eps_u, policy.window, policy.use_confidence) == (EPS_U, WINDOW, True)
    assert policy.switches == PolicySwitches()
    assert planners[1] == PlannerSettings()
    assert policy.classifier is not None
    assert policy.classifier.hidden is not None


@pytest.mark.usefixtures("quick")
def test_an_interrupted_all_methods_writes_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_: object, __: object, used: str, *___: object) -> Policy:
        if used == "A,B":
            raise KeyboardInterrupt
        return POLICY

    monkeypatch.setattr(training, "fit_contexts", lambda *_: {})
    monkeypatch.setattr(training, "print_fits", lambda _: None)
    monkeypatch.setattr(training, "make_policy", interrupted)
    data = folder_of(tmp_path / "iv", *map(made_up, ("A1", "B1", "D1")))
    assert train(data, "--out", tmp_path / "out", "--all-methods") == 130
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.usefixtures("quick")
def test_a_disk_that_fills_up_meanwhile_gets_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    alone = {"A1": fit(made_up("A1"), QUICK)}
    monkeypatch.setattr(training, "fit_contexts", lambda *_: alone)
    data, out = folder_of(tmp_path / "iv", made_up("A1")), tmp_path / "out"
    monkeypatch.setattr(os, "fsync", full)
    assert train(data, "--out", out / "p.safetensors", "--types", "A") == 2
    assert capsys.readouterr().err == f"appli: cannot write {out / 'p.safetensors'}: No space left on device\n"
    assert list(out.iterdir()) == []


def test_lidars_of_different_sizes_do_not_mix() -> None:
    one, other = made_up("A1"), made_up("B1")
    few = [replace(s.observation, scan=replace(s.observation.scan, ranges=np.ones(16))) for s in other.steps]
    small = Intervention("B", "B1", [Step(x, Command(0.1, 0.0)) for x in few], METADATA)
    with pytest.raises(ValueError, match="lidars of different sizes"):
        labelled_scans([one, small])


def test_narrow_terminals_show_every_digit_and_unit(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    table = plain_table("a rather long name [m/s]", "time [s]", "closest [m]")
    table.add_row("twenty-four-letters-long", "123.45", "some words, the longest 0.123456789")
    print_table(table)
    out = capsys.readouterr().out
    assert len(out.splitlines()[0]) < 60
    for text in ("[m/s]", "[s]", "[m]", "twenty-four-letters-long", "123.45", "0.123456789"):
        assert text in out
