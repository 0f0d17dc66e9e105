"""Laws of the teleop session, with keys from a script instead of a person."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from learning import interventions
from learning.interventions import load_dataset, load_intervention
from scenarios import teleop, teleop_session
from scenarios.errors import UserError
from scenarios.keyboard import SPEED, TURBO_SPEED, TURN, Keys, Stick
from scenarios.surfaces.script import ScriptSurface, read_script
from scenarios.teaching import highest_numbers
from scenarios.teleop import teleop_command
from scenarios.teleop_session import TeleopSession
from scenarios.teleop_view import Mode, View
from scenarios.trials import TrialSpec, make_driver, make_simulation, tick_bytes
from twin.records import Command, Outcome, Pose2, Twist2
from twin.rewind import Tape
from twin.rollout import Loop
from twin.world import Box, Rules, World

WORLD = World("hall", (), Pose2(0.0, 0.0, 0.0), Pose2(9.0, 0.0, 0.0), Rules("course", 0.5, 60.0))
WALL = World(
    "wall", (Box(1.0, 0.0, 0.0, 0.1, 4.0, 0.5),), Pose2(0.0, 0.0, 0.0), Pose2(3.0, 0.0, 0.0), Rules("course", 0.5, 60.0)
)


NO_KEYS = Keys()


def held(*keys: str) -> Keys:
    return Keys(held=frozenset(keys))


def pressed(*keys: str) -> Keys:
    return Keys(pressed=keys)


def session_in(world: World, out: Path) -> TeleopSession:
    spec = TrialSpec(world.name, seed=3)
    return TeleopSession(Tape(Loop(make_simulation(spec, world), make_driver(spec))), out, world.name, 3)


@pytest.fixture
def session(tmp_path: Path) -> TeleopSession:
    return session_in(WORLD, tmp_path)


def frames(session: TeleopSession, keys: Keys, count: int) -> View:
    for _ in range(count):
        view = session.frame(keys)
    return view


def commands(folder: Path) -> list[list[float]]:
    (made,) = load_dataset(folder)
    found: list[list[float]] = made.packed.actions.tolist()
    return found


# --- the stick -------------------------------------------------------------------------------------------------------


@given(st.lists(st.frozensets(st.sampled_from(["w", "s", "a", "d", "up", "left", "shift", "space"])), max_size=80))
def test_the_stick_is_smooth_and_stays_in_range(holds: list[frozenset[str]]) -> None:
    stick = Stick()
    for keys in holds:
        after = stick.advance(Keys(keys), 0.05)
        assert abs(after.v) <= TURBO_SPEED
        assert abs(after.w) <= TURN
        if "space" in keys:
            assert after.at_rest
        else:
            assert abs(after.v - stick.v) <= 0.1 + 1e-12
            assert abs(after.w - stick.w) <= 0.3 + 1e-12
        stick = after


@pytest.mark.parametrize(
    ("keys", "v", "w"),
    [
        (held("w"), SPEED, 0.0),
        (held("up", "shift"), TURBO_SPEED, 0.0),
        (held("s", "a"), -SPEED, TURN),
        (held("d"), 0.0, -TURN),
        (held("w", "s", "left", "right"), 0.0, 0.0),
    ],
)
def test_held_keys_reach_their_speed_and_released_ones_coast_to_zero(keys: Keys, v: float, w: float) -> None:
    stick = Stick()
    for _ in range(60):
        stick = stick.advance(keys, 0.05)
    assert (stick.v, stick.w) == (v, w)
    speeds = [abs(stick.v)]
    while not stick.at_rest:
        stick = stick.advance(NO_KEYS, 0.05)
        speeds.append(abs(stick.v))
    assert speeds == sorted(speeds, reverse=True)
    assert len(speeds) <= 22  # about a second from turbo


def test_letting_go_of_turbo_falls_back_to_the_joystick_speed() -> None:
    stick = Stick(2.0)
    for _ in range(20):
        stick = stick.advance(held("w"), 0.05)
    assert stick.v == SPEED


# --- who drives ------------------------------------------------------------------------------------------------------


def test_without_keys_the_planner_drives_as_without_a_session(tmp_path: Path) -> None:
    session = session_in(WORLD, tmp_path)
    spec = TrialSpec(WORLD.name, seed=3)
    alone = Loop(make_simulation(spec, WORLD), make_driver(spec))
    for _ in range(15):
        session.frame(NO_KEYS)
        alone.step()
    assert np.array_equal(session.view().frame.physics, alone.simulation.snapshot().physics)


def test_a_driving_key_takes_over_and_the_planner_comes_back_after_the_time_out(session: TeleopSession) -> None:
    assert frames(session, NO_KEYS, 5).mode is Mode.PLANNER
    assert session.frame(held("a")).mode is Mode.NUDGE
    assert frames(session, held("a"), 10).frame.twist.w > 0.8
    modes = [session.frame(NO_KEYS).mode for _ in range(30)]
    first = modes.index(Mode.PLANNER)
    assert 9 <= first <= 17  # coasting, then 0.5 s
    assert set(modes[first:]) == {Mode.PLANNER}
    assert session.saved == []


def test_space_stops_the_robot_whoever_drives(session: TeleopSession) -> None:
    assert frames(session, NO_KEYS, 20).frame.twist.v > 0.3
    assert abs(frames(session, held("space"), 12).frame.twist.v) < 0.02


def test_taking_over_begins_at_the_speed_the_robot_has(session: TeleopSession, tmp_path: Path) -> None:
    v = frames(session, NO_KEYS, 20).frame.twist.v
    session.frame(Keys(frozenset({"w"}), ("1", "w")))
    session.frame(pressed("enter"))
    assert abs(commands(tmp_path)[0][0] - v) <= 0.1 + 1e-9


def test_a_lost_connection_stops_the_robot_at_once_and_the_twin_waits(session: TeleopSession, tmp_path: Path) -> None:
    session.frame(pressed("2"))
    assert frames(session, held("w", "shift"), 20).frame.twist.v > 0.7
    view = frames(session, Keys(held=frozenset({"w"}), lost=True), 40)
    assert view.mode is Mode.WAITING
    assert abs(view.frame.twist.v) < 0.02
    recorded = view.recorded
    assert frames(session, NO_KEYS, 10).recorded == recorded
    assert session.frame(held("w")).mode is Mode.INTERVENTION
    session.frame(pressed("enter"))
    assert [0.0, 0.0] in commands(tmp_path)


def test_the_twin_waits_for_the_first_sign_of_a_person(session: TeleopSession) -> None:
    assert frames(session, Keys(lost=True), 5).frame.index == 0
    assert frames(session, NO_KEYS, 5).frame.index == 5


# --- recording -------------------------------------------------------------------------------------------------------


def test_an_intervention_holds_every_tick_from_its_key_to_enter(session: TeleopSession, tmp_path: Path) -> None:
    frames(session, NO_KEYS, 4)
    assert session.frame(pressed("1")).label == "A1"
    frames(session, held("w"), 30)
    frames(session, NO_KEYS, 9)
    view = session.frame(pressed("enter"))
    assert view.mode is Mode.PLANNER
    assert view.saved == ("A1",)
    made = load_intervention(session.saved[0])
    assert (made.kind, made.metadata.source, made.metadata.rewound, made.metadata.seed) == ("A", "teleop", 0.0, 3)
    assert np.allclose(made.packed.times, 0.2 + 0.05 * np.arange(40))
    assert made.metadata.trouble_time == pytest.approx(0.2)
    assert made.packed.actions[:, 0].max() == SPEED
    assert made.packed.actions[-1].tolist() == [0.0, 0.0]
    assert made.packed.labelled.all()


def test_labels_count_on_per_kind_and_from_what_the_folder_holds(tmp_path: Path) -> None:
    for number in (1, 2):
        session = session_in(WORLD, tmp_path)
        for key in ("1", "3", "1"):
            session.frame(pressed(key))
            frames(session, held("w"), 2)
            session.frame(pressed("enter"))
        assert session.view().saved == (f"A{2 * number - 1}", f"D{number}", f"A{2 * number}")
    assert highest_numbers(tmp_path) == {"A": 4, "B": 0, "D": 2}
    demonstration = next(i for i in load_dataset(tmp_path) if i.kind == "D")
    assert demonstration.metadata.trouble_time is None


def test_the_type_can_be_corrected_until_it_is_saved(session: TeleopSession, tmp_path: Path) -> None:
    session.frame(pressed("1"))
    session.frame(pressed("2"))
    session.frame(pressed("enter"))
    assert load_dataset(tmp_path)[0].label == "B1"


def test_discard_leaves_no_file(session: TeleopSession, tmp_path: Path) -> None:
    session.frame(pressed("1"))
    frames(session, held("w"), 5)
    assert session.frame(pressed("backspace")).mode is Mode.PLANNER
    session.frame(pressed("q"))
    assert session.finished
    assert list(tmp_path.iterdir()) == []


def test_quit_saves_what_is_in_progress(session: TeleopSession, tmp_path: Path) -> None:
    session.frame(pressed("2"))
    frames(session, held("w"), 5)
    session.frame(pressed("q"))
    assert session.finished
    assert [path.name for path in tmp_path.iterdir()] == ["B1-hall-seed3-001.npz"]


def test_killed_at_any_moment_a_session_loses_at_most_the_intervention_in_progress(
    session: TeleopSession, tmp_path: Path
) -> None:
    session.frame(pressed("1"))
    frames(session, held("w"), 3)
    session.frame(pressed("enter"))
    first = session.saved[0].read_bytes()
    session.frame(pressed("1"))
    frames(session, held("w"), 3)
    del session  # as kill -9 would
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [first]


def test_a_full_disk_keeps_the_intervention_until_there_is_room(
    session: TeleopSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> Path:
        raise OSError(28, "No space left on device")

    session.frame(pressed("1"))
    frames(session, held("w"), 5)
    monkeypatch.setattr(teleop_session, "save_intervention", full)
    view = session.frame(pressed("enter"))
    assert "No space left" in view.message
    assert view.mode is Mode.WAITING
    monkeypatch.setattr(teleop_session, "save_intervention", interventions.save_intervention)
    session.frame(pressed("enter"))
    assert len(commands(tmp_path)) == 6


def test_one_intervention_stays_in_memory_limits(session: TeleopSession, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(teleop_session, "LONGEST", 0.5)
    session.frame(pressed("3"))
    view = frames(session, NO_KEYS, 30)
    assert (view.mode, view.recorded) == (Mode.WAITING, 0.5)


# --- rewinding -------------------------------------------------------------------------------------------------------


def ticks_of(session: TeleopSession, monkeypatch: pytest.MonkeyPatch) -> dict[int, bytes]:
    """Every tick the session makes from now on, as bytes by index; a tick made again replaces its first edition."""
    step: Callable[[Command | None], object] = session._tape.step
    seen: dict[int, bytes] = {}

    def watched(override: Command | None = None) -> object:
        tick = step(override)
        seen[tick.index] = tick_bytes(tick)  # type: ignore[attr-defined]
        return tick

    monkeypatch.setattr(session._tape, "step", watched)
    return seen


def test_rewind_and_hand_back_replays_bit_for_bit(session: TeleopSession, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = ticks_of(session, monkeypatch)
    shown = {session.view().frame.index: session.view().frame}
    for k in range(50):  # with a nudge in it
        frame = session.frame(held("a") if 10 <= k < 20 else NO_KEYS).frame
        shown[frame.index] = frame
    first, end = dict(seen), session.view().frame
    view = frames(session, held("r"), 4)
    assert view.mode is Mode.REWIND
    assert view.rewound == pytest.approx(0.4)
    assert view.frame is shown[42]
    view = session.frame(NO_KEYS)
    assert view.mode is Mode.WAITING
    assert view.frame.index == 42
    assert np.array_equal(session._tape.loop.simulation.snapshot().physics, shown[42].physics)
    assert frames(session, NO_KEYS, 20).frame.index == 42  # it waits
    session.frame(pressed("enter"))
    view = frames(session, NO_KEYS, 7)
    assert seen == first
    assert np.array_equal(view.frame.physics, end.physics)


def test_a_rewound_intervention_begins_where_the_twin_was_put(session: TeleopSession, tmp_path: Path) -> None:
    frames(session, NO_KEYS, 40)
    frames(session, held("r"), 10)
    session.frame(pressed("1"))
    frames(session, held("w", "a"), 10)
    session.frame(pressed("enter"))
    (made,) = load_dataset(tmp_path)
    assert made.start_time == pytest.approx(1.0)
    assert made.metadata.rewound == pytest.approx(1.0)
    assert made.metadata.trouble_time == pytest.approx(1.0)
    assert made.metadata.trouble_pose == made.steps[0].observation.pose


def test_a_rewind_within_an_intervention_takes_its_steps_back(session: TeleopSession, tmp_path: Path) -> None:
    frames(session, NO_KEYS, 10)
    session.frame(pressed("1"))
    frames(session, held("d"), 19)
    frames(session, held("r"), 5)  # ten ticks back, to 1.0 s
    frames(session, held("w"), 10)
    session.frame(pressed("enter"))
    (made,) = load_dataset(tmp_path)
    assert np.allclose(made.packed.times, 0.5 + 0.05 * np.arange(20))
    assert made.metadata.rewound == 0.0
    assert made.packed.actions[9, 1] < -1.0
    assert made.packed.actions[-1, 1] > -0.1


def test_after_a_collision_only_the_way_back_is_open(tmp_path: Path) -> None:
    session = session_in(WALL, tmp_path)
    session.frame(pressed("1"))
    for _ in range(80):
        view = session.frame(held("w"))
        if view.mode is Mode.ENDED:
            break
    assert view.frame.outcome is Outcome.COLLIDED
    assert "box_0000" in view.message
    session.frame(pressed("enter"))
    assert session.saved == []
    frames(session, held("r"), 15)
    assert session.frame(held("a")).mode is Mode.INTERVENTION
    frames(session, held("a"), 5)
    session.frame(pressed("enter"))
    assert [path.name[:2] for path in session.saved] == ["A1"]


def test_the_tape_has_an_end(session: TeleopSession) -> None:
    frames(session, NO_KEYS, 10)
    view = frames(session, held("r"), 20)
    assert view.frame.index == 0
    assert "ends here" in view.message


# --- scripts and the command -----------------------------------------------------------------------------------------

SCRIPT = """
# a nudge, then a type A intervention after a rewind
1.0 down w
1.5 up w
3.0 down r
3.5 up r
3.6 press 1
3.7 down w      # hold it ...
4.7 up w
5.2 press enter
5.5 press q
"""


def test_equal_scripts_give_equal_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = tmp_path / "drive.keys"
    script.write_text(SCRIPT)
    for name in ("one", "two"):
        assert teleop_command("open", tmp_path / name, keys=script) == 0
    (one,), (two,) = load_dataset(tmp_path / "one"), load_dataset(tmp_path / "two")
    assert one.digest == two.digest
    assert (one.label, one.metadata.rewound) == ("A1", pytest.approx(1.0))
    assert "A1-open-seed0-001.npz" in capsys.readouterr().out


def test_a_script_presses_holds_and_quits(tmp_path: Path) -> None:
    script = tmp_path / "s.keys"
    script.write_text("0 down W\n0.1 up w # note\n\n0.1 press 1\n")
    surface = ScriptSurface(read_script(script))
    polls = [surface.poll() for _ in range(4)]
    assert polls == [Keys(frozenset("w"), ("w",)), held("w"), pressed("1"), pressed("q")]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1.0 down", ":1: expected"),
        ("\nx down w", ":2: 'x' is not a time"),
        ("1 hold w", "none of down, up, press"),
        ("1 down ctrl", "unknown key 'ctrl'"),
        ("2 down w\n1 up w", ":2: times must not decrease"),
        ("nan down w", "times must"),
        ("# nothing", "no key events"),
    ],
)
def test_a_wrong_script_is_refused_in_one_line(text: str, says: str, tmp_path: Path) -> None:
    script = tmp_path / "s.keys"
    script.write_text(text)
    with pytest.raises(UserError) as caught:
        teleop_command("open", tmp_path / "out", keys=script)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"world_name": "opne"}, "did you mean open"),
        ({"seed": -1}, "--seed"),
        ({"port": 70000}, "--port"),
        ({"driver": "nobody"}, "nobody"),
        ({"host": "example"}, "--host"),
        ({"keys": Path("missing.keys")}, "missing.keys"),
    ],
)
def test_a_mistake_gets_one_line(options: dict[str, object], says: str, tmp_path: Path) -> None:
    if "host" not in options and "keys" not in options:
        (tmp_path / "q.keys").write_text("0 press q\n")
        options = {"keys": tmp_path / "q.keys", **options}
    with pytest.raises(UserError) as caught:
        teleop_command(**{"world_name": "open", "out": tmp_path / "out", **options})  # type: ignore[arg-type]
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_window_without_a_display_gets_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(UserError, match="no display"):
        teleop_command("open", tmp_path, "window")


def test_pacing_is_real_time(session: TeleopSession, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    slept: list[float] = []
    monkeypatch.setattr(teleop.time, "monotonic", lambda: clock[0])

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        clock[0] += seconds

    monkeypatch.setattr(teleop.time, "sleep", sleep)

    class Patient:
        left = 8

        def poll(self) -> Keys:
            self.left -= 1
            clock[0] += 0.01  # a frame takes a moment
            return NO_KEYS if self.left else pressed("q")

        def draw(self, view: View) -> None: ...
        def close(self) -> None: ...

    teleop.drive(session, Patient(), paced=True)
    assert math.isclose(clock[0], 8 * 0.05)
    assert np.allclose(slept, 0.04)


def test_the_stick_matches_only_what_it_can() -> None:
    assert Stick.matching(Twist2(3.0, -2.0)) == Stick(TURBO_SPEED, -TURN)
