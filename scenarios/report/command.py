"""`appli report`: from results files to tables, figures and a page; and README tables that agree with them."""

from __future__ import annotations

import functools
import os
import sys
from pathlib import Path

from scenarios.errors import UserError, blame
from scenarios.report import readme
from scenarios.report.difficulty import measure
from scenarios.report.document import Report
from scenarios.report.facts import read_facts
from scenarios.report.markdown import figures, to_markdown
from scenarios.report.page import to_html
from scenarios.report.policies import read_policies
from scenarios.report.sections import Material, make_report

KNOWN_WITHOUT_FILES = "barn-like"


def report_command(
    results: str,
    out: Path | None,
    policies: Path | None,
    worlds: str | None,
    pick: str,
    check: Path | None,
    update: Path | None,
) -> int:
    """Exit code 0, or 1 when the README's tables differ from the store."""
    if out is check is update is None:
        raise UserError("report needs --out DIR, --check README.md or --update README.md")
    if out is not None and out.exists() and not out.is_dir():
        raise UserError(f"{out} is not a folder; give another --out")
    say = functools.partial(print, "appli report:", file=sys.stderr, flush=True)
    facts = read_facts(results, pick)
    files = {} if policies is None else read_policies(policies, facts)
    known = {
        e.key: measure(e, worlds or "")
        for e in facts.experiments
        if not e.is_courses and (worlds or e.key.startswith(KNOWN_WITHOUT_FILES))
    }
    report = make_report(Material(facts, files, known), draw=out is not None, say=say)
    if update is not None:
        _update(update, report)
    differs = _check(check, report) if check is not None else False
    if out is not None:
        _write(out, report)
        print(f"{report.status}\nopen {out / 'report.html'}")
    return 1 if differs else 0


def _write(out: Path, report: Report) -> None:
    """All files; every one is replaced at once or not at all."""
    contents = {"report.md": to_markdown(report), "report.html": to_html(report)}
    contents |= {f"tables/{_file_name(name)}.csv": sheet.csv() for name, sheet in report.sheets().items()}
    contents |= {f"figures/{_file_name(name)}": text for name, text in figures(report).items()}
    with blame(f"cannot write to {out}"):
        for folder in (out / "tables", out / "figures"):
            folder.mkdir(parents=True, exist_ok=True)
        for name, text in contents.items():
            _replace(out / name, text)


def _file_name(name: str) -> str:
    """Names of worlds come from files; a slash in one must not lead elsewhere."""
    return name.replace("/", "-").replace("\0", "-")


def _replace(path: Path, text: str) -> None:
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def _check(path: Path, report: Report) -> bool:
    """Say what differs, on stdout."""
    lines = readme.differences(path, readme.read(path), report.sheets())
    print("\n".join(lines) if lines else f"{path}: its tables agree with the store")
    if lines:
        print(f"{len(lines)} differences; rewrite the tables with: appli report ... --update {path}")
    return bool(lines)


def _update(path: Path, report: Report) -> None:
    before = readme.read(path)
    after = readme.updated(path, before, report.sheets())
    if after != before:
        with blame(f"cannot write {path}"):
            _replace(path, after)
    print(f"{path}: {'tables rewritten' if after != before else 'its tables agree with the store already'}")
