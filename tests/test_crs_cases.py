"""Coordinate reference systems as files state them: in three dimensions, by parameters, in other records, twice, and with
heights of several datums."""

import struct
import warnings

import laspy
import numpy as np
import pyogrio
import pyproj
import pytest
import rasterio
from commands import done, run
from las_files import las_of

import jaxfilter as jf

UTM = pyproj.CRS(32631).to_wkt("WKT1_GDAL")
VERT = 'VERT_CS["{}",VERT_DATUM["{}",{}],UNIT["metre",1],AXIS["Up",UP]]'
DATUM = 'DATUM["D_WGS_1984",SPHEROID["WGS_1984",6378137.0,298.257223563]]'
ESRI = f'VERTCS["WGS_1984",{DATUM},PARAMETER["Vertical_Shift",0.0],PARAMETER["Direction",1.0],UNIT["Meter",1.0]]'
FOOT = 1200 / 3937


def file_with(path, *records, evlrs=(), point_format=6, wkt_bit=True, east=0.0):
    """A slope of ground whose file has these records, (number, content); text stands for WKT."""
    x, y = (axis.ravel() for axis in np.mgrid[0:20, 0:20] + 0.25)
    xyz = np.column_stack([500_000 + x + east, 5_400_000 + y, 100 + 0.3 * x])
    las = las_of(None, xyz, point_format, classification=2)
    las.header.global_encoding.wkt = wkt_bit
    las.evlrs = laspy.vlrs.vlrlist.VLRList()
    for place, given in ((las.vlrs, records), (las.evlrs, evlrs)):
        for record in given:
            number, data = (2112, record.encode() + b"\0") if isinstance(record, str) else record
            place.append(laspy.VLR("LASF_Projection", number, "", data))
    las.write(path)
    return path


def geokeys(keys, doubles=()):
    """The records of GeoTIFF keys; those of a list are parameters."""
    entries = [(key, 0, 1, value) for key, value in keys.items()]
    entries += [(key, 34736, 1, at) for at, (key, _) in enumerate(doubles)]
    entries.sort()
    table = b"".join(struct.pack("<4H", *entry) for entry in [(1, 1, 0, len(entries)), *entries])
    values = struct.pack(f"<{len(doubles)}d", *(value for _, value in doubles))
    return [(34735, table), *([(34736, values)] if doubles else [])]


def crs_of(path):
    if path.suffix == ".tif":
        with rasterio.open(path) as file:
            return None if file.crs is None else pyproj.CRS.from_wkt(file.crs.to_wkt())
    return pyproj.CRS.from_user_input(pyogrio.read_info(path)["crs"])


def model_of(path):
    """What the command says, and the CRS of the model it makes."""
    result = run("dtm", path, path.with_suffix(".tif"))
    assert result.exit_code == 0, result.output
    return result.stderr, crs_of(path.with_suffix(".tif"))


@pytest.mark.parametrize("text, code", [
    (pyproj.CRS(25832).to_3d().to_wkt(), 25832),
    (pyproj.CRS(2225).to_3d().to_wkt(), 2225),
    (f'COMPD_CS["both",{UTM},{VERT.format("Ellipsoid (metre)", "Ellipsoid", 2002)}]', 32631),
    (f'{pyproj.CRS(32631).to_wkt("WKT1_ESRI")},{ESRI}', 32631),
    (f'COMPD_CS["local",{UTM},{VERT.format("Local", "Local datum", 2005)}]', 32631),
])  # fmt: skip
def test_outputs_state_the_horizontal_system_and_what_is_lost_is_said_once(tmp_path, text, code):
    for number in range(2):
        (tmp_path / "in").mkdir(exist_ok=True)
        file_with(tmp_path / "in" / f"{number}.las", text, east=20.0 * number)
    result = run("products", tmp_path / "in", tmp_path / "out")
    assert result.exit_code == 0 and result.stderr.count("cannot state its heights") == 1, result.output
    made = [path for path in (tmp_path / "out").iterdir() if path.suffix in (".tif", ".gpkg")]
    assert len(made) > 4 and {crs_of(path).to_epsg() for path in made} == {code}
    cloud = jf.read(tmp_path / "in" / "0.las")
    with pytest.warns(jf.JaxfilterWarning, match="cannot state its heights"):
        jf.contours(jf.dtm(cloud, np.ones(len(cloud), bool)), 1.0, tmp_path / "lines.geojson")
    assert crs_of(tmp_path / "lines.geojson").to_epsg() == code


PLAIN = {1024: 1, 3072: 32767}
OREGON = pyproj.CRS(
    "+proj=lcc +lat_0=41.666666667 +lon_0=-120.5 +lat_1=44 +lat_2=42.66666667 +x_0=1500003.048006096 +datum=NAD83 +units=us-ft"
)
TM = [(3080, 9.0), (3081, 0.0), (3082, 500000.0), (3083, 0.0), (3092, 0.9996)]
LAMBERT = [(3078, 44.0), (3079, 42.66666667), (3084, -120.5), (3085, 41.666666667), (3086, 4921260.0), (3087, 0.0)]


@pytest.mark.parametrize("keys, doubles, crs", [
    (PLAIN | {2048: 4258, 3074: 16032, 3076: 9003}, [], "+proj=utm +zone=32 +ellps=GRS80 +units=us-ft"),
    (PLAIN | {2048: 4269, 3074: 32767, 3075: 8, 3076: 9003}, LAMBERT, OREGON),
    (PLAIN | {2048: 4326, 3074: 32767, 3075: 1, 3076: 9001}, TM, 32632),
    ({3072: 32632, 3076: 9003}, [], "+proj=utm +zone=32 +datum=WGS84 +units=us-ft"),
])  # fmt: skip
@pytest.mark.filterwarnings("ignore:.*its key of linear units says")
def test_keys_with_parameters_become_the_crs_of_outputs(tmp_path, keys, doubles, crs):
    path = file_with(tmp_path / "in.las", *geokeys(keys, doubles), point_format=1, wkt_bit=False)
    said, made = model_of(path)
    assert "not understood" not in said and "metres are assumed" not in said
    expected = pyproj.CRS.from_user_input(crs)
    there = pyproj.Transformer.from_crs(made, expected, always_xy=True).transform(1.5e6, 5.4e5)
    np.testing.assert_allclose(there, (1.5e6, 5.4e5), atol=2e-3)
    assert jf.read(path).units.xy == pytest.approx(expected.axis_info[0].unit_conversion_factor)
    assert jf.read(laspy.read(path)).crs == jf.read(path).crs


@pytest.mark.parametrize("keys, unit", [
    (PLAIN | {3076: 9003}, FOOT), (PLAIN | {3074: 32767, 3075: 1, 3076: 9003}, FOOT), ({1024: 1, 3072: 3, 3076: 9003}, FOOT),
    (PLAIN | {3074: 16032, 3076: 9001}, 1),  # of no datum
    ({1024: 1, 3072: 26915, 4096: 32767, 4099: 9001}, 1), ({1024: 1, 3072: 26915, 4096: 4326}, 1),
])  # fmt: skip
def test_keys_that_are_not_understood_are_said_and_their_units_hold(tmp_path, keys, unit):
    path = file_with(tmp_path / "in.las", *geokeys(keys), point_format=1, wkt_bit=False)
    said, made = model_of(path)
    assert said.count("in.las: its GeoTIFF keys state") == said.count("not understood") == 1
    assert (made and made.to_epsg()) == (26915 if 4096 in keys else None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert jf.read(path).units.xy == pytest.approx(unit)


@pytest.mark.parametrize("keys, datum, unit", [
    ({3072: 26915, 4096: 5703}, "North American Vertical Datum 1988", 1),
    ({3072: 2225, 4096: 5703, 4099: 9003}, "North American Vertical Datum 1988", FOOT),
    ({3072: 2225, 4096: 5102}, "National Geodetic Vertical Datum 1929", FOOT),  # as GeoTIFF 1.0 has it
    ({3072: 26915, 4096: 32767, 4098: 5103, 4099: 9002}, "North American Vertical Datum 1988", 0.3048),
    ('VERT_CS["h",VERT_DATUM["NAVD88",2005],UNIT["foot_us",0.3048006]]', "North American Vertical Datum 1988", FOOT),
    ('VERT_CS["h",VERT_DATUM["Normaal Amsterdams Peil",2005],UNIT["m",1]]', "Normaal Amsterdams Peil", 1),
])  # fmt: skip
def test_datum_and_unit_of_heights_reach_the_raster(tmp_path, keys, datum, unit):
    records = [f'COMPD_CS["both",{UTM},{keys}]'] if isinstance(keys, str) else geokeys({1024: 1} | keys)
    said, made = model_of(file_with(tmp_path / "in.las", *records, point_format=1, wkt_bit=isinstance(keys, str)))
    heights = made.sub_crs_list[1]
    assert "warning" not in said and heights.datum.name == datum
    assert heights.axis_info[0].unit_conversion_factor == pytest.approx(unit, rel=1e-7)


@pytest.mark.parametrize("number, extended", [(4224, False), (4224, True), (2112, True)])
def test_wkt_in_other_records(tmp_path, number, extended):
    record = (number, pyproj.CRS("EPSG:25832+7837").to_wkt().encode() + b"\0")
    path = file_with(tmp_path / "in.las", *[record] * (not extended), evlrs=[record] * extended)
    said, made = model_of(path)
    assert "warning" not in said and made.name == "ETRS89 / UTM zone 32N + DHHN2016 height"
    assert jf.read(laspy.read(path)).crs == jf.read(path).crs


@pytest.mark.parametrize("point_format, bit, text, keys, used, words", [
    (6, True, 25832, {3072: 26915}, 25832, "WKT is ETRS89 / UTM zone 32N, that of its GeoTIFF keys is NAD83 / UTM zone 15N"),
    (1, True, 25832, {3072: 26915}, 25832, "WKT is ETRS89 / UTM zone 32N, that of its GeoTIFF keys is NAD83 / UTM zone 15N"),
    (1, False, 25832, {3072: 26915}, 26915, "GeoTIFF keys is NAD83 / UTM zone 15N, that of its WKT is ETRS89 / UTM zone 32N"),
    (1, False, "EPSG:26915+5703", {3072: 26915, 4096: 7968}, "EPSG:26915+7968", "NGVD29 height (m), that of its WKT is NAVD88"),
    (1, True, 26915, {3076: 9003}, 26915, "metre, that of its GeoTIFF keys is US survey foot"),
    (1, False, 26915, {3072: 26915, 4096: 5703}, "EPSG:26915+5703", ""),
    (1, False, "EPSG:26915+5703", {3072: 26915}, "EPSG:26915+5703", ""),
])  # fmt: skip
def test_wkt_and_keys_that_contradict_one_another(tmp_path, point_format, bit, text, keys, used, words):
    wkt = pyproj.CRS.from_user_input(text).to_wkt("WKT1_GDAL")
    path = file_with(tmp_path / "in.las", wkt, *geokeys({1024: 1} | keys), point_format=point_format, wkt_bit=bit)
    said, made = model_of(path)
    assert made.name == pyproj.CRS.from_user_input(used).name
    assert words in said and said.count("warning: ") == said.count("in.las: the CRS of its") == bool(words)


@pytest.mark.parametrize("point_format, text", [(1, None), (1, 25832), (6, 25832)])
def test_heights_that_are_stated_for_files_without_them_reach_all_outputs(tmp_path, point_format, text):
    """LAS 1.2 holds them as GeoTIFF keys, LAS 1.4 as WKT. The other records of the CRS go."""
    records = [] if text is None else geokeys({1024: 1, 3072: text})
    if point_format == 6:
        records = [pyproj.CRS(text).to_wkt("WKT1_GDAL")]
    path = file_with(tmp_path / "in.las", *records, point_format=point_format, wkt_bit=point_format == 6)
    stated = "EPSG:25832+7837"
    done("ground", "pmf", path, tmp_path / "out.las", "--crs", stated, "-q")
    done("dtm", path, tmp_path / "out.tif", "--filter", "pmf", "--crs", stated, "-q")
    name = "ETRS89 / UTM zone 32N + DHHN2016 height"
    assert jf.open(tmp_path / "out.las").crs.name == jf.Raster.read(tmp_path / "out.tif").crs.name == name
    records = laspy.read(tmp_path / "out.las").header.vlrs
    assert sum(record.user_id == "LASF_Projection" for record in records) == 1


def test_heights_that_an_extended_record_does_not_take_are_not_lost_in_silence(tmp_path):
    record = (2112, pyproj.CRS(25832).to_wkt().encode() + b"\0")
    path = file_with(tmp_path / "in.las", evlrs=[record])
    cloud = jf.read(path, crs="EPSG:25832+7837")
    with pytest.warns(jf.JaxfilterWarning, match="out.las: the heights of its CRS are not written.*extended record"):
        jf.write(tmp_path / "out.las", cloud, jf.PMF()(cloud))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jf.write(tmp_path / "flat.las", flat := jf.read(path), jf.PMF()(flat))


NAVD, NGVD = "EPSG:26915+5703", "EPSG:26915+7968"
PLAIN_NGVD = VERT.format("NGVD29", "National_Geodetic_Vertical_Datum_1929", 2005)
FLAT = pyproj.CRS(26915).to_wkt("WKT1_GDAL")


@pytest.mark.parametrize("one, other, words", [
    (NAVD, NGVD, "NAVD88 height, .*NGVD29 height"),
    (NAVD, f'COMPD_CS["x",{FLAT},{PLAIN_NGVD}]', "NAVD88 height, .*NGVD29"),
    (NAVD, pyproj.CRS(26915).to_3d(), "NAVD88 height, .*ellipsoidal height"),
    (NAVD, f'COMPD_CS["x",{FLAT},{VERT.format("Local", "Local datum", 2005)}]', "NAVD88 height, .*Local"),
    (NAVD, f'COMPD_CS["x",{FLAT},{VERT.format("Geoid 18", "NAVD88", 2005)}]', None),
    (FLAT, NAVD, None), (pyproj.CRS(26915).to_3d(), FLAT, None),
])  # fmt: skip
def test_heights_of_several_datums_are_no_survey(tmp_path, one, other, words):
    for number, crs in enumerate((one, other)):
        file_with(tmp_path / f"{number}.las", pyproj.CRS.from_user_input(crs).to_wkt("WKT2_2019"), east=20.0 * number)
    survey = jf.open(tmp_path)
    assert (survey.check().mixed is None) == (words is None)
    commands = [("ground", "smrf", tmp_path, tmp_path / "out"), ("dtm", tmp_path, tmp_path / "dtm.tif")]
    results = [run(*arguments) for arguments in commands]
    assert [result.exit_code for result in results] == [int(words is not None)] * 2
    if words is None:
        assert survey.crs.name.partition(" + ")[0] == "NAD83 / UTM zone 15N" and ("NAVD88" in survey.crs.name) == (
            NAVD in (one, other)
        )
        return
    with pytest.raises(jf.InputError, match=f"0.las is in {words}"):
        _ = survey.units
    with pytest.raises(jf.InputError, match="states another CRS"):
        jf.read(tmp_path / "1.las", crs=one)


def test_heights_alone_do_not_state_units(tmp_path):
    file_with(tmp_path / "in.las", pyproj.CRS(7837).to_wkt("WKT1_GDAL"))
    with pytest.warns(jf.JaxfilterWarning, match=r"in.las: no CRS states the units, metres are assumed"):
        jf.ground(tmp_path / "in.las", tmp_path / "out.las", jf.SMRF())
