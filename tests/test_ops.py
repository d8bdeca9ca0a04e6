"""The triangulation as arrays against SciPy's, which decides in its own way where four points are on one circle."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull, Delaunay

import jaxfilter as jf

ELSEWHERE = [-1e300, -5.0, -1e-3, np.nan, np.inf, 1e300]


def points(kind, n=1500):
    rng = np.random.default_rng(3)
    xy = {
        "random": lambda: rng.random((n, 2)) * 300,
        "unit square": lambda: rng.random((n, 2)),
        "UTM": lambda: rng.random((n, 2)).round(3) * 2000 + [512_000.25, 5_403_000.5],
        "a corridor": lambda: rng.random((n, 2)) * [900.0, 3.0],
        "large": lambda: rng.random((n, 2)) * 1e150,
        "grid": lambda: np.stack(np.mgrid[:40, :30], axis=-1).reshape(-1, 2) * 0.5,
        "turned grid": lambda: np.stack(np.mgrid[:40, :30], axis=-1).reshape(-1, 2) @ [[0.3, 0.1], [-0.1, 0.3]],
        "duplicates": lambda: rng.integers(0, 25, (n, 2)) * 1.25 - 9,
        "three": lambda: np.array([[5.0, 1.0], [0.0, 0.0], [1.0, 3.0]]),
    }[kind]()
    return np.column_stack([xy, rng.random(len(xy)).round(1)])[rng.permutation(len(xy))]


def turn(u, v):
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


KINDS = ["random", "unit square", "UTM", "a corridor", "large", "grid", "turned grid", "duplicates", "three"]


@pytest.mark.parametrize("kind", KINDS)
def test_triangles_are_those_of_scipy_but_for_ties(kind):
    xyz = points(kind)
    tin, at = jf.ops.delaunay(xyz), (xyz[:, :2] - xyz[:, :2].min(axis=0)) / np.ptp(xyz[:, 0])
    a, b, c = at[tin.triangles].swapaxes(0, 1)
    area = turn(b - a, c - a)
    assert area.min() > -1e-8 and (np.bincount(tin.triangles.ravel(), minlength=len(xyz)) > 0).sum() == len(
        tin.vertices
    )
    mesh = Delaunay(at[tin.vertices])
    assert area.sum() == pytest.approx(2 * ConvexHull(at).volume, rel=1e-6)
    if kind not in ("grid", "turned grid", "duplicates"):
        assert sorted(map(sorted, tin.triangles.tolist())) == sorted(map(sorted, tin.vertices[mesh.simplices].tolist()))
    for t, k in zip(*np.nonzero(tin.neighbours >= 0), strict=True):  # no corner beyond an edge lies in the circle
        (apex,) = set(tin.triangles[tin.neighbours[t, k]].tolist()) - set(tin.triangles[t].tolist())
        assert t in tin.neighbours[tin.neighbours[t, k]] and inside(at[tin.triangles[t]], at[apex]) < 1e-6
    on_hull = {tuple(sorted(np.delete(tin.triangles[t], k).tolist())) for t, k in np.argwhere(tin.neighbours < 0)}
    if kind != "turned grid":
        assert len(on_hull) == (tin.neighbours < 0).sum() and len(tin.triangles) == 2 * len(tin.vertices) - 2 - len(
            on_hull
        )


def inside(corners, p):
    """The in-circle determinant over the fourth power of the distances: positive inside."""
    d = corners - p
    rows = np.column_stack([d, (d**2).sum(axis=1)])
    size = np.abs(d).max()
    return np.linalg.det(rows) / size**4


def test_the_lowest_of_points_at_one_position_is_the_vertex_and_no_order_matters():
    xyz, rng = points("duplicates"), np.random.default_rng(0)
    tin = jf.ops.delaunay(xyz)
    position, spot = np.unique(xyz[:, :2], axis=0, return_inverse=True)
    lowest = [min(np.flatnonzero(spot == s), key=lambda row: (xyz[row, 2], row)) for s in range(len(position))]
    assert tin.vertices.tolist() == sorted(lowest)
    assert tin.merged.tolist() == np.array(lowest)[spot].tolist()
    order = rng.permutation(len(xyz))
    other = jf.ops.delaunay(xyz[order])
    assert (xyz[order][other.triangles] == xyz[tin.triangles]).all() and (other.neighbours == tin.neighbours).all()


@pytest.mark.parametrize("kind", ["random", "UTM", "grid", "duplicates"])
def test_positions_are_in_the_triangles_that_hold_them(kind):
    xyz, rng = points(kind), np.random.default_rng(1)
    tin, low, high = jf.ops.delaunay(xyz), xyz.min(axis=0), xyz.max(axis=0)
    at = rng.uniform(low - 2, high + 2, (4000, 3))
    found, mesh = tin.locate(at), Delaunay(xyz[tin.vertices, :2] - low[:2])
    held = np.flatnonzero(found >= 0)
    assert ((found >= 0) == (mesh.find_simplex(at[:, :2] - low[:2]) >= 0)).all() and 2000 < len(held) < 4000
    a, b, c = xyz[tin.triangles[found[held]], :2].swapaxes(0, 1)
    for one, other in ((a, b), (b, c), (c, a)):
        assert turn(other - one, at[held, :2] - one).min() > -1e-3
    assert (tin.triangles[tin.locate(xyz)] == tin.merged[:, None]).any(axis=1).all()  # those on the hull, too
    far = [[x, y] for x in ELSEWHERE for y in ELSEWHERE]
    assert (jf.ops.delaunay(xyz + [9, 9, 0]).locate(far) == -1).all() and tin.locate(np.zeros((0, 2))).shape == (0,)


def test_normals_point_up_and_stand_on_their_triangles():
    for kind in ("random", "UTM", "turned grid"):
        xyz = points(kind)
        tin = jf.ops.delaunay(xyz)
        a, b, c = xyz[tin.triangles].swapaxes(0, 1)
        np.testing.assert_allclose(np.linalg.norm(tin.normals, axis=1), 1, rtol=1e-12)
        assert (tin.normals[:, 2] > 0).all() and tin.normals is tin.normals
        for edge in (b - a, c - a):
            wide = np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-3
            assert np.abs((edge * tin.normals).sum(axis=1))[wide].max() < 1e-4


LINE = np.column_stack([np.arange(50) * 0.1, np.arange(50) * 0.03, np.arange(50)])


@pytest.mark.parametrize("xyz, words", [
    (np.zeros((0, 3)), "0 points: all lie on one line"), (np.eye(3)[:2], "2 points: .* on one line"),
    (np.zeros((9, 3)), "9 points: .* on one line"), (LINE, "50 points: .* on one line"),
    (LINE + [5e5, 5e6, 0], "50 points: .* on one line"), (LINE * [0, 1, 1], "on one line"),
    (np.where(np.eye(3), np.nan, 1), "3 of 3 points are not finite"), (LINE + [0, 0, np.inf], "50 of 50 points are not finite"),
    (LINE[:, :2], r"shape \(50, 2\)"), (LINE[0], r"shape \(3,\)"), (LINE > 1, "bool"), (LINE.astype(str), "<U"),
])  # fmt: skip
def test_what_cannot_be_triangulated_is_named(xyz, words):
    with pytest.raises(jf.InputError, match=f"^xyz.*{words}"):
        jf.ops.delaunay(xyz)
    with pytest.raises(jf.InputError, match=r"^points is float64 of shape \(3,\): f64\[n, 2\]"):
        jf.ops.delaunay(np.eye(3)).locate([1.0, 2.0, 3.0])
