"""Densification, as methods use it, against a plain loop that triangulates everything anew in every round."""

import dataclasses
import functools
import itertools
import signal
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.spatial import cKDTree
from triangulation import Mesh

import jaxfilter as jf
from jaxfilter.core.cloud import PointCloud
from jaxfilter.core.points import canonical_points
from jaxfilter.core.result import Decision, Status, silent
from jaxfilter.engines.tin import flips, walks
from jaxfilter.engines.tin import ground as ground_module
from jaxfilter.engines.tin import triangulation as tin_module
from jaxfilter.engines.tin.facets import Rule
from jaxfilter.engines.tin.growth import Adaptive, Outliers
from jaxfilter.engines.tin.network import block_networks, border_positions
from jaxfilter.engines.tin.triangulation import lattice


def hillside(seed=0, n=4000, side=90.0):
    """f64[n, 3]: a slope with a scarp, a house and bushes, in decimetres, so that positions coincide and are cocircular."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, side, (n, 2)).round(1)
    z = 0.1 * xy[:, 0] + np.sin(xy[:, 1] / 12) + np.where(xy[:, 0] > 60, 3.0, 0.0) + rng.normal(0, 0.03, n)
    house = (np.abs(xy[:, 0] - 30) < 8) & (np.abs(xy[:, 1] - 40) < 10)
    bush = rng.random(n) < 0.2
    z = z + np.where(house, 6.0, 0.0) + np.where(bush & ~house, rng.uniform(0, 2, n), 0.0)
    return np.column_stack([xy, z.round(2)])


def scene(*given, **named):
    return canonical_points(PointCloud.from_arrays(hillside(*given, **named)))


def steep_scene(seed):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, 90, (1500, 2)).round(1)
    z = 0.6 * xy[:, 0] + 2 * np.sin(xy[:, 1] / 7) + rng.normal(0, 0.1, 1500)
    return canonical_points(PointCloud.from_arrays(np.column_stack([xy, z.round(2)])))


def of_rows(points, values):
    """Values of the points of a cloud, in the canonical order of its points."""
    out = np.zeros(len(points), values.dtype)
    out[points.member] = values[points.index]
    return out


def lowest_of_positions(xyz, rows):
    """The first of rows, which ascend, at each position: in canonical order this is the lowest."""
    return rows[np.sort(np.unique(xyz[rows, :2], axis=0, return_index=True)[1])]


def plain(net, growth):
    """The same method without any of the machinery: float64, one triangulation and all open points in every round."""
    rule, mirror = growth.rule, growth.mirror
    xyz, xy = net.xyz.astype(np.float64), lattice(net.xyz).astype(np.int64)
    ground = net.seed.copy()
    while True:
        vertices = lowest_of_positions(net.xyz, np.flatnonzero(ground))
        if growth.border_follows:
            real = vertices[net.real[vertices]]
            xyz[net.virtual, 2] = xyz[real[cKDTree(xy[real]).query(xy[net.virtual])[1]], 2]
        mesh = Mesh(xy[vertices])
        open_ = np.flatnonzero(net.open & ~ground)

        def judge(p, where, mesh=mesh, vertices=vertices):
            f = xyz[vertices[mesh.triangles[where]]]
            n = np.cross(f[:, 1] - f[:, 0], f[:, 2] - f[:, 0])
            n *= (np.sign(n[:, 2]) / np.linalg.norm(n, axis=1))[:, None]
            d = ((p - f[:, 0]) * n).sum(1)
            gap = np.linalg.norm(f - p[:, None], axis=2).min(1)
            sine = np.divide(d, gap, out=np.zeros_like(d), where=gap > 0)
            angle, v = np.degrees(np.arcsin(np.clip(sine, -1, 1))), p[:, 2] - f[:, :, 2].max(1)
            if not rule.signed:
                d, angle = np.abs(d), np.abs(angle)
            return (angle <= rule.max_angle) & (v <= rule.max_elevation) & (d <= rule.max_distance), f, n

        where = mesh.find(xy[open_])
        ok, f, n = judge(xyz[open_], where)
        if mirror is not None:
            steep = np.flatnonzero(np.degrees(np.arccos(n[:, 2])) > mirror.slope)
            gap = np.linalg.norm(f - xyz[open_, None], axis=2)
            top = f[steep, gap[steep].argmin(1) if mirror.nearest else f[steep, :, 2].argmax(1)]
            image = np.column_stack([2 * top[:, :2] - xyz[open_[steep], :2], xyz[open_[steep], 2]])
            there = mesh.find(lattice(image))
            steep, image, there = steep[there >= 0], image[there >= 0], there[there >= 0]
            second = judge(image, there)[0]
            ok[steep] = second | (ok[steep] & mirror.nearest)
        if not ok.any():
            return ground
        if growth.one_per_facet:  # of the points over it that may become vertices the lowest; the others may all stay
            height = ((xyz[open_] - f[:, 0]) * n).sum(1) / n[:, 2]
            taken = {tuple(v) for v in net.xyz[vertices, :2]}
            fresh = np.array([tuple(v) not in taken for v in net.xyz[open_, :2]])
            for facet in np.unique(where[ok & fresh]):
                rivals = np.flatnonzero(ok & fresh & (where == facet))
                ok[rivals] = False
                ok[rivals[height[rivals].argmin()]] = True
        ground[open_[ok]] = True


class OneEach(jf.PTD):
    """Of the points over a facet the lowest only becomes a vertex, as in the downward step of IPTD."""

    def growth(self, network):
        return dataclasses.replace(super().growth(network), one_per_facet=True, mirror=None)


TWO_SIDED = {"max_angle": 12.0, "max_distance": 0.8, "seed_cell": 15.0, "low_clusters": False}
SIGNED = jf.FPTD(max_angle=15.0, max_elevation=0.9, window=20.0, stride=10.0, low_clusters=False)
STEEP = SIGNED.replace(max_angle=12.0, max_elevation=0.7)


@pytest.mark.parametrize("filter_, points", [
    (SIGNED, scene(0)), (SIGNED, scene(1)), (STEEP, steep_scene(2)), (STEEP, steep_scene(3)),
    (SIGNED.replace(blocks="independent", window=30.0, stride=5.0), scene(3, n=2500)),
    (jf.PTD(max_terrain_angle=20.0, **TWO_SIDED), scene(2)), (jf.PTD(max_terrain_angle=5.0, **TWO_SIDED), scene(14, n=2500)),
    (jf.PTD(max_terrain_angle=20.0, refresh_border=False, **TWO_SIDED), scene(2)),
    (jf.ATIN(mirror="nearest", max_terrain_slope=36.0, **TWO_SIDED), scene(2)),
    (jf.ATIN(mirror="nearest", max_terrain_slope=9.0, **TWO_SIDED), scene(14, n=2500, side=70.0)),
    (OneEach(**TWO_SIDED, max_rounds=1000), scene(12, n=1200, side=60.0)),
    (OneEach(**TWO_SIDED, max_rounds=1000), scene(13, n=1200, side=60.0)),
], ids=lambda value: type(value).__name__)  # fmt: skip
def test_labels_equal_those_of_a_plain_loop(filter_, points):
    result, net = filter_(points.cloud), filter_.start(points, None, silent)
    expected, growth = np.zeros(len(points), bool), filter_.growth(net)
    for number in range(int(net.sheet[-1]) + 1):
        part = sheet_of(net, number)
        expected[part.row[plain(part, growth) & part.real]] = True
    assert result.status is Status.CONVERGED and 0.4 < expected.mean() < 0.95
    assert (of_rows(points, result.ground) != expected).sum() <= 4  # float32 against float64 at a threshold
    if isinstance(filter_, jf.PTD):
        assert (result.ground != jf.PTD(max_terrain_angle=90.0, **TWO_SIDED)(points.cloud).ground).sum() > 10


def blocks_of(points, reach=63.6):
    """The network of FPTD in blocks of 30 m, and its seeds, the lowest points of cells of 15 m."""
    key = np.floor(points.xyz[:, 0] / 15.0) * 1000 + np.floor(points.xyz[:, 1] / 15.0)
    order = np.lexsort((np.arange(len(points)), points.xyz[:, 2], key))
    seeds = np.sort(order[np.append(True, np.diff(key[order]) != 0)])
    border, none = border_positions(*points.extent, 30.0, points.anchored()), np.zeros(len(points), bool)
    return block_networks(points, seeds, border, Outliers(none, none), size=30.0, overlap=5.0, reach=reach), seeds


@pytest.mark.parametrize("sides", [(95.0, 30.0), (59.9, 120.0), (10.0, 61.0)])
def test_border_nodes_stand_a_block_apart_counted_from_the_anchor(sides):
    blocks = 0
    for width, height in (sides, sides[::-1]):
        border = border_positions(np.zeros(2), np.array([width, height]), 30.0, np.array([100.0, 100.0]))
        along = np.sort(border[border[:, 1] < -0.1, 0].clip(0, width))  # of the southern side
        nodes = np.arange(20.0, width, 30.0)  # 120 m, 150 m, ... from the anchor
        np.testing.assert_allclose(along, [0.0, *nodes, width], atol=1e-4)
        blocks += len(along) - 1
        at = {axis: np.unique(border[np.abs(border[:, 1 - axis]) < 1, 1 - axis]) for axis in (0, 1)}
        assert all(values.tolist() == [-0.25] for values in at.values()), "sides are straight"
    assert len(border) == 2 * blocks


def test_a_block_has_its_points_and_the_seeds_within_reach_of_its_centre():
    """Seeds stand 15 m apart, so that some are 30 m from a centre exactly."""
    column, line = (v.ravel().astype(float) for v in np.mgrid[:91, :91])
    points = canonical_points(PointCloud.from_arrays(np.column_stack([column, line, 0 * line])))
    (net, seeds), xy = blocks_of(points, 30.0), points.xyz[:, :2].astype(float)
    seed = np.isin(np.arange(len(points)), seeds)
    for number, centre in enumerate((c, r) for r in (15, 45, 75) for c in (15, 45, 75)):
        off = np.abs(xy - centre)
        near = seed & (np.hypot(*off.T) <= 30)
        assert 0 < near.sum() < seed.sum()
        own = net.row[(net.sheet == number) & net.real]
        assert np.array_equal(own, np.flatnonzero(near | (off <= 20).all(axis=1)))
    opened = np.bincount(net.row[net.open], minlength=len(points))
    assert opened.min() == 1 and opened.max() == 4


def test_blocks_begin_at_the_first_point_that_is_judged():
    """One that is not lies 45 m before all others, in both directions."""
    xyz = scene(3).xyz.astype(float)
    xyz[0, :2] = 0.0
    far = PointCloud.from_arrays(np.concatenate([xyz, [[-45.0, -45.0, 0.0]]]))
    far = dataclasses.replace(far, candidate=np.arange(len(xyz) + 1) < len(xyz))
    one, other = (blocks_of(canonical_points(cloud))[0] for cloud in (PointCloud.from_arrays(xyz), far))
    np.testing.assert_array_equal(np.bincount(one.sheet), np.bincount(other.sheet))
    assert one.sheet[-1] == 8


@pytest.mark.parametrize("turn", [1, -1])
@pytest.mark.parametrize(("place", "corners"), [(10.5, 0), (8.5, 4)])
def test_a_block_is_completed_where_seeds_do_not_surround_all_points_of_its_overlap(turn, place, corners):
    """The middle one of nine blocks reaches from 8 to 22; seeds around it leave out what is beyond x + y = 20."""
    seeds = np.array([(7.0, 13.0), (13.0, 7.0), (23.0, 7.0), (23.0, 23.0), (7.0, 23.0)])
    xy = 15 + turn * (np.array([*seeds, (place, place), (0.0, 0.0), (30.0, 30.0)]) - 15)
    points = canonical_points(PointCloud.from_arrays(np.column_stack([xy, np.zeros(len(xy))])))
    rows = cKDTree(points.xyz[:, :2]).query(xy[:5])[1]
    none, nowhere = np.zeros(len(xy), bool), np.zeros((0, 2))
    net = block_networks(points, np.sort(rows), nowhere, Outliers(none, none), size=10.0, overlap=2.0, reach=12.0)
    sheets = [net.row[net.sheet == number] for number in range(int(net.sheet[-1]) + 1)]
    (middle,) = (sheet for sheet in sheets if np.isin(rows, sheet).all())
    assert (middle < 0).sum() == corners


def sheet_of(net, number):
    """One sheet of a network, as a network of its own."""
    part = net.sheet == number
    columns = {name: getattr(net, name)[part] for name in ("xyz", "row", "seed", "open", "late")}
    return dataclasses.replace(net, sheet=np.zeros(part.sum(), np.int32), **columns)


def test_a_result_tells_heights_over_the_final_surface_decisions_and_rounds():
    points = scene(5)
    result, net = SIGNED(points.cloud, trace=True), SIGNED.start(points, None, silent)
    found = {
        name: of_rows(points, getattr(result, name)) for name in ("ground", "height", "elevation", "angle", "decision")
    }
    ground, high = found["ground"], found["elevation"] > 0.9
    vertices = lowest_of_positions(net.xyz, np.flatnonzero(np.append(ground, net.seed[len(points) :])))
    mesh, others = Mesh(lattice(net.xyz)[vertices]), np.flatnonzero(~ground)
    corners = vertices[mesh.triangles[mesh.find(lattice(net.xyz)[others])]]
    inner = (corners < len(points)).all(axis=1)  # border points have moved
    f, others = net.xyz[corners[inner]].astype(float), others[inner]
    n = np.cross(f[:, 1] - f[:, 0], f[:, 2] - f[:, 0])
    height = ((net.xyz[others] - f[:, 0]) * n).sum(1) / n[:, 2]
    assert inner.mean() > 0.8 and np.abs(found["height"][vertices[vertices < len(points)]]).max() == 0
    np.testing.assert_allclose(found["height"][others], height, atol=2e-3)

    seed = net.seed[: len(points)]
    expected = np.where(ground, Decision.ACCEPTED, np.where(high, Decision.ELEVATION, Decision.ANGLE))
    np.testing.assert_array_equal(found["decision"], np.where(seed, Decision.SEED, expected))
    assert np.bincount(expected[~seed])[[Decision.ACCEPTED, Decision.ANGLE, Decision.ELEVATION]].min() > 20
    assert (found["angle"][~ground & ~high] > 15).all()

    counts = [step["ground"].sum() for step in result.trace]
    assert (
        counts == sorted(counts) and (of_rows(points, result.trace[-1]["ground"][: len(points.cloud)]) == ground).all()
    )
    assert sum(step["accepted"] for step in result.trace) == (ground & ~seed).sum()
    cut_off = SIGNED.replace(max_rounds=2)(points.cloud)
    assert cut_off.status is Status.ROUND_LIMIT and len(cut_off.trace) == 2


def test_vertex_spacing_keeps_one_vertex_per_square_and_nearly_the_labels():
    cloud = scene(6, n=20000).cloud
    dense, thin = (SIGNED.replace(noise_floor=0.1, vertex_spacing=spacing)(cloud) for spacing in (0.0, 1.5))
    assert thin.info["vertices"] <= 60 * 60 + 100 < dense.info["vertices"]
    assert (thin.ground != dense.ground).mean() < 0.03


def test_late_points_wait_and_must_lie_near_the_surface():
    """Three of six are far below the ground, the others are suspected wrongly."""
    xyz = scene(7).cloud.coordinates()
    pit = np.flatnonzero((np.abs(xyz[:, 0] - 15) < 4) & (np.abs(xyz[:, 1] - 70) < 4))[:6]
    xyz[pit[:3], 2] -= 6.0

    class Suspicious(jf.FPTD):
        def outliers(self, points, workers):
            late = of_rows(points, np.isin(np.arange(len(xyz)), pit))
            return Outliers(late, late)

    result = Suspicious(**{f.name: getattr(SIGNED, f.name) for f in dataclasses.fields(SIGNED)})(xyz)
    assert not result.ground[pit[:3]].any() and result.ground[pit[3:]].any()
    assert result.decision[pit[0]] in (Decision.ANGLE, Decision.ELEVATION)


def following(thresholds):
    """PTD whose limits are those that a function of distances and angles of vertices gives."""

    class Following(jf.PTD):
        def growth(self, network):
            return dataclasses.replace(super().growth(network), adaptive=Adaptive(thresholds), mirror=None)

    return Following(**TWO_SIDED, refresh_border=False)


def test_loosened_thresholds_test_all_points_again():
    cloud = scene(15, n=2500, side=70.0).cloud
    steps = iter([Rule(max_angle=6, max_distance=0.3)] * 3 + [Rule(max_angle=12, max_distance=0.8)] * 100)
    late = following(lambda distance, angle: next(steps))(cloud)
    loose = jf.PTD(**TWO_SIDED, refresh_border=False)
    tight = loose.replace(max_angle=6.0, max_distance=0.3)(cloud)
    assert tight.ground.sum() + 100 < late.ground.sum() <= loose(cloud).ground.sum() + 20
    assert [step["tested"] > 500 for step in late.trace[2:5]].count(True)


def test_adaptive_thresholds_see_the_distances_of_vertices_to_the_facets_next_to_them():
    points, seen = scene(16, n=600, side=60.0), []

    def keep(distance, angle):
        seen.append((distance, angle))
        return Rule(max_angle=10, max_distance=0.5)

    filter_ = following(keep)
    result, net = filter_(points.cloud), filter_.start(points, None, silent)
    assert len(seen) == len(result.trace) + 1
    distance, angle = seen[-1]
    ground = np.append(of_rows(points, result.ground), net.seed[len(points) :])
    vertices = lowest_of_positions(net.xyz, np.flatnonzero(ground))
    mesh, xyz, expected = Mesh(lattice(net.xyz)[vertices]), net.xyz.astype(float), []
    for facet, beyond in zip(mesh.triangles, mesh.neighbours, strict=True):
        for other in beyond[beyond >= 0]:
            apex = np.setdiff1d(mesh.triangles[other], facet)[0]
            nodes = vertices[np.append(facet, apex)]
            if net.real[nodes].all():
                a, b, c, p = xyz[nodes]
                n = np.cross(b - a, c - a)
                d = abs((p - a) @ n) / np.linalg.norm(n)
                expected.append((d, np.degrees(np.arcsin(d / min(np.linalg.norm(p - v) for v in (a, b, c))))))
    expected = np.array(expected)
    assert len(distance) == len(expected) > 500
    np.testing.assert_allclose(np.sort(distance), np.sort(expected[:, 0]), atol=1e-3)
    np.testing.assert_allclose(np.sort(angle), np.sort(expected[:, 1]), atol=0.05)


@pytest.fixture
def lawn(monkeypatch):
    """A call for 240 x 240 points, one in each square metre, that all pass in the first round, in small steps."""
    rng, n = np.random.default_rng(7), 240 * 240
    xy = np.indices((240, 240)).reshape(2, -1).T + rng.integers(0, 1000, (n, 2)) / 1024
    cloud = PointCloud.from_arrays(np.column_stack([xy, rng.normal(0, 0.02, n)]))
    filter_ = jf.PTD(max_angle=89.0, max_distance=99.0, seed_cell=240.0, low_clusters=False)
    monkeypatch.setattr(tin_module, "NODES_AT_ONCE", 1024)
    monkeypatch.setattr(tin_module, "_SHARE", 1024)
    return functools.partial(filter_, cloud)


STEPS = {"judge": (ground_module, "judge"), "locate": (walks, "locate"), "insert": (flips, "insert")}
"""What is called again and again with a bounded number of nodes: nothing can interrupt it."""


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no signals to threads here")
@pytest.mark.parametrize("workers", [1, 3])
@pytest.mark.parametrize("step", STEPS)
def test_an_interrupt_ends_densification_before_another_step_begins(step, workers, lawn, monkeypatch):
    """The signal comes in the fifth step. Other threads wait until its handler has run, and then until what raised it has
    cancelled the steps that wait: each may have one more at most, which it had begun to fetch."""
    lawn(workers=workers)  # compiles
    place, name = STEPS[step]
    work, begun, later = getattr(place, name), itertools.count(1), []
    handled, cancelled = threading.Event(), threading.Event()

    def counted(*arguments, **named):
        if handled.is_set():
            later.append(name)
            cancelled.wait(60)
        elif next(begun) == 5:
            signal.pthread_kill(threading.main_thread().ident, signal.SIGUSR1)
            handled.wait(60)
        return work(*arguments, **named)

    def handler(*_):
        handled.set()
        raise KeyboardInterrupt

    def shutdown(pool, *arguments, **named):
        cancelled.set()
        return end(pool, *arguments, **named)

    end = ThreadPoolExecutor.shutdown
    monkeypatch.setattr(place, name, counted)
    monkeypatch.setattr(ThreadPoolExecutor, "shutdown", shutdown)
    before = signal.signal(signal.SIGUSR1, handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            lawn(workers=workers)
    finally:
        signal.signal(signal.SIGUSR1, before)
        cancelled.set()
    assert handled.is_set() and len(later) <= (workers if workers > 1 else 0)


@pytest.mark.data
@pytest.mark.parametrize("number", ["24", "41"])
def test_too_few_seeds_for_the_area_are_warned_of_and_no_others(sample, number):
    """IPTD as printed keeps one seed on sample 41, which two squares as large as the largest building cover."""
    warned = set()
    for name, method in jf.FILTERS.items():
        for way, filter_ in (("paper", method.preset("paper")), ("for_cloud", method.for_cloud(sample(number)))):
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", jf.JaxfilterWarning)
                filter_(sample(number))
            warned |= {(name, way, str(one.message).partition(" for ")[0]) for one in caught}
    assert warned == ({("iptd", "paper", "IPTD: too few seeds of the ground, 1")} if number == "41" else set())
