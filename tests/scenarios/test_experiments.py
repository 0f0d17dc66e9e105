"""The estimate of `make experiments`: what is done does not count again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from scenarios.errors import UserError
from scenarios.experiments import BARN_TRIAL, steps
from scenarios.identity import code_digest
from scenarios.store import Store
from tests.scenarios.test_store import DONE


def test_the_papers_numbers_of_trials(tmp_path: Path) -> None:
    sessions, training, courses, barn = steps(tmp_path, "barn-like", ["0", "1"], cost=0.5)
    assert (sessions.total, training.total, courses.total, barn.total) == (2, 1, 280, 25_200)
    assert not any(step.done for step in (sessions, training, courses, barn))
    assert barn.seconds == 0.5 * BARN_TRIAL
    assert steps(tmp_path, "barn-like/0-9", [], 1.0)[3].total == 840


def test_what_is_done_is_seen(tmp_path: Path) -> None:
    (tmp_path / "sessions").mkdir()
    (tmp_path / "sessions" / "1").touch()
    with Store.open(tmp_path / "courses.sqlite", write=True) as store:
        store.add([replace(DONE, code=code_digest()), replace(DONE, key="older", code="of before")])
    assert [step.done for step in steps(tmp_path, "barn-like", ["0", "1"], 1.0)] == [1, 0, 1, 0]


def test_unknown_worlds_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="does not exist"):
        steps(tmp_path, "none.npz", [], 1.0)
