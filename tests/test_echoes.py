"""Return numbers that are not as the format wants them, and echoes that lie in two files."""

import warnings

import laspy
import numpy as np
import pytest
from click.testing import CliRunner
from commands import run
from las_files import las_of

import jaxfilter as jf
from jaxfilter.cli import main
from jaxfilter.core.echoes import Numbering, numbering, sample


def pulses(n=2000, seed=0):
    """Echoes of n pulses from above, pulse by pulse: xyz, return number, number of returns, GPS time."""
    rng = np.random.default_rng(seed)
    total = rng.integers(1, 4, n)
    number = np.concatenate([np.arange(1, k + 1) for k in total])
    total = np.repeat(total, total)
    time = np.repeat(np.sort(rng.uniform(0, 1e3, n)), total[number == 1])
    xy = np.repeat(rng.uniform(0, 100, (n, 2)), total[number == 1], axis=0)
    z = 10 + 0.1 * xy[:, 0] + 4.0 * (total - number) + rng.normal(0, 0.02, len(total))
    return np.column_stack([xy, z]), number, total, time


WAYS = {
    "sound": (lambda number, total: number, None, False),
    "zero": (lambda number, total: number - 1, "count from 0", False),
    "some zero": (lambda number, total: number - (total > 1), "count from 0", False),
    "unfilled": (lambda number, total: np.ones_like(number), "are not filled in", True),
    "blank": (lambda number, total: np.zeros_like(number), "are not filled in", True),
    "reversed": (lambda number, total: total - number + 1, "heights rise with return numbers", True),
}


@pytest.mark.parametrize("way", WAYS)
def test_return_numbers_that_are_not_as_the_format_wants_them(tmp_path, way):
    change, said, all_judged = WAYS[way]
    xyz, number, total, time = pulses()
    wrong, expected = change(number, total), np.ones(len(total), bool) if all_judged else number == total
    mixed = np.random.default_rng(1).permutation(len(total))
    box = (0.0, 0.0, 10.0, 10.0)  # of so few points that they alone say nothing
    for name, point_format, order in (("a.laz", 6, mixed), ("b.las", 1, mixed), ("c.las", 0, np.arange(len(total)))):
        fields = {} if point_format == 0 else {"gps_time": time[order]}
        fields |= {"return_number": wrong[order], "number_of_returns": total[order]}
        las = las_of(tmp_path / name, xyz[order], point_format, crs=32632, **fields)
        for points in (tmp_path / name, las):
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                cloud, part = jf.read(points), jf.read(tmp_path / name, bounds=box)
            assert cloud.candidate.tolist() == expected[order].tolist() and cloud.candidate.any()
            rows = ((las.x < 10) & (las.y < 10)).nonzero()[0]
            assert part.candidate.tolist() == cloud.candidate[rows].tolist()
            words = [str(one.message) for one in caught]
            assert all(said in text for text in words) and len(words) == (0 if said is None else 2), words
    kind = [("X", "f8"), ("Y", "f8"), ("Z", "f8"), ("ReturnNumber", "u1"), ("NumberOfReturns", "u1"), ("GpsTime", "f8")]
    table = np.array([*zip(*xyz.T, wrong, total, time, strict=True)], kind)[mixed]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert jf.PointCloud.from_structured(table).candidate.tolist() == expected[mixed].tolist()
        jf.ground(tmp_path / "a.laz", tmp_path / "out.laz", jf.SMRF(), run=jf.RunOptions(workers=1))
    out = laspy.read(tmp_path / "out.laz")
    assert np.array_equal(out.return_number, wrong[mixed]) and np.count_nonzero(out.classification == 2) > 0


def test_the_command_says_once_what_several_tiles_say(tmp_path):
    xyz, number, total, _ = pulses()
    path = tmp_path / "in.las"
    las_of(path, xyz, crs=32632, return_number=number - 1, number_of_returns=total)
    words = ("ground", "smrf", path, tmp_path / "out.las", "--tile", 50, "--wide-halos", "--workers", 1)
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code == 0 and result.stderr.count("count from 0") == 1, result.output


def test_sound_numbers_are_taken_as_they_are_in_any_order_and_parts_of_files_are_sampled():
    xyz, number, total, time = pulses(60_000)
    z = np.round(xyz[:, 2], 1)
    for order in (np.argsort(z, kind="stable"), np.argsort(-z, kind="stable"), np.lexsort((z, number)), np.arange(10)):
        for times in (time[order], None):
            columns = {"return_number": number[order], "number_of_returns": total[order]}
            assert numbering(columns, z[order], times) is Numbering.SOUND
    assert numbering({"return_number": number, "number_of_returns": 0 * total}, z) is Numbering.SOUND
    runs = sample(3_000_000)
    assert runs[0].start == 0 and runs[-1].stop == 3_000_000 and sum(run.stop - run.start for run in runs) < 2**18
    assert sample(1000) == [slice(0, 1000)]


@pytest.fixture
def buffered(tmp_path):
    """The folder of three tiles with a buffer of 20 m; which of 5000 echoes each has, and the file that keeps each."""
    rng = np.random.default_rng(3)
    xyz = np.round(np.column_stack([rng.uniform(0, 200, (5000, 2)), rng.normal(10, 0.05, 5000)]), 2)
    xyz[1] = xyz[0] = (100.5, 100.5, 10.0)  # twins that were measured at different times
    xyz[3], time = xyz[2], np.arange(5000.0)
    time[3] = time[2]  # twins in all: each file has both
    rows = [np.flatnonzero((xyz[:, 0] >= low) & (xyz[:, 0] < high)) for low, high in ((0, 80), (40, 140), (100, 200))]
    keeper, buffer = np.full(5000, -1), np.isin(np.arange(5000), rows[2]) & (xyz[:, 0] < 120)
    for number, own in enumerate(rows):  # withheld in one file, as some programs mark buffers
        withheld = (number == 1) & buffer[own]
        fields = {"gps_time": time[own], "classification": 2, "withheld": withheld, "point_source_id": 7}
        name, scales = f"{'abc'[number]}.{'laz' if number else 'las'}", (0.01, 0.001, 0.0001)[number]
        (tmp_path / "in").mkdir(exist_ok=True)
        las_of(tmp_path / "in" / name, xyz[own], (1, 6, 7)[number], scales=scales, crs=32632, **fields)
        keeper[own[(keeper[own] < 0) & ~withheld]] = number
    return tmp_path / "in", rows, keeper


@pytest.mark.parametrize("tile", [None, 30.0])
def test_the_same_echo_in_several_files_counts_once(tmp_path, buffered, tile):
    folder, rows, keeper = buffered
    run = {"workers": 1, "tile": tile, "wide_halos": True}
    jf.products(folder, tmp_path / "made", (2,), only=["count", "density"], cell=5.0, run=jf.RunOptions(**run))
    assert np.nansum(jf.Raster.read(tmp_path / "made" / "count.tif").values) == 5000
    for name, make in (("g", jf.ground), ("h", jf.heights)):
        for drop in (False, True):
            out, reading = tmp_path / f"{name}{drop}", jf.Reading(drop_duplicates=drop)
            ground = (jf.SMRF(),) if make is jf.ground else ()
            make(folder, out, *ground, reading=reading, run=jf.RunOptions(**run))
            for number, file in enumerate(sorted(out.glob("*.la[sz]"))):
                kept = rows[number][keeper[rows[number]] == number] if drop else rows[number]
                assert laspy.read(file).gps_time.tolist() == np.where(kept == 3, 2, kept).tolist()


@pytest.mark.parametrize("tiles", [(), ("--tile", 40, "--wide-halos")], ids=["in one piece", "in tiles"])
@pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
@pytest.mark.parametrize("name", ["ground", "products"])
def test_a_warning_of_several_files_comes_once_and_is_all_that_quiet_leaves(tmp_path, name, tiles):
    xyz = np.random.default_rng(0).uniform(0, (90, 40, 0), (4000, 3))
    xyz[:, 2] = 0.1 * xyz[:, 0]
    total = np.arange(2000, dtype=np.uint8) % 2 + 1
    numbers = {"return_number": np.ones(2000, np.uint8), "number_of_returns": total}
    (tmp_path / "in").mkdir()
    for side, rows in (("east", xyz[:, 0] > 45), ("west", xyz[:, 0] <= 45)):
        part = {key: np.resize(values, rows.sum()) for key, values in numbers.items()}
        cloud = jf.PointCloud.from_arrays(xyz[rows], crs="EPSG:25832", **part)
        jf.write(tmp_path / "in" / f"{side}.laz", cloud, None)
    done = run(name, tmp_path / "in", tmp_path / "out", "--workers", 1, "--quiet", *tiles)
    assert done.exit_code == 0 and done.stdout == ""
    assert done.stderr.count("warning: ") == done.stderr.count("\n") == 1
    assert "east.laz and 1 other file: no point is the last echo" in done.stderr
