"""The report: its numbers against hand-made ones, its page by itself, and one line for every mistake."""

from __future__ import annotations

import csv
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from learning.policy import Context, Policy, Provenance
from learning.policy_file import policy_bytes
from scenarios.errors import UserError
from scenarios.identity import policy_digest
from scenarios.report.command import report_command
from scenarios.report.facts import read_facts
from scenarios.report.figures.style import spread
from scenarios.report.paper import COURSES, TABLE_IV
from scenarios.report.sheet import ONE, SPREAD, Column, Sheet
from scenarios.report.tables import Significance, courses_sheet, methods_sheet
from scenarios.store import CONFIDENCE_BINS, Store, StoredTrial
from tests.learning.classifiers import range_classifier
from twin.planner.params import PlannerParams

POLICY = Policy(
    (Context("A1", PlannerParams(max_vel_x=0.31)), Context("B1", PlannerParams(max_vel_x=1.23))),
    range_classifier(),
    provenance=Provenance(
        interventions={"d0": "A1", "d1": "A1", "d2": "B1"},
        losses={"A1": (12.0, 1.5)},
        flatness={"A1": {"max_vel_x": (0.25, 0.375)}},
        curves={"A1": [(12.0, 5.0), (24.0, 1.5)], "classifier": [(0.0, 2.0), (100.0, 0.5)]},
        types="A,B",
    ),
)
DIGEST = policy_digest(policy_bytes(POLICY))
EVERY = ("training", "world_2", "world_10", "world_30")  # the worlds below
LEARNED = "A+B+c"


def trial(world: str, method: str, run: int, time: float | None, **changes: object) -> StoredTrial:
    """A finished trial; no time = it timed out."""
    learned = method != "dwa"
    row = StoredTrial(
        key=f"{world}|{method}|{run}",
        world=world,
        world_digest=f"digest of {world}",
        protocol="course" if world in COURSES else "appli",
        method=method,
        seed=0,
        run=run,
        policy=DIGEST if learned else "",
        code="c0de" * 16,
        status="done",
        outcome="timed_out" if time is None else "reached",
        time=50.0 if time is None else time,
        distance=10.0,
        recoveries=1,
        min_clearance=0.1,
        contexts={"default": 0.25, "A1": 0.75} if learned else {"default": 1.0},
        confidence=(0,) * (CONFIDENCE_BINS - 1) + (100,) if learned else None,
        ticks=100,
        digest="t",
        finished="2026-01-01T00:00:00.000+00:00",
    )
    return replace(row, **changes)


TIMES: dict[tuple[str, str], Sequence[float | None]] = {
    ("training", "dwa"): (100.0, 120.0, None),  # None counts as 200 s there
    ("training", LEARNED): (60.0, 70.0, 80.0),
    ("world_2", "dwa"): (20.0, 20.5, 21.0),
    ("world_2", LEARNED): (10.0, 10.5, 11.0),  # clearly better
    ("world_10", "dwa"): (20.0, 30.0, None),  # and as 50 s here
    ("world_10", LEARNED): (20.0, 30.0, None),  # the same
    ("world_30", "dwa"): (10.0, 10.0, 10.0),
    ("world_30", LEARNED): (12.0, 12.0, 12.0),  # clearly worse
}
ROWS = [trial(w, m, run, time) for (w, m), times in TIMES.items() for run, time in enumerate(times)]


@pytest.fixture
def make(tmp_path: Path) -> Callable[..., str]:
    """Writes rows to a new store and gives its path."""
    count = iter(range(100))

    def made(rows: Sequence[StoredTrial]) -> str:
        path = tmp_path / f"results{next(count)}.sqlite"
        with Store.open(path, write=True) as store:
            store.add(rows)
        return str(path)

    return made


@pytest.fixture
def policies(tmp_path: Path) -> Path:
    folder = tmp_path / "policies"
    folder.mkdir()
    (folder / f"{LEARNED}.safetensors").write_bytes(policy_bytes(POLICY))
    return folder


def report(results: str, out: Path | None = None, **options: object) -> int:
    arguments: dict[str, object] = {"policies": None, "worlds": None, "pick": "", "check": None, "update": None}
    return report_command(results, out, **(arguments | options))  # type: ignore[arg-type]


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


# --- numbers ---------------------------------------------------------------------------------------------------------


def test_the_courses_table_holds_what_a_hand_computes(make: Callable[..., str], tmp_path: Path) -> None:
    assert report(make(ROWS), tmp_path / "out") == 0
    default, learned = read_csv(tmp_path / "out" / "tables" / "courses-training.csv")
    assert float(default["time_mean"]) == 140.0  # of 100, 120 and 200
    assert float(default["time_sd"]) == pytest.approx(np.std([100, 120, 200], ddof=1))
    assert float(default["reached"]) == pytest.approx(200 / 3)
    assert default["p"] == ""
    assert (learned["time_mean"], learned["time_sd"], learned["ratio"]) == ("70", "10", "0.5")
    assert (learned["paper_time_mean"], learned["paper_time_sd"]) == ("70.6", "3.2")
    assert float(learned["paper_ratio"]) == pytest.approx(70.6 / 134.0)
    assert float(learned["p"]) == pytest.approx(
        2 * stats.t.sf(70 / np.sqrt((2800 + 100) / 3), 2.1427), rel=1e-4
    )  # Welch by hand
    text = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    line = "| A+B+c | APPLI (A+B) | 3 | 100.0 | 70.0 ± 10.0 | 0.50 | 0.145 | 70.6 ± 3.2 | 0.53 |"
    assert line in text


def test_table_iv_counts_the_worlds_that_are_worse(make: Callable[..., str], tmp_path: Path) -> None:
    assert report(make(ROWS), tmp_path / "out") == 0
    pairs = {(r["row"], r["column"]): r for r in read_csv(tmp_path / "out" / "tables" / "barn-pairs.csv")}
    assert float(pairs["dwa", LEARNED]["worse"]) == pytest.approx(100 / 3)  # world_2 alone
    assert float(pairs[LEARNED, "dwa"]["worse"]) == pytest.approx(100 / 3)  # world_30 alone
    assert {row["worlds"] for row in pairs.values()} == {"3"}
    assert pairs["dwa", LEARNED]["paper"] == str(TABLE_IV["dwa", LEARNED]) == "44"
    text = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    assert "| dwa | – | 33 |" in text


def test_methods_are_summed_up_over_worlds(make: Callable[..., str]) -> None:
    courses, barn = read_facts(make(ROWS)).experiments
    sheet = methods_sheet(barn)
    default = dict(zip((c.name for c in sheet.columns), sheet.rows[0], strict=True))
    assert default["time"] == pytest.approx((20.5 + 100 / 3 + 10.0) / 3)
    assert (default["trials"], default["worlds"], default["recoveries"]) == (9, 3, 1.0)
    assert default["timed_out"] == pytest.approx(100 / 9)
    assert default["time_reached"] == pytest.approx((61.5 + 50.0 + 30.0) / 8)
    assert barn.worlds == EVERY[1:]  # by number, not by letters
    assert courses.worlds == ("training",)


def test_the_papers_tables_are_typed_twice() -> None:
    assert (TABLE_IV["A", "dwa"], TABLE_IV["dwa", "A"], TABLE_IV["A+c", "dwa"]) == (50, 10, 4)
    assert (TABLE_IV["A+B+c", "dwa"], TABLE_IV["A+B", "A+B+c"], TABLE_IV["A+B+D+c", "A+B"]) == (3, 6, 33)
    assert sum(TABLE_IV.values()) == 362 + 180 + 168 + 112 + 71 + 27 + 28  # its rows
    assert COURSES["unseen"]["A+B+c"] == (59.0, 0.7)


def test_policies_add_table_i(make: Callable[..., str], policies: Path, tmp_path: Path) -> None:
    assert report(make(ROWS), tmp_path / "out", policies=policies) == 0
    rows = read_csv(tmp_path / "out" / "tables" / "parameters.csv")
    ours = {row["context"]: row for row in rows if row["source"] == "twin"}
    paper = {row["context"]: row for row in rows if row["source"] == "paper"}
    assert (ours["B1"]["max_vel_x"], paper["B1"]["max_vel_x"]) == ("1.23", "1.91")
    assert (ours["A1"]["loss_default"], ours["A1"]["loss_learned"], ours["A1"]["interventions"]) == ("12", "1.5", "2")
    assert set(paper) == {"A1", "A2", "B1", "B2", "D1", "D2"}
    (flat,) = read_csv(tmp_path / "out" / "tables" / "flatness.csv")  # of B1 nothing is known
    assert (flat["context"], flat["max_vel_x_low"], flat["max_vel_x_high"]) == ("A1", "0.25", "0.375")
    assert "0.25 – 0.375" in (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    assert (tmp_path / "out" / "figures" / "learning-fits.svg").is_file()
    assert "made by other code than this" in (tmp_path / "out" / "report.md").read_text(encoding="utf-8")  # no map


# --- unfinished ------------------------------------------------------------------------------------------------------


def test_an_unfinished_sweep_says_what_is_missing(make: Callable[..., str], tmp_path: Path) -> None:
    rows = [row for row in ROWS if row.key != "world_30|dwa|2"]
    failed = trial("world_10", "dwa", 3, None, status="error", error="Traceback\nZeroDivisionError: no", outcome=None)
    assert report(make([*rows, failed]), tmp_path / "out") == 0
    text = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    # run 3 is known from the failed trial, so that it is missing in all three worlds under both methods
    assert "Unfinished: 23 of 30 trials, 7 missing, 1 of them failed with an error." in text
    assert "Tested: 0 of 3 worlds, those where both methods have all 4 runs." in text
    assert "ZeroDivisionError: no" in text
    missing = read_csv(tmp_path / "out" / "tables" / "missing.csv")
    assert len(missing) == 7
    assert {"experiment": "barn", "world": "world_30", "method": "dwa", "seed": "0", "run": "2"} in missing


def test_tests_are_made_only_with_complete_worlds(make: Callable[..., str]) -> None:
    facts = read_facts(make([row for row in ROWS if row.key != "world_30|dwa|2"]))
    entry = Significance(facts.experiments[1]).entry(LEARNED, "dwa")
    assert entry is not None
    assert (entry.worlds, entry.worse) == (2, 0.0)
    incomplete = read_facts(make([row for row in ROWS if row.key != "training|dwa|2"])).experiments[0]
    assert np.isnan(dict(zip("abcdefghi", courses_sheet(incomplete, "training").rows[1], strict=True))["g"])


def test_what_is_missing_is_one_line_with_a_command(make: Callable[..., str], tmp_path: Path) -> None:
    assert report(make([row for row in ROWS if row.world == "world_2" and row.method == "dwa"]), tmp_path / "out") == 0
    text = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    assert "--worlds training,unseen --runs 20" in text
    assert "add --policies DIR" in text
    assert "No Table IV" in text


def test_results_in_several_files_are_one(make: Callable[..., str]) -> None:
    both = f"{make(ROWS[:10])},{make(ROWS[8:])}"  # two trials stand in both
    assert len(read_facts(both).rows) == len(ROWS)
    with pytest.raises(UserError, match="contradicts another results file in the trial training, dwa, run 0"):
        read_facts(f"{make(ROWS)},{make([replace(ROWS[0], time=1.0)])}")


def test_versions_are_not_mixed(make: Callable[..., str]) -> None:
    other = [replace(r, key=f"{r.key}!", code="beef" * 16, finished="2025-01-01T00:00:00.000+00:00") for r in ROWS]
    path = make([*ROWS, *other])
    with pytest.raises(UserError, match="pick one: newest, c0dec0de or beefbeef"):
        read_facts(path)
    facts = read_facts(path, "newest")
    assert (facts.code[:4], facts.set_aside, len(facts.rows)) == ("c0de", len(ROWS), len(ROWS))


# --- the page --------------------------------------------------------------------------------------------------------


def test_the_page_loads_nothing_and_runs_nothing(make: Callable[..., str], policies: Path, tmp_path: Path) -> None:
    evil = "<script src=https://example.org/x.js></script>|`$_{x}"
    rows = [*ROWS, *(trial("world_2", evil, run, 9.0, policy="p") for run in range(3))]
    assert report(make(rows), tmp_path / "out", policies=policies) == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "<script" not in page.lower()
    assert not re.findall(
        r"""(?:src|href|data|action)\s*=\s*["']?(?!#)[^"'>\s]*:""", re.sub(r"&[lg]t;.*?&gt;", "", page)
    )
    assert not re.findall(r"url\((?!#)", page)
    assert "@import" not in page
    assert re.search(r"""Content-Security-Policy" content="default-src 'none'""", page)
    targets = set(re.findall(r'\bid="([^"]+)"', page))
    assert len(targets) == len(re.findall(r'\bid="([^"]+)"', page))  # no two parts share a name
    assert set(re.findall(r'href="#([^"]+)"', page)) <= targets
    assert page.count("<svg") >= 5
    assert len(page) < 3_000_000


def test_equal_stores_give_equal_reports(make: Callable[..., str], tmp_path: Path) -> None:
    path = make(ROWS)
    report(path, tmp_path / "a")
    report(path, tmp_path / "b")
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file())
    assert len(files) > 10
    assert all((tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files)


def test_labels_keep_their_distance() -> None:
    places = spread([0.9, 0.5, 0.49, 0.48, 0.1], 0.1)
    assert places == pytest.approx([0.9, 0.59, 0.49, 0.39, 0.1])
    assert spread([0.5], 0.1) == [0.5]


# --- README tables ---------------------------------------------------------------------------------------------------

README = (
    "# Title\n\n<!-- table: courses -->\nold\n<!-- end -->\nprose\n<!-- table: barn-significance -->\n<!-- end -->\n"
)


def test_readme_tables_are_rewritten_and_checked(
    make: Callable[..., str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, readme = make(ROWS), tmp_path / "README.md"
    readme.write_text(README, encoding="utf-8")
    assert report(path, check=readme) == 1
    assert report(path, update=readme) == 0
    text = readme.read_text(encoding="utf-8")
    assert "| training | A+B+c | APPLI (A+B) | 3 | 100.0 | 70.0 ± 10.0 | 0.50 |" in text
    assert "| dwa | – | 33 (44) |" in text
    assert text.startswith("# Title\n\n<!-- table: courses -->\n|")
    assert "\n<!-- end -->\nprose\n<!-- table" in text
    assert report(path, check=readme) == 0
    readme.write_text(text.replace("70.0 ± 10.0", "69.9 ± 10.0"), encoding="utf-8")
    capsys.readouterr()
    assert report(path, check=readme) == 1
    said = capsys.readouterr().out
    assert "table courses: training, A+B+c, APPLI (A+B), time [s]: 69.9 ± 10.0, in the store 70.0 ± 10.0" in said
    assert "1 differences" in said
    for wrong in (
        text.replace("| A+B+c | APPLI (A+B) |", "| A+B+C | APPLI (A+B) |"),
        text.replace("| 3 |", "| 3 | 4 |", 1),
    ):
        assert wrong != text
        readme.write_text(wrong, encoding="utf-8")
        assert report(path, check=readme) == 1


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("nothing", "has no <!-- table: NAME -->"),
        ("<!-- table: courses -->\n", "has no <!-- end -->"),
        ("<!-- table: courses -->\n<!-- table: courses -->\n<!-- end -->", "has no <!-- end -->"),
        ("<!-- table: speed -->\n<!-- end -->", "there is no table speed"),
    ],
)
def test_wrong_marks_are_one_line(make: Callable[..., str], tmp_path: Path, text: str, complaint: str) -> None:
    readme = tmp_path / "README.md"
    readme.write_text(text, encoding="utf-8")
    for option in ("check", "update"):
        with pytest.raises(UserError, match=complaint):
            report(make(ROWS), **{option: readme})
    assert readme.read_text(encoding="utf-8") == text


def test_cells_with_bars_stay_cells() -> None:
    sheet = Sheet(
        "x",
        "",
        (Column("a", "a|b"), Column("t", "t [s]", SPREAD), Column("n", "n", ONE)),
        (("c|d", (1.0, float("nan")), None),),
    )
    assert sheet.markdown() == "| a\\|b | t [s] | n |\n| --- | ---: | ---: |\n| c\\|d | 1.0 | – |"
    assert sheet.csv() == "a,t_mean,t_sd,n\nc|d,1,,\n"


# --- mistakes --------------------------------------------------------------------------------------------------------


def test_empty_stores_are_refused(make: Callable[..., str], tmp_path: Path) -> None:
    with pytest.raises(UserError, match="holds no finished trials; make some with: appli sweep"):
        report(make([]), tmp_path / "out")
    with pytest.raises(UserError, match=r"holds no finished trials \(1 failed\)"):
        report(make([trial("world_2", "dwa", 0, None, status="error")]), tmp_path / "out")
    with pytest.raises(UserError, match="does not exist"):
        report(str(tmp_path / "none.sqlite"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_corrupt_stores_are_refused(make: Callable[..., str], tmp_path: Path) -> None:
    path = Path(make(ROWS))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(UserError, match="damaged"):
        report(str(path), tmp_path / "out")
    path.write_bytes(b"not a database")
    with pytest.raises(UserError, match="not a results file"):
        report(f"{make(ROWS)},{path}", tmp_path / "out")
    with pytest.raises(UserError, match="no penalty is known for the protocol other"):
        report(make([replace(ROWS[0], protocol="other")]), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_foreign_policies_are_refused(make: Callable[..., str], policies: Path, tmp_path: Path) -> None:
    path, file = make(ROWS), policies / f"{LEARNED}.safetensors"
    with pytest.raises(UserError, match="is not a folder; give the folder"):
        report(path, tmp_path / "out", policies=tmp_path / "none")
    with pytest.raises(UserError, match=r"has no \*.safetensors"):
        report(path, tmp_path / "out", policies=tmp_path)
    shutil.copy(file, policies / "A.safetensors")
    file.unlink()
    with pytest.raises(UserError, match=r"has none of the policies A\+B\+c"):
        report(path, tmp_path / "out", policies=policies)
    file.write_bytes(policy_bytes(replace(POLICY, eps_u=0.5)))
    with pytest.raises(UserError, match=r"is not the policy that the trials of A\+B\+c were driven with"):
        report(path, tmp_path / "out", policies=policies)
    file.write_bytes(b"junk")
    with pytest.raises(UserError, match="not a policy"):
        report(path, tmp_path / "out", policies=policies)
    assert not (tmp_path / "out").exists()


def test_something_must_be_asked_for(make: Callable[..., str], tmp_path: Path) -> None:
    with pytest.raises(UserError, match="needs --out DIR"):
        report(make(ROWS))
    with pytest.raises(UserError, match="is not a folder"):
        report(make(ROWS), Path(make(ROWS)))
    with pytest.raises(UserError, match="no blank ones"):
        report(f"{make(ROWS)},", tmp_path / "out")
