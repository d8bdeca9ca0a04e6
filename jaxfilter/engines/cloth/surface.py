"""The surface that a cloth falls onto: an elevation for every particle."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import lax

from ...core.arrays import GRID, MASK, operation
from ..grid.cells import block_minima
from ..grid.inpaint import fill_nearest, running


@operation(xyz="f32[n, 3]", carries="bool[n]", frame="f32[3]", extent="int[2]", shape=1, nearest=(False, True))
def lowest_below(
    xyz: jax.Array,
    carries: jax.Array,
    frame: jax.Array,
    extent: jax.Array,
    shape: tuple[int, int],
    nearest: bool,
) -> tuple[jax.Array, jax.Array]:
    """Elevation that each particle of a cloth can fall to, and which ones have a point.

    Points belong to the particle that they are nearest to. It falls onto the lowest of them, or with ``nearest`` onto that
    nearest to it, of equally near ones the lowest.

    Args:
        xyz: f32[n, 3] without NaN, local metres; carries: bool[n], the points that count.
        frame: f32[3], x and y of particle (0, 0), and the distance between particles, metres.
        extent: i32[2], true numbers of rows and columns; ``shape`` is padded.

    Returns: f32[rows, columns], zero where there is no point; bool[rows, columns].
    """
    at = (xyz[:, :2] - frame[None, :2]) / frame[2]
    node = jnp.floor(at + 0.5).astype(jnp.int32)
    column, row = jnp.clip(node[:, 0], 0, extent[1] - 1), jnp.clip(node[:, 1], 0, extent[0] - 1)
    index, cells = row * shape[1] + column, shape[0] * shape[1]
    if nearest:
        distance = jnp.where(carries, ((at - node.astype(at.dtype)) ** 2).sum(axis=1), jnp.inf)
        carries &= distance == block_minima(index, distance, cells)[0][index]
    lowest = block_minima(index, jnp.where(carries, xyz[:, 2], jnp.inf), cells)[0].reshape(shape)
    carried = lowest < jnp.inf
    return jnp.where(carried, lowest, 0), carried


@operation(z=GRID, known=MASK, inside=MASK)
def fill_along_lines(z: jax.Array, known: jax.Array, inside: jax.Array) -> jax.Array:
    """Give every unknown node the value of the next known one in its row or column.

    The next to the right is taken, else to the left, else below, else above; where row and column are empty, the nearest
    known node. As in the program of Zhang et al. (2016).

    Args: z f32 without NaN (metres), known bool, inside bool (nodes that exist), each [rows, columns].
    Returns: f32[rows, columns].

    >>> from jaxfilter.engines.cloth import surface
    >>> z = jnp.array([[1.0, 0.0, 3.0]])
    >>> known = jnp.array([[True, False, True]])
    >>> surface.fill_along_lines(z, known, jnp.ones((1, 3), bool)).tolist()
    [[1.0, 3.0, 3.0]]
    """
    known = known & inside

    def fill(axis: int, reverse: bool, filled: jax.Array, done: jax.Array) -> tuple[jax.Array, jax.Array]:
        size = z.shape[axis]
        place = lax.broadcasted_iota(jnp.int32, z.shape, axis)
        pick, none = (jnp.minimum, size) if reverse else (jnp.maximum, -1)
        source = running(pick, jnp.where(known, place, none), axis, reverse=reverse)
        found = (source >= 0) & (source < size)
        value = jnp.take_along_axis(z, jnp.clip(source, 0, size - 1), axis=axis)
        return jnp.where(~done & found, value, filled), done | found

    def across(filled: jax.Array, done: jax.Array) -> jax.Array:
        filled, done = fill(0, True, *fill(0, False, filled, done))
        return fill_nearest(filled, done & inside, inside)

    filled, done = fill(1, False, *fill(1, True, jnp.where(known, z, 0), known))
    return lax.cond((done | ~inside).all(), lambda filled, _: filled, across, filled, done)
