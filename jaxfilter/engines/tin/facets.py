"""Tests of points against the facets of a triangulation: the kernel that all TIN methods share.

For a point p in a facet with vertices A, B, C: n is the unit normal, turned so that it points up; the signed distance is
d = (p - A) . n, positive above; l is the 3-D distance to the nearest vertex and the angle is arcsin(d / l). That angle to
the nearest vertex (Zhang & Lin 2013; Li et al. 2021, eq. 3) is also the largest of the three angles to the vertices
(Axelsson 2000), since d is the same for all. The elevation is that of p over the highest vertex (Li et al. 2021, eq. 2).
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...core.arrays import operation, takes
from ...core.errors import ParameterError
from ...core.result import Decision

_FLAT_AREA = 1e-6
"""Square of twice the area over the fourth power of the longest edge, below which a facet has no plane."""

Vector = list[jax.Array]
"""Three components. Kernels are written in these, which compile to one loop over all points; reductions over an axis of
length three do not, and add up in an order that depends on the number of points."""


class FacetScore(NamedTuple):
    """Quantities of points over their facets, each of the shape of the points without the last axis; metres and degrees."""

    distance: jax.Array  # d: signed, perpendicular
    height: jax.Array  # signed, vertical
    angle: jax.Array  # theta: signed
    elevation: jax.Array  # v: over the highest vertex
    slope: jax.Array  # of the facet, 0..90
    level: jax.Array  # cosine of the slope, which takes a third of the time; 0 without a plane
    planar: jax.Array  # bool: the facet has a plane that is not vertical


class Verdict(NamedTuple):
    """Outcome of the tests per point: whether it passed, which test decided (Decision) and by how much (margin)."""

    accepted: jax.Array
    decision: jax.Array
    margin: jax.Array
    score: FacetScore


class Rule(NamedTuple):
    """Limits of the test of points over facets; f32 scalars (or, under vmap, arrays). Infinity switches a test off.

    Attributes:
        max_angle: degrees, angle between facet and the line to its nearest vertex.
        max_elevation: metres over the highest vertex of the facet.
        max_distance: metres from the plane of the facet.
        max_below: metres below the plane, measured vertically, at which a point is too low.
        noise_floor: metres; a point this close to the plane, measured vertically, is accepted whatever its angle. 0 = off.
        signed: 1 = points below the facet pass the tests of angle and distance; 0 = both sides are limited.

    >>> from jaxfilter.engines.tin import facets
    >>> rule = facets.Rule(max_angle=15.0, max_distance=1.4)
    >>> rule.max_elevation, rule.max_below
    (inf, inf)
    """

    max_angle: float | jax.Array = jnp.inf
    max_elevation: float | jax.Array = jnp.inf
    max_distance: float | jax.Array = jnp.inf
    max_below: float | jax.Array = jnp.inf
    noise_floor: float | jax.Array = 0.0
    signed: float | jax.Array = 0.0

    def verdict(self, s: FacetScore, two_sided: jax.Array) -> Verdict:
        """Hold one point against the limits.

        ``two_sided`` (bool) tests the point on both sides of the facet whatever the rule says, and holds its distance to the
        limit of elevation as well: for points that were kept out of the seeds as suspected low outliers.

        >>> from jaxfilter.engines.tin import facets
        >>> corners = jnp.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0]])
        >>> score = facets.facet_score(jnp.array([2.0, 2.0, 0.5]), corners)
        >>> bool(facets.Rule(max_distance=0.4).verdict(score, jnp.bool_(False)).accepted)
        False
        """
        one_sided = (jnp.asarray(self.signed) > 0) & ~two_sided
        angle = jnp.where(one_sided, s.angle, jnp.abs(s.angle))
        distance = jnp.where(one_sided, s.distance, jnp.abs(s.distance))
        over_angle = angle - self.max_angle
        over_height = jnp.maximum(s.elevation - self.max_elevation, distance - self.max_distance)
        over_height = jnp.where(two_sided, jnp.maximum(over_height, distance - self.max_elevation), over_height)
        too_low = -s.height - self.max_below
        near = (jnp.asarray(self.noise_floor) > 0) & (jnp.abs(s.height) <= self.noise_floor)
        passed = (over_angle <= 0) & (over_height <= 0) & (too_low <= 0)
        accepted = s.planar & (passed | near)
        decision = jnp.where(
            accepted,
            jnp.where(passed, Decision.ACCEPTED, Decision.NOISE_FLOOR),
            jnp.where(too_low > 0, Decision.LOW, jnp.where(over_height > 0, Decision.ELEVATION, Decision.ANGLE)),
        ).astype(jnp.uint8)
        margin = jnp.where(
            near & ~passed,
            jnp.abs(s.height) - self.noise_floor,
            jnp.where(too_low > 0, too_low, jnp.where(over_height > 0, over_height, over_angle)),
        )
        return Verdict(accepted, decision, margin, s)


def _minus(u: Vector, v: Vector) -> Vector:
    return [u[0] - v[0], u[1] - v[1], u[2] - v[2]]


def _dot(u: Vector, v: Vector) -> jax.Array:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _least(values: Vector) -> jax.Array:
    return jnp.minimum(jnp.minimum(values[0], values[1]), values[2])


@takes(p="f32?[3]", corners="f32?[3, 3]")
def facet_score(p: jax.Array, corners: jax.Array) -> FacetScore:
    """Score one point f32[3] against one facet f32[3, 3] (rows are vertices), local metres."""
    a, b, c = ([corner[k] - p[k] for k in range(3)] for corner in corners)  # exact in float32 for quantised coordinates
    u, v = _minus(b, a), _minus(c, a)
    n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    n = [jnp.where(n[2] < 0, -component, component) for component in n]
    size = jnp.sqrt(_dot(n, n))
    longest = jnp.maximum(jnp.maximum(_dot(u, u), _dot(v, v)), _dot(_minus(v, u), _minus(v, u)))
    planar = (size * size > _FLAT_AREA * longest * longest) & (n[2] > 1e-6 * size)
    n = [component / jnp.where(planar, size, 1.0) for component in n]
    nearest = jnp.sqrt(_least([_dot(a, a), _dot(b, b), _dot(c, c)]))
    distance = -_dot(a, n)
    sine = jnp.where(nearest > 0, distance / jnp.where(nearest > 0, nearest, 1.0), 0.0)
    return FacetScore(
        distance=distance,
        height=distance / jnp.where(planar, n[2], 1.0),
        angle=jnp.degrees(jnp.arcsin(jnp.clip(sine, -1.0, 1.0))),
        elevation=_least([-a[2], -b[2], -c[2]]),
        slope=jnp.degrees(jnp.arctan2(jnp.hypot(n[0], n[1]), n[2])),
        level=jnp.where(planar, n[2], 0.0),
        planar=planar,
    )


def single(rule: Any) -> Any:
    """A rule, a pytree of limits, with its limits in single precision: f32 each. Raises: ParameterError for what is none."""
    try:
        return jax.tree.map(np.float32, rule)
    except (TypeError, ValueError) as error:
        wanted = "make it a NamedTuple of numbers, of arrays with a number for each node, or of such tuples"
        raise ParameterError(f"rule: {type(rule).__name__}: {wanted}, with a method verdict ({error})") from error


def loosened(new: Any, old: Any) -> bool:
    """Whether any limit of a rule is larger than before; of a rule of another type, whether any limit has changed."""
    (limits, kind), (before, kind_before) = map(jax.tree.flatten, (new, old))
    looser = np.greater if type(new) is Rule else np.not_equal
    if kind != kind_before:  # type: ignore[operator]
        return True
    return any(looser(*pair).any() for pair in zip(limits, before, strict=True))


def of_nodes(rule: Any, nodes: np.ndarray) -> Any:
    """The rule of some nodes, i64[n]: limits f32[k] become f32[n], others are those of all."""
    return jax.tree.map(lambda limit: limit[nodes] if np.ndim(limit) > 0 else limit, rule)


FACET_QUANTITIES = ("accepted", "decision", "margin", *FacetScore._fields)
"""What is known of a point after its test: the fields of :class:`Verdict` and of its :class:`FacetScore`."""


@functools.partial(jax.jit, inline=True)
def _scores(points: jax.Array, corners: jax.Array) -> FacetScore:
    """Traced once for all rules and names, as :func:`_verdicts` is for all names, since that takes longer than to run them."""
    return jax.vmap(facet_score, in_axes=(1, 2))(points, corners)


@functools.partial(jax.jit, inline=True)
def _verdicts(rule: Any, scores: FacetScore, two_sided: jax.Array) -> Verdict:
    each = jax.tree.map(lambda limit: 0 if jnp.ndim(limit) > 0 else None, rule)
    found: Verdict = jax.vmap(lambda one, *of: one.verdict(*of), in_axes=(each, 0, 0))(rule, scores, two_sided)
    return found._replace(accepted=found.accepted.astype(bool), decision=found.decision.astype(jnp.uint8))


@takes(two_sided="bool[n]", points="f32?[3, n]", corners="f32?[3, 3, n]")
@functools.partial(jax.jit, static_argnames="names")
def judge(
    rule: Any,
    two_sided: jax.Array,
    points: jax.Array,
    corners: jax.Array,
    *,
    names: tuple[str, ...] = FACET_QUANTITIES,
) -> dict[str, jax.Array]:
    """Apply one rule to points f32[3, N] over their facets f32[3, 3, N], local metres, by corners, then axes.

    Coordinates of one axis lie side by side: so they are read by vector instructions.

    Args:
        rule: a pytree of limits with a method ``verdict``, such as :class:`Rule`; f32 scalars or f32[N], one for each point.
        two_sided: bool[N], points that are tested on both sides of the facet whatever the rule says.
        names: which of :data:`FACET_QUANTITIES` to return; what is not named is not computed.

    Points with NaN, and those over facets with NaN, are not accepted. Raises: InputError for other types and shapes.

    Returns: arrays [N] by name: ``accepted`` bool, ``decision`` (:class:`jaxfilter.Decision`), ``margin`` in the unit of the
        deciding test; ``distance``, ``height`` and ``elevation`` in metres, ``angle`` and ``slope`` in degrees, ``level`` its
        cosine; ``planar`` bool, False for facets without a plane and for vertical ones.

    >>> from jaxfilter.engines.tin import facets
    >>> corners = jnp.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0]])[:, :, None]
    >>> points = jnp.array([2.0, 2.0, 0.5])[:, None]
    >>> found = facets.judge(facets.Rule(max_distance=1.4), jnp.zeros(1, bool), points, corners)
    >>> found["distance"].tolist(), found["accepted"].tolist()
    ([0.5], [True])
    """
    verdict = _verdicts(rule, _scores(points, corners), two_sided)
    found = {**verdict._asdict(), **verdict.score._asdict()}
    return {name: found[name] for name in names}


@operation(points="f32?[n, 3]", corners="f32?[n, 3, 3]", about_highest="bool[]")
def mirrored(points: jax.Array, corners: jax.Array, about_highest: jax.Array) -> jax.Array:
    """Mirror points f32[N, 3] about a vertex of their facets f32[N, 3, 3], local metres, in the plane; the elevation stays.

    ``about_highest`` (bool scalar): about the highest vertex (Zhang & Lin 2013), else about the nearest in 3-D (Axelsson 2000).

    >>> from jaxfilter.engines.tin import facets
    >>> corners = jnp.array([[[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0]]])
    >>> facets.mirrored(jnp.array([[2.0, 1.0, 0.5]]), corners, jnp.bool_(False)).tolist()
    [[-2.0, -1.0, 0.5]]
    """

    def one(p: jax.Array, facet: jax.Array) -> jax.Array:
        away = [[corner[k] - p[k] for k in range(3)] for corner in facet]
        near = jnp.argmin(jnp.stack([_dot(to, to) for to in away]))
        v = facet[jnp.where(about_highest, jnp.argmax(facet[:, 2]), near)]
        return jnp.stack([2 * v[0] - p[0], 2 * v[1] - p[1], p[2]])

    return jax.vmap(one)(points, corners)
