"""How likely the label of a point is to be wrong: what speaks for and against it, and a logistic model of these figures."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..core.compilation import bucket
from ..core.filter import Labels
from ..engines.chunks import in_chunks
from .doubt_model import DOUBT_MODEL
from .pruning import Scatter

FEATURES = (
    "height", "near", "below", "drop", "flip", "residual", "roughness", "facet", "landscape",
)  # fmt: skip
"""What :func:`evidence` says of each point, in this order."""
_ROWS = 2**14
"""Points that are looked at at a time: what is made of them stays in the cache."""


def doubts(labels: Labels, scatter: Scatter, drop: np.ndarray, landscape: np.ndarray, tolerance: float) -> np.ndarray:
    """f32[m]: how likely the labels of points are to be wrong.

    Args:
        labels: of the points m, with heights and slopes over the final triangulation; scatter: of all of them.
        drop: f32[m], steepest drop of the cell of each point over the limit from which on cells are marked.
        landscape: f32[m], rise over run. tolerance: height of ground over the facets of the seeds, metres.
    """
    given: Any = labels.ground, labels.height, labels.slope, *scatter, drop, landscape
    size, least = bucket(min(len(drop), _ROWS)), max(tolerance, 0.01)
    found: np.ndarray = in_chunks(
        lambda labels, *columns: probability(np.asarray(evidence(*columns, least)), labels),
        lambda rows: tuple(column[rows] for column in given),
        len(drop),
        size,
    )
    return found


@jax.jit
def evidence(
    height: jax.Array,
    slope: jax.Array,
    residual: jax.Array,
    roughness: jax.Array,
    drop: jax.Array,
    landscape: jax.Array,
    tolerance: jax.Array,
) -> jax.Array:
    """f32[n, 9]: figures without a unit that tell certain labels from doubtful ones. Lengths are in tolerances.

    ``height``: of the point over the triangulation of the ground, log(1 + |h|), at most 4. ``near``: 1 where that is one
    tolerance, less where it is more or fewer. ``below``: log(1 + h) of points below it, at most 3. ``drop``: logarithm of
    the steepest drop of the cell in terms of its limit, -3 to 2. ``flip``: 1 where the cell is at the limit, 0 from a factor
    of e on. ``residual``: of a vertex above the plane of its neighbours, log(1 + e). ``roughness``: log(1 + root mean
    square) of these around the point. ``facet``: slope of its facet, at most 1.5. ``landscape``: square root of its slope,
    at most 1.

    Args: f32[n] each, and f32, as for :func:`doubts`; ``height`` in metres and ``slope`` in degrees over the triangulation,
    ``residual`` and ``roughness`` as in :class:`jaxfilter.steps.pruning.Scatter`. What is not a number is zero.
    """
    h = height / tolerance
    size = jnp.abs(h)
    steepness = jnp.clip(jnp.log(jnp.maximum(drop, 1e-3)), -3, 2)
    columns = (
        jnp.minimum(jnp.log1p(size), 4),
        jnp.exp(-jnp.abs(jnp.log(jnp.maximum(size, 0.05)))),
        jnp.minimum(jnp.log1p(jnp.maximum(-h, 0)), 3),
        steepness,
        jnp.maximum(0, 1 - jnp.abs(steepness)),
        jnp.log1p(jnp.maximum(residual, 0) / tolerance),
        jnp.log1p(roughness / tolerance),
        jnp.minimum(jnp.tan(jnp.radians(jnp.minimum(slope, 80))), 1.5),
        jnp.sqrt(jnp.clip(landscape, 0, 1)),
    )
    return jnp.nan_to_num(jnp.stack(columns, axis=1))


def probability(evidence: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """f32[m]: how likely the labels ``ground``, bool[m], are to be wrong, by ``evidence``, f32[m, features].

    At most one half: of two labels the method takes the more likely one.
    """
    other, own = (evidence @ DOUBT_MODEL[:, 1:].T + DOUBT_MODEL[:, 0]).T
    return np.minimum(1 / (1 + np.exp(-np.where(ground, own, other))), 0.5).astype(np.float32)
