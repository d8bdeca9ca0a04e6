"""The command line: exit codes, what goes where, and files that must not be lost."""

from __future__ import annotations

import dataclasses
import datetime
import json
import os
import re
import subprocess
import sys

import laspy
import numpy as np
import pytest
from commands import assert_one_line, done, facts, run

import jaxfilter as jf
from jaxfilter.cli import main
from jaxfilter.cli.commands import ground_command
from jaxfilter.files.reading import read, write
from jaxfilter.methods import FILTERS

SLOW = {"csf", "iptd", "ppdf"}  # they compile for seconds; how flags become parameters is the same for all
METHODS = pytest.mark.parametrize(
    "method", [pytest.param(m, marks=pytest.mark.slow) if m in SLOW else m for m in FILTERS]
)


@pytest.fixture
def folder(tmp_path, scene):
    """scene.laz as delivered, truth.laz with its true classes, and truth.txt: the same points in another order."""
    nothing = np.zeros(len(scene), bool)
    write(tmp_path / "scene.laz", scene.cloud, nothing, reset="none")
    classified = dataclasses.replace(scene.cloud, classification=scene.classes)
    write(tmp_path / "truth.laz", classified, nothing, reset="none")
    order = np.random.default_rng(0).permutation(len(scene))
    table = np.column_stack([scene.xyz, ~scene.truth])[order]
    np.savetxt(tmp_path / "truth.txt", table, fmt=("%.3f", "%.3f", "%.3f", "%d"))
    return tmp_path


def ground(folder, *arguments, source="scene.laz", target="out.laz", method="fptd"):
    return run("ground", method, folder / source, folder / target, *arguments)


def everything(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def classes_of(path):
    return np.asarray(laspy.read(path).classification)


@METHODS
def test_ground_writes_what_the_library_finds(folder, method):
    result = ground(folder, "--json", method=method)
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    cloud = read(folder / "scene.laz", units="m")
    expected = FILTERS[method]()(cloud).ground
    np.testing.assert_array_equal(classes_of(folder / "out.laz") == 2, expected)
    assert report["ground"] == expected.sum() and report["points"] == len(cloud)
    assert report["candidates"] == cloud.candidate.sum()
    assert report["status"] == "CONVERGED"
    assert set(report["parameters"]) == {f.name for f in dataclasses.fields(FILTERS[method])}
    assert set(report["seconds"]) == {"read", "compile", "filter", "write", "places"}
    assert min(seconds for step, seconds in report["seconds"].items() if step != "compile") > 0
    assert min(report["filter_seconds"].values()) > 0
    assert report["compilations"]["count"] >= 0
    assert any("metres are assumed" in text for text in report["warnings"])
    assert "warning: " in result.stderr and "warning: " not in result.stdout


def test_flags_cover_every_field_once():
    for method in FILTERS.values():
        names = [option.name for option in ground_command(method).params]
        assert len(names) == len(set(names)), "a parameter has the name of an option of the command"
        assert {field.name for field in dataclasses.fields(method)} <= set(names)


@pytest.mark.parametrize("method, words, values", [
    ("spf", ("--no-low-clusters", "--fill", "zero", "--max-rounds", 7), {"low_clusters": False, "fill": "zero", "max_rounds": 7}),
    ("pmf", ("--low-clusters", "--no-exponential"), {"low_clusters": True, "exponential": False}),
    ("ost", ("--spacing", "none"), {"spacing": None}), ("ost", ("--spacing", 3), {"spacing": 3.0}),
])  # fmt: skip
def test_fields_of_every_kind_become_flags(folder, monkeypatch, method, words, values):
    seen = []

    def classify(filter_, *_, **__):
        seen.append(filter_)
        raise jf.InputError("enough")

    monkeypatch.setattr(FILTERS[method], "classify", classify)
    assert_one_line(ground(folder, *words, method=method), 1, "enough")
    assert seen == [FILTERS[method](**values)]
    assert "[symbol s; > 0 rise/run; default 0.15]" in " ".join(run("ground", "smrf", "--help").stdout.split())


@pytest.mark.parametrize("options, width", [(("--largest-building", 25), 25.0), (("--for-cloud",), None)])
def test_presets_and_the_cloud_set_parameters(folder, scene, options, width):
    np.savetxt(folder / "sparse.txt", scene.xyz[::12], fmt="%.3f")
    arguments = ("--preset", "recommended", "--json", *options)
    result = ground(folder, *arguments, source="sparse.txt", target="out.txt", method="smrf")
    expected = FILTERS["smrf"].for_cloud(read(folder / "sparse.txt"), width, preset="recommended")
    assert expected.cell > FILTERS["smrf"].preset("recommended").cell, "the spacing decides something"
    given = json.loads(result.stdout)["parameters"]
    for name, value in dataclasses.asdict(expected).items():
        assert given[name] == value or float(given[name]) == value  # infinity is a string in JSON


@pytest.mark.parametrize("target, arguments, words", [
    ("out.laz", ("--max-angle", "-1"), ("FPTD(max_angle=-1.0)", "must be > 0 and < 90")),
    ("out.laz", ("--window", "nan"), ("window=nan",)),
    ("out.laz", ("--units", "parsec"), ("parsec", "us-ft")),
    ("out.laz", ("--returns", "second"), ("second", "intermediate")),
    ("truth.laz", (), ("--overwrite",)),
    ("scene.laz", (), ("--in-place",)),
    ("no/out.laz", (), ("not a folder",)),
    ("out.tif", (), ("suffix",)),
])  # fmt: skip
def test_wrong_usage_is_found_before_reading(folder, target, arguments, words):
    (folder / "scene.laz").write_bytes(b"not a point cloud")
    before = everything(folder)
    assert_one_line(ground(folder, *arguments, target=target), 2, *words)
    assert everything(folder) == before


def test_overwrite_and_in_place_do_as_told_and_quiet_says_nothing(folder):
    assert (
        "points are ground" in done("ground", "fptd", folder / "scene.laz", folder / "truth.laz", "--overwrite").stdout
    )
    assert done("ground", "fptd", folder / "scene.laz", "--in-place", "--quiet").stdout == ""
    assert all((classes_of(folder / name) == 2).any() for name in ("truth.laz", "scene.laz"))
    assert sorted(everything(folder)) == ["scene.laz", "truth.laz", "truth.txt"]


def test_a_damaged_file_is_one_line_and_exit_code_1(folder):
    whole = (folder / "scene.laz").read_bytes()
    (folder / "scene.laz").write_bytes(whole[: len(whole) // 2])
    assert_one_line(ground(folder), 1, "scene.laz")
    assert not (folder / "out.laz").exists()


@pytest.mark.parametrize(
    "error, code", [(MemoryError("no room"), 1), (KeyboardInterrupt(), 130), (ValueError("odd"), 1)]
)
def test_a_run_that_fails_leaves_nothing(folder, monkeypatch, error, code):
    def fails(*_, **__):
        raise error

    monkeypatch.setattr(FILTERS["fptd"], "classify", fails)
    before = everything(folder)
    for arguments in ((), ("--in-place",)):
        result = ground(folder, *arguments, target="scene.laz" if arguments else "out.laz")
        assert result.exit_code == code
        assert "Traceback" not in result.output
        assert everything(folder) == before
    if not isinstance(error, KeyboardInterrupt):
        assert type(ground(folder, "--debug").exception) is type(error)


@pytest.fixture
def survey(folder):
    """survey.las: a delivered tile with a river, a bridge and a class of the producer's own inside; its classes."""
    las = laspy.read(folder / "truth.laz")
    x, y = (np.asarray(v) - v.min() for v in (las.x, las.y))
    las.classification[np.abs(x - 20) < 5] = 9
    las.classification[np.abs(y - 30) < 3] = 17
    las.classification[np.hypot(x - 45, y - 45) < 6] = 26
    edge = np.minimum(np.minimum(x, y), np.minimum(x.max() - x, y.max() - y)) == 0
    las.withheld[::40] = True
    las.classification[edge] = 1  # the extent stays when what is kept is taken away
    las.write(folder / "survey.las")
    return np.asarray(las.classification).copy()


@pytest.mark.parametrize("method", ["fptd", "smrf"])
def test_classes_of_a_survey_are_kept_and_have_no_influence(folder, survey, method):
    kept = np.isin(survey, (9, 17, 26))
    report = facts("ground", method, folder / "survey.las", folder / "out.las")
    classes = classes_of(folder / "out.las")
    np.testing.assert_array_equal(classes[kept], survey[kept])
    pairs, counts = np.unique(np.stack([survey, classes]), axis=1, return_counts=True)
    assert report["classes"] == [
        {"before": a, "after": b, "points": n} for a, b, n in zip(*pairs.tolist(), counts.tolist(), strict=True)
    ]
    assert report["of_ground_class"] == (classes == 2).sum() > report["ground"], "withheld ground stays"

    las = laspy.read(folder / "survey.las")
    las.points = las.points[~kept]
    las.write(folder / "dry.las")
    done("ground", method, folder / "dry.las", folder / "alone.las")
    np.testing.assert_array_equal(classes_of(folder / "alone.las"), classes[~kept])


def test_classes_before_and_after_are_printed_and_can_be_judged(folder, survey):
    plain = ground(folder, source="survey.las", target="out.las", method="smrf").stdout
    assert ["9", "water", "kept", f"{(survey == 9).sum():,}"] in [line.split() for line in plain.splitlines()]
    of_class = (classes_of(folder / "out.las") == 2).sum()
    assert re.search(rf"points that were not judged keep class 2: [\d,]+; in all {of_class:,} points have it", plain)
    every = ("--returns", "all", "--keep-withheld", "--overwrite")
    report = facts("ground", "smrf", folder / "survey.las", folder / "all.las", "--ignore-class", "none", *every)
    assert report["candidates"] == len(survey) and report["of_ground_class"] == report["ground"]
    report = facts("ground", "smrf", folder / "survey.las", folder / "all.las", "--ignore-class", "26", *every)
    assert report["candidates"] == (survey != 26).sum(), "--ignore-class replaces the default"


def test_points_of_the_overlap_are_judged_and_named_unless_they_are_set_aside(folder, survey):
    las = laspy.read(folder / "survey.las")
    strip = np.abs(las.x - np.mean(las.x)) < 6
    las.classification[strip] = 12
    laspy.convert(las, point_format_id=1).write(folder / "marked.las")  # which has no flag
    judged = done("ground", "smrf", folder / "marked.las", folder / "judged.las", "--overlap-flag")
    named = re.search(r"([\d,]+) points are of class 12 or have the overlap flag: ([\d,]+) of them were", judged.stdout)
    assert int(named[1].replace(",", "")) == strip.sum() >= int(named[2].replace(",", "")) > 100
    assert "points of class 12 keep their class" in judged.output
    assert "--ignore-overlap sets them aside" in " ".join(judged.stdout.split())
    aside = facts("ground", "smrf", folder / "marked.las", folder / "aside.las", "--ignore-overlap")
    assert aside["overlap"] == {"points": strip.sum(), "judged": 0, "ground": 0, "kept": 0}
    assert (classes_of(folder / "aside.las")[strip] == 12).all()


@pytest.mark.parametrize("source", ["truth.txt", "scene.laz"])
def test_text_without_classes_cannot_hold_noise(folder, source):
    result = ground(folder, "--noise-class", "7", source=source, target="out.txt", method="smrf")
    assert_one_line(result, 1, "out.txt", "--noise-class 7")
    assert not (folder / "out.txt").exists()


@pytest.mark.parametrize("source, target", [("truth.txt", "out.txt"), ("truth.laz", "out.csv")])
def test_the_summary_of_text_speaks_of_its_labels(folder, source, target):
    report = facts("ground", "smrf", folder / source, folder / target)
    out = np.genfromtxt(folder / target, delimiter="," if "csv" in target else None)
    held = [{"label": k, "points": int((out[:, 3] == k).sum())} for k in (0, 1)]
    assert report["labels"] == held and report["classes"] == [] and held[0]["points"] == report["ground"] > 0
    shown = ground(folder, "--overwrite", source=source, target=target, method="smrf").stdout
    assert f"label 0: {held[0]['points']:,}, label 1: {held[1]['points']:,}" in shown and "class" not in shown


def test_the_summary_of_text_with_classes_speaks_of_these(folder, scene):
    table = np.column_stack([scene.xyz, scene.classes])
    np.savetxt(folder / "in.csv", table, "%.3f,%.3f,%.3f,%d", header="x,y,z,classification", comments="")
    report = facts("ground", "smrf", folder / "in.csv", folder / "out.csv")
    classes = np.genfromtxt(folder / "out.csv", delimiter=",", skip_header=1)[:, 3]
    after = {k: sum(one["points"] for one in report["classes"] if one["after"] == k) for k in range(256)}
    assert after == {k: int((classes == k).sum()) for k in range(256)} and "labels" not in report


def test_a_log_says_what_was_done_when(folder):
    log = folder / "näher.log"
    log.write_text("before\n", encoding="utf-8")
    assert ground(folder, "--log", log, "-q", method="smrf").exit_code == 0
    assert ground(folder, "--log", log, method="smrf").exit_code == 2, "out.laz exists"
    lines = log.read_text(encoding="utf-8").splitlines()
    assert lines[0] == "before"
    times = [datetime.datetime.fromisoformat(line.split()[0]) for line in lines[1:]]
    assert times == sorted(times) and abs(times[0] - datetime.datetime.now()).total_seconds() < 600
    said = [line.split(" ", 1)[1] for line in lines[1:]]
    for begin in ("INFO jaxfilter ", "WARNING ", "INFO read: ", "INFO filter: ", "INFO write: ", "INFO done in "):
        assert sum(line.startswith(begin) for line in said) == 1 + (begin == "INFO jaxfilter "), begin
    assert any("points are ground" in line for line in said)
    assert said[-1].startswith("ERROR ") and "exists" in said[-1]


def test_a_log_is_neither_an_input_nor_in_a_place_that_cannot_be_written(folder):
    before = everything(folder)
    assert_one_line(ground(folder, "--log", folder / "scene.laz"), 2, "scene.laz", "input or output")
    assert_one_line(ground(folder, "--log", folder / "no" / "a.log"), 2, "a.log", "cannot be written")
    assert_one_line(run("info", folder, "--log", folder / "scene.laz"), 2, "scene.laz", "is no log")
    assert everything(folder) == before


def test_places_and_breaklines_are_two_files(folder):
    both, made = folder / "both.gpkg", folder / "made"
    assert_one_line(ground(folder, "--review", both, "--breaklines", both), 2, "both.gpkg", "name another")
    words = ("--ground-class", 2, "--overwrite", "--only", "contours", "--breaklines", made / "contours.gpkg")
    assert_one_line(run("products", folder / "truth.laz", made, *words), 2, "contours.gpkg", "name another")
    assert not both.exists() and not made.exists()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no device that is always full")
def test_a_full_disk_of_the_log_is_said_once_and_stops_nothing(folder, capfd):
    result = ground(folder, "--log", "/dev/full", "-q", method="smrf")
    assert result.exit_code == 0 and (folder / "out.laz").exists(), result.output
    assert result.stderr.count("/dev/full: cannot be written on") == 1 and "Traceback" not in capfd.readouterr().err


def test_progress_where_there_is_no_terminal_is_a_line_now_and_then(folder):
    assert "densify" not in ground(folder, method="fptd").stderr, "it takes less than a minute"
    result = ground(folder, "--overwrite", "--progress-every", 0, method="fptd")
    line = next(line for line in result.stderr.splitlines() if line.startswith("densify: "))
    assert re.fullmatch(r"densify: \d+ %(, [\d.]+( k)? points/s)?(, \d+ s left)?, [\d.]+ [MG]B", line), line
    assert "densify" not in ground(folder, "-q", "--overwrite", "--progress-every", 0, method="fptd").stderr


@pytest.mark.parametrize("source, reference", [("scene.laz", "truth.laz"), ("truth.laz", "truth.txt")])
def test_evaluate_counts_points_in_any_order(folder, scene, source, reference):
    ground(folder, source=source)
    labels = classes_of(folder / "out.laz") == 2
    for arguments, counted in (
        ((), np.ones(len(scene), bool)),
        (("--candidates-only",), read(folder / source, units="m").candidate),
        (("--ignore-class", "5", "--ignore-class", "6"), ~np.isin(scene.classes, (5, 6))),
    ):
        confusion = facts("evaluate", folder / "out.laz", folder / reference, *arguments)["confusion"]
        for row, truth in zip(confusion, (scene.truth, ~scene.truth), strict=True):
            assert row == [(counted & truth & labels).sum(), (counted & truth & ~labels).sum()]


def test_evaluate_and_report_take_folders(folder, scene):
    """Two halves of a scene in folders have the counts of the whole."""
    ground(folder, source="truth.laz")
    west = scene.xyz[:, 0] < np.median(scene.xyz[:, 0])
    for name, source in (("found", "out.laz"), ("truth", "truth.laz")):
        (folder / name).mkdir()
        las = laspy.read(folder / source)
        for number, part in enumerate((west, ~west)):
            piece = laspy.LasData(las.header)
            piece.points = las.points[part]
            piece.write(folder / name / f"{number}.laz")
    both = facts("evaluate", folder / "found", folder / "truth")
    assert both["confusion"] == facts("evaluate", folder / "out.laz", folder / "truth.laz")["confusion"]
    assert np.array_equal(np.sum([one["confusion"] for one in both["files"]], axis=0), both["confusion"])
    assert facts("report", folder / "found", folder / "page.html")["points"] == len(scene)
    assert_one_line(run("evaluate", folder / "found", folder / "truth.laz"), 2, "two files or two folders")
    (folder / "truth" / "1.laz").unlink()
    assert_one_line(run("evaluate", folder / "found", folder / "truth"), 2, "holds 1 and")


def test_evaluate_prints_a_table_and_undefined_figures_as_null(folder, scene):
    write(folder / "empty.laz", scene.cloud, np.zeros(len(scene), bool), reset="all")
    plain = done("evaluate", folder / "empty.laz", folder / "truth.laz").stdout
    assert "Type I 100.00" in plain and "reference object            0      2,565" in plain
    assert facts("evaluate", folder / "empty.laz", folder / "truth.laz")["precision"] is None


def test_evaluate_refuses_other_points_and_missing_labels(folder):
    cut = np.loadtxt(folder / "truth.txt")
    np.savetxt(folder / "cut.txt", cut[1:], fmt=("%.3f", "%.3f", "%.3f", "%d"))
    cut[0, 2] += 1
    np.savetxt(folder / "moved.txt", cut, fmt=("%.3f", "%.3f", "%.3f", "%d"))
    assert_one_line(run("evaluate", folder / "truth.laz", folder / "cut.txt"), 1, "cut.txt", "the same points")
    assert_one_line(run("evaluate", folder / "truth.laz", folder / "moved.txt"), 1, "do not hold the same points")
    assert_one_line(run("evaluate", folder / "truth.laz", folder / "scene.laz"), 1, "no ground labels")


def test_methods_and_info_speak_json(folder, scene):
    table, listed = facts("methods"), run("methods").stdout
    assert list(table) == list(FILTERS)
    for name, method in FILTERS.items():
        assert f"\n{name}  " in f"\n{listed}"
        assert all(f"  --preset {preset}: {values.note}\n" in listed for preset, values in method.PRESETS.items())
    assert table["fptd"]["notes"]["D1"] == FILTERS["fptd"].PRESETS["D1"].note
    found = facts("info", folder / "scene.laz")
    assert found["points"] == len(scene) and found["extra_bytes"] == []
    shown = dict(line.split("  ", 1) for line in run("info", folder / "scene.laz").stdout.splitlines())
    assert shown["points"].strip() == f"{len(scene):,}" and shown["extra bytes"].strip() == "none"
    assert float(shown["candidates per m2"]) == pytest.approx(found["density"], rel=1e-3)


def test_demo_leaves_a_scene_with_its_truth_and_labels(tmp_path):
    made = facts("demo", tmp_path / "demo", "--method", "msf", "--size", "120", "120")
    assert made["scores"]["kappa"] > 50
    assert sorted(p.name for p in (tmp_path / "demo").iterdir()) == sorted(os.path.basename(f) for f in made["files"])
    for name in ("scene.laz", "scene_truth.laz", "scene_ground.laz"):  # a warning on units would be an error
        assert read(tmp_path / "demo" / name).crs.to_epsg() == 25832


@pytest.mark.parametrize("arguments, words", [
    (("ground", "--method", "smrf", "in.laz", "out.laz"), "ground smrf IN OUT"),
    (("height", "in.laz", "out.laz", "--method", "smrf"), "--filter"),
    (("compare", "in.laz"), "jf.compare"),
    (("review", "in.laz"), "OUT is missing"),
    (("ground", "fptd", "{scene}"), "OUT is missing"),
    (("ground", "fptd", "nothing.laz", "out.laz"), "nothing.laz"),
    (("ground", "nosuch", "{scene}", "out.laz"), "the methods are"),
    (("ground", "fptd", "{scene}", "out.laz", "--nosuch", "3"), "--nosuch"),
    (("ground", "fptd", "{scene}", "out.laz", "--max-rounds", "1.5"), "1.5"),
    (("ground", "fptd", "{scene}", "out.laz", "--window", "none"), "none"),
    (("ground", "spf", "{scene}", "out.laz", "--fill", "best"), "zero"),
    (("ground", "ost", "{scene}", "out.laz", "--spacing", "nothing"), "nothing"),
    (("smrf", "in.laz", "out.laz"), "ground smrf IN OUT"),
    (("{scene}", "out.laz"), "ground {scene} OUT"),
    (("demo", "{folder}"), "truth.laz): name another folder, or pass --overwrite"),
    (("demo", "{folder}/demo", "--method", "nosuch"), "nosuch"),
])  # fmt: skip
def test_what_is_typed_first_gets_an_answer_that_leads_on(folder, arguments, words):
    names, before = {"scene": folder / "scene.laz", "folder": folder}, everything(folder)
    result = run(*(word.format(**names) for word in arguments))
    assert result.exit_code == 2 and words.format(**names) in result.stderr, result.stderr
    for command in re.findall(r"jaxfilter ([a-z]+)", result.stderr.partition("Error: ")[2]):
        assert command in main.commands
    assert everything(folder) == before


def test_help_of_the_default_lists_its_options_and_the_methods():
    shown = run("ground", "--help").stdout
    assert all(f"\n  {words} " in shown for words in ("--overwrite", "--noise-class", "--review", "smrf", "ost"))
    assert "--scaling" not in shown and "default [OPTIONS]" not in run("ground", "in.laz", "--nosuch").stderr


def test_help_does_not_wait_for_jax():
    code = "import sys, jaxfilter.cli; sys.exit(any(m in sys.modules for m in ('jax', 'scipy', 'laspy', 'matplotlib')))"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
