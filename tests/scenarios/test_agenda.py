"""What a sweep decides to do: worlds, methods, keys, order. No process is started."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from learning.policy import Context, Policy, PolicySwitches
from learning.policy_file import policy_bytes
from scenarios import agenda, identity, job
from scenarios.agenda import Agenda, make_agenda
from scenarios.errors import UserError
from scenarios.store import StoredTrial
from scenarios.world_checks import WorldError
from scenarios.worlds import load_world
from twin.planner.params import PlannerParams
from twin.world import Mesh

ARCHIVE = Path(__file__).resolve().parents[3] / "shared" / "barn" / "barn_100.npz"
OPEN = load_world("open")
POLICY = policy_bytes(Policy((Context("A1", PlannerParams()),)))
OTHER = policy_bytes(Policy((Context("A2", PlannerParams()),)))


def plan(**changes: object) -> Agenda:
    """A small agenda, with changes."""
    values = {"worlds": [OPEN], "methods": {"dwa": None, "A": POLICY}, "runs": 2, "seed": 0, "code": "c"} | changes
    return make_agenda(**values)  # type: ignore[arg-type]


def keys(**changes: object) -> set[str]:
    return {j.key for j in plan(**changes).jobs}


# --- keys ------------------------------------------------------------------------------------------------------------


def test_equal_specs_have_equal_keys_and_all_jobs_different_ones() -> None:
    assert keys() == keys()
    assert len(keys(runs=5)) == 10


def test_a_key_forgets_what_a_method_is_called() -> None:
    assert keys(methods={"dwa": None, "B": POLICY}) == keys()


@pytest.mark.parametrize("changes", [{"code": "d"}, {"seed": 1}, {"worlds": [replace(OPEN, goal=OPEN.start)]}])
def test_whatever_decides_a_trial_changes_its_key(changes: dict[str, object]) -> None:
    assert not keys() & keys(**changes)


def test_another_policy_changes_the_keys_of_its_method_only() -> None:
    assert len(keys() & keys(methods={"dwa": None, "A": OTHER})) == 2


def test_more_runs_keep_the_keys_of_the_first() -> None:
    assert keys() < keys(runs=3)


def test_the_code_is_all_that_trials_import_and_no_more() -> None:
    names = {path.relative_to(identity.ROOT).as_posix() for path in identity.deciding_sources()}
    assert {"scenarios/trials.py", "scenarios/switches.py", "learning/deploy.py", "twin/planner/navfn.py"} <= names
    assert not {name for name in names if "record" in name and name != "twin/records.py"}
    assert not names & {"scenarios/statistics.py", "scenarios/sweep.py", "scenarios/cli.py", "learning/fit.py"}


def test_comments_and_docstrings_decide_nothing(tmp_path: Path) -> None:
    one, same, other = (tmp_path / name for name in ("a.py", "b.py", "c.py"))
    one.write_text('"""Old."""\n\ndef f(x):\n    """Doubles."""\n    return 2 * x  # twice\n')
    same.write_text("def f(x):\n\n    return (2 * x)\n")
    other.write_text("def f(x):\n    return 3 * x\n")
    assert identity._syntax(one) == identity._syntax(same) != identity._syntax(other)


def test_a_digest_of_a_policy_is_that_of_its_bytes() -> None:
    assert identity.policy_digest(POLICY) == hashlib.sha256(POLICY).hexdigest()
    assert identity.policy_digest(None) == ""


def test_meshes_count_in_a_world() -> None:
    faces = np.array([[0, 1, 2]], dtype=np.int32)
    meshes = [Mesh(np.eye(3) * size, faces) for size in (1.0, 1.0, 2.0)]
    digests = [identity.world_digest(replace(OPEN, obstacles=(mesh,))) for mesh in meshes]
    assert digests[0] == digests[1] != digests[2]


# --- order and ambiguity ---------------------------------------------------------------------------------------------


def test_an_unfinished_sweep_is_balanced() -> None:
    jobs = plan(worlds=[OPEN, load_world("u-trap")], runs=3).jobs
    assert [j.run for j in jobs] == [0] * 4 + [1] * 4 + [2] * 4
    assert [(j.world, j.method) for j in jobs[:4]] == [
        ("open", "dwa"),
        ("open", "A"),
        ("u-trap", "dwa"),
        ("u-trap", "A"),
    ]


def test_a_world_given_twice_is_done_once() -> None:
    assert len(plan(worlds=[OPEN, load_world("open")]).jobs) == 4


def test_two_worlds_of_one_name_are_refused() -> None:
    with pytest.raises(UserError, match="two different worlds"):
        plan(worlds=[OPEN, replace(OPEN, goal=OPEN.start)])


def test_two_methods_that_are_one_file_are_refused() -> None:
    with pytest.raises(UserError, match="the same file"):
        plan(methods={"A": POLICY, "B": POLICY})


def test_what_the_store_has_of_other_versions_is_said_in_one_line_each() -> None:
    ours = plan()
    rows = [row(j) for j in ours.jobs]
    assert agenda.other_versions(ours, rows) == []
    assert "4 stored" in agenda.other_versions(ours, [replace(r, code="old") for r in rows])[0]
    assert "policies" in agenda.other_versions(ours, [replace(r, policy="old") for r in rows])[0]
    assert "changed" in agenda.other_versions(ours, [replace(r, world_digest="old") for r in rows])[0]
    assert agenda.other_versions(ours, [replace(r, world="elsewhere", code="old") for r in rows]) == []


def row(j: agenda.Job) -> StoredTrial:
    return job.failed(j, "Traceback")


def test_only_what_is_not_done_is_missing() -> None:
    jobs = plan().jobs
    assert agenda.missing(jobs, {jobs[0].key, "unknown"}) == list(jobs[1:])


def test_a_policy_keeps_its_name_within_a_file() -> None:
    ours = plan()
    agenda.check_names(ours, [row(j) for j in ours.jobs])
    with pytest.raises(UserError, match="is in this file as another"):
        agenda.check_names(ours, [replace(row(ours.jobs[-1]), method="another")])


def test_a_folder_is_its_world_files(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match="without"):
        agenda.expand(str(tmp_path))
    for name in ("b.world", "a.world", "c.txt"):
        (tmp_path / name).touch()
    assert agenda.expand(str(tmp_path)) == [str(tmp_path / "a.world"), str(tmp_path / "b.world")]


# --- names -----------------------------------------------------------------------------------------------------------


def test_names_of_many_worlds() -> None:
    assert len(agenda.expand("barn-like")) == 300
    assert agenda.expand("barn-like/8-10") == agenda.expand("barn-like/8..10")
    assert agenda.expand("barn-like/8-10") == ["barn-like/8", "barn-like/9", "barn-like/10"]
    assert agenda.expand("training") == ["training"]
    assert [w.name for w in agenda.read_worlds("open, barn-like/3-4", "appli")] == [
        "open",
        "barn-like/3",
        "barn-like/4",
    ]


@pytest.mark.skipif(not ARCHIVE.is_file(), reason="needs ../shared/barn")
def test_names_of_an_archive() -> None:
    assert len(agenda.expand(str(ARCHIVE))) == 100
    assert agenda.expand(f"{ARCHIVE}#3-7") == [f"{ARCHIVE}#3", f"{ARCHIVE}#6"]
    assert agenda.expand(f"{ARCHIVE}#3") == [f"{ARCHIVE}#3"]
    with pytest.raises(WorldError, match="no world"):
        agenda.expand(f"{ARCHIVE}#4-5")


@pytest.mark.parametrize(
    ("worlds", "word"),
    [
        ("open,", "blank"),
        ("opn", "open"),
        ("barn-like/299-301", "barn-like/300"),
        ("barn-like/9-3", "smaller"),
        ("nowhere.npz", "does not exist"),
    ],
)
def test_wrong_worlds_get_one_line(worlds: str, word: str) -> None:
    with pytest.raises(UserError, match=word):
        agenda.read_worlds(worlds, "appli")


def test_methods_and_their_policies(tmp_path: Path) -> None:
    (tmp_path / "A+c.safetensors").write_bytes(POLICY)
    (tmp_path / "broken.safetensors").write_bytes(POLICY[:100])
    assert agenda.read_methods("dwa, A+c", tmp_path) == {"dwa": None, "A+c": POLICY}
    for methods, folder, word in (
        ("A", None, "--policies"),
        ("A", tmp_path, r"has A\+c, broken"),
        ("../A", tmp_path, "not a path"),
        ("A", tmp_path / "nowhere", "has none"),
        ("broken", tmp_path, "broken.safetensors: not a policy"),
    ):
        with pytest.raises(UserError, match=word):
            agenda.read_methods(methods, folder)


# --- one job ---------------------------------------------------------------------------------------------------------


def test_a_trial_that_raises_becomes_a_row_with_its_traceback() -> None:
    """Nobody has brought this world."""
    lost = plan(worlds=[replace(OPEN, name="lost")], code=identity.code_digest()).jobs[0]
    stored = job.do(lost)
    assert stored.status == "error"
    assert "KeyError" in str(stored.error)
    assert (stored.key, stored.outcome, stored.method) == (lost.key, None, "dwa")


def test_a_job_of_other_code_is_refused() -> None:
    with pytest.raises(job.OtherCodeError):
        job.do(plan().jobs[0])


def test_a_policys_own_switches_reach_the_robot() -> None:
    policy = policy_bytes(Policy((Context("A1", PlannerParams()),), switches=PolicySwitches(inflation="local")))
    ours = plan(methods={"A": policy}, runs=1, code=identity.code_digest())
    job.equip(ours.worlds, ours.policies)
    stored = job.do(ours.jobs[0])
    assert stored.status == "done", stored.error
    assert stored.contexts == {"A1": 1.0}
    assert stored.confidence is None
