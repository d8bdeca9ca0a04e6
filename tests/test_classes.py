"""Classes around ground: what is found of points, which class that gives them, and how it gets into files."""

import dataclasses

import laspy
import numpy as np
import pytest
from commands import done, facts

import jaxfilter as jf
from jaxfilter.core.filter import Filter, Labels
from jaxfilter.core.params import filter_params
from jaxfilter.files.classes import Finding, class_name, classes_of, findings_of, table_of
from jaxfilter.scenes import Kind
from jaxfilter.steps import high_noise, vegetation
from jaxfilter.surveys import ground as survey_ground

LAS14 = jf.Classes.preset("las14")


@pytest.fixture(scope="module")
def scene():
    layout = dataclasses.replace(jf.scenes.LAYOUTS["town"], high_outliers=2e-5)
    return jf.scenes.make(layout, size=(300.0, 240.0), density=2.0, seed=4)


def test_high_noise_is_what_lies_far_above_all_around(scene):
    """By the definition, point for point; birds are found, and buildings, walls and trees are not."""
    cloud = scene.cloud
    found = high_noise.isolated_above(cloud)
    square = np.floor((cloud.xyz[:, :2] - cloud.grid_offset(high_noise.SIDE)) / high_noise.SIDE).astype(int)
    for at in np.flatnonzero(cloud.xyz[:, 2] > np.quantile(cloud.xyz[:, 2], 0.9999)):
        near = (np.abs(square - square[at]) <= 1).all(axis=1)
        near[at] = False
        assert found[at] == (cloud.xyz[near, 2] < cloud.xyz[at, 2] - high_noise.ABOVE).all()
    birds = scene.kind == Kind.HIGH_OUTLIER
    assert birds.sum() >= 2 and found[birds].mean() >= 0.5 and not found[~birds].any()


def test_wires_masts_and_cranes_are_no_high_noise():
    """At one echo per m2 on the ground; a bird beside them is one, and two echoes of it are none."""
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(0, 300, (90_000, 2)), rng.normal(0, 0.03, 90_000)])
    wire = np.column_stack([np.arange(5, 295, 4.0), np.full(73, 50.0), np.full(73, 30.0)])
    mast = np.column_stack([np.full((9, 2), 150.0), np.arange(4, 40, 4.0)])
    boom = np.column_stack([np.arange(200, 240, 2.5), np.full(16, 200.0), np.full(16, 60.0)])
    bird, flock = np.array([[60.0, 250.0, 40.0]]), np.array([[250.0, 100.0, 40.0], [250.5, 100.0, 40.0]])
    cloud = jf.PointCloud.from_arrays(np.vstack([bird, flat, wire, mast, boom, flock]))
    np.testing.assert_array_equal(np.flatnonzero(high_noise.isolated_above(cloud)), [0])
    alone = jf.PointCloud.from_arrays(np.array([[0.0, 0.0, 900.0], [100.0, 0.0, 0.0], [101.0, 0.0, 0.0]]))
    assert not high_noise.isolated_above(alone).any()  # nothing around tells how high it is


def test_heights_near_are_those_of_the_surface_where_triangles_are_small(scene):
    cloud, truth = scene.cloud, scene.truth
    rows = np.flatnonzero(~truth)[::7]
    height = vegetation.heights_near(cloud, truth, rows, 1)
    whole = jf.height_above_ground(cloud, truth)[rows]
    error = np.abs(height - whole)[known := np.isfinite(height)]
    assert known.mean() > 0.95 and np.median(error) < 1e-5 and (error < 0.5).mean() > 0.98
    x = cloud.xyz[:, 0]
    some = truth & ((x < 100) | (x > 180))  # a void 80 m wide
    over = rows[(x[rows] > 125) & (x[rows] < 155)]
    assert np.isnan(vegetation.heights_near(cloud, some, over, 1)).all()
    assert np.isnan(vegetation.heights_near(cloud, np.zeros(len(cloud), bool), rows, 1)).all()


def test_plants_get_classes_by_height_and_roofs_do_not(scene):
    result = jf.FilterResult.of_labels(scene.truth)
    classes = classes_of(scene.cloud, result, jf.Classes(vegetation=(0.5, 2.0, 5.0)))
    height = jf.height_above_ground(scene.cloud, scene.truth)
    for number, low, high in ((3, 0.5, 2.0), (4, 2.0, 5.0), (5, 5.0, np.inf)):
        got = classes == number
        assert got.sum() > 50 and ((height[got] > low - 0.3) & (height[got] < high + 0.3)).mean() > 0.98
    trees, roofs = scene.kind == Kind.HIGH_VEGETATION, scene.kind == Kind.BUILDING
    assert np.isin(classes[trees], (3, 4, 5)).mean() > 0.98
    assert np.isin(classes[roofs], (3, 4, 5)).mean() < 0.1
    earlier = trees & ~scene.cloud.candidate  # not judged since an echo below it was
    assert earlier.sum() > 100 and (classes[earlier] > 2).mean() > 0.98
    assert (classes[scene.truth & scene.cloud.candidate] == 2).all()


def made(classes, **columns):
    """A flat cloud with a point of each of these classes; columns as arrays."""
    n = len(classes)
    xyz = np.column_stack([np.arange(n) * 3.0, np.zeros(n), np.zeros(n)])
    return jf.PointCloud.from_arrays(xyz, classification=np.array(classes, np.uint8), **columns)


def result_for(n, **fields):
    """A result without ground, with points i of each field set."""
    values = {name: np.isin(np.arange(n), rows) for name, rows in fields.items()}
    ground = values.pop("ground", np.zeros(n, bool))
    low = values.pop("low_noise", None)
    return dataclasses.replace(jf.FilterResult.of_labels(ground, low), **values)


def test_water_and_decks_get_their_class_and_edited_points_keep_theirs():
    cloud = made([0, 1, 2, 5, 9, 0, 1, 2, 6, 17])
    result = result_for(10, ground=range(5), water=range(5), deck=range(5, 10))
    both = jf.Classes(water=9, bridge=17)
    # water over 0, 1, 2; what was 5 is ground as without it; 9 and 17 are not judged; a deck over a building is none
    assert classes_of(cloud, result, both).tolist() == [9, 9, 9, 2, 9, 17, 17, 17, 6, 17]
    assert classes_of(cloud, result).tolist() == [2, 2, 2, 2, 9, 1, 1, 1, 6, 17]
    assert jf.class_changes(cloud, result, both)[0, 9] == 1
    with pytest.warns(jf.JaxfilterWarning, match="class 17: the method does not look for decks"):
        assert 17 not in classes_of(made([0, 0]), result_for(2, water=[0]), both)
    with pytest.raises(jf.ParameterError, match="water=9: labels alone tell no water"):
        jf.class_changes(cloud, result.ground, jf.Classes(water=9))


def test_the_overlap_flag_stands_for_class_12_where_there_is_one(tmp_path):
    las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    las.x, las.y, las.z = np.arange(4.0) * 3, np.zeros(4), np.zeros(4)
    las.classification, las.return_number, las.number_of_returns = [12, 12, 1, 9], [1] * 4, [1] * 4
    las.write(tmp_path / "in.laz")
    cloud = jf.read(tmp_path / "in.laz", units="m")
    ground = np.array([True, False, True, False])
    one = jf.Classes(overlap_flag=True)
    jf.write(tmp_path / "out.laz", cloud, ground, classes=one)
    out = laspy.read(tmp_path / "out.laz")
    assert np.asarray(out.classification).tolist() == [2, 1, 2, 9]
    assert np.asarray(out.overlap).tolist() == [1, 1, 0, 0]
    assert jf.class_changes(cloud, ground, one) == {(1, 2): 1, (9, 9): 1, (12, 1): 1, (12, 2): 1}
    laspy.convert(las, point_format_id=1).write(tmp_path / "old.laz")
    old = jf.read(tmp_path / "old.laz", units="m")
    jf.write(tmp_path / "kept.laz", old, ground, classes=one)
    assert np.asarray(laspy.read(tmp_path / "kept.laz").classification).tolist() == [12, 12, 2, 9]


def test_presets_and_what_they_refuse():
    usgs = jf.Classes.preset("usgs")
    assert jf.Classes.preset("ground") == jf.Classes() and dataclasses.replace(usgs, vegetation=(0.5, 2, 5)) == LAS14
    assert (usgs.noise_class, usgs.high_noise, usgs.water, usgs.bridge) == (7, 18, 9, 17)
    with pytest.raises(jf.ParameterError, match="classes='asprs': choose one of ground, usgs, las14"):
        jf.Classes.preset("asprs")
    for wrong in ((2.0, 0.5, 5.0), (1.0, 2.0), (0.5, 2.0, np.nan)):
        with pytest.raises(jf.ParameterError, match=r"vegetation=.*three heights"):
            jf.Classes(vegetation=wrong)
    with pytest.raises(jf.ParameterError, match=r"classes=.*name them there only"):
        jf.write("x.laz", made([0]), np.array([True]), classes=usgs, noise_class=7)
    assert (class_name(17), class_name(64)) == ("17 bridge deck", "64")
    rows = table_of(usgs)
    assert rows.shape == (len(Finding), 256) and (rows[Finding.KEPT, 1:] == np.arange(1, 256)).all()
    assert (rows[[Finding.OTHER, Finding.HIGH_NOISE, Finding.DECK], 20:] == np.arange(20, 256)).all()
    assert rows[Finding.KEPT, 0] == 1 and rows[Finding.HIGH_NOISE, [0, 1, 2, 5, 6]].tolist() == [18, 18, 18, 5, 6]


@filter_params
class Level(Filter):
    """Ground below a level; water in the west, a deck in the north: labels that a test can tell beforehand."""

    def halo(self):
        return 5.0

    def classify(self, points, *, key, workers, progress, trace):
        z = points.xyz[:, 2] + points.cloud.origin[2]
        x, y = (points.xyz[:, :2] + points.cloud.origin[:2]).T
        ground = z < np.float32(352.0)
        barred = z < 340
        return Labels(
            ground & ~barred,
            height=z - 352,
            barred=barred,
            water=ground & (x < 512_040),
            deck=~ground & (y > 5_403_100),
        )


del jf.FILTERS["level"]  # no method for other tests


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    folder = tmp_path_factory.mktemp("survey")
    layout = dataclasses.replace(jf.scenes.LAYOUTS["town"], high_outliers=1e-4, low_outliers=1e-4)
    made = jf.scenes.make(layout, size=(200.0, 160.0), density=1.0, seed=6)
    jf.write(folder / "whole.laz", dataclasses.replace(made.cloud, crs="EPSG:25832"), None)
    (folder / "parts").mkdir()
    las = laspy.read(folder / "whole.laz")
    west = np.asarray(las.x) < 512_100
    for name, rows in (("west", west), ("east", ~west)):
        part = laspy.LasData(las.header)
        part.points = las.points[rows]
        part.write(folder / "parts" / f"{name}.laz")
    return folder, west


def test_classes_are_those_of_the_whole_in_files_and_tiles(survey, tmp_path):
    folder, west = survey
    cloud = jf.read(folder / "whole.laz")
    result = Level()(cloud)
    expected = classes_of(cloud, result, LAS14)
    assert {1, 2, 3, 4, 5, 7, 9, 17, 18} <= set(expected.tolist()) and not (expected == 0).any()
    how = jf.RunOptions(tile=100.0, workers=1, wide_halos=True)
    report = jf.ground(folder / "parts", tmp_path / "out", Level(), classes=LAS14, run=how)
    assert report.complete and report.tiles > 1
    for name, rows in (("west", west), ("east", ~west)):
        np.testing.assert_array_equal(laspy.read(tmp_path / "out" / f"{name}.laz").classification, expected[rows])
    assert dict(zip(*np.unique(expected, return_counts=True), strict=True)) == {
        new: sum(n for (_, other), n in report.classes.items() if other == new) for _, new in report.classes
    }
    jf.write(tmp_path / "one.copc.laz", cloud, result, classes=LAS14)
    found = laspy.read(tmp_path / "one.copc.laz")
    rows = [
        np.unique(np.column_stack([np.rint(xyz * 1000), classes]), axis=0)
        for xyz, classes in ((cloud.coordinates(), expected), (found.xyz, found.classification))
    ]
    np.testing.assert_array_equal(*rows)
    assert max(high_noise.REACH, vegetation.REACH) <= survey_ground._REACH


def test_text_with_classes_has_them_too(survey, tmp_path):
    cloud = jf.read(survey[0] / "whole.laz")
    rows = np.flatnonzero(cloud.candidate)[:500]
    lines = [f"{x:.3f},{y:.3f},{z:.3f},0" for x, y, z in cloud.coordinates()[rows]]
    (tmp_path / "in.csv").write_text("x,y,z,classification\n" + "\n".join(lines) + "\n")
    text = jf.read(tmp_path / "in.csv", units="m")
    result = Level()(text)
    jf.write(tmp_path / "out.csv", text, result, classes=LAS14)
    back = jf.read(tmp_path / "out.csv", units="m")
    np.testing.assert_array_equal(back.classification, classes_of(text, result, LAS14))
    assert len(set(back.classification.tolist())) > 2
    with pytest.raises(jf.OutputError, match=r"noise_class=7, high_noise=18, water=9, bridge=17.*vegetation"):
        jf.write(tmp_path / "out.txt", cloud, Level()(cloud), classes=LAS14)


def test_the_command_writes_named_sets_and_single_classes(survey, tmp_path):
    words = ("ground", "pmf", survey[0] / "whole.laz")
    written = facts(*words, tmp_path / "a.laz", "--classes", "usgs", "--high-noise-class", "64")["written"]
    assert (written["high_noise"], written["noise_class"], written["vegetation"]) == (64, 7, None)
    assert {1, 2, 7, 64} == set(np.asarray(laspy.read(tmp_path / "a.laz").classification).tolist())
    shown = done(*words, tmp_path / "b.laz", "--vegetation-classes", "0.3", "1", "3").stdout
    assert "0 never classified 5 high vegetation" in " ".join(shown.split())
    assert {0, 1, 2, 3, 4, 5} == set(np.asarray(laspy.read(tmp_path / "b.laz").classification).tolist())


def test_findings_of_points_that_are_set_aside_stay_nothing(scene):
    """Classes that are ignored, and withheld points, get neither vegetation nor noise."""
    n = len(scene)
    old = np.where(np.arange(n) % 3 == 0, 20, 1).astype(np.uint8)
    cloud = dataclasses.replace(scene.cloud, classification=old, withheld=np.arange(n) % 5 == 0).select()
    found = findings_of(cloud, scene.truth & cloud.candidate, jf.Classes(high_noise=18, vegetation=(0.5, 2.0, 5.0)))
    assert (found.code[(old == 20) | cloud.withheld] == Finding.KEPT).all()
    assert (found.code == Finding.HIGH_VEGETATION).sum() > 100
