"""Rules by which points join a triangulation of ground whose limits differ from point to point."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..core.result import Decision
from ..engines.tin.facets import FacetScore, Verdict

STEEPEST = 80.0
"""Degrees that facets, and ways to the hull, are taken to slope at most: a wall of points is in the plane of a slim facet that
stands upright."""
_LEAST = 1e-6
"""Metres beyond the limit, at least, of a point that does not join."""


class HeightRule(NamedTuple):
    """Points join whose height over their facet is small; f32 each, one for all points or one for each.

    Attributes:
        height: metres, upward or downward.
        tilt: metres that this grows by per slope of the facet, up to a slope of 1.
    """

    height: jax.Array | np.ndarray | float
    tilt: jax.Array | np.ndarray | float

    def verdict(self, s: FacetScore, two_sided: jax.Array) -> Verdict:
        """Hold one point against the limits, on both sides of the facet."""
        limit = self.height + self.tilt * jnp.minimum(jnp.tan(jnp.radians(s.slope)), 1.0)
        return _verdict(jnp.abs(s.height) - limit, s)


class AngleRule(NamedTuple):
    """Points join that are near to the plane of their facet, and at a small angle; f32 each, one for all or one for each.

    Planes steeper than 80 degrees count as that steep, and distances from these grow with the height over them. The margin of a
    point whose angle is too large is metres beyond ``noise``, or beyond ``distance`` if this is less.

    Attributes:
        distance: metres, at most, from the plane. angle: degrees, to the facet at its nearest vertex, must be less.
        noise: metres from the plane within which angles do not count: between points that are near to each other, a few
            centimetres are many degrees.
    """

    distance: jax.Array | np.ndarray | float
    angle: jax.Array | np.ndarray | float
    noise: jax.Array | np.ndarray | float

    def verdict(self, s: FacetScore, two_sided: jax.Array) -> Verdict:
        """Hold one point against the limits, on both sides of the facet."""
        away = jnp.abs(s.height) * jnp.cos(jnp.radians(jnp.minimum(s.slope, STEEPEST)))
        near = (jnp.abs(s.angle) < self.angle) | (away <= self.noise)
        steep = jnp.maximum(away - jnp.minimum(self.distance, self.noise), _LEAST)  # else rounding might make it zero
        return _verdict(jnp.where(near, away - self.distance, steep), s)


def _verdict(margin: jax.Array, s: FacetScore) -> Verdict:
    margin = jnp.where(s.planar, margin, jnp.inf)
    decision = jnp.where(margin <= 0, Decision.ACCEPTED, Decision.ELEVATION).astype(jnp.uint8)
    return Verdict(margin <= 0, decision, margin, s)
