"""Slopes of the points of a cell towards its lowest point, by which an adaptive grid divides cells."""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ..core.compilation import jit
from ..engines.grid.cells import block_counts, block_minima

MAX_SLOPE = 63.0
"""Rise over run that a single slope counts with at most (89.1 degrees); over points almost above each other it is unbounded."""
_STEPS = 2**16  # slopes are summed as whole multiples of 1 / _STEPS, so that the order of the points changes no sum
_LOW = 2**11  # in two parts, so that sums over two million points stay within 32 bits, whatever their slopes


class CellSlopes(NamedTuple):
    """What the points of each cell say about it; arrays over cells.

    Attributes:
        number: i32, how many points count.
        first: i32, the lowest of them, the first of equally low ones; ``n`` in empty cells.
        mean, least: f32, mean and minimum of the slopes from the lowest point to the others, rise over run. Points
            straight above the lowest have no slope and do not enter; 0 where no other point is left.
    """

    number: jax.Array
    first: jax.Array
    mean: jax.Array
    least: jax.Array


@functools.partial(jit, static_argnames="cells")
def cell_slopes(index: jax.Array, xyz: jax.Array, counted: jax.Array, cells: int) -> CellSlopes:
    """Slopes per cell (Zheng et al. 2024, eq. 5).

    Args:
        index: i32[n], cell of every point.
        xyz: f32[n, 3], local metres.
        counted: bool[n], the points that count.
        cells: number of cells of the padded grid.

    Returns: CellSlopes of ``cells`` entries, the same for any order of the points but for ``first``. Slopes count as
    multiples of 2^-16, up to :data:`MAX_SLOPE`.
    """
    _, first = block_minima(index, jnp.where(counted, xyz[:, 2], jnp.inf), cells)
    lowest = xyz[jnp.minimum(first, len(xyz) - 1)][index]
    rise, run = xyz[:, 2] - lowest[:, 2], jnp.hypot(xyz[:, 0] - lowest[:, 0], xyz[:, 1] - lowest[:, 1])
    sloped = counted & (run > 0)
    slope = jnp.minimum(jnp.where(sloped, rise / jnp.where(sloped, run, 1.0), 0.0), MAX_SLOPE)
    step = jnp.rint(slope * _STEPS).astype(jnp.uint32)
    zero = jnp.zeros(cells, jnp.uint32)
    low, high, others = (zero.at[index].add(v) for v in (step % _LOW, step // _LOW, sloped.astype(jnp.uint32)))
    total = (high.astype(jnp.float32) * _LOW + low.astype(jnp.float32)) / _STEPS
    least = jnp.full(cells, MAX_SLOPE, jnp.float32).at[index].min(jnp.where(sloped, step / _STEPS, MAX_SLOPE))
    return CellSlopes(
        number=block_counts(index, counted, cells),
        first=first,
        mean=total / jnp.maximum(others, 1).astype(total.dtype),
        least=jnp.where(others > 0, least, 0.0),
    )
