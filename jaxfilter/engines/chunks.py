"""Kernels over many rows, in padded calls of few sizes, so that little is compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from ..core.compilation import in_turn


def padded(values: np.ndarray, size: int) -> np.ndarray:
    """[size, ...]: values [n, ...], and zeros after them."""
    if len(values) == size:
        return values
    return np.concatenate([values, np.zeros((size - len(values), *values.shape[1:]), values.dtype)])


def in_chunks(
    kernel: Callable[..., Any],
    given: Callable[[slice], tuple[np.ndarray, ...]],
    count: int,
    sizes: tuple[int, int],
    workers: int = 1,
) -> Any:
    """What a kernel makes of so many rows: a pytree of NumPy arrays [count, ...].

    Args:
        kernel: from arrays [size, ...] to a pytree of arrays [size, ...], row by row.
        given: its arguments for some of the rows, [rows, ...] each; they are padded with zeros.
        sizes: of calls: what does not fill half of a call of the second size is cut into calls of the first.
        workers: threads that prepare calls and wait for them, where there are more than two.
    """

    def call(part: tuple[slice, int]) -> Any:
        rows, size = part
        made = kernel(*(padded(values, size) for values in given(rows)))
        return jax.tree.map(lambda values: np.asarray(values)[: rows.stop - rows.start], made)

    parts = _parts(count, *sizes)
    several = workers > 1 and len(parts) > 2
    whole: Any = None
    for (rows, _), made in in_turn(call, parts, workers) if several else ((part, call(part)) for part in parts):
        if whole is None:
            whole = jax.tree.map(lambda values: np.empty((count, *values.shape[1:]), values.dtype), made)
        for out, values in zip(jax.tree.leaves(whole), jax.tree.leaves(made), strict=True):
            out[rows] = values
    return whole


def _parts(count: int, small: int, large: int) -> list[tuple[slice, int]]:
    """Rows of calls, and the sizes of these; the last may be padded, and there is one at least."""
    many = max(0, -(-(count - large // 2) // large))
    starts = [(i * large, large) for i in range(many)]
    starts += [(start, small) for start in range(many * large, max(count, 1), small)]
    return [(slice(start, min(start + size, count)), size) for start, size in starts]
