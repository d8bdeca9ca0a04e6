"""The geometry of a regular grid over a cloud, and the guard against absurd ones."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from .errors import InputError

MAX_CELLS = 400_000_000


@dataclasses.dataclass(frozen=True)
class Grid:
    """``ny`` rows of ``nx`` square cells; the lower left corner of cell (0, 0) lies at (``x0``, ``y0``), local metres."""

    x0: float
    y0: float
    cell: float
    nx: int
    ny: int

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) = (ny, nx); row 0 is the southern edge."""
        return self.ny, self.nx

    def flat(self, xy: np.ndarray) -> np.ndarray:
        """i32[n] row-major cell index of local points [n, >=2]; points outside go to the nearest cell."""
        ix = np.clip(np.floor((xy[:, 0] - self.x0) / self.cell), 0, self.nx - 1).astype(np.int32)
        iy = np.clip(np.floor((xy[:, 1] - self.y0) / self.cell), 0, self.ny - 1).astype(np.int32)
        return iy * self.nx + ix


def grid_over(
    xy: np.ndarray, cell: float, offset: tuple[float, float] = (0.0, 0.0), name: str = "cell", limit: int = MAX_CELLS
) -> Grid:
    """The smallest grid of ``cell`` metres, aligned to ``offset``, that holds local points [n, >=2].

    A point on the upper edge of the extent belongs to the last cell. Raises InputError, before anything is allocated,
    when more than ``limit`` cells would be needed: the cell is too fine, or a stray point lies far away.
    """
    low, high = (np.array([pick(xy[:, axis]) for axis in range(2)]) for pick in (np.min, np.max))
    x0, y0 = (math.floor((float(v) - o) / cell + 1e-9) * cell + o for v, o in zip(low, offset, strict=True))
    nx, ny = (max(1, math.ceil((float(v) - s) / cell - 1e-6)) for v, s in zip(high, (x0, y0), strict=True))
    if nx * ny > limit:
        spread = ", ".join(f"{float(v):.6g}" for v in high - low)
        raise InputError(
            f"{name}={cell:g} m over an extent of {spread} m needs {nx * ny:.3g} cells ({nx * ny * 4 / 2**30:.1f} GiB a "
            "layer): use larger cells, or remove stray points far from the rest"
        )
    return Grid(x0, y0, cell, nx, ny)
