"""``ground``, ``dtm`` and ``height`` of collections on the command line."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

import jaxfilter as jf
from jaxfilter.cli import main
from jaxfilter.cli.values import Bytes


def run(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def survey(tmp_path_factory, scene):
    """Two LAZ files, west and east."""
    folder = tmp_path_factory.mktemp("survey")
    xyz, cloud = scene.cloud.coordinates(), scene.cloud
    west = xyz[:, 0] < np.median(xyz[:, 0])
    for name, rows in (("west", west), ("east", ~west)):
        part = jf.PointCloud.from_arrays(
            xyz[rows],
            crs="EPSG:25832",
            return_number=cloud.return_number[rows],
            number_of_returns=cloud.number_of_returns[rows],
        )
        jf.write(folder / f"{name}.laz", part, np.zeros(len(part), bool), only_ground=True)
    return folder


@pytest.fixture(scope="module")
def done(survey, tmp_path_factory):
    """A run over the folder: its output and what it printed."""
    out = tmp_path_factory.mktemp("done") / "out"
    result = run("ground", "pmf", survey, out, "--max-window", 9, "--workers", 1, "--json", "--quiet")
    assert result.exit_code == 0, result.output
    return out, json.loads(result.stdout)


def test_a_folder_is_classified_into_a_folder(survey, done):
    out, report = done
    assert sorted(path.name for path in out.glob("*.laz")) == ["east.laz", "west.laz"]
    ground = sum(int((jf.read(path).classification == 2).sum()) for path in out.glob("*.laz"))
    assert report["complete"] and report["method"] == "PMF" and report["parameters"]["max_window"] == 9
    assert report["ground"] == ground == sum(r["points"] for r in report["classes"] if r["after"] == 2) > 1000
    assert report["points"] == sum(len(jf.read(path)) for path in survey.glob("*.laz"))


def test_a_folder_that_holds_something_is_refused_and_resumed(survey, done):
    refused = run("ground", "pmf", survey, done[0], "--max-window", 9)
    assert refused.exit_code == 1 and "pass --resume" in refused.stderr and "pass --overwrite" in refused.stderr
    again = run("ground", "pmf", survey, done[0], "--max-window", 9, "--resume", "--workers", 1)
    assert again.exit_code == 0 and f"{done[1]['ground']:,} of {done[1]['points']:,} points are ground" in again.stdout
    assert "again" not in again.stderr
    written = (done[0] / "east.laz").read_bytes()
    (done[0] / "east.laz").unlink()
    again = run("ground", "pmf", survey, done[0], "--max-window", 9, "--resume", "--workers", 1)
    assert again.exit_code == 0 and "east.laz: is missing, so it had to be made again" in " ".join(again.stderr.split())
    assert (done[0] / "east.laz").read_bytes() == written
    facts = done[0] / ".jaxfilter-run" / "run.json"
    sound = facts.read_bytes()
    for text in (b"no facts", b"[" * 100_000 + b"]" * 100_000, b"1" * 5000):
        facts.write_bytes(text)
        damaged = run("ground", "pmf", survey, done[0], "--max-window", 9, "--resume")
        assert damaged.exit_code == 1 and "run.json: is damaged" in damaged.stderr
        assert "pass --overwrite to begin the run anew" in damaged.stderr
    facts.write_bytes(sound)
    other = run("ground", "pmf", survey, done[0], "--max-window", 11, "--resume")
    assert other.exit_code == 1 and "results are not mixed" in other.stderr


def test_what_fails_is_named_and_the_exit_code_is_1(survey, tmp_path):
    for path in survey.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "broken.laz").write_bytes(b"LASF" + bytes(300))
    result = run("ground", "pmf", tmp_path / "*.laz", tmp_path / "out", "--max-window", 9, "--workers", 1)
    assert result.exit_code == 1 and "not written" in result.stderr and "broken.laz" in result.stderr
    assert len(list((tmp_path / "out").glob("*.laz"))) == 2


@pytest.mark.parametrize(
    "words, message",
    [
        (("smfr", "{survey}", "out"), "smfr: no such file or folder, and no method: choose one of agptd"),
        (("pmf", "{survey}", "nothing.laz", "out"), "nothing.laz: no such file"),
        (("pmf", "{survey}", "out", "--bounds", 2, 0, 1, 1), "bounds=(2.0, 0.0, 1.0, 1.0)"),
        (("pmf", "{survey}", "out", "--memory", "much"), "is no number of bytes"),
        (("pmf", "{survey}", "out", "--memory", "4"), "is no number of bytes"),
        (("pmf", "{survey}", "out", "--slope", -1), "PMF(slope=-1.0)"),
        (("pmf", "{survey}/west.laz", "out.laz", "--memory", "1MB"), "memory=1e+06 bytes do not suffice"),
        (("smfr", "out.laz"), "smfr: no such file or folder, and no method: choose one of agptd"),
        (("pmf", "{survey}", "out.laz"), "out.laz: 2 files are written into a folder"),
        (("absent.laz", "out.laz"), "absent.laz: no such file or folder"),
    ],
)
def test_wrong_usage_ends_before_anything_is_written(survey, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    result = run("ground", *(str(word).format(survey=survey) for word in words))
    assert result.exit_code == 2 and message in " ".join(result.stderr.split()), result.stderr
    assert not list(tmp_path.iterdir())


def test_without_a_method_a_file_gets_the_default(survey, tmp_path):
    result = run("ground", survey / "west.laz", tmp_path / "out.laz", "--json", "--quiet")
    assert result.exit_code == 0, result.output
    cloud = jf.read(survey / "west.laz")
    assert json.loads(result.stdout)["ground"] == jf.default_filter(cloud)(cloud).ground.sum()


def test_a_terrain_model_of_a_folder(done, tmp_path):
    log = tmp_path / "a.log"
    result = run("dtm", done[0], tmp_path / "dtm.tif", "--cell", 2, "--workers", 1, "--json", "--quiet", "--log", log)
    assert result.exit_code == 0, result.output
    raster, report = jf.Raster.read(tmp_path / "dtm.tif"), json.loads(result.stdout)
    assert raster.values.shape == (report["rows"], report["columns"]) == (30, 30)
    assert np.isfinite(raster.values).mean() > 0.95 and raster.crs.to_epsg() == 25832
    assert run("dtm", done[0], tmp_path / "dtm.tif", "--log", log).exit_code == 2, "exists"
    said = log.read_text()
    for words in (
        " INFO run: ",
        f"through {report['ground']:,} ground points",
        "INFO done in",
        "ERROR",
        "dtm.tif exists",
    ):
        assert words in said, said
    assert run("dtm", done[0], tmp_path / "b.tif", "--set", "slope=2").exit_code == 2, "without --filter"


def test_heights_of_a_folder(done, tmp_path):
    log = tmp_path / "a.log"
    result = run("height", done[0], tmp_path / "out", "--replace-z", "--workers", 1, "--json", "--quiet", "--log", log)
    assert result.exit_code == 0, result.output
    report, z = json.loads(result.stdout), []
    for path in sorted(done[0].glob("*.laz")):
        before, after = jf.read(path), jf.read(tmp_path / "out" / path.name)
        assert np.array_equal(before.classification, after.classification)
        z.append(after.coordinates()[:, 2])
    assert report["complete"] and report["dimension"] == "Z" and report["ground"] == done[1]["ground"]
    assert (report["lowest"], report["highest"]) == pytest.approx(
        (np.concatenate(z).min(), np.concatenate(z).max()), abs=0.002
    )
    assert f"{report['points']:,} points above {report['ground']:,} ground points" in log.read_text()
    assert run("height", done[0], tmp_path / "out").exit_code == 1, "not empty"
    for words, message in (
        ((done[0], tmp_path / "new", "--in-place"), "new: no such file or folder"),
        ((done[0], "s3://bucket/out"), "pass --work"),
        ((done[0], tmp_path / "a.laz"), "a.laz: 2 files are written into a folder"),
    ):
        wrong = run("height", *words)
        assert wrong.exit_code == 2 and message in wrong.stderr, wrong.output


@pytest.mark.parametrize(
    "text, size", [("4GB", 4e9), ("512MiB", 2**29), ("1e9", 1e9), ("1.5 g", 1.5e9), ("7000000", 7e6)]
)
def test_sizes(text, size):
    assert Bytes().convert(text, None, None) == size


def test_what_tiles_cost_is_said_before_and_small_ones_are_refused(survey, tmp_path):
    words = ("ground", "pmf", survey, tmp_path / "out", "--max-window", 9, "--halo", 30, "--tile", 10, "--workers", 1)
    refused, forecast = run(*words), run(*words, "--dry-run")
    assert refused.exit_code == forecast.exit_code == 2 and refused.stderr == forecast.stderr
    assert "pass --tile with more, leave it out, or pass --wide-halos" in refused.stderr
    assert not (tmp_path / "out").exists()
    result = run(*words, "--wide-halos")
    assert result.exit_code == 0, result.output
    facts = json.loads((tmp_path / "out" / "jaxfilter-run.json").read_text())
    said = re.search(r"(\d+) tiles; with their surroundings each point is read ([\d.]+) times", result.stderr)
    assert said and int(said[1]) == facts["tiles"]
    assert float(said[2]) == pytest.approx(
        facts["read"] / facts["points"], rel=0.3
    )  # the plan knows densities of files only
    assert f"every point would be read {said[2]} times" in refused.stderr
    wide = run("ground", "pmf", survey, tmp_path / "wide", "--max-window", 9, "--halo", 5, "--tile", 50, "--workers", 1)
    assert wide.exit_code == 0 and "tiles; with" in wide.stderr
