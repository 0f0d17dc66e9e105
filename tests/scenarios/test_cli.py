"""The command line as a user meets it: exit codes, one line for a mistake, JSON and nothing else, equal runs."""

from __future__ import annotations

import io
import json
import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from learning.policy import Context, Policy
from learning.policy_file import save_policy
from scenarios.cli import main
from scenarios.run import summary
from scenarios.trials import TrialSpec, run_trial
from scenarios.worlds import load_world
from tests.learning.classifiers import FAR, NEAR, range_classifier
from twin.planner.params import PlannerParams
from twin.records import Outcome


def appli(*arguments: str, cwd: Path | None = None, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "scenarios", *arguments],
        capture_output=True,
        text=True,
        timeout=240,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2]), **environment},
        check=False,
    )


def complaint(*arguments: str) -> str:
    """The one line on stderr of a refused command; in this process, because starting one takes longer than refusing."""
    stdout, stderr, on_sigterm = io.StringIO(), io.StringIO(), signal.getsignal(signal.SIGTERM)
    with redirect_stdout(stdout), redirect_stderr(stderr), pytest.raises(SystemExit) as stop:
        main(list(arguments))
    signal.signal(signal.SIGTERM, on_sigterm)
    assert stop.value.code == 2
    assert stdout.getvalue() == ""
    lines = stderr.getvalue().strip().splitlines()
    assert len(lines) == 1, stderr.getvalue()
    assert lines[0].startswith("appli: ")
    assert "Traceback" not in lines[0]
    return lines[0]


def test_help_is_quick_and_names_every_command() -> None:
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = appli("--help")
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before < 1.0
    assert done.returncode == 0
    assert all(name in done.stdout for name in ("run", "worlds", "collect", "teleop", "sweep", "bench", "demo"))


@pytest.mark.parametrize("command", ["run", "worlds", "collect", "teleop", "sweep", "bench", "demo"])
def test_every_command_has_help_with_defaults(command: str) -> None:
    done = appli(command, "--help")
    assert done.returncode == 0
    assert "default" in done.stdout


def test_no_heavy_import_for_help_or_a_plain_run() -> None:
    code = (
        "import sys; from scenarios.cli import main\n"
        "try: main(['run', 'open', '--json'])\n"
        "except SystemExit: pass\n"
        "print(sorted({'torch', 'rerun', 'dask', 'distributed', 'matplotlib', 'rosbags'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().splitlines()[-1] == "[]"


def test_a_run_that_arrives() -> None:
    done = appli("run", "open", "--json")
    assert done.returncode == 0
    report = json.loads(done.stdout)
    assert report["outcome"] == "reached"
    assert set(report) >= {
        "world", "protocol", "driver", "seed", "outcome", "time", "distance", "recoveries", "min_clearance",
        "contexts", "wall_time", "real_time_factor", "recording",
    }  # fmt: skip
    assert report["contexts"] == {"default": 1.0}


def test_an_unreachable_goal_runs_and_reports(tmp_path: Path) -> None:
    course = tmp_path / "closed.toml"
    course.write_text(
        'name = "closed"\nstart = [0.0, 0.0, 0.0]\ngoal = [3.0, 0.0]\ntime_limit = 8.0\n'
        "[[walls]]\npoints = [[-1.0, -1.0], [1.5, -1.0], [1.5, 1.0], [-1.0, 1.0]]\nclosed = true\n"
    )
    done = appli("run", str(course), "--json")
    assert done.returncode == 1, done.stderr
    assert json.loads(done.stdout)["outcome"] in {"timed_out", "aborted"}


def test_scans_that_cannot_be_judged_are_counted(tmp_path: Path) -> None:
    contexts = (Context(NEAR, PlannerParams()), Context(FAR, PlannerParams()))
    save_policy(Policy(contexts, range_classifier()), tmp_path / "p.safetensors")
    blind = json.loads(appli("run", "open", "--driver", str(tmp_path / "p.safetensors"), "--json").stdout)
    assert blind["faults"] == blind["ticks"]
    assert blind["contexts"] == {"default": 1.0}
    seeing = json.loads(appli("run", "doorway", "--driver", str(tmp_path / "p.safetensors"), "--json").stdout)
    assert seeing["faults"] == 0


def test_giving_up_is_explained() -> None:
    result, world = run_trial(TrialSpec("open")), load_world("open")
    assert "gave up" not in summary(world, result, 1.0)
    assert "gave up" in summary(world, replace(result, outcome=Outcome.ABORTED), 1.0)


def test_equal_specs_in_two_processes_give_equal_streams() -> None:
    reports = [json.loads(appli("run", "doorway", "--seed", "3", "--json").stdout) for _ in range(2)]
    for report in reports:
        del report["wall_time"], report["real_time_factor"]
    assert reports[0] == reports[1]
    other = json.loads(appli("run", "doorway", "--seed", "4", "--json").stdout)
    assert other["digest"] != reports[0]["digest"]


def test_an_unknown_world_names_the_closest() -> None:
    assert "training" in complaint("run", "trainin")


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["run"], "needs: WORLD"),
        (["rnu", "open"], "Available"),
        (["run", "open", "--sed", "1"], "--seed"),
        (["run", "open", "--sed", "1"], "appli run --help"),
        (["run", "open", "--protocol", "2020"], "BARN"),
        (["run", "open", "--goal", "1,2,3"], "x,y in metres"),
        (["run", "open", "--seed", "x"], "--seed"),
        (["run", "open", "--seed", "-1"], "--seed"),
        (["run", "open", "--protocol", "moon"], "icra22"),
        (["run", "open", "--driver", "nobody"], "driver"),
        (["run", "open", "--params", "missing.yaml"], "missing.yaml"),
        (["run", "open", "--record", "/dev/null/at/all.rrd"], "/dev/null"),
        (["run", "barn-like/300"], "299"),
        (["run", "open", "--record", "course.toml"], ".rrd"),
        (["run", "open", "--driver", "theta:Z9"], "theta:B1"),
        (["run", "open", "--driver", "missing.safetensors"], "missing.safetensors"),
        (["run", "open", "--driver", "theta:B1", "--params", "p.yaml"], "--params is for the driver dwa"),
        (["run", "open", "--driver", "p.safetensors", "--inflation", "local"], "--inflation does not go with a policy"),
        (["run", "open", "--driver", "p.safetensors", "--couple-min-vel-theta"], "--couple-min-vel-theta does not"),
        (["bench", "--repeats", "0"], "--repeats"),
        (["collect", "open"], "--out"),
        (["collect", "open", "--out", __file__], "it is a file"),
        (["demo", "--sessions", "0", "--out", "/nowhere"], "--sessions"),
        (["sweep", "--worlds", "open", "--methods", "dwa", "--runs", "1", "--out", "/"], "is a folder"),
        (["sweep", "--worlds", "open", "--methods", "dwa", "--runs", "99999999999", "--out", "x.sqlite"], "--runs"),
        (
            ["sweep", "--worlds", "open", "--methods", "../A", "--runs", "1", "--policies", "/", "--out", "x"],
            "not a path",
        ),
        (["run", "/"], "is a folder"),
        (["run", "policy.safetensors"], "is a policy"),
        (["train", "/nowhere", "--out", "p.safetensors"], "/nowhere"),
        (["train", __file__, "--out", "p.safetensors"], "is a file"),
        (["train", "/nowhere", "--out", "p.safetensors", "--types", "A,X"], "--types"),
    ],
)
def test_mistakes_get_one_line(arguments: list[str], word: str) -> None:
    assert word in complaint(*arguments)


def test_a_narrow_terminal_without_unicode_shows_every_word() -> None:
    done = appli("worlds", PYTHONIOENCODING="ascii", LC_ALL="C", COLUMNS="40")
    assert done.returncode == 0, done.stderr
    assert "corridor" in done.stdout


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])  # the parser draws its frames differently
def test_a_mistake_gets_the_same_line_on_every_terminal(encoding: str) -> None:
    done = appli("rnu", "open", PYTHONIOENCODING=encoding)
    assert done.returncode == 2
    assert done.stderr.startswith("appli: Unrecognized options: rnu")
    assert done.stderr.endswith("; see: appli --help\n")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("max_vel_x: .nan\n", "max_vel_x"),
        ("max_vel_x: 90\n", "outside"),
        ("max_vel: 0.5\n", "max_vel_x"),
        ("vx_samples: 2.5\n", "whole"),
        ("vx_samples: true\n", "number"),
        ("- 1\n- 2\n", "max_vel_x"),
        ("{", "YAML"),
        ("max_vel_x: 0.8\nmax_vel_x: 0.9\n", "max_vel_x is given twice"),
        ("a: &a [1]\nb: !!python/object/apply:os.system ['true']\n", "YAML"),
    ],
)
def test_bad_parameters_get_one_line(tmp_path: Path, text: str, word: str) -> None:
    (tmp_path / "p.yaml").write_text(text)
    assert word in complaint("run", "open", "--params", str(tmp_path / "p.yaml"))


def test_a_full_stdout_gets_one_line() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "scenarios", "worlds", "--json"], stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1


def test_without_a_writable_home_it_still_runs(tmp_path: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k not in {"XDG_CACHE_HOME", "NUMBA_CACHE_DIR"}}
    environment |= {"HOME": "/proc", "TMPDIR": str(tmp_path)}
    code = "from twin.compiled import *; print(CAN_CACHE, FIRST_TIME, numba.config.CACHE_DIR)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.startswith(f"True True {tmp_path}")


def test_parameters_reach_the_planner(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text("max_vel_x: 0.25\n")
    slow = json.loads(appli("run", "open", "--params", str(tmp_path / "p.yaml"), "--json").stdout)
    usual = json.loads(appli("run", "open", "--json").stdout)
    assert slow["time"] > 1.7 * usual["time"]


def test_a_pickled_grid_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "grid.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    complaint("run", str(tmp_path / "grid.npy"))


@pytest.mark.slow
def test_ctrl_c_closes_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    child = subprocess.Popen(
        [sys.executable, "-m", "scenarios", "run", "training", "--record", str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and (not path.exists() or path.stat().st_size < 200_000):
        time.sleep(0.1)
    child.send_signal(signal.SIGINT)
    _, err = child.communicate(timeout=60)
    assert child.returncode == 130, err
    assert "Traceback" not in err
    rerun = Path(sys.executable).with_name("rerun")
    verified = subprocess.run([rerun, "rrd", "verify", path], capture_output=True, text=True, check=False)
    assert verified.returncode == 0, verified.stdout + verified.stderr


def test_worlds_fits_sixty_columns_and_cuts_no_word() -> None:
    lines = appli("worlds", COLUMNS="60").stdout.splitlines()
    assert max(map(len, lines)) <= 60
    told = " ".join(line.split("│")[-2].strip() for line in lines if "│" in line)
    for entry in json.loads(appli("worlds", "--json").stdout):
        assert entry["note"] in told
        assert any(entry["name"] in line and entry["size"] in line for line in lines)
