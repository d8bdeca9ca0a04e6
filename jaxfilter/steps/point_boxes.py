"""Windows around points: the lowest of any quantity in a square box about each point of a cloud."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.ndimage import minimum_filter1d

from ..core.grid import grid_over
from ..core.points import Points
from ..engines.grid.cells import lowest_in_cells
from .quadrants import Buckets

_AT_ONCE = 1 << 13
"""Boxes that are asked for by one call."""


class PointBoxes:
    """The points of a cloud, sorted once for boxes of several widths."""

    def __init__(self, points: Points, narrowest: float, widest: float, workers: int | None = None) -> None:
        """Sort the points for boxes from ``narrowest`` to ``widest`` metres wide. ``workers``: threads, None = cores.

        Bins are as wide as a power of two, so that the bin of a coordinate is exact, near 1.5 point spacings.
        Raises: InputError if there would be too many of them.
        """
        side, self._workers = 2.0 ** math.floor(math.log2(min(narrowest / 4, 1.5 * points.spacing()))), workers
        margin = math.ceil(widest / side) // 2 + 3
        grid = grid_over(points.xyz, side, name="bin of PMF(reading='points')")
        shape = grid.ny + 2 * margin, grid.nx + 2 * margin
        row, column = (place.astype(np.int64) + margin for place in grid.places(points.xyz))
        self._at = row * shape[1] + column
        self._bins = Buckets.of(points.xyz[:, :2], np.arange(len(points)), self._at, shape)
        self._side = np.float32(side)
        self._corner = np.array([grid.x0 - margin * side, grid.y0 - margin * side], np.float32)

    def lowest(self, values: np.ndarray, width: float) -> np.ndarray:
        """f32[n]: the lowest of ``values``, f32[n], in a closed square of ``width`` metres around each point.

        Points of value +inf do not count; +inf where none counts.
        """
        from ..engines.grid.boxes import box_minima  # imports Numba

        rows, columns = self._bins.shape
        windows = lowest_in_cells(self._at, values, rows * columns, rows=False)[0].reshape(rows, columns)
        half = np.float32(width / 2)
        run = math.floor(float(2 * half / self._side) - 1e-3) - 1
        for axis in range(2):
            windows = minimum_filter1d(windows, run, axis, mode="constant", cval=np.inf, origin=-(run // 2))
        given = values[self._bins.row].astype(np.float32), self._bins.start, windows, run
        found = np.empty(len(values), np.float32)

        def ask(start: int) -> None:
            last = min(start + _AT_ONCE, len(values))
            box_minima(self._bins.xy, *given, self._corner, self._side, half, start, last, found)

        with ThreadPoolExecutor(self._workers or os.cpu_count()) as pool:
            list(pool.map(ask, range(0, len(values), _AT_ONCE)))
        out = np.empty(len(values), np.float32)
        out[self._bins.row] = found
        return out

    def opened(self, values: np.ndarray, taken: np.ndarray, width: float) -> np.ndarray:
        """f32[n]: the opening of ``values``, f32[n], by squares of ``width`` metres around the points ``taken``, bool[n].

        +inf where there is none of these around.
        """
        lower = self.lowest(np.where(taken, values, np.inf), width)
        negative = self.lowest(np.where(taken, -lower, np.inf), width)
        return np.where(negative < np.inf, -negative, np.float32(np.inf))
