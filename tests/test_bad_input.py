"""Bad and odd input through the command line: a typed error in one line and nothing written, or a warning and a whole output.

How files are damaged in detail is in ``test_bad_input_files.py``; what each method does with odd clouds in ``test_filters.py``.
"""

from __future__ import annotations

import re

import click
import laspy
import numpy as np
import pytest
import rasterio
from click.testing import CliRunner
from las_files import las_of, make_las, patch

from jaxfilter.cli import main
from jaxfilter.cli.commands import ground_command

UTM = {"crs": 32632, "offsets": (440000.0, 4750000.0, 100.0), "scales": (0.01, 0.01, 0.001)}


def run(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


def ground(source, target, *options):
    return run("ground", "pmf", source, target, *options)


def terrain(n=900, seed=0):
    """f64[n, 3]: a gentle hill on 30 x 30 m, with some points a few metres above it."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, 30, (n, 2)).round(2)
    z = 0.05 * xy[:, 0] + 2 * np.sin(xy[:, 1] / 12) + np.where(rng.random(n) < 0.2, rng.uniform(3, 6, n), 0)
    return np.column_stack([xy, z.round(2)])


def written(path, xyz, **fields):
    las_of(path, np.asarray(xyz) + UTM["offsets"], **(UTM | {"classification": 1} | fields))
    return path


def assert_refused(result, folder, *words):
    assert result.exit_code == 1, result.output
    lines = [line for line in result.stderr.splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1 and lines[0].startswith("Error: "), result.stderr
    for word in words:
        assert word in lines[0], lines[0]
    assert not list(folder.glob("out*")) and not list(folder.glob(".*")), "something was left"


def assert_warned(result, *words):
    assert result.exit_code == 0, result.output
    warnings = [line for line in result.stderr.splitlines() if line.startswith("warning: ")]
    assert any(all(word in line for word in words) for line in warnings), result.stderr


def labels(path):
    return np.asarray(laspy.read(path).classification) == 2


@pytest.mark.parametrize("name, spoil, words", [
    ("in.las", lambda path: path.write_bytes(b""), "empty"),
    ("in.las", lambda path: patch(path, "Q", 247, 10**7), "announces 10000000 points"),
    ("in.laz", lambda path: path.write_bytes(path.read_bytes()[:-900]), "truncated"),
])  # fmt: skip
def test_damaged_files(tmp_path, name, spoil, words):
    make_las(tmp_path / name, 6)
    spoil(tmp_path / name)
    assert_refused(ground(tmp_path / name, tmp_path / "out.las"), tmp_path, str(tmp_path / name), words)


@pytest.mark.parametrize("name", ["in.las", "in.laz", "in.txt"])
def test_no_points(tmp_path, name):
    source = tmp_path / name
    if name == "in.txt":
        source.write_text("")
    else:
        make_las(source, 6, n=0)
    for target in ("out.las", "out.laz", "out.txt"):
        assert_warned(ground(source, tmp_path / target), f"{name}: holds no points")
    assert [laspy.read(tmp_path / target).header.point_count for target in ("out.las", "out.laz")] == [0, 0]
    assert (tmp_path / "out.txt").read_text() == ""
    assert '"bounds": null' in run("info", source, "--json").stdout
    assert_warned(run("dtm", source, tmp_path / "out.tif", "--bounds", 0, 0, 3, 2), "no points")
    with rasterio.open(tmp_path / "out.tif") as raster:
        assert raster.shape == (2, 3) and (raster.read(1) == raster.nodata).all()
    (tmp_path / "out.tif").unlink()
    refused = run("dtm", source, tmp_path / "out.tif")
    assert refused.exit_code == 1 and "--bounds" in refused.stderr and not (tmp_path / "out.tif").exists()


@pytest.mark.parametrize("xyz, few", [
    ([[1, 2, 3]], True), ([[1, 2, 3], [4, 5, 6], [4, 5, 9]], True), ([[i, 2 * i, i % 2] for i in range(50)], True),
    ([[0, 0, 0], [9, 0, 1], [0, 9, 2], [9, 9, 1]], False),
])  # fmt: skip
def test_few_points_and_points_on_a_line(tmp_path, xyz, few):
    result = ground(written(tmp_path / "in.las", xyz), tmp_path / "out.las")
    if not few:
        assert result.exit_code == 0 and "warning: " not in result.stderr
        return
    assert_warned(result, "fewer than four distinct positions, or all on a line")
    xyz = np.asarray(xyz)
    lowest = np.array([z == xyz[(xyz[:, :2] == xy).all(axis=1), 2].min() for *xy, z in xyz.tolist()])
    np.testing.assert_array_equal(labels(tmp_path / "out.las"), lowest)


@pytest.mark.parametrize("fields", [{"classification": 7}, {"withheld": 1}, {"number_of_returns": 2}])
def test_nothing_to_judge_leaves_the_points_as_they_are(tmp_path, fields):
    source = written(tmp_path / "in.las", terrain(), **fields)
    assert_warned(ground(source, tmp_path / "out.las"), "no point is a candidate")
    assert (tmp_path / "out.las").read_bytes() == source.read_bytes()


def test_no_crs_and_feet(tmp_path):
    xyz = terrain()
    metres = written(tmp_path / "m.las", xyz, crs=None)
    assert_warned(ground(metres, tmp_path / "out.las"), "metres are assumed", "--units")
    feet = written(tmp_path / "ft.las", xyz / [1200 / 3937, 1200 / 3937, 0.3048], scales=0.001, crs=None)
    result = ground(feet, tmp_path / "feet.las", "--units", "us-ft,ft")
    assert result.exit_code == 0 and "0.3048006096" in result.stdout and "0.3048 " in result.stdout
    assert "metres are assumed" not in result.stderr
    assert (labels(tmp_path / "feet.las") == labels(tmp_path / "out.las")).mean() >= 0.999


def test_a_stray_point_and_a_cell_that_is_too_fine(tmp_path):
    source = written(tmp_path / "in.las", np.append(terrain(), [[1e6, 1e6, 0]], axis=0))
    refused = run("ground", "smrf", source, tmp_path / "out.las")
    assert_refused(refused, tmp_path, "in.las", "1000 x 1000 km", "1 of 901", "stray points", "--bounds")
    source = written(tmp_path / "fine.las", terrain() * [100, 100, 1])
    refused = run("ground", "smrf", source, tmp_path / "out.laz", "--cell", "0.02")
    assert_refused(refused, tmp_path, "cell", "GiB")


def numeric(*commands):
    """Each option that takes numbers once, of the first of these commands that has it, and how many it takes."""
    seen = {}
    for name in commands:
        command = main.commands[name] if name != "ground" else ground_command(None)
        for option in command.params:
            words = (click.types.StringParamType, click.Path, click.Choice, click.types.BoolParamType)
            if isinstance(option, click.Option) and not option.is_flag and not isinstance(option.type, words):
                seen.setdefault(option.opts[0], (name, option.nargs))
    return seen


def test_no_number_gives_a_raw_error(tmp_path):
    """Every option that takes numbers, but those of methods: see ``test_numbers_that_overflow_are_refused``."""
    source = written(tmp_path / "in.las", terrain(300) * [1, 1, 0], classification=2)
    options = numeric("contours", "voids", "dsm", "hillshade", "height", "ground", "report")
    assert {"--cell", "--interval", "--distance", "--gap", "--tile", "--halo", "--workers", "--bounds"} < set(options)
    targets = {"contours": "o.gpkg", "height": "o.las", "ground": "o.las", "report": "o.html"}
    for option, (command, count) in options.items():
        target = tmp_path / targets.get(command, "o.tif")
        for value in ("1e300", "1e-300", "5e-324", "-1", "nan", "inf", "1e9", "1e-9", "1" + "0" * 40, "1" + "0" * 400):
            numbers = [value] * count if count < 4 else [f"-{value.lstrip('-')}"] * 2 + [value.lstrip("-")] * 2
            result = run(command, source, target, "--overwrite", option, *numbers)
            told = f"{command} {option} {value[:9]}: {result.stderr[-300:]}"
            assert result.exception is None or isinstance(result.exception, SystemExit), told
            assert result.exit_code in (0, 1, 2), told
            assert not re.search(r"^Error: [\w.]*(Error|Exception|Warning)\b", result.stderr, re.MULTILINE), told
