"""Dense clouds: few points stand for all, against counts by hand, SciPy and sheets of noise that are known."""

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator

import jaxfilter as jf
from jaxfilter.core.points import Points, canonical_points
from jaxfilter.engines.tin.ground import GroundTin
from jaxfilter.engines.tin.growth import Beyond, Growth, Outliers, Vertices
from jaxfilter.engines.tin.network import one_network
from jaxfilter.steps.crowd import Crowd
from jaxfilter.steps.ground_rules import AngleRule


def crowd_of(xyz, **options):
    return Crowd.from_points(canonical_points(jf.PointCloud.from_arrays(xyz, **options)))


def sheet(rng, density=300.0, side=24.0, noise=0.04):
    """f64[n, 3]: points of a gentle slope, with noise."""
    xy = rng.uniform(0, side, (int(density * side**2), 2))
    return np.column_stack([xy, 0.05 * xy[:, 0] + rng.normal(0, noise, len(xy))])


@pytest.fixture(scope="module")
def yard():
    """f64[n, 3] and bool[n], ground: a sheet with a house, bushes, and a hundred false echoes in one place below."""
    rng = np.random.default_rng(5)
    xyz = sheet(rng)
    house, bush = (abs(xyz[:, :2] - [12, 12]).max(axis=1) < 4), np.hypot(*(xyz[:, :2] - [4, 19]).T) < 2
    xyz[house, 2] += 5
    xyz[bush, 2] += rng.uniform(0.3, 2, bush.sum())
    under = np.column_stack([rng.uniform(19, 19.6, (100, 2)), rng.uniform(-6.2, -6, 100)])
    return np.concatenate([xyz, under]), np.append(~(house | bush), np.zeros(100, bool))


@pytest.mark.slow
@pytest.mark.parametrize("sides", [(0.2, 0.2), (0.4, 0.2), (3.0, 0.6)], ids=["one square", "two", "many"])
def test_few_squares_have_labels(rng, sides):
    xyz = np.column_stack([rng.uniform(0.01, sides, (2000, 2)), rng.normal(0, 0.005, 2000)])
    assert (crowd_of(xyz) is None) == (sides[0] < 0.5), "one or two positions have no area"
    assert jf.OST()(xyz).ground.mean() > 0.9, "a level sheet"


def test_of_each_square_the_most_central_point_of_the_middle_of_its_lowest_sheet_stands_for_it(rng):
    xyz = np.column_stack([rng.integers(0, 64, (900, 2)) / 32 - 1, rng.integers(0, 60, 900) / 100])
    crowd = crowd_of(xyz)
    p = crowd.every.xyz.astype(np.float64)
    square = np.floor(p[:, :2] / 0.25)
    names = np.unique(square, axis=0)
    assert len(crowd.rows) == len(names) == len(np.unique(crowd.own)) and (crowd.rows[:-1] < crowd.rows[1:]).all()
    np.testing.assert_array_equal(crowd.points.xyz, crowd.every.xyz[crowd.rows])
    for name in names:
        rows = np.flatnonzero((square == name).all(axis=1))
        chosen = crowd.rows[crowd.own[rows[0]]]
        assert (crowd.own[rows] == crowd.own[rows[0]]).all() and chosen in rows
        z = np.sort(p[rows, 2][p[rows, 2] <= p[rows, 2].min() + 0.2])
        quarter = (len(z) - 1) // 4
        middle = rows[(p[rows, 2] >= z[quarter]) & (p[rows, 2] <= z[len(z) - 1 - quarter])]
        away = np.hypot(*(p[middle, :2] - (name + 0.5) * 0.25).T)
        assert chosen == middle[np.argmin(away)]


def test_what_stands_for_points_does_not_depend_on_where_the_cloud_is_cut(rng):
    xyz = sheet(rng, side=8.0) + [0.3, 0.7, 0.0]
    inside = (xyz[:, :2] > 2.6).all(axis=1)  # as a tile, whose corner is elsewhere
    chosen = []
    for part in (xyz, xyz[inside]):
        crowd = crowd_of(part, anchor=(0.0, 0.0))
        own = crowd.points.xyz[crowd.own] + crowd.every.cloud.origin
        at = crowd.every.xyz + crowd.every.cloud.origin
        well = (at[:, :2] > 3).all(axis=1)
        chosen.append(own[well][np.lexsort(at[well].T)])
    np.testing.assert_array_equal(*chosen)


def test_positions_are_tested_over_the_triangulation_as_scipy_interpolates_it(rng):
    xy = rng.uniform(0, 20, (300, 2))
    xyz = canonical_points(jf.PointCloud.from_arrays(np.column_stack([xy, np.sin(xy[:, 0] / 3)]))).xyz
    every, full = np.arange(len(xyz)), np.ones(len(xyz), np.float32)
    points = Points(jf.PointCloud.from_arrays(xyz), xyz, every, every, np.ones(len(xyz), np.int32))
    network = one_network(points, every, np.zeros((0, 2)), Outliers(full < 0, full < 0))
    beyond = Beyond(0.1, 0.5 * full)
    growth = Growth(AngleRule(0.3 * full, 90 * full, 0.0), vertices=Vertices(sinks=False), beyond=beyond)
    positions = np.column_stack([rng.uniform(-2, 22, (4000, 2)), rng.uniform(-1.5, 1.5, 4000)]).astype(np.float32)
    near = np.hypot(*(positions[:, None, :2] - xyz[:, :2]).transpose(2, 0, 1)).argmin(axis=1)
    with GroundTin.start(network, growth, workers=1) as ground:
        ground.ground[near[:2]] = False
        found = ground.over(positions, near)
        is_ground = ground.ground.copy()
    above = positions[:, 2] - LinearNDInterpolator(xyz[:, :2].astype(float), xyz[:, 2])(positions[:, :2])
    inside = np.isfinite(above)
    assert 500 < inside.sum() < 3900
    np.testing.assert_allclose(found["height"][inside], above[inside], atol=2e-3)
    distance = np.abs(above) * np.cos(np.radians(found["slope"]))
    clear = inside & (np.abs(distance - 0.3) > 0.01) & (found["slope"] < 80)
    np.testing.assert_array_equal(found["ground"][clear], distance[clear] < 0.3)
    away = np.hypot(*(positions[:, :2] - xyz[near, :2]).T)
    margin = np.abs(positions[:, 2] - xyz[near, 2]) - 0.1 - 0.5 * away
    np.testing.assert_allclose(found["margin"][~inside], margin[~inside], atol=1e-3)
    clear = ~inside & (np.abs(margin) > 1e-3)
    np.testing.assert_array_equal(found["ground"][clear], ((margin < 0) & is_ground[near])[clear])


@pytest.mark.parametrize("noise", [0.02, 0.04, 0.08])
def test_limits_of_three_sigmas_hold_a_noisy_sheet_since_its_middle_stands_for_it(rng, noise):
    xyz = sheet(rng, noise=noise)
    limits = {"tolerance": 3 * noise, "noise": 3 * noise, "tolerance_spacing": 0.0, "max_distance": 1.0}
    result = jf.OST.for_cloud(xyz).replace(**limits)(xyz)
    assert result.ground.mean() > 0.985  # of a normal distribution 99.7 % lie within
    assert abs((xyz[:, 2] - 0.05 * xyz[:, 0])[result.ground].mean()) < 0.005
    middle = np.median(np.abs(result.height[result.ground]))  # 0.67 sigma over the true plane
    assert 0.6 < middle / noise < 0.85


def test_what_stands_on_dense_ground_is_told_from_it_and_false_echoes_below_are_low(yard):
    xyz, truth = yard
    result = jf.OST.for_cloud(xyz)(xyz)
    scores = jf.evaluate(result, truth)
    assert scores.type1 < 2 and scores.type2 < 3
    under = np.arange(len(xyz)) >= len(xyz) - 100
    np.testing.assert_array_equal(result.barred, under)
    assert result.low_noise[under].all()
    judged = result.ground | (np.abs(result.margin) > 0)
    np.testing.assert_array_equal(result.margin[judged] <= 0, result.ground[judged])
    off = np.abs(np.nansum(result.doubt) - (result.ground != truth).sum()) / len(xyz)
    assert off < 0.03 and np.isfinite(result.doubt).all()
    wrong = np.sort(result.doubt)[-len(xyz) // 10]
    assert (result.ground != truth)[result.doubt >= wrong].mean() > 2 * (result.ground != truth).mean()


def test_points_that_stand_for_others_have_the_labels_of_a_cloud_of_them_alone(yard):
    xyz, _ = yard
    cloud = jf.PointCloud.from_arrays(xyz)
    crowd, filter_ = Crowd.from_points(canonical_points(cloud)), jf.OST.for_cloud(cloud)
    index = np.argsort(crowd.every.member)[crowd.rows]  # no two points are equal
    every, alone = filter_(cloud), filter_(jf.PointCloud.from_arrays(cloud.coordinates()[index]))
    for name in ("ground", "height", "slope", "margin", "doubt", "decision", "barred"):
        np.testing.assert_array_equal(getattr(every, name)[index], getattr(alone, name))
    assert every.info["seeds"] == alone.info["seeds"] and every.info["scatter"] == alone.info["scatter"]
    house = (abs(xyz[:, :2] - [12, 12]).max(axis=1) < 3.5) & ~every.ground
    assert (every.decision[house] == jf.Decision.SURFACE).mean() > 0.95


def test_labels_of_dense_clouds_depend_on_neither_order_nor_threads_nor_core(yard, rng):
    xyz, _ = yard
    cloud = jf.PointCloud.from_arrays(xyz)
    filter_ = jf.OST.for_cloud(cloud)
    whole, order = filter_(cloud, workers=1), rng.permutation(len(xyz))
    other = filter_(jf.PointCloud.from_arrays(xyz[order]), workers=3)
    part = filter_(dataclasses.replace(cloud, core=(3.0, 3.0, 9.0, 9.0)))
    inside = ((xyz[:, :2] >= 3) & (xyz[:, :2] <= 9)).all(axis=1)
    for name in ("ground", "height", "slope", "margin", "doubt", "decision", "barred"):
        np.testing.assert_array_equal(getattr(other, name), getattr(whole, name)[order])
        np.testing.assert_array_equal(getattr(part, name)[inside], getattr(whole, name)[inside])


def test_a_sweep_over_a_dense_cloud_finds_the_labels_of_single_runs(yard):
    xyz, truth = yard
    cloud = jf.PointCloud.from_arrays(xyz, reference=truth)
    base, values = jf.OST.for_cloud(cloud), (0.6, 1.25)
    swept = jf.sweep(base, cloud, {"max_distance": list(values)})
    alone = [jf.evaluate(base.replace(max_distance=value)(cloud), truth).total for value in values]
    np.testing.assert_allclose(np.ravel(swept["total"]), alone)
    assert alone[0] != alone[1]
