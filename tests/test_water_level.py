"""The level of water in terrain models and breaklines: against what is written down here, and of tiles against the whole."""

from __future__ import annotations

import math

import geopandas
import numpy as np
import pytest
import shapely
from commands import done
from las_files import las_of

import jaxfilter as jf
from jaxfilter.surveys.tiles import part_of
from jaxfilter.terrain.levels import levels_in

pytestmark = pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
METRES = jf.Reading(units="m")
CORNER = np.array([512000.0, 5403000.0, 0.0])


def course(x: np.ndarray) -> np.ndarray:
    """Metres north of the corner: the middle of the river of :func:`valley`."""
    return 150 + 40 * np.sin(x / 80)


def valley(fall: float, seed: int = 0) -> jf.PointCloud:
    """A river, 24 m wide, that bends and falls to the east by ``fall``, rise over run; 30 % of its pulses come back."""
    rng = np.random.default_rng(seed)
    x, y = rng.random((2, 30_000)) * [[400.0], [300.0]]
    away = abs(y - course(x)) / np.hypot(1, 0.5 * np.cos(x / 80))
    z = 100 - fall * x + 0.02 * rng.standard_normal(len(x)) + np.where(away < 12, 0, 2 + 0.05 * away)
    kept = (away >= 12) | (rng.random(len(x)) < 0.3)
    classes = np.where(away < 12, 9, 2).astype(np.uint8)
    return jf.PointCloud.from_arrays(
        np.column_stack([x, y, z])[kept] + CORNER, classification=classes[kept], reference=away[kept] >= 12
    )


def test_a_river_falls_along_its_course_and_is_level_across():
    cloud = valley(0.005)
    levels = levels_in(cloud, None, cloud.reference)
    assert levels is not None
    x = np.arange(5.0, 395.0)
    middle = levels.at(x + CORNER[0], course(x) + CORNER[1])
    assert (np.diff(middle) <= 1e-9).all()  # it never rises on the way down
    assert np.abs(middle - (100 - 0.005 * x)).max() < 0.05
    slope = 0.5 * np.cos(x / 80)
    across = [
        levels.at(x + CORNER[0] - slope * k / np.hypot(1, slope), course(x) + CORNER[1] + k / np.hypot(1, slope))
        for k in (-8, 0, 8)
    ]
    assert np.nanmax(np.ptp(across, axis=0)) < 0.08  # 16 m along it are as much
    (outline,) = jf.breaklines(cloud).itertuples()
    corners = shapely.get_coordinates(outline.geometry, include_z=True) - CORNER
    assert np.abs(corners[:, 2] - (100 - 0.005 * corners[:, 0])).max() < 0.15
    assert abs(outline.fall - 2.0) < 0.1 and abs(outline.area - 400 * 24) < 1000


def test_a_level_river_has_one_height_and_land_is_as_it_was():
    cloud = valley(0.0)
    model, raw = jf.dtm(cloud), jf.dtm(cloud, level_water=False, max_edge=math.inf)
    (outline,) = jf.breaklines(cloud).itertuples()
    x, y = np.meshgrid(*model.centres())
    inside = shapely.contains_xy(outline.geometry, x, y)
    outside = ~shapely.intersects_xy(outline.geometry, x, y)
    assert outline.fall == 0 and abs(outline.elevation - 100) < 0.01
    assert np.unique(model.values[inside]).tolist() == [np.float32(outline.elevation)]
    land = outside & np.isfinite(model.values)
    np.testing.assert_array_equal(model.values[land], raw.values[land])
    assert np.nanstd(raw.values[inside]) > 0.01
    canopy = jf.chm.replace(gap=20.0)(cloud)
    surface = jf.dsm.replace(gap=20.0)(cloud)
    np.testing.assert_array_equal(canopy.values, np.maximum(surface.values - model.values, 0))
    assert len(jf.breaklines(part_of(cloud, cloud.classification == 2))) == 0


def test_water_in_feet_has_the_cells_and_levels_of_that_in_metres():
    cloud = valley(0.0)
    feet = jf.PointCloud.from_arrays(
        cloud.coordinates() / 0.3048, units="ft", classification=cloud.classification, reference=cloud.reference
    )
    np.testing.assert_array_equal(feet.xyz, cloud.xyz)
    model = jf.dtm(feet, cell=1 / 0.3048)  # centres of cells are edges of cells of water
    np.testing.assert_allclose(model.values * 0.3048, jf.dtm(cloud).values, atol=1e-4)


def test_stray_points_of_water_are_no_crash():
    cloud = jf.PointCloud.from_arrays(
        np.array([[0.0, 0, 0], [99_000, 99_000, 0], [9, 0, 1], [0, 9, 1]]),
        classification=np.array([9, 9, 2, 2], np.uint8),
    )
    with pytest.warns(jf.JaxfilterWarning, match="99,0.. m apart"):
        assert len(jf.breaklines(cloud, cloud.classification == 2)) == 0


def in_four(cloud: jf.PointCloud, folder) -> jf.PointCloud:
    """Write the quarters of a cloud, cut in its middle. Returns: the cloud as a file holds it."""
    folder.mkdir()
    jf.write(folder.parent / "whole.laz", cloud, None)
    cloud = jf.read(folder.parent / "whole.laz", units="m", ignore_classes=())
    x, y, _ = cloud.coordinates().T
    east, north = x >= np.rint(x.mean()), y >= np.rint(y.mean())
    for number in range(4):
        jf.write(folder / f"{number}.laz", part_of(cloud, (east + 2 * north) == number), None)
    return cloud


def test_water_of_tiles_is_that_of_the_whole(tmp_path):
    """By points of class 9: rasters of four files, in tiles that cut the river, and those of the cloud in memory."""
    cloud = in_four(valley(0.002), tmp_path / "in")
    how = ("--ground-class", 2, "--units", "m", "--cell", 2, "--tile", 150, "--workers", 1)
    how += ("--only", "dtm,hillshade,chm", "--breaklines", tmp_path / "out" / "water.gpkg")
    assert "water.gpkg: 1 outline of water" in done("products", tmp_path / "in", tmp_path / "out", *how).output
    model = jf.dtm(cloud, cell=2.0)
    made = jf.Raster.read(tmp_path / "out" / "dtm.tif")
    levels = levels_in(cloud, None, cloud.reference)
    assert levels is not None
    water = np.isfinite(levels.at(*np.meshgrid(*model.centres())))
    np.testing.assert_array_equal(made.values[water], model.values[water])
    assert water.sum() > 2000 and np.abs(made.values - model.values)[~np.isnan(model.values)].max() < 1e-4
    relief = jf.Raster.read(tmp_path / "out" / "hillshade.tif")
    np.testing.assert_array_equal(relief.values, jf.hillshade(made).values)
    outlines = geopandas.read_file(tmp_path / "out" / "water.gpkg")
    expected = jf.breaklines(cloud)
    assert outlines.geometry.to_wkt().tolist() == expected.geometry.to_wkt().tolist()
    assert outlines["elevation"].tolist() == expected["elevation"].tolist()


@pytest.mark.parametrize("more", [{}, {"max_gap": 3.0}])
def test_water_has_its_level_where_the_ground_gives_no_height(tmp_path, more):
    """A lake at the corner of the data, beyond the hull of the ground, and wider than ``max_gap``: in files as in memory."""
    rng = np.random.default_rng(3)
    xyz = np.column_stack([rng.random((20_000, 2)) * [160.0, 120.0], np.full(20_000, 50.0)])
    wet = (xyz[:, 0] > 100) & (xyz[:, 1] < 60)
    xyz[:, 2] += np.where(wet, -2, 0.02 * xyz[:, 0])
    classes = np.where(wet, 9, 2).astype(np.uint8)
    jf.write(tmp_path / "in.laz", jf.PointCloud.from_arrays(xyz + CORNER, classification=classes), None)
    model = jf.dtm(jf.read(tmp_path / "in.laz", units="m"), **more)
    how = {"interpolation": jf.Interpolation(**more), "reading": METRES}
    jf.terrain_model(tmp_path / "in.laz", tmp_path / "model.tif", **how)
    assert (model.values[-50:-5, -50:-5] == 48).all()
    np.testing.assert_array_equal(jf.Raster.read(tmp_path / "model.tif").values, model.values)
    area = shapely.box(*CORNER[:2] + [90, 10], *CORNER[:2] + [150, 40])
    jf.terrain_model(tmp_path / "in.laz", tmp_path / "part.tif", **how | {"reading": jf.Reading(units="m", aoi=area)})
    np.testing.assert_array_equal(jf.Raster.read(tmp_path / "part.tif").values, model.values[80:110, 90:150])


@pytest.mark.parametrize("number", [9, None])
def test_water_that_is_found_in_tiles_is_that_of_the_whole_and_remembered(tmp_path, number):
    """By OST: labels, outlines and levels of a river through four files; and of later models of the classified ones."""
    layout = jf.scenes.SceneLayout(relief=4, landform=128, river=28, water_echoes=0.8, forest=0, settlement=0)
    scene = jf.scenes.make(layout, size=(440, 180), density=0.7, seed=7)
    x = scene.xyz[:, 0] - scene.origin[0]
    cloud = in_four(part_of(scene.cloud, (x > 240) & (x < 440)), tmp_path / "in")
    filter_ = jf.OST.for_cloud(cloud)
    result = filter_(cloud)
    run = jf.RunOptions(workers=1, tile=90.0, wide_halos=True)
    how = {"reading": METRES, "classes": jf.Classes(water=number), "run": run, "cell": 2.0}
    made = jf.products(
        tmp_path / "in", tmp_path / "out", filter_, only=["dtm"], breaklines=tmp_path / "w.geojson", **how
    )
    assert made.ground is not None and made.ground.tiles > 3 and result.water.sum() > 1000
    assert number is None or made.ground.classes[0, 9] == result.water.sum()
    whole = jf.breaklines(cloud, result)
    outlines = geopandas.read_file(tmp_path / "w.geojson")
    assert len(outlines) == len(whole) > 0
    assert outlines.union_all().symmetric_difference(whole.union_all()).area == 0
    np.testing.assert_allclose(outlines["elevation"], whole["elevation"], atol=1e-3)
    made_model, model = jf.Raster.read(tmp_path / "out" / "dtm.tif").values, jf.dtm(cloud, result, cell=2.0).values
    x, y = np.meshgrid(*jf.Raster.read(tmp_path / "out" / "dtm.tif").centres())
    inside = shapely.contains_xy(whole.union_all(), x, y)
    np.testing.assert_allclose(made_model[inside], model[inside], atol=1e-3)
    for one in whole.geometry:
        assert np.ptp(made_model[shapely.contains_xy(one, x, y)]) == 0
    classified = tmp_path / "out" / "classified"

    def assert_same(name, **more):
        jf.terrain_model(classified, tmp_path / name, cell=2.0, reading=METRES, **more)
        np.testing.assert_array_equal(jf.Raster.read(tmp_path / name).values, made_model)

    assert_same("later.tif")
    assert_same("tiles.tif", run=run)
    places = jf.review(cloud, result).iloc[:1].assign(verdict="fine")
    jf.apply_survey(places, classified, reading=METRES)
    assert_same("after.tif")
    (classified / "jaxfilter-water.npz").write_bytes(b"PK\x03\x04")
    with pytest.raises(jf.InputError, match=r"jaxfilter-water\.npz: is damaged"):
        assert_same("damaged.tif")


def test_the_bed_that_is_named_as_ground_is_the_terrain(tmp_path):
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 100, (2, 20_000))
    bed = 3 - 7 * x / 100
    surface = (bed < 0) & (rng.uniform(size=len(x)) < 0.5)
    classes = np.where(surface, 9, np.where(bed < 0, 40, 2))
    las = las_of(
        tmp_path / "in.las", np.column_stack([x, y, np.where(surface, 0, bed)]), crs=32632, classification=classes
    )
    cloud, run = jf.read(las), jf.RunOptions(workers=1, tile=40.0, wide_halos=True)
    expected = 3 - 7 * (np.arange(99) + 0.5) / 100  # of the columns, but the last one, which has an edge
    for named, low in (((2,), 0.0), ((2, 40), -3.8)):
        jf.terrain_model(tmp_path / "in.las", tmp_path / "dtm.tif", named, run=jf.RunOptions(workers=1, overwrite=True))
        outlines = tmp_path / f"{low}.gpkg"
        made = tmp_path / str(low)
        jf.products(tmp_path / "in.las", made, named, only=["dtm", "contours"], breaklines=outlines, run=run)
        in_memory = jf.dtm(cloud, np.isin(classes, named))
        for model in (in_memory, jf.Raster.read(tmp_path / "dtm.tif"), jf.Raster.read(made / "dtm.tif")):
            rows = model.values[5:-5, :99]
            assert np.nanmax(abs(rows - np.where(expected < 0, expected if low else 0.0, expected))[:, 50:]) < 0.2
        assert len(geopandas.read_file(outlines)) == 1
        assert (geopandas.read_file(made / "contours.gpkg").elevation.min() <= -3) == (low < 0)
