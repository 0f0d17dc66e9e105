"""Laws of the results file: what goes in comes out, a mistake is one line, and only one sweep writes."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import pytest

from scenarios.errors import UserError
from scenarios.store import SCHEMA, Store, StoredTrial

DONE = StoredTrial(
    key="k0",
    world="open",
    world_digest="w",
    protocol="course",
    method="A+c",
    seed=0,
    run=0,
    policy="p",
    code="c",
    status="done",
    outcome="reached",
    time=12.3456789012345,
    distance=6.1,
    recoveries=0,
    min_clearance=None,
    contexts={"A1": 0.25, "default": 0.75},
    confidence=(1,) * 19 + (230,),
    ticks=249,
    digest="d",
    wall=1.5,
    finished="2026-01-01T00:00:00+00:00",
)
FAILED = StoredTrial(
    key="k1",
    world="open",
    world_digest="w",
    protocol="course",
    method="dwa",
    seed=0,
    run=1,
    policy="",
    code="c",
    status="error",
    error="Traceback ...",
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "results.sqlite"


def complaint(path: Path, write: bool = False) -> str:
    """The one line of a refused file."""
    with pytest.raises(UserError) as caught:
        Store.open(path, write)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_goes_in_comes_out(path: Path) -> None:
    with Store.open(path, write=True) as store:
        store.add([DONE, FAILED])
        assert store.rows() == [DONE, FAILED]
    with Store.open(path) as store:
        assert store.rows() == [DONE, FAILED]
        assert store.rows(method="dwa", world="open") == [FAILED]
        assert store.rows(status="done") == [DONE]
        assert store.keys() == {"k0"}
        assert store.keys(None) == {"k0", "k1"}
    assert [p.name for p in path.parent.iterdir()] == [path.name]  # a single file


def test_a_row_of_the_same_key_is_replaced(path: Path) -> None:
    again = replace(FAILED, status="done", outcome="reached", error=None)
    with Store.open(path, write=True) as store:
        store.add([FAILED])
        store.add([again])
        assert store.rows() == [again]


def test_facts_leave_out_what_differs_between_runs() -> None:
    later = replace(DONE, wall=99.0, finished="2027-01-01T00:00:00+00:00")
    assert later.facts() == DONE.facts() != replace(DONE, time=1.0).facts()


def test_rows_are_written_all_or_none(path: Path) -> None:
    broken = replace(DONE, key="k2", world=None)  # type: ignore[arg-type]
    with Store.open(path, write=True) as store:
        with pytest.raises(UserError):
            store.add([DONE, broken])
        assert store.rows() == []


def test_a_reader_cannot_write(path: Path) -> None:
    Store.open(path, write=True).close()
    with Store.open(path) as store, pytest.raises(UserError):
        store.add([DONE])


def test_a_report_reads_while_a_sweep_writes(path: Path) -> None:
    with Store.open(path, write=True) as writer:
        writer.add([DONE])
        with Store.open(path) as reader:
            assert reader.rows() == [DONE]
            writer.add([FAILED])
            assert len(reader.rows()) == 2


# --- files that are refused ------------------------------------------------------------------------------------------


def test_a_missing_file(path: Path) -> None:
    assert "appli sweep" in complaint(path)
    assert not path.exists()


def test_a_missing_folder(tmp_path: Path) -> None:
    assert "not a folder" in complaint(tmp_path / "nowhere" / "r.sqlite", write=True)


@pytest.mark.parametrize("write", [False, True])
def test_a_foreign_file_is_left_alone(path: Path, write: bool) -> None:
    path.write_text("name,time\n")
    assert "not a results file" in complaint(path, write)
    assert path.read_text() == "name,time\n"


@pytest.mark.parametrize("write", [False, True])
def test_a_foreign_database(path: Path, write: bool) -> None:
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE people (name TEXT)")
    connection.close()
    before = path.read_bytes()
    assert "not of appli sweep" in complaint(path, write)
    assert path.read_bytes() == before


def test_a_newer_file(path: Path) -> None:
    Store.open(path, write=True).close()
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE meta SET value = ? WHERE name = 'schema'", (str(SCHEMA + 1),))
    connection.close()
    assert "update appli-twin" in complaint(path)


@pytest.mark.parametrize("write", [False, True])
def test_a_corrupt_file(path: Path, write: bool) -> None:
    with Store.open(path, write=True) as store:
        store.add([replace(DONE, key=f"k{i}") for i in range(500)])
    data = bytearray(path.read_bytes())
    data[8192:40960] = os.urandom(40960 - 8192)
    path.write_bytes(data)
    assert "damaged" in complaint(path, write)
    path.write_bytes(path.read_bytes()[:5000])
    assert "damaged" in complaint(path, write)


def test_an_empty_file_is_what_an_early_kill_leaves(path: Path) -> None:
    path.touch()
    assert "not a results file" in complaint(path)
    with Store.open(path, write=True) as store:
        assert store.rows() == []


# --- one writer, and what kills it -----------------------------------------------------------------------------------

HOLD = """
    import sys
    from pathlib import Path
    from scenarios.store import Store
    store = Store.open(Path(sys.argv[1]), write=True)
    print("open", flush=True)
    sys.stdin.read()
"""


def test_a_second_writer_is_refused_until_the_first_is_gone(path: Path) -> None:
    child = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(HOLD), path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with child:
        assert child.stdout is not None
        assert child.stdout.readline() == "open\n"
        assert "another sweep" in complaint(path, write=True)
        Store.open(path).close()
        child.send_signal(signal.SIGKILL)
        child.wait()
    Store.open(path, write=True).close()
    assert [p.name for p in path.parent.iterdir()] == [path.name]


FILL = """
    import resource, sys
    from dataclasses import replace
    from pathlib import Path
    from scenarios.errors import UserError
    from scenarios.store import Store
    from tests.scenarios.test_store import DONE
    with Store.open(Path(sys.argv[1]), write=True) as store:
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
        try:
            for i in range(10_000):
                store.add([replace(DONE, key=f"k{i:05}", run=i)])
                print(i + 1, flush=True)
        except UserError as error:
            print(error)
"""


def test_a_full_disk_keeps_every_row_that_was_added(path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(FILL), path, "100000"], capture_output=True, text=True, check=True
    )
    *counts, line = done.stdout.splitlines()
    assert "disk full" in line
    assert int(counts[-1]) > 10
    with Store.open(path, write=True) as store:
        assert [row.run for row in store.rows()] == list(range(int(counts[-1])))
        store.add([replace(DONE, key="afterwards", run=10_000)])


ENDLESS = FILL.replace("resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)", "pass")


@pytest.mark.parametrize("count", [1, 7, 30])
def test_a_killed_writer_loses_nothing_that_was_added(path: Path, count: int) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(ENDLESS), path], stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        while int(child.stdout.readline()) < count:
            pass
        child.send_signal(signal.SIGKILL)
    with Store.open(path) as store:
        runs = [row.run for row in store.rows()]
        assert runs == list(range(len(runs)))
        assert len(runs) >= count
