"""LaserScan messages of any planar lidar as the scans that the twin and the learned policies know.

Those have 720 beams over 270 degrees, right to left. A lidar that sees at least that much is resampled: every wanted
beam takes the nearest one that was measured. Nothing is averaged: no range is invented between an edge and what is
behind it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenarios.bags.files import BagError
from scenarios.bags.frames import Placement
from twin.records import Array, Scan, frozen_array
from twin.robot.lidar import LidarConfig

SENSOR = LidarConfig()
WANTED = np.linspace(-SENSOR.angle, SENSOR.angle, SENSOR.beams)  # (720,) [rad]
SAME = 1e-4  # [rad] geometries that differ by less are one: the fields of a LaserScan are float32
COARSEST = math.radians(2.0)  # between beams; at 2.5 m, where obstacles begin to count, these are 9 cm or two cells


@dataclass(slots=True)
class ScanReader:
    """Turns the messages of one topic into scans; remembers how the beams of the last geometry map."""

    topic: str
    placement: Placement  # of the lidar on the robot
    _geometry: tuple[float, ...] = ()
    _beams: NDArray[np.intp] | None = field(default=None)

    def scan(self, sent: Any) -> Scan:
        """Raises BagError, without saying when, for a scan that cannot be used."""
        ranges = np.asarray(sent.ranges, dtype=np.float64)
        geometry = (len(ranges), float(sent.angle_min), float(sent.angle_increment))
        if geometry != self._geometry:
            self._geometry, self._beams = geometry, self._choose(*geometry)
        near, far = decimal(sent.range_min), decimal(sent.range_max)
        if not 0.0 <= near < far < math.inf:
            raise BagError(f"{self.topic} says that it measures from {near:g} to {far:g} m")
        if broken := int(np.isnan(ranges).sum()):
            raise BagError(
                f"{self.topic} has {broken} ranges that are no number (NaN); filter them, or put inf for no return"
            )
        if self._beams is not None:
            ranges = ranges[self._beams]
        ranges = np.where((ranges < near) | (ranges > far), np.inf, ranges)
        return Scan(frozen_array(ranges), -SENSOR.angle, SENSOR.angle, near, far, self.placement.position)

    def _choose(self, count: int, first: float, step: float) -> NDArray[np.intp] | None:
        """For every wanted beam the index of the nearest measured one; None where they are the same."""
        if count < 2 or not math.isfinite(first) or not math.isfinite(step) or step == 0.0:
            raise BagError(f"{self.topic} has {count} beams {step:g} rad apart, which is no sweep")
        measured = self.placement.bearings(first + step * np.arange(count, dtype=np.float64))
        if count == SENSOR.beams and np.abs(measured - WANTED).max() < SAME:
            return None
        nearest, off = nearest_beams(measured)
        if abs(step) > COARSEST:
            raise BagError(
                f"{self.topic} has a beam every {math.degrees(abs(step)):.1f} degrees; 2 are too few already"
            )
        if off.max() > 0.75 * abs(step):
            seen = [math.degrees(a) for a in (measured.min(), measured.max())]
            raise BagError(
                f"{self.topic} sees from {seen[0]:.0f} to {seen[1]:.0f} degrees; "
                "a policy needs a lidar that sees from -135 to 135"
            )
        return nearest


def nearest_beams(measured: Array) -> tuple[NDArray[np.intp], Array]:
    """For every wanted beam the index of the nearest of the measured bearings [rad], and how far off that is [rad]."""
    turned = np.mod(measured, math.tau)
    order = np.argsort(turned, kind="stable")
    ring = np.concatenate([[turned[order[-1]] - math.tau], turned[order], [turned[order[0]] + math.tau]])
    wanted = np.mod(WANTED, math.tau)
    above = np.clip(np.searchsorted(ring, wanted), 1, len(ring) - 1)
    pick = np.where(wanted - ring[above - 1] <= ring[above] - wanted, above - 1, above)
    return order[(pick - 1) % len(order)], np.abs(ring[pick] - wanted)


def decimal(value: float) -> float:
    """What a float32 was before it became one, if that was a short decimal: 0.1 and not 0.10000000149."""
    return float(str(np.float32(value)))
