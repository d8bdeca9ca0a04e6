"""Counts behind every score."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from .core.arrays import operation


@operation(ground="bool[n]", reference="bool[n]", counted="bool[n]")
def confusion_counts(ground: jax.Array, reference: jax.Array, counted: jax.Array) -> jax.Array:
    """Confusion matrix of one labelling.

    Args:
        ground: bool[n], labels to judge; True = ground.
        reference: bool[n], true labels.
        counted: bool[n], the points that count; padding is False.

    Returns: i32[2, 2], rows reference ground and object, columns labelled ground and object. Sums are of integers, so
        exact for every n that an int32 can count.

    >>> from jaxfilter import metrics
    >>> ground, reference = jnp.array([True, True, False]), jnp.array([True, False, False])
    >>> metrics.confusion_counts(ground, reference, jnp.ones(3, bool)).tolist()
    [[1, 0], [1, 1]]
    """
    rows = (reference & counted, ~reference & counted)
    return jnp.stack([jnp.stack([jnp.sum(r & c, dtype=jnp.int32) for c in (ground, ~ground)]) for r in rows])
