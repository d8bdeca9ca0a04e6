"""An area of interest: what is written are its points, with the labels, heights and cells of the whole survey."""

from __future__ import annotations

import sqlite3

import geopandas
import laspy
import numpy as np
import pyproj
import pytest
import shapely
from commands import run
from las_files import make_las

import jaxfilter as jf
from jaxfilter.files import vectors

pytestmark = pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
SMRF = jf.SMRF(window=8.0)
HOW = {"tile": 60.0, "wide_halos": True, "workers": 1}


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """Four files of a town, in a UTM zone."""
    folder = tmp_path_factory.mktemp("survey")
    scene = jf.scenes.make("town", size=(160.0, 120.0), density=1.0, seed=5)
    xyz = scene.cloud.coordinates()
    x, y = xyz[:, 0] - xyz[:, 0].min(), xyz[:, 1] - xyz[:, 1].min()
    for name in ("sw", "se", "nw", "ne"):
        rows = ((x < 80) == ("w" in name)) & ((y < 60) == ("s" in name))
        las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
        las.header.add_crs(pyproj.CRS.from_epsg(25832))
        las.header.scales, las.header.offsets = np.full(3, 0.01), np.floor(xyz.min(axis=0))
        las.x, las.y, las.z = xyz[rows].T
        las.gps_time = np.flatnonzero(rows).astype(float)
        las.write(folder / f"{name}.laz")
    return folder


@pytest.fixture(scope="module")
def patch(survey):
    """40 m of the south-west."""
    x, y = jf.open(survey).bounds[:2]
    return geopandas.GeoSeries([shapely.box(x, y, x + 40, y + 40)], crs=25832)


@pytest.fixture(scope="module")
def area(survey):
    """Two triangles and a hole, none in the north-east."""
    x, y = jf.open(survey).bounds[:2]
    outer = shapely.Polygon([(x + 10, y + 5), (x + 150, y + 8), (x + 30, y + 100)])
    hole = shapely.box(x + 45, y + 20, x + 60, y + 35)
    return shapely.MultiPolygon([*shapely.get_parts(outer - hole), shapely.box(x + 120, y + 40, x + 135, y + 55)]) & (
        shapely.box(x, y, x + 160, y + 120) - shapely.box(x + 79, y + 59, x + 170, y + 130)
    )


def points(folder):
    files = sorted(folder.glob("*.laz"))
    return {path.name: laspy.read(path) for path in files}


def test_labels_heights_and_cells_are_those_of_the_whole(survey, area, tmp_path):
    for folder, reading in (("whole", jf.Reading()), ("part", jf.Reading(aoi=area))):
        how, out = {"run": jf.RunOptions(**HOW), "reading": reading}, tmp_path / folder
        jf.products(survey, out, SMRF, only=("dtm", "chm"), **how)
        jf.heights(survey, out / "heights", SMRF, **how)
    report = jf.ground(survey, tmp_path / "ground", SMRF, review=tmp_path / "places.gpkg", **how)
    for name in ("classified", "heights"):
        whole, part = points(tmp_path / "whole" / name), points(tmp_path / "part" / name)
        assert set(part) == {"sw.laz", "se.laz", "nw.laz"} and report.complete, "no tile of the fourth is wanted"
        assert report.points == sum(len(las) for las in part.values())
        for file, las in part.items():
            inside = shapely.intersects_xy(area, whole[file].x, whole[file].y)
            edge = shapely.distance(area.boundary, shapely.points(whole[file].x, whole[file].y)) < 0.002
            written = np.isin(whole[file].gps_time, las.gps_time)
            np.testing.assert_array_equal(written[~edge], inside[~edge])
            assert 0.05 < inside.mean() < 0.95 and edge.sum() < 9
            assert len(las) == written.sum() == las.header.point_count
            np.testing.assert_array_equal(las.points.array, whole[file].points[written].array)
            np.testing.assert_array_equal(las.header.maxs, np.max(las.xyz, axis=0))
            assert (
                name == "heights"
                or (tmp_path / f"ground/{file}").read_bytes() == (tmp_path / f"part/classified/{file}").read_bytes()
            )
    places = geopandas.read_file(tmp_path / "places.gpkg")
    assert len(places) == 0 or (places.distance(area) < 3).all()
    for name in ("dtm", "chm"):
        whole, part = (jf.Raster.read(tmp_path / folder / f"{name}.tif") for folder in ("whole", "part"))
        left, bottom, right, top = part.bounds
        assert part.bounds == pytest.approx((*np.floor(area.bounds[:2]), *np.ceil(area.bounds[2:])))
        west, _, _, north = whole.bounds
        cut = whole.values[int(north - top) : int(north - bottom), int(left - west) : int(right - west)]
        inside = shapely.intersects_xy(area, *np.meshgrid(*part.centres()))
        np.testing.assert_array_equal(part.values[inside], cut[inside])
        assert np.isnan(part.values[~inside]).all() and np.isfinite(part.values[inside]).mean() > 0.9
        assert name == "chm" or np.isfinite(part.values[inside]).mean() > 0.95


def test_an_area_in_another_system_is_transformed_and_one_that_is_broken_is_repaired(survey, tmp_path):
    x, y = jf.open(survey).bounds[:2]
    box = geopandas.GeoSeries([shapely.box(x + 10, y + 10, x + 50, y + 50)], crs=25832)
    box.to_crs(4326).to_file(tmp_path / "degrees.gpkg")
    tie = shapely.Polygon([(x + 10, y + 10), (x + 50, y + 50), (x + 50, y + 10), (x + 10, y + 50)])
    geopandas.GeoSeries([tie], crs=25832).to_file(tmp_path / "tie.geojson", driver="GeoJSON")
    with pytest.warns(jf.JaxfilterWarning, match=r"degrees.gpkg: transformed from WGS 84 to ETRS89 / UTM zone 32N"):
        jf.ground(survey / "sw.laz", tmp_path / "a.laz", SMRF, reading=jf.Reading(aoi=tmp_path / "degrees.gpkg"))
    with pytest.warns(jf.JaxfilterWarning, match="tie.geojson: Self-intersection.*repaired"):
        jf.ground(survey / "sw.laz", tmp_path / "b.laz", SMRF, reading=jf.Reading(aoi=tmp_path / "tie.geojson"))
    whole = laspy.read(survey / "sw.laz")
    assert len(laspy.read(tmp_path / "a.laz")) == shapely.intersects_xy(box[0].buffer(1e-4), whole.x, whole.y).sum()
    assert 0.4 < len(laspy.read(tmp_path / "b.laz")) / len(laspy.read(tmp_path / "a.laz")) < 0.6, "half of the box"


def test_areas_that_cannot_be_are_named(survey, tmp_path):
    (tmp_path / "bad.gpkg").write_text("no polygons")
    geopandas.GeoSeries([shapely.Point(1, 2)], crs=25832).to_file(tmp_path / "point.gpkg")
    geopandas.GeoSeries([shapely.box(0, 0, 9, 9)], crs=25832).to_file(tmp_path / "far.gpkg")
    make_las(tmp_path / "none.las", 6, crs=None)
    (tmp_path / "one.xyz").write_text("440000 4750000 1\n")
    for source, aoi, words in (
        (survey, "bad.gpkg", "cannot be read as polygons"),
        (survey, "point.gpkg", "holds no polygon"),
        (survey, "far.gpkg", "lies beside the points"),
        (tmp_path / "none.las", "far.gpkg", r"is not known: pass --crs"),
        (tmp_path / "one.xyz", "far.gpkg", "text is cut by bounds only"),
    ):
        result = run("ground", "smrf", source, tmp_path / "out", "--aoi", tmp_path / aoi)
        assert result.exit_code and words in result.stderr.splitlines()[-1], result.stderr
        assert not (tmp_path / "out").exists()
    for make in (
        lambda **how: jf.ground(survey, tmp_path / "o", SMRF, **how),
        lambda **how: jf.terrain_model(survey, tmp_path / "o.tif", **how),
    ):
        with pytest.raises(jf.ParameterError, match="leave out one of them"):
            make(reading=jf.Reading(aoi=tmp_path / "far.gpkg", bounds=(0, 0, 1, 1)))
    with pytest.raises(jf.ParameterError, match="in_place=True would remove"):
        jf.ground(survey, None, SMRF, reading=jf.Reading(aoi=tmp_path / "far.gpkg"), run=jf.RunOptions(in_place=True))


ENDLESS = (
    "WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c) SELECT n AS fid, g.geom FROM c, aoi g WHERE n < 0"
)
COMPUTED = "ALTER TABLE aoi ADD COLUMN q TEXT GENERATED ALWAYS AS (hex(zeroblob(400000000))) VIRTUAL"
POINTER = '<OGRVRTDataSource><OGRVRTLayer name="aoi"><SrcDataSource>{}</SrcDataSource></OGRVRTLayer></OGRVRTDataSource>'


@pytest.mark.parametrize(
    "spoil, words",
    [
        (f"CREATE VIEW v AS {ENDLESS}; UPDATE gpkg_contents SET table_name = 'v'; "
         "UPDATE gpkg_geometry_columns SET table_name = 'v'", "v is a view"),
        ("ALTER TABLE gpkg_contents RENAME TO g; CREATE VIEW gpkg_contents AS SELECT g.* FROM g, "
         "(WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c) SELECT n FROM c WHERE n < 0)",
         "gpkg_contents is a view"),
        (COMPUTED, "aoi is a view, or has computed columns"),
        ("ALTER TABLE aoi ADD COLUMN q TEXT; UPDATE aoi SET q = hex(zeroblob(1000000))", "more than 1 MB"),
    ],
)  # fmt: skip
def test_what_has_no_bound_in_a_database_is_refused(survey, patch, tmp_path, monkeypatch, spoil, words):
    monkeypatch.setattr(vectors, "_MOST", 1 << 20)
    patch.to_file(tmp_path / "aoi.gpkg", layer="aoi")
    assert len(vectors.read_shapes(tmp_path / "aoi.gpkg", "polygons")) == 1
    base = sqlite3.connect(tmp_path / "aoi.gpkg")
    for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
        base.execute(f"DROP TRIGGER {name}")  # they call functions that are GDAL's own
    base.executescript(spoil)
    base.commit()
    base.close()
    with pytest.raises(jf.InputError, match=rf"aoi\.gpkg: cannot be read as polygons: .*{words}"):
        jf.ground(survey, tmp_path / "out", SMRF, reading=jf.Reading(aoi=tmp_path / "aoi.gpkg"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["aoi.vrt", "aoi.gpkg", "aoi.geojson", "aoi.gdalg.json"])
def test_files_that_name_others_are_not_followed(survey, patch, tmp_path, name):
    patch.to_file(tmp_path / "own.gpkg", layer="aoi")
    command = (
        f'{{"type": "gdal_streamed_alg", "command_line": "gdal vector pipeline ! read {tmp_path}/own.gpkg ! write x"}}'
    )
    (tmp_path / name).write_text(command if "gdalg" in name else POINTER.format(tmp_path / "own.gpkg"))
    with pytest.raises(jf.InputError, match="packs or names other files"):
        jf.ground(survey, tmp_path / "out", SMRF, reading=jf.Reading(aoi=tmp_path / name))


def test_an_archive_is_refused_and_a_shapefile_is_read(patch, tmp_path):
    patch.to_file(tmp_path / "aoi.shp.zip", driver="ESRI Shapefile")
    with pytest.raises(jf.InputError, match=r"aoi\.shp\.zip: .*packs or names"):
        vectors.read_shapes(tmp_path / "aoi.shp.zip", "polygons")
    patch.to_file(tmp_path / "aoi.shp")
    assert shapely.equals(vectors.read_shapes(tmp_path / "aoi.shp", "polygons").geometry[0], patch[0])


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("kind", ["file", "table", "series"])
def test_coordinates_that_are_none_are_named(survey, patch, tmp_path, number, kind):
    (x, y), good = patch.total_bounds[:2], patch[0]
    bad = shapely.Polygon([(x, y), (x + 9, y), (number, y + 9), (x, y + 9)])
    table = geopandas.GeoDataFrame(geometry=[good, bad], crs=25832, index=[7, 7])
    table.to_file(tmp_path / "aoi.gpkg")
    given = {"file": tmp_path / "aoi.gpkg", "table": table, "series": table.geometry.iloc[1:]}[kind]
    row = 1 if kind == "series" else 2
    with pytest.raises(jf.InputError, match=rf"aoi.*: feature {row} has NaN, infinite or far coordinates"):
        jf.ground(survey, tmp_path / "out", SMRF, reading=jf.Reading(aoi=given))


@pytest.mark.parametrize("wkt", [
    'LOCAL_CS["x",UNIT["metre",1]]',
    'ENGCRS["x",EDATUM["d"],CS[Cartesian,2],AXIS["e",east],AXIS["n",north],LENGTHUNIT["metre",1]]',
])  # fmt: skip
def test_a_system_that_leads_nowhere_is_named(survey, patch, tmp_path, wkt):
    local = patch.set_crs(pyproj.CRS(wkt), allow_override=True)
    with pytest.raises(jf.InputError, match="aoi: there is no way from x to ETRS89 / UTM zone 32N: save it in that"):
        jf.ground(survey, tmp_path / "out", SMRF, reading=jf.Reading(aoi=local))
    las = laspy.read(survey / "sw.laz")
    las.header.vlrs.extract("WktCoordinateSystemVlr")
    las.header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
    las.write(tmp_path / "local.laz")
    with pytest.raises(jf.InputError, match="aoi: there is no way from ETRS89 / UTM zone 32N to x"):
        jf.ground(tmp_path / "local.laz", tmp_path / "out.laz", SMRF, reading=jf.Reading(aoi=patch))
    assert jf.ground(tmp_path / "local.laz", tmp_path / "out.laz", SMRF, reading=jf.Reading(aoi=local)).complete
