"""Flat grey-scale morphology with squares, diamonds and exact Euclidean disks of any radius.

Minima of runs of 1, 2, 4, ... cells are made by doubling; a run of any length is the union of two overlapping ones, and
a disk or a diamond is the union of one such run per row. The radius is traced: one compilation serves all radii up to
``reach``.

Cells beyond the border never take part: they count as +inf in an erosion and as -inf in a dilation, so that nothing is
drawn towards the border. The results equal those of ``scipy.ndimage`` with that padding bit for bit.

Source: J. Serra, Image Analysis and Mathematical Morphology (1982); run-wise decomposition of disks after E. R. Urbach
and M. H. F. Wilkinson, IEEE Trans. Image Processing 17 (2008), 1-8.
"""

from __future__ import annotations

import functools
import math

import jax
import jax.numpy as jnp
from jax import lax

_ROWS_AT_ONCE = 2


def _isqrt(n: jax.Array) -> jax.Array:
    """Integer square root; exact below 2**24, where float32 represents all integers and rounds square roots correctly."""
    return jnp.floor(jnp.sqrt(jnp.maximum(n, 0).astype(jnp.float32))).astype(jnp.int32)


def _erode_round(z: jax.Array, radius: jax.Array, reach: int, diamond: bool) -> jax.Array:
    def half_chord(row: jax.Array) -> jax.Array:  # also the last row with a half chord of so many cells, by symmetry
        return radius - row if diamond else _isqrt(radius * radius - row * row)

    spare = 2 ** int(math.log2(2 * reach + 1))
    border = jnp.pad(z, reach, constant_values=jnp.inf)

    def rows_of_one_level(state: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        run, minima, out = state  # minima[i, j]: lowest of cells j .. j + run - 1 of row i
        first = jnp.where(run > radius, 0, half_chord(run) + 1)
        last = half_chord(run // 2)  # rows first..last have chords of run to 2 * run - 1 cells

        def rows(step: jax.Array, out: jax.Array) -> jax.Array:
            for k in range(_ROWS_AT_ONCE):
                row = jnp.minimum(first + step * _ROWS_AT_ONCE + k, last)
                half = half_chord(row)
                for i in (reach - row, reach + row):
                    for j in (reach - half, reach + half + 1 - run):
                        out = jnp.minimum(out, lax.dynamic_slice(minima, (i, j), z.shape))
            return out

        out = lax.fori_loop(jnp.int32(0), (last - first + _ROWS_AT_ONCE) // _ROWS_AT_ONCE, rows, out)
        wide = jnp.pad(minima, ((0, 0), (0, spare)), constant_values=jnp.inf)
        minima = jnp.minimum(minima, lax.dynamic_slice(wide, (jnp.int32(0), run), minima.shape))
        return 2 * run, minima, out

    start = (jnp.int32(1), border, z)
    return lax.while_loop(lambda state: state[0] <= 2 * radius + 1, rows_of_one_level, start)[2]


def _along(axis: int, step: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Where a slice begins that is shifted along one axis."""
    return (step, jnp.int32(0)) if axis == 0 else (jnp.int32(0), step)


def run_minima(z: jax.Array, length: jax.Array, longest: int, axis: int) -> jax.Array:
    """Lowest of each cell and the ``length`` - 1 cells that follow it along an axis, as far as there are any.

    Args: z: f32[rows, columns]; length: i32[], 1 <= length <= longest. Returns: f32[rows, columns].
    """
    widths = [(0, 0), (0, 0)]
    widths[axis] = (0, 2 ** int(math.log2(longest)))

    def ahead(array: jax.Array, step: jax.Array) -> jax.Array:
        wide = jnp.pad(array, widths, constant_values=jnp.inf)
        return lax.dynamic_slice(wide, _along(axis, step), array.shape)

    def double(state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        run, minima = state
        return 2 * run, jnp.minimum(minima, ahead(minima, run))

    run, minima = lax.while_loop(lambda state: 2 * state[0] <= length, double, (jnp.int32(1), z))
    return jnp.minimum(minima, ahead(minima, length - run))


def _erode_run(z: jax.Array, radius: jax.Array, reach: int, axis: int) -> jax.Array:
    """Lowest of the 2 * radius + 1 cells along one axis."""
    widths = [(0, 0), (0, 0)]
    widths[axis] = (reach, reach)
    minima = run_minima(jnp.pad(z, widths, constant_values=jnp.inf), 2 * radius + 1, 2 * reach + 1, axis)
    return lax.dynamic_slice(minima, _along(axis, reach - radius), z.shape)


@functools.partial(jax.jit, static_argnames=("reach", "element"))
def erosion(z: jax.Array, radius: jax.Array | int, reach: int, element: str = "disk") -> jax.Array:
    """Lowest value under a flat structuring element centred on every cell.

    Args:
        z: f32[rows, columns] without NaN.
        radius: i32[], cells, 0 <= radius <= reach (not checked, since traced).
        reach: the largest radius that this compilation serves, below 4096.
        element: "disk" takes the cells within the Euclidean distance ``radius`` (radius 1 is the cross of five cells),
            "square" those within ``radius`` rows and columns, "diamond" those within ``radius`` steps along rows and columns.

    Returns: f32[rows, columns]. Raises: ValueError for another element.
    """
    radius = jnp.asarray(radius, jnp.int32)
    if element in ("disk", "diamond"):
        return _erode_round(z, radius, reach, element == "diamond")
    if element == "square":
        return _erode_run(_erode_run(z, radius, reach, 1), radius, reach, 0)
    raise ValueError(f"element={element!r}: use 'disk', 'square' or 'diamond'")


@functools.partial(jax.jit, static_argnames=("reach", "element"))
def dilation(z: jax.Array, radius: jax.Array | int, reach: int, element: str = "disk") -> jax.Array:
    """Highest value under a flat structuring element centred on every cell; arguments as for :func:`erosion`."""
    return -erosion(-z, radius, reach, element)


@functools.partial(jax.jit, static_argnames=("reach", "element"))
def opening(
    z: jax.Array, radius: jax.Array | int, reach: int, element: str = "disk", valid: jax.Array | None = None
) -> jax.Array:
    """Erosion followed by dilation: the largest surface below ``z`` that a flat element can touch everywhere.

    ``valid``, bool[rows, columns], marks the cells that exist; the others are treated as lying beyond the border and are
    returned as they came. Further arguments as for :func:`erosion`. Never above ``z``, and idempotent.
    """
    if valid is None:
        return dilation(erosion(z, radius, reach, element), radius, reach, element)
    eroded = erosion(jnp.where(valid, z, jnp.inf), radius, reach, element)
    return jnp.where(valid, dilation(jnp.where(valid, eroded, -jnp.inf), radius, reach, element), z)
