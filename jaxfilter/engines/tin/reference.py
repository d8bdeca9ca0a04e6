"""The reference: triangulations that SciPy makes anew from all vertices of a sheet whenever some of these come or go.

They have the tables of :class:`jaxfilter.engines.tin.triangulation.Tin`, so that the same loop grows over them. Qhull computes
in floating point. Where four vertices lie on a circle, it takes either diagonal; a point on an edge is found on either side.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...core.errors import ParameterError
from .triangulation import Tin, lattice

if TYPE_CHECKING:
    from scipy.spatial import Delaunay


class _Sheet(NamedTuple):
    """A sheet as SciPy triangulates it.

    Attributes:
        delaunay: of positions in steps of the lattice from ``middle``, i32[2], so that they have few digits.
        rows: i32[t], numbers in the tables: of its triangles, then of the ghosts beyond its hull.
        hull: f64[h, 2, 2], begin and end of the edge of each ghost; the sheet is to the left.
    """

    delaunay: Delaunay
    middle: np.ndarray
    rows: np.ndarray
    hull: np.ndarray

    def find(self, xy: np.ndarray) -> np.ndarray:
        """i32[n]: the triangles that contain positions i32[n, 2], outside the ghosts of the nearest edges in sight."""
        at, (begin, end) = (xy - self.middle).astype(np.float64), np.moveaxis(self.hull, 1, 0)
        found = self.delaunay.find_simplex(at).astype(np.int64)
        outside = np.flatnonzero(found < 0)
        (x, y), (u, v) = np.moveaxis(at[outside, None] - begin, 2, 0), (end - begin).T
        along = np.clip((x * u + y * v) / (u * u + v * v), 0.0, 1.0)
        square, hidden = (x - along * u) ** 2 + (y - along * v) ** 2, u * y - v * x >= 0
        nearest = square == square.min(axis=1, keepdims=True)  # of two that share an end, the one that begins there
        found[outside] = len(self.delaunay.simplices) + np.where(nearest, along + 2 * hidden, np.inf).argmin(axis=1)
        return self.rows[found]


class SciPyTin(Tin):
    """Triangulations by SciPy. A triangle keeps its number while its three vertices make one; all others count as changed."""

    _sheets: Mapping[int, _Sheet] = {}
    _watched = np.zeros(0, np.int64)

    def insert(self, nodes: np.ndarray) -> None:
        self.vertex[nodes] = True
        self._triangulate(self.sheet[nodes])

    def remove(self, nodes: np.ndarray) -> None:
        self.vertex[nodes] = False
        self._triangulate(self.sheet[nodes])

    def locate(self, nodes: np.ndarray) -> None:
        if self._sheets:  # not before the first of them
            nodes = nodes[~self.vertex[nodes]]  # vertices have a triangle of their own
            self.where[nodes] = self._find(self.xy[nodes], self.sheet[nodes])

    def walk(self, xy: np.ndarray, start: np.ndarray) -> np.ndarray:
        rows = self._find(lattice(xy), self.sheet[self.triangles[start].max(axis=1)])
        return np.where(self.triangles[rows, 0] < 0, -1 - self.neighbours[rows, 0], rows)

    def twins(self, nodes: np.ndarray) -> np.ndarray:
        step = np.diff(np.column_stack([self.xy, self.sheet]), axis=0, prepend=-1)
        place = np.cumsum(step.any(axis=1)) - 1  # nodes at one position follow each other
        vertices, twin = np.flatnonzero(self.vertex), np.full(len(place), -1)
        twin[place[vertices]] = vertices
        return twin[place[nodes]]

    def changed(self, nodes: np.ndarray) -> np.ndarray:
        watched = np.union1d(self._watched, nodes)
        self.locate(watched)
        new = self.stamp[self.where[watched]] == self.now
        self._watched = watched[~new]
        return watched[new]

    def _find(self, xy: np.ndarray, sheet: np.ndarray) -> np.ndarray:
        """i32[n]: the triangles that contain positions i32[n, 2] in sheets i32[n]."""
        out = np.empty(len(xy), np.int32)
        for number in np.unique(sheet):
            part = np.flatnonzero(sheet == number)
            out[part] = self._sheets[number].find(xy[part])
        return out

    def _triangulate(self, sheets: np.ndarray) -> None:
        """Make these sheets, i32[.], anew; the first time all."""
        numbers = np.unique(sheets) if self._sheets else range(len(self._hull))
        self._sheets = {**self._sheets, **{number: self._one_sheet(number) for number in numbers}}

    def _one_sheet(self, number: int) -> _Sheet:
        """Triangulate the vertices of a sheet, and bring the tables up to date."""
        from scipy.spatial import Delaunay

        nodes = np.flatnonzero(self.vertex & (self.sheet == number))
        middle = self.xy[nodes].min(axis=0) // 2 + self.xy[nodes].max(axis=0) // 2
        made = Delaunay((self.xy[nodes] - middle).astype(np.float64))
        made._transform = _barycentric(made.points[made.simplices])  # SciPy's calls of LAPACK take many times as long
        if len(made.coplanar):
            lost = f"Qhull leaves out {len(made.coplanar):,} vertices, whose distances are beyond double precision"
            raise ParameterError(f"triangulation='scipy': {lost}; use triangulation='own'")
        row, k = np.nonzero(made.neighbors < 0)
        begin, end = (made.simplices[row, (k + step) % 3] for step in (1, 2))
        ghost, (starts, ends) = len(made.simplices) + np.arange(len(row)), np.empty((2, len(nodes)), np.int64)
        starts[begin], ends[end] = ghost, ghost
        inner = made.neighbors.copy()
        inner[row, k] = ghost
        beside = np.concatenate([inner, np.column_stack([row, ends[begin], starts[end]])])
        outer = np.column_stack([np.full(len(row), self._walks.NOWHERE), nodes[end], nodes[begin]])
        corner = np.concatenate([nodes[made.simplices], outer])
        turn = (corner.argmin(axis=1)[:, None] + np.arange(3)) % 3  # the first node comes first
        corner, beside = (np.take_along_axis(table, turn, axis=1) for table in (corner, beside))
        rows = self._numbers(number, corner)
        self.triangles[rows], self.neighbours[rows] = corner, rows[beside]
        self.where[nodes], self._hull[number] = rows[made.vertex_to_simplex], len(row)
        return _Sheet(made, middle, rows, made.points[np.column_stack([begin, end])])

    def _numbers(self, number: int, corner: np.ndarray) -> np.ndarray:
        """i32[t]: numbers for triangles with corners i64[t, 3]. Those that were there keep theirs, the others change now."""
        old = self._sheets[number].rows if self._sheets else np.arange(4 * number, 4 * number + 4, dtype=np.int32)
        key, known = (table[:, 0].astype(np.int64) << 32 | table[:, 1] for table in (corner, self.triangles[old]))
        _, new, same = np.intersect1d(key, known, assume_unique=True, return_indices=True)
        stays = self.triangles[old[same], 2] == corner[new, 2]
        rows, gone = np.full(len(corner), -1, np.int32), np.delete(old, same[stays])
        rows[new[stays]] = old[same[stays]]
        self.triangles[gone], self.stamp[gone] = self._walks.DEAD, self.now
        self._unused = np.concatenate([gone, self._unused])
        fresh = np.flatnonzero(rows < 0)
        free = self._fresh(-(-len(fresh) // 2)).ravel()
        rows[fresh], self._unused = free[: len(fresh)], np.concatenate([free[len(fresh) :], self._unused])
        self.stamp[rows[fresh]] = self.now
        return rows


def _barycentric(corner: np.ndarray) -> np.ndarray:
    """f64[t, 3, 2], contiguous: ``Delaunay.transform`` of triangles f64[t, 3, 2]; NaN for those without area."""
    (a, b), (c, d) = ((corner[:, k] - corner[:, 2]).T for k in range(2))
    area = np.where(a * d == b * c, np.nan, a * d - b * c)
    return np.column_stack([d / area, -c / area, -b / area, a / area, corner[:, 2]]).reshape(-1, 3, 2)


TRIANGULATIONS: dict[str, type[Tin]] = {"own": Tin, "scipy": SciPyTin}
"""What ground may grow over, by name."""
