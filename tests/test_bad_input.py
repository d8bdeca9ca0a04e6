"""Bad and odd input through the command line: a typed error in one line and nothing written, or a warning and a whole output.

How files are damaged in detail is in ``test_bad_input_files.py``; what each method does with odd clouds in ``test_filters.py``.
"""

from __future__ import annotations

import json
import re
import struct

import click
import laspy
import numpy as np
import pytest
from click.testing import CliRunner
from las_files import SCALES, make_las, patch

from jaxfilter.cli import main
from jaxfilter.cli.commands import ground_command

QUIET = {"return_number": 1, "number_of_returns": 1, "classification": 1, "withheld": 0}
"""Fields of a file in which every point is judged."""


def run(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


def ground(source, target, *options, method="pmf"):
    return run("ground", method, source, target, *options)


def terrain(n=900, seed=0):
    """f64[n, 3]: a gentle hill on 30 x 30 m, with some points a few metres above it."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, 30, (n, 2)).round(2)
    z = 0.05 * xy[:, 0] + 2 * np.sin(xy[:, 1] / 12) + np.where(rng.random(n) < 0.2, rng.uniform(3, 6, n), 0)
    return np.column_stack([xy, z.round(2)])


def las_of(path, xyz, *, point_format=6, scales=SCALES, offsets=(440000.0, 4750000.0, 100.0), crs=32632, **fields):
    header = laspy.LasHeader(version="1.2" if point_format < 4 else "1.4", point_format=point_format)
    header.scales, header.offsets = scales, offsets
    if crs is not None:
        import pyproj

        header.add_crs(pyproj.CRS.from_user_input(crs))
    las = laspy.LasData(header)
    las.xyz = np.asarray(xyz, float) + offsets
    for name, value in (QUIET | fields).items():
        las[name] = np.broadcast_to(value, len(xyz))
    las.write(path)
    return path


def text_of(path, xyz):
    np.savetxt(path, xyz, fmt="%.3f")
    return path


def assert_refused(result, folder, *words, code=1, options=()):
    assert result.exit_code == code, result.output
    lines = [line for line in result.stderr.splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1 and lines[0].startswith("Error: "), result.stderr
    for word in words:
        assert word in lines[0], lines[0]
    assert not list(folder.glob("out*")) and not list(folder.glob(".*")), "something was left"


def assert_warned(result, *words):
    assert result.exit_code == 0, result.output
    warnings = [line for line in result.stderr.splitlines() if line.startswith("warning: ")]
    assert any(all(word in line for word in words) for line in warnings), result.stderr


def classes(path):
    return np.asarray(laspy.read(path).classification)


def labels(path):
    return classes(path) == 2


# files that are damaged


def truncated(path, keep):
    path.write_bytes(path.read_bytes()[:keep])


DAMAGE = {
    "empty": (".las", lambda path: path.write_bytes(b""), ("empty",)),
    "no signature": (".las", lambda path: path.write_bytes(b"PK\3\4" + bytes(400)), ("not a LAS file",)),
    "truncated LAZ": (".laz", lambda path: truncated(path, -900), ("truncated",)),
    "truncated LAS": (".las", lambda path: truncated(path, -79_000), ("announces 200 points",)),
    "too many points": (".las", lambda path: patch(path, "Q", 247, 10**7), ("announces 10000000 points",)),
    "records": (".las", lambda path: patch(path, "I", 100, 2**31), ("variable length records",)),
    "scale 0": (".las", lambda path: patch(path, "d", 131, 0.0), ("X scale factor is 0",)),
    "scale NaN": (".las", lambda path: patch(path, "d", 139, np.nan), ("Y scale factor is nan",)),
    "scale absurd": (".las", lambda path: patch(path, "d", 147, 1e300), ("Z scale factor is 1e+300",)),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_files(tmp_path, damage):
    suffix, spoil, words = DAMAGE[damage]
    source = tmp_path / f"in{suffix}"
    make_las(source, 6)
    spoil(source)
    result = ground(source, tmp_path / "out.las")
    assert_refused(result, tmp_path, str(source), *words)


def test_coordinates_that_are_no_numbers(tmp_path):
    xyz = terrain()
    source = text_of(tmp_path / "in.txt", xyz)
    source.write_text(source.read_text() + "1 2 nan\n3 inf 4\n")
    assert_refused(ground(source, tmp_path / "out.las"), tmp_path, "line 901: z is nan", "--drop-invalid")
    result = ground(source, tmp_path / "out.txt", "--drop-invalid")
    assert_warned(result, "2 points with NaN or infinite")
    assert np.loadtxt(tmp_path / "out.txt")[-2:, 3].tolist() == [1, 1]


def test_coordinates_that_las_cannot_hold(tmp_path):
    xyz = np.append(terrain(), [[3e6, 5.0, 1.0]], axis=0)
    result = ground(text_of(tmp_path / "in.txt", xyz), tmp_path / "out.las")
    assert_refused(result, tmp_path, "in.txt", "stray points", "--bounds")


def test_coordinates_beyond_the_earth(tmp_path):
    xyz = np.append(terrain(), [[3.0, 5.0, 1e7]], axis=0)
    assert_refused(ground(text_of(tmp_path / "in.txt", xyz), tmp_path / "out.txt"), tmp_path, "Z spans 1e+07 m")


# clouds in which there is little to do


def empty_las(path):
    make_las(path, 6, n=0)
    return path


def empty_text(path):
    path.write_text("")
    return path


@pytest.mark.parametrize("make, name", [(empty_las, "in.las"), (empty_las, "in.laz"), (empty_text, "in.txt")])
def test_no_points(tmp_path, make, name):
    source = make(tmp_path / name)
    for target in ("out.laz", "out.txt"):
        assert_warned(ground(source, tmp_path / target), "no points")
    assert laspy.read(tmp_path / "out.laz").header.point_count == 0
    assert (tmp_path / "out.txt").read_text() == ""
    import rasterio

    assert_warned(run("dtm", source, tmp_path / "out.tif", "--bounds", 0, 0, 3, 2), "no points")
    with rasterio.open(tmp_path / "out.tif") as raster:
        assert raster.shape == (2, 3) and (raster.read(1) == raster.nodata).all()
    (tmp_path / "out.tif").unlink()
    refused = run("dtm", source, tmp_path / "out.tif")
    assert refused.exit_code == 1 and "--bounds" in refused.stderr and not (tmp_path / "out.tif").exists()


@pytest.mark.parametrize(
    "xyz", [[[1, 2, 3]], [[1, 2, 3], [4, 5, 6], [4, 5, 9]], [[i, 2 * i, i % 2] for i in range(50)]]
)
def test_few_points_and_points_on_a_line(tmp_path, xyz):
    source = las_of(tmp_path / "in.las", xyz)
    assert_warned(ground(source, tmp_path / "out.las"), "fewer than four distinct positions, or all on a line")
    xyz = np.asarray(xyz)
    lowest = np.array([z == xyz[(xyz[:, :2] == xy).all(axis=1), 2].min() for *xy, z in xyz.tolist()])
    np.testing.assert_array_equal(labels(tmp_path / "out.las"), lowest)


@pytest.mark.parametrize("method", ["fptd", "pmf"])
def test_points_above_each_other_are_all_classified(tmp_path, method):
    xyz = terrain(400)
    column = xyz[:200] + [0, 0, 8]
    source = las_of(tmp_path / "in.las", np.concatenate([xyz, column]))
    assert ground(source, tmp_path / "out.las", method=method).exit_code == 0
    ground(las_of(tmp_path / "alone.las", xyz), tmp_path / "out2.las", method=method)
    found = labels(tmp_path / "out.las")
    np.testing.assert_array_equal(found[:400], labels(tmp_path / "out2.las"))
    assert not found[400:].any()


def test_one_elevation(tmp_path):
    xyz = terrain() * [1, 1, 0]
    assert ground(las_of(tmp_path / "in.las", xyz), tmp_path / "out.las").exit_code == 0
    assert labels(tmp_path / "out.las").all()


@pytest.mark.parametrize("fields", [{"classification": 7}, {"withheld": 1}, {"number_of_returns": 2}])
def test_nothing_to_judge_leaves_the_points_as_they_are(tmp_path, fields):
    source = las_of(tmp_path / "in.las", terrain(), **fields)
    assert_warned(ground(source, tmp_path / "out.las"), "no point is a candidate")
    assert (tmp_path / "out.las").read_bytes() == source.read_bytes()


def test_echo_numbers_that_are_missing_or_impossible(tmp_path):
    xyz = terrain()
    source = las_of(tmp_path / "in.las", xyz, return_number=0, number_of_returns=0)
    result = ground(source, tmp_path / "out.las", "--json")
    assert_warned(result, "0 throughout")
    assert json.loads(result.stdout)["candidates"] == len(xyz)
    odd = np.ones(len(xyz), int)
    odd[:7] = 3
    source = las_of(tmp_path / "in.las", xyz, return_number=odd)
    result = ground(source, tmp_path / "odd.las", "--json")
    assert_warned(result, "7 points have impossible return numbers")
    assert json.loads(result.stdout)["candidates"] == len(xyz), "they count as last echoes"
    np.testing.assert_array_equal(labels(tmp_path / "out.las"), labels(tmp_path / "odd.las"))


@pytest.mark.parametrize("method", ["fptd", "smrf"])
def test_single_echoes_far_below_and_above(tmp_path, method):
    xyz = terrain(2500)
    assert ground(las_of(tmp_path / "in.las", xyz), tmp_path / "out.las", method=method).exit_code == 0
    plain = labels(tmp_path / "out.las")
    bird = np.append(xyz, [[15, 15, 10_000]], axis=0)
    assert ground(las_of(tmp_path / "in.las", bird), tmp_path / "bird.las", method=method).exit_code == 0
    np.testing.assert_array_equal(labels(tmp_path / "bird.las"), np.append(plain, False))
    deep = np.append(xyz, [[15, 15, -500]], axis=0)
    assert ground(las_of(tmp_path / "in.las", deep), tmp_path / "deep.las", method=method).exit_code == 0
    changed = np.flatnonzero(labels(tmp_path / "deep.las")[:-1] != plain)
    assert np.hypot(*(xyz[changed, :2] - 15).T).max(initial=0) < 12 and len(changed) < 0.2 * len(xyz)


# where the coordinates are


def test_no_crs_and_feet(tmp_path):
    xyz = terrain()
    metres = las_of(tmp_path / "m.las", xyz, crs=None)
    assert_warned(ground(metres, tmp_path / "out.las"), "metres are assumed", "--units")
    foot, survey = 0.3048, 1200 / 3937
    scales = np.array([0.001, 0.001, 0.001])
    feet = las_of(tmp_path / "ft.las", xyz / [survey, survey, foot], scales=scales, crs=None)
    result = ground(feet, tmp_path / "feet.las", "--units", "us-ft,ft")
    assert result.exit_code == 0 and "0.3048006096" in result.stdout and "0.3048 " in result.stdout
    assert "metres are assumed" not in result.stderr
    assert (labels(tmp_path / "feet.las") == labels(tmp_path / "out.las")).mean() >= 0.999


def test_degrees(tmp_path):
    xyz = terrain() * [1e-5, 1e-5, 1]
    scales = np.array([1e-7, 1e-7, 0.01])
    stated = las_of(tmp_path / "a.las", xyz, scales=scales, offsets=(8.0, 48.0, 0.0), crs=4326)
    assert_refused(ground(stated, tmp_path / "out.las"), tmp_path, "reproject", "--units")
    silent = las_of(tmp_path / "b.las", xyz, scales=scales, offsets=(8.0, 48.0, 0.0), crs=None)
    assert_refused(ground(silent, tmp_path / "out.las"), tmp_path, "degrees", "--units")
    text = tmp_path / "c.txt"
    np.savetxt(text, xyz + [8, 48, 0], fmt="%.7f")
    assert_refused(ground(text, tmp_path / "out.txt"), tmp_path, "degrees", "--units")
    assert ground(silent, tmp_path / "out.las", "--units", "m").exit_code == 0


@pytest.mark.parametrize("shift", [(-3e6, -7e6, -400.0), (1e7, 5e6, 3000.0)])
def test_any_place_on_earth(tmp_path, shift):
    xyz = terrain()
    ground(las_of(tmp_path / "in.las", xyz), tmp_path / "here.las")
    assert ground(las_of(tmp_path / "in.las", xyz, offsets=shift), tmp_path / "there.las").exit_code == 0
    np.testing.assert_array_equal(labels(tmp_path / "here.las"), labels(tmp_path / "there.las"))


@pytest.mark.parametrize("method", ["smrf", "fptd", "csf"])
def test_a_stray_point_and_a_cell_that_is_too_fine(tmp_path, method):
    stray = np.append(terrain(), [[1e6, 1e6, 0]], axis=0)
    result = ground(las_of(tmp_path / "in.las", stray), tmp_path / "out.las", method=method)
    if result.exit_code:
        assert_refused(result, tmp_path, "in.las", "1000 x 1000 km", "1 of 901", "stray points", "--bounds")
    else:
        assert labels(tmp_path / "out.las")[:-1].any()
    if method == "smrf":
        source = las_of(tmp_path / "fine.las", terrain() * [100, 100, 1])
        assert_refused(ground(source, tmp_path / "out.laz", "--cell", "0.02", method=method), tmp_path, "cell", "GiB")


# what goes out


def test_a_class_that_the_point_format_cannot_hold(tmp_path):
    source = las_of(tmp_path / "in.las", terrain(), point_format=1)
    result = ground(source, tmp_path / "out.las", "--ground-class", "64")
    assert_refused(result, tmp_path, "64", "point format 1", "upgrade")


def test_unknown_bytes_and_a_crs_that_no_one_understands_are_kept(tmp_path):
    las = make_las(tmp_path / "in.las", 7, extra=True, **{name: np.full(200, value) for name, value in QUIET.items()})
    source = tmp_path / "in.las"
    content = source.read_bytes()
    at = content.index(b'PROJCRS["') if b'PROJCRS["' in content else content.index(b"PROJCS[")
    source.write_bytes(content[:at] + b"WRONGS" + content[at + 6 :])
    assert_warned(ground(source, tmp_path / "out.las"), "cannot be understood and is kept")
    out, old = laspy.read(tmp_path / "out.las"), laspy.read(source)
    for name in las.point_format.dimension_names:
        if name != "classification":
            np.testing.assert_array_equal(np.asarray(out[name]), np.asarray(old[name]))
    start = struct.unpack_from("<I", content, 96)[0]
    assert (tmp_path / "out.las").read_bytes()[:start] == source.read_bytes()[:start]


def test_the_input_as_output(tmp_path):
    source = las_of(tmp_path / "in.las", terrain())
    before = source.read_bytes()
    assert_refused(ground(source, source), tmp_path, "--in-place", code=2)
    assert source.read_bytes() == before
    assert ground(source, source, "--in-place").exit_code == 0 and labels(source).any()
    assert [p.name for p in tmp_path.iterdir()] == ["in.las"]


@pytest.mark.parametrize("option", [("--cell", "-1"), ("--slope", "nan"), ("--max-window", "0")])
def test_parameters_are_checked_before_the_input_is_read(tmp_path, option):
    (tmp_path / "in.las").write_bytes(b"not read")
    assert_refused(
        ground(tmp_path / "in.las", tmp_path / "out.las", *option), tmp_path, option[0][2:].replace("-", "_"), code=2
    )


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
    source = las_of(tmp_path / "in.las", terrain(300) * [1, 1, 0], classification=2)
    options = numeric("contours", "voids", "dsm", "hillshade", "height", "ground", "report")
    assert {"--cell", "--interval", "--distance", "--gap", "--tile", "--halo", "--workers", "--bounds"} < set(options)
    for option, (command, count) in options.items():
        target = tmp_path / {"contours": "o.gpkg", "height": "o.las", "ground": "o.las", "report": "o.html"}.get(
            command, "o.tif"
        )
        for value in ("1e300", "1e-300", "5e-324", "-1", "nan", "inf", "1e9", "1e-9", "1" + "0" * 40, "1" + "0" * 400):
            numbers = [value] * count if count < 4 else [f"-{value.lstrip('-')}"] * 2 + [value.lstrip("-")] * 2
            result = run(command, source, target, "--overwrite", option, *numbers)
            told = f"{command} {option} {value[:9]}: {result.stderr[-300:]}"
            assert result.exception is None or isinstance(result.exception, SystemExit), told
            assert result.exit_code in (0, 1, 2), told
            assert not re.search(r"^Error: [\w.]*(Error|Exception|Warning)\b", result.stderr, re.MULTILINE), told
