"""The growing triangulation against the one made anew of all its vertices, in any order, batches, history and threads."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay
from triangulation import Mesh, in_circle, power, triangulation, turn

from jaxfilter.core.cloud import QUANTUM
from jaxfilter.core.errors import InputError
from jaxfilter.core.points import morton
from jaxfilter.engines.tin import flips, predicates
from jaxfilter.engines.tin import triangulation as tin_module
from jaxfilter.engines.tin.triangulation import Tin, triangulated

FAR = 2**26
"""Half of the largest distance along an axis that is tried, in quanta."""


@pytest.fixture(scope="module")
def pool():
    with ThreadPoolExecutor(3) as executor:
        yield executor


def random(rng, n):
    """No four on a circle, nearly surely."""
    return rng.integers(0, 2**17, (n, 2))


def grid(rng, n):
    """Many of them on every circle."""
    return rng.integers(0, 8, (n, 2)) * rng.choice([1, 2, 1024])


def circles(rng, n):
    """Lattice positions on circles around one centre, corners of squares among them, and the centre."""
    x, y = (v.ravel() for v in np.meshgrid(np.arange(-65, 66), np.arange(-65, 66)))
    on = np.isin(x * x + y * y, rng.choice([25, 50, 325, 425, 625, 1105, 4225], 3))
    return np.append(rng.permutation(np.column_stack([x, y])[on])[:n], [[0, 0]], axis=0) * rng.choice([1, 7, 2**18])


def lines(rng, n):
    """Runs of positions along a few lines, some of them parallel, all of them crossing or touching others."""
    step = np.array([[1, 0], [0, 1], [1, 1], [2, 1], [-1, 3]]) * 16
    return step[rng.integers(0, 5, n)] * rng.integers(-n // 3, n // 3, n)[:, None] + rng.choice([0, 0, 48], (n, 1))


def clusters(rng, n):
    """Positions a few quanta apart, kilometres from the next ones."""
    return rng.integers(-2, 3, (4, 2))[rng.integers(0, 4, n)] * 2**20 + rng.integers(-2, 3, (n, 2))


def far(rng, n):
    """A crowd within a few millimetres, and others as far away as is allowed."""
    crowd, others = rng.integers(-3, 4, (n, 2)), rng.integers(-8, 9, (n // 6, 2)) * (FAR // 8)
    return np.concatenate([crowd, others, [[-FAR, -FAR], [FAR, FAR], [FAR, -FAR]]])


KINDS = [random, grid, circles, lines, clusters, far]


def nodes(rng, xy, twins=True):
    """f32[k, 3]: nodes at these positions i64[n, 2], one at each and some again, shuffled."""
    xy = np.unique(xy, axis=0)
    xy = np.concatenate([xy, xy[rng.random(len(xy)) < 0.3 * twins]])
    out = np.column_stack([xy * QUANTUM, rng.uniform(0, 9, len(xy))]).astype(np.float32)
    assert (np.rint(out[:, :2].astype(float) / QUANTUM) == xy).all()
    return out[rng.permutation(len(out))]


def single(xy, chosen):
    """Of ascending nodes the first at each position i32[k, 2]."""
    return np.sort(chosen[np.unique(xy[chosen], axis=0, return_index=True)[1]])


def has_area(xy):
    """Whether positions i32[k, 2] are not on a line."""
    if len(xy) < 3:
        return False
    x, y = (xy - xy[0]).astype(np.int64).T
    most = np.argmax(x * x + y * y)
    return bool((x * y[most] != y * x[most]).any())


def assert_canonical(tin):
    """Each sheet has the triangles of the reference, all tables say the same, and so does the count."""
    triangles, neighbours = tin.facets()
    of = tin.sheet[triangles[:, 0]]
    first = 0
    for sheet in range(int(tin.sheet[-1]) + 1):
        vertices = np.flatnonzero(tin.vertex & (tin.sheet == sheet))
        mesh = Mesh(tin.xy[vertices])
        assert np.array_equal(triangles[of == sheet], vertices[mesh.triangles])
        assert np.array_equal(neighbours[of == sheet], np.where(mesh.neighbours < 0, -1, mesh.neighbours + first))
        hull = int((mesh.neighbours < 0).sum())
        assert len(mesh.triangles) == 2 * len(vertices) - 2 - hull  # Euler
        first += len(mesh.triangles)
    assert len(tin) == first
    vertices = np.flatnonzero(tin.vertex)
    assert (tin.triangles[tin.where[vertices]] == vertices[:, None]).any(axis=1).all()


def assert_located(tin, chosen):
    """Each node is in its triangle, or outside the hull in sight of an edge, after a step of (e, e^2)."""
    corner = tin.triangles[tin.where[chosen]]
    assert (tin.sheet[np.maximum(corner, corner.max(axis=1)[:, None])] == tin.sheet[chosen][:, None]).all()
    for k in range(3):
        a, b = corner[:, k], corner[:, (k + 1) % 3]
        for node, i, j in zip(*(v[(a >= 0) & (b >= 0)].tolist() for v in (chosen, a, b)), strict=True):
            p, q, r = (tuple(tin.xy[v].tolist()) for v in (i, j, node))
            assert (turn(p, q, r), p[1] - q[1], q[0] - p[0]) > (0, 0, 0)  # the terms of 1, e and e^2


def assert_empty_circles(xy, triangles):
    """No circle has a position in it, the triangles cover the hull, and that is convex."""
    p = [tuple(q) for q in xy.tolist()]
    assert all(power(p[a], p[b], p[c], q) <= 0 for a, b, c in triangles.tolist() for q in p)
    areas = [turn(p[a], p[b], p[c]) for a, b, c in triangles.tolist()]
    assert min(areas) > 0
    edges = {(t[k], t[k - 2]) for t in triangles.tolist() for k in range(3)}
    rim = [(a, b) for a, b in edges if (b, a) not in edges]
    assert all(turn(p[a], p[b], q) >= 0 for a, b in rim for q in p)
    assert sum(areas) == sum(p[a][0] * p[b][1] - p[b][0] * p[a][1] for a, b in rim)


def inner(tin):
    """i64[v]: vertices that are not on the hull of their sheet."""
    triangles, neighbours = tin.facets()
    row, k = np.nonzero(neighbours < 0)
    rim = np.append(triangles[row, (k + 1) % 3], triangles[row, (k + 2) % 3])
    return np.setdiff1d(np.flatnonzero(tin.vertex), rim)


def stamped(tin, change, *arguments):
    """Do something in a round of its own: what keeps its corners is not stamped, and nothing else."""
    before, kinds = tin.triangles.copy(), {tuple(t) for t in tin.facets()[0].tolist()}
    tin.now += 1
    out = change(*arguments)
    same = tin.stamp[: len(before)] != tin.now
    assert np.array_equal(tin.triangles[: len(before)][same], before[same])
    new = tin.triangles[(tin.stamp == tin.now) & (tin.triangles >= 0).all(axis=1)]
    new = np.take_along_axis(new, (new.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    assert kinds.isdisjoint(map(tuple, new.tolist()))
    return out


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@settings(max_examples=40, deadline=None, derandomize=True, database=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.integers(20, 70),
    rounds=st.integers(1, 3),
    chunk=st.sampled_from([65536, 5]),
    most=st.sampled_from([10_000_000, 0, 3]),
    workers=st.sampled_from([1, 3]),
)
def test_any_history_has_the_triangulation_of_its_vertices(kind, pool, seed, size, rounds, chunk, most, workers):
    rng = np.random.default_rng(seed)
    xyz = nodes(rng, kind(rng, size))
    xy, sheet = tin_module.lattice(xyz), np.zeros(len(xyz), np.int32)
    every = single(xy, np.arange(len(xyz)))
    if not has_area(xy[every]):
        return
    start = single(xy, np.sort(rng.permutation(len(xyz))[: rng.integers(3, size)]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tin_module, "NODES_AT_ONCE", chunk)
        patch.setattr(tin_module, "_MADE", most)
        tin = Tin(xyz, sheet, start if has_area(xy[start]) else every, pool, workers)
        assert_canonical(tin)
        for _ in range(rounds):
            assert_located(tin, np.flatnonzero(~tin.vertex))
            free = np.flatnonzero(~tin.vertex)
            free = free[tin.twins(free) < 0]
            stamped(tin, tin.insert, single(xy, free[rng.random(len(free)) < 0.5]))
            assert_canonical(tin)
            out = inner(tin)
            stamped(tin, tin.remove, out[rng.random(len(out)) < 0.6])
            assert_canonical(tin)
            tin.locate(np.flatnonzero(~tin.vertex))
        free = np.flatnonzero(~tin.vertex)
        stamped(tin, tin.insert, single(xy, free[tin.twins(free) < 0]))
        assert_canonical(tin)
    order = rng.permutation(len(xyz))
    other = Tin(xyz[order], sheet, single(xy[order], np.arange(len(order))), pool)
    assert positions(other) == positions(tin)
    assert_empty_circles(xy, tin.facets()[0])
    if kind is random:
        mesh = Delaunay(xy[every] - xy[every].mean(axis=0))
        assert positions(tin) == {tuple(sorted(map(tuple, xy[every[t]].tolist()))) for t in mesh.simplices}


def positions(tin):
    """The triangles by the positions of their corners, whatever the numbers of the nodes."""
    return {tuple(sorted(map(tuple, t))) for t in tin.xy[tin.facets()[0]].tolist()}


def test_large_networks_have_the_triangulation_of_scipy_or_of_the_reference(pool, rng):
    for xy, unique in ((random(rng, 30000), True), (rng.integers(0, 60, (9000, 2)) * 256, False)):
        xyz = nodes(rng, xy, twins=False)
        xyz = xyz[np.argsort(morton(xyz))]
        tin = Tin(xyz, np.zeros(len(xyz), np.int32), np.arange(len(xyz)), pool)
        assert tin.vertex.all() and len(tin) == len(tin.facets()[0])
        if unique:
            mesh = Delaunay(tin.xy - tin.xy.mean(axis=0))
            assert {tuple(sorted(t)) for t in tin.facets()[0].tolist()} == {
                tuple(sorted(t)) for t in mesh.simplices.tolist()
            }
        else:
            assert np.array_equal(tin.facets()[0], triangulation(tin.xy))


@pytest.mark.parametrize("kind", [random, grid, circles, clusters], ids=lambda kind: kind.__name__)
def test_the_nearest_vertex_is_that_of_all_pairs(pool, rng, kind):
    """Also if more are nearer that do not count than are asked one by one."""
    parts = [nodes(rng, kind(rng, 400), twins=False) for _ in range(2)]
    sheet = np.repeat(np.int32([0, 1]), [len(part) for part in parts])
    tin = Tin(np.concatenate(parts), sheet, np.arange(len(sheet)), pool)
    tin.remove(inner(tin)[::3])
    vertices, xy = np.flatnonzero(tin.vertex), tin.xy.astype(np.int64)
    for share in (1.0, 0.2, 0.01, 0.0):
        counts = rng.random(len(sheet)) < share
        expected = []
        for v in vertices:
            others = vertices[counts[vertices] & (vertices != v) & (sheet[vertices] == sheet[v])]
            square = ((xy[others] - xy[v]) ** 2).sum(axis=1)
            expected.append(others[np.lexsort([*xy[others].T[::-1], square])[0]] if len(others) else -1)
        assert tin.nearest(vertices, counts).tolist() == expected


def test_nodes_outside_the_hull_belong_to_its_nearest_edge_whatever_the_history(pool, rng):
    xyz = nodes(rng, random(rng, 900), twins=False)
    sheet, vertices = np.zeros(len(xyz), np.int32), np.flatnonzero(np.abs(xyz[:, :2] - 64).max(axis=1) < 35)
    tin, other = Tin(xyz, sheet, vertices, pool), Tin(xyz, sheet, vertices[::9], pool, 3)
    other.insert(np.setdiff1d(vertices, vertices[::9]))
    other.locate(rng.permutation(np.flatnonzero(~other.vertex)))
    outside = np.flatnonzero(tin.triangles[tin.where].min(axis=1) < 0)
    assert len(outside) > 300
    rest = np.flatnonzero(~tin.vertex)
    np.testing.assert_array_equal(np.sort(tin.triangles[tin.where[rest]]), np.sort(other.triangles[other.where[rest]]))

    def distance(p, edges):
        a, b = tin.xy[edges[..., 0]].astype(float), tin.xy[edges[..., 1]].astype(float)
        along = np.clip(((p - a) * (b - a)).sum(axis=-1) / ((b - a) ** 2).sum(axis=-1), 0, 1)[..., None]
        return np.linalg.norm(p - a - along * (b - a), axis=-1)

    hull = np.sort(tin.triangles[(tin.triangles == -1).any(axis=1)], axis=1)[:, 1:]
    own = np.sort(tin.triangles[tin.where[outside]], axis=1)[:, 1:]
    at = tin.xy[outside].astype(float)
    np.testing.assert_allclose(distance(at, own), distance(at[:, None], hull[None]).min(axis=1))


def corners_and_more(*more):
    """A square of 9 m with its middle, the middle of its lower side, and further positions in metres."""
    xy = np.array([[0, 0], [9, 0], [9, 9], [0, 9], [4.5, 0], [4.5, 4.5], *more])
    return np.column_stack([xy, np.zeros(len(xy))]).astype(np.float32)


@pytest.mark.parametrize("again", range(6))
def test_a_position_that_is_taken_is_an_error(pool, again):
    xyz = corners_and_more()
    xyz = np.concatenate([xyz, xyz[[again]]])
    tin = Tin(xyz, np.zeros(7, np.int32), np.arange(6), pool)
    assert tin.twins(np.array([6])).tolist() == [again]
    with pytest.raises(ValueError, match="node 6 is at the position of a vertex"):
        tin.insert(np.array([6]))


@pytest.mark.parametrize("vertex", range(5))
def test_a_vertex_of_the_hull_cannot_be_taken_out(pool, vertex):
    tin = Tin(corners_and_more([3.0, 4.0]), np.zeros(7, np.int32), np.arange(6), pool)
    with pytest.raises(ValueError, match=f"node {vertex} is on the hull"):
        tin.remove(np.array([vertex]))
    tin.remove(np.array([5]))
    assert_canonical(tin)


def test_spans_for_which_the_circle_test_is_not_proven_are_refused(pool):
    Tin(corners_and_more([0.0, 139_000.0]), np.zeros(7, np.int32), np.arange(7), pool)
    for more in ([0.0, 141_000.0], [-141_000.0, 0.0]):
        with pytest.raises(ValueError, match="140 km apart"):
            Tin(corners_and_more(more), np.zeros(7, np.int32), np.arange(7), pool)


def quadruples(rng):
    """Positions up to 2^27 apart: anywhere, on a circle, next to one, and three close together with one far away."""
    unit = [(x, y) for x in range(-65, 66) for y in range(-65, 66) if x * x + y * y == 4225]
    for _ in range(1500):
        yield rng.integers(-FAR, FAR + 1, (4, 2))
        yield np.append(
            rng.integers(0, 2 ** rng.integers(1, 12), (3, 2)) - FAR, [[FAR, FAR - rng.integers(2**20)]], axis=0
        )
        width, height = rng.integers(1, 2 * FAR, 2)
        box = rng.permutation([(0, 0), (width, 0), (0, height), (width, height)]) - FAR
        for tied in (rng.permutation(unit)[:4] * rng.integers(1, FAR // 65), box):
            yield tied
            yield np.append(tied[:3], np.clip(tied[3:] + rng.integers(-1, 2, 2), -FAR, FAR), axis=0)


def test_the_circle_test_equals_that_in_integers_of_any_size(rng):
    ties = 0
    for four in quadruples(rng):
        a, b, c, p = map(tuple, four.tolist())
        if turn(a, b, c) == 0 or p in (a, b, c):
            continue
        b, c = (b, c) if turn(a, b, c) > 0 else (c, b)
        ties += power(a, b, c, p) == 0
        assert predicates.in_circle(*a, *b, *c, *p) == in_circle(a, b, c, p), (a, b, c, p)
    assert ties > 2500


def crowd(rng):
    """10^4 positions within a decimetre, and four as far away as is allowed."""
    return np.concatenate(
        [np.indices((100, 100)).reshape(2, -1).T, [[-FAR, -FAR], [FAR, -FAR], [FAR, FAR], [-FAR, FAR]]]
    )


def two_lines(rng):
    """Two parallel lines of 20,000 positions, a kilometre apart."""
    along = np.arange(20_000) * 64
    return np.concatenate(
        [np.column_stack([along, np.zeros(20_000, int)]), np.column_stack([along, np.full(20_000, 2**20)])]
    )


def hub(rng):
    """10^4 positions as near to a circle of 100 km as the lattice lets them, and its centre."""
    angle = rng.uniform(0, 2 * np.pi, 10_000)
    return np.concatenate([np.rint(5e7 * np.column_stack([np.cos(angle), np.sin(angle)])).astype(int) & ~7, [[0, 0]]])


@pytest.mark.parametrize("kind", [crowd, two_lines, hub], ids=lambda kind: kind.__name__)
def test_bad_inputs_make_few_triangles(kind, pool, rng, monkeypatch):
    xyz = nodes(rng, kind(rng), twins=False)
    xyz = xyz[np.argsort(morton(xyz - xyz.min(axis=0)))]
    k = len(xyz)
    small = Tin(corners_and_more(), np.zeros(6, np.int32), np.arange(5), pool)  # compiles what is not yet
    small.locate(np.array([5]))
    small.insert(np.array([5]))
    small.remove(np.array([5]))
    calls, insert = [], flips.insert
    monkeypatch.setattr(flips, "insert", lambda *given: calls.append(len(given[7]) - given[13]) or insert(*given))
    monkeypatch.setattr(tin_module, "_MADE", 10_000)
    tin = Tin(xyz, np.zeros(k, np.int32), np.arange(k), pool)
    triangles = tin.facets()[0]
    far = np.argsort(np.abs(tin.xy).sum(axis=1))
    grown = Tin(xyz, np.zeros(k, np.int32), np.sort(far[[0, 1, 2, 3, *range(-8, 0)]]), pool)
    grown.insert(np.flatnonzero(~grown.vertex))
    assert np.array_equal(grown.facets()[0], triangles)
    out = inner(tin)
    tin.now += 1
    tin.remove(out)
    tin.locate(out)
    tin.insert(out)
    assert np.array_equal(tin.facets()[0], triangles)
    assert len(calls) < 200, (
        "a call makes 10,000 triangles: those are 50 for a node, and nodes squared would be 160,000 calls"
    )


ON_A_LINE = [
    [[3.0, 4.0]],
    [[0.0, 0.0], [1.0, 1.0]],
    [[2.0, 2.0]] * 5,
    [[1.0, y] for y in range(5)],
    [[65000.0 + x, 32000.0 - x] for x in range(40)],
    [[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [2.0, 0.0]],
]
SQUARE = np.array([[0, 0, 1], [4, 0, 2], [4, 4, 3], [0, 4, 5]], np.float32)


@pytest.mark.parametrize(
    "xyz, words",
    [
        (SQUARE[:0], "shape"),
        (SQUARE[:, :2], "shape"),
        (SQUARE.ravel(), "shape"),
        (SQUARE.astype(int), "int64"),
        (SQUARE.astype(object), "object"),
        (SQUARE.tolist() + [[1]], "array"),
        (np.where(SQUARE == 5, np.nan, SQUARE), "NaN"),
        (np.where(SQUARE == 4, np.nan, SQUARE), "NaN"),
        (np.where(SQUARE == 4, np.inf, SQUARE), "4 points.*2097 km"),
        (np.where(SQUARE == 4, 1e30, SQUARE), "4 points.*2097 km"),
        (np.where(SQUARE == 4, 2e5, SQUARE), "4 points.*140 km"),
        (
            np.concatenate([SQUARE, SQUARE[1:2] + [[0, 0, 9]]]),
            "5 points: node 4 is at the position of a vertex: give each",
        ),
        (np.concatenate([SQUARE, SQUARE[1:2] + 1e-5]), "5 points: node 4 is at the position of a vertex"),
        *((np.pad(np.float32(xy), ((0, 0), (0, 1))), f"{len(xy)} points: they are on one line") for xy in ON_A_LINE),
    ],
)
def test_what_cannot_be_triangulated_is_refused_by_name(xyz, words):
    with pytest.raises(InputError, match=rf"^xyz\b.*{words}"):
        triangulated(xyz)


@pytest.mark.parametrize(
    "xyz", [SQUARE, SQUARE.astype(float), SQUARE.tolist(), SQUARE + [[65000, 65000, 0]], SQUARE[:3]]
)
def test_few_points_that_are_not_on_a_line_have_the_triangles_of_scipy(xyz):
    corners = triangulated(xyz).facets()[0]
    assert len(corners) == len(Delaunay(np.array(xyz)[:, :2]).simplices)
    assert set(corners.ravel()) == set(range(len(xyz)))
