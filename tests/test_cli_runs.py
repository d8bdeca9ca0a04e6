"""``ground``, ``dtm`` and ``height`` of collections on the command line."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from commands import done as completed
from commands import facts, run

import jaxfilter as jf

PMF = ("--max-window", 9, "--workers", 1)


@pytest.fixture(scope="module")
def survey(tmp_path_factory, scene):
    """Two LAZ files, west and east."""
    folder = tmp_path_factory.mktemp("survey")
    xyz, cloud = scene.cloud.coordinates(), scene.cloud
    west = xyz[:, 0] < np.median(xyz[:, 0])
    for name, rows in (("west", west), ("east", ~west)):
        echoes = {key: getattr(cloud, key)[rows] for key in ("return_number", "number_of_returns")}
        part = jf.PointCloud.from_arrays(xyz[rows], crs="EPSG:25832", **echoes)
        jf.write(folder / f"{name}.laz", part, np.zeros(len(part), bool), only_ground=True)
    return folder


@pytest.fixture(scope="module")
def done(survey, tmp_path_factory):
    """A run over the folder: its output and what it printed."""
    out = tmp_path_factory.mktemp("done") / "out"
    return out, facts("ground", "pmf", survey, out, *PMF, "--quiet")


def test_a_folder_that_holds_something_is_refused_and_resumed(survey, done):
    words, report = ("ground", "pmf", survey, done[0], *PMF), done[1]
    refused = run(*words)
    assert refused.exit_code == 1 and "pass --resume" in refused.stderr and "pass --overwrite" in refused.stderr
    again = completed(*words, "--resume")
    assert f"{report['ground']:,} of {report['points']:,} points are ground" in again.stdout
    facts = done[0] / ".jaxfilter-run" / "run.json"
    sound = facts.read_bytes()
    for text in (b"no facts", b"[" * 100_000 + b"]" * 100_000, b"1" * 5000):
        facts.write_bytes(text)
        damaged = run(*words, "--resume")
        assert damaged.exit_code == 1 and "run.json: is damaged" in damaged.stderr
        assert "pass --overwrite to begin the run anew" in damaged.stderr
    facts.write_bytes(sound)


def test_what_fails_is_named_and_the_exit_code_is_1(survey, tmp_path):
    (tmp_path / "broken.laz").write_bytes(b"LASF" + bytes(300))
    result = run("ground", "pmf", survey, tmp_path / "*.laz", tmp_path / "out", *PMF)
    assert result.exit_code == 1 and "not written" in result.stderr and "broken.laz" in result.stderr
    assert len(list((tmp_path / "out").glob("*.laz"))) == 2


@pytest.mark.parametrize("words, message", [
    (("smfr", "{survey}", "out"), "smfr: there is no such file, folder or method; the methods are agptd"),
    (("pmf", "{survey}", "nothing.laz", "out"), "nothing.laz: there is no such file"),
    (("pmf", "{survey}", "out", "--bounds", 2, 0, 1, 1), "--bounds (2.0, 0.0, 1.0, 1.0)"),
    (("pmf", "{survey}", "out", "--memory", "much"), "is no number of bytes"),
    (("pmf", "{survey}/west.laz", "out.laz", "--memory", "1.5 m"), "--memory 1.5e+06 bytes do not suffice"),
    (("pmf", "{survey}/west.laz", "out.laz", "--memory", "0.002 gb"), "--memory 2e+06 bytes do not suffice"),
    (("pmf", "{survey}/west.laz", "out.laz", "--memory", "2MiB"), "--memory 2.1e+06 bytes do not suffice"),
    (("pmf", "{survey}", "out", "--slope", -1), "PMF(slope=-1.0)"),
    (("pmf", "{survey}", "out.laz"), "out.laz: 2 files are written into a folder"),
    (("absent.laz", "out.laz"), "absent.laz: there is no such file or folder"),
])  # fmt: skip
def test_wrong_usage_ends_before_anything_is_written(survey, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    result = run("ground", *(str(word).format(survey=survey) for word in words))
    assert result.exit_code == 2 and message in " ".join(result.stderr.split()), result.stderr
    assert not list(tmp_path.iterdir())


def test_without_a_method_a_file_gets_the_default(survey, tmp_path):
    cloud = jf.read(survey / "west.laz")
    report = facts("ground", survey / "west.laz", tmp_path / "out.laz", "--quiet")
    assert report["ground"] == jf.default_filter(cloud)(cloud).ground.sum()


def test_heights_go_into_an_empty_folder(done, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    assert run("height", done[0], tmp_path / "out").exit_code == 1, "not empty"
    for words, message in (
        ((done[0], tmp_path / "new", "--in-place"), "new: there is no such file or folder"),
        ((done[0], "s3://bucket/out"), "pass --work"),
        ((done[0], tmp_path / "a.laz"), "a.laz: 2 files are written into a folder"),
    ):
        wrong = run("height", *words)
        assert wrong.exit_code == 2 and message in wrong.stderr, wrong.output


def test_what_tiles_cost_is_said_before_and_small_ones_are_refused(survey, tmp_path):
    words = ("ground", "pmf", survey, tmp_path / "out", *PMF, "--halo", 30, "--tile", 10)
    refused, forecast = run(*words), run(*words, "--dry-run")
    assert refused.exit_code == forecast.exit_code == 2 and refused.stderr == forecast.stderr
    assert "pass --tile with more, leave it out, or pass --wide-halos" in refused.stderr
    assert not (tmp_path / "out").exists()
    result = completed(*words, "--wide-halos")
    report = json.loads((tmp_path / "out" / "jaxfilter-run.json").read_text())
    said = re.search(r"(\d+) tiles; with their surroundings each point is read ([\d.]+) times", result.stderr)
    assert said and int(said[1]) == report["tiles"]
    assert float(said[2]) == pytest.approx(report["read"] / report["points"], rel=0.3), "by densities of files"
    assert f"every point would be read {said[2]} times" in refused.stderr
    wide = completed("ground", "pmf", survey, tmp_path / "wide", *PMF, "--halo", 5, "--tile", 50)
    assert "tiles; with" in wide.stderr
