"""Lowest value among the points in a square box around every point, exactly.

Points are binned. The bins that lie wholly inside a box form a rectangle, whose minimum is that of four overlapping
windows of bins; the points in the ring of bins around it are tested one by one. Two orders of the points, along rows and
along columns of bins, make the ring four stretches of consecutive points.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from .morphology import run_minima

_QUERIES = 4096  # boxes at a time; neighbours in order, so that their rings hold about as many points


class Bins(NamedTuple):
    """Points in bins, sorted along rows of bins.

    Attributes:
        xy: f32[n, 2], local metres. Padding follows the true points.
        across: i32[n], the points sorted along columns of bins.
        starts: i32[rows * columns + 1], the first point of each bin in the order along rows.
        starts_across: i32[columns * rows + 1], the same in the order along columns.
        frame: f32[3], x and y of the lower left corner and side of a bin, metres. There are so many empty rows and columns
            of bins around the points that no box reaches beyond the grid.
    """

    xy: jax.Array
    across: jax.Array
    starts: jax.Array
    starts_across: jax.Array
    frame: jax.Array


@functools.partial(jax.jit, static_argnames=("shape", "longest"))
def box_minima(values: jax.Array, bins: Bins, half: jax.Array, shape: tuple[int, int], longest: int) -> jax.Array:
    """The lowest of ``values`` among the points within ``half`` metres of each point in x and in y.

    Args:
        values: f32[n]; +inf for points that do not count, padding among them.
        half: f32[], metres; boxes are closed. At least two bins, and less than (``longest`` + 1) / 2.
        shape: rows and columns of bins.
        longest: the most bins that may lie along a box.

    Returns: f32[n]; +inf where no point counts, and for padding.
    """
    rows, columns = shape
    xy, frame = bins.xy, bins.frame
    true = jnp.arange(len(xy), dtype=jnp.int32) < bins.starts[-1]

    def bin_of(v: jax.Array, axis: int) -> jax.Array:
        return jnp.floor((v - frame[axis]) / frame[2]).astype(jnp.int32)

    column, row = bin_of(xy[:, 0], 0), bin_of(xy[:, 1], 1)
    run = jnp.floor(2 * half / frame[2] - 1e-3).astype(jnp.int32) - 1  # bins inside every box, at least
    index = jnp.where(true, row * columns + column, rows * columns)
    lowest = jnp.full(rows * columns, jnp.inf, values.dtype).at[index].min(values, mode="drop").reshape(shape)
    windows = run_minima(run_minima(lowest, run, longest, 1), run, longest, 0).reshape(-1)
    along = jnp.column_stack((xy, values))
    both = jnp.concatenate((along, along[bins.across]))

    def ask(box: tuple[jax.Array, jax.Array]) -> jax.Array:
        (x, y), known = box[0].T, box[1]
        west, east, south, north = (
            jnp.where(known, bin_of(v, axis), 0)
            for v, axis in ((x - half, 0), (x + half, 0), (y - half, 1), (y + half, 1))
        )
        low = jnp.full(x.shape, jnp.inf, x.dtype)
        for r in (south + 1, north - run):
            for c in (west + 1, east - run):
                low = jnp.minimum(low, windows[jnp.clip(r, 0, rows - 1) * columns + jnp.clip(c, 0, columns - 1)])
        n = len(xy)
        firsts = [bins.starts[r * columns + west] for r in (south, north)]
        lasts = [bins.starts[r * columns + east + 1] for r in (south, north)]
        firsts += [n + bins.starts_across[c * rows + south + 1] for c in (west, east)]
        lasts += [n + bins.starts_across[c * rows + north] for c in (west, east)]
        first, count = jnp.stack(firsts), jnp.where(known[None], jnp.stack(lasts) - jnp.stack(firsts), 0)

        def look(state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            k, low = state
            px, py, value = jnp.moveaxis(both[jnp.where(k < count, first + k, 0)], -1, 0)
            within = (k < count) & (jnp.abs(px - x[None]) <= half) & (jnp.abs(py - y[None]) <= half)
            return k + 1, jnp.minimum(low, jnp.where(within, value, jnp.inf).min(axis=0))

        low = lax.while_loop(lambda state: state[0] < count.max(), look, (jnp.int32(0), low))[1]
        return jnp.where(known, low, jnp.inf)

    queries = min(_QUERIES, len(xy))
    boxes = (xy.reshape(-1, queries, 2), true.reshape(-1, queries))
    return lax.map(ask, boxes).reshape(-1)
