"""Doubt: where it is stated, what it is worth on scenes, how it is written, drawn and turned into a list of places."""

import dataclasses
import warnings

import geopandas
import laspy
import numpy as np
import pytest
import shapely
from commands import facts, run

import jaxfilter as jf
from jaxfilter.core.errors import InputError, OutputError, ParameterError
from jaxfilter.core.filter import Labels
from jaxfilter.core.points import canonical_points
from jaxfilter.steps.doubt import FEATURES, WEIGHTS, mixture, probability
from jaxfilter.steps.surfaces import lowest_cells

EPSG = 25832


@pytest.fixture(scope="module")
def scene():
    made = jf.scenes.make("town", size=(200.0, 150.0), density=1.0, seed=5)
    return made.cloud, made.truth


@pytest.fixture(scope="module")
def result(scene):
    return jf.OST.for_cloud(scene[0])(scene[0])


def synthetic(doubt):
    """A cloud of one point in the middle of each cell of 2 m, f[rows, columns], with this doubt; where it is large, no ground."""
    y, x = (v.ravel() * 2.0 + 1.0 for v in np.mgrid[: doubt.shape[0], : doubt.shape[1]])
    xyz = np.column_stack([x + 500_000.0, y + 4_800_000.0, np.zeros(len(x))])
    values = doubt.ravel().astype(np.float32)
    made = dataclasses.replace(jf.FilterResult.of_labels(values < 0.3), doubt=values)
    return jf.PointCloud.from_arrays(xyz, crs=EPSG), made


def test_every_judged_point_has_a_probability_and_no_other(scene, result):
    cloud, _ = scene
    assert result.doubt.dtype == np.float32 and np.array_equal(np.isnan(result.doubt), ~cloud.candidate)
    judged = result.doubt[cloud.candidate]
    assert "doubt" not in result.info
    assert judged.min() >= 0 and judged.max() == 0.5
    assert (result.decision[~result.ground & cloud.candidate] > jf.Decision.ACCEPTED).all()


def test_errors_are_where_doubt_is(scene, result):
    cloud, truth = scene
    rows = np.flatnonzero(cloud.candidate)
    wrong, doubt = (result.ground != truth)[rows], result.doubt[rows]
    most = np.argsort(-doubt, kind="stable")[: len(rows) // 10]
    assert wrong[most].sum() > 3 * 0.1 * wrong.sum()  # three times what chance finds
    assert abs(doubt.mean() - wrong.mean()) < 0.05


def test_the_model_is_a_logistic_function_up_to_a_half_for_each_label(rng):
    values, ground = rng.normal(size=(50, len(FEATURES))).astype(np.float32), rng.random(50) < 0.5
    total = WEIGHTS[:, :1] + WEIGHTS[:, 1:] @ values.T.astype(float)
    expected = np.minimum(1 / (1 + np.exp(-np.where(ground, total[1], total[0]))), 0.5)
    np.testing.assert_allclose(probability(values, ground), expected, atol=1e-5)


def test_where_points_are_too_few_doubt_says_that_it_does_not_hold(tmp_path):
    made = jf.scenes.make("hills", size=(300.0, 300.0), density=0.1, seed=5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = jf.OST.for_cloud(made.cloud)(made.cloud)
        jf.write(tmp_path / "plain.las", made.cloud, result)
    assert "does not hold" in result.info["doubt"]
    with pytest.warns(jf.JaxfilterWarning, match="fewer than 0.2 points per m2"):
        jf.write(tmp_path / "doubt.las", made.cloud, result, extra=("doubt",))


def test_degenerate_clouds_have_doubt_without_numbers():
    flat = np.array([[0.0, 0, 0], [9, 0, 0], [0, 9, 0], [9, 9, 0], [4, 5, 0]])
    for xyz in (flat, np.zeros((0, 3))):
        with pytest.warns(jf.JaxfilterWarning):
            result = jf.OST()(xyz)
        assert np.isnan(result.doubt).all() and len(jf.review(xyz, result)) == 0


def test_places_join_cells_that_touch_and_come_largest_volume_first():
    doubt = np.full((30, 100), 0.001)
    doubt[4:10, 4:10] = 0.5
    doubt[20:26, 80:88] = 0.5
    doubt[26:29, 88:90] = 0.5  # touches the block before at a corner
    doubt[4, 25] = 0.5  # too small for a place
    cloud, result = synthetic(doubt)
    table = jf.review(cloud, result)
    assert list(table["rank"]) == [1, 2] and (table["volume"].diff()[1:] < 0).all()
    assert table.crs.to_epsg() == EPSG and set(table["reason"]) == {"few ground points"}
    assert list(table["area"]) == [round(shape.area, 3) for shape in table.geometry]
    corner = np.array([500_000.0, 4_800_000.0])
    boxes = [np.array(shape.bounds) - np.tile(corner, 2) for shape in table.geometry]
    for box, (x0, y0, x1, y1) in zip(boxes, ((162, 42, 174, 50), (8, 8, 20, 20)), strict=True):
        assert (box[:2] <= (x0, y0)).all() and (box[2:] >= (x1, y1)).all() and (box[2:] - box[:2] <= 24).all()
    xy = np.array(table[["x", "y"]])
    np.testing.assert_array_equal(np.floor((xy - corner) / 2) * 2 + 1, xy - corner)
    assert shapely.contains_xy(shapely.union_all(table.geometry), *xy.T).all()


@pytest.mark.parametrize("suffix", [".gpkg", ".geojson"])
def test_the_list_is_read_back_as_it_was_and_is_the_same_bytes_again(tmp_path, suffix):
    cloud, result = synthetic(np.linspace(0.0, 0.6, 240).reshape(12, 20))
    path = tmp_path / f"places{suffix}"
    table = jf.review(cloud, result, path)
    again = geopandas.read_file(path, engine="pyogrio")
    assert again.crs.to_epsg() == EPSG and list(again["rank"]) == list(table["rank"])
    assert again["volume"].to_numpy() == pytest.approx(table["volume"].to_numpy(), rel=1e-9)
    assert again.geometry.geom_equals_exact(table.geometry, 1e-3).all()
    with pytest.raises(OutputError, match="exists"):
        jf.review(cloud, result, path)
    before = path.read_bytes()
    jf.review(cloud, result, path, overwrite=True)
    assert path.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == [path.name]


def test_the_command_writes_places_and_doubt(tmp_path, scene):
    source, target, places = (tmp_path / name for name in ("in.laz", "out.laz", "places.geojson"))
    jf.write(source, scene[0], None)
    command = ("ground", "ost", source, target, "--extra", "doubt")
    said = facts(*command, "--review", places)
    assert said["review"] == str(places) and len(geopandas.read_file(places)) == len(said["places"]) > 0
    written = np.asarray(laspy.read(target)["doubt"])
    assert np.array_equal(np.isnan(written), ~jf.read(target, units="m").candidate)
    late = run(*command, "--overwrite", "--review", tmp_path / "places.shp")
    assert late.exit_code == 2 and ".gpkg" in late.output


def test_results_without_doubt_say_so(tmp_path, scene, result):
    cloud, without = scene[0], dataclasses.replace(result, doubt=None)
    assert len(jf.review(cloud, without)) > 0 and jf.review(cloud, without.ground)["volume"].gt(0).all()
    with pytest.raises(ParameterError, match="no doubt"):
        jf.write(tmp_path / "out.las", cloud, without, extra=("doubt",))
    with pytest.raises(InputError, match="no doubt"):
        jf.plots.doubt_map(cloud, without)


def test_bad_arguments_are_refused():
    cloud, result = synthetic(np.full((3, 3), 0.1))
    with pytest.raises(InputError, match=r"bool\[9\]|needed"):
        jf.review(cloud, result.ground[:4])
    with pytest.raises(OutputError, match="suffix"):
        jf.review(cloud, result, "places.shp")


def test_the_map_shows_the_mean_of_each_cell():
    doubt = np.linspace(0.0, 0.4, 30).reshape(5, 6)
    cloud, result = synthetic(doubt)
    ax = jf.plots.doubt_map(cloud, dataclasses.replace(result, ground=np.ones(len(cloud), bool)))
    drawn = np.ma.compressed(ax.images[-1].get_array())
    assert np.sort(drawn) == pytest.approx(np.sort(100 * doubt.ravel()), abs=1e-4)


def test_labels_are_mixed_where_points_around_of_the_level_of_the_ground_have_both(rng):
    """Counted point by point, in the square of cells around each."""
    cloud = jf.PointCloud.from_arrays(np.column_stack([rng.uniform(0, 40, (800, 2)), rng.uniform(0, 5, 800)]))
    points = canonical_points(cloud)
    ground, height = rng.random(len(points)) < points.xyz[:, 0] / 40, rng.normal(0, 0.4, len(points))
    labels = Labels(ground, height=height.astype(np.float32))
    cells = lowest_cells(points, 1.0, "cell", corner=(0.0, 0.0))
    found = mixture(points.xyz, cells, labels, slice(None), spacing=1.0, tolerance=0.2)
    row, column = np.divmod(cells.grid.flat(points.xyz), cells.grid.shape[1])
    for one in rng.integers(0, len(points), 60):
        near = (abs(row - row[one]) <= 3) & (abs(column - column[one]) <= 3) & (abs(labels.height) < 0.6)
        share = (ground[near].sum() + 0.5) / (near.sum() + 1)
        assert found[one] == pytest.approx(1 - abs(2 * share - 1), abs=1e-6)
