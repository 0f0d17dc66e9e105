"""Scans of other lidars become the 720 beams over 270 degrees of the twin's."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from scenarios.bags.files import BagError, message
from scenarios.bags.frames import Placement
from scenarios.bags.scans import WANTED, ScanReader, decimal, nearest_beams


def sweep(angles: np.ndarray, ranges: np.ndarray | None = None) -> Any:
    """A LaserScan with beams at evenly spaced angles; without ranges each says its own bearing [rad] plus ten."""
    ranges = angles + 10.0 if ranges is None else ranges
    header = message("std_msgs/msg/Header", message("builtin_interfaces/msg/Time", 0, 0), "laser")
    step = float(angles[1] - angles[0])
    return message(
        "sensor_msgs/msg/LaserScan", header, float(angles[0]), float(angles[-1]), step, 0.0, 0.05, 0.1, 30.0,
        ranges.astype(np.float32), np.empty(0, np.float32),
    )  # fmt: skip


LIDARS = {
    "1081 beams over 270 degrees": np.linspace(-2.356194, 2.356194, 1081),
    "541 beams over 270 degrees": np.linspace(-2.356194, 2.356194, 541),
    "1440 beams all around": np.linspace(-math.pi, math.pi, 1440),
    "360 beams all around, from 0": np.radians(np.arange(360.0)),
    "720 beams, left to right": np.linspace(2.35619, -2.35619, 720),
}


@pytest.mark.parametrize("angles", LIDARS.values(), ids=LIDARS.keys())
def test_every_beam_is_the_nearest_of_those_measured(angles: np.ndarray) -> None:
    scan = ScanReader("/scan", Placement((0.1, 0.0, 0.2))).scan(sweep(angles))
    measured = np.remainder(scan.ranges - 10.0 + math.pi, math.tau) - math.pi
    off = np.abs(np.remainder(measured - WANTED + math.pi, math.tau) - math.pi)
    assert off.max() <= 0.75 * abs(angles[1] - angles[0])
    assert (len(scan.ranges), scan.range_min, scan.mount) == (720, 0.1, (0.1, 0.0, 0.2))


def test_nearest_means_nearest() -> None:
    rng = np.random.default_rng(0)
    measured = np.sort(rng.uniform(-math.pi, math.pi, 500))
    beams, off = nearest_beams(measured)
    distance = np.abs(np.remainder(measured - WANTED[:, None] + math.pi, math.tau) - math.pi)
    assert np.allclose(off, distance.min(axis=1))
    assert np.allclose(distance[np.arange(720), beams], distance.min(axis=1))


@pytest.mark.parametrize(("yaw", "upside_down"), [(math.pi, False), (0.3, False), (0.0, True), (math.pi / 2, True)])
def test_a_turned_lidar_sees_the_same_room(yaw: float, upside_down: bool) -> None:
    """A room in which a range depends on the bearing in base_link only."""
    own = np.linspace(-math.pi, math.pi, 2000)  # the lidar's own angles
    towards = yaw + (-own if upside_down else own)
    scan = ScanReader("/scan", Placement((0.0, 0.0, 0.2), yaw, upside_down)).scan(sweep(own, 5.0 + np.cos(towards)))
    assert np.abs(scan.ranges - 5.0 - np.cos(WANTED)).max() < 0.005


def test_what_is_out_of_range_is_no_return() -> None:
    ranges = np.full(720, 5.0)
    ranges[:6] = 0.0, 0.05, 0.1, 30.0, 30.5, -np.inf
    scan = ScanReader("/scan", Placement((0.0, 0.0, 0.0))).scan(sweep(WANTED, ranges))
    assert scan.ranges[:6].tolist() == pytest.approx([math.inf, math.inf, 0.1, 30.0, math.inf, math.inf])
    assert decimal(np.float32(0.1)) == 0.1


@pytest.mark.parametrize(
    ("scan", "words"),
    [
        (sweep(np.linspace(-1.57, 1.57, 720)), "sees from -90 to 90 degrees"),
        (sweep(np.linspace(-2.35619, 2.35619, 90)), "too few"),
        (sweep(WANTED, np.full(720, np.nan)), "720 ranges that are no number"),
        (dataclasses.replace(sweep(WANTED), angle_increment=0.0), "no sweep"),
        (dataclasses.replace(sweep(WANTED), range_max=math.inf), "measures from"),
    ],
)
def test_useless_scans_are_refused(scan: Any, words: str) -> None:
    with pytest.raises(BagError, match=words):
        ScanReader("/scan", Placement((0.0, 0.0, 0.0))).scan(scan)
