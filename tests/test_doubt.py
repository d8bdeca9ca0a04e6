"""Doubt: where it is stated, what it is worth on scenes, how it is written, drawn and turned into a list of places."""

import dataclasses
import json
import warnings

import numpy as np
import pytest
from click.testing import CliRunner

import jaxfilter as jf
from jaxfilter.cli import main
from jaxfilter.core.errors import InputError, OutputError, ParameterError
from jaxfilter.reports.places import squares
from jaxfilter.steps.doubt import FEATURES, MODEL, probability

EPSG = 25832


@pytest.fixture(scope="module")
def scene():
    made = jf.scenes.make("town", size=(200.0, 150.0), density=1.0, seed=5)
    return made.cloud, made.truth


@pytest.fixture(scope="module")
def result(scene):
    return jf.OST.for_cloud(scene[0])(scene[0])


def synthetic(doubt):
    """A cloud of one point in the middle of each square of 10 m, f[rows, columns], with this doubt and a result."""
    rows, columns = doubt.shape
    y, x = (v.ravel() * 10.0 + 5.0 for v in np.mgrid[:rows, :columns])
    corner = np.array([[0.0, 0.0], [columns * 10.0, rows * 10.0]])
    xy = np.concatenate([np.stack([x, y], axis=1), corner]) + (500_000.0, 4_800_000.0)
    cloud = jf.PointCloud.from_arrays(np.column_stack([xy, np.zeros(len(xy))]), crs=EPSG)
    n = len(xy)
    none = np.full(n, np.nan, np.float32)
    decision = np.full(n, jf.Decision.SURFACE, np.uint8)
    values = np.append(doubt.ravel(), [np.nan, np.nan]).astype(np.float32)
    made = jf.FilterResult(
        np.zeros(n, bool),
        none,
        none,
        none,
        none,
        none,
        decision,
        np.zeros(n, bool),
        jf.Status.CONVERGED,
        {},
        [],
        doubt=values,
    )
    return cloud, made


def test_every_judged_point_has_a_probability_and_no_other(scene, result):
    cloud, _ = scene
    assert result.doubt.dtype == np.float32 and np.array_equal(np.isnan(result.doubt), ~cloud.candidate)
    judged = result.doubt[cloud.candidate]
    assert judged.min() >= 0 and judged.max() <= 1
    assert (result.decision[~result.ground & cloud.candidate] > jf.Decision.ACCEPTED).all()


def test_errors_are_where_doubt_is(scene, result):
    cloud, truth = scene
    rows = np.flatnonzero(cloud.candidate)
    wrong, doubt = (result.ground != truth)[rows], result.doubt[rows]
    most = np.argsort(-doubt, kind="stable")[: len(rows) // 10]
    assert wrong[most].sum() > 3 * 0.1 * wrong.sum()  # three times what chance finds
    assert abs(doubt.mean() - wrong.mean()) < 0.05


def test_the_model_is_a_logistic_function_up_to_a_half_of_few_features_for_each_label():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(50, len(FEATURES))).astype(np.float32)
    ground = rng.random(50) < 0.5
    assert len(FEATURES) <= 20 and MODEL.shape == (2, len(FEATURES) + 1)
    for row, label, found in zip(values.astype(float), ground, probability(values, ground), strict=True):
        total = MODEL[int(label), 0] + sum(w * v for w, v in zip(MODEL[int(label), 1:], row, strict=True))
        assert found == pytest.approx(min(1 / (1 + np.exp(-total)), 0.5), abs=1e-5)


def test_doubt_does_not_depend_on_the_order_of_points(scene, result):
    cloud, _ = scene
    order = np.random.default_rng(1).permutation(len(cloud))
    rows = order[cloud.candidate[order]]
    other = jf.PointCloud.from_arrays(cloud.coordinates()[rows])
    assert np.array_equal(jf.OST.for_cloud(other)(other).doubt, result.doubt[rows])


def test_degenerate_clouds_have_doubt_without_numbers():
    flat = np.array([[0.0, 0, 0], [9, 0, 0], [0, 9, 0], [9, 9, 0], [4, 5, 0]])
    with pytest.warns(jf.JaxfilterWarning):
        result = jf.OST()(flat)
    assert np.isnan(result.doubt).all() and len(jf.review(flat, result)) == 0


def test_squares_hold_the_sums_of_a_plain_loop(scene, result):
    cloud, _ = scene
    found = squares(cloud, result.doubt, 10.0)
    sums: dict[tuple[int, int], float] = {}
    for (x, y, _), value in zip(cloud.xyz.tolist(), result.doubt.tolist(), strict=True):
        if np.isfinite(value):
            row, column = int((y - found.grid.y0) // 10), int((x - found.grid.x0) // 10)
            key = (
                min(row, found.grid.ny - 1),
                min(column, found.grid.nx - 1),
            )  # the upper edge belongs to the last square
            sums[key] = sums.get(key, 0.0) + value
    got = {divmod(int(at), found.grid.nx): total for at, total in zip(found.at, found.total, strict=True)}
    assert got.keys() == sums.keys() and all(got[k] == pytest.approx(sums[k]) for k in sums)
    assert (np.diff(found.total[found.first]) <= 0).all()


def test_places_join_squares_that_touch_and_come_most_errors_first():
    doubt = np.full((10, 10), 0.01)
    doubt[2, 2:5] = 0.5  # three in a row
    doubt[8, 8], doubt[7, 7] = 0.9, 0.8  # touching at a corner only
    cloud, result = synthetic(doubt)
    table = jf.review(cloud, result, area=5)
    assert list(table["rank"]) == [1, 2, 3] and list(table["points"]) == [3, 1, 1]
    assert table["expected_errors"].to_numpy() == pytest.approx([1.5, 0.9, 0.8], rel=1e-6)
    assert table["mean_doubt"].to_numpy() == pytest.approx([0.5, 0.9, 0.8], rel=1e-6)
    assert list(table["area"]) == [300.0, 100.0, 100.0] == [round(g.area, 3) for g in table.geometry]
    assert table.crs.to_epsg() == EPSG and set(table["reason"]) == {"not ground: in a cell that is an object"}
    assert table.geometry[0].bounds == pytest.approx((500_020, 4_800_020, 500_050, 4_800_030), abs=0.01)
    assert len(jf.review(cloud, result, area=1)) == 1 and jf.review(cloud, result, area=100)["area"].sum() == 10_000


def test_places_side_by_side_have_their_own_squares():
    doubt = np.full((10, 10), 0.01)
    doubt[2:6, 2], doubt[3, 6] = 0.5, 0.9
    table = jf.review(*synthetic(doubt), area=5)
    corner = np.array([500_000, 4_800_000, 500_000, 4_800_000])
    for place, box in ((0, (20, 20, 30, 60)), (1, (60, 30, 70, 40))):
        np.testing.assert_allclose(table.geometry[place].bounds - corner, box, atol=0.01)


@pytest.mark.parametrize("suffix", [".gpkg", ".geojson"])
def test_the_list_is_read_back_as_it_was_and_is_the_same_bytes_again(tmp_path, suffix):
    geopandas = pytest.importorskip("geopandas")
    cloud, result = synthetic(np.linspace(0.0, 0.6, 60).reshape(6, 10))
    path = tmp_path / f"places{suffix}"
    table = jf.review(cloud, result, path, area=10)
    again = geopandas.read_file(path, engine="pyogrio")
    assert again.crs.to_epsg() == EPSG and list(again["rank"]) == list(table["rank"])
    assert again["expected_errors"].to_numpy() == pytest.approx(table["expected_errors"].to_numpy(), rel=1e-9)
    assert again.geometry.geom_equals_exact(table.geometry, 1e-3).all()
    with pytest.raises(OutputError, match="exists"):
        jf.review(cloud, result, path)
    before = path.read_bytes()
    jf.review(cloud, result, path, area=10, overwrite=True)
    assert path.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix, words", [(".gpkg", "has none: set"), (".geojson", "for degrees: set")])
def test_a_list_without_crs_is_written_with_one_warning(tmp_path, suffix, words):
    geopandas = pytest.importorskip("geopandas")
    cloud, result = synthetic(np.linspace(0.0, 0.6, 60).reshape(6, 10))
    path = tmp_path / f"places{suffix}"
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        table = jf.review(dataclasses.replace(cloud, crs=None), result, path, area=10)
    assert [one.category for one in given] == [jf.JaxfilterWarning]
    assert str(path) in str(given[0].message) and words in str(given[0].message)
    again = geopandas.read_file(path, engine="pyogrio").geometry.set_crs(None, allow_override=True)
    assert table.crs is None and again.geom_equals_exact(table.geometry, 1e-3).all()


def test_the_command_writes_places_and_doubt(tmp_path, scene, result):
    cloud, _ = scene
    source, target, places = (tmp_path / name for name in ("in.laz", "out.laz", "places.geojson"))
    jf.write(source, cloud, None)
    command = ["ground", "ost", str(source), str(target), "--extra", "doubt", "--review", str(places), "--json"]
    run = CliRunner().invoke(main, [*command, "--review-area", "10"])
    assert run.exit_code == 0, run.output
    features = json.loads(places.read_text())["features"]
    facts = json.loads(run.stdout)["review"]
    assert facts["places"] == len(features) > 0
    expected = [one["properties"]["expected_errors"] for one in features]
    assert expected == sorted(expected, reverse=True) and sum(expected) == pytest.approx(
        facts["expected_errors"], rel=1e-6
    )
    laspy = pytest.importorskip("laspy")
    written = np.asarray(laspy.read(target)["doubt"])
    assert np.array_equal(np.isnan(written), ~jf.read(target, units="m").candidate)
    late = CliRunner().invoke(main, [*command[:-3], "--overwrite", "--review", str(tmp_path / "places.shp")])
    assert late.exit_code == 2 and ".gpkg" in late.output
    assert "--review" not in CliRunner().invoke(main, ["ground", "smrf", "--help"]).output


def test_results_without_doubt_say_so(tmp_path, scene, result):
    cloud, without = scene[0], dataclasses.replace(result, doubt=None)
    with pytest.raises(InputError, match="states no doubt"):
        jf.review(cloud, without)
    with pytest.raises(ParameterError, match="no doubt"):
        jf.write(tmp_path / "out.las", cloud, without, extra=("doubt",))
    with pytest.raises(InputError, match="no doubt"):
        jf.plots.doubt_map(cloud, without)


def test_bad_arguments_are_refused():
    cloud, result = synthetic(np.full((3, 3), 0.1))
    for wrong in ({"area": 0.0}, {"area": 101.0}, {"side": 0.0}, {"side": float("nan")}):
        with pytest.raises(ParameterError, match=next(iter(wrong))):
            jf.review(cloud, result, **wrong)
    with pytest.raises(InputError, match="11 points"):
        jf.review(np.zeros((4, 3)), result)
    with pytest.raises(OutputError, match="suffix"):
        jf.review(cloud, result, "places.shp")


def test_the_map_shows_the_mean_of_each_cell():
    doubt = np.linspace(0.0, 0.4, 30).reshape(5, 6)
    cloud, result = synthetic(doubt)
    ax = jf.plots.doubt_map(cloud, dataclasses.replace(result, ground=np.ones(len(cloud), bool)))
    drawn = np.ma.compressed(ax.images[-1].get_array())
    assert np.sort(drawn) == pytest.approx(np.sort(100 * doubt.ravel()), abs=1e-4)
