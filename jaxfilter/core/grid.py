"""The geometry of a regular grid over a cloud, and the guard against absurd ones."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import jax
import numpy as np

from .errors import InputError
from .frame import ends

MAX_CELLS = 400_000_000
_PER_POINT, _AT_LEAST = 64, 4_000_000


@dataclasses.dataclass(frozen=True)
class Grid:
    """``ny`` rows of ``nx`` square cells; the lower left corner of cell (0, 0) lies at (``x0``, ``y0``), local metres. A pytree
    of five numbers, which may be traced."""

    x0: Any
    y0: Any
    cell: Any
    nx: Any
    ny: Any

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) = (ny, nx); row 0 is the southern edge."""
        return self.ny, self.nx

    def single(self) -> Grid:
        """With lengths in single precision, as kernels have them."""
        return dataclasses.replace(self, **{name: np.float32(getattr(self, name)) for name in ("x0", "y0", "cell")})

    def places(self, xy: Any) -> tuple[Any, Any]:
        """i32[n], i32[n] row and column of local points [n, >=2], NumPy or JAX; points outside go to the nearest cell."""
        xp = xy.__array_namespace__()

        def along(axis: int, first: Any, count: Any) -> Any:
            return xp.clip(xp.floor((xy[:, axis] - first) / self.cell).astype(np.int32), 0, count - 1)

        return along(1, self.y0, self.ny), along(0, self.x0, self.nx)

    def flat(self, xy: Any, columns: int | None = None) -> Any:
        """i32[n] row-major cell of local points [n, >=2], as for :meth:`places`, in an array of so many columns, by default
        ``nx``."""
        row, column = self.places(xy)
        return row * (columns or self.nx) + column


def _leaves(grid: Grid) -> tuple[tuple[Any, ...], None]:
    """The five numbers; whole ones in 32 bits, whatever JAX makes of those of Python."""
    counts = (np.int32(count) if isinstance(count, int) else count for count in (grid.nx, grid.ny))
    return (grid.x0, grid.y0, grid.cell, *counts), None


jax.tree_util.register_pytree_node(Grid, _leaves, lambda _, leaves: Grid(*leaves))


def most_cells(points: int, limit: int = MAX_CELLS) -> int:
    """How many cells a grid over so many points may have: 64 for each point, or 4 million, but at most ``limit``. More are
    mostly empty: the cell is too fine, or a stray point far away makes the extent."""
    return min(limit, max(_PER_POINT * points, _AT_LEAST))


def period(*sides: float) -> float:
    """The least multiple of the largest side that is one of all of them, metres; the first side where none up to ten times is."""
    for length in max(sides) * np.arange(1, 11):
        if all(abs(length / side - round(length / side)) < 1e-6 for side in sides):
            return float(length)
    return sides[0]


def lattice_over(xy: np.ndarray, cell: float, offset: tuple[float, float] = (0.0, 0.0)) -> Grid:
    """The smallest grid of ``cell`` metres, aligned to ``offset``, that holds local points [n, >=2], of any size. A point on
    the upper edge of the extent belongs to the last cell."""
    low, high = ends(xy[:, :2])
    x0, y0 = (math.floor((float(v) - o) / cell + 1e-9) * cell + o for v, o in zip(low, offset, strict=True))
    nx, ny = (max(1, math.ceil((float(v) - s) / cell - 1e-6)) for v, s in zip(high, (x0, y0), strict=True))
    return Grid(x0, y0, cell, nx, ny)


def grid_over(
    xy: np.ndarray, cell: float, offset: tuple[float, float] = (0.0, 0.0), name: str = "cell", limit: int = MAX_CELLS
) -> Grid:
    """:func:`lattice_over`, for arrays that hold every cell. Raises InputError, before anything is allocated, when more cells
    than :func:`most_cells` would be needed."""
    grid = lattice_over(xy, cell, offset)
    if (cells := grid.nx * grid.ny) > most_cells(len(xy), limit):
        spread = " x ".join(f"{float(np.ptp(xy[:, axis])):.6g}" for axis in range(2))
        needed = f"{cells:.3g} cells for {len(xy):,} points ({cells * 4 / 2**30:.1f} GiB a layer)"
        advice = "use larger cells, or remove stray points far from the rest"
        raise InputError(f"{name}={cell:g} m over an extent of {spread} m needs {needed}: {advice}")
    return grid
