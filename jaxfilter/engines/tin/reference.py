"""The reference: triangulations that SciPy makes anew from all vertices of a sheet whenever some of these come or go.

They have the tables of :class:`jaxfilter.engines.tin.triangulation.Tin`, so that the same loop grows over them. Qhull computes
in floating point. Where four vertices lie on a circle, it takes either diagonal; a point on an edge is found on either side.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...core.errors import ParameterError
from ...core.points import pieces
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
        """i32[n]: the triangles that contain positions i32[n, 2]; outside the ghost of the nearest edge in sight."""
        at = (xy - self.middle).astype(np.float64)
        found = self.delaunay.find_simplex(at).astype(np.int64)
        outside = np.flatnonzero(found < 0)
        for part in pieces(len(outside)):
            found[outside[part]] = len(self.delaunay.simplices) + self._nearest_edge(at[outside[part]])
        return self.rows[found]

    def _nearest_edge(self, at: np.ndarray) -> np.ndarray:
        """i64[n]: the edge of the hull nearest to positions f64[n, 2]; of two that share an end, the one that begins there."""
        begin, end = self.hull[:, 0], self.hull[:, 1]
        (x, y), (u, v) = np.moveaxis(at[:, None] - begin, 2, 0), (end - begin).T
        along = np.clip((x * u + y * v) / (u * u + v * v), 0.0, 1.0)
        square = (x - along * u) ** 2 + (y - along * v) ** 2
        nearest, hidden = square == square.min(axis=1, keepdims=True), u * y - v * x >= 0
        return np.where(nearest, along + 2.0 * hidden, np.inf).argmin(axis=1)


class SciPyTin(Tin):
    """Triangulations by SciPy. A triangle keeps its number while its three vertices make one; all others count as changed."""

    _sheets: tuple[_Sheet | None, ...] = ()
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
        order, out = np.argsort(sheet, kind="stable"), np.empty(len(xy), np.int32)
        for part in np.split(order, np.flatnonzero(np.diff(sheet[order])) + 1):
            if len(part) and (one := self._sheets[sheet[part[0]]]):
                out[part] = one.find(xy[part])
        return out

    def _triangulate(self, sheets: np.ndarray) -> None:
        """Make these sheets, i32[.], anew, and those that never were."""
        after: list[_Sheet | None] = list(self._sheets or [None] * len(self._hull))
        bounds = np.searchsorted(self.sheet, np.arange(len(after) + 1))
        for number in np.union1d(sheets, [k for k, one in enumerate(after) if one is None]).astype(int):
            first, end = bounds[number : number + 2]
            after[number] = self._one_sheet(number, first + np.flatnonzero(self.vertex[first:end]), after[number])
        self._sheets = tuple(after)

    def _one_sheet(self, number: int, nodes: np.ndarray, before: _Sheet | None) -> _Sheet:
        """Triangulate the vertices of a sheet, i64[n], and bring the tables up to date."""
        from scipy.spatial import Delaunay

        middle = self.xy[nodes].min(axis=0) // 2 + self.xy[nodes].max(axis=0) // 2
        made = Delaunay((self.xy[nodes] - middle).astype(np.float64))
        made._transform = _barycentric(made.points[made.simplices])  # SciPy's calls of LAPACK take many times as long
        if len(made.coplanar):
            few = (
                f"{len(made.coplanar):,} of {len(nodes):,} vertices, which are too near to others for double precision"
            )
            raise ParameterError(f"triangulation='scipy': Qhull leaves out {few}; use triangulation='own'")
        row, k = np.nonzero(made.neighbors < 0)
        begin, end = (made.simplices[row, (k + step) % 3] for step in (1, 2))
        ghost, at = len(made.simplices) + np.arange(len(row)), np.empty((2, len(nodes)), np.int64)
        at[0, begin] = at[1, end] = ghost  # the ghosts whose edge begins, and whose edge ends, at a vertex
        inner = made.neighbors.copy()
        inner[row, k] = ghost
        beside = np.concatenate([inner, np.column_stack([row, at[1, begin], at[0, end]])])
        outer = np.column_stack([np.full(len(row), self._walks.NOWHERE), nodes[end], nodes[begin]])
        corner = np.concatenate([nodes[made.simplices], outer])
        turn = (corner.argmin(axis=1)[:, None] + np.arange(3)) % 3  # the first node comes first
        corner, beside = (np.take_along_axis(table, turn, axis=1) for table in (corner, beside))
        rows = self._numbers(corner, np.arange(4, dtype=np.int32) + 4 * number if before is None else before.rows)
        self.triangles[rows], self.neighbours[rows] = corner, rows[beside]
        self.where[nodes], self._hull[number] = rows[made.vertex_to_simplex], len(row)
        return _Sheet(made, middle, rows, made.points[np.column_stack([begin, end])])

    def _numbers(self, corner: np.ndarray, old: np.ndarray) -> np.ndarray:
        """i32[t]: numbers for triangles with corners i64[t, 3]: of those with the numbers ``old`` the same, else free ones."""
        key, known = (table[:, 0].astype(np.int64) << 32 | table[:, 1] for table in (corner, self.triangles[old]))
        _, new, same = np.intersect1d(key, known, assume_unique=True, return_indices=True)
        stays = self.triangles[old[same], 2] == corner[new, 2]
        rows, gone = np.full(len(corner), -1, np.int32), np.delete(old, same[stays])
        rows[new[stays]] = old[same[stays]]
        self.triangles[gone], self.stamp[gone] = self._walks.DEAD, self.now
        self._unused = np.concatenate([gone, self._unused])
        fresh = np.flatnonzero(rows < 0)
        numbers = self._fresh(-(-len(fresh) // 2)).ravel()
        rows[fresh], self._unused = numbers[: len(fresh)], np.concatenate([numbers[len(fresh) :], self._unused])
        self.stamp[rows[fresh]] = self.now
        return rows


def _barycentric(corner: np.ndarray) -> np.ndarray:
    """f64[t, 3, 2], contiguous: ``Delaunay.transform`` of triangles f64[t, 3, 2]; NaN for those without area."""
    out = corner.copy()
    (a, b), (c, d) = ((corner[:, k] - corner[:, 2]).T for k in range(2))
    area = np.where(a * d == b * c, np.nan, a * d - b * c)
    out[:, 0], out[:, 1] = np.column_stack([d, -c]) / area[:, None], np.column_stack([-b, a]) / area[:, None]
    return out


TRIANGULATIONS: dict[str, type[Tin]] = {"own": Tin, "scipy": SciPyTin}
"""What ground may grow over, by name."""
