"""A whole session of the synthetic intervener: the contexts of the training course, each in its place."""

from __future__ import annotations

import gc
from pathlib import Path

import pytest

from learning.interventions import Intervention, Kind, load_dataset, save_intervention
from scenarios.cli import main
from scenarios.collect import Collected, Labels, Session
from scenarios.teaching import highest_numbers
from scenarios.trials import TrialSpec
from scenarios.worlds import load_world
from tests.learning.observations import METADATA, random_steps
from twin.records import Tick


def collect(world_name: str, seed: int) -> list[Collected]:
    kept: list[Collected] = []
    spec = TrialSpec(world_name, seed=seed)
    Session(spec, load_world(world_name)).run(kept.append)
    return kept


def test_a_drive_does_not_pile_up_maps() -> None:
    def ticks() -> int:
        gc.collect()
        return sum(type(thing) is Tick for thing in gc.get_objects())

    before, alive = ticks(), list[int]()
    session = Session(TrialSpec("doorway", seed=3), load_world("doorway"))
    session.run(lambda collected: alive.append(ticks() - len(collected.ticks) - before))
    assert alive
    assert max(alive) < 5


# ---- labels ---------------------------------------------------------------------------------------------------------


def test_a_named_place_has_the_same_label_in_every_session_and_process() -> None:
    world = load_world("training")
    # the order in which things go wrong, and what is in the folder, must not matter
    for so_far in (None, {"A": 5, "B": 2, "D": 9}):
        labels = Labels(world, so_far)  # type: ignore[arg-type]
        for _ in range(3):
            for place in ("D2", "A2", "B1", "A1", "D1", "B2"):
                assert labels.of(place[0], place) == place  # type: ignore[arg-type]


def test_trouble_of_another_type_at_a_named_place_is_a_context_of_its_own_with_a_stable_label() -> None:
    world = load_world("training")
    kinds: tuple[Kind, ...] = ("A", "B", "D")
    places = sorted({segment.name for segment in world.segments})
    assert places == ["A1", "A2", "B1", "B2", "D1", "D2"]
    forth, back = Labels(world), Labels(world, {"A": 7})
    first = {(kind, place): forth.of(kind, place) for kind in kinds for place in places}
    second = {(kind, place): back.of(kind, place) for place in reversed(places) for kind in reversed(kinds)}
    assert first == second
    assert len(set(first.values())) == len(first), "one label, one context"
    assert first["A", "B2"] not in {"A1", "A2"}
    assert all(label[0] == kind for (kind, _), label in first.items())


def test_trouble_between_the_places_gets_numbers_of_its_own() -> None:
    world = load_world("training")
    labels = Labels(world)
    placed = {labels.of("A", segment.name) for segment in world.segments}
    between = [labels.of("A", "") for _ in range(3)]
    assert len(placed | set(between)) == len(placed) + 3
    assert labels.of("A", "A1") == "A1"
    assert not set(between) & {Labels(world, {"A": int(between[-1][1:])}).of("A", "")}


def test_without_places_numbers_go_on_after_the_files_that_are_there(tmp_path: Path) -> None:
    world = load_world("barn-like/7")
    assert not world.segments
    assert [Labels(world).of(kind, "") for kind in ("A", "B", "D")] == ["A1", "B1", "D1"]  # type: ignore[arg-type]
    for label in ("A1", "A3", "D2"):
        save_intervention(Intervention(label[0], label, random_steps(0, 2, 16), METADATA), tmp_path)  # type: ignore[arg-type]
    labels = Labels(world, highest_numbers(tmp_path))
    assert [labels.of("A", ""), labels.of("A", ""), labels.of("B", ""), labels.of("D", "")] == ["A4", "A5", "B1", "D3"]


# ---- sessions -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 7])
def test_training_gives_each_context_once_in_its_place(seed: int, tmp_path: Path) -> None:
    kept = collect("training", seed)
    assert sorted(c.intervention.label for c in kept) == ["A1", "A2", "B1", "B2", "D1", "D2"]
    for collected in kept:
        made = collected.intervention
        assert made.label == collected.place
        assert all(tick.contact is None for tick in collected.ticks), "demonstrations are free of collisions"
        assert collected.min_clearance > 0.02
        assert 2.0 <= len(made.steps) * 0.05 <= 12.05
        assert made.metadata.source == "synthetic"
        assert made.metadata.rewound > 0.0
        path = save_intervention(made, tmp_path)
        assert path.stat().st_size < 3_000_000
    assert [i.label for i in load_dataset(tmp_path)] == ["A1", "A2", "B1", "B2", "D1", "D2"]
    assert [i.label for i in load_dataset(tmp_path, ["B"])] == ["B1", "B2"]
    # the first two seconds still have the speed at which the person took over
    fastest = {c.place: max(step.action.v for step in c.intervention.steps[40:]) for c in kept}
    assert fastest["B1"] > 1.2, "brisk in the open"
    assert max(fastest["A1"], fastest["A2"]) <= 0.46, "steady where the default failed at 0.5 m/s"
    assert fastest["D1"] <= 0.41
    assert fastest["D2"] <= 0.41, "careful where nothing was wrong"


@pytest.mark.slow
def test_without_rewinding_only_what_follows_a_good_state_is_learnt_from() -> None:
    kept: list[Collected] = []
    Session(TrialSpec("training", seed=3), load_world("training"), rewinding=False).run(kept.append)
    assert {c.intervention.kind for c in kept} == {"A", "B"}
    retreats = 0
    for collected in kept:
        steps, simulated = list(collected.intervention.steps), collected.ticks
        assert collected.intervention.metadata.rewound == 0.0
        assert all(tick.contact is None for tick in simulated)
        labelled = [step.labelled for step in steps]
        assert any(labelled)
        assert labelled == sorted(labelled), "once good, always good"
        assert all(step.action.v >= 0.0 for step in steps if step.labelled), "nobody learns to back up"
        retreats += any(step.action.v < 0.0 for step in steps)
    assert retreats >= 1


@pytest.mark.slow
def test_a_session_is_reproducible(tmp_path: Path) -> None:
    first, second = (collect("doorway", 3) for _ in range(2))
    assert [c.intervention.digest for c in first] == [c.intervention.digest for c in second]


def test_a_closed_world_is_refused_with_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    course = tmp_path / "closed.toml"
    course.write_text(
        'name = "closed"\nstart = [0.0, 0.0, 0.0]\ngoal = [3.0, 0.0]\ntime_limit = 8.0\n'
        "[[walls]]\npoints = [[-1.0, -1.0], [1.5, -1.0], [1.5, 1.0], [-1.0, 1.0]]\nclosed = true\n"
    )
    with pytest.raises(SystemExit) as stop:
        main(["collect", str(course), "--out", str(tmp_path / "out")])
    assert stop.value.code == 2
    assert "a human could not show a way either" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_told_before_the_drive(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["collect", "open", "--out", "/proc"])
    assert stop.value.code == 2
    err = capsys.readouterr().err
    assert err.startswith("appli: cannot use the folder /proc: ")
    assert len(err.splitlines()) == 1
