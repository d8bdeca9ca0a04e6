"""The facet kernel against plain float64 geometry."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxfilter.core.result import Decision
from jaxfilter.engines.tin import facets as kernels
from jaxfilter.engines.tin.facets import FacetScore, Rule, mirrored


def judge(rule, late, points, facets, **names):
    return kernels.judge(rule, late, points.T, np.moveaxis(facets, 0, 2), **names)


def plain(p, f):
    """Distance, height, angle, elevation and slope of one point over one facet, from the textbook formulas."""
    p, f = np.asarray(p, float), np.asarray(f, float)
    n = np.cross(f[1] - f[0], f[2] - f[0])
    n /= np.linalg.norm(n)
    n *= np.sign(n[2])
    d = np.dot(p - f[0], n)
    angles = [np.degrees(np.arcsin(np.clip(d / np.linalg.norm(p - v), -1, 1))) for v in f]
    plane_z = f[0, 2] - (n[0] * (p[0] - f[0, 0]) + n[1] * (p[1] - f[0, 1])) / n[2]
    return d, p[2] - plane_z, max(angles, key=abs), p[2] - f[:, 2].max(), np.degrees(np.arccos(n[2]))


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(0)
    facets = rng.uniform(0, 30, (400, 3, 3))
    area = np.abs(np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0])[:, 2])  # twice, in the plane
    facets = facets[area > 5]
    weights = rng.dirichlet(np.ones(3), len(facets))
    points = np.einsum("nk,nkd->nd", weights, facets) + rng.normal(0, 2, (len(facets), 3)) * [0, 0, 1]
    quantum = 2.0**-10
    return tuple((np.rint(a / quantum) * quantum).astype(np.float32) for a in (points, facets))


def run(rule, points, facets, late=None):
    late = np.zeros(len(points), bool) if late is None else late
    return SimpleNamespace(**judge(Rule(*map(np.float32, rule)), late, points, facets))


def test_scores_equal_float64_geometry_also_far_from_the_origin(scene):
    points, facets = scene
    expected = np.array([plain(p, f) for p, f in zip(points, facets, strict=True)]).T
    for shift in (0.0, 8192.0):
        move = np.float32([shift, shift, 0])
        s = run(Rule(), points + move, facets + move)
        for got, want in zip((s.distance, s.height, s.angle, s.elevation, s.slope), expected, strict=True):
            np.testing.assert_allclose(got, want, atol=2e-3, rtol=2e-4)


def test_rules(scene):
    points, facets = scene
    d, height, angle, elevation, _ = np.array([plain(p, f) for p, f in zip(points, facets, strict=True)]).T
    clear = np.abs(angle) > 0.05  # away from rounding at a threshold

    def same(rule, expected, late=None):
        got = np.asarray(run(rule, points, facets, late).accepted)
        border = np.minimum(np.abs(np.abs(angle) - 20), np.abs(elevation - 1) * 9)
        assert (got == expected)[clear & (border > 0.01)].all()

    same(Rule(max_angle=20, max_elevation=1, signed=1), (angle <= 20) & (elevation <= 1))
    same(Rule(max_angle=20, max_distance=1.5), (np.abs(angle) <= 20) & (np.abs(d) <= 1.5))
    upward = Rule(max_angle=20, max_elevation=1, signed=1)
    within = (angle <= 20) & (elevation <= 1)
    same(upward._replace(max_below=0.5), within & (height >= -0.5))
    same(upward._replace(noise_floor=0.3), within | (np.abs(height) <= 0.3))
    both = (np.abs(angle) <= 20) & (elevation <= 1) & (np.abs(d) <= 1)
    same(upward, both, late=np.ones(len(points), bool))


def test_decision_and_margin_name_the_deciding_test():
    facet = np.float32([[0, 0, 0], [8, 0, 0], [0, 8, 0]])
    points = np.float32([[2, 2, 0.25], [2, 2, 2.0], [2, 2, -2.0], [0.25, 0.25, 0.5], [2, 2, -9.0]])
    v = run(Rule(max_angle=20, max_elevation=1, signed=1, max_below=5), points, np.repeat(facet[None], 5, axis=0))
    expected = [Decision.ACCEPTED, Decision.ELEVATION, Decision.ACCEPTED, Decision.ANGLE, Decision.LOW]
    assert np.asarray(v.decision).tolist() == expected
    angle = np.degrees(np.arcsin(0.25 / np.sqrt(8 + 0.0625)))
    np.testing.assert_allclose(v.margin[0], angle - 20, atol=1e-4)
    np.testing.assert_allclose([v.margin[1], v.margin[4]], [1.0, 4.0], atol=1e-5)
    assert (np.asarray(v.margin) <= 0).tolist() == np.asarray(v.accepted).tolist()


def test_facets_without_a_plane_accept_nothing_and_give_finite_numbers():
    vertical = np.float32([[0, 0, 0], [4, 0, 0], [2, 0, 5]])
    line = np.float32([[0, 0, 0], [1, 1, 0], [2, 2, 0]])
    point = np.float32([[1, 0.5, 0.1]] * 2)
    v = run(Rule(), point, np.stack([vertical, line]))
    assert not np.asarray(v.accepted).any()
    assert all(np.isfinite(getattr(v, name)).all() for name in FacetScore._fields)


def test_a_point_on_a_vertex_has_angle_zero():
    facet = np.float32([[[0, 0, 1], [8, 0, 3], [0, 8, 2]]])
    v = run(Rule(max_angle=5, max_elevation=1, signed=1), facet[:, 0], facet)
    assert bool(v.accepted[0]) and float(v.angle[0]) == 0.0


def test_mirror_images():
    facet = np.float32([[[0, 0, 0], [10, 0, 1], [0, 10, 9]]])
    p = np.float32([[1, 2, 3]])
    np.testing.assert_array_equal(mirrored(p, facet, jnp.array(True))[0], [-1, 18, 3])
    np.testing.assert_array_equal(mirrored(p, facet, jnp.array(False))[0], [-1, -2, 3])
