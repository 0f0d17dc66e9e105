"""Import a scanned room and drive in it: `python examples/scanned_room.py --mesh room.ply --start=1,1,0 --goal=5,3`

Without --mesh it makes a scan of its own: a room with a partition, a table and a shelf, as rough as scans are.
"""

from pathlib import Path

import numpy as np
import trimesh
import tyro

from scenarios import TrialSpec, load_world, one_line_errors, run_trial
from scenarios.report.figures.floor_plan import floor_plan
from scenarios.report.figures.style import BLUE
from twin import Tick

FLOOR, WALL, LEG = 0.05, 0.1, 0.06  # [m] thickness
ROOM = (  # centre x, y, sides x, y, height of the underside, height [m]
    *((3.0, 2.0, 6.2, 4.2, -FLOOR, FLOOR), (3.0, 0.0, 6.2, WALL, 0.0, 1.0), (3.0, 4.0, 6.2, WALL, 0.0, 1.0)),
    *((0.0, 2.0, WALL, 4.0, 0.0, 1.0), (6.0, 2.0, WALL, 4.0, 0.0, 1.0)),
    (2.6, 1.3, WALL, 2.6, 0.0, 1.0),  # the partition
    (4.4, 1.1, 1.0, 0.7, 0.70, 0.04),  # a table top: the robot fits under it
    *((x, y, LEG, LEG, 0.0, 0.70) for x in (3.95, 4.85) for y in (0.8, 1.4)),
    (4.6, 3.75, 1.4, 0.4, 0.0, 0.9),  # a shelf
)


def scan_room(path: Path, roughness: float = 0.004) -> None:
    """Write a triangle mesh in metres, z up, its points `roughness` [m] off as those of a scanner are."""
    parts = []
    for x, y, length, width, bottom, height in ROOM:
        part = trimesh.creation.box((length, width, height)).subdivide_to_size(0.2)
        parts.append(part.apply_translation((x, y, bottom + height / 2)))
    mesh = trimesh.util.concatenate(parts)
    mesh.vertices += np.random.default_rng(0).normal(0.0, roughness, mesh.vertices.shape)
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path)


def main(mesh: Path | None = None, start: str = "1,1,0", goal: str = "5,3", plot: Path = Path("out/room.png")) -> None:
    """Drive from `start` (x,y,yaw) to `goal` (x,y) in metres and radians, and plot the path over the scan."""
    if mesh is None:
        scan_room(mesh := plot.with_suffix(".ply"))
    world, ticks = load_world(str(mesh), start=start, goal=goal), list[Tick]()
    result = run_trial(TrialSpec(str(mesh)), world, ticks.append)
    print(f"{mesh}: {world.note}")
    print(f"{result.outcome} after {result.time:.2f} s, closest {result.min_clearance:.2f} m")
    with floor_plan(world) as (figure, axes):
        axes.plot([t.true_pose.x for t in ticks], [t.true_pose.y for t in ticks], color=BLUE, linewidth=2.2)
        axes.set_title(f"{mesh.name}: {result.outcome} after {result.time:.1f} s")
    plot.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(plot, dpi=150, bbox_inches="tight")
    print(f"plot: {plot}")


if __name__ == "__main__":
    with one_line_errors():
        tyro.cli(main)
