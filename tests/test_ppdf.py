"""PPDF: its planes against known ones, its quadrants against brute force, its figures on labelled tiles."""

import itertools

import jax
import numpy as np
import pytest

import jaxfilter as jf
from jaxfilter import scenes
from jaxfilter.core.points import canonical_points
from jaxfilter.steps.consensus import cells_of, consensus_planes
from jaxfilter.steps.references import NearestReferences, QuadrantReferences, local_planes
from jaxfilter.steps.scaled_planes import PlaneSearch, progressive_planes

DRAWS = jax.random.uniform(jax.random.key(0), (128, 3))


@pytest.fixture
def planes(rng):
    """Three cells: points, where each begins, the gradients of their planes, and which points are on them."""
    gradients = np.array([[0.1, -0.2], [0.0, 0.6], [-1.0, 0.3]])
    xyz, on = [], []
    for k, count in enumerate((40, 150, 500)):
        xy = rng.uniform(0, 10, (count, 2)) + [20 * k, 5]
        inlier = rng.random(count) < 0.6
        z = 7 * k + xy @ gradients[k] + np.where(inlier, rng.normal(0, 0.02, count), rng.uniform(0.8, 5, count))
        xyz.append(np.column_stack([xy, z]).astype(np.float32))
        on.append(inlier)
    return np.concatenate(xyz), np.array([0, 40, 190, 690]), gradients, np.concatenate(on)


def test_the_plane_with_most_points_is_found_in_every_cell(planes):
    xyz, start, gradients, on = planes
    found = consensus_planes(cells_of(xyz, start, 16), DRAWS, 0.15, 75.0)
    for k in range(3):
        rows = slice(start[k], start[k + 1])
        normal = np.asarray(found.normal[k])
        np.testing.assert_allclose(-normal[:2] / normal[2], gradients[k], atol=0.01)
        distance = (xyz[rows] - xyz[start[k]] - np.asarray(found.centre[k])) @ normal
        assert ((np.abs(distance) <= 0.15) == on[rows]).mean() > 0.99
        assert found.inliers[k] == (np.abs(distance) <= 0.15).sum()
        assert found.below[k] == pytest.approx(max(0, -distance.min()), abs=1e-4)
        alone = consensus_planes(cells_of(xyz[rows], start[k : k + 2] - start[k], 16), DRAWS, 0.15, 75.0)
        for one, all_ in zip(alone, found, strict=True):
            np.testing.assert_array_equal(one[0], all_[k], err_msg="not beside others")
    narrow = consensus_planes(cells_of(xyz, start, 16), DRAWS, 0.03, 75.0)  # counted again after the fit
    for k in range(3):
        offsets = xyz[start[k] : start[k + 1]] - xyz[start[k]] - np.asarray(narrow.centre[k])
        assert narrow.inliers[k] == (np.abs(offsets @ np.asarray(narrow.normal[k])) <= 0.03).sum()


def test_steep_planes_are_not_tried(rng):
    wall = np.column_stack([rng.normal(0, 0.01, 60), rng.uniform(0, 5, 60), rng.uniform(0, 9, 60)]).astype(np.float32)
    floor = np.column_stack([rng.uniform(0, 5, (40, 2)), rng.normal(0, 0.01, 40)]).astype(np.float32)
    cells = cells_of(np.concatenate([wall, floor]), np.array([0, 100]), 8)
    assert consensus_planes(cells, DRAWS, 0.1, 90.0).normal[0, 2] < 0.1
    assert consensus_planes(cells, DRAWS, 0.1, 75.0).normal[0, 2] > 0.99


def brute(xy, query, references, reach):
    """Squared distance to the nearest reference in each half-open quadrant."""
    dx, dy = np.moveaxis(xy[references][None].astype(float) - xy[query][:, None], -1, 0)
    quadrants = [
        (dx > 0) & (dy >= 0) | (dx == 0) & (dy == 0),
        (dx <= 0) & (dy > 0),
        (dx < 0) & (dy <= 0),
        (dx >= 0) & (dy < 0),
    ]
    assert (np.sum(quadrants, axis=0) == 1).all()
    square = [np.where(q, dx**2 + dy**2, np.inf).min(axis=1) for q in quadrants]
    return np.minimum(np.stack(square, axis=1), reach**2)


@pytest.mark.parametrize("side, reach", [(1.0, 30.0), (0.4, 7.0), (5.0, 12.0)])
def test_quadrants_against_brute_force(rng, side, reach):
    xy = rng.uniform(0, 50, (4000, 2)).round(1).astype(np.float32)
    references = np.arange(1, 4000, 7)
    references = references[np.hypot(*(xy[references] - 25).T) > 9]
    query = np.setdiff1d(np.arange(4000), references)
    around = QuadrantReferences(xy, query, side, reach)
    added = np.zeros(0, int)
    for part in (references[::3], references[1::3], references[2:20:3]):
        before = around.square.copy()
        changed = around.add(np.sort(part))
        added = np.append(added, part)
        expected = brute(xy, query, added, reach)
        np.testing.assert_allclose(around.square, expected, rtol=1e-5, atol=1e-6)
        assert (changed == (around.square < before).any(axis=1)).all()
    found = around.row >= 0
    assert (found == (expected < np.float32(reach) ** 2 * (1 - 1e-6))).all()
    assert np.isin(around.row[found], added).all()
    half = np.arange(len(query)) % 2 == 0
    around.keep(half)
    around.add(references)
    np.testing.assert_allclose(around.square, brute(xy, query[half], references, reach), rtol=1e-5, atol=1e-6)


def test_nearest_references_against_brute_force(rng):
    xy = rng.uniform(0, 50, (1500, 2)).astype(np.float32)
    references, query = np.arange(1, 1500, 9), np.setdiff1d(np.arange(1500), np.arange(1, 1500, 9))
    around = NearestReferences(xy, query, 6.0)
    added = np.zeros(0, int)
    for part in (references[:2], references[2::3], references[3::3]):
        before = around.row.copy()
        changed = around.add(part)
        added = np.append(added, part)
        square = ((xy[query][:, None].astype(float) - xy[added]) ** 2).sum(axis=2)
        order = np.argsort(square, axis=1)[:, :4]
        near = np.take_along_axis(square, order, axis=1) <= 36
        width = order.shape[1]
        np.testing.assert_array_equal(around.row[:, :width], np.where(near, added[order], -1))
        assert (around.row[:, width:] == -1).all()
        assert (changed == (around.row != before).any(axis=1)).all()
    assert not around.add(np.zeros(0, int)).any()
    around.keep(query > 700)
    assert len(around.row) == (query > 700).sum()


def test_local_planes_against_least_squares(rng):
    xyz = rng.uniform(0, 20, (300, 3)).astype(np.float32)
    query = np.arange(100)
    row = rng.integers(100, 300, (100, 4)).astype(np.int32)
    row[:20, 3] = -1
    distance, height, slope = local_planes(xyz, query, row)
    for k in query:
        known = xyz[row[k][row[k] >= 0]].astype(float)
        if np.linalg.svd(known[:, :2] - known[:, :2].mean(axis=0), compute_uv=False)[1] < 1:
            continue
        a, b, c = np.linalg.lstsq(np.column_stack([known[:, :2], np.ones(len(known))]), known[:, 2], rcond=None)[0]
        expected = xyz[k, 2] - (a * xyz[k, 0] + b * xyz[k, 1] + c)
        assert height[k] == pytest.approx(expected, rel=1e-3, abs=0.02)
        assert distance[k] == pytest.approx(expected / np.sqrt(1 + a * a + b * b), rel=1e-3, abs=0.02)
        assert slope[k] == pytest.approx(np.rad2deg(np.arctan(np.hypot(a, b))), abs=0.2)


def test_few_references_give_a_level_plane_through_the_nearest():
    xyz = np.array([[5, 5, 3], [7, 5, 1], [1, 5, 2]], np.float32)
    distance, height, slope = local_planes(
        xyz, np.array([0, 0]), np.array([[1, -1, 2, -1], [-1, -1, -1, -1]], np.int32)
    )
    assert (distance[0], height[0], slope[0]) == (2, 2, 0)
    assert np.isnan([distance[1], height[1]]).all()


@pytest.mark.parametrize(("share", "divided"), [(0.99, 0), (1.0, 1)])
def test_a_cell_is_divided_into_four_from_the_division_distance_on(share, divided):
    """One point of a level cell of 8 m lies ``share`` of that distance below the others."""
    x, y = (v.ravel() for v in np.mgrid[:8:0.25, :8:0.25])
    low = (x == 1.0) & (y == 1.0)
    points = canonical_points(jf.PointCloud.from_arrays(np.column_stack([x, y, -1.5 * share * low])))
    options = {"cell": 8.0, "min_points": 20, "inlier_distance": 0.3, "max_slope": 75.0, "division_distance": 1.5}
    found = progressive_planes(points, np.ones(len(points), bool), DRAWS, PlaneSearch(**options))
    small = (points.xyz[:, :2] < 4).all(axis=1)
    assert (found.divided > 0) == bool(divided) and (found.size[~small] == (4.0 if divided else 8.0)).all()
    sides = np.unique(found.size[small & ~np.isnan(found.size)]).tolist()
    assert sides == ([2.0] if divided else [8.0])  # the quarter with the point is divided again, down to min_points


@pytest.fixture(scope="module")
def forest():
    return scenes.make("forest", size=(80, 70), density=4, seed=3)


def test_shrubs_become_references_in_the_printed_reading_only(rng):
    """Ground, and shrubs of all heights up to 4 m: a ladder of steps below 1.5 m."""
    xy = rng.uniform(0, 40, (8000, 2)).round(2)
    shrub = (rng.random(8000) < 0.4) & (np.hypot(*(xy - 20).T) < 12)
    z = rng.normal(0, 0.03, 8000) + np.where(shrub, rng.uniform(0.4, 4, 8000), 0)
    xyz = np.column_stack([xy, z.round(2)])
    tall = shrub & (z > 2)
    ours, printed = jf.PPDF()(xyz).ground, jf.PPDF.preset("paper")(xyz).ground
    assert printed[tall].mean() > 0.3 and ours[tall].mean() < 0.01
    assert ours[~shrub].mean() > 0.98


def test_seeds_lie_near_planes_and_every_quantity_is_told(forest):
    result = jf.PPDF()(forest.cloud)
    judged = forest.cloud.candidate
    seeds = result.decision == jf.Decision.SEED
    assert (np.abs(result.elevation[seeds]) <= 0.5).all() and result.ground[seeds].all()
    assert (result.ground[judged] == (result.margin[judged] <= 0)).all()
    assert result.info["references"] >= seeds.sum()
    assert result.info["seeds"] >= seeds.sum()
    again = jf.PPDF(max_rounds=200)(forest.cloud, trace=True)
    traced = again.trace
    assert (
        again.status is jf.Status.CONVERGED
        and [bool(step["accepted"]) for step in traced].index(False) == len(traced) - 1
    )
    assert all((a["ground"] <= b["ground"]).all() for a, b in itertools.pairwise(traced))


def test_lowest_seeds_are_the_lowest_points_of_the_cells(rng):
    xy = rng.uniform(0, 59, (6000, 2)).round(2)
    xyz = np.column_stack([xy, (0.3 * xy[:, 0] + rng.uniform(0, 4, 6000)).round(3)]).astype(np.float32)
    result = jf.PPDF(seeds="lowest", window=0.0, low_clusters=False)(xyz)
    cell = np.floor((xyz[:, :2] - xyz[:, :2].min(axis=0)) / 10).astype(int) @ [1, 100]
    lowest = [rows[np.argmin(xyz[rows, 2])] for rows in (np.flatnonzero(cell == c) for c in np.unique(cell))]
    np.testing.assert_array_equal(np.flatnonzero(result.decision == jf.Decision.SEED), np.sort(lowest))
    assert result.info["planes"] == 0


def test_a_wide_roof_is_no_ground_if_the_disk_is_wider(rng):
    xy = rng.uniform(0, 150, (45000, 2)).round(2)
    roof = (np.abs(xy - 75) < 20).all(axis=1)
    xyz = np.column_stack([xy, (rng.normal(0, 0.02, len(xy)) + 0.1 * xy[:, 0] + 8 * roof).round(2)])
    for window, low, high in ((25.0, 0.0, 0.03), (0.0, 0.5, 1.0)):
        ground = jf.PPDF(window=window)(xyz).ground
        assert low <= ground[roof].mean() <= high
        assert ground[~roof].mean() > 0.97


def test_points_without_a_reference_in_reach_are_no_ground(rng):
    """The middle of a roof, whose own plane is no reference."""
    xy = rng.uniform(0, 110, (12000, 2)).round(2)
    roof, middle = ((np.abs(xy - 55) < half).all(axis=1) for half in (30, 8))
    xyz = np.column_stack([xy, (rng.normal(0, 0.02, len(xy)) + 8 * roof).round(2)])
    result = jf.PPDF(window=32.0, reach=20.0, low_clusters=False)(xyz)
    assert not result.ground[middle].any() and np.isnan(result.margin[middle]).all()
    assert result.ground[~roof].mean() > 0.97


def test_other_draws_give_nearly_the_same_labels(forest):
    one, two, three = (jf.PPDF()(forest.cloud, key=key).ground for key in (None, jax.random.key(0), jax.random.key(7)))
    assert (one == two).all()
    assert (one == three).mean() > 0.99


@pytest.mark.parametrize(
    "tile, expected", [pytest.param("lff_2_42.laz", 1.6, marks=pytest.mark.slow), ("zf_veluwezoom_ahn3.laz", 4.1)]
)
def test_forest_tiles(data, tile, expected):
    cloud = jf.read(data / "tiles" / tile, units="m", returns="all", ignore_classes=(7, 9, 12, 18, 26, 65, 66, 67))
    scores = jf.evaluate(jf.PPDF()(cloud), cloud.reference, ignore=~cloud.candidate)
    assert scores.total < expected + 0.1
