"""The commands ``sweep`` and ``calibrate``: files that hold what the library finds, and errors before anything runs."""

from __future__ import annotations

import dataclasses
import json
import shlex

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from commands import assert_one_line, facts, run

import jaxfilter as jf
from jaxfilter.cli.session import Session
from jaxfilter.files.reading import read, write
from jaxfilter.sweeps.best import best_sets
from jaxfilter.sweeps.labels import point_labels

SETS = {"slope": [0.1, 0.2], "threshold": [0.3, 0.5, 0.7]}
AXES = ("--axis", "slope=0.1,0.2", "--axis", "threshold=0.3:0.7:0.2")


@pytest.fixture
def folder(tmp_path, scene):
    """scene.laz without classes; truth.laz with all of them; patches.laz with those of two patches, class 0 elsewhere."""
    nothing = np.zeros(len(scene), bool)
    x, y = (scene.xyz[:, :2] - scene.xyz[:, :2].min(axis=0)).T
    inside = (np.maximum(x, y) < 25) | (np.minimum(x, y) >= 30)
    for name, classes in (
        ("scene.laz", np.zeros_like(scene.classes)),
        ("truth.laz", scene.classes),
        ("patches.laz", np.where(inside, scene.classes, 0)),
    ):
        write(tmp_path / name, dataclasses.replace(scene.cloud, classification=classes), nothing, reset="none")
    return tmp_path


def sweep(folder, *arguments, sources=("truth.laz",), axes=AXES):
    return run("sweep", "smrf", *(folder / name for name in sources), folder / "out", *axes, *arguments)


FEW = ("--size", 24, "--rounds", 1, "--folds", 2)


def calibrate(folder, *arguments, source="patches.laz"):
    return run("calibrate", "smrf", folder / source, *FEW, *arguments)


def stored(folder):
    with xr.open_dataset(folder / "out" / "sweep.nc", engine="scipy") as dataset:
        return dataset.load()


def test_sweep_stores_what_the_library_finds(folder, scene):
    result = sweep(folder, "--votes", "--json")
    assert result.exit_code == 0, result.output
    cloud = read(folder / "truth.laz", units="m")
    expected, found = jf.sweep(jf.SMRF(), cloud, SETS, votes=True), stored(folder)
    assert dict(found.sizes) == {"slope": 2, "threshold": 3, "point": len(scene)}
    for name in ("slope", "threshold", "type1", "type2", "total", "kappa", "ground", "votes"):
        np.testing.assert_allclose(found[name].values, expected[name].values, rtol=1e-6, err_msg=name)
    assert found["slope"].attrs["units"] == "rise/run" and found.attrs["method"] == "SMRF"

    table, report = pd.read_csv(folder / "out" / "sets.csv", index_col="set"), json.loads(result.stdout)
    pd.testing.assert_frame_equal(table, best_sets(expected, count=None), check_dtype=False)
    assert report["sets"] == 6 and report["groups"] == 1 and report["parameters"]["cell"] == 1.0
    assert report["best"][0]["set"] == table.index[0]
    assert report["best"][0]["total"] == pytest.approx(table["total"].min())
    assert {"sweep.nc", "sets.csv"} <= set(report["files"])
    assert {p.name for p in (folder / "out").iterdir()} == {*report["files"], "checkpoint.npz"}


def test_sweep_draws_and_prints(folder):
    result = sweep(folder, "--votes", "--score", "kappa")
    assert result.exit_code == 0, result.output
    assert "best sets by kappa" in result.stdout and "6 sets, 1 cloud, 1 group" in result.stdout
    _, heading, row, *_ = result.stdout.splitlines()
    assert heading.split()[:3] == ["set", "slope", "threshold"]
    assert f"{stored(folder)['kappa'].values.max():.2f}" in row
    for name in ("curves.png", "maps.png", "votes.png"):
        assert (folder / "out" / name).read_bytes().startswith(b"\x89PNG")
    assert_one_line(sweep(folder, "--quiet", axes=AXES[:2]), 2, "--fresh")
    again = sweep(folder, "--quiet", "--fresh", axes=AXES[:2])
    assert again.exit_code == 0 and again.stdout == ""
    names = {p.name for p in (folder / "out").iterdir()}
    assert names == {"checkpoint.npz", "curves.png", "sets.csv", "sweep.nc"}, "pictures of the sweep before are gone"
    (folder / "out" / "checkpoint.npz").unlink()
    before = (folder / "out" / "sweep.nc").read_bytes()
    assert_one_line(sweep(folder, axes=AXES[2:]), 2, "sweep.nc", "--fresh")
    assert (folder / "out" / "sweep.nc").read_bytes() == before


def test_sweep_of_several_clouds_and_without_labels(folder):
    axes = ("--axis", "slope=0.1,0.2")
    assert sweep(folder, "--votes", sources=("truth.laz", "scene.laz"), axes=axes).exit_code == 0
    found = stored(folder)
    assert found["cloud"].values.tolist() == ["truth", "scene"]
    np.testing.assert_array_equal(found["votes_truth"], found["votes_scene"])
    assert found["total"].sel(cloud="truth").notnull().all() and found["total"].sel(cloud="scene").isnull().all()
    table = pd.read_csv(folder / "out" / "sets.csv", index_col="set")
    np.testing.assert_allclose(table["total"], table["total_truth"])
    assert_one_line(sweep(folder, "--fresh", sources=("scene.laz",)), 1, "scene.laz has no labels", "--votes")
    alone = sweep(folder, "--fresh", "--votes", sources=("scene.laz",), axes=axes)
    assert alone.exit_code == 0 and "best" not in alone.stdout
    assert {p.name for p in (folder / "out").iterdir()} >= {"sweep.nc", "sets.csv"}
    np.testing.assert_array_equal(stored(folder)["votes"], found["votes_scene"])


@pytest.mark.parametrize("arguments, expected", [
    (("--axis", "slope=0.1:0.3:0.05"), {"slope": [0.1, 0.15, 0.2, 0.25, 0.3]}),
    (("--axis", "slope=0.1:0.29:0.1", "--set", "scaling=2"), {"slope": [0.1, 0.2]}),
    (("--design", "list", "--axis", "slope=0.1,0.2", "--axis", "cell=1,1.05"), {"slope": [0.1, 0.2], "cell": [1, 1.05]}),
])  # fmt: skip
def test_axes_are_read_as_written(folder, arguments, expected):
    result = sweep(folder, "--json", axes=arguments)
    assert result.exit_code == 0, result.output
    for name, values in expected.items():
        np.testing.assert_allclose(stored(folder)[name].values, values, rtol=1e-12)
    assert json.loads(result.stdout)["parameters"]["scaling"] == (2.0 if "scaling=2" in arguments else 1.25)


def test_values_that_are_none_or_words_are_stored_as_words(folder):
    axes = ("--axis", "fill=neighbours,zero", "--axis", "low_clusters=yes,no", "--design", "list")
    facts("sweep", "spf", folder / "truth.laz", folder / "out", *axes)
    found = stored(folder)
    assert found["fill"].values.tolist() == ["neighbours", "zero"]
    assert found["low_clusters"].values.tolist() == [True, False]
    last = jf.SPF(fill="zero", low_clusters=False)(read(folder / "truth.laz", units="m"))
    assert found["ground"].values[1] == last.ground.sum()
    axes = ("--axis", "spacing=none,2", "--axis", "rounds=0", "--fresh")
    facts("sweep", "ost", folder / "truth.laz", folder / "out", *axes)
    assert stored(folder)["spacing"].values.tolist() == ["none", "2"]


@pytest.mark.parametrize("arguments, words", [
    (("--axis", "steepness=1,2"), ("steepness", "slope, window")),
    (("--axis", "slope="), ("slope", "empty")),
    (("--axis", "slope=0.1,-1"), ("slope=-1.0", "must be > 0")),
    (("--axis", "slope=0.1,steep"), ("slope=steep", "not a valid float")),
    (("--axis", "slope"), ("'slope'", "FIELD=...")),
    (("--axis", "slope=0.3:0.1:0.1"), ("slope=0.3:0.1:0.1", "START to STOP")),
    (("--axis", "slope=0.1:0.3"), ("slope=0.1:0.3", "START:STOP:STEP")),
    (("--axis", "slope=0.1:0.3:0"), ("slope=0.1:0.3:0",)),
    (("--axis", "slope=0.1..0.3"), ("slope", "--design")),
    (("--axis", "slope=0.1..", "--design", "random", "--size", 4), ("slope=0.1..", "LOW..HIGH")),
    (("--axis", "cell=a..b", "--design", "random", "--size", 4), ("cell=a",)),
    (("--axis", "slope=0.1", "--axis", "slope=0.2"), ("slope", "twice")),
    (("--axis", "slope=0.1", "--set", "cell=0"), ("cell=0.0", "must be > 0")),
    (("--axis", "slope=0.1", "--set", "cell"), ("'cell'",)),
    (("--axis", "slope=0.1", "--preset", "samp99"), ("samp99", "recommended")),
])  # fmt: skip
def test_wrong_axes_are_usage_errors_found_before_reading(folder, arguments, words):
    (folder / "truth.laz").write_bytes(b"not a point cloud")
    assert_one_line(sweep(folder, axes=arguments), 2, *words)
    assert not (folder / "out").exists()


def test_unknown_methods_and_files_for_folders_are_usage_errors(folder):
    assert_one_line(run("sweep", "nosuch", folder / "truth.laz", folder / "out", *AXES), 2, "nosuch", "smrf")
    assert run("sweep", "smrf", folder / "truth.laz", folder / "scene.laz", *AXES).exit_code == 2  # OUT_DIR is a file


def test_calibrate_finds_what_the_library_finds(folder, scene):
    report = facts("calibrate", "smrf", folder / "patches.laz", *FEW, "--out", folder / "smrf.json")
    cloud = read(folder / "patches.laz", units="m")
    labels = np.where(cloud.classification == 0, -1, cloud.classification == 2)
    expected = jf.calibrate(jf.SMRF(), cloud, labels, size=24, rounds=1, folds=2)
    assert report["found"] == {name: getattr(expected.filter, name) for name in ("slope", "threshold", "scaling")}
    for key, value in (("cross_validated", expected.score), ("spread", expected.spread), ("before", expected.before)):
        assert report[key] == pytest.approx(value)
    assert report["labelled"] == {"ground": (labels == 1).sum(), "object": (labels == 0).sum()}
    assert json.loads((folder / "smrf.json").read_text())["parameters"] == report["parameters"]
    assert jf.SMRF(**report["changed"]) == expected.filter
    words = shlex.split(report["command"])
    assert words[:3] == ["jaxfilter", "ground", "smrf"]
    words[words.index("OUT")] = str(folder / "ground.laz")
    assert facts(*words[1:])["parameters"] == report["parameters"]


def test_labels_may_come_from_another_file_or_from_patches(folder, scene):
    """The same labels by class, by a text file with a part of the points, and by bounds in a file with all classes."""
    report = facts("calibrate", "smrf", folder / "patches.laz", *FEW)
    known = np.flatnonzero(read(folder / "patches.laz", units="m").classification != 0)[::-1]
    table = np.column_stack([scene.xyz, scene.classes != 2])[known]
    np.savetxt(folder / "labels.txt", table, fmt=("%.2f", "%.2f", "%.2f", "%d"))
    x, y = scene.xyz[:, :2].min(axis=0)
    patches = ("--bounds", x - 1, y - 1, x + 25, y + 25, "--bounds", x + 30, y + 30, x + 99, y + 99)
    for source, arguments in (
        ("scene.laz", ("--labels", folder / "labels.txt")),
        ("scene.laz", ("--labels", folder / "patches.laz")),
        ("truth.laz", patches),
    ):
        other = facts("calibrate", "smrf", folder / source, *FEW, *arguments)
        for key in ("found", "cross_validated", "spread", "before", "labelled"):
            assert other[key] == report[key], (arguments, key)


def test_a_stated_crs_gives_the_units_of_clouds_and_is_part_of_the_command(folder):
    assert sweep(folder, "--crs", "EPSG:2263").exit_code == 0
    expected = jf.sweep(jf.SMRF(), read(folder / "truth.laz", units="us-ft"), SETS)
    np.testing.assert_allclose(stored(folder)["total"].values, expected["total"].values, rtol=1e-6)
    result = calibrate(folder, "--crs", "EPSG:2263")
    assert result.exit_code == 0 and " OUT --crs EPSG:2263 " in result.stdout, result.output


def test_calibrate_prints_the_command_and_keeps_files(folder):
    options = ("--axis", "slope=0.1..0.4", "--score", "kappa", "--set", "window=10", "--out", folder / "a.json")
    result = calibrate(folder, *options)
    assert result.exit_code == 0, result.output
    assert "SMRF(slope=0." in result.stdout and "kappa" in result.stdout and "24 sets" in result.stdout
    command = next(line for line in result.stdout.splitlines() if line.startswith("jaxfilter ground smrf"))
    assert "--slope 0." in command and "--window 10.0" in command and "--threshold" not in command
    assert_one_line(calibrate(folder, *options), 2, "a.json exists", "--overwrite")
    assert calibrate(folder, *options, "--overwrite", "--quiet").stdout == ""


@pytest.mark.parametrize("arguments, words", [
    (("--axis", "slope=0.1,0.2"), ("slope=0.1,0.2", "LOW..HIGH")),
    (("--axis", "slope=-1..1"), ("slope=-1.0", "must be > 0")),
    (("--bounds", 5, 0, 1, 9), ("bounds", "xmin < xmax")),
    (("--out", "no/such/folder.json"), ("not a folder",)),
])  # fmt: skip
def test_wrong_searches_are_usage_errors_found_before_reading(folder, arguments, words):
    (folder / "patches.laz").write_bytes(b"not a point cloud")
    assert_one_line(calibrate(folder, *arguments), 2, *words)


def test_labels_that_cannot_be_used_are_named(folder, scene):
    assert_one_line(calibrate(folder, source="scene.laz"), 1, "labels", "no point is labelled ground")
    one_class = ("--unlabelled", *" --unlabelled ".join(map(str, (0, 1, 3, 5, 6, 7, 17, 18))).split())
    assert_one_line(calibrate(folder, *one_class), 1, "labels", "no point is labelled object")
    assert_one_line(calibrate(folder, "--bounds", 0, 0, 1, 1), 1, "bounds 0 0 1 1", "no labelled point")
    moved = scene.xyz[:5] + [0.0, 0.0, 0.5]
    np.savetxt(folder / "moved.txt", np.column_stack([moved, np.arange(5) % 2]), fmt=("%.2f", "%.2f", "%.2f", "%d"))
    found = calibrate(folder, "--labels", folder / "moved.txt")
    assert_one_line(found, 1, "moved.txt", "5 of 5", f"{moved[:, 0].min():.2f}"[:-3])
    np.savetxt(folder / "bare.txt", moved, fmt="%.2f")
    assert_one_line(calibrate(folder, "--labels", folder / "bare.txt"), 1, "bare.txt", "neither classes nor labels")


def test_labels_of_some_points_reach_all_that_coincide_with_them(folder, scene):
    """The last ten points lie where the first ten do, and of the first labels contradict each other."""
    xyz = np.unique(scene.xyz, axis=0)
    np.savetxt(folder / "in.txt", np.concatenate([xyz, xyz[:10]]), fmt="%.2f")
    labels = np.column_stack([xyz[:400], np.arange(400) % 2])
    np.savetxt(folder / "labels.txt", [*labels, [*xyz[0], 1]], fmt=("%.2f", "%.2f", "%.2f", "%d"))
    words = ("calibrate", "smrf", folder / "in.txt", *FEW, "--labels", folder / "labels.txt", "--units", "m")
    assert facts(*words)["labelled"] == {"ground": 199 + 4, "object": 200 + 5}
    first, last = read(folder / "in.txt", units="m").coordinates()[[0, 399], 0]
    west = np.append(labels[labels[:, 0] < xyz[399, 0], 3], labels[1:10, 3])  # the eastern bound is outside
    found = facts(*words, "--bounds", first, 0, last, 1e8)["labelled"]
    assert found == {"ground": (west == 0).sum() - 1, "object": (west == 1).sum()} and len(west) < 409


def test_the_time_left_follows_the_mean_rate_of_this_run(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("jaxfilter.cli.session.perf_counter", lambda: now[0])
    session = Session(quiet=True, debug=False)
    with session.step("sweep", 1000, "sets"):
        now[0] = 100.0
        session.progress(0.5, "sets")  # half was done before, in another run
        assert session.standing(0.5).startswith("50 %, ") and "left" not in session.standing(0.5)
        for now[0], share, shown in ((110.0, 0.7, "70 %, 20.0 sets/s, 15 s"), (300.0, 0.9, "90 %, 2.0 sets/s, 50 s")):
            session.progress(share, "sets")
            assert session.standing(share).startswith(f"{shown} left, ")
    with session.step("filter", 1_000_000):
        session.progress(0.0, "lowest")
        now[0] = 300.001
        session.progress(0.2, "surface")
        assert "points/s" not in session.standing(0.2), "no rate of a millisecond"
        now[0] = 302.0
        assert "100 k points/s" in session.standing(0.2)


def test_a_terminal_has_one_line_of_progress_that_goes_when_the_step_ends(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setattr("jaxfilter.cli.session._DRAWN_EVERY", -1.0)
    session = Session(quiet=False, debug=False)
    with session.step("filter"):
        session.progress(0.25, "densify", "1 of 2")
        session.warn("odd")
    drawn = capsys.readouterr().err.split("\r\x1b[2K")
    assert drawn[1].startswith("densify 1 of 2: 25 %, ") and drawn[2:] == ["warning: odd\n", ""]
    session = Session(quiet=True, debug=False)
    with session.step("filter"):
        session.progress(0.25, "densify")
    assert capsys.readouterr().err == ""


def test_labels_of_their_own_go_before_classes():
    classes, own = {"classification": np.array([2, 6, 0], np.uint8)}, np.array([False, True, True])
    assert point_labels(jf.PointCloud.from_arrays(np.eye(3), **classes)).tolist() == [1, 0, -1]
    assert point_labels(jf.PointCloud.from_arrays(np.eye(3), **classes, reference=own)).tolist() == [0, 1, 1]


@pytest.mark.parametrize("name", ["checkpoint.npz", "sweep.nc", "sets.csv", "curves.png"])
def test_a_sweep_follows_no_link_that_bears_the_name_of_its_file(folder, name):
    (folder / "precious.txt").write_text("precious")
    (folder / "out").mkdir()
    (folder / "out" / name).symlink_to(folder / "precious.txt")
    done = sweep(folder, "--fresh", axes=("--axis", "slope=0.1,0.2"))
    assert (folder / "precious.txt").read_text() == "precious"
    if name == "curves.png":  # drawn anew
        assert done.exit_code == 0 and not (folder / "out" / name).is_symlink(), done.output
    else:
        assert done.exit_code == 2 and f"{folder / 'out' / name} is a link" in done.stderr, done.output
