"""The synthetic intervener: what it notices, where it rewinds to, and that its drives are those of a careful human."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from learning.bystander import STUCK_TIME, Bystander, Sight, reversals
from learning.expert import REACTION, V_RAMP, W_RAMP, Expert, Hand
from learning.intervener import LEAD, Intervener, segment_at
from learning.route import BRISK, CAREFUL, PASSABLE, UnreachableError, curvatures, distance_field, plan_route
from twin.free_space import free_space
from twin.records import STOP, Command, Pose2
from twin.world import Box, Rules, Segment, World

TICK = 0.05
RULES = Rules("course", 0.5, 100.0)


def hall(*obstacles: Box, segments: tuple[Segment, ...] = ()) -> World:
    """A hall of 12 x 6 m with walls, from west to east."""
    walls = (
        Box(6.0, 3.05, 0.0, 12.2, 0.1, 1.0),
        Box(6.0, -3.05, 0.0, 12.2, 0.1, 1.0),
        Box(-0.05, 0.0, 0.0, 0.1, 6.0, 1.0),
        Box(12.05, 0.0, 0.0, 0.1, 6.0, 1.0),
    )
    return World("hall", (*walls, *obstacles), Pose2(1.0, 0.0, 0.0), Pose2(11.0, 0.0, 0.0), RULES, segments)


DOOR = (Box(6.0, 1.85, 0.0, 0.2, 2.3, 1.0), Box(6.0, -1.85, 0.0, 0.2, 2.3, 1.0))  # 1.4 m wide


def watch(world: World, poses: list[Pose2]) -> Bystander:
    space = free_space(world)
    bystander = Bystander(space, distance_field(space, world.goal))
    for index, pose in enumerate(poses):
        bystander.see(Sight(index, pose))
    return bystander


def straight(v: float, seconds: float, x: float = 1.0) -> list[Pose2]:
    return [Pose2(x + v * TICK * k, 0.0, 0.0) for k in range(round(seconds / TICK) + 1)]


def test_good_progress_is_no_trouble() -> None:
    bystander = watch(hall(*DOOR), straight(0.5, 6.0))
    assert bystander.urgent() is None


@pytest.mark.parametrize("seconds", [STUCK_TIME - 0.2, STUCK_TIME + 0.2])
def test_standing_still_is_trouble_after_its_time_and_not_before(seconds: float) -> None:
    bystander = watch(hall(*DOOR), straight(0.0, seconds))
    trouble = bystander.urgent()
    if seconds < STUCK_TIME:
        assert trouble is None
    else:
        assert trouble is not None
        assert (trouble.kind, trouble.reason) == ("A", "makes no progress")


def test_backing_up_is_trouble() -> None:
    there = straight(0.5, 4.0)
    back = [Pose2(there[-1].x - 0.3 * TICK * k, 0.0, 0.0) for k in range(1, 17)]
    trouble = watch(hall(*DOOR), there + back).urgent()
    assert trouble is not None
    assert trouble.reason == "drives backwards"
    assert watch(hall(*DOOR), there + back[:4]).urgent() is None, "one short step back is not yet trouble"


def test_spinning_is_trouble() -> None:
    there = straight(0.5, 2.0)
    spin = [Pose2(there[-1].x, 0.0, math.remainder(1.57 * TICK * k, math.tau)) for k in range(90)]
    trouble = watch(hall(*DOOR), there + spin).urgent()
    assert trouble is not None
    assert trouble.reason == "turns on the spot"


def test_driving_at_a_wall_is_trouble_before_it_is_touched() -> None:
    trouble, seen = None, []
    for pose in straight(1.0, 11.0):
        seen.append(pose)
        if pose.x > 10.0 and (trouble := watch(hall(), seen[-60:]).urgent()) is not None:
            break
    assert trouble is not None
    assert trouble.reason == "is about to touch something"
    assert 11.2 < seen[-1].x < 12.0 - 0.229


def test_trouble_began_where_progress_ended_not_where_it_showed() -> None:
    drive = straight(0.5, 4.0)
    stuck = [drive[-1]] * 110
    trouble = watch(hall(*DOOR), drive + stuck).urgent()
    assert trouble is not None
    assert trouble.noticed - trouble.began > 60
    assert abs(trouble.began - len(drive)) < 25


def test_slow_in_the_open_is_improvable_and_brisk_is_not() -> None:
    assert watch(hall(), straight(0.5, 5.0)).improvable(1000) is not None
    assert watch(hall(), straight(1.4, 3.2)).improvable(1000) is None


def test_slow_in_a_narrow_place_is_not_called_slow() -> None:
    corridor = (Box(5.0, 0.85, 0.0, 8.0, 0.2, 1.0), Box(5.0, -0.85, 0.0, 8.0, 0.2, 1.0))
    assert watch(hall(*corridor), straight(0.5, 5.0, x=2.0)).improvable(1000) is None


def test_shaking_into_a_narrow_place_is_improvable() -> None:
    rates = [0.6 if (k // 12) % 2 else -0.6 for k in range(100)]
    yaw, x, poses = 0.0, 2.6, []
    for w in rates:
        yaw += w * TICK
        x += 0.5 * TICK
        poses.append(Pose2(x, 0.0, yaw))
    narrow = (Box(7.0, 0.5, 0.0, 3.0, 0.2, 1.0), Box(7.0, -0.5, 0.0, 3.0, 0.2, 1.0))
    trouble = watch(hall(*narrow), poses).improvable(1000)
    assert trouble is not None
    assert (trouble.kind, trouble.reason) == ("B", "enters a narrow place unsteadily")
    assert reversals([0.0] * 100, 0.25) == 0


def test_what_was_before_a_place_does_not_count_in_it() -> None:
    drive = straight(0.5, 5.0)
    assert watch(hall(), drive).improvable(100) is not None
    assert watch(hall(), drive).improvable(30) is None


def test_a_route_is_smooth_and_keeps_its_distance() -> None:
    world = hall(*DOOR, Box(3.5, 0.3, 0.2, 0.6, 0.6, 0.5))
    space = free_space(world)
    route = plan_route(space, world.start, world.goal, BRISK)
    assert route.clearance.min() > PASSABLE
    assert np.hypot(*(route.points[0] - (1.0, 0.0))) < 0.05
    assert np.hypot(*(route.points[-1] - (11.0, 0.0))) < 0.05
    assert np.abs(curvatures(route.points)).max() < 2.5
    length = np.hypot(*np.diff(route.points, axis=0).T).sum()
    assert length < 1.1 * 10.0, "not wide around obstacles"


def test_a_route_is_slow_where_it_is_tight_and_fast_where_it_is_not() -> None:
    world = hall(*DOOR)
    space = free_space(world)
    route, careful = (plan_route(space, world.start, world.goal, pace) for pace in (BRISK, CAREFUL))
    door = int(np.argmin(np.abs(route.points[:, 0] - 6.0)))
    assert route.speed[door] < route.speed[door - 40]
    assert route.speed.max() > 1.5
    assert careful.speed.max() <= 0.4


def test_a_closed_hall_has_no_route() -> None:
    world = hall(Box(6.0, 0.0, 0.0, 0.2, 6.0, 1.0))
    with pytest.raises(UnreachableError):
        plan_route(free_space(world), world.start, world.goal, BRISK)
    with pytest.raises(UnreachableError):
        plan_route(free_space(world), world.start, Pose2(99.0, 0.0, 0.0), BRISK)


def drive_by_hand(world: World, start: Pose2, seed: int = 0) -> tuple[list[Command], list[Pose2]]:
    """The expert on an ideal unicycle."""
    expert = Expert(plan_route(free_space(world), start, world.goal, BRISK), BRISK)
    hand, pose, rng = Hand(STOP), start, np.random.default_rng(seed)
    commands, poses = [], []
    for _ in range(1200):
        command, hand = expert.drive(hand, pose, rng)
        yaw = pose.yaw + command.w * TICK
        pose = Pose2(pose.x + command.v * TICK * math.cos(yaw), pose.y + command.v * TICK * math.sin(yaw), yaw)
        commands.append(command)
        poses.append(pose)
        if expert.at_end(hand):
            break
    return commands, poses


@pytest.mark.parametrize("yaw", [0.0, 2.5])
def test_the_expert_arrives_without_touching_anything(yaw: float) -> None:
    world = hall(*DOOR, Box(3.5, 0.3, 0.2, 0.6, 0.6, 0.5))
    commands, poses = drive_by_hand(world, Pose2(1.0, 0.0, yaw))
    assert math.hypot(poses[-1].x - 11.0, poses[-1].y) < 0.5
    assert free_space(world).at(np.array([[p.x, p.y] for p in poses])).min() > 0.24
    assert len(commands) * TICK < 16.0, "briskly"


def test_the_hand_reacts_late_and_moves_the_stick_smoothly() -> None:
    commands, _ = drive_by_hand(hall(), Pose2(1.0, 0.0, 0.0))
    assert commands[: round(REACTION / TICK)] == [STOP] * round(REACTION / TICK)
    for a, b in pairwise(commands):
        assert abs(b.v - a.v) <= V_RAMP * TICK + 1e-9
        assert abs(b.w - a.w) <= W_RAMP * TICK + 1e-9


def test_equal_seeds_drive_equally_and_others_do_not() -> None:
    runs = [drive_by_hand(hall(*DOOR), Pose2(1.0, 0.0, 0.3), seed)[0] for seed in (1, 1, 2)]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


PLACES = (
    Segment("D1", ((0.0, -3.0), (5.0, -3.0), (5.0, 3.0), (0.0, 3.0))),
    Segment("A1", ((5.0, -3.0), (12.0, -3.0), (12.0, 3.0), (5.0, 3.0))),
)
CORRIDOR = (Box(5.0, 0.9, 0.0, 9.0, 0.2, 1.0), Box(5.0, -0.9, 0.0, 9.0, 0.2, 1.0))


def test_places_are_found_by_their_polygons() -> None:
    world = hall(segments=PLACES)
    assert segment_at(world, Pose2(2.0, 0.0, 0.0)) is PLACES[0]
    assert segment_at(world, Pose2(8.0, 0.0, 0.0)) is PLACES[1]
    assert segment_at(world, Pose2(20.0, 0.0, 0.0)) is None


def test_an_untroubled_place_is_shown_again_and_a_stuck_one_is_answered_at_once() -> None:
    intervener = Intervener(hall(*CORRIDOR, segments=PLACES))
    pleas = []
    for index, pose in enumerate(straight(0.5, 8.5)):
        if (plea := intervener.watch(index, pose, False, False)) is not None:
            pleas.append(plea)
            intervener.resume(plea, index, pose)
    assert [(p.kind, p.place) for p in pleas] == [("D", "D1")]
    assert pleas[0].start == 0
    stuck_at = index
    for index in range(stuck_at, stuck_at + 200):
        if (plea := intervener.watch(index, pose, False, False)) is not None:
            break
    assert plea is not None
    assert (plea.kind, plea.place) == ("A", "A1")
    assert plea.start <= plea.began - round(LEAD / TICK) or plea.start == intervener._first_tick


def test_a_touch_is_answered_like_trouble_of_type_a() -> None:
    intervener = Intervener(hall(*CORRIDOR, segments=PLACES))
    plea = None
    for index, pose in enumerate(straight(0.5, 1.0)):
        plea = intervener.watch(index, pose, index == 20, index == 20)
    assert plea is not None
    assert (plea.kind, plea.reason) == ("A", "touched something")
