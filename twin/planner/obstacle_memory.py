"""What a robot remembers of its scans: the obstacle layers of both costmaps, fed together.

The twin's simulation and the replay of a bag both go through here, so that equal scans leave equal maps.
"""

from __future__ import annotations

from dataclasses import dataclass

from twin.planner.obstacle_layer import GLOBAL_MAP, LOCAL_MAP, clear_outside, empty_map, scan_points, update_obstacles
from twin.records import ObstacleMap, Pose2, Scan


@dataclass(frozen=True, slots=True)
class ObstacleMemory:
    """Both obstacle maps after some scan."""

    local_map: ObstacleMap
    global_map: ObstacleMap


def no_obstacles() -> ObstacleMemory:
    """Before the first scan."""
    return ObstacleMemory(empty_map(LOCAL_MAP), empty_map(GLOBAL_MAP))


def remember(memory: ObstacleMemory, scan: Scan, pose: Pose2, taken_at: Pose2 | None = None) -> ObstacleMemory:
    """The maps after one update by `scan`, with the robot at `pose` (odom_from_base).

    `taken_at` is where the robot was when the scan was taken (`costmap_2d::ObservationBuffer` places each scan by tf at
    its own stamp); without it, scan and update are one instant, as in the twin.
    """
    points, sensor = scan_points(scan, pose if taken_at is None else taken_at)
    return ObstacleMemory(
        update_obstacles(memory.local_map, LOCAL_MAP, points, sensor, pose),
        update_obstacles(memory.global_map, GLOBAL_MAP, points, sensor, pose),
    )


def forget_beyond(memory: ObstacleMemory, pose: Pose2, side: float) -> ObstacleMemory:
    """The clearing recovery: both maps forget what lies outside a square of that side [m] round the robot."""
    return ObstacleMemory(
        clear_outside(memory.local_map, pose, side),
        clear_outside(memory.global_map, pose, side),
    )
