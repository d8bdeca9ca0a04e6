"""How steep the landscape is around a place: the slope between means of blocks, averaged with Gaussian weights."""

from __future__ import annotations

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np

from ..core.grid import Grid
from ..engines.grid.cells import inside
from ..engines.grid.inpaint import fill_membrane
from .surfaces import Cells, steepness


def landscape_slope(z: np.ndarray, cells: Cells, objects: np.ndarray, sigma: float) -> np.ndarray:
    """f32[rows, columns]: slope of the landscape, rise over run, at the cells, without padding.

    Args:
        z: f32[rows, columns], metres. objects: bool[rows, columns], cells that do not count; nor do those without points.
        sigma: standard deviation of the weights, metres.
    """
    cell, shape = float(cells.grid.cell), cells.lowest.shape
    block = max(1, round(sigma / 6 / cell))  # 5 m by default, which levels furrows and vehicles
    reach = min(math.ceil(3 * sigma / (block * cell)), -(-max(shape) // block))  # nothing lies beyond the array
    pad = [(0, wide - n) for wide, n in zip(shape, z.shape, strict=True)]
    known = np.asarray(cells.seen) & ~np.pad(objects, pad)
    slope = _slope(np.pad(z, pad), known, cells.grid, np.float32(sigma), block, reach)
    return np.asarray(slope)[: z.shape[0], : z.shape[1]]


@functools.partial(jax.jit, static_argnames=("block", "reach"))
def _slope(z: jax.Array, known: jax.Array, grid: Grid, sigma: jax.Array, block: int, reach: int) -> jax.Array:
    """Slopes of the means of blocks, averaged over up to ``reach`` of them, and linear between their centres."""
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
    slope = average(slope) / jnp.maximum(average(jnp.ones(shape, jnp.float32)), 1e-6)
    return jax.image.resize(slope, (shape[0] * block, shape[1] * block), "linear", antialias=False)
