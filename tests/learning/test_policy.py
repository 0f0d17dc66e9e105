"""The policy file: what goes in comes out, and nothing else is accepted."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.policy import Context, Policy, PolicyError, PolicySwitches, Provenance
from learning.policy_file import load_policy, parse_policy, policy_bytes, save_policy
from tests.learning.classifiers import random_classifier
from twin.planner.move_base import MoveBaseSettings
from twin.planner.params import PlannerParams

CLASSIFIER = random_classifier(contexts=3)
POLICY = Policy(
    tuple(Context(label, PlannerParams(max_vel_x=0.3 + k / 3)) for k, label in enumerate(CLASSIFIER.labels)),
    CLASSIFIER,
    eps_u=0.75,
    window=7,
    switches=PolicySwitches(path_gate=True, inflation="local", couple_min_vel_theta=True),
    provenance=Provenance(
        {"0a1b": "C0"},
        {"C0": (12.5, 0.1)},
        {"C0": (0.05, 0.2)},
        {"C0": {"max_vel_x": (0.4, 0.5)}},
        {"C0": [(12.0, 3.5), (24.0, 0.1)], "classifier": [(100.0, 0.7)]},
        {"accuracy": 0.95},
        {"torch": "2"},
        "A,B",
        3,
    ),
)
EMPTY = Policy(())


def metadata_of(data: bytes) -> dict[str, Any]:
    """The JSON in a policy's header."""
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    values: dict[str, Any] = json.loads(header["__metadata__"]["appli"])
    return values


def with_metadata(text: str) -> bytes:
    """POLICY's weights under other metadata."""
    return bytes(safetensors.numpy.save(CLASSIFIER.weights, {"appli": text}))


def changed(change: Callable[[dict[str, Any]], Any]) -> bytes:
    """POLICY's file after a change of its metadata."""
    values = metadata_of(policy_bytes(POLICY))
    change(values)
    return with_metadata(json.dumps(values))


# --- what goes in comes out ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("policy", [POLICY, EMPTY, Policy((Context("A1", PlannerParams()),), use_confidence=False)])
def test_round_trip_is_byte_equal(policy: Policy, tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    save_policy(policy, path)
    loaded = load_policy(path)
    assert policy_bytes(loaded) == path.read_bytes() == policy_bytes(policy)
    assert replace(loaded, classifier=None, contexts=()).provenance == policy.provenance
    assert (loaded.contexts, loaded.default, loaded.eps_u, loaded.window) == (
        policy.contexts,
        policy.default,
        policy.eps_u,
        policy.window,
    )
    assert (loaded.use_confidence, loaded.switches) == (policy.use_confidence, policy.switches)
    if policy.classifier is not None:
        assert loaded.classifier is not None
        scan = np.linspace(0.3, 6.0, 720)
        ours, theirs = policy.classifier.judge(scan), loaded.classifier.judge(scan)
        assert ours is not None
        assert theirs is not None
        assert ours.alpha.tobytes() == theirs.alpha.tobytes()


def test_the_file_is_small_and_an_ordinary_one(tmp_path: Path) -> None:
    path = tmp_path / "p.safetensors"
    save_policy(POLICY, path)
    assert path.stat().st_size < 2 * 2**20
    (tmp_path / "plain").write_bytes(b"")
    assert path.stat().st_mode == (tmp_path / "plain").stat().st_mode
    assert sorted(p.name for p in tmp_path.iterdir()) == ["p.safetensors", "plain"]


def test_a_failed_save_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "p.safetensors"
    save_policy(EMPTY, path)
    before = path.read_bytes()

    def fail(*_: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr("learning.policy_file.os.replace", fail)
    with pytest.raises(OSError, match="no space"):
        save_policy(POLICY, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["p.safetensors"]


def test_m_of_a_context() -> None:
    assert POLICY.theta("C1").max_vel_x == pytest.approx(0.3 + 1 / 3)
    assert POLICY.theta("default") == PlannerParams()


def test_switches_reach_the_planner_and_nothing_else_changes() -> None:
    base = MoveBaseSettings(clearing_works=True)
    local = replace(base.planner.local, meter_scoring_factor=0.05)
    base = replace(base, planner=replace(base.planner, local=local))
    settings_ = POLICY.settings(base)
    assert (settings_.planner.inflation, settings_.planner.couple_min_vel_theta) == ("local", True)
    assert settings_.clearing_works
    assert settings_.planner.local == local


# --- nothing else is accepted ----------------------------------------------------------------------------------------


def refuse(path: Path, data: bytes, words: str) -> None:
    """Loading must fail with one line that names the file and holds the words."""
    path.write_bytes(data)
    with pytest.raises(PolicyError, match=words) as caught:
        load_policy(path)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(str(path))


@pytest.mark.parametrize("kept", [0, 1, 7, 8, 9, 100, 1000, 100_000, -4096, -1])
def test_truncated_files(kept: int, tmp_path: Path) -> None:
    refuse(tmp_path / "p.safetensors", policy_bytes(POLICY)[:kept], "not a policy, or a truncated one")


def test_foreign_files(tmp_path: Path) -> None:
    path = tmp_path / "p.safetensors"
    for data in (
        b"max_vel_x: 0.5\n",
        pickle.dumps({"kernel": 1}),
        b"\xff" * 64,
        (2**63).to_bytes(8, "little") + b"{}",
    ):
        refuse(path, data, "not a policy")
    refuse(path, safetensors.numpy.save({"a": np.ones(3)}), "safetensors file, but not a policy")
    refuse(path, safetensors.numpy.save({}, {"appli": "{}"}), "damaged policy")
    refuse(path, safetensors.numpy.save({}, {"appli": '{"kind": "other"}'}), "not a policy")


def test_missing_files_and_folders(tmp_path: Path) -> None:
    for path in (tmp_path / "none.safetensors", tmp_path):
        with pytest.raises(PolicyError, match=str(path)):
            load_policy(path)


def test_too_large_files_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "p.safetensors"
    with path.open("wb") as file:
        file.truncate(2**33)
    with pytest.raises(PolicyError, match="larger than"):
        load_policy(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"schema": 2}, "newer version"),
        ({"schema": 0}, "train it again"),
        ({"schema": True}, "whole number"),
        ({"robot": "husky"}, "robot 'husky'"),
        ({"beams": 1081}, "1081 beams"),
        ({"contexts": 5}, "'contexts'"),
        ({"contexts": []}, "classifier knows"),
        ({"contexts": ["A1"]}, "not a JSON object"),
        ({"default": {}}, "must hold max_vel_x"),
        ({"eps_u": "0.8"}, "'eps_u'"),
        ({"eps_u": -0.1}, "eps_u must be"),
        ({"eps_u": 10**400}, "finite"),
        ({"window": 0}, "window"),
        ({"window": 2.5}, "whole number"),
        ({"window": 10**9}, "window"),
        ({"use_confidence": 1}, "true or false"),
        ({"switches": None}, "'switches'"),
        ({"switches": {"path_gate": True, "inflation": "none", "couple_min_vel_theta": True}}, "inflation"),
        ({"provenance": []}, "'provenance'"),
        ({"classifier": None}, "weights without a classifier"),
        ({"classifier": ["C0", "C1"]}, "shape"),
        ({"classifier": ["C0", "C0", "C1"]}, "two or more different"),
        ({"classifier": ["C0", "C1", 3]}, "names"),
        ({"classifier": ["X", "Y", "Z"]}, "the classifier knows"),
    ],
    ids=str,
)
def test_hostile_metadata(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    refuse(tmp_path / "p.safetensors", changed(lambda values: values.update(change)), words)


def test_hostile_parameters(tmp_path: Path) -> None:
    path = tmp_path / "p.safetensors"
    for value in (True, "fast", None, -1.0, 1e9, 10**400, [0.5]):
        refuse(path, changed(lambda values, v=value: values["contexts"][0]["theta"].update(max_vel_x=v)), "max_vel_x")
    for text in ('{"kind": NaN}', "[" * 100_000, "nothing", '"text"', "[]"):
        refuse(path, with_metadata(text), "damaged policy")
    for label in ("", "default", "a\nb", "x" * 65):
        refuse(path, changed(lambda values, v=label: values["contexts"][0].update(label=v)), "cannot be called")


def test_hostile_weights(tmp_path: Path) -> None:
    path = tmp_path / "p.safetensors"
    text = {"appli": json.dumps(metadata_of(policy_bytes(POLICY)))}
    good = CLASSIFIER.weights
    for weights, words in (
        ({**good, "kernel": np.full_like(good["kernel"], np.inf)}, "finite"),
        ({**good, "kernel": good["kernel"].astype(np.float16)}, "float32"),
        ({**good, "kernel": good["kernel"].T.copy()}, "shape"),
        ({k: v for k, v in good.items() if k != "output"}, "missing"),
        ({**good, "other": good["kernel"]}, "unknown"),
    ):
        refuse(path, safetensors.numpy.save(weights, text), words)


def accepted_or_refused(data: bytes) -> None:
    """Either a whole policy comes out, or one line; nothing else is ever raised."""
    error: PolicyError | None = None
    try:
        policy_bytes(parse_policy(data))
    except PolicyError as caught:
        error = caught
    assert error is None or "\n" not in str(error)


LEAVES = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False), st.text(max_size=5))
ANYTHING = st.recursive(LEAVES, lambda x: st.lists(x, max_size=2) | st.dictionaries(st.text(max_size=4), x, max_size=2))


@settings(deadline=None, max_examples=150)
@given(st.data())
def test_any_change_of_the_metadata_loads_or_is_refused(data: st.DataObject) -> None:
    values = metadata_of(policy_bytes(POLICY))
    place = values
    while True:  # somewhere in the tree, something else
        key = data.draw(st.sampled_from(sorted(place)))
        if isinstance(place[key], dict) and place[key] and data.draw(st.booleans()):
            place = place[key]
            continue
        place[key] = data.draw(ANYTHING)
        break
    accepted_or_refused(with_metadata(json.dumps(values)))


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 3000), st.integers(0, 255))
def test_any_changed_byte_of_the_header_loads_or_is_refused(position: int, value: int) -> None:
    data = bytearray(policy_bytes(POLICY))
    data[position] = value
    accepted_or_refused(bytes(data))


def test_parts_that_do_not_fit_together() -> None:
    with pytest.raises(PolicyError, match="need a classifier"):
        replace(POLICY, classifier=None)
    with pytest.raises(PolicyError, match="the classifier knows"):
        replace(POLICY, contexts=POLICY.contexts[:2])
    with pytest.raises(PolicyError, match="different names"):
        Policy((POLICY.contexts[0], POLICY.contexts[0]))
    with pytest.raises(PolicyError, match="eps_u"):
        replace(POLICY, eps_u=float("nan"))
