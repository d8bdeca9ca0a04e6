"""Operations on points on the host, of which kernels of one's own take the arrays (docs/arrays.md has an example).

>>> jf.ops.delaunay(np.random.default_rng(0).random((1000, 3))).neighbours.shape[1]
3
"""

from __future__ import annotations

import dataclasses
import functools
import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from .core.errors import InputError
from .core.frame import QUANTUM, ends
from .core.points import has_area, morton, pieces
from .engines.tin import walks
from .engines.tin.predicates import SPAN
from .engines.tin.triangulation import Tin, lattice


@dataclasses.dataclass(frozen=True, eq=False)
class Delaunay:
    """The Delaunay triangulation of points in x and y; made by :func:`delaunay`.

    Attributes:
        xyz: f64[n, 3], the points.
        vertices: i64[v], ascending: the points that are vertices.
        merged: i64[n], for each point the vertex at its position; a vertex has its own number.
        triangles: i32[t, 3], points, counter-clockwise.
        neighbours: i32[t, 3], the triangle beyond the edge opposite each corner; -1 = none.
    """

    xyz: np.ndarray
    vertices: np.ndarray
    merged: np.ndarray
    triangles: np.ndarray
    neighbours: np.ndarray
    _frame: tuple[np.ndarray, float] = dataclasses.field(repr=False)
    _tin: Tin = dataclasses.field(repr=False)

    @functools.cached_property
    def normals(self) -> np.ndarray:
        """f64[t, 3]: the unit normals, which point up. They are computed when they are first asked for.

        >>> jf.ops.delaunay([[0, 0, 0], [1, 0, 0], [0, 1, 1]]).normals.round(3).tolist()
        [[0.0, -0.707, 0.707]]
        """
        at = np.column_stack([_placed(self.xyz, *self._frame), self.xyz[:, 2] * self._frame[1]])
        a, b, c = (at[self.triangles[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)

    @functools.cached_property
    def _codes(self) -> np.ndarray:
        return morton(self._tin.xyz)

    def locate(self, points: Any) -> np.ndarray:
        """i32[q]: the triangle that holds each position, real[q, 2] or [q, 3]; on an edge one of the two, -1 outside of all.
        Raises: InputError for other shapes and types.

        >>> jf.ops.delaunay([[0, 0, 0], [1, 0, 0], [0, 1, 1]]).locate([[0.2, 0.2], [0.5, 0.0], [3.0, 0.0]]).tolist()
        [0, 0, -1]
        """
        at, tin = _placed(_numbers("points", points, (2, 3)), *self._frame), self._tin
        rows, out = np.flatnonzero(((at >= 0) & (at <= SPAN * QUANTUM)).all(axis=1)), np.full(len(at), -1, np.int32)
        found = tin.walk(at[rows], tin.where[np.searchsorted(self._codes[:-1], morton(at[rows]))])
        found = np.where(found < 0, -1 - found, found)
        x, y = np.moveaxis(tin.xy[tin.triangles[found]].astype(np.int64) - lattice(at[rows])[:, None], 2, 0)
        inside = (x * np.roll(y, -1, axis=1) >= np.roll(x, -1, axis=1) * y).all(axis=1)
        out[rows] = np.where(inside, tin.stamp[found], -1)
        return out


def delaunay(xyz: Any) -> Delaunay:
    """The Delaunay triangulation of points f64[n, 3], or other real numbers, in x and y, which have one unit.

    Points may come in any order: they are sorted along a space-filling curve. Points at one position are merged: the lowest, of
    equally low ones the first, is the vertex (``merged``). Positions are rounded to 1e-8 of the extent. From there on all is
    exact, and of four on a circle the coordinates decide. So triangles and their order do not depend on the order of points.

    Raises: InputError for other shapes and types, numbers that are not finite, and points on one line, as fewer than three are.

    >>> tin = jf.ops.delaunay([[0, 0, 1], [9, 0, 0], [9, 9, 5], [0, 9, 0], [9, 9, 3]])
    >>> sorted(map(sorted, tin.triangles.tolist())), tin.vertices.tolist(), tin.merged.tolist()
    ([[0, 1, 3], [1, 3, 4]], [0, 1, 3, 4], [0, 1, 4, 3, 4])
    """
    xyz = _numbers("xyz", xyz, (3,))
    if not (finite := np.isfinite(xyz)).all():
        raise InputError(f"xyz: {(~finite.all(axis=1)).sum():,} of {len(xyz):,} points are not finite: leave them out")
    low, high = ends(xyz) if len(xyz) else (np.zeros(3), np.ones(3))
    scale = 2.0 ** min(1000, -math.frexp((high - low)[:2].max() / (SPAN * QUANTUM))[1])
    at = _placed(xyz, low, scale)
    if not has_area(at):
        raise InputError(f"xyz of {len(xyz):,} points: all lie on one line; at least three that do not are needed")
    code = morton(at)
    order = np.argsort(code)
    first = np.append(True, np.diff(code[order]) > 0)
    merged = vertices = np.arange(len(xyz))
    if not first.all():
        order, merged = np.lexsort((xyz[:, 2], code)), np.empty_like(order)
        merged[order] = order[first][np.cumsum(first) - 1]
        order, vertices = order[first], np.unique(merged)
    at = np.take(at, order, axis=0)  # what was there before is memory for what follows
    with ThreadPoolExecutor(1) as pool:  # with more the order of triangles would depend on how many
        tin = Tin(at, np.zeros(len(at), np.int32), np.arange(len(at)), pool)
    triangles, neighbours = (np.empty((len(tin), 3), np.int32) for _ in range(2))
    walks.compact(tin.triangles, tin.neighbours, order.astype(np.int32), tin.stamp, triangles, neighbours)
    return Delaunay(xyz, vertices, merged, triangles, neighbours, (low, scale), tin)


def _placed(points: np.ndarray, low: np.ndarray, scale: float) -> np.ndarray:
    """f64[n, 2], multiples of the quantum: points f64[n, >=2], so large that they use all digits of the exact predicates."""
    out = np.empty((len(points), 2))
    for part in pieces(len(points)):
        for axis in range(2):  # across rows NumPy takes twice as long
            out[part, axis] = np.rint((points[part, axis] - low[axis]) * (scale / QUANTUM)) * QUANTUM
    return out


def _numbers(name: str, values: Any, columns: tuple[int, ...]) -> np.ndarray:
    """f64[n, columns]. Raises: InputError."""
    array = np.asarray(values)
    if array.ndim != 2 or array.dtype.kind not in "fiu" or array.shape[1] not in columns:
        raise InputError(f"{name} is {array.dtype} of shape {array.shape}: f64[n, {columns[0]}] is needed")
    return array.astype(np.float64, copy=False)
