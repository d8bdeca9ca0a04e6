"""An area of interest: what is written are its points, with the labels, heights and cells of the whole survey."""

from __future__ import annotations

import geopandas
import laspy
import numpy as np
import pyproj
import pytest
import shapely
from click.testing import CliRunner
from las_files import make_las

import jaxfilter as jf
from jaxfilter.cli import main

pytestmark = [
    pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning"),
]
SMRF = jf.SMRF(window=8.0)
HOW = {"tile": 60.0, "wide_halos": True, "workers": 1}


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """Four files of a town, in a UTM zone."""
    folder = tmp_path_factory.mktemp("survey")
    scene = jf.scenes.make("town", size=(160.0, 120.0), density=1.5, seed=5)
    xyz = scene.cloud.coordinates()
    x, y = xyz[:, 0] - xyz[:, 0].min(), xyz[:, 1] - xyz[:, 1].min()
    for name, rows in (
        ("sw", (x < 80) & (y < 60)), ("se", (x >= 80) & (y < 60)), ("nw", (x < 80) & (y >= 60)), ("ne", (x >= 80) & (y >= 60)),
    ):  # fmt: skip
        las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
        las.header.add_crs(pyproj.CRS.from_epsg(25832))
        las.header.scales, las.header.offsets = np.full(3, 0.01), np.floor(xyz.min(axis=0))
        las.x, las.y, las.z = xyz[rows].T
        las.gps_time = np.flatnonzero(rows).astype(float)
        las.write(folder / f"{name}.laz")
    return folder


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
    run, reading = jf.RunOptions(**HOW), jf.Reading(aoi=area)
    for name, make in (
        ("ground", lambda out, **how: jf.ground(survey, out, SMRF, review=out.with_suffix(".gpkg"), **how)),
        ("heights", lambda out, **how: jf.heights(survey, out, SMRF, **how)),
    ):
        make(tmp_path / f"{name}-whole", run=run)
        report = make(tmp_path / f"{name}-part", run=run, reading=reading)
        whole, part = points(tmp_path / f"{name}-whole"), points(tmp_path / f"{name}-part")
        assert set(part) == {"sw.laz", "se.laz", "nw.laz"} and report.complete, "no tile of the fourth is wanted"
        assert report.points == sum(len(las) for las in part.values())
        for file, las in part.items():
            inside = shapely.intersects_xy(area, whole[file].x, whole[file].y)
            edge = shapely.distance(area.boundary, shapely.points(whole[file].x, whole[file].y)) < 0.002
            written = np.isin(whole[file].gps_time, las.gps_time)
            np.testing.assert_array_equal(written[~edge], inside[~edge])
            assert (
                0.05 < inside.mean() < 0.95 and len(las) == written.sum() == las.header.point_count and edge.sum() < 9
            )
            np.testing.assert_array_equal(las.points.array, whole[file].points[written].array)
            np.testing.assert_array_equal(las.header.maxs, np.max(las.xyz, axis=0))
    places = geopandas.read_file(tmp_path / "ground-part.gpkg")
    assert len(places) == 0 or (places.distance(area) < 3).all()
    jf.terrain_model(survey, tmp_path / "whole.tif", SMRF, run=run)
    jf.terrain_model(survey, tmp_path / "part.tif", SMRF, run=run, reading=reading)
    whole, part = (jf.Raster.read(tmp_path / f"{name}.tif") for name in ("whole", "part"))
    assert part.bounds == pytest.approx(
        [f(v) for f, v in zip((np.floor,) * 2 + (np.ceil,) * 2, area.bounds, strict=True)]
    )
    (a, b, c, d), (west, _, _, north) = part.bounds, (whole.bounds[0], 0, 0, whole.bounds[3])
    cut = whole.values[int(north - d) : int(north - b), int(a - west) : int(c - west)]
    cx, cy = np.meshgrid(*part.centres())
    inside = shapely.intersects_xy(area, cx, cy)
    np.testing.assert_array_equal(part.values[inside], cut[inside])
    assert np.isnan(part.values[~inside]).all() and np.isfinite(part.values[inside]).mean() > 0.95


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
        arguments = ["ground", "smrf", source, tmp_path / "out", "--aoi", tmp_path / aoi]
        result = CliRunner().invoke(main, [str(one) for one in arguments])
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
