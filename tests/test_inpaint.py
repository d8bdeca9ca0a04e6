import jax
import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from jaxfilter.engines.grid.inpaint import fill_membrane, fill_nearest

SIZE = 150


def direct(z, known):
    """The membrane by a sparse direct solver in double precision."""
    rows, columns = z.shape
    number = np.arange(z.size).reshape(z.shape)
    beside = (number[:, :-1], number[:, 1:]), (number[:-1], number[1:])
    pairs = np.concatenate([np.stack([one.ravel(), other.ravel()], 1) for one, other in beside])
    ends = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(z.size, z.size))
    graph = sparse.csgraph.laplacian(ends + ends.T).tocsr()
    hole, fixed = ~known.ravel(), known.ravel()
    out = z.astype(float).ravel().copy()
    out[hole] = spsolve(graph[hole][:, hole].tocsc(), -graph[hole][:, fixed] @ out[fixed])
    return out.reshape(rows, columns)


def terrain(kind, seed=0):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:SIZE, :SIZE]
    z = 40 * np.sin(x / 31) * np.cos(y / 23) + 0.1 * x + rng.normal(0, 0.2, x.shape) + 300
    known = rng.random(z.shape) > 0.4
    if kind == "lake":
        known &= np.hypot(x - 80, y - 70) > 45
    if kind == "shore":
        known &= x + y < 170
    if kind == "few":
        known[:] = False
        known[3, 5] = known[90, 140] = known[147, 2] = True
    return z.astype(np.float32), known


def padded(z, known, size=256):
    out = np.full((size, size), 77, np.float32), np.zeros((size, size), bool), np.zeros((size, size), bool)
    for array, values in zip(out, (z, known, True), strict=True):
        array[:SIZE, :SIZE] = values
    return out


@pytest.mark.parametrize("kind", ["dots", "lake", "shore", "few"])
def test_membrane_equals_the_direct_solution(kind):
    z, known = terrain(kind)
    filled = fill_membrane(*padded(np.where(known, z, 1e4), known), tolerance=1e-3)
    np.testing.assert_allclose(np.asarray(filled.z)[:SIZE, :SIZE], direct(z, known), atol=4e-3, rtol=0)
    assert filled.error <= 1e-3 and filled.rounds < 40
    assert np.asarray(filled.z)[SIZE:].max() == 0
    np.testing.assert_array_equal(np.asarray(filled.z)[:SIZE, :SIZE][known], z[known])


def test_nothing_to_fill():
    z, known = terrain("dots")
    all_known = np.ones_like(known)
    np.testing.assert_array_equal(fill_membrane(z, all_known, all_known).z, z)
    assert np.isfinite(fill_membrane(z, ~all_known, all_known).z).all()
    np.testing.assert_array_equal(fill_nearest(z, ~all_known, all_known), z)


def test_nearest_fill_of_many_blocks_settles_ties_as_it_says(rng):
    known = rng.random((70, 300)) < 0.004
    z = np.arange(known.size, dtype=np.float32).reshape(known.shape)
    filled = np.asarray(fill_nearest(z, known, np.ones_like(known)))
    row, column = np.nonzero(known)
    for y, x in rng.integers(0, known.shape, (400, 2)):
        apart, beside = (row - y) ** 2 + (column - x) ** 2, column - x
        first = np.lexsort((row, beside, np.abs(beside), apart))[0]
        assert filled[y, x] == z[row[first], column[first]]


def test_nearest_along_a_corridor_of_fifty_kilometres(rng):
    """Squares of the distance to what is in no column do not overflow."""
    known = rng.random((4, 50_000)) < 0.5
    known[:, 1000:1010] = False
    z = np.where(known, np.arange(50_000, dtype=np.float32), -1)
    filled = np.asarray(fill_nearest(z, known, np.ones_like(known)))
    assert (np.abs(filled - np.arange(50_000)) < 20).all()


@pytest.mark.parametrize("shape", [(1200, 5), (3, 2000)])
def test_a_membrane_over_a_corridor_takes_no_more_memory_than_its_cells(shape):
    """Held at both ends it is a straight line; the short axis is not padded to the coarsening of the long one."""
    place = np.indices(shape)[int(np.argmax(shape))]
    ramp = (40 * place / place.max()).astype(np.float32)
    known = (place == 0) | (place == place.max())
    arguments = (np.where(known, ramp, 0), known, np.ones(shape, bool), 1e-4)
    np.testing.assert_allclose(fill_membrane(*arguments).z, ramp, atol=0.1)
    memory = fill_membrane.lower(*arguments).compile().memory_analysis()
    assert memory.temp_size_in_bytes < 250 * ramp.size


def test_several_grids_are_filled_where_ranks_must_be_equal(rng):
    """As the soft labels of SMRF do, and their gradient by elevations."""
    known = rng.random((9, 12)) < 0.5
    grids, along = rng.normal(size=(2, 3, 9, 12)).astype(np.float32)

    def filled(z):
        return jax.vmap(lambda one: fill_membrane(one, known, np.ones(known.shape, bool)).z)(z)

    expected = jax.jvp(filled, (grids,), (along,))
    with jax.numpy_rank_promotion("raise"):
        for found, one in zip(jax.jvp(filled, (grids,), (along,)), expected, strict=True):
            np.testing.assert_array_equal(found, one)
