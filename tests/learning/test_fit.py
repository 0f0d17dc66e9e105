"""Laws of Eq. 1: the cached G is G, and what the fit promises."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from learning.fit import STARTS_APART, FitResult, FitSettings, _Fitting, fit
from learning.imitation import Imitation, LabelledSteps, surroundings
from learning.interventions import Intervention, Step
from learning.published import published_parameters
from learning.steps import pack
from tests.learning.observations import METADATA, SLALOM, slalom_drive
from twin.planner.move_base import MoveBaseDriver
from twin.planner.params import PARAMETER_NAMES, ParameterSpace, PlannerParams
from twin.planner.plan import Plan, PlannerSettings, plan
from twin.planner.trajectory import LocalPlannerSettings
from twin.records import STOP, Command, Observation, Pose2, Twist2, frozen_array
from twin.rollout import rollout
from twin.simulation import Simulation
from twin.world import Box, Cylinder, World

DEFAULT = PlannerParams()
QUICK = FitSettings(max_evaluations=36, restarts=0, max_steps=8)


def action(x: Observation, theta: PlannerParams, settings: PlannerSettings) -> tuple[float, float]:
    """G(x; theta) the plain way."""
    answer, _ = plan(x, theta, settings=settings)
    command = answer.command if isinstance(answer, Plan) else STOP
    return command.v, command.w


def seen(count: int) -> list[Observation]:
    """Some observations of a drive with the default parameters."""
    ticks = slalom_drive(DEFAULT, 160)
    return [ticks[k].observation for k in np.linspace(0, len(ticks) - 1, count).astype(int).tolist()]


def demonstrated(observations: list[Observation], theta: PlannerParams) -> Intervention:
    """An intervention in which theta itself acts."""
    times = [replace(x, time=0.05 * k) for k, x in enumerate(observations)]
    steps = [Step(x, Command(*action(x, theta, PlannerSettings()))) for x in times]
    return Intervention("B", "B1", steps, METADATA)


# ---- the cached G --------------------------------------------------------------------------------------------------


def odd_observations() -> list[Observation]:
    """What an ordinary drive does not have."""
    x = seen(3)[1]
    around = x.local_map.cells.copy()
    ny, nx = around.shape
    around[ny // 2 - 4 : ny // 2 + 5, nx // 2 - 4] = 254  # a wall under the robot's side: nothing is legal
    goal = Pose2(x.pose.x + 0.1, x.pose.y + 0.1, x.pose.yaw + 1.0)
    return [
        replace(x, local_map=replace(x.local_map, cells=frozen_array(around))),
        replace(x, goal=goal, twist=Twist2(0.3, 0.2)),  # at the goal, still moving
        replace(x, goal=goal, twist=Twist2(0.0, 0.0)),  # at the goal, turning
        replace(x, goal=replace(goal, yaw=x.pose.yaw)),  # there
        replace(x, goal=Pose2(30.0, 0.0, 0.0)),  # off the map
        replace(x, goal=Pose2(x.pose.x - 3.0, x.pose.y, 0.0)),  # behind
        replace(x, twist=Twist2(1.7, -1.2)),  # faster than most thetas allow
        replace(x, twist=Twist2(-0.4, 3.0)),  # backing up
    ]


def random_thetas(count: int, seed: int) -> list[PlannerParams]:
    rng, space = np.random.default_rng(seed), ParameterSpace()
    return [space.decode(rng.uniform(-0.05, 1.05, 8)) for _ in range(count)]


@pytest.mark.parametrize(
    "settings",
    [
        PlannerSettings(),
        PlannerSettings(inflation="local"),
        PlannerSettings(couple_min_vel_theta=True),
        PlannerSettings(local=LocalPlannerSettings(meter_scoring_factor=0.05)),
    ],
    ids=["plain", "local inflation", "coupled", "metres"],
)
def test_the_cached_g_is_g_bit_for_bit(settings: PlannerSettings) -> None:
    observations = [replace(x, time=0.05 * k) for k, x in enumerate(seen(9) + odd_observations())]
    imitation = Imitation(LabelledSteps.of([pack([Step(x, STOP) for x in observations])]), settings)
    few = [DEFAULT, PlannerParams(vx_samples=1, vtheta_samples=1), PlannerParams(vtheta_samples=2, max_vel_theta=6.0)]
    for theta in [*few, *published_parameters().values(), *random_thetas(8, len(repr(settings)))]:
        assert imitation.actions(theta).tolist() == [list(action(x, theta, settings)) for x in observations], theta


def test_actions_do_not_depend_on_what_was_asked_before() -> None:
    steps = LabelledSteps.of([demonstrated(seen(5), DEFAULT).packed])
    thetas = random_thetas(6, 3)
    one, other = Imitation(steps, PlannerSettings()), Imitation(steps, PlannerSettings())
    forth = [one.actions(t).tolist() for t in thetas]
    back = [other.actions(t).tolist() for t in reversed(thetas)]
    assert forth == back[::-1]


def test_surroundings_are_the_highest_byte_that_an_outline_may_meet() -> None:
    rng = np.random.default_rng(0)
    cells = rng.choice(np.array([0, 100, 253, 254], dtype=np.uint8), (30, 24), p=[0.97, 0.01, 0.01, 0.01])
    no_way = rng.random((30, 24)) < 0.1
    around = surroundings(cells, no_way, 5)
    for y in range(30):
        for x in range(24):
            inside = 5 <= y < 25 and 5 <= x < 19
            highest = cells[max(0, y - 5) : y + 6, max(0, x - 5) : x + 6].max() if inside else 254
            assert around[y, x] == (255 if no_way[y, x] else highest)


def test_labelled_steps_are_spread_and_divided_without_loss() -> None:
    parts = []
    for first, count in ((0, 7), (7, 1), (8, 12)):
        steps = list(demonstrated(seen(20)[first : first + count], DEFAULT).steps)
        parts.append(pack([replace(s, labelled=k % 3 != 2) for k, s in enumerate(steps)]))
    steps = LabelledSteps.of(parts)
    times = [(s.observation.time, s.action) for s in steps]
    assert len(steps) == len(times) == 5 + 1 + 8
    assert steps.actions.tolist() == [[a.v, a.w] for _, a in times]
    assert [(s.observation.time, s.action) for c in steps.chunks(4) for s in c] == times
    spread = [(s.observation.time, s.action) for s in steps.spread(5)]
    assert len(spread) == len(steps.spread(5)) == 5
    assert (spread[0], spread[-1]) == (times[0], times[-1])
    assert steps.spread(14) is steps


# ---- the fit -------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def quick_fit(seed: int = 0) -> FitResult:
    """A fit that is far from finished."""
    return fit(demonstrated(seen(10), published_parameters()["B2"]), replace(QUICK, seed=seed))


def test_equal_arguments_give_equal_fits_and_leave_numpys_generator_alone() -> None:
    before = np.random.get_state()[1].tolist()  # type: ignore[union-attr]  # noqa: NPY002
    one = fit(demonstrated(seen(10), published_parameters()["B2"]), QUICK)
    assert np.random.get_state()[1].tolist() == before  # type: ignore[union-attr]  # noqa: NPY002
    two = quick_fit()
    assert (one.theta, one.loss, one.flatness, one.evaluations) == (two.theta, two.loss, two.flatness, two.evaluations)
    assert one.curve.tobytes() == two.curve.tobytes()
    assert fit(demonstrated(seen(10), published_parameters()["B2"]), replace(QUICK, seed=1)).theta != one.theta


def test_losses_are_eq_1_over_all_steps() -> None:
    result = quick_fit()
    assert len(result.actions) == 10  # although the search looked at 8
    for theta, actions, loss in (
        (result.theta, result.actions, result.loss),
        (DEFAULT, result.default_actions, result.default_loss),
    ):
        assert actions.tolist() == [list(action(x, theta, PlannerSettings())) for x in seen(10)]
        assert loss == pytest.approx(np.sum((actions - result.demonstrated) ** 2))
    assert result.loss <= result.default_loss
    assert result.rms_error[0] ** 2 + result.rms_error[1] ** 2 == pytest.approx(result.loss / 10)


def test_weights_weigh() -> None:
    intervention = demonstrated(seen(10), published_parameters()["B2"])
    only_v, only_w = (
        fit(intervention, replace(QUICK, lambda_v=v, lambda_w=w)).default_loss for v, w in ((2.0, 0.0), (0.0, 3.0))
    )
    assert only_v / 2.0 + only_w / 3.0 == pytest.approx(quick_fit().default_loss)


def test_a_fit_is_never_worse_than_the_default() -> None:
    shown = fit(demonstrated(seen(6), DEFAULT), QUICK)
    assert (shown.theta, shown.loss, shown.default_loss) == (DEFAULT, 0.0, 0.0)
    # whatever a sample of one step says, all steps decide
    misled = fit(demonstrated(seen(12), DEFAULT), replace(QUICK, max_steps=1))
    assert (misled.theta, misled.loss) == (DEFAULT, 0.0)


def test_the_curve_and_the_progress_only_fall_within_a_search() -> None:
    told: list[tuple[int, float]] = []
    result = fit(
        demonstrated(seen(8), published_parameters()["A2"]), replace(QUICK, restarts=1), lambda *a: told.append(a)
    )
    assert [n for n, _ in told] == list(range(1, result.evaluations + 1))
    assert result.evaluations >= 36
    for number in np.unique(result.curve[:, 1]):
        losses = result.curve[result.curve[:, 1] == number, 2]
        assert np.all(np.diff(losses) < 0)


@pytest.mark.parametrize("after", [1, 20, 60])
def test_ctrl_c_keeps_the_best_so_far(after: int) -> None:
    best = math.inf

    def press(evaluations: int, loss: float) -> None:
        nonlocal best
        best = loss
        if evaluations == after:
            raise KeyboardInterrupt

    settings = FitSettings(modesty=0.0, patience=1, min_progress=1.0)  # 60 is among the scattered points
    result = fit(demonstrated(seen(8), published_parameters()["B2"]), settings, press)
    assert result.interrupted
    assert result.evaluations == after
    assert result.loss == pytest.approx(best)
    assert result.flatness == {}


def test_flatness_surrounds_theta_and_tells_what_the_data_do_not_determine() -> None:
    result = quick_fit()
    assert list(result.flatness) == list(PARAMETER_NAMES)
    for name, (low, high) in result.flatness.items():
        assert low <= getattr(result.theta, name) <= high
    standing = replace(seen(3)[1], goal=Pose2(30.0, 0.0, 0.0))  # no plan, so nothing matters
    taught = Intervention("A", "A1", [Step(standing, Command(0.1, 0.0))], METADATA)
    space = ParameterSpace()
    assert fit(taught, QUICK).flatness == {
        n: (low, high) for n, low, high in zip(PARAMETER_NAMES, space.lower, space.upper, strict=True)
    }


def test_flatness_is_of_the_parameters_that_are_returned() -> None:
    first, *others = demonstrated(seen(12), DEFAULT).steps
    act = Command(*action(first.observation, published_parameters()["A1"], PlannerSettings()))
    taught = Intervention("B", "B1", [replace(first, action=act), *others], METADATA)
    result = fit(taught, replace(QUICK, max_steps=1, max_evaluations=100))  # the one step looked at wants A1's
    assert result.theta == DEFAULT
    for name, (low, high) in result.flatness.items():
        assert low <= getattr(result.theta, name) <= high


def unsteadily_demonstrated() -> Intervention:
    """By a hand so unsteady that no parameters explain it."""
    hand = np.random.default_rng(5)
    steady = demonstrated(seen(8), published_parameters()["B2"]).steps
    steps = [replace(s, action=Command(s.action.v, s.action.w + hand.normal(0.0, 0.5))) for s in steady]
    return Intervention("B", "B1", steps, METADATA)


def test_among_equally_good_parameters_those_nearest_to_the_default_are_taken() -> None:
    taught = unsteadily_demonstrated()
    best, modest = (fit(taught, replace(QUICK, max_evaluations=200, modesty=m)) for m in (0.0, 0.2))
    space, default = ParameterSpace(), ParameterSpace().encode(DEFAULT)
    far, near = (float(np.linalg.norm(space.encode(r.theta) - default)) for r in (best, modest))
    assert near < far
    assert best.loss < modest.loss <= best.loss + 0.2 * min(best.default_loss - best.loss, best.loss) + 1e-9
    assert modest.curve.tolist() == best.curve.tolist()  # the search is the same


def test_searches_with_different_seeds_agree_better_where_something_is_given_up() -> None:
    taught, encode = unsteadily_demonstrated(), ParameterSpace().encode

    def apart(settings: FitSettings) -> float:
        """Mean distance between the parameters of three seeds [cube sides]."""
        found = [encode(fit(taught, replace(settings, seed=seed)).theta) for seed in range(3)]
        return float(np.mean([np.linalg.norm(a - b) for a, b in itertools.combinations(found, 2)]))

    settings = replace(QUICK, max_evaluations=800)
    assert apart(settings) < 0.7 * apart(replace(settings, modesty=0.0))


def test_no_chosen_parameter_could_go_back_to_its_default_for_nothing() -> None:
    taught = demonstrated(seen(8), replace(DEFAULT, max_vel_x=0.8, gdist_scale=0.5))
    fitting = _Fitting(LabelledSteps.of([taught.packed]), replace(QUICK, max_evaluations=600, modesty=0.2), None)
    fitting.run()
    chosen, moved = fitting.chosen(), 0
    for name in PARAMETER_NAMES:
        back = replace(chosen, **{name: getattr(DEFAULT, name)})
        assert back == chosen or fitting.loss(back) > fitting.allowed, name
        moved += back != chosen
    assert 1 <= moved < 8
    assert fitting.loss(chosen) <= fitting.allowed


def test_restarts_begin_at_the_best_of_scattered_points_that_lie_apart() -> None:
    steps = LabelledSteps.of([pack(list(demonstrated(seen(6), published_parameters()["B2"]).steps))])
    settings = replace(QUICK, scattered=30, restarts=3, max_evaluations=1000)
    fitting = _Fitting(steps, settings, None)
    first, *others = fitting.starts(np.random.default_rng(0))
    assert first.tolist() == [0.5] * 8
    looked_at = [loss for loss, _ in fitting.seen[1:]]
    assert fitting.evaluations == len(looked_at) == 30
    losses = [fitting.loss(settings.space.decode(point)) for point in others]
    assert losses[0] == min(looked_at)
    assert losses == sorted(losses)
    assert len(others) == 3
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(others, 2)) > STARTS_APART


def test_several_interventions_of_one_context_are_one_sum() -> None:
    one, two = demonstrated(seen(4), published_parameters()["B1"]), demonstrated(seen(9), published_parameters()["B2"])
    together = fit([one, two], QUICK)
    assert together.default_loss == pytest.approx(fit(one, QUICK).default_loss + fit(two, QUICK).default_loss)
    assert len(together.actions) == 13
    with pytest.raises(ValueError, match="one fit is for one context, not for A1, B1"):
        fit([one, Intervention("A", "A1", two.steps, METADATA)])
    with pytest.raises(ValueError, match="not for none"):
        fit([])


def test_without_labelled_steps_there_is_nothing_to_learn() -> None:
    steps = [replace(s, labelled=False) for s in demonstrated(seen(3), DEFAULT).steps]
    with pytest.raises(ValueError, match="intervention B1 has no labelled steps to learn from"):
        fit(Intervention("B", "B1", steps, METADATA))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lambda_v": -1.0}, "lambda_v"),
        ({"lambda_w": math.nan}, "lambda_w"),
        ({"lambda_v": 0.0, "lambda_w": 0.0}, "must not both be 0"),
        ({"population": 3}, "population must be at least 4"),
        ({"max_steps": 0}, "max_steps"),
        ({"sigma": 0.0}, "sigma"),
        ({"modesty": 1.0}, "modesty"),
        ({"start": "here"}, "start must be one of"),
    ],
)
def test_settings_that_make_no_sense_are_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(FitSettings(), **change)  # type: ignore[arg-type]


def test_published_rows_lie_in_the_search_space() -> None:
    space = ParameterSpace()
    assert list(published_parameters()) == ["A1", "A2", "B1", "B2", "D1", "D2"]
    for theta in published_parameters().values():
        assert space.decode(space.encode(theta)).as_array() == pytest.approx(theta.as_array())


# ---- known answers -------------------------------------------------------------------------------------------------

OPEN = World(
    "open",
    (Cylinder(3.0, 1.2, 0.2, 0.5), Box(6.0, -1.6, 0.3, 0.6, 0.6, 0.6)),
    Pose2(0.0, 0.0, -1.7),
    Pose2(9.0, 0.5, 0.0),
    SLALOM.rules,
)


@pytest.mark.slow
@pytest.mark.parametrize("label", ["A1", "B1", "B2"])
def test_published_parameters_are_found_again_from_what_they_do(label: str) -> None:
    # Facing away from the goal at first: only fast turns to the left show max_vel_theta.
    theta = published_parameters()[label]
    world = OPEN if label == "B1" else replace(SLALOM, start=replace(SLALOM.start, yaw=-2.6))
    driving = rollout(Simulation(world, np.random.default_rng(7)), MoveBaseDriver(theta))
    observations = [tick.observation for tick, _ in zip(driving, range(100), strict=False)]
    result = fit(demonstrated(observations, theta))
    assert result.loss < 0.03 * result.default_loss
    assert result.theta.max_vel_x == pytest.approx(theta.max_vel_x, rel=0.1)
    assert result.theta.max_vel_theta == pytest.approx(theta.max_vel_theta, rel=0.1)
    assert not result.interrupted
