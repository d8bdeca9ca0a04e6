"""Lowest point of windows that slide over the plane at a stride smaller than their size.

Windows begin at 0, s, 2 s, ... from the lower corner of the cloud; per axis of length L there are
max(1, floor((L - w) / s) + 1), and the last one is stretched to the border (Li et al. 2021, Sec. II-C).
The windows are assembled from the minima of square blocks whose side measures both ``w`` and ``s``.
"""

from __future__ import annotations

import dataclasses
import math

import jax
import jax.numpy as jnp
from jax import lax

from ...core.arrays import GRID, operation
from ...core.errors import ParameterError, check_positive

_RESOLUTION = 1000  # window and stride count in millimetres


@dataclasses.dataclass(frozen=True)
class Windows:
    """Layout of sliding windows over a rectangle.

    Attributes:
        block: side of a block, metres.
        width, stride: window size and stride in blocks.
        blocks: number of blocks (rows, columns) that cover the rectangle.
        counts: number of windows (rows, columns).
    """

    block: float
    width: int
    stride: int
    blocks: tuple[int, int]
    counts: tuple[int, int]


def window_layout(extent: tuple[float, float], window: float, stride: float, name: str = "") -> Windows:
    """Windows of ``window`` metres every ``stride`` metres over ``extent`` (height, width) in metres.

    The block is the stride where that divides the window, else the greatest length that divides both.
    ``name`` stands for both in messages.
    Raises: ParameterError if stride or window are not whole millimetres, or not 0 < stride <= window.

    >>> from jaxfilter.engines.grid import windows
    >>> layout = windows.window_layout((20.0, 18.0), window=4.0, stride=2.0)
    >>> layout.width, layout.blocks, layout.counts
    (2, (10, 9), (9, 8))
    """
    check_positive(" of metres", window=window, stride=stride)
    w, s = round(window * _RESOLUTION), round(stride * _RESOLUTION)
    if not 0 < stride <= window:
        raise ParameterError(f"stride={stride!r}: must be > 0 and at most window={window!r} metres")
    if abs(w - window * _RESOLUTION) > 1e-6 * w or abs(s - stride * _RESOLUTION) > 1e-6 * s:
        raise ParameterError(f"{name or f'window={window!r}, stride={stride!r}'}: give whole millimetres")
    common = math.gcd(w, s)
    block = common / _RESOLUTION
    blocks = tuple(max(1, math.ceil(length / block - 1e-6)) for length in extent)
    counts = tuple(max(1, math.floor((length - window) / stride + 1e-9) + 1) for length in extent)
    return Windows(block, w // common, s // common, blocks, counts)  # type: ignore[arg-type]


def _lower(a: tuple[jax.Array, jax.Array], b: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
    """The lower of two (elevation, index) pairs; of equally low ones that of the lower index."""
    second = (b[0] < a[0]) | ((b[0] == a[0]) & (b[1] < a[1]))
    return jnp.where(second, b[0], a[0]), jnp.where(second, b[1], a[1])


def _slide(z: jax.Array, index: jax.Array, count: jax.Array, width: int, stride: int) -> tuple[jax.Array, jax.Array]:
    """Minima of windows along the first axis; entries from ``count`` on are those of no window."""
    none = jnp.iinfo(jnp.int32).max
    length = z.shape[0]

    def ahead(pair: tuple[jax.Array, jax.Array], step: int) -> tuple[jax.Array, jax.Array]:
        step = min(step, length)
        return tuple(
            jnp.concatenate([a[step:], jnp.full((step, *a.shape[1:]), fill, a.dtype)])
            for a, fill in zip(pair, (jnp.inf, none), strict=True)
        )  # type: ignore[return-value]

    run, pair = 1, (z, index)
    while 2 * run <= width:
        pair = _lower(pair, ahead(pair, run))
        run *= 2
    pair = _lower(pair, ahead(pair, width - run))
    begin = jnp.arange(length, dtype=jnp.int32)[:, None]
    in_last = begin >= (count - 1) * stride
    last_z = jnp.min(jnp.where(in_last, z, jnp.inf), axis=0, keepdims=True)
    last_index = jnp.min(jnp.where(in_last & (z == last_z), index, none), axis=0, keepdims=True)
    window = begin[: pair[0][::stride].shape[0]]
    return (
        jnp.where(window < count - 1, pair[0][::stride], jnp.where(window == count - 1, last_z, jnp.inf)),
        jnp.where(window < count - 1, pair[1][::stride], jnp.where(window == count - 1, last_index, none)),
    )


@operation(lowest=GRID, first="int[rows, columns]", counts="int[2]", width=1, stride=1)
def window_minima(
    lowest: jax.Array, first: jax.Array, counts: jax.Array, width: int, stride: int
) -> tuple[jax.Array, jax.Array]:
    """Lowest elevation in every window, and the point that has it.

    Args:
        lowest: f32[rows, columns] without NaN, metres, block minima as from
            :func:`jaxfilter.engines.grid.cells.block_minima`; +inf where empty or padding.
        first: i32[rows, columns], the points they belong to.
        counts: i32[2], number of windows (rows, columns).
        width, stride: window size and stride in blocks.

    Returns: f32 and i32 [ceil(rows / stride), ceil(columns / stride)]: +inf and the largest int32 in places beyond
        ``counts``; +inf and a number that is no point's in windows without points. Equally low points give the lowest
        index.

    >>> from jaxfilter.engines.grid import windows
    >>> blocks = jnp.array([[3.0, 1.0, 2.0, 4.0]])
    >>> number = jnp.arange(4, dtype=jnp.int32)[None]
    >>> low, point = windows.window_minima(blocks, number, jnp.array([1, 3]), width=2, stride=1)
    >>> low.tolist(), point[0, :3].tolist()
    ([[1.0, 1.0, 2.0, inf]], [1, 1, 2])
    """
    z, index = _slide(lowest, first, counts[0], width, stride)
    z, index = _slide(z.T, index.T, counts[1], width, stride)
    return lax.transpose(z, (1, 0)), lax.transpose(index, (1, 0))
