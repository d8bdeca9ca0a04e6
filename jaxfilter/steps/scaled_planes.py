"""Planes that describe the terrain at several scales: detected in cells that are divided where a plane does not do."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import numpy as np

from ..core.grid import grid_over
from ..core.points import Points
from .consensus import batches, cells_of, consensus_planes, rows_of


@dataclasses.dataclass(frozen=True, eq=False)
class ScaledPlanes:
    """Every point against the plane that was accepted for the cell it lies in; NaN where there is none.

    Attributes:
        distance: f32[m], metres along the normal, negative below the plane; height: f32[m], metres upward.
        slope: f32[m], degrees.
        size: f32[m], metres: side of the cell that the plane was accepted for.
        accepted: planes; divided: cells whose plane was not reliable.
    """

    distance: np.ndarray
    height: np.ndarray
    slope: np.ndarray
    size: np.ndarray
    accepted: int
    divided: int


class PlaneSearch(NamedTuple):
    """What planes are searched for.

    Attributes:
        cell: metres, of the first cells; they start at the cloud's corner or at multiples from its anchor.
        min_points: interior points of a plane; a cell with fewer has none.
        inlier_distance: metres, of interior points from their plane.
        division_distance: metres. A cell is divided if a point of it lies so far or farther below its plane.
        max_slope: degrees, of the planes.
    """

    cell: float
    min_points: int
    inlier_distance: float
    division_distance: float
    max_slope: float


def progressive_planes(points: Points, counted: np.ndarray, draws: jax.Array, search: PlaneSearch) -> ScaledPlanes:
    """Progressive RANSAC plane detection (Cai et al. 2023, Sec. 2.4).

    A cell that is divided gives four, each with a plane of its own.

    Args:
        counted: bool[m], the points that planes are fitted to; all are compared with the planes.
        draws: f32[hypotheses, 3] in [0, 1), see :func:`jaxfilter.steps.consensus.consensus_planes`.

    Raises: InputError if the extent needs too many cells.
    """
    cell, min_points, inlier_distance, division_distance, max_slope = search
    xyz = points.xyz
    distance, height, slope, side = (np.full(len(xyz), np.nan, np.float32) for _ in range(4))
    rows, accepted, divided = np.arange(len(xyz)), 0, 0
    size = rows_of(len(xyz))
    while True:
        grid = grid_over(xyz, cell, points.offset(cell), "cell of the planes")
        at = grid.flat(xyz[rows])
        fitted = counted[rows]
        order = np.lexsort((*xyz[rows[fitted]].T[::-1], at[fitted]))  # hypotheses go by x, y and z
        owner, members = at[fitted][order], rows[fitted][order]
        cells, count = np.unique(owner, return_counts=True)
        enough = count >= min_points
        if not enough.any():
            return ScaledPlanes(distance, height, slope, side, accepted, divided)
        members = members[np.repeat(enough, count)]
        cells, start = cells[enough], np.append(0, np.cumsum(count[enough]))
        parts = []
        for part in batches(start, size):
            ends = start[part.start : part.stop + 1]
            some = cells_of(xyz[members[ends[0] : ends[-1]]], ends - ends[0], size)
            found = consensus_planes(some, draws, inlier_distance, max_slope)
            parts.append([np.asarray(a)[: len(ends) - 1] for a in found])
        centre, normal, inliers, below = (np.concatenate(a) for a in zip(*parts, strict=True))
        centre = centre + xyz[members[start[:-1]]]
        plane = inliers >= min_points
        reliable = plane & (below < division_distance)
        accepted, divided = accepted + int(reliable.sum()), divided + int((plane & ~reliable).sum())

        which = np.full(grid.nx * grid.ny, -1)
        which[cells[reliable]] = np.flatnonzero(reliable)
        i, own = rows[which[at] >= 0], which[at][which[at] >= 0]
        distance[i] = np.einsum("ni,ni->n", xyz[i] - centre[own], normal[own])
        height[i] = distance[i] / normal[own, 2]
        slope[i] = np.rad2deg(np.arccos(np.clip(normal[own, 2], 0, 1)))
        side[i] = cell
        divide = np.zeros(grid.nx * grid.ny, bool)
        divide[cells[plane & ~reliable]] = True
        rows = rows[divide[at]]
        if len(rows) == 0:
            return ScaledPlanes(distance, height, slope, side, accepted, divided)
        cell /= 2
