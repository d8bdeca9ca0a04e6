"""How likely the label of a point is to be wrong: what speaks for and against it, and a logistic model of these figures."""

from __future__ import annotations

import numpy as np

from .doubt_model import MODEL
from .ground_tin import GroundTin

FEATURES = (
    "height", "near", "below", "drop", "flip", "residual", "roughness", "facet", "landscape",
)  # fmt: skip
"""What :func:`evidence` says of each point, in this order."""
_ROWS = 2**18
"""Points that probabilities are computed of at a time."""


def evidence(ground: GroundTin, drop: np.ndarray, landscape: np.ndarray, tolerance: float) -> np.ndarray:
    """f32[m, 9]: figures without a unit that tell certain labels from doubtful ones. Lengths are in tolerances.

    ``height``: of the point over the triangulation of the ground, log(1 + |h|), at most 4. ``near``: 1 where that is one
    tolerance, less where it is more or fewer. ``below``: log(1 + h) of points below it, at most 3. ``drop``: logarithm of
    the steepest drop of the cell in terms of its limit, -3 to 2. ``flip``: 1 where the cell is at the limit, 0 from a factor
    of e on. ``residual``: of a vertex above the plane of its neighbours, log(1 + e). ``roughness``: log(1 + root mean
    square) of these around the point. ``facet``: slope of its facet, at most 1.5. ``landscape``: square root of its slope,
    at most 1.

    Args:
        ground: the points m, and the final triangulation, finished.
        drop: f32[m], steepest drop of the cell of each point over the limit from which on cells are marked.
        landscape: f32[m], rise over run. tolerance: height of ground over the facets of the seeds, metres.
    """
    above, slope = ground.height, ground.slope
    residual, roughness = ground.scatter_of_all()
    tolerance = max(tolerance, 0.01)
    h = above / np.float32(tolerance)
    size = np.abs(h)
    steepness = np.clip(np.log(np.maximum(drop, np.float32(1e-3))), -3, 2)
    columns = (
        np.minimum(np.log1p(size), 4),
        np.exp(-np.abs(np.log(np.maximum(size, np.float32(0.05))))),
        np.minimum(np.log1p(np.maximum(-h, 0)), 3),
        steepness,
        np.maximum(0, 1 - np.abs(steepness)),
        np.log1p(np.maximum(residual, 0) / np.float32(tolerance)),
        np.log1p(roughness / np.float32(tolerance)),
        np.minimum(np.tan(np.radians(np.minimum(slope, 80))), 1.5),
        np.sqrt(np.clip(landscape, 0, 1)),
    )
    return np.nan_to_num(np.stack(columns, axis=1, dtype=np.float32))


def probability(evidence: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """f32[m]: how likely the labels ``ground``, bool[m], are to be wrong, by ``evidence``, f32[m, features]."""
    out = np.empty(len(ground), np.float32)
    for start in range(0, len(out), _ROWS):
        rows = slice(start, start + _ROWS)
        weights = MODEL[ground[rows].astype(np.int64)]
        total = weights[:, 0] + (weights[:, 1:] * evidence[rows]).sum(axis=1)
        out[rows] = 1 / (1 + np.exp(-total))
    return out
