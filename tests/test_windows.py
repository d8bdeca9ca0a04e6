import math

import numpy as np
import pytest

from jaxfilter.core.errors import ParameterError
from jaxfilter.core.grid import Grid
from jaxfilter.engines.grid.cells import block_minima
from jaxfilter.engines.grid.windows import window_layout, window_minima


def by_brute_force(xyz, extent, window, stride):
    """Lowest point (ties: first) of every window, straight from the definition; -1 where a window is empty."""
    counts = [max(1, math.floor((length - window) / stride + 1e-9) + 1) for length in extent]
    out = np.full(counts, -1)
    for i in range(counts[0]):
        for j in range(counts[1]):
            rows = np.ones(len(xyz), bool)
            for axis, k, n in ((1, i, counts[0]), (0, j, counts[1])):
                rows &= xyz[:, axis] >= k * stride
                if k < n - 1:
                    rows &= xyz[:, axis] < k * stride + window
            if rows.any():
                rows = np.flatnonzero(rows)
                out[i, j] = rows[np.argmin(xyz[rows, 2])]
    return out


def by_blocks(xyz, extent, window, stride, padding):
    layout = window_layout(extent, window, stride)
    shape = layout.blocks[0] + padding, layout.blocks[1] + padding
    index = Grid(0.0, 0.0, layout.block, *layout.blocks[::-1]).flat(xyz, shape[1])
    lowest, first = block_minima(index, xyz[:, 2], shape[0] * shape[1])
    z, point = window_minima(
        lowest.reshape(shape), first.reshape(shape), np.int32(layout.counts), layout.width, layout.stride
    )
    z, point = np.asarray(z), np.asarray(point)
    beyond = np.ones(z.shape, bool)
    beyond[: layout.counts[0], : layout.counts[1]] = False
    assert np.isinf(z[beyond]).all()
    z, point = z[~beyond].reshape(layout.counts), point[~beyond].reshape(layout.counts)
    return np.where(np.isfinite(z), point, -1)


@pytest.mark.parametrize("window, stride, n, padding", [
    (60, 10, 700, 3), (60, 60, 700, 0), (25, 10, 700, 17), (7.5, 2.5, 700, 3), (16, 6, 2, 0), (500, 10, 700, 3),
])  # fmt: skip
def test_lowest_points_equal_the_definition(window, stride, n, padding):
    """Of many points and of few, most windows of which are empty, in arrays of any size."""
    rng = np.random.default_rng(5)
    extent = (113.0, 171.0)
    xyz = (rng.random((n, 3)) * [extent[1], extent[0], 20]).astype(np.float32)
    xyz[:, 2] = np.round(xyz[:, 2])  # many ties
    expected = by_brute_force(xyz, extent, window, stride)
    np.testing.assert_array_equal(by_blocks(xyz, extent, window, stride, padding), expected)
    assert expected.size == 1 or (expected >= 0).sum() > 1


def test_number_of_windows_is_the_papers():
    assert window_layout((72.0, 122.0), 60, 10).counts == (2, 7)
    assert window_layout((30.0, 59.0), 60, 10).counts == (1, 1)
    assert window_layout((100.0, 100.0), 25, 10).block == 5


@pytest.mark.parametrize("window, stride, name", [(10, 20, "stride"), (10, 0, "stride"), (10, math.pi, "millimetres")])
def test_bad_windows_are_named(window, stride, name):
    with pytest.raises(ParameterError, match=name):
        window_layout((100.0, 100.0), window, stride)
