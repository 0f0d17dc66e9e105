"""Laws of driving with a policy: threshold, mode filter, faults, gate."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.classifier import EvidentialClassifier, Judgement
from learning.deploy import AppliDriver, AppliMemory, mode, path_bearing
from learning.policy import Context, Policy, PolicySwitches
from tests.learning.classifiers import FAR, NEAR, range_classifier, scan_at
from tests.learning.observations import slalom_drive
from twin.planner.move_base import Memory, MoveBase, MoveBaseDriver, MoveBaseSettings
from twin.planner.params import PlannerParams
from twin.planner.plan import PlannerSettings
from twin.records import DEFAULT_CONTEXT, STOP, Array, Decision, Observation, Pose2, frozen_array

CONTEXTS = (Context(NEAR, PlannerParams(max_vel_x=0.2)), Context(FAR, PlannerParams(max_vel_x=1.8)))
POLICY = Policy(CONTEXTS, range_classifier(), window=1)
THETAS = {DEFAULT_CONTEXT: PlannerParams(), NEAR: CONTEXTS[0].theta, FAR: CONTEXTS[1].theta}
DISTANCES = st.lists(st.sampled_from([0.5, 1.5, 2.4, 2.6, 3.5, 4.5]), min_size=1, max_size=12)  # [m]


@dataclass(frozen=True, slots=True)
class Parked(MoveBase):
    """A move_base that stands still: for tests of what surrounds it."""

    def step(self, x: Observation, theta: PlannerParams, memory: Memory) -> tuple[Decision, Memory]:
        return Decision(STOP, theta), memory


def seen(ranges: Array) -> Observation:
    """An observation with this scan."""
    x = slalom_drive(PlannerParams(), 1)[0].observation
    return replace(x, scan=replace(x.scan, ranges=frozen_array(np.array(ranges, dtype=np.float64))))


def drive(policy: Policy, scans: list[Array], memory: AppliMemory | None = None) -> tuple[list[Decision], AppliMemory]:
    """What a parked robot decides while it sees these scans."""
    driver = AppliDriver(policy, Parked())
    memory = driver.start() if memory is None else memory
    decisions = []
    for ranges in scans:
        decision, memory = driver.decide(seen(ranges), memory)
        decisions.append(decision)
    return decisions, memory


def contexts(policy: Policy, distances: list[float]) -> list[str]:
    """The contexts in force while the robot sees scans at these distances."""
    return [decision.context for decision in drive(policy, [scan_at(d) for d in distances])[0]]


# --- the confidence gate ---------------------------------------------------------------------------------------------


@given(DISTANCES)
@settings(deadline=None, max_examples=30)
def test_threshold_zero_never_selects_the_default_and_one_above_one_always_does(distances: list[float]) -> None:
    assert DEFAULT_CONTEXT not in contexts(replace(POLICY, eps_u=0.0), distances)
    assert set(contexts(replace(POLICY, eps_u=1.01), distances)) == {DEFAULT_CONTEXT}


@given(DISTANCES, st.integers(1, 5))
@settings(deadline=None, max_examples=30)
def test_without_confidence_never_the_default_whatever_the_threshold(distances: list[float], window: int) -> None:
    policy = replace(POLICY, use_confidence=False, eps_u=1.01, window=window)
    assert DEFAULT_CONTEXT not in contexts(policy, distances)
    assert contexts(policy, distances) == contexts(replace(policy, use_confidence=True, eps_u=0.0), distances)


def test_confident_scans_select_their_context_and_its_parameters() -> None:
    decisions, memory = drive(POLICY, [scan_at(d) for d in (0.5, 2.5, 4.5)])
    assert [d.context for d in decisions] == [NEAR, DEFAULT_CONTEXT, FAR]
    assert [d.theta for d in decisions] == [THETAS[NEAR], THETAS[DEFAULT_CONTEXT], THETAS[FAR]]
    values = [d.confidence for d in decisions]
    assert values[0] is not None
    assert values[0] > 0.9
    assert values[1] is not None
    assert values[1] < 0.1
    assert memory.faults == 0


def test_confidence_shown_is_that_of_the_scan_alone() -> None:
    classifier = range_classifier()
    distances = [0.5, 2.4, 4.5, 1.8]
    decisions, _ = drive(replace(POLICY, window=9), [scan_at(d) for d in distances])
    for distance, decision in zip(distances, decisions, strict=True):
        judgement = classifier.judge(scan_at(distance))
        assert judgement is not None
        assert decision.confidence == judgement.confidence


# --- the mode filter -------------------------------------------------------------------------------------------------


@given(DISTANCES)
@settings(deadline=None, max_examples=30)
def test_a_window_of_one_is_no_filter(distances: list[float]) -> None:
    driver = AppliDriver(POLICY, Parked())
    alone = [driver.believe(seen(scan_at(d)), None).context for d in distances]
    assert contexts(POLICY, distances) == alone


LABELS = st.sampled_from([DEFAULT_CONTEXT, NEAR, FAR])


@given(st.lists(LABELS, min_size=1, max_size=9), LABELS)
def test_mode_is_a_most_frequent_entry_and_ties_keep_the_current_one(recent: list[str], current: str) -> None:
    chosen = mode(tuple(recent), current)
    counts = {label: recent.count(label) for label in (DEFAULT_CONTEXT, NEAR, FAR)}
    assert counts[chosen] == max(counts.values())
    if counts[current] == max(counts.values()):
        assert chosen == current


def test_a_tie_of_others_goes_to_the_latest() -> None:
    assert mode((NEAR, FAR), DEFAULT_CONTEXT) == FAR
    assert mode((FAR, NEAR), DEFAULT_CONTEXT) == NEAR


def test_a_single_other_scan_does_not_change_the_context() -> None:
    assert contexts(replace(POLICY, window=5), [0.5] * 5 + [4.5] + [0.5] * 4) == [NEAR] * 10


def test_a_new_context_needs_more_than_half_the_window() -> None:
    policy = replace(POLICY, window=4)
    # Two against two keeps the current one.
    assert contexts(policy, [0.5] * 4 + [4.5] * 4) == [NEAR] * 6 + [FAR] * 2


def test_before_the_window_is_full_the_mode_is_of_what_there_is() -> None:
    assert contexts(replace(POLICY, window=100), [4.5, 0.5, 0.5]) == [FAR, FAR, NEAR]


@given(DISTANCES, st.integers(1, 5))
@settings(deadline=None, max_examples=30)
def test_memory_never_grows_beyond_the_window(distances: list[float], window: int) -> None:
    _, memory = drive(replace(POLICY, window=window), [scan_at(d) for d in distances])
    assert len(memory.recent) == min(window, len(distances))


@given(DISTANCES, st.integers(1, 5), st.integers(0, 11))
@settings(deadline=None, max_examples=30)
def test_equal_inputs_give_equal_outputs_also_from_the_middle(distances: list[float], window: int, cut: int) -> None:
    policy, scans = replace(POLICY, window=window), [scan_at(d) for d in distances]
    whole, end = drive(policy, scans)
    _, middle = drive(policy, scans[:cut])
    kept = repr(middle)
    rest, again = drive(policy, scans[cut:], middle)
    assert rest == whole[cut:]
    assert again == end
    assert repr(middle) == kept


# --- few contexts, and faults ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("use_confidence", [True, False])
def test_one_context_without_a_classifier_is_always_in_force_and_none_is_the_default(use_confidence: bool) -> None:
    one = Policy(CONTEXTS[:1], window=3, use_confidence=use_confidence)
    decisions, _ = drive(one, [scan_at(0.5), scan_at(np.inf)])
    assert [(d.context, d.theta, d.confidence) for d in decisions] == [(NEAR, CONTEXTS[0].theta, None)] * 2
    none = Policy((), use_confidence=use_confidence)
    assert contexts(none, [0.5, 4.5]) == [DEFAULT_CONTEXT] * 2


@pytest.mark.parametrize("use_confidence", [True, False])
@pytest.mark.parametrize("bad", [np.inf, np.nan, -np.inf])
def test_scans_that_cannot_be_judged_fall_back_and_are_counted(bad: float, use_confidence: bool) -> None:
    policy = replace(POLICY, use_confidence=use_confidence)
    decisions, memory = drive(policy, [scan_at(0.5), scan_at(bad), scan_at(4.5), scan_at(bad)])
    assert [d.context for d in decisions] == [NEAR, DEFAULT_CONTEXT, FAR, DEFAULT_CONTEXT]
    assert [d.confidence for d in decisions][1::2] == [0.0, 0.0]
    assert memory.faults == 2


@pytest.mark.parametrize("failure", [ValueError("broken"), FloatingPointError("broken"), RuntimeError("broken")])
def test_a_failing_classifier_falls_back_and_is_counted(failure: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: EvidentialClassifier, __: Array) -> Judgement | None:
        raise failure

    monkeypatch.setattr(EvidentialClassifier, "judge", fail)
    decisions, memory = drive(POLICY, [scan_at(0.5)] * 3)
    assert {d.context for d in decisions} == {DEFAULT_CONTEXT}
    assert memory.faults == 3


def test_a_few_bad_beams_are_no_fault() -> None:
    ranges = scan_at(0.5)
    ranges[::10] = np.nan
    decisions, memory = drive(POLICY, [ranges])
    assert decisions[0].context == NEAR
    assert memory.faults == 0


def test_scans_of_another_size_are_an_error_not_a_fault() -> None:
    with pytest.raises(ValueError, match=r"720 beams; this scan has 360$"):
        drive(POLICY, [np.ones(360)])


# --- the path-bearing gate -------------------------------------------------------------------------------------------


def straight(bearing: float, length: float = 2.0) -> Array:
    """A path (n, 3) from the origin in one direction [rad], odom."""
    s = np.arange(0.0, length, 0.05)
    return np.column_stack([s * math.cos(bearing), s * math.sin(bearing), np.full(len(s), bearing)])


@given(st.floats(-3.1, 3.1), st.floats(-3.1, 3.1), st.floats(0.3, 3.0))
def test_bearing_of_a_straight_path(bearing: float, yaw: float, length: float) -> None:
    expected = math.remainder(bearing - yaw, math.tau)
    found = path_bearing(straight(bearing, length), Pose2(0.0, 0.0, yaw))
    assert math.remainder(found - expected, math.tau) == pytest.approx(0.0, abs=1e-9)


def test_bearing_looks_at_the_first_metre_only() -> None:
    s = np.arange(0.0, 1.01, 0.05)
    ahead = np.column_stack([s, np.zeros_like(s), np.zeros_like(s)])
    then_left = np.column_stack([np.ones(40), np.linspace(0.05, 2.0, 40), np.full(40, math.pi / 2)])
    assert path_bearing(np.concatenate([ahead, then_left]), Pose2(0.0, 0.0, 0.0)) == pytest.approx(0.0, abs=1e-9)
    assert path_bearing(straight(0.4)[:1], Pose2(-1.0, 0.0, 0.0)) == pytest.approx(0.0)  # a path of one point


@pytest.mark.parametrize(("degrees", "gated"), [(0, False), (59, False), (61, True), (-61, True), (180, True)])
def test_gate_closes_at_sixty_degrees(degrees: float, gated: bool) -> None:
    x = seen(scan_at(0.5))
    path = straight(x.pose.yaw + math.radians(degrees)) + np.array([x.pose.x, x.pose.y, 0.0])
    policy = replace(POLICY, switches=PolicySwitches(path_gate=True))
    belief = AppliDriver(policy, Parked()).believe(x, path)
    assert (belief.context, belief.confidence == 0.0) == ((DEFAULT_CONTEXT, True) if gated else (NEAR, False))
    assert not belief.fault
    assert AppliDriver(POLICY, Parked()).believe(x, path).context == NEAR  # the gate is off by default
    assert AppliDriver(policy, Parked()).believe(x, None).context == NEAR  # no path yet: open
    always = replace(policy, use_confidence=False)
    assert AppliDriver(always, Parked()).believe(x, path).context == NEAR


# --- with the real move_base -----------------------------------------------------------------------------------------


def run(driver: AppliDriver | MoveBaseDriver) -> list[tuple[object, ...]]:
    """Commands of a driver on recorded observations."""
    memory, answers = driver.start(), []
    for tick in slalom_drive(PlannerParams(), 30):
        decision, memory = driver.decide(tick.observation, memory)  # type: ignore[arg-type]
        answers.append((decision.command, decision.theta, decision.state))
    return answers


def test_without_contexts_it_is_the_default_move_base() -> None:
    assert run(AppliDriver(Policy(()))) == run(MoveBaseDriver())


def test_with_one_context_it_is_move_base_under_its_parameters() -> None:
    theta = PlannerParams(max_vel_x=0.9, occdist_scale=0.02)
    assert run(AppliDriver(Policy((Context("B1", theta),)))) == run(MoveBaseDriver(theta))


def test_the_policys_switches_are_in_force() -> None:
    policy = replace(POLICY, switches=PolicySwitches(inflation="local", couple_min_vel_theta=True))
    base = MoveBase(MoveBaseSettings(PlannerSettings(), clearing_works=True), explain=True)
    driver = AppliDriver(policy, base)
    assert driver.base.settings.planner.inflation == "local"
    assert driver.base.settings.planner.couple_min_vel_theta
    assert driver.base.settings.clearing_works
    assert driver.base.explain


def test_changing_parameters_forgets_that_the_goal_was_reached() -> None:
    start = AppliDriver(POLICY, Parked()).start()
    controller = replace(start.base.plan.controller, reached_goal=True)
    arrived = replace(start, base=replace(start.base, plan=replace(start.base.plan, controller=controller)))
    _, after = drive(POLICY, [scan_at(2.5)], arrived)  # default as before: nothing is reconfigured
    assert after.base.plan.controller.reached_goal
    _, after = drive(POLICY, [scan_at(0.5)], arrived)
    assert not after.base.plan.controller.reached_goal
