"""STIN against plain loops, closed forms and the figures of Uray & Varlik (2024)."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree
from test_densify import hillside
from triangulation import Mesh

import jaxfilter as jf
from experiments.papers.oracle import tuned
from jaxfilter.core.cloud import Whole
from jaxfilter.core.filter import of_scene
from jaxfilter.core.points import canonical_points
from jaxfilter.engines.tin.triangulation import lattice
from jaxfilter.steps.trend import quadratic_trend


def lowest(xyz, rows, cell):
    """The lowest of these rows in each cell counted from zero; of equals the first by x, then y."""
    last = np.ceil(xyz[:, :2].max(0) / cell) - 1
    key = np.minimum(np.floor(xyz[rows, :2] / cell), last) @ (10000, 1)
    order = np.lexsort((*xyz[rows].T[[1, 0, 2]], key))
    return np.sort(rows[order[np.append(True, np.diff(key[order]) != 0)]])


def plain(points, f, barred=None, lost=None):
    """The method without any machinery: float64, a new triangulation and all points in every round."""
    xyz, xy, n = points.xyz.astype(float), lattice(points.xyz), len(points)
    barred = np.zeros(n, bool) if barred is None else barred
    lost = np.zeros(n, bool) if lost is None else lost
    seeds = lowest(xyz, np.flatnonzero(~barred), f.seed_cell)
    (west, south), (east, north) = xyz[:, :2].min(0) - 10, xyz[:, :2].max(0) + 10
    corner = np.float32([[west, south], [east, south], [east, north], [west, north]]).astype(float)
    corner = np.column_stack([corner, xyz[seeds[cKDTree(xyz[seeds, :2]).query(corner)[1]], 2]])
    ground = np.isin(np.arange(n), seeds)
    far, steep, cell = f.max_distance, f.max_angle, f.seed_cell

    def judge(p, where, far, steep):
        facet = nodes[mesh.triangles[where]]
        normal = np.cross(facet[:, 1] - facet[:, 0], facet[:, 2] - facet[:, 0])
        normal *= (np.sign(normal[:, 2]) / np.linalg.norm(normal, axis=1))[:, None]
        d = np.abs(((p - facet[:, 0]) * normal).sum(1))
        gap = np.linalg.norm(facet - p[:, None], axis=2)
        sine = np.divide(d, gap.min(1), out=np.zeros_like(d), where=gap.min(1) > 0)
        angle = np.degrees(np.arcsin(np.clip(sine, 0, 1)))
        return (d <= far) & (angle <= steep), d, angle, facet, normal, gap

    while True:
        start = True
        while True:
            vertices = lowest(xyz, np.flatnonzero(ground), cell)
            nodes = np.concatenate([xyz[vertices], corner])
            mesh = Mesh(lattice(nodes))
            if start and f.thresholds == "quantile" and cell < f.seed_cell:
                others = np.setdiff1d(np.flatnonzero(ground), vertices)
                _, d, angle, *_ = judge(xyz[others], mesh.find(xy[others]), far, steep)
                far, steep = np.minimum((f.max_distance, f.max_angle), (np.quantile(d, 0.97), np.quantile(angle, 0.97)))
            start = False
            rest = np.flatnonzero(~ground & ~lost)
            ok, _, _, facet, normal, gap = judge(xyz[rest], mesh.find(xy[rest]), far, steep)
            if f.mirror != "off":
                over = np.flatnonzero(np.hypot(normal[:, 0], normal[:, 1]) / normal[:, 2] > f.max_terrain_slope / 100)
                about = facet[over, gap[over].argmin(1)]
                image = np.column_stack([2 * about[:, :2] - xyz[rest[over], :2], xyz[rest[over], 2]])
                there = mesh.find(lattice(image))
                over, image, there = over[there >= 0], image[there >= 0], there[there >= 0]
                second = judge(image, there, far, steep)[0]
                ok[over] |= second
            ground[rest[ok]] = True
            if ok.sum() < f.stop_ratio * n:
                break
        if cell <= f.final_cell:
            break
        cell = max(cell / 2, f.final_cell)
    return ground


BARE = {"low_clusters": False, "outlier_surface": "off", "seed_cell": 20.0, "max_angle": 12.0, "max_distance": 0.8}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"thresholds": "quantile"},
        {"mirror": "nearest", "max_terrain_slope": 15.0},
        {"final_cell": 3.0, "stop_ratio": 0.01, "seed_cell": 18.0},
    ],
    ids=str,
)
def test_labels_equal_those_of_a_plain_loop(changes):
    points = canonical_points(jf.PointCloud.from_arrays(hillside(1, n=5000)))
    f = jf.STIN(**(BARE | changes))
    expected = plain(points, f)
    assert 0.4 < expected.mean() < 0.95
    result = f(points.cloud)
    assert (result.ground[points.index] != expected[points.member]).sum() <= 3
    if changes:
        assert (result.ground != jf.STIN(**BARE)(points.cloud).ground).sum() > 5


def test_the_quadratic_surface_is_the_least_squares_fit_to_the_means_of_cells(rng):
    xy = rng.uniform(0, 200, (3000, 2))
    exact = (
        3 + 0.02 * xy[:, 0] - 0.01 * xy[:, 1] + 1e-4 * xy[:, 0] ** 2 - 2e-4 * xy[:, 0] * xy[:, 1] + 3e-4 * xy[:, 1] ** 2
    )
    xyz = np.column_stack([xy, exact + rng.normal(0, 1, 3000)]).astype(np.float32)
    key = np.floor(xyz[:, :2] / np.float32(25)) @ (100, 1)
    means = np.array([xyz[key == k].astype(float).mean(0) for k in np.unique(key)])

    def terms(x, y):
        return np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])

    a = terms(means[:, 0], means[:, 1])
    coefficient = np.linalg.solve(a.T @ a, a.T @ means[:, 2])  # normal equations
    found = quadratic_trend(xyz, 25.0)
    np.testing.assert_allclose(found, terms(*xyz[:, :2].astype(float).T) @ coefficient, atol=2e-3)
    assert np.abs(found - exact).max() < 1.5


def test_outliers_of_the_quadratic_surface_are_barred_or_removed():
    xyz = hillside(4, n=5000)
    xyz = np.concatenate([xyz, [[20.0, 20.0, -30.0], [70.0, 30.0, 60.0]]])
    f = jf.STIN(**(BARE | {"outlier_surface": "quadratic", "outlier_distance": 4.0}))
    points = canonical_points(jf.PointCloud.from_arrays(xyz))
    far = np.abs(points.xyz[:, 2] - quadratic_trend(points.xyz, 10.0)) > 4.0
    barred, removed = f(xyz), f.replace(outlier_fate="removed")(xyz)
    assert (barred.barred[points.index] == far[points.member]).all() and barred.barred[-2:].all()
    assert not barred.ground[-2:].any()
    assert not removed.ground[removed.barred].any()
    assert (barred.ground[points.index] == plain(points, f, far)[points.member]).mean() > 0.999
    assert (removed.ground[points.index] == plain(points, f, far, far)[points.member]).mean() > 0.999


def test_only_low_points_are_outliers_of_the_local_surface():
    x, y = (v.ravel().astype(float) for v in np.meshgrid(np.arange(0, 120), np.arange(0, 120)))
    z = 30 * np.cos(x / 40) + 0.3 * y
    z[7000] -= 14.0
    z[[3000, 3001]] += 25.0
    result = jf.STIN(low_clusters=False)(np.column_stack([x, y, z.round(2)]))
    assert np.flatnonzero(result.barred).tolist() == [7000]


def test_parts_of_a_scene_do_as_many_rounds_as_the_whole():
    """A part alone ends a grid too soon or too late, since it knows its own points only."""
    f = jf.STIN(seed_cell=12.0, stop_ratio=0.015, low_clusters=False)
    rough, level = hillside(1, n=5000), hillside(2, n=15000)
    level[:, 0], level[:, 2] = level[:, 0] + 96.0, 9.0  # adds all its points at once
    cloud = jf.PointCloud.from_arrays(np.concatenate([rough, level]), anchor=(0.0, 0.0))

    def rounds(result):
        stages = [step["stage"] for step in result.trace]
        return [stages.count(stage) for stage in range(4)]

    whole, found = f(cloud), of_scene(f, lambda points: [cloud])
    planned = list(found["rounds"][:4])
    assert rounds(whole) == [1, *planned[1:]] and max(planned[1:]) < f.max_rounds == planned[0], "one was enough"
    told = dataclasses.replace(cloud, whole=Whole(**found))
    np.testing.assert_array_equal(f(told).ground, whole.ground)
    part = jf.PointCloud.from_arrays(rough, anchor=(0.0, 0.0))
    alone, beside = f(part), f(dataclasses.replace(part, whole=told.whole))
    assert rounds(beside)[1:] == planned[1:] != rounds(alone)[1:]
    apart = of_scene(f, lambda points: [part, dataclasses.replace(part, origin=part.origin + [9e5, 6e4, 0.0])])
    assert apart == of_scene(f, lambda points: [part]), "windows far apart are put side by side"


def test_what_contradicts_the_method_is_an_error():
    with pytest.raises(jf.ParameterError, match="final_cell"):
        jf.STIN(final_cell=70.0)


def test_total_error_of_the_five_samples(sample):
    clouds = {number: sample(number) for number in (11, 12, 23, 52, 71)}
    totals = [jf.evaluate(tuned("stin", f"samp{n}")(cloud), cloud.reference).total for n, cloud in clouds.items()]
    assert np.mean(totals) <= 8.57  # Table 3, from its counts
