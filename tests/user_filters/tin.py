"""A filter on a triangulation as a user writes it, with a rule of its own: other limits, in another order, another test."""

import dataclasses
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp

import jaxfilter as jf
from jaxfilter.core.params import Preset, filter_params, param, static
from jaxfilter.engines.tin.facets import Verdict
from jaxfilter.steps.seeds import lowest_per_cell
from jaxfilter.steps.tin_filter import VertexSpacing, surrounded


class Bent(NamedTuple):
    """Metres, degrees, and degrees of angle that a degree of slope of the facet adds."""

    max_distance: Any
    max_angle: Any
    share: Any

    def verdict(self, s, two_sided):
        limit = self.max_angle + self.share * jnp.minimum(s.slope, 40.0)
        angle, distance = jnp.abs(s.angle) - limit, 0.9 * jnp.abs(s.distance) - self.max_distance
        accepted = s.planar & (angle <= 0) & (distance <= 0)
        other = jnp.where(distance > 0, jf.Decision.ELEVATION, jf.Decision.ANGLE)
        decision = jnp.where(accepted, jf.Decision.ACCEPTED, other).astype(jnp.uint8)
        return Verdict(accepted, decision, jnp.where(distance > 0, distance, angle), s)


@filter_params
class Bender(VertexSpacing):
    """The angle that a point may have grows with the slope of its facet. Lengths in metres, angles in degrees."""

    BIBTEX: ClassVar[str] = "@misc{bender, title = {A user's filter on a triangulation}}"
    PRESETS: ClassVar[dict[str, Preset]] = {
        "paper": Preset("as printed, but there is no paper", low_clusters=False),
        "recommended": Preset("the default"),
    }

    max_distance: float = param("a point of ground is at most this far from its facet", "> 0 m", default=1.0)
    max_angle: float = param("the angle to a level facet is at most this", "> 0 and < 90 degrees", default=12.0)
    share: float = param("degrees of angle that a degree of slope adds", ">= 0", default=0.1)
    seed_cell: float = static("a square cell of this size has one seed", "> 0 m", default=40.0)

    def start(self, points, workers, progress, trace=False):
        outliers = self.outliers(points, workers)
        seeds = lowest_per_cell(points, self.seed_cell, outliers.barred)
        return surrounded(self, points, seeds, outliers, self.seed_cell)

    def growth(self, network):
        rule = Bent(self.max_distance, self.max_angle, self.share)
        return dataclasses.replace(super().growth(network), rule=rule)
