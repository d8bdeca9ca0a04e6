"""ATIN: the same as PTD at constant thresholds, and thresholds that follow the surface."""

import numpy as np
import pytest
from test_densify import hillside

import jaxfilter as jf
from jaxfilter.methods import atin


@pytest.fixture(scope="module")
def rough():
    return hillside(4, n=7000, side=120)


@pytest.mark.parametrize("refresh", [True, False])
def test_at_constant_thresholds_and_without_mirroring_it_is_ptd(rough, refresh):
    common = {"max_angle": 12.0, "max_distance": 0.9, "seed_cell": 30.0, "refresh_border": refresh}
    plain, ptd = jf.ATIN(**common)(rough), jf.PTD(**common, max_terrain_angle=90.0)(rough)
    assert (plain.ground == ptd.ground).all()
    np.testing.assert_array_equal(plain.height, ptd.height)
    mirrored = jf.ATIN(**common, mirror="nearest", max_terrain_slope=30.0)(rough)
    assert (plain.ground != mirrored.ground).sum() > 5


def test_limits_are_median_and_robust_deviations_below_the_users(rng):
    f = jf.ATIN(max_angle=40.0, max_distance=3.0)
    distance = np.abs(rng.normal(1.0, 0.02, 20001)).astype(np.float32)
    rule = f.adapted(distance, np.full(9, 30.0, np.float32))
    assert rule.max_distance in (pytest.approx(1.3), pytest.approx(1.35))  # mean and 15 standard deviations
    assert rule.max_angle == 30.0
    assert f.adapted(np.full(9, 0.51), np.full(9, 7.2))[:3:2] == pytest.approx((8.0, 0.55))
    assert f.adapted(100 * distance, distance).max_distance == 3.0


@pytest.mark.parametrize("deviations", [2.0, 5.0])
def test_thresholds_settle_and_do_not_shrink_to_nothing(rough, deviations, monkeypatch):
    monkeypatch.setattr(atin, "_DEVIATIONS", deviations)
    result = jf.ATIN(thresholds="adaptive", seed_cell=30.0, max_distance=5.0, max_angle=60.0)(rough)
    assert result.status == jf.Status.CONVERGED
    limits = [step["max_distance"] for step in result.trace]
    assert len(set(limits)) > 1 and len(set(limits[-3:])) == 1
    assert limits[-1] > 3 * 0.03  # ground with this noise still passes
    angles = [step["max_angle"] for step in result.trace]
    assert angles[-1] > angles[0]  # the facets get smaller


def test_limits_follow_the_noise_of_the_ground(rng):
    xy = rng.uniform(0, 100, (6000, 2)).round(1)
    f = jf.ATIN(thresholds="adaptive", seed_cell=25.0, max_distance=5.0, max_angle=80.0)
    last = {}
    for noise in (0.02, 0.1):
        z = 0.05 * xy[:, 0] + rng.normal(0, noise, 6000)
        result = f(np.column_stack([xy, z.round(3)]))
        last[noise] = result.trace[-1]["max_distance"]
        assert result.ground.mean() > 0.95
    assert 3.5 < last[0.1] / last[0.02] < 6.5


def test_border_switch_changes_the_number_of_simulated_points(rough):
    corners = jf.ATIN(border="corners", seed_cell=30.0)(rough)
    perimeter = jf.ATIN(border="perimeter", seed_cell=30.0)(rough)
    assert corners.info["border_points"] == 4 and perimeter.info["border_points"] == 2 * (4 + 4)
