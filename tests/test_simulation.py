"""Laws of the simulation: exact snapshots, contacts, command time-out, the two frames."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twin.records import STOP, Command, Pose2
from twin.robot.odometry import OdometryConfig
from twin.simulation import RobotConfig, Simulation
from twin.world import Box, Cylinder, Rules, World

RULES = Rules("course", 0.5, 20.0)


def make_world(*obstacles: Box | Cylinder, start: Pose2 = Pose2(0.0, 0.0, 0.0)) -> World:  # noqa: B008
    return World("test", obstacles, start, Pose2(start.x + 8.0, start.y, 0.0), RULES)


PILLARS = (Cylinder(2.0, 0.6, 0.075, 0.5), Cylinder(3.0, -0.8, 0.2, 0.5), Box(4.0, 0.2, 0.4, 0.5, 0.3, 0.6))


def drive(simulation: Simulation, ticks: int) -> list[bytes]:
    """A wandering drive; what was seen, byte for byte."""
    seen = []
    for k in range(ticks):
        x = simulation.observe()
        seen.append(x.scan.ranges.tobytes() + x.local_map.cells.tobytes() + simulation.body_poses.tobytes())
        simulation.apply(Command(0.4, math.sin(simulation.time)) if k % 7 else None)
    return seen


def test_a_restored_snapshot_replays_bit_for_bit() -> None:
    simulation = Simulation(make_world(*PILLARS), np.random.default_rng(3))
    drive(simulation, 25)
    snapshot = simulation.snapshot()
    first = drive(simulation, 40)
    simulation.restore(snapshot)
    assert drive(simulation, 40) == first
    assert len(set(first)) == 40


def test_equal_seeds_give_equal_runs_and_other_seeds_do_not() -> None:
    runs = [drive(Simulation(make_world(*PILLARS), np.random.default_rng(seed)), 20) for seed in (1, 1, 2)]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_a_bump_into_a_box_is_a_contact_with_time_place_and_name() -> None:
    simulation = Simulation(make_world(Box(1.0, 0.0, 0.0, 0.2, 2.0, 0.5)), np.random.default_rng(0))
    contact = None
    for _ in range(60):
        contact = contact or simulation.apply(Command(0.5, 0.0))
    assert contact is not None
    # the wheels reach 0.229 m ahead of base_link; the box begins at x = 0.9
    assert contact.time == pytest.approx((0.9 - 0.229) / 0.5, abs=0.3)
    assert contact.x == pytest.approx(0.9, abs=0.03)
    assert contact.obstacle
    assert simulation.clearance < 0.01


def test_driving_on_the_floor_is_no_contact() -> None:
    simulation = Simulation(make_world(), np.random.default_rng(0))
    assert all(simulation.apply(Command(0.8, 0.9)) is None for _ in range(40))
    assert simulation.clearance == math.inf


def test_silence_stops_the_robot_after_the_time_out() -> None:
    simulation = Simulation(make_world(), np.random.default_rng(0))
    for _ in range(20):
        simulation.apply(Command(0.5, 0.0))
    simulation.apply(None)
    assert simulation.observe().twist.v == pytest.approx(0.5, abs=0.05), "the last command still holds"
    for _ in range(10):
        simulation.apply(None)
    assert abs(simulation.observe().twist.v) < 0.02


def test_odom_starts_at_the_robot_with_the_axes_of_the_world() -> None:
    start = Pose2(-2.0, 3.0, 1.57)
    simulation = Simulation(make_world(start=start), np.random.default_rng(0))
    assert simulation.observe().pose == Pose2(0.0, 0.0, 1.57)
    assert (simulation.goal.x, simulation.goal.y) == (8.0, 0.0)
    for _ in range(40):
        simulation.apply(Command(0.5, 0.2))
    truth, odom = simulation.true_pose, simulation.observe().pose
    assert math.hypot(truth.x - start.x - odom.x, truth.y - start.y - odom.y) < 0.05


def test_ideal_odometry_is_the_truth() -> None:
    config = RobotConfig(odometry=OdometryConfig(ideal=True))
    simulation = Simulation(make_world(), np.random.default_rng(0), config)
    for _ in range(30):
        simulation.apply(Command(0.5, 0.5))
    truth, odom = simulation.true_pose, simulation.observe().pose
    # odometry is 10 ms older than the truth at an odd tick end
    assert math.hypot(truth.x - odom.x, truth.y - odom.y) < 0.5 * 0.02
    assert simulation.apply(STOP) is None


def test_an_obstacle_seen_is_marked_where_it_stands() -> None:
    simulation = Simulation(make_world(Box(1.5, 0.0, 0.0, 0.2, 0.6, 0.5)), np.random.default_rng(0))
    local = simulation.observe().local_map
    ys, xs = np.nonzero(local.cells == 254)
    x = local.origin[0] + (xs + 0.5) * local.resolution
    y = local.origin[1] + (ys + 0.5) * local.resolution
    assert len(x) >= 10
    assert np.all(np.abs(x - 1.4) <= 0.05), "the face towards the robot"
    assert np.all(np.abs(y) <= 0.35)


def test_the_clearing_recovery_forgets_what_is_far() -> None:
    world = make_world(Box(2.2, 0.0, 0.0, 0.2, 0.6, 0.5), Cylinder(0.8, 0.5, 0.1, 0.5))
    simulation = Simulation(world, np.random.default_rng(0))
    simulation.observe()
    before = simulation.snapshot().obstacles.local_map.cells
    simulation.apply(STOP, clear_beyond=3.0)
    after = simulation.snapshot().obstacles.local_map.cells
    assert np.count_nonzero(before == 254) > np.count_nonzero(after == 254) > 0
