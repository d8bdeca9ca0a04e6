"""How likely the label of a point is to be wrong: what speaks for and against it, and a logistic model of these figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import correlate1d

from ..core.compilation import bucket
from ..core.filter import Labels
from ..engines.chunks import in_chunks
from .surfaces import Cells, look_up

FEATURES = ("height", "near", "below", "drop", "flip", "residual", "facet", "landscape", "mixed")
"""What :func:`evidence` says of each point, in this order."""
MODEL = Path(__file__).with_name("doubt.csv")
"""Made by ``experiments/default/doubt.py``, from simulated scenes and labelled tiles."""
WEIGHTS = np.loadtxt(MODEL, delimiter=",", skiprows=1, usecols=range(1, len(FEATURES) + 2))
"""f64[2, 1 + features]: constant and weights, for points that are not ground and for ground."""
SPARSEST = 0.2
"""Points per square metre: where there are fewer, doubt does not hold."""
SPARSE = f"doubt does not hold: there are fewer than {SPARSEST} points per m2"
_AROUND = 6.0
"""Metres, or spacings where these are more, along the square around a point in which labels are compared."""
_LEVEL = 3.0
"""Tolerances above and below the triangulation within which they are."""
_ROWS = 2**14
"""Points that are looked at at a time: what is made of them stays in the cache."""


def doubts(
    labels: Labels,
    residual: np.ndarray,
    drop: np.ndarray,
    landscape: np.ndarray,
    mixed: np.ndarray,
    tolerance: float,
) -> np.ndarray:
    """f32[m]: how likely the labels of points are to be wrong.

    Args:
        labels: of the points m, with heights and slopes over the final triangulation.
        residual: f32[m], metres that vertices lie above the plane of their neighbours; zero for other points.
        drop: f32[m], steepest drop of the cell of each point over the limit from which on cells are marked.
        landscape: f32[m], rise over run. mixed: f32[m], see :func:`mixture`.
        tolerance: height of ground over the facets of the seeds, metres.
    """
    given: Any = labels.ground, labels.height, labels.slope, residual, drop, landscape, mixed
    size, least = bucket(min(len(drop), _ROWS)), max(tolerance, 0.01)
    found: np.ndarray = in_chunks(
        lambda labels, *columns: probability(np.asarray(evidence(*columns, least)), labels),
        lambda rows: tuple(column[rows] for column in given),
        len(drop),
        size,
    )
    return found


def mixture(
    xyz: np.ndarray, cells: Cells, labels: Labels, rows: np.ndarray | slice, spacing: float, tolerance: float
) -> np.ndarray:
    """f32[m]: how mixed the labels around points f32[m, 3] are, of those that are about as high as the ground: 0 where all are
    the same, 1 where half of them are ground. ``rows``: of the points that are counted; ``spacing`` and ``tolerance``: metres."""
    at, shape = cells.grid.flat(xyz[rows]), cells.grid.shape
    assert labels.height is not None
    near, of_ground = np.abs(labels.height[rows]) < _LEVEL * max(tolerance, 0.01), labels.ground[rows]
    wide = 2 * min(round(_AROUND * max(1.0, spacing) / cells.grid.cell / 2), max(shape)) + 1
    count, ground = (np.bincount(at[which], minlength=shape[0] * shape[1]) for which in (near, near & of_ground))
    for axis in range(2):  # sums of whole numbers are exact, so that tiles agree
        count, ground = (
            correlate1d(table.reshape(shape), np.ones(wide, int), axis, mode="constant") for table in (count, ground)
        )
    share = (ground + 0.5) / (count + 1)
    return look_up(xyz, cells, (1 - np.abs(2 * share - 1)).astype(np.float32))[0]


@jax.jit
def evidence(
    height: jax.Array,
    slope: jax.Array,
    residual: jax.Array,
    drop: jax.Array,
    landscape: jax.Array,
    mixed: jax.Array,
    tolerance: jax.Array,
) -> jax.Array:
    """f32[n, 9]: figures without a unit that tell certain labels from doubtful ones. Lengths are in tolerances.

    ``height``: of the point over the triangulation of the ground, log(1 + |h|), at most 4. ``near``: 1 where that is one
    tolerance, less where it is more or fewer. ``below``: log(1 + h) of points below it, at most 3. ``drop``: logarithm of
    the steepest drop of the cell in terms of its limit, -3 to 2. ``flip``: 1 where the cell is at the limit, 0 from a factor
    of e on. ``residual``: of a vertex above the plane of its neighbours, log(1 + e). ``facet``: slope of its facet, at most
    1.5. ``landscape``: square root of its slope, at most 1. ``mixed``: how mixed the labels around are.

    Args: f32[n] each, and f32, as for :func:`doubts`; ``height`` in metres and ``slope`` in degrees over the triangulation.
    What is not a number is zero.
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
        jnp.minimum(jnp.tan(jnp.radians(jnp.minimum(slope, 80))), 1.5),
        jnp.sqrt(jnp.clip(landscape, 0, 1)),
        mixed,
    )
    return jnp.nan_to_num(jnp.stack(columns, axis=1))


def probability(evidence: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """f32[m]: how likely the labels ``ground``, bool[m], are to be wrong, by ``evidence``, f32[m, features].

    At most one half: of two labels the method takes the more likely one.
    """
    other, own = (evidence @ WEIGHTS[:, 1:].T + WEIGHTS[:, 0]).T
    return np.minimum(1 / (1 + np.exp(-np.where(ground, own, other))), 0.5).astype(np.float32)
