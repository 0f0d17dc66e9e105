"""A triangle mesh as boxes: what the robot can bump into, at its own height."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from twin.records import Array
from twin.world import Box, Mesh

CELL: Final = 0.05  # [m] grid of the columns, the costmap's own resolution; contact is up to one cell early
BAND: Final = (0.04, 0.26)  # [m] heights that matter: above the unevenness of a scanned floor, below the chassis' top
STEP: Final = 0.05  # [m] heights are widened to multiples of this, so that neighbouring cells merge


def mesh_columns(mesh: Mesh) -> list[Box]:
    """Boxes over every cell in which the mesh has surface inside `BAND`, merged into long ones."""
    points = surface_points(mesh.vertices, mesh.faces, CELL / 4)
    points = points[(points[:, 2] >= BAND[0]) & (points[:, 2] <= BAND[1])]
    if not len(points):
        return []
    cells = np.floor(points[:, :2] / CELL).astype(np.int64)
    occupied, where = np.unique(cells, axis=0, return_inverse=True)
    low = np.full(len(occupied), np.inf)
    high = np.full(len(occupied), -np.inf)
    np.minimum.at(low, where, np.floor(points[:, 2] / STEP) * STEP)
    np.maximum.at(high, where, np.ceil(points[:, 2] / STEP) * STEP)
    return [
        Box(
            x=CELL * (i0 + i1) / 2,
            y=CELL * (j0 + j1) / 2,
            yaw=0.0,
            length=CELL * (i1 - i0),
            width=CELL * (j1 - j0),
            height=top - bottom,
            bottom=bottom,
            style=mesh.style,
        )
        for i0, i1, j0, j1, bottom, top in _merge(occupied, np.round(np.column_stack([low, high]), 6))
    ]


def surface_points(vertices: Array, faces: NDArray, spacing: float) -> Array:  # type: ignore[type-arg]
    """(k, 3) points on every triangle, no farther apart than `spacing` [m]."""
    corners = np.asarray(vertices, dtype=np.float64)[faces]  # (m, 3, 3)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    splits = np.maximum(1, np.ceil(longest / spacing)).astype(int)
    parts = [np.empty((0, 3))]
    for n in np.unique(splits).tolist():
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        inside = i + j <= n
        weights = np.column_stack([i[inside], j[inside], n - i[inside] - j[inside]]) / n  # (w, 3) barycentric
        parts.append(np.einsum("wc,mcd->mwd", weights, corners[splits == n]).reshape(-1, 3))
    return np.vstack(parts)


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
