"""The growing triangulation against SciPy's triangulation of all vertices at once."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.spatial import Delaunay

from jaxfilter.core.cloud import QUANTUM
from jaxfilter.core.points import morton
from jaxfilter.host import tin as tin_module
from jaxfilter.host.tin import Tin, delaunay, perturbed


@pytest.fixture
def pool():
    with ThreadPoolExecutor(2) as executor:
        yield executor


def nodes(rng, n, side, step):
    """Distinct lattice positions (many cocircular), in Morton order, with four corners around them."""
    xy = np.unique(np.rint(rng.uniform(0, side, (n, 2)) / step) * step, axis=0)
    xyz = np.column_stack([xy, rng.uniform(0, 9, len(xy))])
    xyz = (np.rint(xyz / QUANTUM) * QUANTUM).astype(np.float32)
    corners = np.array([[-1, -1, 0], [side + 1, -1, 0], [side + 1, side + 1, 0], [-1, side + 1, 0]], np.float32)
    return np.concatenate([xyz[np.argsort(morton(xyz))], corners + np.float32([0, 0, 1])])


def triples(triangles):
    return {tuple(sorted(t)) for t in triangles.tolist()}


def assert_sound(tin):
    """Same triangles as from scratch, counter-clockwise, mutual neighbours, every other node inside its triangle."""
    for sheet in range(int(tin.sheet[-1]) + 1):
        vertices = np.flatnonzero(tin.vertex & (tin.sheet == sheet))
        mine = tin.triangles[tin.sheet[tin.triangles[:, 0]] == sheet]
        assert triples(mine) == triples(vertices[Delaunay(tin.xy[vertices] - tin.xy[vertices].mean(0)).simplices])
    a, b, c = (tin.xy[tin.triangles[:, k]] for k in range(3))
    u, v = b - a, c - a
    assert (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0).all()
    row, edge = np.nonzero(tin.neighbours >= 0)
    other = tin.neighbours[row, edge]
    assert (tin.neighbours[other] == row[:, None]).any(axis=1).all()
    shared = [len(set(tin.triangles[i]) & set(tin.triangles[j])) for i, j in zip(row[:500], other[:500], strict=True)]
    assert set(shared) == {2}
    free = np.flatnonzero(~tin.vertex)
    corner = tin.xy[tin.triangles[tin.where[free]]] - tin.xy[free][:, None]
    ahead = np.roll(corner, -1, axis=1)
    assert (corner[..., 0] * ahead[..., 1] - corner[..., 1] * ahead[..., 0] > -1e-7).all()


@pytest.mark.parametrize("chunk", [8192, 150])
@pytest.mark.parametrize("step", [0.25, 2.0])
def test_batches_of_insertions_equal_a_triangulation_from_scratch(pool, monkeypatch, chunk, step):
    monkeypatch.setattr(tin_module, "CHUNK", chunk)
    rng = np.random.default_rng(3)
    xyz = nodes(rng, 4000, 60, step)
    k = len(xyz)
    network = Tin(xyz, np.zeros(k, np.int32), np.append(np.arange(0, k - 4, 97), np.arange(k - 4, k)), pool)
    for share in (0.5, 0.3, 0.02, 0.5):
        free = np.flatnonzero(~network.vertex)
        before = triples(network.triangles)
        rows = network.triangles.copy()
        changed = network.insert(free[rng.random(len(free)) < share])
        assert triples(network.triangles[changed]).isdisjoint(before)
        assert (network.triangles[: len(rows)][~changed[: len(rows)]] == rows[~changed[: len(rows)]]).all()
        assert_sound(network)
    assert network.rebuilt == 0


@pytest.mark.parametrize("chunk", [8192, 60])
@pytest.mark.parametrize("step", [0.25, 2.0])
def test_vertices_can_be_taken_out_again(pool, monkeypatch, chunk, step):
    for name in ("CHUNK", "_SMALLEST_CHUNK"):
        monkeypatch.setattr(tin_module, name, chunk)
    rng = np.random.default_rng(13)
    xyz = nodes(rng, 4000, 60, step)
    k = len(xyz)
    network = Tin(xyz, np.zeros(k, np.int32), np.append(np.arange(0, k - 4, 2), np.arange(k - 4, k)), pool)
    for share in (0.02, 0.4, 0.8, 1.0):
        inner = np.flatnonzero(network.vertex[: k - 4])
        rows, before = network.triangles.copy(), triples(network.triangles)
        out = inner[rng.random(len(inner)) < share]
        changed = network.remove(out)
        assert not network.vertex[out].any() and network.vertex.sum() == len(inner) - len(out) + 4
        n = len(changed)
        assert (network.triangles[~changed] == rows[:n][~changed]).all()
        assert triples(network.triangles) - before <= triples(network.triangles[changed])
        assert_sound(network)
        network.insert(np.flatnonzero(~network.vertex)[::3])
        assert_sound(network)
    assert network.rebuilt == 0


def test_sheets_do_not_touch_and_equal_single_runs(pool):
    rng = np.random.default_rng(5)
    one, two = nodes(rng, 800, 30, 0.5), nodes(rng, 1200, 40, 0.5)
    xyz = np.concatenate([one, two])
    sheet = np.repeat(np.int32([0, 1]), [len(one), len(two)])
    start = np.concatenate([np.arange(len(one) - 4, len(one)), np.arange(len(xyz) - 4, len(xyz))])
    both = Tin(xyz, sheet, start, pool)
    both.insert(np.flatnonzero(~both.vertex)[::2])
    assert_sound(both)
    assert (sheet[both.triangles] == sheet[both.triangles[:, :1]]).all()


def test_many_seeds_are_triangulated_from_a_sparse_root(pool):
    xyz = nodes(np.random.default_rng(7), 30000, 200, 0.25)
    network = Tin(xyz, np.zeros(len(xyz), np.int32), np.arange(len(xyz)), pool)
    assert network.vertex.all()
    assert_sound(network)


def test_a_failed_patch_is_repaired_by_a_rebuild(pool, monkeypatch):
    xyz = nodes(np.random.default_rng(9), 1000, 30, 0.5)
    k = len(xyz)
    network = Tin(xyz, np.zeros(k, np.int32), np.append(np.arange(0, k - 4, 50), np.arange(k - 4, k)), pool)
    monkeypatch.setattr(Tin, "_stitch", lambda *_: None)
    network.insert(np.flatnonzero(~network.vertex)[::3])
    assert network.rebuilt == 1
    assert_sound(network)


def test_walk_finds_the_triangle_that_scipy_finds(pool):
    rng = np.random.default_rng(11)
    xyz = nodes(rng, 3000, 50, 0.25)
    network = Tin(xyz, np.zeros(len(xyz), np.int32), np.arange(len(xyz)), pool)
    queries = rng.uniform(0, 50, (2000, 2))
    queries[-1] = (500.0, 500.0)
    found = network.walk(queries, np.zeros(2000, np.int32), np.zeros(2000, np.int32))
    reference = Delaunay(network.xy)
    expected = reference.simplices[reference.find_simplex(queries[:-1])]
    assert (np.sort(network.triangles[found[:-1]], axis=1) == np.sort(expected, axis=1)).all()
    assert found[-1] == -1


def test_perturbation_depends_on_the_position_only_and_stays_within_half_a_quantum():
    xyz = nodes(np.random.default_rng(1), 2000, 30, 0.25)
    moved = perturbed(xyz)
    order = np.random.default_rng(2).permutation(len(xyz))
    assert (perturbed(xyz[order]) == moved[order]).all()
    assert np.abs(moved - xyz[:, :2]).max() <= QUANTUM / 2
    assert len(np.unique(moved - xyz[:, :2], axis=0)) > 0.99 * len(xyz)


def test_the_location_table_equals_scipys():
    rng = np.random.default_rng(4)
    xy = rng.uniform(1000, 1100, (500, 2))
    mesh = delaunay(xy)
    local = xy - xy.mean(axis=0)
    np.testing.assert_allclose(mesh.transform, Delaunay(local).transform, rtol=1e-6, atol=1e-9)


def test_triangles_around_vertices_are_found_on_the_hull_and_inside(pool):
    rng = np.random.default_rng(13)
    xyz = nodes(rng, 2000, 40, 0.25)
    k = len(xyz)
    network = Tin(xyz, np.zeros(k, np.int32), np.append(np.arange(0, k - 4, 31), np.arange(k - 4, k)), pool)
    network.insert(np.flatnonzero(~network.vertex)[::2])
    vertices = np.append(rng.choice(np.flatnonzero(network.vertex), 40, replace=False), np.arange(k - 4, k))
    expected = np.flatnonzero(np.isin(network.triangles, vertices).any(axis=1))
    assert (network.around(vertices) == expected).all()
    own = network.triangle_of_vertices()
    assert (network.triangles[own[vertices]] == vertices[:, None]).any(axis=1).all()


def test_one_of_the_triangles_at_a_vertex_is_first_in_any_history(pool, rng):
    xyz = nodes(rng, 900, 40, 0.5)
    all_nodes, corners = np.arange(len(xyz)), np.arange(len(xyz) - 4, len(xyz))
    sheet = np.zeros(len(xyz), np.int32)
    whole = Tin(xyz, sheet, all_nodes, pool)
    grown = Tin(xyz, sheet, corners, pool)
    for part in np.array_split(rng.permutation(len(xyz) - 4), 3):
        grown.insert(np.sort(part))
    found = [np.sort(tin.triangles[tin.first_around(all_nodes)], axis=1) for tin in (whole, grown)]
    assert np.array_equal(*found)
    for v in all_nodes[::37]:
        at = np.sort(whole.triangles[(whole.triangles == v).any(axis=1)], axis=1).tolist()
        assert found[0][v].tolist() == min(at)
    marked = rng.random(len(whole)) < 0.05
    expected = [bool(marked[(whole.triangles == v).any(axis=1)].any()) for v in all_nodes]
    assert whole.any_around(all_nodes, marked).tolist() == expected
