"""Kernels over many rows, in padded calls of few sizes, so that little is compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from ..core.compilation import in_turn


def padded(values: np.ndarray, size: int, axis: int = 0) -> np.ndarray:
    """So many values along an axis, zeros after those that there are."""
    if values.shape[axis] == size:
        return values
    shape = list(values.shape)
    shape[axis] = size - shape[axis]
    return np.concatenate([values, np.zeros(shape, values.dtype)], axis)


def in_chunks(
    kernel: Callable[..., Any],
    given: Callable[[slice], tuple[Any, ...]],
    count: int,
    size: int,
    workers: int = 1,
    axis: int = 0,
) -> Any:
    """What a kernel makes of so many rows: a pytree of NumPy arrays [count, ...].

    Args:
        kernel: from arrays to a pytree of arrays [size, ...], row by row.
        given: its arguments for some of the rows, pytrees; arrays are padded with zeros.
        size: rows of a call.
        workers: threads that prepare calls and wait for them, where there are more than two.
        axis: of all arguments along which rows are counted.
    """

    def call(rows: slice) -> Any:
        made = kernel(*jax.tree.map(lambda leaf: padded(leaf, size, axis) if np.ndim(leaf) > 0 else leaf, given(rows)))
        return jax.tree.map(lambda values: np.asarray(values)[: rows.stop - rows.start], made)

    parts = [slice(start, min(start + size, count)) for start in range(0, max(count, 1), size)]
    several = workers > 1 and len(parts) > 2
    whole: Any = None
    for rows, made in in_turn(call, parts, workers) if several else ((part, call(part)) for part in parts):
        if whole is None:
            whole = jax.tree.map(lambda values: np.empty((count, *values.shape[1:]), values.dtype), made)
        for out, values in zip(jax.tree.leaves(whole), jax.tree.leaves(made), strict=True):
            out[rows] = values
    return whole
