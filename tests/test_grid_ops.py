from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

import jaxfilter as jf
from jaxfilter import metrics
from jaxfilter.core.grid import Grid
from jaxfilter.engines.cloth import surface
from jaxfilter.engines.grid import cones, inpaint, sampling, spread, windows
from jaxfilter.engines.grid.cells import (
    block_minima,
    inside,
    lowest_in_cells,
    lowest_points,
    padded_length,
    padded_shape,
)
from jaxfilter.engines.grid.extremes import highest, lowest
from jaxfilter.engines.tin import facets
from jaxfilter.steps import planes


@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray])
def test_cells_of_points_count_from_the_corner_and_points_outside_go_to_the_nearest(kind):
    xy = kind(np.array([[0, 0], [1.99, 0], [2, 0], [5, 3.9], [-9, 99], [99, -9]], np.float32))
    row, column = Grid(0.0, 0.0, 2.0, 3, 2).places(xy)
    assert (row.tolist(), column.tolist()) == ([0, 0, 0, 1, 1, 0], [0, 0, 1, 2, 0, 2])
    assert Grid(0.0, 0.0, 2.0, 3, 2).flat(xy, 128).tolist() == [0, 0, 1, 128 + 2, 128, 2]


@pytest.mark.parametrize("n", [0, 1, 500, 200_000])
def test_the_lowest_of_cells_are_those_of_a_sort(rng, n):
    """Among ties, which a zero of the other sign makes too, the first row; some cells are empty, and +inf does not count."""
    index, cells = rng.integers(0, 40, n).astype(np.int32), 41
    index[index == 7] = 8
    z = rng.choice(np.float32([-0.0, 0.0, -1.5, 2.0]), n, p=[0.3, 0.3, 0.01, 0.39])
    z[::9] = np.inf
    order = np.lexsort((np.arange(n), z, index))
    order = order[np.isfinite(z[order])]
    known, first = np.unique(index[order], return_index=True)
    lowest, row = np.full(cells, np.inf, np.float32), np.full(cells, n)
    lowest[known], row[known] = z[order[first]], order[first]
    for found in (lowest_in_cells(index, z, cells), block_minima(index, z, cells)):
        np.testing.assert_array_equal(found[0], lowest)
        np.testing.assert_array_equal(found[1], row)
    xy = rng.integers(0, 3, (n, 2)).astype(np.float32)
    order = order[np.lexsort((xy[order, 1], xy[order, 0], z[order], index[order]))]
    level, number, rows = lowest_points(xy, index, z, cells)
    np.testing.assert_array_equal(level, lowest)
    np.testing.assert_array_equal(xy[rows[number[known]]], xy[order[np.unique(index[order], return_index=True)[1]]])


def test_small_grids_have_two_shapes_and_padding_wastes_little_on_large_ones():
    assert {padded_shape((n, m)) for n in range(1, 513, 7) for m in range(1, 513, 7)} == {(256, 256), (512, 512)}
    assert [padded_length(n) for n in (1000, 1025, 2236, 5000)] == [1024, 1152, 2304, 5120]
    assert max(padded_length(n) / n for n in range(1024, 20000, 7)) <= 1.126


@pytest.mark.parametrize("shape", [(1, 1), (3, 7), (9, 4)])
@pytest.mark.parametrize("size", [1, 3, 9, 21, 10**9 + 1])
def test_extremes_in_windows_are_those_of_scipy_even_in_windows_wider_than_the_grid(shape, size, rng):
    z, width = rng.normal(size=shape).astype(np.float32), min(size, 101)
    for outside in (-np.inf, 0.5):
        expected = ndimage.maximum_filter(z, width, mode="constant", cval=outside)
        np.testing.assert_array_equal(highest(z, size, outside), expected)
    np.testing.assert_array_equal(lowest(z, size), ndimage.minimum_filter(z, width, mode="constant", cval=np.inf))


ALL, KNOWN = np.ones((2, 3), bool), np.array([[True, False, True], [False, True, True]])
POINTS = np.array([[0.2, 0.3, 4.0], [1.6, 0.1, 2.0], [2.9, 1.9, 7.0]])
CORNERS = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 1.0], [0.0, 10.0, 2.0]])
Z = np.array([[3.0, 0.5, -2.0], [1.0, 5.0, 4.25]])
OPERATIONS = {
    "cone_erosion": (cones.cone_erosion, {"z": Z, "slope": 0.5, "radius": 2.0, "reach": 2}),
    "block_minima": (block_minima, {"index": np.array([0, 2, 2]), "z": POINTS[:, 2], "cells": 3}),
    "inside": (inside, {"shape": (2, 3), "extent": np.array([2, 2])}),
    "fill_membrane": (inpaint.fill_membrane, {"z": Z, "known": KNOWN, "inside": ALL, "tolerance": 1e-3}),
    "fill_nearest": (inpaint.fill_nearest, {"z": Z, "known": KNOWN, "inside": ALL}),
    "running": (inpaint.running, {"pick": jnp.minimum, "a": Z, "axis": 1}),
    "fill_from_neighbours": (spread.fill_from_neighbours, {"z": Z, "seen": KNOWN, "valid": ALL, "rounds": 2}),
    "fill_along_lines": (surface.fill_along_lines, {"z": Z, "known": KNOWN, "inside": ALL}),
    "lowest_below": (
        surface.lowest_below,
        {
            "xyz": POINTS, "carries": np.ones(3, bool), "frame": np.array([0.0, 0.0, 1.0]), "extent": np.array([2, 3]),
            "shape": (2, 3), "nearest": False,
        },
    ),
    "corners": (lambda at, extent, columns: sampling.corners(at, extent, columns)[1:],
                {"at": POINTS[:, :2], "extent": np.array([2, 3]), "columns": 3}),
    "bilinear": (lambda grid: sampling.bilinear(np.array([[0.5, 1.0]]), [2, 3], 3)(grid), {"grid": Z}),
    "window_minima": (
        windows.window_minima,
        {"lowest": Z, "first": np.arange(6).reshape(2, 3), "counts": np.array([1, 2]), "width": 2, "stride": 1},
    ),
    "fit_planes": (planes.fit_planes, {"xyz": CORNERS[None], "mask": np.ones((1, 3), bool)}),
    "plane_residuals": (
        lambda xyz: planes.plane_residuals(planes.fit_planes(CORNERS[None], np.ones((1, 3), bool)), xyz),
        {"xyz": POINTS[None]},
    ),
    "facet_score": (facets.facet_score, {"p": POINTS[0], "corners": CORNERS}),
    "judge": (
        partial(facets.judge, facets.Rule(max_angle=9.0)),
        {"two_sided": np.zeros(3, bool), "points": POINTS.T, "corners": np.stack([CORNERS] * 3, axis=2)},
    ),
    "mirrored": (facets.mirrored, {"points": POINTS, "corners": np.stack([CORNERS] * 3), "about_highest": True}),
    "confusion_counts": (
        metrics.confusion_counts, {name: np.ones(3, bool) for name in ("ground", "reference", "counted")}
    ),
}  # fmt: skip
"""Operations with arguments of the types that they say they take; those of :mod:`morphology` have a table of their own."""
ARGUMENTS = [
    (name, key) for name, (_, given) in OPERATIONS.items() for key, v in given.items() if isinstance(v, np.ndarray)
]
MAY_BE_NAN = {("bilinear", "grid"), *(("running", "a"), ("facet_score", "p"), ("facet_score", "corners"))} | {
    (name, key) for name in ("judge", "mirrored") for key in ("p", "points", "corners")
}


def leaves(made):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(made)]


@pytest.mark.parametrize("name", list(OPERATIONS))
def test_numbers_in_other_forms_give_the_same(name):
    """Lists, float64 and float32, all integers that fit, and other byte orders."""
    call, given = OPERATIONS[name]
    expected = leaves(call(**given))

    def same(change):
        changed = {key: change(value) if isinstance(value, np.ndarray) else value for key, value in given.items()}
        for one, other in zip(leaves(call(**changed)), expected, strict=True):
            np.testing.assert_array_equal(one, other)

    same(lambda value: value.tolist())
    for kind in ("float32", ">f8", ">f4"):
        same(lambda value: value.astype(kind if value.dtype.kind == "f" else value.dtype))  # noqa: B023
    for kind in ("int8", "int16", "int32", "uint8", "uint16", "uint32", "uint64", ">i8"):
        same(lambda value: value.astype(kind if value.dtype.kind == "i" else value.dtype))  # noqa: B023
    assert all(leaf.dtype.name != "float64" for leaf in expected)


@pytest.mark.parametrize("name, argument", ARGUMENTS)
def test_other_types_and_shapes_are_refused_by_name(name, argument):
    call, given = OPERATIONS[name]
    right = given[argument]
    good = {"f": "f", "i": "iu", "b": "b"}[right.dtype.kind] + ("iu" if name == "running" else "")
    kinds = "bool int8 int32 int64 uint8 uint64 float16 float32 float64 complex64 complex128 object U3 S3 M8[s] m8[s]"
    wrong = [right.astype(float).astype(kind) for kind in kinds.split() if np.dtype(kind).kind not in good]
    if "iu" not in good and right.dtype.kind == "f":
        wrong += [right.astype("float16"), right.astype(jnp.bfloat16)]
    if good == "iu":
        wrong.append(right + 2**31)
    wrong += [np.ma.array(right, mask=True), [[right], right.tolist()], None, "words", right[..., None]]
    if right.dtype.kind == "f" and (name, argument) not in MAY_BE_NAN:
        wrong += [np.where(np.arange(right.size).reshape(right.shape) == 0, np.nan, right)]
    if right.shape[:2] == (2, 3):
        wrong += [np.zeros((0, 0, *right.shape[2:]), right.dtype), np.zeros((0, 3, *right.shape[2:]), right.dtype)]
    for value in wrong:
        with pytest.raises(jf.InputError, match=rf"^{argument}\b"):
            call(**given | {argument: value})


@pytest.mark.parametrize(
    "call",
    [
        lambda z: cones.cone_erosion(z, 0.5, 3, 3),
        lambda z: inpaint.fill_membrane(z, [[True]], [[True]]).z,
        lambda z: inpaint.fill_nearest(z, [[True]], [[True]]),
        lambda z: inpaint.running(jnp.maximum, z, 1, reverse=True),
        lambda z: spread.fill_from_neighbours(z, [[True]], [[True]], 3)[0],
        lambda z: surface.fill_along_lines(z, [[True]], [[True]]),
        lambda z: sampling.bilinear([[9.0, -9.0]], [1, 1], 1)(z)[None],
        lambda z: windows.window_minima(z, [[0]], [1, 1], 3, 2)[0],
        lambda z: block_minima([0], z[0], 1)[0][None],
    ],
)
def test_one_cell_has_its_own_value(call):
    assert np.asarray(call(np.array([[2.5]]))).tolist() == [[2.5]]


def test_no_points_are_no_points():
    none, nowhere = np.zeros((0, 3)), np.zeros(0, int)
    assert [a.tolist() for a in block_minima(nowhere, none[:, 2], 2)] == [[np.inf, np.inf], [0, 0]]
    assert sampling.bilinear(none[:, :2], [2, 3], 3)(Z).shape == (0,)
    assert metrics.confusion_counts(nowhere == 0, nowhere == 0, nowhere == 0).tolist() == [[0, 0], [0, 0]]
    judged = facets.judge(facets.Rule(), nowhere == 0, none.T, np.zeros((3, 3, 0)))
    assert judged["accepted"].shape == (0,) and facets.mirrored(none, np.zeros((0, 3, 3)), True).shape == (0, 3)
    low, there = surface.lowest_below(none, nowhere == 0, [0.0, 0.0, 1.0], [2, 3], (2, 3), True)
    assert not np.asarray(there).any() and not np.asarray(low).any()


def test_points_and_facets_with_nan_pass_no_test():
    points, corners = np.stack([POINTS[0]] * 3, axis=1), np.stack([CORNERS] * 3, axis=2)
    points[2, 1], corners[1, 0, 2] = np.nan, np.nan
    judged = facets.judge(facets.Rule(max_distance=9.0), np.zeros(3, bool), points, corners)
    assert judged["accepted"].tolist() == [1, 0, 0]


@pytest.mark.parametrize("slope, radius", [(0.0, np.inf), (0.5, np.inf), (0.5, 1.0)])
def test_a_cone_over_infinite_elevations_and_to_an_infinite_radius(slope, radius):
    z = np.array([[3.0, np.inf, -np.inf, 1.0, 9.0, 9.0, np.inf]], np.float32)
    apart = np.abs(np.subtract.outer(np.arange(7), np.arange(7)))
    near = apart <= min(radius, 3)
    with np.errstate(invalid="ignore"):
        expected = np.where(near, z + slope * apart, np.inf).min(axis=1)
    np.testing.assert_array_equal(cones.cone_erosion(z, slope, radius, reach=3)[0], expected)


@pytest.mark.parametrize(
    "call, name",
    [
        (lambda: padded_length(2.5), "n"), (lambda: padded_shape((3, "4")), "shape"), (lambda: inside((2.0, 3), [1, 1]), "shape"),
        (lambda: cones.disk_offsets(-1), "reach"), (lambda: block_minima([0], [1.0], 0), "cells"),
        (lambda: windows.window_minima(Z, [[0] * 3] * 2, [1, 1], 2, 0), "stride"),
        (lambda: inpaint.running(jnp.minimum, Z, 2), "axis"), (lambda: windows.window_layout((9.0, 9.0), np.nan, 1.0), "window"),
        (lambda: windows.window_layout((9.0, 9.0), np.inf, 1.0), "window"),
    ],
)  # fmt: skip
def test_static_arguments_are_refused_by_name(call, name):
    with pytest.raises(jf.ParameterError, match=f"^{name}="):
        call()


def test_a_grid_of_another_width_than_was_prepared_is_refused():
    with pytest.raises(jf.InputError, match=r"^grid of shape \(2, 4\): \[rows, 3\]"):
        sampling.bilinear(np.array([[0.5, 0.5]]), [2, 3], 3)(np.zeros((2, 4)))
