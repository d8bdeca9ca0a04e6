"""How steep the landscape is around a place: the slope between means of blocks, averaged with Gaussian weights."""

from __future__ import annotations

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np

from ..core.grid import Grid
from ..engines.grid.cells import inside
from ..engines.grid.inpaint import fill_membrane
from ..engines.grid.sampling import bilinear
from .surfaces import Cells, hold_against, steepness

_BLOCK = 5.0
"""Metres: wide enough to level furrows and vehicles, a sixth of what it is averaged over by default."""


@dataclasses.dataclass(frozen=True, eq=False)
class Landscape:
    """Slopes around places on a grid of blocks.

    Attributes:
        slope: f32[blocks, blocks], rise over run, padded.
        cells: the cells that blocks are made of; block: so many rows, and columns, each.
    """

    slope: jax.Array
    cells: Cells
    block: int

    @classmethod
    def from_elevations(cls, z: np.ndarray, cells: Cells, objects: np.ndarray, sigma: float) -> Landscape:
        """From elevations f32[rows, columns] without the cells that are ``objects``, bool[rows, columns], or have no points.

        ``sigma``: standard deviation of the weights, metres.
        """
        cell = float(cells.grid.cell)
        block = max(1, round(_BLOCK / cell))
        reach = min(math.ceil(3 * sigma / (block * cell)), -(-max(z.shape) // block))  # nothing lies beyond the array
        known = cells.seen, cells.valid, objects
        slope = _slope(z, known, cells.grid, np.float32(sigma), block, reach)
        return cls(slope, cells, block)

    def in_cells(self) -> jax.Array:
        """f32[rows, columns]: in each cell, padded cells included."""
        return _in_cells(self.slope, self.cells.grid, self.cells.lowest.shape, self.block)

    def at(self, xyz: np.ndarray) -> np.ndarray:
        """f32[n]: at points f32[n, 3], local metres."""
        block = np.int32(self.block)
        return hold_against(xyz, lambda chunk: (_at_points(self.slope, chunk, self.cells.grid, block),))[0]


@functools.partial(jax.jit, static_argnames=("block", "reach"))
def _slope(
    z: jax.Array,
    masks: tuple[jax.Array, jax.Array, jax.Array],
    grid: Grid,
    sigma: jax.Array,
    block: int,
    reach: int,
) -> jax.Array:
    """Slopes of the means of blocks, averaged over up to ``reach`` of them; ``masks``: cells with points, cells that exist, and
    objects."""
    seen, valid_cells, objects = masks
    known = seen & valid_cells & ~objects
    shape = (-(-z.shape[0] // block), -(-z.shape[1] // block))

    def sums(a: jax.Array) -> jax.Array:
        wide = jnp.pad(a, [(0, -n % block) for n in z.shape])
        return wide.reshape(shape[0], block, shape[1], block).sum(axis=(1, 3))

    count = sums(known.astype(jnp.float32))
    blocks = -(-jnp.stack(grid.shape) // block)
    valid = inside(shape, blocks)
    level = fill_membrane(sums(jnp.where(known, z, 0)) / jnp.maximum(count, 1), count > 0, valid).z
    weight = jnp.exp(-0.5 * (jnp.arange(-reach, reach + 1, dtype=z.dtype) * grid.cell * block / sigma) ** 2)

    def average(a: jax.Array) -> jax.Array:
        a = jnp.where(valid, a, 0)
        for _ in range(2):
            a = jax.vmap(lambda line: jnp.convolve(line, weight, precision="highest")[reach : reach + line.size])(a).T
        return a

    slope = steepness(level, Grid(grid.x0, grid.y0, grid.cell * block, blocks[1], blocks[0]))
    return average(slope) / jnp.maximum(average(jnp.ones(shape, jnp.float32)), 1e-6)


@functools.partial(jax.jit, static_argnames=("shape", "block"))
def _in_cells(slope: jax.Array, grid: Grid, shape: tuple[int, int], block: int) -> jax.Array:
    """As :func:`bilinear` at the centres of cells, which form rows and columns: along these first, then across."""
    blocks = -(-jnp.stack(grid.shape) // block)

    def between(axis: int) -> tuple[jax.Array, jax.Array, jax.Array]:
        last = blocks[axis] - 1
        at = (jnp.arange(shape[axis], dtype=slope.dtype) + 0.5) / block - 0.5
        at = jnp.clip(at, 0, last.astype(at.dtype))
        low = jnp.minimum(jnp.floor(at).astype(jnp.int32), jnp.maximum(last - 1, 0))
        return low, jnp.minimum(low + 1, last), at - low.astype(at.dtype)

    (west, east, u), (south, north, v) = between(1), between(0)
    lines = u[None] * slope[:, east] + (1 - u[None]) * slope[:, west]
    return (1 - v[:, None]) * lines[south] + v[:, None] * lines[north]


@jax.jit
def _at_points(slope: jax.Array, xyz: jax.Array, grid: Grid, block: jax.Array) -> jax.Array:
    at = (xyz[:, :2] - jnp.stack([grid.x0, grid.y0])[None]) / (grid.cell * jnp.asarray(block, grid.cell.dtype)) - 0.5
    return bilinear(at, -(-jnp.stack(grid.shape) // block), slope.shape[1])(slope)
