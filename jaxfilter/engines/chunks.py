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
    size: int,
    workers: int = 1,
) -> Any:
    """What a kernel makes of so many rows: a pytree of NumPy arrays [count, ...].

    Args:
        kernel: from arrays [size, ...] to a pytree of arrays [size, ...], row by row.
        given: its arguments for some of the rows, [rows, ...] each; they are padded with zeros.
        size: rows of a call.
        workers: threads that prepare calls and wait for them, where there are more than two.
    """

    def call(rows: slice) -> Any:
        made = kernel(*(padded(values, size) for values in given(rows)))
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
