"""OST and its parts against SciPy, NumPy, closed forms and constructed scenes."""

import dataclasses
import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay

import jaxfilter as jf
from jaxfilter.cli.commands import main
from jaxfilter.core.points import Points, canonical_points
from jaxfilter.engines.grid import shapes
from jaxfilter.engines.ground import grow
from jaxfilter.engines.tin import rings
from jaxfilter.engines.tin.ground import GroundTin
from jaxfilter.engines.tin.growth import Beyond, Growth, Outliers, Vertices
from jaxfilter.engines.tin.network import one_network
from jaxfilter.engines.tin.triangulation import Tin
from jaxfilter.methods import ost
from jaxfilter.scenes import Kind
from jaxfilter.steps.ground_rules import AngleRule, HeightRule
from jaxfilter.steps.landscape import landscape_slope
from jaxfilter.steps.objects import Parts
from jaxfilter.steps.pruning import Scatter, drop_vertices
from jaxfilter.steps.rules import RULES, OstRule, OstScene
from jaxfilter.steps.rules.scene import filled
from jaxfilter.steps.seeds import standing, veiled
from jaxfilter.steps.sensors import AIRBORNE, MATCHING
from jaxfilter.steps.surfaces import lowest_cells

ROOFS = jf.OST(roof_step=0.3, roof_area=30.0, roof_share=0.6, roof_drop=2.5, roof_drop_share=0.5)


def points_of(xyz):
    return canonical_points(jf.PointCloud.from_arrays(xyz)).xyz


def rows_of(xyz):
    every = np.arange(len(xyz))
    return Points(jf.PointCloud.from_arrays(xyz), xyz, every, every, np.ones(len(xyz), np.int32))


def cells_of(xyz, cell=1.0):
    return lowest_cells(rows_of(xyz), cell, "cell", corner=(0.0, 0.0))


def ground_of(xyz, seeds, rule, workers=1):
    """The growth of OST, before its first step."""
    none = np.zeros(len(xyz), bool)
    network = one_network(rows_of(xyz), seeds, np.zeros((0, 2)), Outliers(none, none))
    growth = Growth(rule, vertices=Vertices(sinks=False), kept=("margin", "height", "slope"))
    return GroundTin.start(network, growth, workers=workers)


def nodes(side, z):
    """f32[side * side, 3] in canonical order: one point in the middle of every square metre."""
    row, column = np.mgrid[:side, :side]
    return points_of(np.column_stack([column.ravel() + 0.5, row.ravel() + 0.5, np.broadcast_to(z, row.shape).ravel()]))


def low_of(filter_, points):
    """bool[m], what the first step bars."""
    return filter_.surface(points, 1).low


def with_rule(monkeypatch, name, **constants):
    """From now on the rule has other constants."""
    monkeypatch.setitem(RULES, name, dataclasses.replace(RULES[name], **constants))


@pytest.fixture
def tin_of():
    """A function that makes the network of all points f32[n, 3]."""
    with ThreadPoolExecutor(2) as pool:
        yield lambda xyz: Tin(xyz.copy(), np.zeros(len(xyz), np.int32), np.arange(len(xyz)), pool)


@pytest.mark.parametrize(
    "density, extent, window",
    [(1.0, (60, 60), 12.0), (8.0, (20, 20), 6.0), (0.05, (300, 300), 25.0), (0.4, (8, 200), 25.0)],
)
def test_low_points_are_those_with_few_others_as_low_around_them_wherever_the_grid_lies(rng, density, extent, window):
    """Every count by hand, over rough land with clusters below; ties of distance and of depth are whole numbers."""
    n = int(density * np.prod(extent))
    xyz = np.column_stack([rng.integers(0, 4 * np.array(extent), (n, 2)) / 4, rng.integers(0, 12, n) / 4])
    for size in (1, 5, 6, 7):
        near = np.argsort(np.hypot(*(xyz[:, :2] - rng.uniform(0, extent)).T))[:size]
        xyz[near, 2] -= 20
    xyz = np.concatenate([xyz, [[9 * max(extent) + i / 4, 0, i / 2] for i in range(9)]])  # few in all: below or above
    points = canonical_points(jf.PointCloud.from_arrays(xyz, anchor=(0.37, 512.71)))
    p = points.xyz.astype(np.float64)
    radius = max(window, 8 * points.spacing())
    around = ((p[:, None, :2] - p[:, :2]) ** 2).sum(axis=2) <= radius**2
    below = (around & (p[:, 2] < p[:, None, 2] + 2)).sum(axis=1) - 1
    expected = (below <= 6) & (around.sum(axis=1) - 1 - below > 6)
    assert 5 <= expected.sum() < 40
    np.testing.assert_array_equal(low_of(jf.OST(window=window, low_points=6, rules=()), points), expected)
    assert not low_of(jf.OST(window=window, low_points=0), points).any()


def test_a_cluster_is_low_and_a_courtyard_and_a_patch_far_away_are_not():
    x, y = (v.ravel() + 0.5 for v in np.mgrid[:100, :100])
    block = (abs(x - 50) < 18) & (abs(y - 50) < 18)  # streets beyond it are within the radius
    court, cluster = (abs(x - 50) < 2) & (abs(y - 50) < 2), (abs(x - 20) < 2) & (abs(y - 20) < 2)
    xyz = np.column_stack([x, y, np.where(block & ~court, 12.0, 0.0) - 9.0 * cluster])
    xyz = np.concatenate([xyz, [[300 + i, 300, -30.0] for i in range(10)]])
    points = canonical_points(jf.PointCloud.from_arrays(xyz))
    low = points.spread(low_of(jf.OST(), points), False)
    np.testing.assert_array_equal(low, np.append(cluster, np.zeros(10, bool)))


@pytest.mark.parametrize("depth, scatter, barred", [(10, 0.8, True), (10, 0.1, False), (2.2, 0.5, False)])
def test_a_large_cluster_is_low_if_it_is_deep_and_scatters(rng, depth, scatter, barred):
    x, y = (v.ravel() + 0.5 for v in np.mgrid[:100, :100])
    cluster = np.hypot(x - 40, y - 60) < 5
    hill = 0.3 * x + np.where(cluster, rng.normal(-depth, scatter, len(x)), 0)
    points = canonical_points(jf.PointCloud.from_arrays(np.column_stack([x, y, hill])))
    low = points.spread(low_of(jf.OST(), points), False)
    assert 60 < cluster.sum() < 120
    np.testing.assert_array_equal(low, cluster & barred)
    assert low_of(jf.OST(rules=()), points).sum() <= 30


@pytest.mark.parametrize("rule, plants, barred", [("clusters", 0, True), ("clusters", 3, False), ("strays", 3, True)])
def test_one_deep_point_is_low_beside_lower_ground_by_one_rule_and_under_plants_by_another(rng, rule, plants, barred):
    """Within the radius many points are lower, below the step of a terrace."""
    x, y = (v.ravel() + 0.5 for v in np.mgrid[:100, :100])
    z = np.where(x < 50, 0.0, 6.0)
    z[(x == 70.5) & (y == 50.5)] = -1.5
    above = np.repeat(np.column_stack([x, y, np.full(len(x), 6.0)])[x > 50], plants, axis=0)
    xyz = np.concatenate([np.column_stack([x, y, z]), above + rng.uniform((-0.4, -0.4, 1), (0.4, 0.4, 4), above.shape)])
    points = canonical_points(jf.PointCloud.from_arrays(xyz))
    low = points.spread(low_of(jf.OST(spacing=1.0, rules=(rule,)), points), False)
    np.testing.assert_array_equal(low, (xyz[:, 2] == -1.5) & barred)
    assert not low_of(jf.OST(rules=()), points).any()


def test_lone_echoes_below_a_wooded_hillside_are_low_and_ground_is_not_in_a_pit_either(rng):
    """One of twenty points is ground, beside few others; the pit is 3 m deep and 4 m wide. At its border a slope has no trend."""
    x, y = rng.uniform(0, 100, (2, 40000))
    ground = 0.6 * x + 2 * np.sin(y / 12)
    pit, stray = np.hypot(x - 40, y - 60) < 2, (np.arange(len(x)) < 50) & (np.hypot(x - 40, y - 60) > 20)
    z = ground + np.where(pit, -3, rng.uniform(2, 20, len(x)) * (rng.random(len(x)) < 0.95))
    z[stray] = (ground - rng.uniform(3, 20, len(x)))[stray]
    points = canonical_points(jf.PointCloud.from_arrays(np.column_stack([x, y, z])))
    low = points.spread(low_of(jf.OST(spacing=0.5, rules=("strays",)), points), False)
    inside = np.abs(x - 50) < 30
    assert not (low & ~stray)[inside].any()
    assert low[stray & inside].mean() > 0.9
    assert low_of(jf.OST(spacing=0.5, rules=()), points).sum() < 0.6 * stray.sum()


def test_drawn_elevations_equal_scipy(rng):
    xy, z = rng.uniform(-3, 43, (150, 2)), rng.normal(size=150)
    triangles = Delaunay(xy).simplices.astype(np.int32)
    a, b, c = (xy[triangles[:, k]] for k in range(3))
    turn = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    triangles[turn < 0] = triangles[turn < 0][:, [0, 2, 1]]
    known = rng.random((40, 40)) < 0.2
    out, before = np.full((40, 40), -99.0, np.float32), known.copy()
    row, column = np.mgrid[:40, :40]
    ghost = np.concatenate([triangles, [[0, 1, -1]]]).astype(np.int32)
    shapes.draw(*xy.T.copy(), ghost, z.astype(np.float32), out, known)
    expected = LinearNDInterpolator(xy, z)(column, row)
    drawn = ~before & np.isfinite(expected)
    assert (known == (drawn | before)).all() and (out[~drawn] == -99.0).all()
    np.testing.assert_allclose(out[drawn], expected[drawn], atol=1e-4)


def test_the_census_counts_as_numpy_does(rng):
    segment, count = shapes.segments(rng.integers(0, 2, (18, 22)).astype(np.float32), np.float32(0.5), 3)
    fall, slope = rng.random((2, *segment.shape)).astype(np.float32)
    fall *= rng.choice([-1, 1], segment.shape)
    falls = np.abs(fall) > 0.25 + 0.5 * slope
    walls, inside = rng.random(segment.shape) < 0.5, rng.random(segment.shape) < 0.9
    wide = np.pad(np.where(inside, segment, -1), 1, constant_values=-1)
    border, edge = np.zeros((2, *segment.shape), bool)
    for dr, dc in ((0, 1), (2, 1), (1, 0), (1, 2)):
        beside = wide[dr : dr + 18, dc : dc + 22]
        border |= (beside != segment) & (beside >= 0)
        edge |= beside < 0
    limits = (np.float32(limit) for limit in (0.25, 0.5, 0.6))
    found = shapes.census(segment, count, fall, walls, slope, inside, *limits)
    assert (found[:, 0] == 0).all() and found.shape == (6, count + 1)
    falling, tall = border & falls, border & walls & (fall > 0.6)
    counted = np.ones_like(border), border, falling, falling & (fall < 0), tall, edge & ~border
    for k, cells in enumerate(counted):
        np.testing.assert_array_equal(found[k, 1:], np.bincount(segment[cells], minlength=count + 1)[1:])


def test_residuals_and_roughness_equal_least_squares_over_the_neighbours_in_scipys_triangulation(rng, tin_of):
    turn = np.linspace(0, 2 * np.pi, 80, endpoint=False)
    hub = [100.0, 30.0] + np.concatenate([[[0.0, 0.0]], 20 * np.column_stack([np.cos(turn), np.sin(turn)])])
    xy = np.concatenate([rng.uniform(0, 60, (300, 2)), hub])  # scattered, and one point with 80 neighbours
    xyz = points_of(np.column_stack([xy, rng.normal(size=len(xy))]).round(3))
    count, xy = len(xyz), xyz[:, :2].astype(np.float64)
    tin = tin_of(xyz)
    e, rough = np.zeros(count, np.float32), np.zeros(count, np.float32)
    tables = tin.triangles, tin.neighbours, tin.where
    rings.residuals(xyz, *tables, np.arange(count), e)
    rings.roughness(*tables, np.arange(count), e, rough)
    network = Delaunay(xy)
    beside, across = [set() for _ in range(count)], [[] for _ in range(count)]
    for t, corners in enumerate(network.simplices):
        for k, node in enumerate(corners):
            beside[node] |= {corners[(k + 1) % 3], corners[(k + 2) % 3]}
            if (beyond := network.neighbors[t, k]) >= 0:
                across[node] += set(network.simplices[beyond]) - set(corners)
    inner = np.setdiff1d(np.arange(count), network.convex_hull)
    assert len(inner) > 200
    for node in inner:
        rows = np.array([*beside[node], *across[node]])
        a = np.column_stack([np.ones(len(rows)), xy[rows] - xy[node]])
        plane = np.linalg.lstsq(a, xyz[rows, 2].astype(np.float64), rcond=None)[0]
        assert e[node] == pytest.approx(xyz[node, 2] - plane[0], abs=1e-4)
        assert rough[node] == pytest.approx(np.sqrt((e[rows].astype(np.float64) ** 2).mean()), abs=1e-5)


@pytest.mark.parametrize("houses", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_slope_of_a_landscape_is_that_of_its_plane(houses):
    row, column = np.mgrid[:100, :100].astype(np.float32)
    z, objects = 0.3 * column + 0.4 * row, np.zeros((100, 100), bool)
    if houses:
        objects[20:32, 20:32] = objects[60:75, 50:58] = True
        z = z + 8 * objects
    slope = landscape_slope(z.astype(np.float32), cells_of(nodes(100, z)), objects, 10.0)
    np.testing.assert_allclose(slope, 0.5, atol=0.06 if houses else 1e-3)


def scene_of(z, roofs=ROOFS, inside=None, largest=1e6, seen=None, slope=0.0, marked=None, high=None):
    """A scene of cells of 1 m in the state in which rules judge: all but the rows of points is known."""
    z, every = np.asarray(z, np.float32), np.ones(z.shape, bool)
    inside, seen = (every if given is None else given for given in (inside, seen))
    row, column = (a.ravel() + 0.5 for a in np.mgrid[: z.shape[0], : z.shape[1]])
    top = z if high is None else high
    scene = OstScene(
        roofs.replace(window=math.sqrt(largest) / 2), rows_of(np.c_[column, row, top.ravel()].astype("f4")), 1.0
    )
    cells = cells_of(np.c_[column, row, z.ravel()].astype("f4"))
    wide = [(0, n - m) for n, m in zip(cells.seen.shape, z.shape, strict=True)]
    scene.z, scene.inside, scene.cells = z, inside, dataclasses.replace(cells, seen=np.pad(seen, wide))
    scene.segments = Parts.from_elevations(z, inside, scene.seen, 1.0, roofs.roof_step, roofs.roof_area)
    scene.slope = np.full(z.shape, slope, np.float32)
    scene.marked = np.zeros(z.shape, bool) if marked is None else marked
    scene.whole = scene.back = scene.rock = ~every
    RULES["steep"].fill(scene)
    return scene


def given_back(name, z, marked, whole=None, **given):
    """bool[rows, columns]: what the rule makes ground of these marked cells."""
    scene = scene_of(z, marked=marked, **given)
    scene.whole = scene.whole if whole is None else whole
    RULES[name].give_back(scene)
    return scene.back


def objects(z, **given):
    """Cells that go as a whole, by the core and by the rule for halls."""
    scene = scene_of(z, **given)
    scene.whole = scene.ost.roofs(scene)
    RULES["halls"].measure(scene)
    RULES["halls"].judge(scene)
    return scene.whole


@pytest.mark.parametrize("back, reach", [(2, 12.0), (3, 8.0)])
def test_flanks_are_the_nearest_edges_on_both_sides_of_a_line(rng, back: int, reach: float) -> None:
    """Walks outward from each cell, along each line."""
    blocks = np.kron(rng.integers(0, 4, (7, 8)), np.ones((4, 4)))
    z = (blocks + rng.normal(0, 0.1, blocks.shape)).astype(np.float32)[:26, :31]
    drop, lines = 0.8, ((0, 1), (1, 2), (1, 1), (2, 1), (1, 0), (2, -1), (1, -1), (1, -2))

    def at(row: int, column: int) -> float:
        inside = 0 <= row < z.shape[0] and 0 <= column < z.shape[1]
        return float(z[row, column]) if inside else np.inf

    def edge(row: int, column: int, dy: int, dx: int) -> tuple[float, float, float]:
        """Cells to it, its elevation, and what it falls by."""
        step, away = np.float32(np.hypot(dy, dx)), np.float32(0)
        far = max(1, round(back / step))
        while np.isfinite(here := at(row, column)):
            first, second = at(row + far * dy, column + far * dx), at(row + 2 * far * dy, column + 2 * far * dx)
            if here - first > drop and first - second < (here - first) / 3:
                return away, here, here - first
            row, column, away = row + dy, column + dx, away + step  # which rounds as there
        return np.inf, np.nan, np.nan

    expected = np.zeros((3, *z.shape))
    expected[1] = reach
    for (row, column), here in np.ndenumerate(z):
        for turn, (dy, dx) in enumerate(lines, 1):
            (left, low, fall), (right, high, other) = (edge(row, column, s * dy, s * dx) for s in (-1, 1))
            near = float(left + right) + 1
            if near < expected[1, row, column] and max(abs(low - here), abs(high - here)) < drop / 2:
                expected[:, row, column] = turn, np.float32(near), min(fall, other)
    assert (np.bincount(expected[0].astype(int).ravel(), minlength=9) > 0).all()  # no line is without
    found = shapes.flanks(z, back, np.float32(reach), np.float32(drop))
    same = found[0] == expected[0]
    assert same.mean() > 0.9  # where further edges lie between two, these are none
    np.testing.assert_allclose(np.stack(found[1:])[:, same], expected[1:][:, same], rtol=1e-6)


@pytest.mark.parametrize("width, height, slope", [(3, 3, 0.5), (5, 5, 0.67), (4, 8, 0.67), (8, 4, 0.8)])
def test_the_crest_of_a_dike_is_ground(rng, width, height, slope):
    """Dikes of earth across a plain with waves, at 2 points per m2; a twentieth of the points are plants."""
    x, y = rng.uniform(0, 120, (2, 28_800))
    across = np.abs((x - 60) * np.cos(0.5) + (y - 60) * np.sin(0.5))
    dike = np.maximum(height - np.maximum(across - width / 2, 0) * slope, 0)
    z = dike + 0.3 * np.sin(x / 25) + rng.normal(0, 0.03, len(x))
    plant = rng.random(len(x)) < 0.05
    cloud = jf.PointCloud.from_arrays(np.column_stack([x, y, z + plant * rng.uniform(0.5, 3, len(x))]))
    ground = jf.OST.for_cloud(cloud)(cloud).ground
    assert ground[~plant].mean() > 0.97 and ground[~plant & (across < width / 2)].mean() > 0.9
    assert ground[plant].mean() < 0.05


def test_what_falls_on_banks_is_an_embankment_and_what_has_walls_is_none(rng):
    row, column = np.mgrid[:80, :80].astype(np.float32)
    dike = np.clip(6 - 0.6 * np.abs(row + column / 4 - 50), 0, 4)
    top = dike > 1
    np.testing.assert_array_equal(given_back("embankments", dike, top), top)
    house, sunk = np.where(top, dike / 3 + 2, 0), np.where(top, -1, 0)  # this one falls nowhere
    rough, steep = dike + top * rng.uniform(0, 0.9, dike.shape), 2.5 * dike  # steeper than earth
    for other in (house, sunk, rough, steep):
        assert not given_back("embankments", other, top).any()
    assert not given_back("embankments", dike, top, roofs=ROOFS.replace(roof_area=5000.0)).any()


def test_a_rock_is_terrain_and_a_roof_and_a_crown_are_none(rng):
    """Cones of 60 degrees: bare; with a storey below; with echoes at any height. All of them are marked."""
    row, column = np.mgrid[:60, :60].astype(np.float32)
    cone = np.maximum(0, 20 - 1.7 * np.hypot(row - 30, column - 30)).astype(np.float32)
    marked = cone > 0
    bare = cone + np.float32(1.7) * marked
    np.testing.assert_array_equal(given_back("steep", cone, marked, high=bare), marked)
    house = np.where(marked, cone / 4 + 5, 0).astype(np.float32)
    crown = cone + np.where(marked, rng.uniform(0, 3, cone.shape), 0).astype(np.float32)
    level = np.minimum(cone, np.float32(5))  # between its faces
    for other, high in ((house, house + 0.5), (cone, bare + 3 * marked), (crown, crown + 2), (level, level)):
        assert not given_back("steep", other, marked, high=high).any()
    assert not given_back("steep", cone, marked, whole=marked, high=bare).any()  # roofs as a whole
    assert not given_back("steep", cone, marked, high=bare, seen=column % 2 == 0).any()  # too few points to tell


@pytest.mark.parametrize("sensor, share", [(AIRBORNE, 0.97), (MATCHING, 0.7)])
def test_a_headland_of_steep_rock_at_the_edge_of_the_data_is_ground(rng, sensor, share):
    """A quarter of a cone, 30 m high, above level land, at ten points per square metre. In photographs walls are such ramps."""
    xy = rng.uniform(0, 60, (36_000, 2))
    z = np.maximum(0, 30 - 1.5 * np.hypot(*xy.T)) + rng.normal(0, 0.02, len(xy))
    echo = np.full(len(xy), 2 if sensor == AIRBORNE else 1, np.uint8)
    cloud = jf.PointCloud.from_arrays(np.column_stack([xy, z]), return_number=echo, number_of_returns=echo)
    result = jf.OST.for_cloud(cloud)(cloud)
    steep = np.hypot(*xy.T) < 19
    assert result.info["sensor"] == sensor
    assert steep.sum() > 2000 and result.ground[steep].mean() > share


def rock_where(there):
    """A rule for steep terrain that gives back the columns in which this is so."""

    def give_back(self, scene):
        scene.rock = scene.back = there(np.mgrid[: scene.z.shape[0], : scene.z.shape[1]][1])

    return give_back


def test_near_steep_terrain_that_is_given_back_rough_rock_is_ground(rng, monkeypatch):
    """A slope of 45 degrees with bumps of up to 1 m, of which the western end is said to be given back."""
    xy = rng.uniform((0, 0), (90, 30), (27_000, 2))
    up = rng.uniform(0, 1, len(xy))
    points = np.column_stack([xy, xy[:, 0] + up])
    filter_, bumps = jf.OST(window=20, scaling=0, distance_relief=0, rounds=2), up > 0.7
    monkeypatch.setattr(type(RULES["steep"]), "give_back", rock_where(lambda column: column < 10))
    near, far = bumps & (xy[:, 0] < 29), bumps & (xy[:, 0] > 31)  # the window lies around the first ten metres
    ground = filter_(points).ground
    assert ground[near].mean() > 0.9 and ground[far].mean() < 0.2


@pytest.mark.parametrize(
    "density, slope, plants, hidden",
    [(5, 0.0, 0.6, True), (5, 1.0, 0.6, True), (5, 0.0, 0.3, False), (5, 3.0, 0.0, False), (1, 0.0, 0.6, False)],
    ids=["plants", "plants on a slope", "few plants", "a bare face", "few points"],
)
def test_plants_hide_the_ground_where_most_points_stand_above_the_lowest(rng, density, slope, plants, hidden):
    x, y = rng.uniform(0, 40, (2, density * 1600))
    z = slope * x + (rng.random(len(x)) < plants) * rng.uniform(2, 9, len(x))
    points = canonical_points(jf.PointCloud.from_arrays(np.column_stack([x, y, z])))
    cells = lowest_cells(points, 1.0, "here")
    found = veiled(points, cells, 10.0, standing(points, cells))
    rows = slice(3, 37)  # cells at the border have few points, or a part of a face
    assert (found[rows, rows] == hidden).all()


def test_terrain_below_plants_that_let_few_pulses_through_is_that_of_the_few():
    """A slope of 31 degrees under forest, of which one pulse in a hundred meets the ground below a crown."""
    layout = dataclasses.replace(jf.scenes.LAYOUTS["canopy"], penetration=0.01, tilt=0.6, forest=0.95)
    scene = jf.scenes.make(layout, size=(250, 200), density=4.0, seed=21)
    assert scene.truth[scene.cloud.candidate].mean() < 0.3

    def measured(rules):
        result = jf.OST.for_cloud(scene.cloud, rules=rules)(scene.cloud)
        return jf.dtm_rmse(scene.cloud, result, scene.truth)

    found, before = measured(None), measured([name for name in RULES if name not in ("plants", "pits", "ramps")])
    assert found.rmse < 0.7 * before.rmse and found.off < 0.7 * before.off and before.off > 1


def test_in_a_sparse_forest_on_a_slope_the_terrain_is_that_of_the_few_points_below(rng):
    """A tenth of 0.1 points per m2 is ground, so the lowest point of most cells of any usual size is a plant."""
    xy = rng.uniform(0, 300, (9000, 2))
    terrain, truth = 0.25 * xy[:, 0] + 4 * np.sin(xy[:, 1] / 40), rng.random(9000) < 0.1
    cloud = jf.PointCloud.from_arrays(np.column_stack([xy, terrain + np.where(truth, 0, rng.uniform(2, 20, 9000))]))
    ost, smrf = (one.for_cloud(cloud)(cloud) for one in (jf.OST, jf.SMRF))
    assert jf.evaluate(ost, truth).total < 0.2 * jf.evaluate(smrf, truth).total
    assert jf.dtm_rmse(cloud, ost, truth).rmse < 0.4 * jf.dtm_rmse(cloud, smrf, truth).rmse


def test_decks_are_looked_for_where_the_points_show_most_of_the_surface(rng):
    """The trees of a sparse forest leave flanks on both sides of the ground between them."""
    xy = rng.uniform(0, 300, (18_000, 2))
    tree = rng.random(18_000) < 0.8
    cloud = jf.PointCloud.from_arrays(np.column_stack([xy, 0.3 * xy[:, 0] + tree * rng.uniform(2, 20, 18_000)]))
    result = jf.OST.for_cloud(cloud)(cloud)
    assert not result.deck.any() and result.ground[~tree].mean() > 0.95


def overhanging(rng):
    """Rock that rises by 60 degrees from 20 m at x = 20 and overhangs the sea by 6 m; in the north a crown is in the place of the
    overhang, in the south a boulder hangs without a joint. Points, and what they are: rock, overhang, crown,
    boulder, sea, from 0 on."""
    boxes = (((20, 0), (40, 30), 9000), ((14, 10), (20, 20), 900), ((14, 20), (20, 30), 900), ((14, 2), (18, 6), 300))
    rock, hung, crown, boulder = (rng.uniform(*box[:2], (box[2], 2)) for box in boxes)
    sea = rng.uniform((0, 0), (20, 30), (3000, 2))
    z = [20 + 1.73 * (part[:, 0] - 20) + rng.normal(0, 0.1, len(part)) for part in (rock, hung, crown, boulder)]
    z[2] += rng.uniform(-2.5, 2.5, len(crown))
    z[3] += 12
    xyz = np.column_stack([np.concatenate([rock, hung, crown, boulder, sea]), np.concatenate([*z, np.zeros(len(sea))])])
    kind = np.repeat(np.arange(5), [len(part) for part in (rock, hung, crown, boulder, sea)])
    return xyz, kind


def test_an_overhang_is_ground_and_so_is_what_is_beneath(rng, monkeypatch):
    xyz, kind = overhanging(rng)
    before = jf.OST()(xyz).ground
    monkeypatch.setattr(type(RULES["steep"]), "give_back", rock_where(lambda column: column >= 20))
    result = jf.OST()(xyz)
    assert before[kind == 1].mean() < 0.1 and result.ground[kind == 1].mean() > 0.9
    assert result.ground[kind == 4].mean() > 0.95 and result.ground[kind == 2].mean() < 0.2
    assert (result.margin[result.ground] <= 0).all()


def test_along_the_edge_of_the_data_decks_are_looked_for_between_points_only(rng):
    """A gap between two strips: at the border slim triangles join a street with a yard 7 m below, as if it fell there."""
    xy = rng.uniform(0, (60, 90), (5000, 2))
    xy = xy[abs(xy[:, 1] - 40 - 0.4 * xy[:, 0]) > 16]
    south = xy[:, 1] < 40 + 0.4 * xy[:, 0]
    result = jf.OST()(np.column_stack([xy, np.where(south, -7.0, 0.0)]))
    assert result.deck is not None and not result.deck.any()


def test_a_plateau_at_the_edge_of_the_data_is_ground_where_it_is_larger_than_the_largest_building():
    """A level 40 m above a beach, cut by the data on three sides: it falls along its whole inner border."""
    z = np.zeros((80, 80), np.float32)
    z[30:] = 40
    plateau = z > 0
    np.testing.assert_array_equal(objects(z, largest=4001), plateau)
    assert not objects(z, largest=3999).any()
    corner = np.hypot(*np.mgrid[:80, :80]) < 100  # the data end along a circle; nothing beyond is judged
    found = objects(z, inside=corner)
    np.testing.assert_array_equal(found, plateau & corner)


def test_a_roof_of_several_levels_is_an_object():
    """Bands of 8 m on a hall of 40 m, 1 m higher and lower in turn: most of the border of each falls by no more."""
    hall = np.zeros((80, 80), np.float32)
    hall[20:60, 20:60] = 8 + np.arange(40) // 8 % 2
    np.testing.assert_array_equal(objects(hall), hall > 0)
    low = np.where(hall > 0, np.float32(11), 0)
    low[20:60, 33:47] = 8  # between two higher parts it falls at its ends only
    np.testing.assert_array_equal(objects(low), low > 0)
    rock = np.where(hall > 0, hall + np.random.default_rng(0).uniform(-0.8, 0.8, hall.shape), 0).astype(np.float32)
    assert not objects(rock).any()  # a group, but of no segments
    corner = np.roll(hall, (-20, -20), (0, 1))
    np.testing.assert_array_equal(objects(corner), corner > 0)
    low = objects(corner * np.float32(0.4))  # walls of 3 m: the band beside them falls, no other
    np.testing.assert_array_equal(low, (corner > 0) & (np.arange(80) >= 32))


def test_a_hall_that_a_corner_of_the_data_cuts_is_an_object_however_large_it_is():
    """Half of its outline is inside, with walls. A plateau has faces, walls above a void, or less of it inside."""
    (row, column), level = np.mgrid[:80, :80], np.zeros((80, 80), np.float32)
    hall, judged = level.copy(), {"roofs": ROOFS.replace(roof_drop_share=0.53), "largest": 400}
    hall[:50, :40] = 8
    np.testing.assert_array_equal(objects(hall, **judged), hall > 0)
    stairs = hall.copy()
    stairs[50:57, 20] = np.arange(7, 0, -1)  # by which it is in one group with the ground
    assert objects(stairs, **judged)[hall > 0].all()
    assert not objects(hall / 2, **judged).any()  # 4 m high
    assert not objects(hall, seen=column + row < 70, **judged).any()  # a void beside most of it
    face = 8 - 2 * np.clip(np.maximum(row - 49, column - 39), 0, 4).astype(np.float32)
    assert not objects(face, **judged)[face == 8].any()
    wide = level.copy()
    wide[:10] = 8  # as a strip along one edge it is cut by three
    assert not objects(wide, **judged).any()


def test_a_steep_roof_that_a_corner_of_the_data_cuts_is_an_object_and_a_rock_is_none():
    row, column = np.indices((60, 60), np.float32)
    roof = np.where((row < 30) & (column < 30), 30 - 0.6 * (abs(column - 16) + abs(row - 16)), np.float32(0))
    assert not scene_of(roof).segments.number[roof > 0].any()
    np.testing.assert_array_equal(objects(roof), roof > 0)
    rough = np.random.default_rng(0).uniform(-0.6, 0.6, roof.shape)
    rock = np.where(roof > 0, roof + rough, 0).astype(np.float32)
    assert not objects(rock).any()
    assert not objects(np.roll(roof, (20, 20), (0, 1))).any()  # a mound inside the data is left to openings


def test_a_narrow_headland_with_faces_is_ground_and_a_hall_with_walls_is_none():
    """Both are level, 40 m wide and 30 m high, and cut by the data at their ends; the faces are 70 degrees steep."""
    away = abs(np.mgrid[:90, :90][1].astype(np.float32) - 45) - 20
    headland, hall = np.clip(30 - 2.75 * away, 0, 30), np.where(away <= 0, np.float32(30), 0)
    assert not objects(headland)[headland == 30].any()
    np.testing.assert_array_equal(objects(hall), hall > 0)
    few = np.isfinite(away) & (np.arange(90) % 4 == 0)  # where most cells are empty, a face may be a wall
    assert objects(headland, seen=few)[headland == 30].all()


def test_a_gable_roof_and_a_bridge_go_as_a_whole_and_a_terrace_stays():
    row, column = np.mgrid[:60, :60].astype(np.float32)
    level = np.zeros((60, 60), np.float32)
    gable = level.copy()
    gable[20:40, 20:32] = (6 - 0.25 * abs(column - 25.5))[20:40, 20:32]
    np.testing.assert_array_equal(objects(gable), gable > 0)

    deck = level - 6
    deck[27:33] = 0
    np.testing.assert_array_equal(objects(deck), deck == 0)

    rise = np.float32(0.25) * np.clip(column - 10, 0, 24)
    terrace = np.where(row >= 30, level, rise)  # a ramp up to 6 m, with one steep side
    assert not objects(terrace).any()
    roof = gable > 0
    np.testing.assert_array_equal(objects(gable, roofs=ROOFS.replace(roof_drop=99.0), marked=roof), roof)
    few = roof & (row < 28)  # 8 of its 20 rows are marked
    assert not objects(gable, roofs=ROOFS.replace(roof_drop=99.0), marked=few).any()
    assert not objects(gable, roofs=ROOFS.replace(roof_area=500.0), marked=roof).any()
    assert not objects(gable, slope=3.0).any()  # falls that a landscape of 300 % explains


def test_cells_outside_the_hull_are_told(rng, tin_of):
    xy = rng.uniform(0, 40, (200, 2))
    xy = xy[np.hypot(*(xy - 20).T) < 18]
    xyz = points_of(np.column_stack([xy, np.ones(len(xy))]))
    tin = tin_of(xyz)
    cells = cells_of(xyz)
    inside = filled(tin, cells)[1]
    row, column = np.mgrid[: inside.shape[0], : inside.shape[1]]
    x, y = cells.grid.x0, cells.grid.y0
    hull = Delaunay(xyz[:, :2]).find_simplex(np.column_stack([column.ravel() + x + 0.5, row.ravel() + y + 0.5])) >= 0
    np.testing.assert_array_equal(
        inside.ravel(), hull | np.asarray(cells.seen)[: len(inside), : inside.shape[1]].ravel()
    )
    assert 0 < inside.sum() < inside.size


@pytest.mark.parametrize("height", [5.0, 1.9])
def test_a_void_hangs_from_the_lowest_around_its_corners_that_is_2_m_below_them(tin_of, height):
    """Level land with a void 20 m wide, and a roof 5 m high, or a terrace, at its edge."""
    row, column = (a.ravel() + 0.5 for a in np.mgrid[:40, :60])
    roof = (column > 14) & (column < 20) & (row > 15) & (row < 25)
    land = (column < 20) | (column > 40)
    xyz = points_of(np.column_stack([column, row, height * roof])[land])
    cells = cells_of(xyz)
    scene = scene_of(np.zeros((40, 60)), largest=6400)  # the window is 40 m, so that the rim is 8 m
    scene.tin, scene.cells = tin_of(xyz), cells
    void = np.zeros((40, 60), bool)
    void[:, 20:40] = True
    straight = scene.z = filled(scene.tin, cells)[0]
    RULES["voids"].fill(scene)
    hung = scene.z
    np.testing.assert_allclose(hung[void], 0.0 if height > 2 else straight[void], atol=1e-6)
    expected = LinearNDInterpolator(xyz[:, :2], xyz[:, 2])(21.5, 20.5)
    assert straight[20, 21] == pytest.approx(float(expected), abs=0.3) and straight[20, 21] > 0.8 * height
    np.testing.assert_allclose(hung[~void].ravel(), height * roof.reshape(40, 60)[~void], atol=1e-3)


def test_pruning_drops_a_spike_of_a_plane_and_nothing_else(rng):
    xy = rng.uniform(0, 50, (2000, 2)).round(2)
    plane = points_of(np.column_stack([xy, 0.2 * xy[:, 0] + rng.normal(0, 0.02, 2000)]))

    def pruned(ground, spreads):
        scatter = Scatter.from_vertices(ground.tin)
        least = np.maximum(np.float32(spreads * scatter.deviation(ground.tin)), 3 * scatter.roughness)
        return drop_vertices(ground, scatter.residual - least), scatter

    with ground_of(plane, np.arange(len(plane)), HeightRule(0.1, 0.1), 2) as ground:
        before = ground.tin.vertex.sum()
        assert pruned(ground, 12.0)[0] == 0
        assert ground.tin.vertex.sum() == before and ground.ground.all()
    spiked = plane.copy()
    spike = int(np.argmin(((plane[:, :2] - 25) ** 2).sum(axis=1)))
    spiked[spike, 2] += 0.8
    with ground_of(spiked, np.arange(len(plane)), HeightRule(0.1, 0.1), 2) as ground:
        count, scatter = pruned(ground, 12.0)
        assert count == 1
        assert not ground.ground[spike] and ground.ground.sum() == len(plane) - 1
        assert scatter.residual[spike] > 0.6 and not ground.tin.vertex[spike]


@pytest.mark.parametrize("case", ["plants", "in view", "within limits"])
def test_vertices_that_stick_out_are_dropped_where_plants_hide_the_ground(rng, case):
    """Of a field of plants more than half is left out, from above, only where the limits say so. The highest hide from the first
    pass that those beside them stick out, too."""
    xy = rng.uniform(0, 40, (1200, 2)).round(2)
    above = np.column_stack([rng.uniform(0, 40, (6000, 2)).round(2), rng.uniform(8, 12, 6000)])
    plants = np.column_stack([xy, rng.uniform(0, 1.2, 1200)])
    xyz = points_of(np.concatenate([plants, above]))
    low = xyz[:, 2] < xyz[:, 2].min() + 2
    least = 2.0 if case == "within limits" else 0.15
    scene = scene_of(np.zeros((45, 45)), jf.OST(noise=least))
    scene.points, scene.plants, scene.spacing = rows_of(xyz), np.full(len(xyz), case != "in view"), 0.1

    def pruned(passes):
        with ground_of(xyz, np.flatnonzero(low), HeightRule(0.1, 0.1), 2) as ground:
            scatter = Scatter.from_vertices(ground.tin)
            dropped = dataclasses.replace(RULES["plants"], passes=passes).prune(scene, ground, scatter)
            gone = low & ~ground.ground
            assert dropped == gone.sum() and (ground.margin[gone] > 0).all()
            if passes == 1:
                assert (scatter.residual[gone] > np.maximum(scatter.roughness[gone], least)).all()
            return dropped, (xyz[ground.ground, 2] - xyz[:, 2].min()).mean()

    (first, mean), (more, less) = pruned(1), pruned(3)
    if case == "plants":
        assert 200 < first < 500 and first + 100 < more < 900 and less < min(0.5, mean - 0.05)
    else:
        assert first == more == 0


def test_low_roofs_close_together_do_not_pass_for_relief():
    """Nine roofs of 24 x 24 m, 1.5 m high, in lanes of 10 m: with all of them the landscape is steep, without them level."""
    x, y = (v.ravel() + 0.5 for v in np.mgrid[:112, :112])
    roof = (x % 34 > 10) & (y % 34 > 10)
    result = jf.OST()(np.column_stack([x, y, 1.5 * roof]))
    np.testing.assert_array_equal(result.ground, ~roof)


def test_barred_points_join_by_densification_only():
    """The bottom of a bowl, smooth ground, is more than two metres below all but few points within the window."""
    x, y = (v.ravel() / 2 for v in np.mgrid[:61, :61])
    xyz = np.column_stack([x, y, 0.12 * np.minimum(np.hypot(x - 15, y - 15), 8) ** 2])
    seeded, grown = (jf.OST(rounds=rounds, low_points=300)(xyz) for rounds in (0, 6))
    bottom = np.hypot(x - 15, y - 15) < 1
    assert seeded.barred[bottom].all() and not seeded.barred[np.hypot(x - 15, y - 15) > 4.5].any()
    assert seeded.ground.any() and not (seeded.ground & seeded.barred).any() and grown.ground[bottom].all()


def test_outside_the_hull_the_rise_from_its_nearest_place_is_limited(rng):
    """Around a level square; the rule itself would take all points. The distance to a square is known."""
    flat, around = nodes(10, 0.0) + np.float32([15, 15, 0]), rng.uniform(0, 40, (600, 3))
    around[:, 2], around[0, :2] = rng.uniform(-3, 3, 600), 0
    around = around[(np.abs(around[:, :2] - 20) > 4.6).any(axis=1)]
    xyz = points_of(np.concatenate([flat, around]))
    away = np.hypot(*np.maximum(np.abs(xyz[:, :2].astype(np.float64) - 20) - 4.5, 0).T)
    slope = np.where(xyz[:, 0] < 20, np.float32(0.3), np.float32(0.1))
    seeds, none = np.flatnonzero(away == 0), np.zeros(len(xyz), bool)
    assert len(seeds) == len(flat)
    network = one_network(rows_of(xyz), seeds, np.zeros((0, 2)), Outliers(none, none))
    growth = Growth(HeightRule(100.0, 1.0), vertices=Vertices(sinks=False), beyond=Beyond(0.5, slope), kept=("margin",))
    with GroundTin.start(network, growth, workers=1) as ground:
        over = np.abs(xyz[:, 2] - xyz[seeds[0], 2]) - 0.5 - slope * away
        far = over > 0
        assert 100 < far.sum() < len(around) - 100
        np.testing.assert_array_equal(ground.test(), np.setdiff1d(np.flatnonzero(~far), seeds))
        np.testing.assert_allclose(ground.margin[far], over[far], atol=1e-5)


def test_what_the_border_cuts_is_not_climbed():
    """Level land beside a house that the edge of the data cuts: walls and a gable roof lie outside the hull of the seeds. On a
    slope ground outside that hull joins."""
    step = 0.25
    x, y = (v.ravel() * step for v in np.mgrid[:160, :160])
    house = (y > 30) & (x > 8) & (x < 30)
    roof = np.where(house, 5 + 0.6 * (11 - abs(x - 19)), 0.0)
    wall = [(a, 30.0 - 0.05 * (k % 3), 0.4 * k) for a in np.arange(8, 30, 0.5) for k in range(1, 13)]
    xyz = np.concatenate([np.column_stack([x, y, roof]), wall])
    truth = np.append(~house, np.zeros(len(wall), bool))
    ground = jf.OST.for_cloud(xyz)(xyz).ground
    assert not ground[~truth & (xyz[:, 2] > 1)].any() and ground[truth].mean() > 0.99
    slope = np.column_stack([x, y, 0.5 * x + 0.02 * np.sin(37 * x + 11 * y)])
    assert jf.OST.for_cloud(slope)(slope).ground.mean() > 0.99


def test_the_local_spread_counts_per_metre_of_spacing_up_to_one_metre():
    """In filters in which the spacing decides nothing else."""
    cloud = jf.scenes.make("mixed", size=60.0, density=1.5, seed=3).cloud
    plain = jf.OST(tolerance_spacing=0.0, scaling=0.0, distance_relief=0.0, noise=99.0, scene_spread=1.0, rules=())

    def ground(spacing, spread):
        result = plain.replace(spacing=spacing, local_spread=spread)(cloud)
        assert result.info["pruned"] > 0
        return result.ground.tolist()

    assert ground(1.0, 2.0) == ground(3.0, 2.0) == ground(0.5, 4.0) != ground(0.5, 2.0)


def test_points_are_taken_in_by_height_and_by_distance_and_angle():
    """Over a level square: at most a limit high, or so far from its plane and below an angle to the corner."""
    corners = [[0, 0, 0], [20, 0, 0], [0, 20, 0], [20, 20, 0]]
    over = [[10, 3, 0.2], [10, 6, 0.6], [1, 2.5, 0.5], [0.2, 0.2, 0.15], [0, 0, 3]]
    xyz = points_of(np.array(corners + over, float))
    seeds = np.flatnonzero(((xyz[:, 0] % 20 == 0) & (xyz[:, 1] % 20 == 0)) & (xyz[:, 2] == 0))
    full = np.ones(len(xyz), np.float32)
    with ground_of(xyz, seeds, HeightRule(0.3 * full, 1.0)) as ground:
        ground.step()
        assert sorted(xyz[ground.ground, 2].round(2).tolist()) == pytest.approx([0, 0, 0, 0, 0.15, 0.2])
    low = points_of(np.array([*corners, [10, 3, -0.2], [10, 6, -0.6]], float))
    z = low[:, 2] - low[:, 2].max()
    for but, taken in ((z > 0, [-0.2]), (z < -0.1, [])):
        rule = HeightRule(np.full(len(low), 0.3, np.float32), 1.0)
        with ground_of(low, np.flatnonzero(z > -0.1), rule) as ground:
            ground.change(rule, but=but)
            ground.step()
            assert sorted(z[ground.ground].tolist()) == pytest.approx([*taken, 0, 0, 0, 0], abs=1e-3)
    angle = [math.degrees(math.atan2(z, min(math.dist((x, y), c[:2]) for c in corners))) for x, y, z in over]
    for noise in (0.0, 0.1, 0.2):
        with ground_of(xyz, seeds, AngleRule(0.7 * full, 8.0 * full, noise)) as ground:
            grow(ground, 1)
            taken = [z <= 0.7 and (a < 8 or z <= noise) for (_, _, z), a in zip(over, angle, strict=True)]
            expected = sorted(p[2] for p, yes in zip(over, taken, strict=True) if yes)
            assert sorted(xyz[ground.ground & (xyz[:, 2] > 0.1), 2].tolist()) == pytest.approx(expected, abs=1e-3)


def test_points_in_the_plane_of_a_facet_that_stands_upright_do_not_join(rng):
    """Over facets of 45 degrees distance counts from the plane, over those of nearly 90 a tree in their plane is far."""
    for width, joins in ((8.0, True), (1 / 32, False)):
        slope = 8.0 / width
        corners = [[0, 0, 0], [20, 0, 0], [10, width, 8]]
        off = 0.1 * math.hypot(1, slope)  # a tenth of a metre from the plane
        xyz = points_of(np.array([*corners, [10, width / 2, slope * width / 2 + off]]))
        seeds = np.flatnonzero(xyz[:, 1] != width / 2)
        full = np.ones(len(xyz), np.float32)
        with ground_of(xyz, seeds, AngleRule(0.2 * full, 60.0 * full, 0.0)) as ground:
            grow(ground, 1)
            assert ground.ground.all() == joins


def test_no_tree_at_the_border_of_the_data_is_ground():
    scene = jf.scenes.make("forest", size=(160.0, 160.0), density=1.0, seed=4)
    ground = jf.default_filter(scene.cloud)(scene.cloud).ground
    tree = scene.kind == Kind.HIGH_VEGETATION
    x, y = scene.xyz[:, 0] - scene.xyz[:, 0].min(), scene.xyz[:, 1] - scene.xyz[:, 1].min()
    border = np.minimum(np.minimum(x, y), np.minimum(x.max() - x, y.max() - y)) < 1
    assert (tree & border).sum() > 300
    assert (ground & tree & border).sum() <= 0.01 * (tree & border).sum()


@pytest.mark.parametrize("case", ["no seeds left", "few cells", "all low but a line"])
def test_clouds_in_which_too_little_is_left_for_a_triangulation(rng, case):
    if case == "no seeds left":  # a roof alone, cut all around, with a street along one side
        xyz = np.column_stack([rng.uniform(0, 40, (3000, 2)), np.full(3000, 9.0)])
        xyz[xyz[:, 1] < 1, 2] = rng.uniform(0, 0.01, (xyz[:, 1] < 1).sum())
    elif case == "few cells":
        xyz = np.column_stack([rng.uniform(0, 0.4, (500, 2)), rng.normal(0, 0.01, 500)])
    else:
        xyz = np.column_stack([np.arange(60.0), np.zeros(60), rng.normal(0, 0.02, 60)])
        xyz = np.concatenate([xyz, [[30, 0.7, -9.0], [31, 0.7, -9.0]]])
    result = jf.OST()(xyz)
    assert result.ground.any() and np.isfinite(result.height).all()


def test_margins_have_the_sign_of_the_label_and_heights_are_over_the_final_ground():
    """Heights of what is no ground against SciPy's linear interpolation of the ground; dropped vertices have theirs, too."""
    scene = jf.scenes.make("mixed", size=(90.0, 90.0), density=2.0, seed=3)
    result = jf.OST()(scene.cloud)
    assert result.info["pruned"] > 0
    judged = scene.cloud.candidate
    np.testing.assert_array_equal(result.margin[judged] <= 0, result.ground[judged])
    assert np.isfinite(result.margin[judged]).all()
    xyz = scene.cloud.xyz.astype(float)
    ground = xyz[result.ground]
    others = judged & ~result.ground
    above = xyz[others, 2] - LinearNDInterpolator(ground[:, :2], ground[:, 2])(xyz[others, :2])
    inside = np.isfinite(above)
    np.testing.assert_allclose(result.height[others][inside], above[inside], atol=0.01)


def test_the_default_filter_follows_spacing_and_building_size(rng):
    xyz = np.column_stack([rng.uniform(0, 240, (4000, 2)), rng.normal(0, 0.02, 4000)])
    filter_ = jf.default_filter(xyz)
    assert isinstance(filter_, jf.OST) and filter_.spacing == pytest.approx(240 / 4000**0.5, rel=0.15)
    assert filter_.window == jf.OST().window and jf.default_filter(xyz, largest_building=80.0).window == 40
    assert filter_(xyz).ground.mean() > 0.95
    with pytest.raises(jf.ParameterError, match="largest_building=0"):
        jf.default_filter(xyz, largest_building=0)


def test_labels_are_those_of_the_whole_in_the_core_and_points_far_from_it_are_not_tested(town, monkeypatch):
    monkeypatch.setattr(ost, "TESTED", 30.0)  # the town is small
    cloud, filter_ = town.cloud, jf.OST.for_cloud(town.cloud)
    x0, y0 = cloud.coordinates()[:, :2].min(axis=0)
    core = (x0, y0, x0 + 20.0, y0 + 20.0)
    whole, part = filter_(cloud), filter_(dataclasses.replace(cloud, core=core))
    xy = cloud.coordinates()[:, :2]
    beyond = np.maximum(np.maximum(np.array(core[:2]) - xy, xy - core[2:]), 0).max(axis=1)
    assert (part.ground == whole.ground)[beyond == 0].all() and (part.height == whole.height)[beyond == 0].all()
    far = beyond > 30.01
    assert part.ground[far].sum() < 0.9 * whole.ground[far].sum() and part.ground[far].any(), "the lowest points alone"


def test_a_rule_of_ones_own_acts_sweeps_and_is_named_on_the_command_line(rng, monkeypatch, tmp_path):
    """It takes the western half from the ground; the core alone does not."""

    @dataclasses.dataclass(frozen=True)
    class West(OstRule):
        SENSORS = ()
        share: float = 0.5

        def seed(self, scene):
            x = scene.points.xyz[:, 0]
            scene.never = scene.never | (x < self.share * x.max())
            scene.seeds = scene.seeds[~scene.never[scene.seeds]]

    xyz = np.column_stack([rng.uniform(0, 40, (3000, 2)), rng.normal(0, 0.02, 3000)])
    monkeypatch.setitem(RULES, "west", West())
    west, core = jf.OST(rules=["west"]), jf.OST(rules="none")
    assert core.rules == () and west == jf.OST(rules="west") and hash(west.rules) == hash(("west",))
    found = west(xyz).ground
    assert core(xyz).ground.all() and not found[xyz[:, 0] < 19].any() and found[xyz[:, 0] > 21].all()
    swept = jf.sweep(jf.OST(), xyz, {"rules": ["none", ("west",), ("west", "voids")]})
    assert swept.ground.values.tolist() == [3000, found.sum(), found.sum()]
    assert swept.rules.values.tolist() == ["none", "west", "west+voids"]
    cloud = jf.PointCloud.from_arrays(xyz)
    jf.write(tmp_path / "in.las", cloud, np.zeros(3000, bool))
    given = [str(tmp_path / name) for name in ("in.las", "out.las")]
    answer = CliRunner().invoke(main, ["ground", "ost", *given, "--rules", "west", "--units", "m"])
    assert answer.exit_code == 0, answer.output
    assert (jf.read(tmp_path / "out.las", units="m").reference == found).all()
    with pytest.raises(jf.ParameterError, match="'east' is none of 'clusters'"):
        jf.OST(rules=("east",))
