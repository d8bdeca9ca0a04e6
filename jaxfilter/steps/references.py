"""Ground that grows from reference points: each point against the plane through the references around it.

The references around a point are the nearest in each of four quadrants, or the nearest of all; they are kept up to date
while references are added.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..core.grid import Grid, grid_over
from ..engines.chunks import in_chunks
from ..engines.ground import GroundNodes
from ..engines.neighbours import nearest, tree_of
from .planes import fit_planes
from .quadrants import Buckets, nearest_in_quadrants, rings

_BLOCK = 1 << 15  # queries per call
_NEAR = 6  # cells that a near search reaches
_FAR = 32  # cells that a search reaches at most


class NearestReferences:
    """The four reference points nearest to every query point, in x and y, wherever they lie.

    Attributes:
        xyz: f32[m, >=2], all points; query: i64[q], rows of those to find references for.
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
        self.xyz, self._xy = xyz, np.ascontiguousarray(xyz[:, :2])
        self.query, self._reach = query, reach
        self.row = np.full((len(query), 4), -1, np.int32)
        self.square = np.full((len(query), 4), np.float32(reach) ** 2, np.float32)

    def keep(self, kept: np.ndarray) -> None:
        """Go on with some of the query points only, bool[q]."""
        self.query, self.row, self.square = self.query[kept], self.row[kept], self.square[kept]

    def add(self, references: np.ndarray, workers: int | None = None) -> np.ndarray:
        """Take in more references, ascending i64[r]. Returns bool[q]: whose nearest have changed.

        Of equally near points those that were taken in before stay.
        """
        if len(references) == 0:
            return np.zeros(len(self.query), bool)
        tree = tree_of(self._xy[references])
        distance, index = nearest(tree, self._xy[self.query], 4, self._reach, workers)
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
        xyz: f32[m, >=2], all points; query: i64[q], rows of those to find references for.
        row: i32[q, 4], rows of ``xyz``, counter-clockwise from the north-east; -1 where a quadrant is empty.
        square: f32[q, 4], squared distances, m2; ``reach`` squared where a quadrant is empty.
    """

    def __init__(self, xyz: np.ndarray, query: np.ndarray, side: float, reach: float) -> None:
        """No references yet.

        Args:
            xyz: f32[m, >=2], all points, local metres.
            query: i64[q], rows to find references for, ascending; neighbours should follow each other.
            side: metres; of the grid cells of the search, about the distance between references.
            reach: metres, of the search.
        """
        super().__init__(xyz, query, reach)
        wide = max(side, reach / _FAR)
        sides = [(wide, math.ceil(reach / wide - 1e-6))]
        if wide > side:
            sides.insert(0, (side, _NEAR))

        def cells(side: float) -> tuple[Grid, np.ndarray]:
            grid = grid_over(xyz, side, name="cell of the search for references")
            return grid, grid.flat(self._xy)

        self._searches = [(*cells(size), rings(radius)) for size, radius in sides]

    def add(self, references: np.ndarray, workers: int | None = None) -> np.ndarray:
        """Take in more references, ascending i64[r]. Returns bool[q]: whose nearest have changed.

        Where ``reach`` is far, the first search is a near one, and the few queries with a quadrant that is still empty, or
        filled from farther away, search again in larger cells.
        """
        changed = np.zeros(len(self.query), bool)
        if len(references) == 0:
            return changed
        todo, query = np.arange(len(self.query)), self._xy[self.query]
        with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
            for grid, cell, steps in self._searches:
                buckets = Buckets.of(self._xy[references], references, cell[references], grid.shape)
                side, home = np.float32(grid.cell), cell[self.query]
                search = functools.partial(
                    nearest_in_quadrants, *buckets, query, home, steps, side, self.row, self.square, changed
                )
                list(pool.map(search, np.array_split(todo, -(-len(todo) // _BLOCK) or 1)))
                radius = float(side) ** 2 * steps[-1, 2]
                todo = todo[(self.square[todo] > radius).any(axis=1)]
        return changed


class Compared(NamedTuple):
    """Every point against the plane that it was compared with last; f32[m] each, NaN where there was none.

    ``distance``: metres along the normal, ``height``: metres upward, both negative below the plane; ``slope``: degrees.
    """

    distance: np.ndarray
    height: np.ndarray
    slope: np.ndarray

    def update(self, xyz: np.ndarray, query: np.ndarray, row: np.ndarray) -> None:
        """Compare points with :func:`local_planes`."""
        self.distance[query], self.height[query], self.slope[query] = local_planes(xyz, query, row)


class GroundReferences(GroundNodes):
    """Points near the plane through the references around them become references (Cai et al. 2023, Sec. 2.5).

    A step compares the points whose references have changed. ``rule``: from distances f32[n], metres, to bool[n].
    """

    STEP = "growing the references"

    def __init__(
        self,
        around: NearestReferences,
        reference: np.ndarray,
        compared: Compared,
        rule: Callable[[np.ndarray], np.ndarray],
        workers: int | None,
    ) -> None:
        """``around``: the points that may become references, without references yet; ``reference``: bool[m], where growth
        begins; ``compared``: all points, those of ``around`` are updated."""
        super().__init__(reference.copy(), around.query, rule)
        self.around, self.compared, self.workers = around, compared, workers
        self._add(np.flatnonzero(reference))

    def _add(self, references: np.ndarray) -> None:
        changed = self.around.add(references, self.workers)
        self.left, self.todo, self._row = len(changed), self.around.query[changed], self.around.row[changed]

    def test(self) -> np.ndarray:
        self.compared.update(self.around.xyz, self.todo, self._row)
        accepted: np.ndarray = self.todo[self.rule(self.compared.distance[self.todo])]
        return accepted

    def take(self, accepted: np.ndarray) -> dict[str, Any]:
        self.around.keep(~self.ground[self.around.query])
        self._add(accepted)
        return {"references": int(self.ground.sum())}


def local_planes(xyz: np.ndarray, query: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points against the least-squares plane through their references (Cai et al. 2023, Sec. 2.5).

    With fewer than three references, or with all on a line, the plane is the horizontal one through the nearest. Without
    any, the answers are NaN.

    Args:
        xyz: f32[m, 3], local metres; query: i64[q], rows of the points; row: i32[q, 4], of their references, -1 for none.

    Returns: f32[q] each: distance along the normal and height, metres, negative below the plane; slope, degrees.
    """

    def around(rows: slice) -> tuple[np.ndarray, np.ndarray]:
        return xyz[row[rows]] - xyz[query[rows]][:, None], row[rows] >= 0

    none = (row < 0).all(axis=1, keepdims=True)
    found = np.where(none, np.float32(np.nan), in_chunks(_plane_below, around, len(query), _BLOCK))
    return found[:, 0], found[:, 1], found[:, 2]


@jax.jit
def _plane_below(reference: jax.Array, known: jax.Array) -> jax.Array:
    """f32[q, 3]: distance, height and slope of the plane through f32[q, 4, 3], for a point at the origin; of no point, any."""
    planes = fit_planes(reference, known)
    square = jnp.where(known, (reference[..., :2] ** 2).sum(axis=-1), jnp.inf)
    nearest_one = jnp.take_along_axis(reference, jnp.argmin(square, axis=1)[:, None, None], axis=1)[:, 0]
    planes = planes._replace(centre=jnp.where(planes.determined[:, None], planes.centre, nearest_one))
    distance = -(planes.centre * planes.normal).sum(axis=1)
    return jnp.stack([distance, distance / planes.normal[:, 2], planes.slope], axis=1)
