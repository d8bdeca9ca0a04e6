import numpy as np
import pytest
from scipy import ndimage

from jaxfilter.engines.grid.cells import block_counts, block_minima, cell_index, inside, padded_length, padded_shape
from jaxfilter.engines.grid.extremes import highest, lowest


def test_cell_index_counts_from_the_corner_and_clips_to_the_extent():
    xy = np.array([[0, 0], [1.99, 0], [2, 0], [5, 3.9], [-9, 99], [99, -9]], np.float32)
    index = cell_index(xy, np.float32([0, 0]), np.float32(2), np.int32([2, 3]), 128)
    np.testing.assert_array_equal(index, [0, 0, 1, 128 + 2, 128, 2])


def test_block_minima_equal_a_loop_and_ties_go_to_the_lowest_index():
    rng = np.random.default_rng(0)
    index = rng.integers(0, 40, 500).astype(np.int32)
    index[index == 7] = 8
    z = rng.integers(0, 5, 500).astype(np.float32)
    z[::9] = np.inf  # padding
    lowest, first = map(np.asarray, block_minima(index, z, 40))
    for cell in range(40):
        rows = np.flatnonzero((index == cell) & np.isfinite(z))
        if len(rows):
            assert lowest[cell] == z[rows].min() and first[cell] == rows[np.argmin(z[rows])]
        else:
            assert lowest[cell] == np.inf and first[cell] == 500
    assert np.isinf(lowest[7])


def test_a_cell_with_padding_only_is_empty():
    lowest, first = block_minima(np.zeros(3, np.int32), np.full(3, np.inf, np.float32), 2)
    assert np.isinf(lowest).all() and (np.asarray(first) == 3).all()


def test_block_counts_equal_bincount():
    rng = np.random.default_rng(1)
    index, counted = rng.integers(0, 30, 400).astype(np.int32), rng.random(400) < 0.7
    np.testing.assert_array_equal(block_counts(index, counted, 30), np.bincount(index[counted], minlength=30))


def test_inside_marks_the_true_extent():
    mask = np.asarray(inside((6, 5), np.int32([4, 2])))
    assert mask.sum() == 8 and mask[:4, :2].all()


@pytest.mark.parametrize("n, padded", [(1, 256), (257, 512), (1000, 1024), (1025, 1152), (2236, 2304), (5000, 5120)])
def test_padded_length(n, padded):
    assert padded_length(n) == padded
    assert padded_shape((n, 1)) == (padded, max(256, padded if padded <= 512 else 0))


def test_small_grids_have_two_shapes():
    assert {padded_shape((n, m)) for n in range(1, 513, 7) for m in range(1, 513, 7)} == {(256, 256), (512, 512)}
    assert padded_shape((100, 50), least=(1, 300)) == (512, 512)


def test_padding_wastes_little_on_large_grids():
    lengths = np.arange(1024, 20000, 7)
    assert max(padded_length(int(n)) / n for n in lengths) <= 1.126


@pytest.mark.parametrize("shape", [(1, 1), (3, 7), (9, 4)])
@pytest.mark.parametrize("size", [1, 3, 9, 21, 10**9 + 1])
def test_extremes_in_windows_are_those_of_scipy_even_in_windows_wider_than_the_grid(shape, size, rng):
    z, width = rng.normal(size=shape).astype(np.float32), min(size, 101)
    for outside in (-np.inf, 0.5):
        expected = ndimage.maximum_filter(z, width, mode="constant", cval=outside)
        np.testing.assert_array_equal(highest(z, size, outside), expected)
    np.testing.assert_array_equal(lowest(z, size), ndimage.minimum_filter(z, width, mode="constant", cval=np.inf))
