"""Windows around points: the lowest of any quantity in a square box about each point of a cloud."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np

from ..core.compilation import bucket
from ..core.grid import grid_over
from ..core.points import Points
from ..engines.grid.boxes import Bins, box_minima
from ..engines.grid.cells import cell_index, padded_shape


class PointBoxes:
    """The points of a cloud, sorted once for boxes of several widths."""

    def __init__(self, points: Points, narrowest: float, widest: float) -> None:
        """Sort the points for boxes from ``narrowest`` to ``widest`` metres wide.

        Bins are as wide as a power of two, so that the bin of a coordinate is exact, near 1.5 point spacings.
        Raises: InputError if there would be too many of them.
        """
        side = 2.0 ** math.floor(math.log2(min(narrowest / 4, 1.5 * points.spacing())))
        self._longest = math.ceil(widest / side) + 2
        margin = self._longest // 2 + 2
        grid = grid_over(points.xyz, side, name="bin of PMF(reading='points')")
        self._shape = rows, columns = padded_shape(
            (grid.ny + 2 * margin, grid.nx + 2 * margin), points.least_shape(side, 2 * margin)
        )
        frame = np.array([grid.x0 - margin * side, grid.y0 - margin * side, side], np.float32)
        extent = np.array(self._shape, np.int32)
        n = len(points)
        xy = np.zeros((bucket(n), 2), np.float32)
        xy[:n] = points.xyz[:, :2]
        at = np.asarray(cell_index(xy, frame[:2], frame[2], extent, columns))[:n]
        row, column = np.divmod(at, columns)
        self._order = np.argsort(at, kind="stable")
        xy[:n] = xy[self._order]
        across = np.arange(len(xy), dtype=np.int32)
        across[:n] = np.argsort((column * rows + row)[self._order], kind="stable")
        self._bins = Bins(
            jnp.asarray(xy),
            jnp.asarray(across),
            jnp.asarray(_starts(at, rows * columns)),
            jnp.asarray(_starts(column * rows + row, rows * columns)),
            jnp.asarray(frame),
        )

    def lowest(self, values: np.ndarray, width: float) -> np.ndarray:
        """f32[n]: the lowest of ``values``, f32[n], in a closed square of ``width`` metres around each point.

        Points of value +inf do not count; +inf where none counts.
        """
        given = np.full(len(self._bins.xy), np.inf, np.float32)
        given[: len(values)] = values[self._order]
        found = box_minima(given, self._bins, np.float32(width / 2), self._shape, self._longest)
        out = np.empty(len(values), np.float32)
        out[self._order] = np.asarray(found)[: len(values)]
        return out

    def opened(self, values: np.ndarray, taken: np.ndarray, width: float) -> np.ndarray:
        """f32[n]: the opening of ``values``, f32[n], by squares of ``width`` metres around the points ``taken``, bool[n].

        +inf where there is none of these around.
        """
        lower = self.lowest(np.where(taken, values, np.inf), width)
        negative = self.lowest(np.where(taken, -lower, np.inf), width)
        return np.where(negative < np.inf, -negative, np.float32(np.inf))


def _starts(at: np.ndarray, cells: int) -> np.ndarray:
    """i32[cells + 1]: the number of points in the cells before each."""
    return np.concatenate([[0], np.cumsum(np.bincount(at, minlength=cells))]).astype(np.int32)
