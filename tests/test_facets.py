"""The facet kernel by hand. Its labels, heights and angles against plain float64 geometry: test_densify.py."""

from collections import namedtuple
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfilter as jf
from jaxfilter.core.result import Decision
from jaxfilter.engines.tin.facets import FacetScore, Rule, judge, loosened, mirrored, single

Own = namedtuple("Own", "far steep")


def run(rule, points, facets, two_sided=False):
    late, corners = np.full(len(points), two_sided), np.moveaxis(facets, 0, 2)
    return SimpleNamespace(**judge(Rule(*map(np.float32, rule)), late, points.T, corners))


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
    late = run(Rule(max_angle=20, max_elevation=1, signed=1), points, np.repeat(facet[None], 5, axis=0), two_sided=True)
    assert np.asarray(late.decision)[2] == Decision.ELEVATION, "two metres below, which counts as above"
    v = run(Rule(max_angle=20, noise_floor=0.625, signed=1), points, np.repeat(facet[None], 5, axis=0))
    assert np.asarray(v.decision)[3] == Decision.NOISE_FLOOR and v.accepted[3] and v.margin[3] == 0.5 - 0.625


def test_facets_without_a_plane_accept_nothing_and_give_finite_numbers():
    vertical = np.float32([[0, 0, 0], [4, 0, 0], [2, 0, 5]])
    line = np.float32([[0, 0, 0], [1, 1, 0], [2, 2, 0]])
    point = np.float32([[1, 0.5, 0.1]] * 2)
    v = run(Rule(), point, np.stack([vertical, line]))
    assert not np.asarray(v.accepted).any()
    assert all(np.isfinite(getattr(v, name)).all() for name in FacetScore._fields)


@pytest.mark.parametrize("rule", [SimpleNamespace(far=1.0), lambda s, two_sided: s.planar, Rule(max_angle="steep")])
def test_what_is_no_rule_is_refused_with_what_one_is(rule):
    with pytest.raises(jf.ParameterError, match=rf"^rule: {type(rule).__name__}: make it a NamedTuple.*verdict"):
        single(rule)


def test_a_rule_of_users_is_loosened_whenever_a_limit_changes():
    assert loosened(single(Rule(max_angle=6)), single(Rule(max_angle=5)))
    assert not loosened(single(Rule(max_angle=5)), single(Rule(max_angle=6)))
    own = [Own(np.float32(far), np.float32([3.0, steep])) for far, steep in ((1.0, 2.0), (1.0, 1.5), (1.0, 1.5))]
    assert loosened(own[1], own[0]) and not loosened(own[2], own[1]) and loosened(own[0], Rule())


def test_a_point_on_a_vertex_has_angle_zero():
    facet = np.float32([[[0, 0, 1], [8, 0, 3], [0, 8, 2]]])
    v = run(Rule(max_angle=5, max_elevation=1, signed=1), facet[:, 0], facet)
    assert bool(v.accepted[0]) and float(v.angle[0]) == 0.0


def test_mirror_images():
    facet = np.float32([[[0, 0, 0], [10, 0, 1], [0, 10, 9]]])
    p = np.float32([[1, 2, 3]])
    np.testing.assert_array_equal(mirrored(p, facet, jnp.array(True))[0], [-1, 18, 3])
    np.testing.assert_array_equal(mirrored(p, facet, jnp.array(False))[0], [-1, -2, 3])
