"""Classes around ground: what is found of points, which class that gives them, and how it gets into files."""

import dataclasses

import laspy
import numpy as np
import pytest
from commands import done, facts

import jaxfilter as jf
from jaxfilter.core.filter import Filter, Labels
from jaxfilter.core.params import filter_params
from jaxfilter.files.classes import Finding, class_name, findings_of, table_of

USGS = jf.Classes.preset("usgs")


def classes_of(cloud, result, classes=None):
    classes = classes or jf.Classes()
    old = 0 if cloud.classification is None else cloud.classification
    return table_of(classes)[findings_of(cloud, result, classes).code, old]


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
    assert jf.Classes.preset("ground") == jf.Classes()
    assert (USGS.noise_class, USGS.water, USGS.bridge) == (7, 9, 17)
    with pytest.raises(jf.ParameterError, match="classes='asprs': choose one of ground, usgs"):
        jf.Classes.preset("asprs")
    with pytest.raises(jf.ParameterError, match=r"classes=.*name them there only"):
        jf.write("x.laz", made([0]), np.array([True]), classes=USGS, noise_class=7)
    assert (class_name(17), class_name(64)) == ("17 bridge deck", "64")
    rows = table_of(USGS)
    assert rows.shape == (len(Finding), 256) and (rows[Finding.KEPT, 1:] == np.arange(1, 256)).all()
    assert (rows[[Finding.OTHER, Finding.DECK], 20:] == np.arange(20, 256)).all()
    assert rows[Finding.KEPT, 0] == 1 and rows[Finding.DECK, [0, 1, 2, 5, 6]].tolist() == [17, 17, 17, 5, 6]


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
    layout = dataclasses.replace(jf.scenes.LAYOUTS["town"], low_outliers=1e-4)
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
    expected = classes_of(cloud, result, USGS)
    assert {1, 2, 7, 9, 17} <= set(expected.tolist()) and not (expected == 0).any()
    how = jf.RunOptions(tile=100.0, workers=1, wide_halos=True)
    report = jf.ground(folder / "parts", tmp_path / "out", Level(), classes=USGS, run=how)
    assert report.complete and report.tiles > 1
    for name, rows in (("west", west), ("east", ~west)):
        np.testing.assert_array_equal(laspy.read(tmp_path / "out" / f"{name}.laz").classification, expected[rows])
    assert dict(zip(*np.unique(expected, return_counts=True), strict=True)) == {
        new: sum(n for (_, other), n in report.classes.items() if other == new) for _, new in report.classes
    }
    jf.write(tmp_path / "one.copc.laz", cloud, result, classes=USGS)
    found = laspy.read(tmp_path / "one.copc.laz")
    rows = [
        np.unique(np.column_stack([np.rint(xyz * 1000), classes]), axis=0)
        for xyz, classes in ((cloud.coordinates(), expected), (found.xyz, found.classification))
    ]
    np.testing.assert_array_equal(*rows)


def test_text_with_classes_has_them_too(survey, tmp_path):
    cloud = jf.read(survey[0] / "whole.laz")
    rows = np.flatnonzero(cloud.candidate)[::40]
    lines = [f"{x:.3f},{y:.3f},{z:.3f},0" for x, y, z in cloud.coordinates()[rows]]
    (tmp_path / "in.csv").write_text("x,y,z,classification\n" + "\n".join(lines) + "\n")
    text = jf.read(tmp_path / "in.csv", units="m")
    result = Level()(text)
    jf.write(tmp_path / "out.csv", text, result, classes=USGS)
    back = jf.read(tmp_path / "out.csv", units="m")
    np.testing.assert_array_equal(back.classification, classes_of(text, result, USGS))
    assert len(set(back.classification.tolist())) > 2
    with pytest.raises(jf.OutputError, match=r"noise_class=7, water=9, bridge=17"):
        jf.write(tmp_path / "out.txt", cloud, Level()(cloud), classes=USGS)


def test_the_command_writes_named_sets_and_single_classes(survey, tmp_path):
    words = ("ground", "pmf", survey[0] / "whole.laz")
    written = facts(*words, tmp_path / "a.laz", "--classes", "usgs", "--noise-class", "64")["written"]
    assert (written["noise_class"], written["bridge"], written["overlap_flag"]) == (64, 17, True)
    assert {1, 2, 64} == set(np.asarray(laspy.read(tmp_path / "a.laz").classification).tolist())
    shown = done(*words, tmp_path / "b.laz", "--noise-class", "7").stdout
    assert "0 never classified 7 low noise" in " ".join(shown.split())
    assert {0, 1, 2, 7} == set(np.asarray(laspy.read(tmp_path / "b.laz").classification).tolist())
