"""Statements of accuracy: check points whose differences are known, what does not count, datums, and what labels say."""

from __future__ import annotations

import dataclasses
import datetime
import json
import math
import re

import geopandas
import laspy
import numpy as np
import pandas
import pyproj
import pytest
import shapely
from commands import run

import jaxfilter as jf

pytestmark = pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
HEIGHTS = pyproj.CRS("EPSG:5555")  # ETRS89 / UTM 32N + DHHN92
X, Y, SIDE = 500_000.0, 5_400_000.0, 50


def plane(x, y):
    return 100 + 0.1 * (x - X) - 0.05 * (y - Y)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two points per square metre on a plane, one in ten of them no ground and with a doubt of a quarter; and its model."""
    out = tmp_path_factory.mktemp("statement")
    rng = np.random.default_rng(3)
    x, y = X + rng.uniform(0, SIDE, 5000), Y + rng.uniform(0, SIDE, 5000)
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.add_crs(HEIGHTS)
    las.header.scales, las.header.offsets = np.full(3, 0.001), np.array([X, Y, 0])
    high = np.arange(5000) % 10 == 0
    las.x, las.y, las.z = x, y, plane(x, y) + 5 * high
    las.classification = np.where(high, 5, 2)
    las.add_extra_dim(laspy.ExtraBytesParams("doubt", np.float32))
    las.doubt = np.where(high, 0.25, np.nan).astype(np.float32)
    las.write(out / "points.laz")
    values = plane(*np.meshgrid(X + np.arange(SIDE) + 0.5, Y + SIDE - np.arange(SIDE) - 0.5)).astype(np.float32)
    values[:5, :5] = np.nan
    jf.Raster(values, (1.0, 0.0, X, 0.0, -1.0, Y + SIDE), HEIGHTS).write(out / "model.tif")
    return out


def checkpoints(path, dz, cover=None, datum=None, more=()):
    """A CSV of points that lie so many metres below the model, and lines ``more``."""
    rng = np.random.default_rng(4)
    x, y = X + rng.uniform(6, SIDE - 6, len(dz)), Y + rng.uniform(6, SIDE - 6, len(dz))
    table = {"X": x, "Y": y, "Z": plane(x, y) - dz} | ({"land_cover": cover} if cover else {})
    table |= {"vertical_datum": datum} if datum else {}
    path.write_text(pandas.DataFrame(table).to_csv(index=False) + "".join(f"{line}\n" for line in more))
    return path


def statement(folder, tmp_path, points=None, model="model.tif"):
    """The statement on the points of the folder and its model, as a.html."""
    return jf.accuracy_statement(folder / "points.laz", folder / model, tmp_path / "a.html", points)


def test_nva_and_vva_are_those_of_their_definitions(folder, tmp_path):
    dz = np.random.default_rng(5).normal(0.02, 0.1, 70)
    cover = ["bare earth"] * 30 + ["urban"] * 15 + ["Forest"] * 15 + ["tall weeds"] * 10
    points = checkpoints(tmp_path / "points.csv", dz, cover)
    said = statement(folder, tmp_path, points)
    nva, vva = said["checkpoints"]["nva"], said["checkpoints"]["vva"]
    assert nva["points"] == 45 and vva["points"] == 25
    assert nva["rmse_m"] == pytest.approx(math.sqrt(np.mean(dz[:45] ** 2)), abs=1e-4)
    assert nva["accuracy_95_m"] == pytest.approx(1.96 * nva["rmse_m"])
    assert nva["mean_m"] == pytest.approx(dz[:45].mean(), abs=1e-4)
    assert vva["p95_m"] == pytest.approx(np.percentile(np.abs(dz[45:]), 95), abs=1e-4)
    assert {name: one["points"] for name, one in said["checkpoints"]["by_cover"].items()} == {
        "bare earth": 30, "urban": 15, "Forest": 15, "tall weeds": 10,
    }  # fmt: skip
    assert not [note for note in said["notes"] if "asks for" in note]
    assert json.loads((tmp_path / "a.json").read_text())["checkpoints"]["nva"] == nva
    page = (tmp_path / "a.html").read_text()
    assert f"{nva['rmse_m']:.3f}" in page and "edition 2, version 1.0, August 2023" in page and "Forest" in page


def test_what_labels_and_model_say(folder, tmp_path):
    said = statement(folder, tmp_path)
    labels, model = said["labels"], said["model"]
    km2 = (SIDE**2 - 25) / 1e6
    assert model["void_cells"] == 25 and model["km2"] == pytest.approx(km2) and said["checkpoints"] is None
    assert labels["expected_wrong_per_km2"] == pytest.approx(500 * 0.25 / km2)
    assert labels["ground"] == 4500 and labels["ground_per_m2"] == pytest.approx(4500 / (SIDE**2 - 25))
    assert labels["named_places"] == 0 and said["made"]["jaxfilter"] == jf.__version__
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.html", "a.json"]
    datetime.date.fromisoformat(json.loads((tmp_path / "a.json").read_text())["made"]["date"])


def test_the_page_says_in_words_how_files_were_made(folder, tmp_path):
    parameters = {"cell": 0.5, "cut": None, "scaling": False, "rules": ["one", "two"]}
    (tmp_path / "points.laz").write_bytes((folder / "points.laz").read_bytes())
    (tmp_path / "jaxfilter-run.json").write_text(json.dumps({"method": "SMRF", "parameters": parameters}))
    jf.accuracy_statement(tmp_path / "points.laz", folder / "model.tif", tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text()
    assert "the method SMRF" in page and "<td>not set</td>" in page and "<td>no</td>" in page
    assert "<td>one, two</td>" in page and "{" not in page.partition("<main>")[2]


def test_points_beside_the_model_do_not_count(folder, tmp_path):
    whole = jf.Raster.read(folder / "model.tif")
    part = jf.Raster(whole.values[20:, 10:40], (1.0, 0.0, X + 10, 0.0, -1.0, Y + 30), HEIGHTS)
    said = jf.accuracy_statement(folder / "points.laz", part, tmp_path / "a.html")
    las = laspy.read(folder / "points.laz")
    inside = (las.x >= X + 10) & (las.x < X + 40) & (las.y < Y + 30)
    ground = inside & (np.asarray(las.classification) == 2)
    assert said["labels"]["ground"] == pytest.approx(ground.sum(), abs=2)  # on the edges
    assert said["labels"]["ground_per_m2"] == pytest.approx(ground.sum() / 900, rel=0.01)
    assert said["labels"]["expected_wrong_per_km2"] == pytest.approx((inside & ~ground).sum() * 0.25 / 900e-6, rel=0.01)
    assert said["notes"] == ["the model covers a part of the files: points and places in its bounds count"]


def test_verdicts_are_those_on_these_files(folder, tmp_path):
    for name in ("a.laz", "b.laz"):
        (tmp_path / name).write_bytes((folder / "points.laz").read_bytes())
    place = geopandas.GeoDataFrame({"verdict": ["bridge"]}, geometry=[shapely.box(X, Y, X + 9, Y + 9)], crs=HEIGHTS)
    jf.apply_survey(place, tmp_path / "a.laz")

    def verdicts(name):
        page, again = tmp_path / "s.html", jf.RunOptions(overwrite=True)
        said = jf.accuracy_statement(tmp_path / name, folder / "model.tif", page, run=again)
        return said["made"]["verdicts"]

    assert verdicts("b.laz") == {} and verdicts("a.laz") == {"bridge": 1}
    assert "<td>1 as bridge</td>" in (tmp_path / "s.html").read_text()
    (tmp_path / "a.laz").write_bytes((folder / "points.laz").read_bytes())  # labelled anew
    assert verdicts("a.laz") == {}


def test_what_only_sounds_like_plants_is_not_vegetated(folder, tmp_path):
    cover = ["street", "rock outcrop", "not vegetated", "Unvegetated", "non-vegetated", "trees", "Crops", "vegetated"]
    points = checkpoints(tmp_path / "p.csv", np.zeros(8), cover)
    said = statement(folder, tmp_path, points)
    assert (said["checkpoints"]["nva"]["points"], said["checkpoints"]["vva"]["points"]) == (5, 3)


def test_a_model_beside_the_points_is_refused(folder, tmp_path):
    jf.Raster(np.zeros((5, 5), np.float32), (1.0, 0.0, 0.0, 0.0, -1.0, 5.0), HEIGHTS).write(tmp_path / "far.tif")
    with pytest.raises(jf.InputError, match=r"far.tif: lies within 0, 0, 5, 5, beside the points"):
        statement(folder, tmp_path, model=tmp_path / "far.tif")
    assert not (tmp_path / "a.html").exists()


def test_points_that_do_not_count_and_too_few_are_named(folder, tmp_path):
    more = [f"{X - 10},{Y + 10},100", f"{X + 2},{Y + SIDE - 2},100", f"{X + 20},{Y + 20},"]
    points = checkpoints(tmp_path / "p.csv", np.full(25, 0.1), more=more)
    said = statement(folder, tmp_path, points)
    notes = "\n".join(said["notes"])
    assert "1 check points lie outside of the model, and do not count: lines 27" in notes
    assert "2 check points lie where the model has no height, or have none, and do not count: lines 28, 29" in notes
    assert "25 check points for NVA: the 2023 edition asks for 30" in notes and "2014 edition asks" not in notes
    assert said["checkpoints"]["nva"]["rmse_m"] == pytest.approx(0.1, abs=1e-4)


@pytest.mark.parametrize("crs, datum, refused", [
    (5555, "EPSG:5783", None), (5555, "DHHN92 height", None), (5555, "5783", None),
    (5555, "EPSG:5703", "NAVD88 height.*the model is in DHHN92 height"), ("EPSG:25832+6360", "NAVD88", None),
    ("EPSG:25832+6360", "NAVD", "vertical datum NAVD, and the model is in NAVD88 height"),
])  # fmt: skip
def test_another_vertical_datum_is_refused(folder, tmp_path, crs, datum, refused):
    """The word height may be left out."""
    dataclasses.replace(jf.Raster.read(folder / "model.tif"), crs=pyproj.CRS(crs)).write(tmp_path / "model.tif")
    points = checkpoints(tmp_path / "p.csv", np.zeros(30), datum=datum)
    words = (folder / "points.laz", tmp_path / "model.tif", tmp_path / "a.html", "--checkpoints", points)
    said = run("accuracy", *words)
    assert said.exit_code == (0 if refused is None else 1), said.output
    assert (tmp_path / "a.html").exists() == (refused is None)
    assert refused is None or re.search(refused, " ".join(said.output.split()))


@pytest.mark.parametrize("text, words", [
    ("x,y,h\n1,2,3\n", "has no column z; it has x, y, h"),
    (f"x,y,z\n{X + 2},{Y + 2},100,5\n", r"p\.csv: cannot be read as CSV"),  # a decimal comma, say
])  # fmt: skip
def test_check_points_without_heights_are_refused(folder, tmp_path, text, words):
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(jf.InputError, match=words):
        statement(folder, tmp_path, tmp_path / "p.csv")


@pytest.mark.parametrize("name", ["jaxfilter-run.json", "verdicts.json"])
@pytest.mark.parametrize("text", ["{bad", "[]", "", "1" * 5000, "[" * 100_000 + "]" * 100_000, "\0"])
def test_damaged_records_beside_the_files_are_named(folder, tmp_path, name, text):
    (tmp_path / "points.laz").write_bytes((folder / "points.laz").read_bytes())
    (tmp_path / name).write_text(text)
    with pytest.raises(jf.InputError, match=f"{name}: is damaged"):
        jf.accuracy_statement(tmp_path / "points.laz", folder / "model.tif", tmp_path / "a.html")


def test_words_that_are_no_unicode_are_shown_all_the_same(folder, tmp_path):
    (tmp_path / "points.laz").write_bytes((folder / "points.laz").read_bytes())
    (tmp_path / "jaxfilter-run.json").write_text('{"method": "O\\ud800ST", "parameters": 1e308}')
    jf.accuracy_statement(tmp_path / "points.laz", folder / "model.tif", tmp_path / "a.html")
    assert "O?ST" in (tmp_path / "a.html").read_text(encoding="utf-8")
