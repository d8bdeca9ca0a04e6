"""Terrain models against SciPy, PyKrige, closed forms and brute force; where their cells lie; their files."""

from __future__ import annotations

import dataclasses
import math
from importlib.util import find_spec

import numpy as np
import pyproj
import pytest
import rasterio
import xarray
from commands import assert_one_line, done, facts, run
from scipy.interpolate import LinearNDInterpolator
from scipy.ndimage import binary_dilation, binary_erosion
from scipy.spatial import Delaunay
from scipy.spatial.distance import cdist

import jaxfilter as jf
from jaxfilter.core.cloud import QUANTUM
from jaxfilter.terrain import accuracy, outline

ORIGIN = np.array([447_312.4, 5_301_208.7, 0.0])
NATURAL = pytest.param(
    "natural", marks=pytest.mark.skipif(find_spec("startinpy") is None, reason="startinpy is not installed")
)
EVERY = pytest.mark.parametrize("method", ["tin", "idw", "kriging", NATURAL])
LINEAR = pytest.mark.parametrize("method", ["tin", NATURAL])


def plane(x, y):
    return 312.0 + 0.31 * (x - ORIGIN[0]) - 0.22 * (y - ORIGIN[1])


def hills(x, y):
    return 300.0 + 4.0 * np.sin((x - ORIGIN[0]) / 17.0) + 3.0 * np.cos((y - ORIGIN[1]) / 11.0)


def scattered(rng, height=hills, n=1500, size=40.0, **attributes):
    """A cloud of ground points in random places, in centimetres."""
    xy = np.rint((ORIGIN[:2] + rng.random((n, 2)) * size) * 100) / 100
    return jf.PointCloud.from_arrays(np.column_stack([xy, height(*xy.T)]), **attributes)


def ground_of(cloud):
    return np.ones(len(cloud), bool)


def model(cloud, **settings):
    return jf.dtm(cloud, ground_of(cloud), **settings)


def at_centres(raster):
    return np.stack(np.meshgrid(*raster.centres()), axis=-1)


@EVERY
def test_cells_are_aligned_to_multiples_and_cover_the_cloud(rng, method):
    raster = model(scattered(rng), cell=2.5, method=method)
    left, bottom, right, top = raster.bounds
    assert (left, bottom) == (447_312.5 - 2.5, 5_301_207.5)
    assert right - 2.5 < ORIGIN[0] + 40 <= right and top - 2.5 < ORIGIN[1] + 40 <= top
    assert raster.values.dtype == np.float32 and raster.values.shape == ((top - bottom) / 2.5, (right - left) / 2.5)
    a, b, c, d, e, f = raster.transform
    x, y = raster.centres()
    assert (x[3], y[5]) == (a * 3.5 + b * 5.5 + c, d * 3.5 + e * 5.5 + f) == (left + 3.5 * 2.5, top - 5.5 * 2.5)
    middle = len(y) // 2, len(x) // 2
    assert raster.values[middle] == pytest.approx(hills(x[middle[1]], y[middle[0]]), abs=0.6)


@LINEAR
def test_linear_methods_are_exact_on_planes_and_levels(rng, method):
    raster = model(scattered(rng, plane), method=method)
    inside, missing = np.isfinite(raster.values), np.isnan(raster.values).sum()
    assert inside.mean() > 0.9 and repr(raster).startswith(
        f"Raster(41 x 41 cells of 1, {missing} without height, bounds 44"
    )
    # Coordinates are known to a quantum.
    np.testing.assert_allclose(raster.values[inside], plane(*at_centres(raster)[inside].T), rtol=0, atol=1.2 * QUANTUM)
    lattice = np.stack(np.meshgrid(np.arange(0.0, 30.0, 0.5), np.arange(0.0, 20.0, 0.5)), axis=-1).reshape(-1, 2)
    level = jf.PointCloud.from_arrays(np.column_stack([lattice, np.full(len(lattice), 7.25)]))
    np.testing.assert_array_equal(model(level, cell=0.5, method=method).values, np.full((39, 59), np.float32(7.25)))


def test_tin_is_the_linear_interpolator_of_scipy(rng):
    cloud = scattered(rng, n=400, size=20.0)
    raster = model(cloud, cell=0.5, max_edge=math.inf)
    local = cloud.xyz.astype(np.float64)
    where = at_centres(raster) - cloud.origin[:2]
    expected = LinearNDInterpolator(Delaunay(local[:, :2]), local[:, 2])(where) + cloud.origin[2]
    both = np.isfinite(raster.values) & np.isfinite(expected)
    assert (np.isfinite(raster.values) != np.isfinite(expected)).sum() <= 2  # within millimetres of the hull
    difference = np.abs(raster.values - expected)[both]
    assert np.quantile(difference, 0.99) < QUANTUM and difference.max() < 0.05  # slivers along the hull are steep


def test_many_cells_at_once_are_shared_between_threads(rng):
    cloud = scattered(rng)
    one, three = (model(cloud, cell=0.08, workers=workers).values for workers in (1, 3))
    assert one.size > 200_000 and one.tobytes() == three.tobytes()


@pytest.mark.parametrize("neighbours, power", [(1, 2.0), (12, 2.0), (5, 3.5)])
def test_idw_is_the_weighted_mean_by_brute_force(rng, neighbours, power):
    cloud = scattered(rng, n=400)
    raster = model(cloud, cell=3.0, method="idw", neighbours=neighbours, power=power, fill=True)
    distance = cdist(at_centres(raster).reshape(-1, 2) - cloud.origin[:2], cloud.xyz[:, :2])
    index = np.argsort(distance, axis=1)[:, :neighbours]
    weight = np.take_along_axis(distance, index, axis=1) ** -power
    expected = (weight * cloud.xyz[index, 2]).sum(axis=1) / weight.sum(axis=1) + cloud.origin[2]
    np.testing.assert_allclose(raster.values.ravel(), expected, rtol=0, atol=2e-4)


def test_natural_neighbour_is_smoother_than_the_tin(rng):
    """Sibson's interpolant has no creases: on a smooth surface it errs less."""
    pytest.importorskip("startinpy")
    cloud = scattered(rng, n=800)
    errors = {}
    for method in ("tin", "natural"):
        raster = model(cloud, method=method)
        errors[method] = np.nanmean((raster.values - hills(*np.moveaxis(at_centres(raster), -1, 0)))[4:-4, 4:-4] ** 2)
    assert errors["natural"] < errors["tin"]


def test_kriging_is_that_of_pykrige(rng):
    ok = pytest.importorskip("pykrige.ok")
    cloud = scattered(rng, n=300)
    raster = model(cloud, cell=2.0, method="kriging", neighbours=10, fill=True)
    local = cloud.xyz.astype(np.float64)
    peer = ok.OrdinaryKriging(*local.T, variogram_model="linear", variogram_parameters={"slope": 0.7, "nugget": 0.0})
    where = (at_centres(raster) - cloud.origin[:2]).reshape(-1, 2)
    expected, _ = peer.execute("points", *where.T, backend="loop", n_closest_points=10)
    np.testing.assert_allclose(raster.values.ravel(), expected + cloud.origin[2], rtol=0, atol=2e-4)


@EVERY
def test_models_go_through_points_at_centres(rng, method):
    centres = np.stack(np.meshgrid(np.arange(0.5, 12.0), np.arange(0.5, 9.0)), axis=-1).reshape(-1, 2)
    z = np.rint(rng.random(len(centres)) * 1000) / 1000
    raster = model(jf.PointCloud.from_arrays(np.column_stack([centres, z])), method=method)
    np.testing.assert_allclose(raster.values, z.reshape(9, 12)[::-1], rtol=0, atol=2.5 * QUANTUM)


@EVERY
def test_no_height_outside_the_hull_unless_filled(rng, method):
    cloud = scattered(rng, n=2000)
    xy = cloud.coordinates()[:, :2]
    ground = np.hypot(*(xy - ORIGIN[:2] - 20.0).T) < 12.0
    raster = jf.dtm(cloud, ground, method=method)
    assert raster.bounds == model(cloud).bounds  # the extent is that of the cloud, not of its ground
    radius = np.hypot(*np.moveaxis(at_centres(raster) - ORIGIN[:2] - 20.0, -1, 0))
    assert np.isfinite(raster.values[radius < 11.0]).all() and np.isnan(raster.values[radius > 12.0]).all()
    filled = jf.dtm(cloud, ground, method=method, fill=True)
    assert np.isfinite(filled.values).all()
    inside = np.isfinite(raster.values)
    np.testing.assert_array_equal(filled.values[inside], raster.values[inside])
    low, high = cloud.coordinates()[ground, 2].min(), cloud.coordinates()[ground, 2].max()
    if method in ("tin", "natural"):
        assert low - 1e-3 <= filled.values.min() and filled.values.max() <= high + 1e-3
    near = jf.dtm(cloud, ground, method=method, fill=True, max_gap=3.0)
    distance = cdist(at_centres(raster).reshape(-1, 2), xy[ground]).min(axis=1).reshape(raster.values.shape)
    np.testing.assert_array_equal(np.isnan(near.values), distance > 3.0)


def test_the_model_ends_where_points_are_farther_apart_than_the_largest_edge(rng):
    """Triangles that long edges lead to from outside have no cells, by SciPy's triangulation; a void in the midst is bridged."""
    cloud = scattered(rng, n=6000, size=80.0)
    xy = cloud.coordinates()[:, :2] - ORIGIN[:2]
    void = (np.abs(xy - [20, 40]) < 9).all(axis=1)
    notch = (np.abs(xy - [60, 72]) < [7, 12]).all(axis=1) | (np.abs(xy - [78, 20]) < [30, 1]).all(axis=1)
    ground = ~(void | notch | (xy @ [1, 1] < 30 + 3 * np.sin(xy[:, 0])))
    raster = jf.dtm(cloud, ground, cell=0.5, max_edge=4.0)
    tin = Delaunay(xy[ground])
    corners = tin.points[tin.simplices]
    length = np.hypot(*np.moveaxis(np.roll(corners, -2, 1) - np.roll(corners, -1, 1), -1, 0))  # opposite to each corner
    gone, open_ = np.zeros(len(corners), bool), [-1]
    while len(open_):
        behind = (np.isin(tin.neighbors, open_) & (length > 4.0)).any(axis=1) & ~gone
        gone, open_ = gone | behind, np.flatnonzero(behind)
    at = tin.find_simplex(at_centres(raster) - ORIGIN[:2])
    expected = (at >= 0) & ~gone[at]
    differ = np.isfinite(raster.values) != expected
    near = binary_dilation(expected, iterations=2) & ~binary_erosion(
        expected, iterations=4
    )  # the disc dips in between points
    assert not (differ & ~near).any() and differ.mean() < 0.02
    middle = np.abs(at_centres(raster) - ORIGIN[:2] - [20, 40]).max(axis=-1) < 9
    assert np.isfinite(raster.values[middle]).all() and gone.sum() > 50
    for layer in (jf.count, jf.density, jf.voids):
        other = layer(cloud, ground, cell=0.5)
        assert np.isnan(other.values[np.hypot(*np.moveaxis(at_centres(other) - ORIGIN[:2], -1, 0)) < 10]).all()
    assert jf.count(cloud, ground, cell=0.5).values[expected & ~near].min() == 0


@EVERY
def test_order_shift_and_threads_change_nothing(rng, method):
    xyz = np.rint(scattered(rng, n=700).coordinates() * 100) / 100

    def made(xyz, workers=None, **anchor):
        return model(jf.PointCloud.from_arrays(xyz, **anchor), cell=0.8, method=method, workers=workers)

    expected, moved = made(xyz), made(xyz + [-440_000.0, 80_000.0, 0.0])
    for same in (moved, made(rng.permutation(xyz), workers=1)):
        np.testing.assert_array_equal(same.values, expected.values)
    assert moved.bounds == pytest.approx(np.add(expected.bounds, [-440_000.0, 80_000.0] * 2), abs=1e-6)
    assert made(xyz, anchor=(0.13, 0.4)).bounds == expected.bounds


def test_the_lowest_of_points_in_one_place_counts(rng):
    cloud = scattered(rng, plane, n=300)
    xyz = cloud.coordinates()
    canopy = xyz + [0.0, 0.0, 8.0]
    twice = jf.PointCloud.from_arrays(np.concatenate([canopy, xyz]))
    np.testing.assert_allclose(model(twice).values, model(cloud).values, rtol=0, atol=2 * QUANTUM)


def test_feet_stay_feet(rng):
    """A cloud in feet gives the cells and the heights of the same numbers in metres."""
    metres = scattered(rng)
    xyz = metres.coordinates()
    feet = model(jf.PointCloud.from_arrays(xyz, units="us-ft"), cell=2.0, max_gap=0.4)
    raster = model(metres, cell=2.0, max_gap=0.4)
    assert feet.transform == raster.transform and 0.2 < np.isnan(raster.values).mean() < 0.8
    both = np.isfinite(feet.values) & np.isfinite(raster.values)
    assert (np.isfinite(feet.values) != np.isfinite(raster.values)).mean() < 0.01
    np.testing.assert_allclose(feet.values[both], raster.values[both], rtol=0, atol=0.02)
    mixed = model(jf.PointCloud.from_arrays(xyz, units="m,ft"), cell=2.0)
    np.testing.assert_allclose(mixed.values, model(metres, cell=2.0).values, rtol=0, atol=0.01)


def test_bounds_choose_the_raster_and_tiles_fit_together(rng):
    cloud = scattered(rng, size=60.0)
    whole = model(cloud)
    left, bottom, _, top = whole.bounds
    west = model(cloud, bounds=(left, bottom, left + 20.0, top))
    east = model(cloud, bounds=(left + 20.0, bottom, left + 50.5, top))
    assert east.bounds == (left + 20.0, bottom, left + 51.0, top)
    np.testing.assert_array_equal(np.hstack([west.values, east.values]), whole.values[:, :51])


@LINEAR
def test_bounds_away_from_the_ground_are_said(rng, method):
    with pytest.warns(jf.JaxfilterWarning, match="no cell has a height: bounds 0, 0, 10, 10 are away.*447312.*5301208"):
        raster = model(scattered(rng, n=400), bounds=(0, 0, 10, 10), method=method)
    assert raster.values.shape == (10, 10) and np.isnan(raster.values).all()


def test_ground_is_given_or_the_reference(rng):
    cloud = scattered(rng, n=400)
    truth = rng.random(len(cloud)) < 0.7
    truth[:3] = True
    known = dataclasses.replace(cloud, reference=truth)
    expected = jf.dtm(cloud, truth).values
    np.testing.assert_array_equal(jf.dtm(known).values, expected)
    nothing = np.zeros(len(cloud), np.float32)
    result = jf.FilterResult(truth, *[nothing] * 5, nothing.astype(np.uint8), ~truth, jf.Status.CONVERGED, {}, [])
    np.testing.assert_array_equal(jf.dtm(cloud, result).values, expected)
    withheld = dataclasses.replace(known, withheld=~(np.arange(len(cloud)) % 2 == 0))
    np.testing.assert_array_equal(jf.dtm(withheld).values, jf.dtm(cloud, truth & ~withheld.withheld).values)


@pytest.mark.parametrize("settings, error, words", [
    ({"method": "spline"}, jf.ParameterError, "spline.*kriging"),
    ({"cell": 0.0}, jf.ParameterError, "cell=0.0"),
    ({"cell": float("nan")}, jf.ParameterError, "cell=nan"),
    ({"max_gap": -1.0}, jf.ParameterError, "max_gap=-1"),
    ({"power": 0.0}, jf.ParameterError, "power"),
    ({"neighbours": 0}, jf.ParameterError, "neighbours=0"),
    ({"cell": 1e-4}, jf.InputError, "cell=0.0001 over an extent of .* needs 15[0-9],[0-9,]* cells"),
    ({"bounds": (5.0, 0.0, 1.0, 1.0)}, jf.InputError, "bounds"),
    ({"result": np.zeros(1500, bool)}, jf.InputError, "no ground point"),
    ({"result": np.arange(1500) < 2}, jf.InputError, "2 distinct ground points"),
    ({"result": np.ones(7, bool)}, jf.InputError, r"bool\[1500\]"),
    ({"result": np.ones(1500)}, jf.InputError, "float64"),
    ({"result": None}, jf.InputError, "no reference"),
])  # fmt: skip
def test_what_cannot_be_is_said(rng, settings, error, words):
    cloud = scattered(rng)
    with pytest.raises(error, match=words):
        jf.dtm(cloud, **({"result": ground_of(cloud)} | settings))


def test_points_on_a_line_and_empty_clouds_are_errors():
    n, zero = np.arange(9.0), np.zeros(9)
    for line_or_mast in ((n, 2 * n, zero), (zero, zero, n)):
        with pytest.raises(jf.InputError, match="9 distinct ground points; three that do not lie on one line"):
            model(jf.PointCloud.from_arrays(np.column_stack(line_or_mast)))
    empty = jf.PointCloud.from_arrays(np.zeros((0, 3)), reference=np.zeros(0, bool))
    with pytest.raises(jf.InputError, match=r"no points.*pass bounds="):
        jf.dtm(empty)
    with pytest.warns(jf.JaxfilterWarning, match="no points"):
        raster = jf.dtm(empty, bounds=(0, 0, 4, 3))
    assert raster.values.shape == (3, 4) and np.isnan(raster.values).all()


@pytest.mark.parametrize("code", [None, "EPSG:32632", "EPSG:6539", "EPSG:25832+7837"])
def test_geotiff_keeps_heights_place_crs_and_nodata(rng, tmp_path, code):
    crs = None if code is None else pyproj.CRS(code)
    raster = model(scattered(rng, crs=crs), cell=0.5)
    path = raster.write(tmp_path / "dtm.tif")
    with rasterio.open(path) as file:
        assert file.dtypes == ("float32",) and file.count == 1 and file.nodata == -9999.0
        assert file.tags().get("AREA_OR_POINT", "Area") == "Area"
        assert tuple(file.transform)[:6] == raster.transform and tuple(file.bounds) == raster.bounds
        np.testing.assert_array_equal(file.read(1, masked=True).filled(np.nan), raster.values)
        x, y = raster.centres()
        assert file.xy(4, 7) == pytest.approx((x[7], y[4]), abs=1e-9)
        assert file.crs is None if code is None else "+" in code or file.crs.to_epsg() == crs.to_epsg()
    again = jf.Raster.read(path)
    np.testing.assert_array_equal(again.values, raster.values)
    assert again.transform == raster.transform
    if code is not None:
        assert [s.name for s in again.crs.sub_crs_list] == [s.name for s in crs.sub_crs_list]
        assert again.crs.axis_info[0].unit_conversion_factor == pytest.approx(crs.axis_info[0].unit_conversion_factor)


def test_rasters_are_not_replaced_by_accident_and_what_is_none_is_said(tmp_path):
    raster = jf.Raster(np.zeros((2, 2), np.float32), (1.0, 0.0, 0.0, 0.0, -1.0, 2.0))
    path = raster.write(tmp_path / "dtm.tif")
    for name, words in (("dtm.tif", "exists"), ("dtm.png", "suffix"), ("no/a.tif", "cannot be written")):
        with pytest.raises(jf.OutputError, match=words):
            raster.write(tmp_path / name)
    assert raster.write(path, overwrite=True) == path and [p.name for p in tmp_path.iterdir()] == ["dtm.tif"]
    (tmp_path / "a.tif").write_bytes(b"nothing")
    with pytest.raises(jf.InputError, match=r"a\.tif"):
        jf.Raster.read(tmp_path / "a.tif")


@pytest.mark.parametrize("code", [None, "EPSG:32632", "EPSG:25832+7837"])
def test_xarray_knows_its_place(tmp_path, code):
    """As rioxarray reads it, before and after NetCDF."""
    pytest.importorskip("rioxarray")
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    values[0, 1] = np.nan
    raster = jf.Raster(values, (0.5, 0.0, 400000.0, 0.0, -0.5, 5000000.0), None if code is None else pyproj.CRS(code))
    data = raster.to_xarray()
    data.to_netcdf(tmp_path / "dtm.nc", engine="scipy")
    with xarray.open_dataset(tmp_path / "dtm.nc", engine="scipy", decode_coords="all") as file:
        for one in (data, file["height"]):
            np.testing.assert_array_equal(one, values)
            assert one.rio.bounds() == raster.bounds and tuple(one.rio.transform())[:6] == raster.transform
            assert np.isnan(one.rio.nodata) and one.rio.encoded_nodata == raster.nodata and one.rio.shape == (3, 4)
            assert one.rio.crs == (None if code is None else rasterio.crs.CRS.from_user_input(code))
    data.rio.to_raster(tmp_path / "dtm.tif")
    again = jf.Raster.read(tmp_path / "dtm.tif")
    np.testing.assert_array_equal(again.values, values)
    assert again.transform == raster.transform and again.nodata == raster.nodata


@EVERY
def test_the_reference_has_no_error_against_itself(town, method):
    errors = jf.dtm_rmse(town.cloud, town.truth, town.truth, cell=2.0, interpolation=jf.Interpolation(method))
    assert (errors.rmse, errors.mean, errors.largest, errors.missing) == (0.0, 0.0, 0.0, 0) and errors.cells > 1000


def test_rmse_is_that_of_the_heights(rng):
    cloud = scattered(rng, plane, n=4000)
    xyz = np.concatenate([cloud.coordinates(), cloud.coordinates() + [0.001, 0.0, 0.5]])
    double = jf.PointCloud.from_arrays(xyz, units="m,ft")
    truth = np.arange(len(double)) < len(cloud)
    errors = jf.dtm_rmse(double, ~truth, truth, near=None)
    for value in (errors.rmse, errors.mean, errors.largest):
        assert value == pytest.approx(0.5 * 0.3048, abs=0.003)  # metres, though heights are in feet
    known = dataclasses.replace(double, reference=truth)
    assert jf.dtm_rmse(known, ~truth, near=None) == errors
    west = truth & (double.xyz[:, 0] < 20.0)
    half = jf.dtm_rmse(double, west, truth, near=None)
    assert half.missing > 500 and half.rmse < 0.01 and half.cells + half.missing == pytest.approx(errors.cells, abs=60)
    for reference, words in ((None, "pass reference="), (truth[1:], "reference: bool"), (truth * 1, "reference: bool")):
        with pytest.raises(jf.InputError, match=words):
            jf.dtm_rmse(double, truth, reference)


def plain(side=100):
    """Points at the centres of cells of 1 m, from zero on; x and y f64[n], and the cloud, all of it ground at level zero."""
    x, y = (v.ravel() for v in np.meshgrid(*2 * [np.arange(side) + 0.5]))
    return x, y, np.column_stack([x, y, np.zeros(len(x))])


def test_shares_and_percentiles_are_those_of_the_cells_that_are_off():
    """Level ground at the centres of cells, and second points above and below some of them that are taken for ground instead."""
    x, y, level = plain()
    bump, step, pit = (x < 10) & (y < 10), (x > 50) & (x < 52) & (y < 30), (y > 97) & (x > 40) & (x < 60)
    found = level.copy()
    for where, height in ((bump, 4.0), (step, 0.75), (pit, -2.0)):
        found[where, 2] = height
    cloud = jf.PointCloud.from_arrays(np.concatenate([level, found]))
    truth = np.arange(len(cloud)) < len(level)
    errors = jf.dtm_rmse(cloud, ~truth, truth)
    inner = (np.minimum(x, y) > 20) & (np.maximum(x, y) < 80)
    for part, where in ((errors, True), (errors.border, ~inner), (errors.inside, inner)):
        d = found[np.broadcast_to(where, x.shape), 2]
        assert part.cells == len(d) and part.missing == 0
        for name, share in (
            ("high", d > 0.5), ("low", d < -0.5), ("high_1m", d > 1), ("low_1m", d < -1), ("off", abs(d) > 0.5),
            ("off_1m", abs(d) > 1),
        ):  # fmt: skip
            assert getattr(part, name) == pytest.approx(100 * share.mean(), abs=1e-12), name
        assert part.rmse == pytest.approx(np.sqrt((d * d).mean()), abs=1e-6)
        assert part.mean == pytest.approx(d.mean(), abs=1e-6) and part.largest == pytest.approx(abs(d).max(), abs=1e-6)
        assert part.p95 == pytest.approx(np.percentile(abs(d), 95), abs=1e-6)
    flat = errors.as_dict()
    assert list(flat) == list(accuracy.FIGURES)
    assert flat["border_high_1m"] == errors.border.high_1m > 0 == errors.inside.low


def test_the_border_is_the_outline_of_the_data():
    """An L of 100 m with a lake inside and an inlet of 12 m: lake and inlet are no border, the inner sides of the L are."""
    x, y, level = plain()
    missing = ((x > 60) & (y > 60)) | ((np.abs(x - 30) < 12) & (np.abs(y - 30) < 4)) | ((np.abs(x - 20) < 6) & (y > 80))
    cloud = jf.PointCloud.from_arrays(level[~missing])
    truth = np.ones(len(cloud), bool)
    found = accuracy.differences(cloud, truth, truth, 1.0, jf.Interpolation(), near=3.0, rim=10.0)
    border = found.border[::-1]  # row 0 in the south
    expected = (x < 10) | (y < 10) | (y > 90) | (x > 90) | ((x > 50) & (y > 60)) | ((y > 50) & (x > 60))
    known = ~missing & ~((x > 50) & (x < 70) & (y > 50) & (y < 70))  # the inner corner is rounded off
    known &= ~((np.abs(x - 20) < 10) & (y > 89) & (y < 90))  # as is the mouth of the inlet
    np.testing.assert_array_equal(border.ravel()[known], expected[known])
    feet = jf.PointCloud.from_arrays(level[~missing] / 0.3048, units="ft")
    same = accuracy.differences(feet, truth, truth, 1 / 0.3048, jf.Interpolation(), near=3.0, rim=10.0)
    np.testing.assert_array_equal(same.border[::-1].ravel()[known], expected[known])


def test_only_cells_near_reference_ground_count(rng):
    x, y, level = plain()
    cloud = jf.PointCloud.from_arrays(level)
    hall = (np.abs(x - 50) < 20) & (np.abs(y - 50) < 20)
    errors = jf.dtm_rmse(cloud, np.ones(len(x), bool), ~hall)
    beyond = (np.abs(x - 50) < 17) & (np.abs(y - 50) < 17)
    assert errors.cells == len(x) - beyond.sum()
    feet = jf.PointCloud.from_arrays(level / (foot := 1200 / 3937), units="us-ft")
    assert jf.dtm_rmse(feet, np.ones(len(x), bool), ~hall, cell=1 / foot).cells == errors.cells
    assert jf.dtm_rmse(cloud, np.ones(len(x), bool), ~hall, near=None).cells == len(x)
    west = x < 40
    assert jf.dtm_rmse(cloud, west, ~hall).missing == (~west & ~beyond).sum()
    filled = jf.dtm_rmse(cloud, west, ~hall, interpolation=jf.Interpolation(fill=True))
    assert filled.missing == 0 and filled.cells == errors.cells
    for wrong in ({"near": 0.0}, {"rim": math.nan}):
        with pytest.raises(jf.ParameterError, match=rf"{next(iter(wrong))}="):
            jf.dtm_rmse(cloud, west, ~hall, **wrong)


def test_cells_come_in_blocks_and_are_counted(rng, monkeypatch):
    cloud, seen = scattered(rng), []
    whole = model(cloud)
    monkeypatch.setattr(outline, "CELLS_AT_ONCE", 100)
    np.testing.assert_array_equal(model(cloud, progress=lambda f, step: seen.append((f, step))).values, whole.values)
    fractions = [f for f, _ in seen]
    assert len(fractions) > 10 and fractions == sorted(fractions) and 0.0 <= fractions[0] <= fractions[-1] < 1.0


@pytest.fixture
def files(tmp_path, town):
    jf.write(tmp_path / "scene.laz", town.cloud, np.zeros(len(town), bool), reset="none")
    jf.write(tmp_path / "truth.laz", town.cloud, town.truth, reset="all")
    return tmp_path


@pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
def test_the_command_writes_what_the_library_makes(files):
    cloud = jf.read(files / "truth.laz", units="m")
    report = facts("dtm", files / "truth.laz", files / "out.tif", "--cell", 2, "--max-gap", 5, "--fill")
    expected = jf.dtm(cloud, cell=2.0, max_gap=5.0, fill=True)
    np.testing.assert_array_equal(jf.Raster.read(files / "out.tif").values, expected.values)
    assert report["empty"] == np.isnan(expected.values).sum() and report["ground"] == cloud.reference.sum()
    assert [report["rows"], report["columns"]] == list(expected.values.shape)
    assert tuple(report["transform"]) == expected.transform
    assert set(report["seconds"]) == {"read", "interpolate", "write"}
    how = ("--overwrite", "--filter", "ptd", "--method", "idw", "--power", 3)
    assert "ground points" in done("dtm", files / "scene.laz", files / "out.tif", *how).stdout
    scene = jf.read(files / "scene.laz", units="m")
    found = jf.dtm(scene, jf.PTD()(scene), method="idw", power=3.0)
    np.testing.assert_array_equal(jf.Raster.read(files / "out.tif").values, found.values)


@pytest.mark.parametrize("arguments, code, word", [
    (("scene.laz", "truth.tif"), 2, "--overwrite"),
    (("scene.laz", "out.tif", "--cell", "0"), 2, "--cell 0.0"),
    (("scene.laz", "out.tif", "--method", "spline"), 2, "natural"),
    (("scene.laz", "out.tif"), 1, "--filter"),
    (("truth.laz", "out.tif", "--ground-class", "9"), 1, "no point is ground"),
])  # fmt: skip
@pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
def test_the_command_refuses_in_one_line(files, arguments, code, word):
    (files / "truth.tif").write_bytes(b"mine")
    source, target, *options = arguments
    before = {p.name for p in files.iterdir()}
    assert_one_line(run("dtm", files / source, files / target, *options), code, word)
    assert {p.name for p in files.iterdir()} == before and (files / "truth.tif").read_bytes() == b"mine"
