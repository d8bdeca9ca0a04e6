"""Reference points around others, kept up to date while references are added: one in each of four quadrants, or the nearest."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np

from ..core.compilation import bucket
from ..core.grid import Grid, grid_over
from ..host.neighbours import nearest, tree_of
from ..ops.planes import fit_planes
from ..ops.quadrants import Buckets, Nearest, nearest_in_quadrants

_BLOCK = 1 << 15  # queries per call
_AHEAD = 2  # calls that are started before the first of them is waited for
_NEAR = 6  # cells that the first search reaches
_FAR = 32  # cells that the second reaches at most


class NearestReferences:
    """The four reference points nearest to every query point, in x and y, wherever they lie.

    Attributes:
        row: i32[q, 4], rows of ``xyz``; -1 where there are no more.
        square: f32[q, 4], squared distances, m2; ``reach`` squared where there are no more.
    """

    def __init__(self, xyz: np.ndarray, query: np.ndarray, reach: float) -> None:
        """No references yet.

        Args:
            xyz: f32[m, >=2], all points, local metres.
            query: i64[q], rows to find references for, ascending.
            reach: metres, of the search.
        """
        self._xy = np.ascontiguousarray(xyz[:, :2])
        self._query, self._reach = query, reach
        self.row = np.full((len(query), 4), -1, np.int32)
        self.square = np.full((len(query), 4), np.float32(reach) ** 2, np.float32)

    def keep(self, kept: np.ndarray) -> None:
        """Go on with some of the query points only, bool[q]."""
        self._query, self.row, self.square = self._query[kept], self.row[kept], self.square[kept]

    def add(self, references: np.ndarray, workers: int | None = None) -> np.ndarray:
        """Take in more references, ascending i64[r]. Returns bool[q]: whose nearest have changed.

        Of equally near points those that were taken in before stay.
        """
        if len(references) == 0:
            return np.zeros(len(self._query), bool)
        tree = tree_of(self._xy[references])
        distance, index = nearest(tree, self._xy[self._query], 4, self._reach, workers)
        found = np.isfinite(distance)
        row = np.hstack([self.row, np.where(found, np.append(references, -1)[index], -1).astype(np.int32)])
        square = np.hstack([self.square, np.where(found, distance, self._reach).astype(np.float32) ** 2])
        first = np.argsort(square, axis=1, kind="stable")[:, :4]
        before = self.row
        self.row, self.square = (np.take_along_axis(a, first, axis=1) for a in (row, square))
        return (self.row != before).any(axis=1)


class QuadrantReferences(NearestReferences):
    """The nearest reference point in each quadrant around every query point, in x and y (Cai et al. 2023, eq. 3).

    Attributes:
        row: i32[q, 4], rows of ``xyz``, counter-clockwise from the north-east; -1 where a quadrant is empty.
        square: f32[q, 4], squared distances, m2; ``reach`` squared where a quadrant is empty.
    """

    def __init__(self, xyz: np.ndarray, query: np.ndarray, side: float, reach: float) -> None:
        """No references yet.

        Args:
            xyz: f32[m, >=2], all points, local metres.
            query: i64[q], rows to find references for, ascending; neighbours should follow each other.
            side: metres; of the grid cells of the first search, about the distance between references.
            reach: metres, of the search.
        """
        super().__init__(xyz, query, reach)
        wide = max(side, reach / _FAR)
        name = "cell of the search for references"
        self._searches = [(grid_over(xyz, side, name=name), _NEAR)]
        self._searches.append((grid_over(xyz, wide, name=name), math.ceil(reach / wide - 1e-6)))

    def add(self, references: np.ndarray, workers: int | None = None) -> np.ndarray:
        """Take in more references, ascending i64[r]. Returns bool[q]: whose nearest have changed.

        The first search reaches six cells. The few queries with a quadrant that is still empty, or filled from farther
        away, search again up to ``reach``.
        """
        changed = np.zeros(len(self._query), bool)
        if len(references) == 0:
            return changed
        todo = np.arange(len(self._query))
        if len(references) < len(todo):
            farthest = np.sqrt(self.square.max(axis=1, initial=0))
            distance = nearest(tree_of(self._xy[references]), self._xy[self._query], 1, self._reach, workers)[0][:, 0]
            todo = np.flatnonzero(distance <= farthest)
        for grid, radius in self._searches:
            if len(todo) == 0:
                break
            buckets = self._buckets(references, grid)
            parts = [todo[start : start + _BLOCK] for start in range(0, len(todo), _BLOCK)]
            under_way: list[tuple[np.ndarray, Nearest]] = []
            for part in parts:
                under_way.append((part, self._search(buckets, grid, part, radius)))
                if len(under_way) > _AHEAD:
                    self._take(*under_way.pop(0), changed)
            for search in under_way:
                self._take(*search, changed)
            todo = todo[(self.square[todo] > (radius * grid.cell) ** 2).any(axis=1)]
        return changed

    def _search(self, buckets: Buckets, grid: Grid, part: np.ndarray, radius: int) -> Nearest:
        """Start the search for the queries i64[p]; padded to a block."""
        n = len(part)
        query, home = np.zeros((_BLOCK, 2), np.float32), np.zeros(_BLOCK, np.int32)
        row = np.full((_BLOCK, 4), -1, np.int32)
        square = np.zeros((_BLOCK, 4), np.float32)
        query[:n], row[:n], square[:n] = self._xy[self._query[part]], self.row[part], self.square[part]
        home[:n] = grid.flat(query[:n])
        known = Nearest(jnp.asarray(row), jnp.asarray(square))
        return nearest_in_quadrants(buckets, jnp.asarray(query), jnp.asarray(home), known, radius)

    def _take(self, part: np.ndarray, found: Nearest, changed: np.ndarray) -> None:
        """Wait for a search and take over what it found; mark the queries that have nearer references now."""
        n = len(part)
        row = np.asarray(found.row)[:n]
        changed[part] |= (self.row[part] != row).any(axis=1)
        self.row[part], self.square[part] = row, np.asarray(found.square)[:n]

    def _buckets(self, references: np.ndarray, grid: Grid) -> Buckets:
        cell = grid.flat(self._xy[references])
        order = np.argsort(cell, kind="stable")
        size, cells = bucket(len(self._xy)), grid.nx * grid.ny
        xy = np.zeros((size, 2), np.float32)
        row = np.zeros(size, np.int32)
        start = np.full(bucket(cells) + 1, len(references), np.int32)
        xy[: len(order)] = self._xy[references[order]]
        row[: len(order)] = references[order]
        start[0] = 0
        np.cumsum(np.bincount(cell, minlength=cells), out=start[1 : cells + 1])
        extent = np.asarray(grid.shape, np.int32)
        return Buckets(*map(jnp.asarray, (xy, row, start, np.float32(grid.cell), extent)))


def local_planes(xyz: np.ndarray, query: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points against the least-squares plane through their references (Cai et al. 2023, Sec. 2.5).

    With fewer than three references, or with all on a line, the plane is the horizontal one through the nearest. Without
    any, the answers are NaN.

    Args:
        xyz: f32[m, 3], local metres; query: i64[q], rows of the points; row: i32[q, 4], of their references, -1 for none.

    Returns: f32[q] each: distance along the normal and height, metres, negative below the plane; slope, degrees.
    """
    out = np.empty((3, len(query)), np.float32)
    for start in range(0, len(query), _BLOCK):
        part = slice(start, start + _BLOCK)
        n = len(query[part])
        reference, known = np.zeros((_BLOCK, 4, 3), np.float32), np.zeros((_BLOCK, 4), bool)
        reference[:n] = xyz[row[part]] - xyz[query[part]][:, None]
        known[:n] = row[part] >= 0
        out[:, part] = np.asarray(_plane_below(reference, known))[:, :n]
    return out[0], out[1], out[2]


@jax.jit
def _plane_below(reference: jax.Array, known: jax.Array) -> jax.Array:
    """f32[3, q]: distance, height and slope of the plane through f32[q, 4, 3], for a point at the origin."""
    planes = fit_planes(reference, known)
    square = jnp.where(known, (reference[..., :2] ** 2).sum(axis=-1), jnp.inf)
    nearest_one = jnp.take_along_axis(reference, jnp.argmin(square, axis=1)[:, None, None], axis=1)[:, 0]
    planes = planes._replace(centre=jnp.where(planes.determined[:, None], planes.centre, nearest_one))
    distance = -(planes.centre * planes.normal).sum(axis=1)
    answers = jnp.stack([distance, distance / planes.normal[:, 2], planes.slope])
    return jnp.where(known.any(axis=1), answers, jnp.nan)
