"""What cannot be true is refused or said: units, scales, extents, degrees, counts; laspy.LasData as a cloud.

Each through the library, and through the command where it has a part in it.
"""

from __future__ import annotations

import json
import re
import struct
import types
import warnings

import click
import laspy
import numpy as np
import pyproj
import pytest
from click.testing import CliRunner
from las_files import OFFSETS, las_of, make_las, patch, replace_crs

import jaxfilter as jf
from jaxfilter.cli import main
from jaxfilter.cli.commands import ground_command
from jaxfilter.cli.terrain import layer_command
from jaxfilter.core.cloud import as_cloud
from jaxfilter.core.inputs import COLUMN_TYPES
from jaxfilter.core.units import not_metric

pytestmark = pytest.mark.filterwarnings("ignore:.*impossible return numbers", "ignore:.*metres are assumed")
UTM = (
    'PROJCS["any",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],'
    'UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],'
    'PARAMETER["central_meridian",9],PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],'
    'PARAMETER["false_northing",0],UNIT["metre",{}]]'
)


def command(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


def ground(source, *options):
    return command("ground", "spf", source, source.with_name("out.las"), *options)


def assert_error(result, *words):
    """One line on standard error, exit code 1."""
    assert result.exit_code == 1, result.output
    (line,) = (line for line in result.stderr.splitlines() if not line.startswith("warning: "))
    assert line.startswith("Error: ")
    for word in words:
        assert word in line


def hills(n=400, size=60.0, seed=0):
    """f64[n, 3]: gentle ground."""
    x, y = np.random.default_rng(seed).uniform(0, size, (2, n)).round(2)
    return np.column_stack([x, y, np.round(3 * np.sin(x / 30), 2)])


# scales and units


@pytest.mark.parametrize("metres", ["1e300", "0", "-1", "1e-300", "20000"])
def test_absurd_unit_in_the_crs(tmp_path, metres):
    path = tmp_path / "in.las"
    make_las(path)
    replace_crs(path, UTM.format(metres).encode())
    with pytest.raises(
        jf.InputError, match=r"in.las: its CRS \(any\) has .* metres in a unit named 'metre', which cannot"
    ):
        jf.read(path)
    assert_error(ground(path), "in.las", "its CRS (any) has", "pass --units")
    assert len(jf.read(path, units="m")) == 200
    assert ground(path, "--units", "m").exit_code == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = jf.info(path)
    assert found["metres_per_unit"] is None and found["units"] == f"metre of {float(metres):g} m"


def test_unit_of_a_known_name_and_another_length(tmp_path):
    make_las(tmp_path / "in.las")
    replace_crs(tmp_path / "in.las", UTM.format(2).encode())
    with pytest.warns(jf.JaxfilterWarning, match=r"has 2 metres in a metre, which has 1: used"):
        assert jf.read(tmp_path / "in.las").units.xy == 2


# extent


@pytest.mark.parametrize(
    "axis, far, limit", [(0, 3e7, "1e+07"), (1, -2e7, "1e+07"), (2, 1e300, "100000"), (2, -2e5, "100000")]
)
def test_points_far_off(tmp_path, axis, far, limit):
    xyz = hills()
    xyz[17, axis] = far
    with pytest.raises(jf.InputError) as caught:
        jf.PointCloud.from_arrays(xyz, name="mine")
    message = str(caught.value)
    assert message.startswith(f"mine: {'XYZ'[axis]} spans ") and f"more than the {limit} m" in message
    assert "point 17 of 400" in message and f"{far:.10g}" in message and "drop_invalid=True" in message
    with pytest.warns(jf.JaxfilterWarning, match="mine: 1 points more than .* are labelled non-ground"):
        cloud = jf.PointCloud.from_arrays(xyz, name="mine", drop_invalid=True)
    assert np.flatnonzero(~cloud.valid).tolist() == np.flatnonzero(~cloud.candidate).tolist() == [17]
    rest = jf.PointCloud.from_arrays(np.delete(xyz, 17, axis=0))
    assert np.delete(cloud.xyz, 17, axis=0).tobytes() == rest.xyz.tobytes() and not cloud.xyz[17].any()
    path = tmp_path / "in.txt"
    path.write_text("".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in xyz.tolist()))
    with pytest.raises(jf.InputError, match=rf"in.txt: {'XYZ'[axis]} spans"):
        jf.read(path)
    assert_error(
        command("ground", "spf", path, tmp_path / "out.txt"), "in.txt", "point 17 of 400", "pass --drop-invalid to"
    )
    result = command("ground", "spf", path, tmp_path / "out.txt", "--drop-invalid", "--json")
    assert result.exit_code == 0 and json.loads(result.stdout)["candidates"] == 399
    assert (tmp_path / "out.txt").read_text().splitlines()[17] == path.read_text().splitlines()[17] + " 1"


def test_points_far_off_in_las(tmp_path):
    path = tmp_path / "in.las"
    las = make_las(path)
    las.Z = np.where(np.arange(200) == 5, 2**31 - 1, np.arange(200) % 7)
    las.write(path)
    patch(path, "d", 131 + 16, 1.0)
    with pytest.raises(jf.InputError, match=r"in.las: Z spans 2.147e\+09 m, .* point 5 of 200 .* 2147483747\)"):
        jf.read(path)
    with pytest.warns(jf.JaxfilterWarning, match=r"in.las: 1 points more than 50000 m from the median of Z"):
        cloud = jf.read(path, drop_invalid=True)
    assert np.flatnonzero(~cloud.valid).tolist() == [5] and not cloud.candidate[5]
    assert cloud.origin[2] == 100 and np.ptp(cloud.xyz[:, 2]) == 6
    with pytest.warns(jf.JaxfilterWarning, match="from the median of Z"):
        assert jf.info(path)["z"] == [100, 106]


@pytest.mark.parametrize("offset", [1e300, 1e13, -1e15])
def test_coordinates_that_float64_does_not_resolve(tmp_path, offset):
    make_las(tmp_path / "in.las")
    patch(tmp_path / "in.las", "d", 155 + 8, offset)
    with pytest.raises(jf.InputError, match=r"in.las: Y reaches .* float64 does not resolve"):
        jf.read(tmp_path / "in.las")
    assert_error(ground(tmp_path / "in.las"), "in.las: Y reaches")
    with pytest.raises(jf.InputError, match="X reaches"):
        jf.PointCloud.from_arrays(hills() + [offset, 0, 0])


@pytest.mark.parametrize("offset", [1e9, -1e9, 1e12])
def test_large_offsets_are_none_of_these(offset):
    """Coordinates in quarters stay exact, so nothing but the origin differs."""
    xyz = np.rint(hills() * 4) / 4
    cloud = jf.PointCloud.from_arrays(xyz + [offset, -offset, 0])
    assert cloud.xyz.tobytes() == jf.PointCloud.from_arrays(xyz).xyz.tobytes()
    assert (cloud.origin == jf.PointCloud.from_arrays(xyz).origin + [offset, -offset, 0]).all()


@pytest.mark.parametrize("anchor", [3, (1, 2, 3), (np.nan, 0), (1e300, 0), "ab"])
def test_anchor_that_is_none(anchor):
    with pytest.raises(jf.InputError, match="anchor="):
        jf.PointCloud.from_arrays(hills(), anchor=anchor)


# degrees


def degrees(n=4000, seed=1):
    """f64[n, 3]: a patch of about 1 km, heights in metres."""
    rng = np.random.default_rng(seed)
    lon, lat = 9.1 + 0.013 * rng.random(n), 48.7 + 0.009 * rng.random(n)
    return np.column_stack([lon, lat, 300 + 40 * rng.random(n)])


@pytest.mark.parametrize("name", ["in.las", "in.laz", "in.txt"])
@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("stray", [False, True])
def test_degrees_that_nothing_states(tmp_path, name, swapped, stray):
    path, xyz = tmp_path / name, degrees()
    if swapped:
        xyz = xyz[:, [1, 0, 2]]
    if stray:
        xyz[7] = 0.0
    if name == "in.txt":
        np.savetxt(path, xyz, fmt="%.7f %.7f %.2f")
    else:
        las_of(path, xyz, scales=(1e-7, 1e-7, 0.01))
    with pytest.raises(
        jf.InputError, match=rf"{name}: 4000 points on .* units, with heights over .*, look like degrees"
    ):
        jf.read(path)
    with pytest.warns(jf.JaxfilterWarning, match="look like degrees"):
        jf.info(path)
    assert len(jf.read(path, units="m")) == 4000
    if not swapped and not stray:
        assert_error(ground(path), name, "look like degrees", "pass --units if")
        assert "warning: " in command("info", path).stderr and "look like degrees" in command("info", path).stderr
        assert ground(path, "--units", "m").exit_code == 0


@pytest.mark.parametrize("span, relief, expected", [
    (0.4, 0.5, True), (0.4, 0.3, False), (0.6, 300.0, False), (400.0, 500.0, False),
])  # fmt: skip
@pytest.mark.parametrize("east", [100.0, 440.0, 440000.0])
def test_small_extent_under_a_relief(span, relief, expected, east):
    """The first rule as stated; where a unit is stated, or a small part was asked for, for angles only."""
    xyz = np.random.default_rng(0).random((300, 3)) * [span, span, relief] + [east, 50.0, 7.0]
    assert bool(not_metric(xyz, len(xyz), stated=False)) == expected
    assert bool(not_metric(xyz, len(xyz), stated=True)) == (expected and east == 100.0)


def test_dense_angles():
    xyz = np.random.default_rng(0).random((5000, 3)) * [3.0, 3.0, 2.0] + [170.0, 40.0, 0.0]
    assert not_metric(xyz, 5000, False) is None
    assert "degrees" in not_metric(xyz, 10**9, False)  # the sample of a large cloud
    assert not_metric(xyz + [200, 50, 0], 10**9, False) is None


def test_local_coordinates_are_no_degrees(tmp_path):
    np.savetxt(tmp_path / "in.txt", hills(), fmt="%.2f")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(jf.read(tmp_path / "in.txt")) == 400
        assert len(jf.read(tmp_path / "in.txt", bounds=(0, 0, 30, 30))) > 50


def test_geocentric_is_not_shown_as_degree(tmp_path):
    make_las(tmp_path / "in.las", crs=4978)
    found = jf.info(tmp_path / "in.las")
    assert found["units"] == "metre, geocentric" and found["metres_per_unit"] is None and found["spacing"] is None
    assert "metre, geocentric" in command("info", tmp_path / "in.las").stdout
    assert_error(ground(tmp_path / "in.las"), "centre of the Earth (WGS 84)", "reproject", "pass --units")
    make_las(tmp_path / "grad.las", crs=4807)  # NTF (Paris), in grads
    assert jf.info(tmp_path / "grad.las")["units"] == "grad"


def test_units_for_info(tmp_path):
    make_las(tmp_path / "in.las", crs=None)
    found = json.loads(command("info", tmp_path / "in.las", "--units", "ft", "--json").stdout)
    assert found["metres_per_unit"] == [0.3048, 0.3048]
    result = command("info", tmp_path / "in.las")
    assert "metres are assumed; pass --units if that is wrong" in result.stderr
    assert command("info", tmp_path / "in.las", "--units", "yard").exit_code == 2


# counts


@pytest.mark.parametrize("name, point_format, version, n, counts, words, held", [
    ("in.las", 1, None, 200, {107: 150}, "150 points, but 1400 bytes follow .* so 200 in all", 150),
    ("in.las", 6, None, 200, {247: 0}, "0 points, but 6000 bytes follow", 0),
    ("in.laz", 6, None, 200, {247: 150}, "150 points, but the compressed chunks hold at least 200", 150),
    ("in.laz", 6, None, 120_000, {247: 150}, "150 points, but the compressed chunks hold at least 120000", 150),
    # chunks of the older formats do not say how full the last one is
    ("in.laz", 1, None, 120_000, {107: 150}, "150 points, but the compressed chunks hold at least 100001", 150),
    ("in.laz", 1, None, 300, {107: 299}, "299 points, and 300 in its counts by return: 299 are read", 299),
    ("in.las", 1, "1.4", 200, {107: 120}, "200 points, and 120 in its legacy field: 200 are read", 200),
    ("in.las", 1, "1.4", 200, {107: 200, 247: 0}, "0 points, and 200 in its legacy field: 200 are read", 200),
])  # fmt: skip
def test_other_counts_than_the_points(tmp_path, name, point_format, version, n, counts, words, held):
    path, target = tmp_path / name, tmp_path / f"out{name[2:]}"
    las = make_las(path, point_format, version, n=n)
    for at, value in counts.items():
        patch(path, "Q" if at == 247 else "I", at, value)
    with pytest.warns(jf.JaxfilterWarning, match=f"announces {words}"):
        cloud = jf.read(path)
    np.testing.assert_array_equal(cloud.classification, las.classification[:held])
    jf.write(target, cloud, np.zeros(held, bool), reset="none")
    if name == "in.las":
        size = struct.unpack_from("<H", path.read_bytes(), 94)[0]
        assert target.read_bytes()[size:] == path.read_bytes()[size:]  # points that are not read are kept
    else:
        np.testing.assert_array_equal(laspy.read(target).Z, las.Z[:held])
    if n == 200:
        assert re.search(f"announces {words}", ground(path, "--overwrite").stderr)


@pytest.mark.parametrize("point_format", [4, 6])
def test_start_of_waveforms_that_is_not_in_the_file(tmp_path, point_format):
    las = make_las(tmp_path / "in.laz", point_format)
    patch(tmp_path / "in.laz", "Q", 227, 2**64 - 5)
    cloud = jf.read(tmp_path / "in.laz")
    jf.write(tmp_path / "out.las", cloud, np.zeros(200, bool), reset="none")
    assert laspy.read(tmp_path / "out.las").points.array.tobytes() == las.points.array.tobytes()


# coordinate reference systems


def test_any_crs_that_pyproj_takes_reaches_rasters_and_las(tmp_path):
    expected = pyproj.CRS.from_epsg(2154)
    for crs in ("EPSG:2154", 2154, ("EPSG", 2154), expected, expected.to_wkt(), None):
        cloud = jf.PointCloud.from_arrays(hills(), crs=crs)
        assert cloud.crs is None if crs is None else cloud.crs == expected
    for crs in ("nonsense", 3.5, object(), 10**9):
        with pytest.raises(jf.InputError, match="crs="):
            jf.PointCloud.from_arrays(hills(), crs=crs)
    cloud = jf.PointCloud.from_arrays(hills(), crs="EPSG:2154")
    labels = np.ones(len(cloud), bool)
    jf.dtm(cloud, labels, 5.0).write(tmp_path / "out.tif")
    assert jf.Raster.read(tmp_path / "out.tif").crs.to_epsg() == 2154
    jf.write(tmp_path / "out.las", cloud, labels)
    assert jf.read(tmp_path / "out.las").crs.to_epsg() == 2154


# laspy


@pytest.mark.parametrize("point_format, crs, units", [
    *[(number, crs, units) for number in (1, 3, 6, 8) for crs, units in ((32632, None), (2225, None), (None, "ft"), (4326, "m"))],
    (6, "EPSG:32632+8228", None), (8, "EPSG:32632+8228", None),  # older formats hold no compound CRS as laspy writes them
])  # fmt: skip
def test_las_data_is_its_file(tmp_path, point_format, crs, units):
    las = make_las(tmp_path / "in.las", point_format, crs=crs)
    box = (*(OFFSETS[:2] + 20), *(OFFSETS[:2] + 60))
    for data in (las, laspy.read(tmp_path / "in.las")):
        for bounds in (None, box):
            expected, cloud = (jf.read(source, units=units, bounds=bounds) for source in (tmp_path / "in.las", data))
            assert cloud.xyz.tobytes() == expected.xyz.tobytes() and cloud.origin.tolist() == expected.origin.tolist()
            for name in (*COLUMN_TYPES, "candidate", "reference"):
                np.testing.assert_array_equal(getattr(cloud, name), getattr(expected, name), err_msg=name)
            assert (cloud.units, cloud.crs, cloud.source) == (expected.units, expected.crs, None)
    assert data.X.tolist() == las.X.tolist()  # not used up


def test_las_data_everywhere(tmp_path):
    xyz = hills(900)
    las = las_of(None, xyz, crs=32632)
    filter_ = jf.SPF()
    expected = filter_(xyz)
    result = filter_(las)
    np.testing.assert_array_equal(result.ground, expected.ground)
    assert jf.SPF.for_cloud(las) == jf.SPF.for_cloud(xyz)
    las.classification[result.ground] = 2
    las.classification[~result.ground] = 1
    assert jf.evaluate(result, las).total == 0
    raster = jf.dtm(las, cell=5.0)
    np.testing.assert_array_equal(raster.values, jf.dtm(jf.read(las), result, cell=5.0).values)
    assert raster.crs.to_epsg() == 32632 and jf.dtm_rmse(las, result, cell=5.0).rmse == 0
    jf.write(tmp_path / "out.las", jf.read(las), result)
    again = laspy.read(tmp_path / "out.las")
    np.testing.assert_allclose(again.xyz, xyz, atol=1e-9)
    np.testing.assert_array_equal(again.classification, las.classification)


def test_las_data_is_checked_as_files_are():
    las = las_of(None, degrees(500))
    with (
        pytest.warns(jf.JaxfilterWarning, match="LasData: no CRS"),
        pytest.raises(jf.InputError, match=r"LasData: .*degrees"),
    ):
        jf.SPF()(las)
    las.header.add_crs(pyproj.CRS.from_epsg(4326))
    with pytest.raises(jf.InputError, match=r"LasData: coordinates are not in a projected system \(WGS 84\)"):
        jf.SPF()(las)
    las.header.scales[0] = 1e300
    with pytest.raises(jf.InputError, match="LasData: X scale factor"):
        jf.read(las, units="m")
    with pytest.warns(jf.JaxfilterWarning, match="LasData: holds no points"):
        assert len(jf.read(laspy.LasData(laspy.LasHeader()), units="m")) == 0


# arrays


FLAT = np.column_stack([*(v.ravel() for v in np.meshgrid(np.arange(20.0), np.arange(20.0))), np.zeros(400)])


def test_masked_points_are_refused_or_set_aside():
    masked = np.ma.array(FLAT, mask=False, copy=True)
    masked[7] = (3.0, 3.0, -9999.0)
    masked[7, 2] = np.ma.masked
    with pytest.raises(jf.InputError, match="1 of 400 points have NaN, infinite or masked coordinates"):
        jf.SMRF()(masked)
    with pytest.warns(jf.JaxfilterWarning, match="masked"):
        cloud = jf.PointCloud.from_arrays(masked, drop_invalid=True)
    assert not cloud.candidate[7] and cloud.candidate.sum() == 399 and cloud.xyz[:, 2].min() == 0
    structured = np.ma.zeros(4, [("X", "f8"), ("Y", "f8"), ("Z", "f8"), ("Classification", "u1")])
    for field, words in (("Z", "masked coordinates"), ("Classification", "classification has masked entries")):
        one = structured.copy()
        one[field][2] = np.ma.masked
        with pytest.raises(jf.InputError, match=words):
            jf.PointCloud.from_structured(one)
    labels = np.ma.array(np.ones(3, bool), mask=[0, 1, 0])
    with pytest.raises(jf.InputError, match="reference has masked entries"):
        jf.evaluate(np.ones(3, bool), labels)


def test_arrays_of_pdal_are_clouds(scene):
    names = [(name, "f8") for name in "XYZ"] + [("Intensity", "u2"), ("ReturnNumber", "u1"), ("NumberOfReturns", "u1")]
    points = np.zeros(len(scene), [*names, ("Classification", "u1"), ("Withheld", "u1")])
    for axis, column in zip("XYZ", scene.cloud.coordinates().T, strict=True):
        points[axis] = column
    points["ReturnNumber"], points["NumberOfReturns"] = scene.cloud.return_number, scene.cloud.number_of_returns
    points["Classification"], points["Withheld"] = scene.classes, np.arange(len(scene)) % 50 == 0
    cloud = jf.PointCloud.from_structured(points, crs="EPSG:32632")
    assert cloud.crs.to_epsg() == 32632 and cloud.withheld.sum() == -(-len(scene) // 50)
    np.testing.assert_array_equal(cloud.reference, scene.classes == 2)
    np.testing.assert_array_equal(
        cloud.candidate, scene.cloud.select().candidate & ~cloud.withheld & (scene.classes < 7)
    )
    labels = jf.SMRF()(points).ground
    np.testing.assert_array_equal(labels, jf.SMRF()(cloud).ground)
    assert labels.any() and jf.dtm(points).values.shape == jf.dtm(cloud).values.shape
    x, y, z = scene.cloud.coordinates().T
    echoes = {"return_number": points["ReturnNumber"], "number_of_returns": points["NumberOfReturns"]}
    likewise = as_cloud(types.SimpleNamespace(x=x, y=y, z=z, intensity=z, **echoes))  # as the points of laspy
    np.testing.assert_array_equal(likewise.xyz, scene.cloud.xyz)
    np.testing.assert_array_equal(likewise.candidate, scene.cloud.candidate)
    wrong = points.astype([(n, "i4" if n == "Classification" else points.dtype[n]) for n in points.dtype.names])
    wrong["Classification"][7] = 300
    with pytest.raises(jf.InputError, match=r"classification of point 7 is .*300.*: whole numbers from 0 to 255"):
        jf.PointCloud.from_structured(wrong)
    with pytest.raises(jf.InputError, match=r"withheld of point 1 is .*2.*: True or False"):
        jf.PointCloud.from_arrays(np.zeros((2, 3)), withheld=[1, 2])
    with pytest.raises(jf.InputError, match="there is no field Z"):
        jf.SMRF()(points[["X", "Y", "Intensity"]])


def test_every_array_that_the_docstring_allows_is_taken_and_others_are_refused():
    given = {
        "return_number": 2 + (np.arange(400) % 100 == 1), "number_of_returns": np.full(400, 3.0), "classification": [6] * 400,
        "withheld": np.arange(400) % 2, "reference": np.arange(400) % 3 == 0,
    }  # fmt: skip
    cloud = jf.PointCloud.from_arrays(FLAT, **given, crs="EPSG:2154")
    for name, values in given.items():
        np.testing.assert_array_equal(getattr(cloud, name), values)
    assert cloud.crs.to_epsg() == 2154 and cloud.reference.dtype == bool and not cloud.candidate.any()
    few = np.arange(400) < 200
    assert jf.PointCloud.from_arrays(FLAT, **given, candidate=few).candidate.tolist() == few.tolist()
    ticks = FLAT.astype(np.int32)
    assert jf.PointCloud.from_integers(ticks, np.ones(3), np.zeros(3), candidate=few).candidate.sum() == 200
    odd = FLAT.copy()
    odd[3] = np.nan
    with pytest.warns(jf.JaxfilterWarning):
        assert jf.PointCloud.from_arrays(odd, candidate=few, drop_invalid=True).candidate.sum() == 199
    for name in ("origin", "valid", "intensity"):
        with pytest.raises(jf.InputError, match=f"{name}= is no attribute.*classification.*candidate"):
            jf.PointCloud.from_arrays(FLAT, **{name: few})


@pytest.mark.parametrize(("given", "words"), [
    ({"return_number": np.full(400, 17)}, "return_number of point 0 is .*17.*from 0 to 15"),
    ({"number_of_returns": np.full(400, 16.0)}, "number_of_returns of point 0 is .*16.*from 0 to 15"),
    ({"classification": np.ones((400, 1), np.uint8)}, r"classification has shape \(400, 1\)"),
    ({"reference": np.ones((400, 1), bool)}, r"reference has shape \(400, 1\)"),
    ({"classification": 2}, r"classification has shape \(\)"),
    ({"classification": ["a"] * 400}, "classification is <U1"),
    ({"withheld": np.ones(400, "m8[s]")}, "withheld is timedelta64"),
    ({"reference": np.full(400, 2)}, "reference of point 0 is .*2.*True or False"),
    *[({"ignore_classes": value}, "ignore_classes=.*several whole numbers from 0 to 255")
      for value in (("a",), (300,), 2, None, "27", (2.5,), (True,), [[7]])],
    *[({"returns": value}, "returns=.*first, intermediate, last, only") for value in (None, 1, ["last"], b"last", "", "both")],
    ({"xyz": (1000 * FLAT).astype("m8[ms]")}, r"coordinates must be real numbers, not timedelta64\[ms\]"),
    ({"xyz": FLAT > 3}, "coordinates must be real numbers, not bool"),
])  # fmt: skip
def test_arguments_of_another_kind_are_named(given, words):
    classes = {"classification": np.zeros(400, np.uint8)}
    with pytest.raises(jf.InputError, match=words):
        jf.PointCloud.from_arrays(**{"xyz": FLAT, **classes, **given})
    if "ignore_classes" in given:
        with pytest.raises(jf.InputError, match=words):
            jf.read("no_such_file.las", **given)


@pytest.mark.parametrize(("shift", "units", "step"), [
    ((500_000, 6_050_000, 0), "m", "X, Y came as float32, which at 6050019 has steps of 0.5 m"),
    ((1000, 200_000, 0), "m", "Y came as float32.*0.0156 m"),
    ((1000, 200_000, 0), "ft", None), ((10_000, 60_000, 500), "m", None),
])  # fmt: skip
def test_coordinates_that_float32_does_not_resolve(shift, units, step):
    xyz = FLAT + shift
    fields = xyz.astype(np.float32).view([(axis, "f4") for axis in "XYZ"])[:, 0]
    for make in (lambda: jf.PointCloud.from_arrays(xyz.astype(np.float32), units=units),
                 lambda: jf.PointCloud.from_structured(fields, units=units)):  # fmt: skip
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            make()
        assert len(caught) == (step is not None)
        assert step is None or caught[0].message.args[0].startswith(("xyz: ", "array: "))
        if step is not None:
            with pytest.warns(jf.JaxfilterWarning, match=step):
                make()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jf.PointCloud.from_arrays(xyz, units=units)


@pytest.mark.parametrize("scale", [pytest.param(0.01, marks=pytest.mark.slow), 0.0001])
def test_tables_of_results_have_the_coordinates_of_the_file(tmp_path, scale):
    las = make_las(tmp_path / "in.laz", 6, "1.4", n=400)
    las.header.scales = np.full(3, scale)
    las.write(tmp_path / "in.laz")
    las = laspy.read(tmp_path / "in.laz")
    result = jf.SMRF()(jf.read(tmp_path / "in.laz", units="m", ignore_classes=()))
    table = result.to_pandas()
    for axis in "xyz":
        np.testing.assert_array_equal(table[axis], np.asarray(las[axis]))
    np.savetxt(tmp_path / "in.txt", np.column_stack([las.x, las.y, las.z]), fmt="%.5f")
    table = jf.SMRF()(jf.read(tmp_path / "in.txt")).to_pandas()
    np.testing.assert_array_equal(table[["x", "y", "z"]], np.loadtxt(tmp_path / "in.txt"))
    (tmp_path / "in.laz").unlink()
    with pytest.warns(jf.JaxfilterWarning, match=r"in.laz.*read it again.*to a millimetre"):
        np.testing.assert_allclose(result.to_pandas()["x"], np.asarray(las.x), atol=6e-4)


# odd clouds through the command; what each method does with them is in test_filters.py


PLACE = {"crs": 32632, "offsets": (440000.0, 4750000.0, 100.0), "scales": (0.01, 0.01, 0.001)}


def terrain(n=900, seed=0):
    """f64[n, 3]: a gentle hill on 30 x 30 m, with some points a few metres above it."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, 30, (n, 2)).round(2)
    z = 0.05 * xy[:, 0] + 2 * np.sin(xy[:, 1] / 12) + np.where(rng.random(n) < 0.2, rng.uniform(3, 6, n), 0)
    return np.column_stack([xy, z.round(2)])


def written(path, xyz, **fields):
    las_of(path, np.asarray(xyz) + PLACE["offsets"], **(PLACE | {"classification": 1} | fields))
    return path


def assert_warned(result, *words):
    assert result.exit_code == 0, result.output
    warnings = [line for line in result.stderr.splitlines() if line.startswith("warning: ")]
    assert any(all(word in line for word in words) for line in warnings), result.stderr


@pytest.mark.parametrize("name", ["in.las", "in.laz", "in.txt"])
def test_no_points(tmp_path, name):
    source = tmp_path / name
    if name == "in.txt":
        source.write_text("")
    else:
        make_las(source, 6, n=0)
    for target in ("out.las", "out.laz", "out.txt"):
        assert_warned(command("ground", "pmf", source, tmp_path / target), f"{name}: holds no points")
    assert [laspy.read(tmp_path / target).header.point_count for target in ("out.las", "out.laz")] == [0, 0]
    assert (tmp_path / "out.txt").read_text() == ""
    assert '"bounds": null' in command("info", source, "--json").stdout
    refused = command("dtm", source, tmp_path / "out.tif", "--bounds", 0, 0, 3, 2)
    assert refused.exit_code == 1 and "holds no points, so" in refused.stderr and not (tmp_path / "out.tif").exists()


@pytest.mark.parametrize("xyz, few", [
    ([[1, 2, 3]], True), ([[1, 2, 3], [4, 5, 6], [4, 5, 9]], True), ([[i, 2 * i, i % 2] for i in range(50)], True),
    ([[0, 0, 0], [9, 0, 1], [0, 9, 2], [9, 9, 1]], False),
])  # fmt: skip
def test_few_points_and_points_on_a_line(tmp_path, xyz, few):
    result = ground(written(tmp_path / "in.las", xyz))
    if not few:
        assert result.exit_code == 0 and "warning: " not in result.stderr
        return
    assert_warned(result, "fewer than four distinct positions, or all on a line")
    assert len(laspy.read(tmp_path / "out.las")) == len(xyz)


@pytest.mark.parametrize("fields", [{"classification": 7}, {"withheld": 1}])
def test_nothing_to_judge_leaves_the_points_as_they_are(tmp_path, fields):
    source = written(tmp_path / "in.las", terrain(), **fields)
    assert_warned(ground(source), "no point is a candidate")
    assert (tmp_path / "out.las").read_bytes() == source.read_bytes()


def test_a_stray_point_and_a_cell_that_is_too_fine(tmp_path):
    source = written(tmp_path / "in.las", np.append(terrain(), [[1e6, 1e6, 0]], axis=0))
    refused = command("ground", "smrf", source, tmp_path / "out.las")
    assert_error(refused, "in.las", "1000 x 1000 km", "1 of 901", "stray points", "--bounds")
    source = written(tmp_path / "fine.las", terrain() * [100, 100, 1])
    refused = command("ground", "smrf", source, tmp_path / "out.laz", "--cell", "0.02")
    assert_error(refused, "cell", "GiB")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fine.las", "in.las"]


def numeric(*commands):
    """Each option that takes numbers once, of the first of these commands that has it, and how many it takes."""
    seen = {}
    for name in commands:
        command = main.commands[name] if name in main.commands else layer_command(name)
        command = ground_command(None) if name == "ground" else command
        for option in command.params:
            words = (click.types.StringParamType, click.Path, click.Choice, click.types.BoolParamType)
            if isinstance(option, click.Option) and not option.is_flag and not isinstance(option.type, words):
                seen.setdefault(option.opts[0], (name, option.nargs))
    return seen


def test_no_number_gives_a_raw_error(tmp_path):
    """Every option that takes numbers, but those of methods: see ``test_numbers_that_overflow_are_refused``."""
    source = written(tmp_path / "in.las", terrain(300) * [1, 1, 0], classification=2)
    options = numeric("contours", "voids", "dsm", "hillshade", "height", "ground", "report")
    assert {"--cell", "--interval", "--distance", "--gap", "--tile", "--halo", "--workers", "--bounds"} < set(options)
    targets = {"contours": "o.gpkg", "height": "o.las", "ground": "o.las", "report": "o.html"}
    for option, (name, count) in options.items():
        target = tmp_path / targets.get(name, "o.tif")
        for value in ("1e300", "1e-300", "5e-324", "-1", "nan", "inf", "1e9", "1e-9", "1" + "0" * 40, "1" + "0" * 400):
            numbers = [value] * count if count < 4 else [f"-{value.lstrip('-')}"] * 2 + [value.lstrip("-")] * 2
            result = command(name, source, target, "--overwrite", option, *numbers)
            told = f"{name} {option} {value[:9]}: {result.stderr[-300:]}"
            assert result.exception is None or isinstance(result.exception, SystemExit), told
            assert result.exit_code in (0, 1, 2), told
            assert not re.search(r"^Error: [\w.]*(Error|Exception|Warning)\b", result.stderr, re.MULTILINE), told
