"""A sweep as a user starts it, and what may kill it: in the end the same rows, nothing lost but trials in flight."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import psutil
import pytest

from learning.policy import Context, Policy
from learning.policy_file import save_policy
from scenarios.errors import UserError
from scenarios.progress import Pace, duration
from scenarios.store import Store, StoredTrial
from scenarios.sweep import sweep_command
from tests.learning.classifiers import FAR, NEAR, range_classifier
from twin.planner.params import PlannerParams

ROOT = Path(__file__).resolve().parents[2]
RUNS = 4
TRIALS = 2 * RUNS
PATIENCE = 90.0  # [s]
DASK_PORT = 8787  # that a scheduler takes unless it is told otherwise
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}


@pytest.fixture(scope="module")
def policies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("policies")
    contexts = (Context(NEAR, PlannerParams()), Context(FAR, PlannerParams(max_vel_x=1.0)))
    save_policy(Policy(contexts, range_classifier(), window=1), folder / "A+B+c.safetensors")
    return folder


@pytest.fixture(scope="module")
def course(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of a few seconds."""
    path = tmp_path_factory.mktemp("courses") / "short.toml"
    path.write_text('name = "short"\nstart = [0.0, 0.0, 0.0]\ngoal = [2.5, 0.0]\ntime_limit = 30.0\n')
    return path


@pytest.fixture(scope="module")
def command(course: Path, policies: Path) -> Callable[..., list[str]]:
    """The command line of the sweep that all tests here do, with more options."""

    def build(out: Path, *more: str) -> list[str]:
        sweep = [sys.executable, "-m", "scenarios", "sweep", "--out", str(out), "--worlds", str(course)]
        return [*sweep, "--methods", "dwa,A+B+c", "--policies", str(policies), "--runs", str(RUNS), *more]

    return build


@pytest.fixture(scope="module")
def unbroken(command: Callable[..., list[str]], tmp_path_factory: pytest.TempPathFactory) -> list[StoredTrial]:
    """What the sweep gives when nothing happens to it."""
    out = tmp_path_factory.mktemp("unbroken") / "r.sqlite"
    with ExitStack() as stack:
        with suppress(OSError):  # taken already: just as good
            stack.enter_context(socket.create_server(("127.0.0.1", DASK_PORT)))
        done = finish(start(command(out)))
    assert done.returncode == 0, done.stderr
    assert [p.name for p in out.parent.iterdir()] == [out.name]
    return facts(out)


def start(command: list[str], **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env=ENVIRONMENT | environment,
        start_new_session=True,  # so that a test can press Ctrl-C
    )


def finish(process: subprocess.Popen[str]) -> subprocess.CompletedProcess[str]:
    out, err = process.communicate(timeout=PATIENCE)
    assert "Traceback" not in err, err
    assert "Warning" not in err, err
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def stored(out: Path) -> list[StoredTrial]:
    if not out.exists() or not out.stat().st_size:
        return []
    with Store.open(out) as store:
        return store.rows()


def facts(out: Path) -> list[StoredTrial]:
    return [row.facts() for row in stored(out)]


def wait_for_rows(out: Path, count: int, process: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + PATIENCE
    while len(stored(out)) < count:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.05)


def workers_of(process: subprocess.Popen[str]) -> list[psutil.Process]:
    children = psutil.Process(process.pid).children(recursive=True)
    return [child for child in children if "spawn_main" in " ".join(child.cmdline())]


def gone(processes: list[psutil.Process]) -> bool:
    _, alive = psutil.wait_procs(processes, timeout=20.0)
    return not alive


# --- in one go -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_rows_of_a_sweep(unbroken: list[StoredTrial]) -> None:
    assert len(unbroken) == TRIALS
    assert {(row.method, row.run) for row in unbroken} == {(m, k) for m in ("dwa", "A+B+c") for k in range(RUNS)}
    for row in unbroken:
        assert (row.status, row.outcome, row.world, row.protocol) == ("done", "reached", "short", "course")
        assert row.ticks is not None
        if row.method == "dwa":
            assert (row.policy, row.confidence, row.contexts) == ("", None, {"default": 1.0})
        else:
            assert row.confidence is not None
            assert sum(row.confidence) == row.ticks
    assert len({row.digest for row in unbroken}) == TRIALS


# --- what may happen -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_killed_sweep_goes_on(command: Callable[..., list[str]], unbroken: list[StoredTrial], tmp_path: Path) -> None:
    out = tmp_path / "r.sqlite"
    process = start(command(out))
    wait_for_rows(out, 2, process)
    process.send_signal(signal.SIGSTOP)  # else it may be done before it is killed
    with pytest.raises(UserError, match="another sweep"):
        sweep_command(out, "open", "dwa", None, 1, 0, "appli", None, None)
    workers = workers_of(process)
    process.kill()
    process.communicate()
    assert workers
    assert gone(workers)
    left = facts(out)
    assert 2 <= len(left) < TRIALS
    assert all(row in unbroken for row in left)
    assert finish(start(command(out))).returncode == 0
    assert facts(out) == unbroken
    assert [p.name for p in tmp_path.iterdir()] == [out.name]


@pytest.mark.slow
def test_a_killed_worker_is_replaced(
    command: Callable[..., list[str]], unbroken: list[StoredTrial], tmp_path: Path
) -> None:
    out = tmp_path / "r.sqlite"
    process = start(command(out))
    wait_for_rows(out, 2, process)
    workers_of(process)[0].kill()
    done = finish(process)
    assert done.returncode == 0, done.stderr
    assert facts(out) == unbroken


@pytest.mark.slow
def test_ctrl_c_finishes_what_is_in_work(
    command: Callable[..., list[str]], unbroken: list[StoredTrial], tmp_path: Path
) -> None:
    out = tmp_path / "r.sqlite"
    process = start(command(out))
    wait_for_rows(out, 2, process)
    workers = workers_of(process)
    os.killpg(process.pid, signal.SIGINT)  # a terminal sends it to the workers too
    done = finish(process)
    assert done.returncode == 130, done.stderr
    assert "Ctrl-C again" in done.stderr
    assert "the same command goes on" in done.stdout
    assert gone(workers)
    left = facts(out)
    assert re.search(rf"^{TRIALS - len(left)} left", done.stdout, re.MULTILINE)
    assert all(row in unbroken for row in left)


@pytest.mark.slow
def test_a_second_ctrl_c_stops_at_once(command: Callable[..., list[str]], course: Path, tmp_path: Path) -> None:
    out = tmp_path / "r.sqlite"
    process = start(command(out, "--worlds", f"{course},training"))
    wait_for_rows(out, 2, process)  # what follows is the training course
    workers = workers_of(process)
    os.killpg(process.pid, signal.SIGINT)
    time.sleep(0.5)
    os.killpg(process.pid, signal.SIGINT)
    began = time.monotonic()
    done = finish(process)
    assert done.returncode == 130
    assert done.stderr.strip().splitlines()[-1] == "appli: interrupted"
    assert time.monotonic() - began < 5.0
    assert gone(workers)
    Store.open(out, write=True).close()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 64 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("may not mount a tmpfs here")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.slow
def test_a_full_disk_loses_only_what_is_in_flight(
    command: Callable[..., list[str]], unbroken: list[StoredTrial], small_disk: Path
) -> None:
    out = small_disk / "r.sqlite"
    Store.open(out, write=True).close()
    filler = small_disk / "filler"
    disk = os.statvfs(small_disk)
    filler.write_bytes(bytes((disk.f_bavail - 3) * disk.f_bsize))  # room for about eight rows and SQLite's journal
    more = ("--runs", str(2 * RUNS))
    done = finish(start(command(out, *more)))
    assert done.returncode == 2
    assert "disk full" in done.stderr.strip().splitlines()[-1]
    left = facts(out)
    assert 0 < len(left) < 2 * TRIALS
    filler.unlink()
    assert finish(start(command(out, *more))).returncode == 0
    complete = facts(out)
    assert all(row in complete for row in left)
    assert [row for row in complete if row.run < RUNS] == unbroken


# --- workers that misbehave ------------------------------------------------------------------------------------------


def preload(folder: Path, body: str) -> dict[str, str]:
    """Environment in which every worker does this before its first trial."""
    path = folder / "mischief.py"
    once = "real = job.__dict__.setdefault('real', job.run_trial)"  # dask loads the file twice
    path.write_text(f"import os\nimport scenarios.job as job\n{once}\n{body}\n")
    return {"DASK_DISTRIBUTED__WORKER__PRELOAD": str(path)}


@pytest.mark.slow
def test_trials_that_raise_are_stored_and_tried_again(
    command: Callable[..., list[str]], unbroken: list[StoredTrial], tmp_path: Path
) -> None:
    out = tmp_path / "r.sqlite"
    body = "def broken(spec, *args, **more):\n    return real(spec, *args, **more) if spec.run != 1 else 1 / 0\n"
    done = finish(
        start(command(out, "--runs", "2", "--workers", "1"), **preload(tmp_path, body + "job.run_trial = broken"))
    )
    assert done.returncode == 1
    assert "tracebacks" in done.stdout
    errors = [row for row in stored(out) if row.status == "error"]
    assert [row.run for row in errors] == [1, 1]
    assert all("ZeroDivisionError" in str(row.error) for row in errors)
    before = [row for row in stored(out) if row.status == "done"]
    again = finish(start(command(out, "--runs", "3", "--workers", "1")))
    assert again.returncode == 0
    assert "6 trials, 2 of them stored already, 4 to do" in again.stderr
    assert facts(out) == [row for row in unbroken if row.run < 3]
    assert all(row in stored(out) for row in before)


@pytest.mark.slow
def test_a_trial_that_kills_its_workers_is_given_up(command: Callable[..., list[str]], tmp_path: Path) -> None:
    out = tmp_path / "r.sqlite"
    body = (
        "def deadly(spec, *args, **more):\n"
        "    return real(spec, *args, **more) if spec.run or more['driver'].__class__.__name__ == 'AppliDriver'"
        " else os._exit(9)\n"
        "job.run_trial = deadly"
    )
    environment = preload(tmp_path, body) | {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
    done = finish(start(command(out, "--runs", "2", "--workers", "1"), **environment))
    assert done.returncode == 1, done.stderr
    rows = stored(out)
    assert len(rows) == 4
    assert [(row.method, row.run) for row in rows if "died" in str(row.error)][-1] == ("dwa", 0)


@pytest.mark.slow
def test_workers_of_other_code_are_refused(command: Callable[..., list[str]], tmp_path: Path) -> None:
    out = tmp_path / "r.sqlite"
    done = finish(start(command(out), **preload(tmp_path, "job.code_digest = lambda: 'other'")))
    assert done.returncode == 2
    assert "other code" in done.stderr.strip().splitlines()[-1]
    assert stored(out) == []


# --- a cluster -------------------------------------------------------------------------------------------------------


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[str]]]]:
    """A scheduler and two workers in processes of their own, in other folders."""
    address = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(address)]
    options = ["--host", "127.0.0.1", "--nthreads", "1", "--no-dashboard", "--memory-limit", "1GiB"]
    scheduler = [*dask, "--no-dashboard", "--scheduler-file", str(address)]
    processes = []
    try:
        for name, line in (("s", scheduler), ("a", [*worker, *options]), ("b", [*worker, *options])):
            folder = tmp_path / name
            folder.mkdir()
            with (folder / "log").open("w") as log:
                process = subprocess.Popen(line, stdout=log, stderr=log, text=True, cwd=folder, env=ENVIRONMENT)
            processes.append(process)
        deadline = time.monotonic() + PATIENCE
        while not address.exists() or "tcp" not in address.read_text():
            assert time.monotonic() < deadline
            time.sleep(0.1)
        yield re.findall(r"tcp://[\d.:]+", address.read_text())[0], processes
    finally:
        for process in reversed(processes):
            for child in psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []:
                child.kill()
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_gives_the_same_rows(
    command: Callable[..., list[str]],
    unbroken: list[StoredTrial],
    cluster: tuple[str, list[subprocess.Popen[str]]],
    tmp_path: Path,
) -> None:
    address, (_, victim, _) = cluster
    out = tmp_path / "r.sqlite"
    process = start(command(out, "--scheduler", address))
    wait_for_rows(out, 3, process)
    for child in psutil.Process(victim.pid).children(recursive=True):
        child.kill()
    victim.kill()
    done = finish(process)
    assert done.returncode == 0, done.stderr
    assert facts(out) == unbroken


@pytest.mark.slow
def test_a_cluster_whose_scheduler_dies_gets_one_line(
    command: Callable[..., list[str]], cluster: tuple[str, list[subprocess.Popen[str]]], tmp_path: Path
) -> None:
    address, (scheduler, *_) = cluster
    out = tmp_path / "r.sqlite"
    process = start(command(out, "--scheduler", address))
    wait_for_rows(out, 1, process)
    scheduler.kill()
    done = finish(process)
    assert done.returncode == 2
    assert "scheduler" in done.stderr.strip().splitlines()[-1]
    assert stored(out)


# --- mistakes and words ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"runs": 0}, "--runs"),
        ({"seed": -1}, "--seed"),
        ({"workers": 0}, "--workers"),
        ({"workers": 2, "scheduler": "tcp://127.0.0.1:1"}, "--scheduler"),
        ({"worlds": "nowhere"}, "nowhere"),
        ({"methods": "A"}, "--policies"),
        ({"out": Path("/nowhere/at/all.sqlite")}, "not a folder"),
        ({"out": Path(__file__)}, "not a results file"),
    ],
)
def test_mistakes_get_one_line_before_anything_starts(changes: dict[str, object], word: str, tmp_path: Path) -> None:
    values = {"out": tmp_path / "r.sqlite", "worlds": "open", "methods": "dwa", "policies": None, "runs": 1}
    values |= {"seed": 0, "protocol": "appli", "workers": None, "scheduler": None} | changes
    with pytest.raises(UserError, match=word):
        sweep_command(**values)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_pace_counts_the_last_minutes() -> None:
    now = [0.0]
    pace = Pace(100, lambda: now[0])
    assert pace.words() == "0/min, time left unknown"
    for k in range(40):
        now[0] = 1.5 * (k + 1)
        pace.add("reached" if k % 4 else "timed_out")
    assert pace.per_minute() == pytest.approx(40.0)
    assert pace.words() == "40/min, 90 s left; reached 75 %, timed_out 25 %".replace("90 s", duration(90.0))
    now[0] = 1000.0
    assert pace.per_minute() == 0.0


@pytest.mark.parametrize(("seconds", "words"), [(45.2, "45 s"), (700, "12 min"), (11_100, "3 h 05 min")])
def test_durations_are_for_people(seconds: float, words: str) -> None:
    assert duration(seconds) == words
