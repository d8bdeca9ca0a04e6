"""Nearest points in the four quadrants around other points of the plane, by rings of grid cells."""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

_CHUNK = 2048  # queries that are searched together: the last of them decides how far
_SIGNS = ((1, 1), (-1, 1), (-1, -1), (1, -1))


class Buckets(NamedTuple):
    """Points sorted by grid cell.

    Attributes:
        xy: f32[n, 2], local metres.
        row: i32[n], what each is called.
        start: i32[cells + 1], where each cell begins in them.
        side: f32[], of a cell, metres.
        extent: i32[2], rows and columns of cells.
    """

    xy: jax.Array
    row: jax.Array
    start: jax.Array
    side: jax.Array
    extent: jax.Array


class Nearest(NamedTuple):
    """Per query and quadrant, counter-clockwise from the north-east.

    Attributes:
        row: i32[q, 4], the nearest point; -1 if there is none.
        square: f32[q, 4], its squared distance, m2; where there is none, the square of the distance searched.
    """

    row: jax.Array
    square: jax.Array


def _rings(radius: int) -> list[tuple[int, int]]:
    """Steps of cells into a quadrant, those that may hold nearer points first."""
    steps = [(i, j) for i in range(radius + 1) for j in range(radius + 1) if _gap(i, j) < radius**2]
    return sorted(steps, key=lambda s: (_gap(*s), s))


def _gap(i: int, j: int) -> int:
    """Square of the least distance, in cells, between points in cells that are so many columns and rows apart."""
    return max(i - 1, 0) ** 2 + max(j - 1, 0) ** 2


@functools.partial(jax.jit, static_argnames="radius")
def nearest_in_quadrants(buckets: Buckets, query: jax.Array, home: jax.Array, known: Nearest, radius: int) -> Nearest:
    """Those of ``known``, or points of the buckets that are nearer, up to ``radius`` cells away.

    Quadrants are half-open, so that each point is in one: the first holds the eastern axis and the query's own position,
    the second the northern axis, and so on. Exact for distances up to ``radius * side``. Of equally near points the one
    in ``known`` stays, else that in the nearer ring of cells, else the first of ``buckets``.

    Args:
        query: f32[q, 2], local metres; q is a multiple of 2048. Neighbouring queries should stand together.
        home: i32[q], the cell of every query, row by row.
        known: squared distances of 0 end the search of a quadrant at once.
        radius: cells, at least 1.
    """
    xy, row, start, side, extent = buckets
    rings = _rings(radius)
    steps = jnp.asarray(rings, jnp.int32)
    gaps = jnp.asarray([*(_gap(*s) for s in rings), radius**2], jnp.float32) * side * side
    signs = jnp.asarray(_SIGNS, jnp.int32)

    def chunk(given: tuple[jax.Array, jax.Array, Nearest]) -> Nearest:
        at, inside, before = given
        own = jnp.stack([inside % extent[1], inside // extent[1]], axis=1)

        def ring(state: tuple[jax.Array, Nearest]) -> tuple[jax.Array, Nearest]:
            n, best = state
            cell = own[:, None] + signs * steps[n]
            there = ((cell >= 0) & (cell < extent[::-1])).all(axis=-1) & (best.square > gaps[n])
            flat = jnp.where(there, cell[..., 1] * extent[1] + cell[..., 0], 0)
            first = start[flat]
            count = jnp.where(there, start[flat + 1] - first, 0)

            def look(state: tuple[jax.Array, Nearest]) -> tuple[jax.Array, Nearest]:
                k, best = state
                i = first + jnp.minimum(k, count - 1)
                dx, dy = jnp.moveaxis(xy[i] - at[:, None], -1, 0)
                quadrant = jnp.where(
                    dy > 0,
                    jnp.where(dx > 0, 0, 1),
                    jnp.where(dx < 0, 2, jnp.where(dy < 0, 3, 0)),
                )
                square = dx * dx + dy * dy
                nearer = (k < count) & (quadrant == jnp.arange(4, dtype=jnp.int32)) & (square < best.square)
                return k + 1, Nearest(jnp.where(nearer, row[i], best.row), jnp.where(nearer, square, best.square))

            return n + 1, lax.while_loop(lambda s: s[0] < count.max(), look, (jnp.int32(0), best))[1]

        def unfinished(state: tuple[jax.Array, Nearest]) -> jax.Array:
            return (state[0] < len(rings)) & (state[1].square > gaps[state[0]]).any()

        return lax.while_loop(unfinished, ring, (jnp.int32(0), before))[1]

    shape = (len(query) // _CHUNK, _CHUNK)
    split = jax.tree.map(lambda a: a.reshape(*shape, *a.shape[1:]), (query, home, known))
    found = lax.map(chunk, split)
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), found)
