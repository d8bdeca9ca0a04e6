"""Rasters and contours against direct computations, and those of tiles against those of the whole, bit for bit."""

from __future__ import annotations

import dataclasses
import datetime
import json
import re
import shutil

import geopandas
import numpy as np
import pytest
import rasterio
import shapely
from commands import done as completed
from commands import facts, run
from scipy.interpolate import LinearNDInterpolator, RegularGridInterpolator
from scipy.spatial import Delaunay, cKDTree
from test_tiles_run import Here

import jaxfilter as jf
from jaxfilter.cli.terrain import layer_command
from jaxfilter.surveys.model import Rasters, TerrainReport
from jaxfilter.surveys.page import write_survey_page
from jaxfilter.surveys.products import Products
from jaxfilter.surveys.report import TILE
from jaxfilter.terrain.layer import Layer, setting
from jaxfilter.terrain.layers import LAYERS, Entry

pytestmark = pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
RASTERS = [name for name in LAYERS if name != "contours"]


@pytest.fixture(scope="module")
def wood():
    """A scene with trees, buildings, water and slopes, and its true classes."""
    scene = jf.scenes.make("mixed", size=(150.0, 130.0), density=1.2, seed=7)
    return dataclasses.replace(scene.cloud, classification=scene.classes), scene.truth


def centres(raster):
    return np.stack(np.meshgrid(*raster.centres()), axis=-1)


def radius(a, b, c):
    """Of the circle through three points, by Heron's formula."""
    x, y, z = np.linalg.norm(b - c, axis=-1), np.linalg.norm(a - c, axis=-1), np.linalg.norm(a - b, axis=-1)
    s = (x + y + z) / 2
    area = np.sqrt(np.maximum(s * (s - x) * (s - y) * (s - z), 1e-30))
    return x * y * z / (4 * area)


def pit_free(xyz, height, at, levels, limits):
    """The highest of the surfaces through the points of each level, by SciPy; small triangles alone count."""
    out = np.full(len(at), -np.inf)
    for level, limit in zip(levels, limits, strict=True):
        top = xyz[height >= level] if level else xyz
        mesh = Delaunay(top[:, :2])
        found = mesh.find_simplex(at)
        z = LinearNDInterpolator(mesh, top[:, 2])(at)
        small = radius(*(top[mesh.simplices[found, k], :2] for k in range(3))) <= limit
        out = np.where((found >= 0) & small, np.fmax(out, z), out)
    return np.where(np.isinf(out), np.nan, out)


def test_surface_and_canopy_are_those_of_a_direct_computation(wood):
    cloud, truth = wood
    first = cloud.return_number == 1
    xyz, rows = np.unique(cloud.coordinates()[first], axis=0, return_index=True)
    height = jf.height_above_ground(cloud, truth)[first][rows]
    corner, how = cloud.origin[:2], {"cell": 0.5, "bounds": (512080, 5403060, 512140, 5403120)}
    surface = jf.dsm.replace(gap=6.0, radius=1.2)(cloud, truth, **how)
    local = np.column_stack([xyz[:, :2] - corner, xyz[:, 2]])
    levels, limits = (0, 2, 5, 10, 15), (6.0, 1.2, 1.2, 1.2, 1.2)
    expected = pit_free(local, height, centres(surface).reshape(-1, 2) - corner, levels, limits)
    error = np.abs(surface.values.ravel() - expected)
    known = np.isfinite(error)
    assert (
        np.isfinite(surface.values).ravel() != np.isfinite(expected)
    ).mean() < 1e-3  # circles at the limit, the hull
    assert known.sum() > 10_000 and np.quantile(error[known], 0.999) < 0.002
    assert (error[known] > 0.01).mean() < 5e-4  # heights at a level, cocircular points
    canopy, ground = jf.chm.replace(gap=6.0, radius=1.2)(cloud, truth, **how), jf.dtm(cloud, truth, **how)
    np.testing.assert_array_equal(canopy.values, np.maximum(surface.values - ground.values, 0))


def test_a_crown_has_no_pit(rng):
    """A cone of a tree whose inner echoes are low: with level 0 alone the surface has holes down to them."""
    x, y = (rng.random(4000) * 20 for _ in range(2))
    distance = np.hypot(x - 10, y - 10)
    crown = np.maximum(0.0, 18 - 1.5 * distance) * (distance < 8)
    deep = (rng.random(4000) < 0.15) & (crown > 8)
    cloud = jf.PointCloud.from_arrays(np.column_stack([x, y, 100 + crown * np.where(deep, 0.5, 1.0)]))
    ground = distance >= 8
    at = np.hypot(*(np.moveaxis(centres(jf.dsm(cloud, ground, 0.5)), -1, 0) - 10))
    within = at < 3
    missing = {
        levels: (100 + 18 - 1.5 * at - jf.dsm.replace(levels=levels)(cloud, ground, 0.5).values)[within].max()
        for levels in ((0.0,), (0.0, 2.0, 5.0, 10.0, 15.0))
    }
    assert missing[0.0,] > 4 and missing[0.0, 2.0, 5.0, 10.0, 15.0] < 1.5


def test_noise_later_echoes_and_what_is_withheld_make_no_surface(rng):
    x, y = (rng.random(2000) * 30 for _ in range(2))
    z, kinds = np.full(2000, 50.0), np.full(2000, 2, np.uint8)
    number, withheld = np.ones(2000, np.uint8), np.zeros(2000, bool)
    z[:200] += rng.choice([-40.0, 60.0], 200)
    kinds[:50], kinds[50:100], number[100:150], withheld[150:200] = 7, 18, 2, True
    cloud = jf.PointCloud.from_arrays(
        np.column_stack([x, y, z]), classification=kinds, return_number=number, withheld=withheld
    )
    surface = jf.dsm(cloud, kinds == 2, cell=1.0).values
    assert np.nanmin(surface) == np.nanmax(surface) == 50.0 and np.isfinite(surface).mean() > 0.9


def test_voids_of_echoes_stay_empty_and_gaps_are_bridged(rng):
    x, y = (rng.random(9000) * 60 for _ in range(2))
    water = np.hypot(x - 30, y - 30) < 15
    cloud = jf.PointCloud.from_arrays(np.column_stack([x, y, 0.1 * x])[~water])
    for gap, share in ((5.0, 0.0), (40.0, 1.0)):
        raster = jf.dsm.replace(gap=gap)(cloud, np.ones(len(cloud), bool))
        inner = np.hypot(*(np.moveaxis(centres(raster), -1, 0) - 30)) < 12
        assert np.isfinite(raster.values[inner]).mean() == share


def horn(z, cell, azimuth, altitude):
    """Light by the normal of the surface, with the gradients of Horn (1981), cell by cell."""
    out = np.full(z.shape, np.nan)
    sun = np.array([
        np.cos(np.radians(altitude)) * np.sin(np.radians(azimuth)),
        np.cos(np.radians(altitude)) * np.cos(np.radians(azimuth)),
        np.sin(np.radians(altitude)),
    ])  # fmt: skip
    for r in range(1, z.shape[0] - 1):
        for c in range(1, z.shape[1] - 1):
            w = z[r - 1 : r + 2, c - 1 : c + 2].astype(float)
            if np.isnan(w).any():
                continue
            east = (w[:, 2] @ [1, 2, 1] - w[:, 0] @ [1, 2, 1]) / (8 * cell)
            north = (w[0] @ [1, 2, 1] - w[2] @ [1, 2, 1]) / (8 * cell)
            normal = np.array([-east, -north, 1.0])
            out[r, c] = 1 + 254 * max(normal @ sun / np.linalg.norm(normal), 0.0)
    return out


@pytest.mark.parametrize("azimuth, altitude, z_factor", [(315.0, 45.0, 1.0), (80.0, 20.0, 0.3048)])
def test_hillshade_is_the_light_on_horns_gradients(wood, azimuth, altitude, z_factor):
    heights = jf.dtm(*wood, cell=2.0)
    relief = jf.hillshade(heights, azimuth, altitude, z_factor).values
    expected = horn(heights.values * z_factor, heights.cell, azimuth, altitude)
    known = np.isfinite(expected)
    assert known.mean() > 0.8 and np.abs(relief - expected)[known].max() <= 0.5 + 1e-3
    assert (np.isfinite(relief) == np.isfinite(heights.values)).all() and relief[known].std() > 5
    with pytest.raises(jf.ParameterError, match="altitude=0"):
        jf.hillshade(heights, altitude=0)


def test_relief_of_a_survey_knows_the_units_of_its_heights(wood, tmp_path):
    """X and Y in metres, Z in feet: the same light as with all in metres."""
    relief = {}
    for name, factor in (("m", 1.0), ("ft", 0.3048)):
        xyz = wood[0].coordinates() / [1, 1, factor]
        jf.write(tmp_path / f"{name}.laz", jf.PointCloud.from_arrays(xyz, classification=wood[0].classification), None)
        completed("hillshade", tmp_path / f"{name}.laz", tmp_path / f"{name}.tif", "--units", f"m,{name}")
        relief[name] = jf.Raster.read(tmp_path / f"{name}.tif").values
    assert np.nanmax(np.abs(relief["m"] - relief["ft"])) <= 3 and np.nanstd(relief["m"]) > 5


def test_density_counts_every_ground_point_once(wood):
    cloud, truth = wood
    left, bottom, right, top = bounds = (512010.0, 5403020.0, 512070.0, 5403060.0)
    raster = jf.count(cloud, truth, cell=2.5, bounds=bounds)
    xy = cloud.coordinates()[truth, :2]
    edges = np.arange(bottom, top + 1, 2.5), np.arange(left, right + 1, 2.5)
    expected, _, _ = np.histogram2d(xy[:, 1], xy[:, 0], bins=edges)
    on_edge = (np.isclose(xy % 2.5, 0)).any(axis=1).mean()
    assert on_edge < 0.02 and np.abs(raster.values[::-1] - expected).sum() <= 2 * on_edge * len(xy) + 2
    np.testing.assert_allclose(jf.density(cloud, truth, cell=2.5, bounds=bounds).values, raster.values / 2.5**2)


def test_voids_are_far_from_every_ground_point(wood):
    cloud, truth = wood
    raster = jf.voids.replace(distance=4.0)(cloud, truth, cell=3.0)
    nearest, _ = cKDTree(cloud.coordinates()[truth, :2]).query(centres(raster).reshape(-1, 2))
    known = np.isfinite(raster.values.ravel())
    np.testing.assert_array_equal(raster.values.ravel()[known], nearest[known] > 4.0)
    assert known.mean() > 0.8
    assert (jf.voids(cloud, np.zeros(len(cloud), bool)).values == 1).all()


def cone(size=61, cell=2.0):
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    z = 100 - 0.5 * cell * np.hypot(x - size // 2, y - size // 2)
    return jf.Raster(z.astype(np.float32), (cell, 0.0, 1000.0, 0.0, -cell, 5000.0)), (1000 + (size // 2 + 0.5) * cell)


@pytest.mark.parametrize("rows", [512, 7, 1])
def test_contours_of_a_cone_are_circles_however_many_blocks_there_are(monkeypatch, rows):
    raster, x = cone()
    monkeypatch.setattr("jaxfilter.terrain.contours.STRIP", rows)
    table = jf.contours(raster, interval=5.0)
    closed = table[table.geometry.is_ring]
    assert sorted(closed["elevation"]) == [75.0, 80.0, 85.0, 90.0, 95.0]  # a line each, joined
    for elevation, line in zip(closed["elevation"], closed.geometry, strict=True):
        at = np.array(line.coords) - [x, 5000 - (x - 1000)]
        np.testing.assert_allclose(np.hypot(*at.T), (100 - elevation) / 0.5, atol=0.1 * 5 / 0.5 + 0.05)
    assert (table["elevation"] % 5 == 0).all() and set(table.geom_type) == {"LineString"}


def test_contours_stay_near_the_model_and_small_rings_are_left_out(rng):
    """On a noisy slope each corner lies within a tenth of the interval of the model, linear along the sides of cells."""
    x, y = np.meshgrid(np.arange(120) + 0.5, np.arange(90) + 0.5)
    z = (0.07 * x + 0.5 * np.sin(y / 15) + 0.08 * rng.standard_normal(x.shape)).astype(np.float32)
    raster = jf.Raster(z, (1.0, 0.0, 0.0, 0.0, -1.0, 90.0))
    table = jf.contours(raster, 1.0)
    at, line = shapely.get_coordinates(table.geometry.to_numpy(), return_index=True)
    model = RegularGridInterpolator((y[:, 0], x[0]), z[::-1].astype(float))(at[:, ::-1])
    off = np.abs(model - table["elevation"].to_numpy()[line])
    assert off.max() < 0.1001 and np.quantile(off, 0.5) > 0.01  # it is smoothed, but not by more
    assert len(table) == 9 and table.length.min() > 40 and table.length.sum() < 1000
    assert (table["index_line"] == (table["elevation"] % 5 == 0)).all() and table["index_line"].sum() == 2
    hill = dataclasses.replace(raster, values=np.maximum(-0.5, 3.4 - np.hypot(x - 60, y - 45)).astype(np.float32))
    for shortest, least in ((1.0, {0.0, 1.0, 2.0}), (10.0, {0.0, 1.0}), (18.0, {0.0}), (30.0, set())):
        assert set(jf.contours(hill, 1.0, shortest=shortest)["elevation"]) - {3.0} == least


@pytest.mark.parametrize("name", ["contours", "hillshade"])
def test_a_raster_gives_what_the_points_give(done, survey, tmp_path, name):
    out, _ = done
    suffix = LAYERS[name].kind.SUFFIXES[0]
    target = tmp_path / f"made{suffix}"
    completed(name, out / "dtm.tif", target)
    if name == "hillshade":
        expected = jf.Raster.read(out / "hillshade.tif")
        np.testing.assert_array_equal(jf.Raster.read(target).values, expected.values)
    else:
        table, expected = geopandas.read_file(target), geopandas.read_file(out / "contours.gpkg")
        assert table.geometry.geom_equals(expected.geometry).all() and table["elevation"].equals(expected["elevation"])
    refused = run(name, out / "dtm.tif", tmp_path / f"b{suffix}", "--cell", "2")
    assert refused.exit_code == 2 and "--cell is about points" in refused.stderr


def test_contours_end_where_there_is_no_height_and_files_hold_them(tmp_path):
    raster, _ = cone()
    raster.values[:, 40:] = np.nan
    for name in ("a.gpkg", "a.geojson"):
        table = jf.contours(dataclasses.replace(raster, crs="EPSG:25832"), 10.0, tmp_path / name)
        back = geopandas.read_file(tmp_path / name)
        assert back["elevation"].tolist() == table["elevation"].tolist() and back.length.sum() > 100
    assert table.total_bounds[2] <= 1000 + 40 * 2.0
    with pytest.raises(jf.OutputError, match="suffix"):
        jf.contours(raster, 10.0, tmp_path / "a.shp")
    with pytest.raises(jf.ParameterError, match="interval=0"):
        jf.contours(raster, 0)
    flat = dataclasses.replace(raster, values=np.full((5, 5), np.float32(3.5)))
    assert len(jf.contours(flat, 1.0)) == 0


def test_files_have_the_type_that_a_layer_needs(wood, tmp_path):
    relief = jf.hillshade(jf.dtm(*wood, cell=2.0))
    for raster, kind, nodata in ((relief, "uint8", 0), (jf.voids(*wood, cell=2.0), "uint8", 255)):
        with rasterio.open(raster.write(tmp_path / f"{raster.to_xarray().name}.tif")) as file:
            assert file.dtypes == (kind,) and file.nodata == nodata
            np.testing.assert_array_equal(
                file.read(1, masked=True).filled(nodata), np.nan_to_num(raster.values, nan=nodata)
            )


@pytest.mark.parametrize("layer, values", [
    (jf.dsm, {"gap": 0}), (jf.dsm, {"radius": -1}), (jf.dsm, {"levels": ()}), (jf.dsm, {"levels": (2, 5)}),
    (jf.dsm, {"levels": (0, np.inf)}), (jf.voids, {"distance": 0}),
])  # fmt: skip
def test_settings_out_of_range_are_refused(layer, values):
    with pytest.raises(jf.ParameterError, match=next(iter(values))):
        layer.replace(**values)


@pytest.mark.parametrize("name", ["dsm", "chm", "density", "count", "voids"])
def test_one_point_a_line_and_nothing(name):
    make = getattr(jf, name)
    for xyz in ([[5.5, 5.5, 1.0]], [[k + 0.5, 5.5, 1.0] for k in range(9)]):
        cloud = jf.PointCloud.from_arrays(np.array(xyz))
        ground = np.ones(len(cloud), bool)
        if name == "chm":
            with pytest.raises(jf.InputError, match="three that do not lie on one line"):
                make(cloud, ground)
        else:
            assert make(cloud, ground).values.shape[0] == 1
    with pytest.raises(jf.InputError, match="no points"):
        make(jf.PointCloud.from_arrays(np.zeros((0, 3))), np.zeros(0, bool))
    if name in ("dsm", "chm"):
        with pytest.raises(jf.InputError, match="ground"):
            make(cloud, np.zeros(len(cloud), bool))


# surveys


@pytest.fixture(scope="module")
def survey(wood, tmp_path_factory):
    """The scene as 16 files that end where no tile does, and as one."""
    cloud, _ = wood
    folder = tmp_path_factory.mktemp("survey")
    (folder / "in").mkdir()
    xyz = cloud.coordinates()
    place = np.floor((xyz[:, :2] - cloud.origin[:2]) / [37.7, 32.9]).clip(0, 3)
    parts = {f"in/{i:.0f}{j:.0f}.laz": (place == [i, j]).all(axis=1) for i in range(4) for j in range(4)}
    for name, rows in (parts | {"one.laz": np.ones(len(cloud), bool)}).items():
        columns = {key: getattr(cloud, key)[rows] for key in ("return_number", "number_of_returns", "classification")}
        jf.write(folder / name, jf.PointCloud.from_arrays(xyz[rows], crs="EPSG:25832", **columns), None)
    return folder


def make(what, out, ground=(2,), executor=None, only=tuple(LAYERS), cell=1.0, **run) -> Products:
    options = jf.RunOptions(executor=executor or Here(width=3), wide_halos=True, **run)
    return jf.products(what, out, ground, only=only, cell=cell, run=options)


def contents(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.suffix in (".tif", ".gpkg")}


@pytest.fixture(scope="module")
def done(survey, tmp_path_factory):
    out = tmp_path_factory.mktemp("done") / "out"
    return out, make(survey / "in", out, tile=40.0)


def test_rasters_of_sixteen_files_are_those_of_one_and_of_the_cloud(wood, survey, done, tmp_path):
    """All layers, bit for bit: 16 files in tiles, one file in tiles, one file as one tile, and the functions."""
    out, made = done
    one, whole = make(survey / "one.laz", tmp_path / "one", tile=40.0), make(survey / "one.laz", tmp_path / "whole")
    assert made.complete and made.rasters.tiles > 12 and one.rasters.tiles > 12 and whole.rasters.tiles == 1
    assert contents(out) == contents(tmp_path / "one")
    cloud = jf.read(survey / "one.laz")
    ground = cloud.classification == 2
    terrain = jf.dtm(cloud, ground)
    direct = {
        "dtm": terrain, "dsm": jf.dsm(cloud, ground), "chm": jf.chm(cloud, ground), "hillshade": jf.hillshade(terrain),
        "density": jf.density(cloud, ground), "count": jf.count(cloud, ground), "voids": jf.voids(cloud, ground),
    }  # fmt: skip
    assert direct.keys() == set(RASTERS)
    for name, raster in direct.items():
        for folder in (out, tmp_path / "whole"):
            found = jf.Raster.read(folder / f"{name}.tif")
            np.testing.assert_array_equal(found.values, raster.values, err_msg=f"{name} in {folder.name}")
            assert found.transform == raster.transform and found.crs.to_epsg() == 25832
    table, expected = geopandas.read_file(out / "contours.gpkg"), jf.contours(terrain)
    assert table.crs.to_epsg() == 25832 and sorted(table["elevation"]) == sorted(expected["elevation"])
    assert table.length.sum() == pytest.approx(expected.length.sum(), rel=1e-9)


def test_all_files_are_cloud_optimized_and_the_page_shows_them(done):
    out, made = done
    assert sorted(path.name for path in out.iterdir()) == sorted([*contents(out), "survey.html"])
    assert [file.rpartition("/")[2] for file in made.rasters.files] == [f"{n}.tif" for n in RASTERS] + ["contours.gpkg"]
    page = (out / "survey.html").read_text()
    for name in RASTERS:
        with rasterio.open(out / f"{name}.tif") as file:
            assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG" and f'href="{name}.tif"' in page
    assert page.count("data:image/png;base64,") == len(LAYERS)
    assert 'href="contours.gpkg"' in page and f"{made.rasters.ground:,}" in page
    for words in ("(EPSG:25832)", "not stated", str(datetime.date.today()), jf.__version__, "linear in triangles"):
        assert words in page, words


def test_the_page_says_what_is_missing_and_that_a_table_is_cut(survey, done, tmp_path):
    table = np.zeros(600, TILE)
    table["core"] = np.arange(600)[:, None] * 10 + [0, 0, 10, 5]
    table["points"], table["ground"] = 100, 0.25
    table["points"][3], table["ground"][3] = 0, -1
    place = {"x": 5.0, "y": 6.0, "area": 40.0, "chance": 0.5, "reason": "few ground points"}
    places = [place | {"volume": float(volume)} for volume in range(70, 0, -1)]
    aside, failed = {"tile": 3, "core": [], "reason": "no <room>"}, {"file": "b.laz", "reason": "is damaged"}
    report = TerrainReport(
        table=table, places=places, method="SMRF", parameters={"slope": 0.15, "cut": None}, set_aside=[aside],
        failed=[failed], bounds=(0, 0, 1e4, 1e4),
    )  # fmt: skip
    report.total.classes.update({(0, 2): 7, (2, 2): 5})
    write_survey_page(tmp_path, Rasters({}), (report, report), jf.open(survey / "one.laz"), overwrite=False)
    tables = {
        title: [
            re.findall("<t[hd] scope=.row.>(.*?)</th>|<td>(.*?)</td>", row)
            for row in re.findall("<tr>(.*?)</tr>", body)
        ]
        for title, body in re.findall("<h2>(.*?)</h2>(.*?)</section>", (tmp_path / "survey.html").read_text())
    }
    rows = {title: [["".join(cell) for cell in row] for row in found if row] for title, found in tables.items()}
    assert rows["Classes of the points"] == [["2 ground", "12", "1200.0 %"]]
    assert [row[4] for row in rows["Places to check"]] == [str(volume) for volume in range(70, 20, -1)]
    missing = [["tile 3", "failed: no &lt;room&gt;"], ["b.laz", "was not written: is damaged"]]
    assert rows["What could not be done"] == missing and len(rows["Tiles"]) == 500
    assert rows["Tiles"][2:4] == [
        ["2", "20", "30", "20", "25", "100", "2.00", "25.0 %", "done"],
        ["3", "30", "40", "30", "35", "0", "0.00", "", "failed"],
    ]
    assert [row[:2] for row in rows["Parameters of the method SMRF"]] == [["slope", "0.15"], ["cut", "not set"]]
    page = (tmp_path / "survey.html").read_text()
    assert "600 tiles; the first 500" in page and "70 places; the first 50" in page


@pytest.mark.parametrize("name", LAYERS)
def test_each_layer_has_a_command_that_makes_the_same_file(survey, done, tmp_path, name):
    layer = LAYERS[name].kind
    target = tmp_path / f"x{layer.SUFFIXES[0]}"
    report = facts(name, survey / "in", target, "--tile", 80, "--wide-halos", "--workers", 1, "--quiet")
    assert target.read_bytes() == (done[0] / f"{name}{target.suffix}").read_bytes()
    assert report["ground"] == done[1].rasters.ground
    assert [path.name for path in tmp_path.iterdir()] == [target.name]
    options = {option.name: option.default for option in layer_command(name).params}
    for field in dataclasses.fields(layer):
        assert options[field.name] == field.default or field.default is None, field.name


@dataclasses.dataclass(frozen=True)
class Echoes(Layer):
    """Cells with so many points or more."""

    NAME, TITLE, UNITS, STYLE, SURFACE = "echoes", "enough points", "0 or 1", "magma", False
    least: int = setting("Number of points that are enough.", 1)

    def values(self, site):
        places = (site.cloud.coordinates()[:, 1::-1] - [site.grid.bottom, site.grid.left]) // site.grid.cell
        counts, _, _ = np.histogram2d(*places.T, [np.arange(n + 1) for n in site.grid.shape])
        return (counts[::-1] >= self.least).astype(np.float32)


def test_a_new_raster_is_a_class_and_a_line_in_the_list(survey, tmp_path, monkeypatch):
    monkeypatch.setitem(LAYERS, "echoes", Entry("test_layers:Echoes", "a mask of cells with many echoes"))
    cloud = jf.read(survey / "one.laz")
    expected = {least: Echoes(least)(cloud, cloud.classification == 2).values for least in (1, 3)}
    made = make(survey / "in", tmp_path / "out", only=["echoes"], tile=40.0)
    assert (
        made.rasters.files == [str(tmp_path / "out" / "echoes.tif")] and 0 < expected[3].mean() < expected[1].mean() < 1
    )
    np.testing.assert_array_equal(jf.Raster.read(made.rasters.files[0]).values, expected[1])
    assert "enough points, 0 or 1" in (tmp_path / "out" / "survey.html").read_text()
    assert "cells with many echoes" in run("--help").stdout
    completed("echoes", survey / "one.laz", tmp_path / "x.tif", "--least", 3)
    np.testing.assert_array_equal(jf.Raster.read(tmp_path / "x.tif").values, expected[3])


def test_products_by_command(survey, tmp_path):
    out = tmp_path / "out"
    words, alone = (
        ("products", survey / "in", out, "--workers", 1),
        ("--review", tmp_path / "x.gpkg", "--ground-class", 2),
    )
    for wrong in (("--only", "dtm,hill"), ("--filter", "pmf", "--ground-class", 2), ("--only", ""), alone):
        assert run(*words, *wrong).exit_code == 2 and not out.exists()
    pmf = ("--filter", "pmf", "--set", "max_window=9", "--cell", 2, "--quiet")
    more = ("--review", out / "places.gpkg", "--method", "idw")
    report = facts(*words, "--only", "hillshade, voids", *pmf, *more)
    made = ["classified", "hillshade.tif", "places.gpkg", "survey.html", "voids.tif"]
    assert sorted(p.name for p in out.iterdir()) == made
    assert len(geopandas.read_file(out / "places.gpkg")) == len(report["classified"]["places"])
    assert "inverse distance" in (out / "survey.html").read_text()
    assert report["classified"]["method"] == "PMF" and report["ground"] == report["classified"]["ground"] > 1000
    refused = run(*words, "--only", "voids")
    assert refused.exit_code == 1 and "pass --overwrite to replace it, or pass --resume to go on" in refused.stderr
    shutil.rmtree(out)
    completed(*words, "--only", "count", "--ground-class", 2)
    assert sorted(p.name for p in out.iterdir()) == ["count.tif", "survey.html"]


def test_the_side_of_cells_has_two_names_and_two_units(wood, tmp_path):
    jf.write(tmp_path / "in.laz", jf.PointCloud.from_arrays(wood[0].coordinates(), units="ft"), wood[1])
    made = {}
    for cell in (("--cell", 2 / 0.3048), ("--cell", 2, "--cell-units", "m")):
        said = completed("dtm", tmp_path / "in.laz", tmp_path / "a.tif", "--units", "ft", "--overwrite", *cell).stdout
        assert ("cells of 2 m (6.56168 foot)" if "m" in cell else "cells of 6.56168 foot") in said
        made[cell] = (tmp_path / "a.tif").read_bytes()
    assert len(set(made.values())) == 1


def test_files_say_what_their_values_are_and_may_have_the_cells_of_another(survey, tmp_path):
    like = jf.Raster(np.zeros((20, 30), np.float32), (2.0, 0.0, 512008.0, 0.0, -2.0, 5403060.0))
    how = ["--like", like.write(tmp_path / "like.tif"), "--nodata", "-999999", "--workers", 1]
    completed("products", survey / "in", tmp_path / "out", "--ground-class", 2, "--only", "dtm,count,hillshade", *how)
    for name, unit, kind, nodata in (
        ("dtm", "metre", "float32", -999999), ("count", "points", "int32", -9999), ("hillshade", "1 (dark) to 255", "uint8", 0),
    ):  # fmt: skip
        with rasterio.open(tmp_path / "out" / f"{name}.tif") as file:
            assert tuple(file.transform)[:6] == like.transform and file.shape == (20, 30)
            assert (file.descriptions, file.units) == ((LAYERS[name].kind.TITLE,), (unit,))
            assert (file.dtypes, file.nodata) == ((kind,), nodata) and (file.read(1) != nodata).any()
            assert ("VERTICAL_DATUM" in file.tags()) == (name == "dtm")
    whole = jf.dtm(jf.read(survey / "one.laz"), cell=2.0, bounds=like.bounds)
    made = jf.Raster.read(tmp_path / "out" / "dtm.tif")
    np.testing.assert_array_equal(made.values, whole.values)
    whole.write(tmp_path / "memory.tif")
    with rasterio.open(tmp_path / "memory.tif") as file:
        assert (file.descriptions, file.units) == (("height of the ground",), ("metre",))
    moved = dataclasses.replace(like, transform=(2.0, 0.0, 512009.0, 0.0, -2.0, 5403060.0)).write(
        tmp_path / "moved.tif"
    )
    with pytest.raises(jf.InputError, match="multiples of their side, 2"):
        jf.terrain_model(survey / "in", tmp_path / "x.tif", cell=moved)
    with pytest.raises(jf.ParameterError, match=r"nodata=0\.1: must be a number that float32 can hold"):
        jf.products(survey / "in", tmp_path / "x", (2,), nodata=0.1)


def test_one_file_may_go_to_standard_output(survey, done, tmp_path):
    tiles = ("--tile", 40, "--wide-halos", "--workers", 1)
    model = run("dtm", survey / "in", "-", *tiles)
    assert model.stdout_bytes == (done[0] / "dtm.tif").read_bytes() and "ground points" in model.stderr
    lines = json.loads(run("contours", survey / "one.laz", "-", "--quiet").stdout)
    assert lines["type"] == "FeatureCollection" and lines["features"]
    points = ("ground", "pmf", survey / "one.laz", "--max-window", 9)
    completed(*points[:3], tmp_path / "one.laz", *points[3:])
    piped = run(*points[:3], "-", *points[3:], "--json")
    assert piped.stdout_bytes == (tmp_path / "one.laz").read_bytes()
    assert json.loads(piped.stderr[piped.stderr.index("{") :])["output"] == "-"
    assert b"<html" in run("report", survey / "one.laz", "-", "--quiet").stdout_bytes
    assert run("dtm", survey / "one.laz", "-", "--dry-run").stdout == ""
    for words, message in (
        (("ground", "pmf", survey / "in", "-"), "one file: name a folder"),
        (("height", survey / "in/*.laz", "-"), "one file: name a folder"),
        (("dtm", survey / "one.laz", "-", "--resume"), "nothing to resume"),
        (("products", survey / "one.laz", "-"), "several files: name a folder"),
    ):
        wrong = run(*words)
        assert wrong.exit_code == 2 and message in wrong.stderr and not wrong.stdout, wrong.output


def test_a_run_that_goes_on_shows_on_its_page_what_the_first_had_found(survey, tmp_path):
    """The files are classified, and the rasters are missing."""
    words = (survey / "one.laz", tmp_path / "out", "--filter", "pmf", "--only", "count", "--units", "m")
    completed("products", *words)
    page = tmp_path / "out" / "survey.html"
    first = page.read_text()
    page.unlink()
    completed("products", *words, "--resume")
    for part in ("ground points", "the method PMF", "2 ground"):
        row = rf'<th scope="row">{part}</th>.*?</tr>' if part != "the method PMF" else part
        assert re.search(row, first)[0] == re.search(row, page.read_text())[0]


@pytest.mark.parametrize("how, error, words", [
    ({"only": ["dem"]}, jf.ParameterError, "choose from dtm, dsm"),
    ({"only": []}, jf.ParameterError, "only='nothing'"),
    ({"in_place": True}, jf.ParameterError, "cannot take the place of the input"),
    ({"ground": (30,)}, jf.InputError, "no point is ground"),
    ({"out": "memory://products/out"}, jf.ParameterError, "pass work="),
])  # fmt: skip
def test_wrong_products_are_refused_before_anything_is_done(survey, tmp_path, how, error, words):
    with pytest.raises(error, match=words):
        make(survey / "in", **({"out": tmp_path / "out"} | how))
