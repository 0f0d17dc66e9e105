"""The boxes that stand for a mesh (a scanned room) in contact: what its surface occupies at the robot's height.

MuJoCo collides with a mesh's convex hull, which for a room is a solid block.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from twin.records import Array
from twin.world import Box, Mesh

COLUMN: Final = (
    0.05  # [m] cell of a mesh's contact boxes, the costmap's own resolution; contact is up to one cell early
)
BAND: Final = (
    0.04,
    0.26,
)  # [m] heights that can be bumped into: above a scanned floor's unevenness, below the chassis' top
RISE: Final = 0.05  # [m] the boxes' heights are widened to multiples of this, so that neighbours merge


def mesh_columns(mesh: Mesh) -> list[Box]:
    """Boxes over every cell in which the mesh has surface inside `BAND`, merged into long ones."""
    points = np.vstack([np.empty((0, 3)), *_surface_points(mesh, COLUMN / 2)])
    if not len(points):
        return []
    cells = np.floor(points[:, :2] / COLUMN).astype(np.int64)
    occupied, where = np.unique(cells, axis=0, return_inverse=True)
    low = np.full(len(occupied), np.inf)
    high = np.full(len(occupied), -np.inf)
    np.minimum.at(low, where, np.floor(points[:, 2] / RISE) * RISE)
    np.maximum.at(high, where, np.ceil(points[:, 2] / RISE) * RISE)
    return [
        Box(
            x=COLUMN * (i0 + i1) / 2,
            y=COLUMN * (j0 + j1) / 2,
            yaw=0.0,
            length=COLUMN * (i1 - i0),
            width=COLUMN * (j1 - j0),
            height=top - bottom,
            bottom=bottom,
            style=mesh.style,
        )
        for i0, i1, j0, j1, bottom, top in _merge(occupied, np.round(np.column_stack([low, high]), 6))
    ]


def _surface_points(mesh: Mesh, spacing: float) -> Iterator[Array]:
    """Points (k, 3) [m] inside `BAND`, no farther apart on the surface than `spacing`, some triangles at a time."""
    corners = np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces]  # (m, 3, 3)
    heights = corners[:, :, 2]
    corners = corners[
        (heights.max(axis=1, initial=-np.inf) >= BAND[0]) & (heights.min(axis=1, initial=np.inf) <= BAND[1])
    ]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    splits = np.maximum(1, np.ceil(longest / spacing)).astype(int)
    for n in np.unique(splits).tolist():
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        inside = i + j <= n
        weights = np.column_stack([i[inside], j[inside], n - i[inside] - j[inside]]) / n  # (w, 3) barycentric
        alike = corners[splits == n]
        for chunk in np.array_split(alike, math.ceil(len(alike) * len(weights) / 1_000_000)):
            points = np.einsum("wc,mcd->mwd", weights, chunk).reshape(-1, 3)
            yield points[(points[:, 2] >= BAND[0]) & (points[:, 2] <= BAND[1])]


def _merge(cells: NDArray[np.int64], heights: Array) -> list[tuple[int, int, int, int, float, float]]:
    """Cells (k, 2) of equal heights (k, 2) joined to rectangles: i0, i1, j0, j1 [cells, half open], bottom, top [m]."""
    order = np.lexsort((cells[:, 0], cells[:, 1], heights[:, 1], heights[:, 0]))
    rows = [(*cells[k].tolist(), *heights[k].tolist()) for k in order]
    breaks = [0, *(k for k, (a, b) in enumerate(pairwise(rows), 1) if b != (a[0] + 1, *a[1:])), len(rows)]
    runs = sorted(  # along x; sorted so that equal spans of neighbouring rows follow each other
        ((rows[a][0], rows[b - 1][0] + 1, *rows[a][2:], rows[a][1]) for a, b in pairwise(breaks)),
    )
    merged: list[tuple[int, int, int, int, float, float]] = []
    for i0, i1, bottom, top, j in runs:
        if merged and merged[-1][:2] == (i0, i1) and merged[-1][3:] == (j, bottom, top):
            merged[-1] = (i0, i1, merged[-1][2], j + 1, bottom, top)
        else:
            merged.append((i0, i1, j, j + 1, bottom, top))
    return merged
