"""Gridded surfaces: lowest elevation per cell, and all points of a cloud held against a surface, part by part."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from ..core.errors import InputError
from ..core.grid import Grid, grid_over
from ..core.points import Points, pieces
from ..engines.chunks import in_chunks
from ..engines.grid.cells import lowest_in_cells, padded_shape
from ..engines.grid.morphology import progressive_opening

MAX_SURFACE_CELLS = 100_000_000  # about 10 GB
_WORK, _WORK_PER_POINT = 250_000_000, 64_000
"""Cells times openings that are done for few points, and for each point of many: some seconds of a processor."""
_CHUNK, _SMALL_CHUNK = 2**18, 2**14  # points that are handed to the device at a time, of large clouds and of others
_IN_FLIGHT = 8  # chunks that may be computed at once


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["lowest", "seen", "valid", "grid"],
    meta_fields=[],
)
@dataclasses.dataclass(frozen=True, eq=False)
class Cells:
    """The lowest elevation in each cell of a grid, in arrays of a padded shape [rows, columns]; a pytree.

    Attributes:
        lowest: f32, metres; zero in empty cells.
        seen: bool, cells with points.
        valid: bool, cells of the true extent.
        grid: the true cells; lengths are f32.
    """

    lowest: np.ndarray | jax.Array
    seen: np.ndarray | jax.Array
    valid: np.ndarray | jax.Array
    grid: Grid

    def checked(self) -> Cells:
        """The same cells; those outside the extent, and those whose elevation is NaN or infinite, count as empty.

        Raises: InputError if the shapes of the arrays do not fit each other.
        """
        shapes = {name: np.shape(getattr(self, name)) for name in ("lowest", "seen", "valid")}
        if len(set(shapes.values())) != 1 or len(shapes["lowest"]) != 2:
            got = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
            raise InputError(f"Cells: {got}: arrays of one shape (rows, columns) are needed")
        seen = self.seen & self.valid & jnp.isfinite(self.lowest)
        return dataclasses.replace(self, lowest=jnp.where(seen, self.lowest, 0), seen=seen)


def cell_for(spacing: float, spacings: float = 1.0) -> float:
    """Side of grid cells in metres: so many point spacings, in steps of 0.5 m, and 1 m at least."""
    return max(1.0, 0.5 * math.ceil(2 * spacings * spacing - 1e-6))


def lowest_cells(
    points: Points,
    cell: float,
    name: str,
    *,
    corner: tuple[float, float] | None = None,
    barred: np.ndarray | None = None,
) -> Cells:
    """The lowest point in each square of ``cell`` metres, those that are ``barred`` (bool[m]) left out.

    Args:
        name: what an error calls the cell.
        corner: of the lattice, local metres; by default where squares of this size begin in the cloud.

    Raises: InputError if there would be too many cells.
    """
    xyz = points.xyz
    grid = grid_over(xyz, cell, corner or points.offset(cell), name, MAX_SURFACE_CELLS).single()
    shape = padded_shape(grid.shape)
    z = xyz[:, 2]
    if barred is not None and barred.any():
        z = np.where(barred, np.float32(np.inf), z)
    lowest = lowest_in_cells(grid.flat(xyz, shape[1]), z, shape[0] * shape[1], rows=False)[0].reshape(shape)
    seen, valid = lowest < np.inf, np.zeros(shape, bool)
    valid[: grid.ny, : grid.nx] = True
    return Cells(np.where(seen, lowest, np.float32(0)), seen, valid, grid)


def highest_in(xyz: np.ndarray, cells: Cells) -> np.ndarray:
    """f32[rows, columns], without padding: the highest of the points f32[n, 3] in each cell, -inf without any."""
    grid = cells.grid
    return -lowest_in_cells(grid.flat(xyz), -xyz[:, 2], grid.nx * grid.ny, rows=False)[0].reshape(grid.shape)


def positions(xyz: np.ndarray, cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """f64[n] each: columns and rows of points f32[n, 3]; the centre of cell (row, column) is at (column, row)."""
    corner, cell = np.array([cells.grid.x0, cells.grid.y0], np.float64), float(cells.grid.cell)
    x, y = ((xyz[:, :2].astype(np.float64) - corner) / cell - 0.5).T
    return np.ascontiguousarray(x), np.ascontiguousarray(y)


def number_in(points: Points, cells: Cells) -> np.ndarray:
    """i64[rows, columns], without padding: how many points are in each cell."""
    grid = cells.grid
    return np.bincount(grid.flat(points.xyz), points.weight, grid.nx * grid.ny).reshape(grid.shape)


def check_openings(cells: Cells, openings: int, points: Points, name: str) -> None:
    """Raises: InputError, which begins with ``name``, for more openings of all cells than :data:`_WORK` allows."""
    rows, columns = cells.grid.shape
    if rows * columns * openings > max(_WORK, _WORK_PER_POINT * len(points)):
        raise InputError(
            f"{name}: {openings:,} openings of {rows:,} x {columns:,} cells for {len(points):,} points: use larger cells or "
            "a smaller window, or remove stray points far from the rest"
        )


def hold_against(xyz: np.ndarray, test: Callable[[np.ndarray], tuple[jax.Array, ...]]) -> list[np.ndarray]:
    """``test`` of all points f32[n, 3], a chunk at a time: arrays f32[n], as many as it returns.

    ``test`` is given points f32[m, 3], padded to one of two sizes, and returns arrays f32[m].
    """
    size = _CHUNK if len(xyz) > _CHUNK else _SMALL_CHUNK
    return list(in_chunks(test, lambda rows: (xyz[rows],), len(xyz), size, _IN_FLIGHT))


def look_up(xyz: np.ndarray, cells: Cells, *surfaces: jax.Array | np.ndarray) -> list[np.ndarray]:
    """f32[n] each: the value of every surface, f32[rows, columns], in the cells of points f32[n, 3]."""
    tables, columns = [np.asarray(surface).reshape(-1) for surface in surfaces], surfaces[0].shape[1]
    found = [np.empty(len(xyz), table.dtype) for table in tables]
    for part in pieces(len(xyz)):
        at = cells.grid.flat(xyz[part], columns)
        for out, table in zip(found, tables, strict=True):
            out[part] = table[at]
    return found


@functools.partial(jax.jit, static_argnames=("most", "element"))
def steepest_drops(
    z: jax.Array, valid: jax.Array, reach: jax.Array | int, most: int, element: str = "disk"
) -> jax.Array:
    """Metres per cell of radius that progressive openings with radii of 1, 2, ... ``reach`` cells lower each cell by, at most.

    Args and returns: [rows, columns], as for :func:`jaxfilter.engines.grid.morphology.progressive_opening`; drops are f32, in the
    unit of ``z``. ``most``: the largest ``reach`` that this compilation serves.
    """

    def steeper(k: jax.Array, before: jax.Array, opened: jax.Array, steepest: jax.Array) -> jax.Array:
        drop = before.astype(jnp.float32) - opened.astype(jnp.float32)
        return jnp.maximum(steepest, drop / (k + 1).astype(jnp.float32))

    radii, none = jnp.arange(1, most + 1), jnp.zeros(z.shape, jnp.float32)
    return progressive_opening(z, valid, radii, steeper, none, reach=most, element=element, count=reach)[1]


@jax.jit
def steepness(z: jax.Array, grid: Grid) -> jax.Array:
    """Slope of a surface, rise over run, f32[rows, columns]: central differences, one-sided at the border of the grid."""

    def difference(axis: int) -> jax.Array:
        here = jax.lax.broadcasted_iota(jnp.int32, z.shape, axis)
        first, last = here == 0, here == grid.shape[axis] - 1
        after = jnp.where(last, z, jnp.roll(z, -1, axis))
        before = jnp.where(first, z, jnp.roll(z, 1, axis))
        return (after - before) / (grid.cell * jnp.where(first | last, 1, 2))

    return jnp.hypot(difference(0), difference(1))


@jax.jit
def cell_values(xyz: jax.Array, surfaces: tuple[jax.Array | np.ndarray, ...], grid: Grid) -> tuple[jax.Array, ...]:
    """f32[n] for every surface, f32[rows, columns]: its value in the cells of points f32[n, >=2]; see :class:`Cells`."""
    at = grid.flat(xyz, surfaces[0].shape[1])
    return tuple(surface.reshape(-1)[at] for surface in surfaces)
