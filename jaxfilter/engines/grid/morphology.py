"""Flat grey-scale morphology with squares, diamonds and exact Euclidean disks of any radius.

Minima of runs of 1, 2, 4, ... cells are made by doubling; a run of any length is the union of two overlapping ones, and
a disk or a diamond is the union of one such run per row. The radius is traced: one compilation serves all radii up to
``reach``. Progressive openings with disks erode in fewer steps: the disks of all radii grow out of each other.

Cells beyond the border never take part: they count as +inf in an erosion and as -inf in a dilation, so that nothing is
drawn towards the border. The results equal those of ``scipy.ndimage`` with that padding bit for bit.

Source: J. Serra, Image Analysis and Mathematical Morphology (1982); run-wise decomposition of disks after E. R. Urbach
and M. H. F. Wilkinson, IEEE Trans. Image Processing 17 (2008), 1-8.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ...core.arrays import MASK, operation, takes

T = TypeVar("T")
_ROWS_AT_ONCE = 2
_RIM_AT_ONCE = 4
_REAL, _ELEMENTS = "real[rows, columns]", ("disk", "square", "diamond")
_CROSS = ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0))
_STRIP = 2**19  # cells that a processor keeps close while it goes over them again and again


def _order(z: jax.Array, dtype: Any = None) -> jax.Array:
    """Integers in the order of floating-point numbers without NaN, or back to those of a ``dtype``; integers as they are.

    Processors take the lower of two integers in one step, of two floating-point numbers, with NaN in mind, in several.
    """
    if not jnp.issubdtype(dtype or z.dtype, jnp.floating):
        return z
    size = 8 * z.dtype.itemsize
    bits = lax.bitcast_convert_type(z, jnp.dtype(f"int{size}")) if dtype is None else z
    bits ^= (bits >> (size - 1)) & jnp.iinfo(bits.dtype).max
    return bits if dtype is None else lax.bitcast_convert_type(bits, dtype)


def _isqrt(n: jax.Array) -> jax.Array:
    """Integer square root below 2**24, where float32 represents all integers; exact on devices that round roots badly too."""
    n = jnp.maximum(n, 0)
    root = jnp.floor(jnp.sqrt(n.astype(jnp.float32))).astype(jnp.int32)
    root = jnp.where(root * root > n, root - 1, root)
    return jnp.where((root + 1) * (root + 1) <= n, root + 1, root)


def _beyond(z: jax.Array) -> jax.Array:
    """What cells beyond the border hold: no less than all others."""
    most = jnp.inf if jnp.issubdtype(z.dtype, jnp.floating) else jnp.iinfo(z.dtype).max
    return jnp.array(most, z.dtype)


def _with_border(z: jax.Array, width: int, rows: int | None = None) -> jax.Array:
    """With what lies beyond the border around it, so many cells wide, for a grid of so many rows."""
    border = jnp.full(((rows or z.shape[0]) + 2 * width, z.shape[1] + 2 * width), _beyond(z))
    return lax.dynamic_update_slice(border, z, (width, width))  # in a quarter of the time of jnp.pad


def _erode_round(z: jax.Array, radius: jax.Array, reach: int, diamond: bool) -> jax.Array:
    """Strip by strip, since all runs of a strip fit into a processor's cache; elsewhere the whole is one strip."""
    rows, columns = z.shape
    if reach == 1:  # a disk or diamond of one cell is the cross
        near = _with_border(z, 1)
        cross = (lax.slice(near, (1 + i, 1 + j), (1 + i + rows, 1 + j + columns)) for i, j in _CROSS)
        return jnp.where(radius > 0, functools.reduce(jnp.minimum, cross), z)
    tall = max(_STRIP // columns, 2 * reach, 1) if jax.default_backend() == "cpu" else rows
    strips = -(-rows // tall)
    tall = -(-rows // strips)
    border = _with_border(z, reach, strips * tall)
    if strips == 1:
        return _erode_strip(border, radius, reach, diamond)

    def next_strip(k: jax.Array, out: jax.Array) -> jax.Array:
        strip = lax.dynamic_slice(border, (k * tall, jnp.int32(0)), (tall + 2 * reach, columns + 2 * reach))
        return lax.dynamic_update_slice(out, _erode_strip(strip, radius, reach, diamond), (k * tall, jnp.int32(0)))

    return lax.fori_loop(jnp.int32(0), strips, next_strip, jnp.zeros((strips * tall, columns), z.dtype))[:rows]


def _erode_strip(border: jax.Array, radius: jax.Array, reach: int, diamond: bool) -> jax.Array:
    """Lowest of a disk or diamond; ``border`` is wider by ``reach`` on all sides than what is returned."""

    def half_chord(row: jax.Array) -> jax.Array:  # also the last row with a half chord of so many cells, by symmetry
        return radius - row if diamond else _isqrt(radius * radius - row * row)

    shape = border.shape[0] - 2 * reach, border.shape[1] - 2 * reach
    spare = 2 ** int(math.log2(2 * reach + 1))

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
                        out = jnp.minimum(out, lax.dynamic_slice(minima, (i, j), shape))
            return out

        out = lax.fori_loop(jnp.int32(0), (last - first + _ROWS_AT_ONCE) // _ROWS_AT_ONCE, rows, out)
        wide = jnp.pad(minima, ((0, 0), (0, spare)), constant_values=_beyond(minima))
        minima = jnp.minimum(minima, lax.dynamic_slice(wide, (jnp.int32(0), run), minima.shape))
        return 2 * run, minima, out

    start = (jnp.int32(1), border, lax.slice(border, (reach, reach), (reach + shape[0], reach + shape[1])))
    return lax.while_loop(lambda state: state[0] <= 2 * radius + 1, rows_of_one_level, start)[2]


def _along(axis: int, one: T, other: T) -> tuple[T, T]:
    """Something for this axis, and another for the other one."""
    return (one, other) if axis == 0 else (other, one)


@takes(z=_REAL, length="int[]", longest=1, axis=(0, 1))
def run_minima(z: jax.Array, length: jax.Array, longest: int, axis: int) -> jax.Array:
    """Lowest of each cell and the ``length`` - 1 cells that follow it along an axis, as far as there are any.

    Args: z: as for :func:`erosion`; length: i32[], 1 <= length <= longest. Returns: [rows, columns] of the type of z.

    >>> from jaxfilter.engines.grid import morphology
    >>> z = jnp.array([[4.0, 2.0, 3.0, 5.0, 1.0]])
    >>> morphology.run_minima(z, jnp.int32(2), longest=4, axis=1).tolist()
    [[2.0, 2.0, 3.0, 1.0, 1.0]]
    """
    widths = _along(axis, (0, 2 ** int(math.log2(longest))), (0, 0))

    def ahead(array: jax.Array, step: jax.Array) -> jax.Array:
        wide = jnp.pad(array, widths, constant_values=_beyond(array))
        return lax.dynamic_slice(wide, _along(axis, step, jnp.int32(0)), array.shape)

    def double(state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        run, minima = state
        return 2 * run, jnp.minimum(minima, ahead(minima, run))

    run, minima = lax.while_loop(lambda state: 2 * state[0] <= length, double, (jnp.int32(1), z))
    return jnp.minimum(minima, ahead(minima, length - run))


def _erode_run(z: jax.Array, radius: jax.Array, reach: int, axis: int) -> jax.Array:
    """Lowest of the 2 * radius + 1 cells along one axis."""
    widths = _along(axis, (reach, reach), (0, 0))
    minima = run_minima(jnp.pad(z, widths, constant_values=_beyond(z)), 2 * radius + 1, 2 * reach + 1, axis)
    return lax.dynamic_slice(minima, _along(axis, reach - radius, jnp.int32(0)), z.shape)


def _erode(z: jax.Array, radius: jax.Array, reach: int, element: str) -> jax.Array:
    """:func:`erosion` of integers."""
    if element in ("disk", "diamond"):
        return _erode_round(z, radius, reach, element == "diamond")
    return _erode_run(_erode_run(z, radius, reach, 1), radius, reach, 0)


def _dilate(z: jax.Array, radius: jax.Array, reach: int, element: str, valid: jax.Array) -> jax.Array:
    """The dilation of integers of ``valid`` cells. Their complements have the opposite order."""
    return ~_erode(jnp.where(valid, ~z, _beyond(z)), radius, reach, element)


@functools.cache
def _rims(reach: int) -> tuple[np.ndarray, np.ndarray]:
    """What the disk of every radius up to ``reach`` has beyond the five disks of a radius less by one that lie in it.

    Returns: rows and columns from the centre of these cells, one disk after the other, i32[n, 2], the cells of a disk
        repeated to a multiple of ``_RIM_AT_ONCE``; and where those of each radius begin, i32[reach + 2].
    """
    cells: list[tuple[int, int]] = []
    starts = [0, 0]
    for radius in range(1, reach + 1):
        smaller = [math.isqrt((radius - 1) ** 2 - row**2) for row in range(radius)] + [-1, -1]  # half chords
        rim: list[tuple[int, int]] = []
        for row in range(radius + 1):
            covered = max(smaller[row] + 1 if row < radius else -1, smaller[abs(row - 1)], smaller[row + 1])
            for column in range(covered + 1, math.isqrt(radius**2 - row**2) + 1):
                rim += sorted({(i, j) for i in (-row, row) for j in (-column, column)})
        cells += rim + rim[:1] * (-len(rim) % _RIM_AT_ONCE)
        starts.append(len(cells))
    return np.array(cells, np.int32).reshape(-1, 2), np.array(starts, np.int32)


def _grow(eroded: jax.Array, z: jax.Array, radius: jax.Array, reach: int) -> jax.Array:
    """The erosion of ``z`` with a disk, by that with the disk whose radius is less by one.

    Five of the smaller disks, moved by one cell at most, leave little of the larger one: 8 cells of 1,009 at radius 18.
    """
    cells, starts = (jnp.asarray(table) for table in _rims(reach))
    (rows, columns), near, border = z.shape, _with_border(eroded, 1), _with_border(z, reach)
    moved = (lax.slice(near, (1 + i, 1 + j), (1 + i + rows, 1 + j + columns)) for i, j in _CROSS)

    def rim(step: jax.Array, out: jax.Array) -> jax.Array:
        for k in range(_RIM_AT_ONCE):
            at = cells[step * _RIM_AT_ONCE + k] + reach
            out = jnp.minimum(out, lax.dynamic_slice(border, (at[0], at[1]), z.shape))
        return out

    out = functools.reduce(jnp.minimum, moved)
    if len(cells) == 0:  # as with disks of two cells and less
        return out
    return lax.fori_loop(starts[radius] // _RIM_AT_ONCE, starts[radius + 1] // _RIM_AT_ONCE, rim, out)


@takes(reach=0)
def roomy(reach: int) -> int:
    """The next of 1, 2, ... 8, 10, 12, 14, 16, 20, ...: a ``reach`` that many radii share, so that each need not be compiled.

    >>> from jaxfilter.engines.grid import morphology
    >>> [morphology.roomy(reach) for reach in (1, 7, 9, 18, 33)]
    [1, 7, 10, 20, 40]
    """
    step = 2 ** max(0, math.ceil(math.log2(max(reach, 1))) - 3)
    return -(-reach // step) * step


@operation(z=_REAL, radius="int[]", reach=0, element=_ELEMENTS)
def erosion(z: jax.Array, radius: jax.Array | int, reach: int, element: str = "disk") -> jax.Array:
    """Lowest value under a flat structuring element centred on every cell.

    Args:
        z: [rows, columns] without NaN, of integers or floating-point numbers of any width; not bool.
        radius: i32[], cells, 0 <= radius <= reach (not checked, since traced).
        reach: the largest radius that this compilation serves, below 4096.
        element: "disk" takes the cells within the Euclidean distance ``radius`` (radius 1 is the cross of five cells),
            "square" those within ``radius`` rows and columns, "diamond" those within ``radius`` steps along rows and columns.

    Returns: [rows, columns] of the type of z. Raises: ParameterError for another element, InputError for other arrays.

    >>> from jaxfilter.engines.grid import morphology
    >>> z = jnp.zeros((5, 5)).at[2, 2].set(-3.0)
    >>> morphology.erosion(z, 1, reach=4).astype(int).tolist()[2]
    [0, -3, -3, -3, 0]
    """
    return _order(_erode(_order(z), jnp.asarray(radius, jnp.int32), reach, element), z.dtype)


@operation(z=_REAL, radius="int[]", reach=0, element=_ELEMENTS)
def dilation(z: jax.Array, radius: jax.Array | int, reach: int, element: str = "disk") -> jax.Array:
    """Highest value under a flat structuring element centred on every cell; arguments as for :func:`erosion`.

    >>> from jaxfilter.engines.grid import morphology
    >>> z = jnp.zeros((5, 5)).at[2, 2].set(3.0)
    >>> morphology.dilation(z, 1, reach=4).astype(int).tolist()[2]
    [0, 3, 3, 3, 0]
    """
    return _order(~_erode(~_order(z), jnp.asarray(radius, jnp.int32), reach, element), z.dtype)


@operation(z=_REAL, radius="int[]", reach=0, element=_ELEMENTS, valid=MASK)
def opening(
    z: jax.Array, radius: jax.Array | int, reach: int, element: str = "disk", valid: jax.Array | None = None
) -> jax.Array:
    """Erosion followed by dilation: the largest surface below ``z`` that a flat element can touch everywhere.

    ``valid``, bool[rows, columns], marks the cells that exist; the others are treated as lying beyond the border and are
    returned as they came. Further arguments as for :func:`erosion`. Never above ``z``, and idempotent.

    >>> from jaxfilter.engines.grid import morphology
    >>> z = jnp.zeros((5, 5)).at[2, 2].set(3.0)
    >>> float(morphology.opening(z, 1, reach=4).max())
    0.0
    """
    there = jnp.ones(jnp.shape(z), bool) if valid is None else valid
    radius, level = jnp.asarray(radius, jnp.int32), _order(z)
    eroded = _erode(jnp.where(there, level, _beyond(level)), radius, reach, element)
    return _order(jnp.where(there, _dilate(eroded, radius, reach, element, there), level), z.dtype)


@takes(z=_REAL, valid=MASK, radii="int[n]", reach=0, element=_ELEMENTS, count="int[]")
def progressive_opening(
    z: jax.Array,
    valid: jax.Array,
    radii: jax.Array,
    look: Callable[[jax.Array, jax.Array, jax.Array, T], T],
    found: T,
    *,
    reach: int,
    element: str = "disk",
    count: jax.Array | int | None = None,
) -> tuple[jax.Array, T]:
    """Openings with one radius after the other, each of the surface that the one before has left.

    Args:
        z: as for :func:`erosion`.
        valid: bool[rows, columns], the cells that exist, as for :func:`opening`; a rectangle.
        radii: i32[openings], cells, 0 <= radius <= reach, none smaller than the one before.
        look: called as ``look(k, before, opened, found)`` for each opening, with its number i32[], the surfaces before and
            after it, and what the previous call has returned; arrays of the same shapes and dtypes.
        found: what the first call is given, a pytree of arrays.
        reach, element: as for :func:`erosion`.
        count: i32[], how many of the radii are used; by default all.

    Returns: the last surface, [rows, columns] of the type of z, and what the last call of ``look`` has returned.

    >>> from jaxfilter.engines.grid import morphology
    >>> z = jnp.zeros((5, 5)).at[1:4, 1:4].set(3.0)
    >>> look = lambda k, before, opened, most: jnp.maximum(most, before - opened)
    >>> last, drop = morphology.progressive_opening(
    ...     z, jnp.ones((5, 5), bool), jnp.array([1, 2]), look, jnp.zeros_like(z), reach=4)
    >>> float(last.max()), float(drop[2, 2])
    (0.0, 3.0)
    """

    z, radii = jnp.asarray(z), jnp.asarray(radii, jnp.int32)
    if len(radii) == 0:
        return z, found

    def eroded(k: jax.Array, before: jax.Array, smaller: jax.Array) -> jax.Array:
        there = jnp.where(valid, before, _beyond(before))
        if element != "disk":
            return _erode(there, radii[k], reach, element)
        # An opening leaves the erosion with its disk as it was, so that the next erosion can begin with that.
        first = jnp.where(k == 0, 0, radii[k - 1])
        return lax.fori_loop(first + 1, radii[k] + 1, lambda radius, out: _grow(out, there, radius, reach), smaller)

    def open_once(k: jax.Array, state: tuple[jax.Array, jax.Array, T]) -> tuple[jax.Array, jax.Array, T]:
        before, smaller, found = state
        lowest = eroded(k, before, smaller)
        opened = jnp.where(valid, _dilate(lowest, radii[k], reach, element, valid), before)
        return opened, lowest, look(k, _order(before, z.dtype), _order(opened, z.dtype), found)

    start = _order(z)
    number = len(radii) if count is None else count
    last, _, found = lax.fori_loop(0, number, open_once, (start, jnp.where(valid, start, _beyond(start)), found))
    return _order(last, z.dtype), found


@operation(z="f32[rows, columns]", valid=MASK, radii="int[n]", heights="number[n]", reach=0, element=_ELEMENTS)
def raised_cells(
    z: jax.Array, valid: jax.Array, radii: jax.Array, heights: jax.Array, *, reach: int, element: str = "disk"
) -> jax.Array:
    """Cells that one of the progressive openings lowers by more than its height.

    Args: as for :func:`progressive_opening`, z f32; ``heights``: f32[openings], in the unit of ``z``.
    Returns: bool[rows, columns], False where not ``valid``.
    """

    def look(k: jax.Array, before: jax.Array, opened: jax.Array, raised: jax.Array) -> jax.Array:
        return raised | (valid & (before - opened > heights[k]))

    none = jnp.zeros_like(valid)
    return progressive_opening(z, valid, radii, look, none, reach=reach, element=element)[1]
