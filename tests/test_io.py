"""Reading and lossless writing; laspy, numpy and the bytes themselves are the independent readers."""

from __future__ import annotations

import os
import struct
import tracemalloc
import warnings
from pathlib import Path

import laspy
import numpy as np
import pyproj
import pytest
from click.testing import CliRunner
from las_files import OFFSETS, SCALES, las_of, make_copc, make_las, patch, replace_crs

import jaxfilter as jf
from jaxfilter.cli import main
from jaxfilter.core import frame
from jaxfilter.core.cloud import PointCloud
from jaxfilter.core.errors import InputError, JaxfilterWarning, OutputError, ParameterError
from jaxfilter.core.filter import Labels, expand
from jaxfilter.core.points import canonical_points
from jaxfilter.core.reading import Reading
from jaxfilter.files import guard, points
from jaxfilter.files.reading import read, write
from jaxfilter.reports.info import info

pytestmark = pytest.mark.filterwarnings("ignore:.*impossible return numbers")

VERSIONS = ("1.0", "1.1", "1.2", "1.3", "1.4")
FIRST = (0, 0, 2, 2, 3, 3, 4, 4, 4, 4, 4)  # minor version in which each point format came
EVERY = [(point_format, version) for point_format, first in enumerate(FIRST) for version in VERSIONS[first:]]
EVERY += [(point_format, "1.5") for point_format in range(6, 11)]


def result_of(cloud, seed=0):
    """A FilterResult with arbitrary labels, by the way every filter makes them."""
    points = canonical_points(cloud)
    rng = np.random.default_rng(seed)
    value = rng.normal(size=len(points)).astype(np.float32)
    return expand(cloud, points, Labels(value < 0, height=value + 1, margin=value))


def one_channel(point_format, suffix):
    """lazrs 0.8 does not give back wave packets of several scanner channels; see test_waveforms_of_several_channels."""
    return {"scanner_channel": np.full(200, 2)} if point_format in (9, 10) and suffix == ".laz" else {}


def expected_classes(las, candidate, ground, reset=(0, 2), ground_class=2, other_class=1):
    old = np.asarray(las.classification)
    new = np.where(candidate & np.isin(old, reset), other_class, old)
    return np.where(candidate & ground, ground_class, new)


def expected_candidates(las):
    number, total = np.asarray(las.return_number), np.asarray(las.number_of_returns)
    return (number == total) & ~np.isin(las.classification, (7, 9, *range(17, 256))) & (np.asarray(las.withheld) == 0)


def assert_same_but_classes(one, other):
    assert one.point_format.id == other.point_format.id
    for name in one.point_format.dimension_names:
        if name != "classification":
            a, b = np.asarray(one[name]), np.asarray(other[name])
            assert a.tobytes() == b.tobytes(), name


# LAS and LAZ


@pytest.mark.parametrize("suffix, into", [(".las", ".las"), (".laz", ".laz"), (".las", ".laz")])
@pytest.mark.parametrize("point_format, version", EVERY)
def test_only_classes_of_candidates_change(tmp_path, point_format, version, suffix, into):
    source, target = tmp_path / f"in{suffix}", tmp_path / f"out{into}"
    las = make_las(source, point_format, max(version, "1.2"), extra=True, **one_channel(point_format, into))
    patch(source, "B", 25, int(version[-1]))  # laspy writes no version before 1.2, whose layout is the same
    cloud = read(source)
    local = PointCloud.from_arrays(np.stack([las.x, las.y, las.z], axis=1))
    assert cloud.xyz.tobytes() == local.xyz.tobytes() and cloud.origin.tolist() == local.origin.tolist()
    flags = ("withheld", "overlap") if point_format > 5 else ("withheld",)
    for name in ("return_number", "number_of_returns", "classification", *flags):
        np.testing.assert_array_equal(getattr(cloud, name), np.asarray(las[name]), err_msg=name)
    np.testing.assert_array_equal(cloud.candidate, expected_candidates(las))
    np.testing.assert_array_equal(cloud.reference, np.asarray(las.classification) == 2)
    result = result_of(cloud)
    assert write(target, cloud, result) == target
    out = laspy.read(target)
    assert_same_but_classes(out, las)
    np.testing.assert_array_equal(out.classification, expected_classes(las, cloud.candidate, result.ground))
    assert not np.array_equal(out.classification, las.classification)
    kept = [[v.record_data_bytes() for v in one.vlrs if v.record_id != 22204] for one in (out, laspy.read(source))]
    assert kept[0] == kept[1]
    if version in ("1.4", "1.5"):
        assert out.evlrs[0].record_data == las.evlrs[0].record_data


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las_13_with_the_header_of_las_12(tmp_path, suffix):
    """The output has the header that LAS 1.3 asks for."""
    las = make_las(tmp_path / "full.las", 1, "1.3", crs=None, extra=True)
    content = bytearray((tmp_path / "full.las").read_bytes())
    struct.pack_into("<HI", content, 94, 227, struct.unpack_from("<I", content, 96)[0] - 8)
    (tmp_path / "in.las").write_bytes(content[:227] + content[235:])
    cloud = read(tmp_path / "in.las", units="m")
    np.testing.assert_array_equal(cloud.classification, las.classification)
    write(tmp_path / f"out{suffix}", cloud, None)
    out = laspy.read(tmp_path / f"out{suffix}")
    assert (out.header.version.minor, out.points.array.tobytes()) == (3, las.points.array.tobytes())


@pytest.mark.parametrize("point_format", [4, 5, 9, 10])
def test_wave_packets_are_written_for_laszip(tmp_path, point_format):
    """In the versions of LASzip itself: WAVEPACKET13 (9) in 1, WAVEPACKET14 (13) in 3."""
    las = make_las(tmp_path / "in.las", point_format, extra=True, **one_channel(point_format, ".laz"))
    write(tmp_path / "out.laz", read(tmp_path / "in.las"), None)
    with laspy.open(tmp_path / "out.laz") as file:
        record = file.header.vlrs.get("LasZipVlr")[0].record_data
    versions = {kind: version for kind, _, version in struct.iter_unpack("<3H", record[34:])}
    assert versions[9 if point_format < 6 else 13] == (1 if point_format < 6 else 3)
    for backend in laspy.LazBackend.detect_available():  # LASzip is one of them where it is installed
        assert (
            laspy.read(tmp_path / "out.laz", laz_backend=backend).points.array.tobytes() == las.points.array.tobytes()
        )
    assert len(read(tmp_path / "out.laz")) == len(las.points)


def test_internal_waveforms_move_with_their_start(tmp_path):
    """LAS 1.3 keeps waveforms behind the points, at a byte that the header names."""
    source = tmp_path / "in.las"
    make_las(source, 4)
    end = source.stat().st_size
    with open(source, "ab") as file:
        file.write(b"W" * 1000)
    patch(source, "Q", 227, end)
    cloud = read(source)
    write(tmp_path / "out.laz", cloud, result_of(cloud))
    content = (tmp_path / "out.laz").read_bytes()
    start = struct.unpack_from("<Q", content, 227)[0]
    assert start != end and content[start:] == b"W" * 1000


@pytest.mark.parametrize("channels", [(0, 1), (0, 2), (1, 3)])
def test_waveforms_of_several_channels(tmp_path, channels):
    for name in ("in.las", "in.laz"):
        make_las(tmp_path / name, 9, scanner_channel=np.resize(channels, 200))
    for source, target in (("in.las", "out.laz"), ("in.laz", "out.las")):
        cloud = read(tmp_path / source)
        with pytest.raises(OutputError, match="several scanner channels"):
            write(tmp_path / target, cloud, result_of(cloud))
        assert not (tmp_path / target).exists()


@pytest.mark.parametrize("point_format, options, reset, ground_class, other_class", [
    *[(number, options, reset, 2, 1) for number in (1, 6) for options, reset in (
        ({"reset": "ground"}, (0, 2)), ({"reset": "all"}, range(32)), ({"reset": "none"}, ()), ({"only_ground": True}, ()))],
    *[(number, {"ground_class": one, "other_class": two}, (0, 2), one, two) for number, one, two in ((1, 30, 24), (6, 70, 64))],
])  # fmt: skip
def test_classes_of_choice(tmp_path, point_format, options, reset, ground_class, other_class):
    las = make_las(tmp_path / "in.las", point_format, n=600)
    cloud = read(tmp_path / "in.las")
    ground = np.random.default_rng(1).random(len(cloud)) < 0.5
    write(tmp_path / "out.las", cloud, ground, **options)
    expected = expected_classes(las, cloud.candidate, ground, reset, ground_class, other_class)
    np.testing.assert_array_equal(laspy.read(tmp_path / "out.las").classification, expected)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize("described", [True, False])
def test_extra_dimensions(tmp_path, suffix, described):
    las = make_las(tmp_path / "in.las", 6, extra=True)
    if not described:  # another owner of the record: the extra bytes stay, what they mean is unknown
        content = (tmp_path / "in.las").read_bytes()
        at = content.index(b"LASF_Spec")
        patch(tmp_path / "in.las", "9s", at, b"elsewhere")
    cloud = read(tmp_path / "in.las")
    result = result_of(cloud)
    first, second = tmp_path / f"first{suffix}", tmp_path / f"second{suffix}"
    write(first, cloud, result, extra=("height", "margin"))
    out = laspy.read(first)
    np.testing.assert_array_equal(out.height, result.height)
    np.testing.assert_array_equal(out.margin, result.margin)
    assert out.height.dtype == np.float32
    described_as = {one.name: one.description for one in out.point_format.extra_dimensions}
    assert described_as["height"].startswith("metres") and described_as["margin"]
    if described:
        assert_same_but_classes(las, out)
    else:
        held = las.points.array.view(np.uint8).reshape(len(las), -1)[:, 30:]
        kept = np.stack([out[f"undescribed {i + 1}"] for i in range(held.shape[1])], axis=1)
        np.testing.assert_array_equal(kept, held)
    again = read(first)
    other = result_of(again, seed=5)
    write(second, again, other, extra=("margin", "slope"))
    out = laspy.read(second)
    np.testing.assert_array_equal(out.margin, other.margin)  # replaced, not added twice
    np.testing.assert_array_equal(out.height, result.height)
    assert np.isnan(out.slope).all()
    assert list(out.point_format.dimension_names).count("margin") == 1


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_extra_bytes_that_two_records_describe(tmp_path, suffix):
    """Readers look at one record, so an output that has more extra bytes has one."""
    las = make_las(tmp_path / "one.las", 6, extra=True)
    content = (tmp_path / "one.las").read_bytes()
    at = content.index(b"LASF_Spec") - 2
    head, entries = content[at : at + 54], [content[at + 54 + 192 * k :][:192] for k in range(2)]
    blocks = b"".join(head[:20] + struct.pack("<H", 192) + head[22:] + entry for entry in entries)
    rest = content[at + 54 + 384 :]
    (tmp_path / "two.las").write_bytes(content[:at] + blocks + rest)
    for layout, where, value in (("I", 96, 54), ("I", 100, 1), ("Q", 235, 54)):
        old = struct.unpack_from("<" + layout, content, where)[0]
        patch(tmp_path / "two.las", layout, where, old + value)
    cloud = read(tmp_path / "two.las")
    result = result_of(cloud)
    write(tmp_path / f"out{suffix}", cloud, result, extra=("height",))
    out = laspy.read(tmp_path / f"out{suffix}")
    np.testing.assert_array_equal(out.height, result.height)
    assert_same_but_classes(las, out)
    assert jf.info(tmp_path / f"out{suffix}")["extra_bytes"] == ["amplitude", "echo width", "height"]


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las_14_in_the_compatibility_mode_of_laszip(tmp_path, suffix):
    """What LAS 1.2 has no room for lies in extra bytes: classes above 31, more than 7 echoes, the flag of overlap."""
    las = las_of(None, np.random.default_rng(0).uniform(0, 99, (60, 3)), 1)
    for name, kind in (
        ("scan angle", "i2"),
        ("extended returns", "u1"),
        ("classification", "u1"),
        ("flags and channel", "u1"),
    ):
        las.add_extra_dim(laspy.ExtraBytesParams(f"LAS 1.4 {name}", kind))
    classes = np.resize([0, 2, 5, 40, 64, 200], 60)
    las.classification, las["LAS 1.4 classification"] = (
        np.where(classes > 31, 0, classes),
        np.where(classes > 31, classes, 0),
    )
    las.return_number, las.number_of_returns = np.full(60, 7), np.full(60, 7)
    las["LAS 1.4 extended returns"] = np.full(60, 2 << 4 | 3)  # 9 of 10
    las["LAS 1.4 flags and channel"] = np.resize([0, 1], 60)
    las.vlrs.append(laspy.VLR("lascompatible", 22204, "", bytes(156)))
    las.write(tmp_path / f"in{suffix}")
    cloud = read(tmp_path / f"in{suffix}", units="m", returns="all", ignore_classes=())
    np.testing.assert_array_equal(cloud.classification, classes)
    assert (cloud.return_number == 9).all() and (cloud.number_of_returns == 10).all()
    np.testing.assert_array_equal(cloud.overlap, np.resize([False, True], 60))
    write(tmp_path / f"out{suffix}", cloud, np.arange(60) < 30, reset="none", ground_class=40)
    np.testing.assert_array_equal(
        read(tmp_path / f"out{suffix}", units="m").classification, np.where(np.arange(60) < 30, 40, classes)
    )
    out = laspy.read(tmp_path / f"out{suffix}")
    assert (out.classification[:30] == 0).all() and (out["LAS 1.4 classification"][:30] == 40).all()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*converted from 1 to 6")
        write(tmp_path / "out.copc.laz", cloud, None)
    out = laspy.read(tmp_path / "out.copc.laz")
    np.testing.assert_array_equal(np.sort(out.classification), np.sort(classes))
    assert (
        (out.return_number == 9).all() and (out.number_of_returns == 10).all() and np.count_nonzero(out.overlap) == 30
    )


def test_more_extra_bytes_than_a_record_can_describe(tmp_path):
    las = las_of(None, np.random.default_rng(0).uniform(0, 9, (50, 3)))
    las.add_extra_dim(laspy.ExtraBytesParams("many", "342u1"))
    las.write(tmp_path / "in.las")
    patch(tmp_path / "in.las", "9s", (tmp_path / "in.las").read_bytes().index(b"LASF_Spec"), b"elsewhere")
    cloud = read(tmp_path / "in.las", units="m")
    with pytest.raises(OutputError, match=r"in\.las: its points have too many extra bytes"):
        write(tmp_path / "out.las", cloud, result_of(cloud), extra=("height",))
    assert list(tmp_path.iterdir()) == [tmp_path / "in.las"]


def test_extra_dimension_of_another_type(tmp_path):
    las = las_of(None, np.random.default_rng(0).uniform(0, 9, (50, 3)))
    las.add_extra_dim(laspy.ExtraBytesParams("height", "u2"))
    las.write(tmp_path / "in.las")
    cloud = read(tmp_path / "in.las", units="m")
    with pytest.raises(OutputError, match=r"'height'.*not float32"):
        write(tmp_path / "out.las", cloud, result_of(cloud), extra=("height",))
    assert list(tmp_path.iterdir()) == [tmp_path / "in.las"]


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_many_chunks(tmp_path, monkeypatch, suffix):
    las = make_las(tmp_path / f"in{suffix}", 6, n=1000)
    whole = read(tmp_path / f"in{suffix}")
    monkeypatch.setattr(points, "POINTS_AT_ONCE", 33)
    monkeypatch.setattr(frame, "_ROWS", 47)
    cloud = read(tmp_path / f"in{suffix}")
    assert cloud.xyz.tobytes() == whole.xyz.tobytes() and (cloud.candidate == whole.candidate).all()
    result = result_of(cloud)
    write(tmp_path / f"out{suffix}", cloud, result, extra=("height",))
    out = laspy.read(tmp_path / f"out{suffix}")
    np.testing.assert_array_equal(out.classification, expected_classes(las, cloud.candidate, result.ground))
    np.testing.assert_array_equal(out.height, result.height)


@pytest.mark.slow
def test_memory_is_that_of_the_cloud(tmp_path, monkeypatch):
    n = 800_000  # chunks of 50,000 are the least that is read
    make_las(tmp_path / "in.laz", 6, n=n)
    monkeypatch.setattr(points, "POINTS_AT_ONCE", 10_000)
    monkeypatch.setattr(frame, "_ROWS", 10_000)
    tracemalloc.start()
    try:
        cloud = read(tmp_path / "in.laz")
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        write(tmp_path / "out.laz", cloud, np.zeros(n, bool))
        extra = tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
    assert peak < 32 * n, "float64 coordinates alone would be 24 bytes a point on top of 18"
    assert extra < 10 * n, "writing holds a chunk at a time, not the file"


# integers to local coordinates


@pytest.mark.parametrize("units", ["m", "us-ft,ft"])
@pytest.mark.parametrize("anchor", [(0, 0), (439000.25, 4751000.0)])
@pytest.mark.parametrize("scale", [0.01, 0.00025, 1e-7])
def test_from_integers_is_from_arrays(units, anchor, scale):
    rng = np.random.default_rng(3)
    ticks = rng.integers(-(2**31), 2**31, (5000, 3)).astype(np.int32) // (1000 if scale > 1e-4 else 1)
    scales = np.array([scale, scale, scale / 2])
    arrays = PointCloud.from_arrays(ticks * scales + OFFSETS, units=units, anchor=anchor)
    cloud = PointCloud.from_integers(ticks, scales, OFFSETS, Reading(units=units, anchor=anchor))
    assert cloud.xyz.tobytes() == arrays.xyz.tobytes()
    assert cloud.origin.tolist() == arrays.origin.tolist()
    assert np.shares_memory(cloud.xyz, ticks)
    with pytest.raises(InputError, match="return_number has 2 entries for 5000 points"):
        PointCloud.from_integers(ticks % 1000, scales, OFFSETS, return_number=np.ones(2, np.uint8))


# bounds


@pytest.mark.parametrize("version, point_format", [("1.2", 1), ("1.4", 6), ("1.4", 1)])
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_a_cut_is_written_with_its_own_counts(tmp_path, version, point_format, suffix):
    las = make_las(tmp_path / "in.laz", point_format, version, n=500)
    x, y = OFFSETS[:2] + 30
    cloud = read(tmp_path / "in.laz", bounds=(x, y, x + 40, y + 40))
    keep = (las.x >= x) & (las.x < x + 40) & (las.y >= y) & (las.y < y + 40)
    result = result_of(cloud)
    write(tmp_path / f"out{suffix}", cloud, result, extra=("height",))
    out = laspy.read(tmp_path / f"out{suffix}")
    for name in ("X", "Y", "Z", "intensity", "gps_time", "user_data"):
        np.testing.assert_array_equal(out[name], las[name][keep])
    np.testing.assert_array_equal(out.classification, expected_classes(las[keep], cloud.candidate, result.ground))
    np.testing.assert_array_equal(out.height, result.height)
    number = np.asarray(las.return_number)[keep]
    assert out.header.point_count == keep.sum()
    by_return = [int((number == i).sum()) for i in range(1, 6)]
    assert out.header.number_of_points_by_return[:5].tolist() == by_return
    if point_format < 6:
        assert struct.unpack_from("<6I", (tmp_path / f"out{suffix}").read_bytes(), 107) == (keep.sum(), *by_return)
    np.testing.assert_allclose(out.header.mins, [las.x[keep].min(), las.y[keep].min(), las.z[keep].min()], atol=1e-9)
    np.testing.assert_allclose(out.header.maxs, [las.x[keep].max(), las.y[keep].max(), las.z[keep].max()], atol=1e-9)
    if version in ("1.4", "1.5"):
        assert out.evlrs[0].record_data == las.evlrs[0].record_data


@pytest.mark.parametrize("bounds", [(0, 0, 1), (1, 0, 0, 1), (0, 0, float("nan"), 1), "abcd", 3])
def test_wrong_bounds(tmp_path, bounds):
    make_las(tmp_path / "in.las")
    with pytest.raises(InputError, match="bounds="):
        read(tmp_path / "in.las", bounds=bounds)


def test_bounds_without_points(tmp_path):
    make_copc(tmp_path / "in.copc.laz")
    make_las(tmp_path / "in.las")
    for path in tmp_path.iterdir():
        with pytest.warns(JaxfilterWarning, match="holds no points within bounds"):
            cloud = read(path, bounds=(0, 0, 1, 1))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            write(tmp_path / "out.las", cloud, np.zeros(0, bool), overwrite=True)
        assert laspy.read(tmp_path / "out.las").header.point_count == 0


# COPC


@pytest.mark.parametrize("bounds", [None, (OFFSETS[0] + 20, OFFSETS[1] + 20, OFFSETS[0] + 70, OFFSETS[1] + 90)])
def test_copc(tmp_path, bounds):
    """Points are written in the order in which they were read."""
    source = tmp_path / "in.copc.laz"
    ticks = make_copc(source)[:, :12].copy().view("<i4")
    cloud = read(source, bounds=bounds)
    if bounds is None:
        assert cloud.xyz.tobytes() == PointCloud.from_arrays(ticks * 0.01 + OFFSETS).xyz.tobytes()
    assert cloud.source.format.startswith("COPC 1.4")
    ground = cloud.xyz[:, 2] < np.median(cloud.xyz[:, 2])
    with pytest.warns(JaxfilterWarning, match="COPC, the output is plain LAZ"):
        write(tmp_path / "out.laz", cloud, ground)
    out = laspy.read(tmp_path / "out.laz")
    np.testing.assert_allclose(out.xyz, cloud.coordinates(), atol=1e-3)
    np.testing.assert_array_equal(out.classification, np.where(ground, 2, 1))
    assert not any(v.user_id == "copc" for v in [*out.vlrs, *out.evlrs])


# text


@pytest.mark.parametrize("decimals, scale", [(2, 0.001), (4, 0.0001)])
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_text_to_las(tmp_path, decimals, scale, suffix):
    xyz = np.random.default_rng(0).uniform(0, 300, (50, 3)) + np.array([512000, 5403000, 300])
    np.savetxt(tmp_path / "in.txt", xyz, fmt=f"%.{decimals}f")
    cloud = read(tmp_path / "in.txt")
    ground = np.arange(50) % 2 == 0
    write(tmp_path / f"out{suffix}", cloud, ground)
    out = laspy.read(tmp_path / f"out{suffix}")
    assert (out.header.version, out.point_format.id, out.header.point_count) == ("1.4", 6, 50)
    np.testing.assert_allclose(out.header.scales, scale)
    np.testing.assert_allclose(np.stack([out.x, out.y, out.z], axis=1), np.round(xyz, decimals), atol=1e-6)
    np.testing.assert_array_equal(out.classification, np.where(ground, 2, 1))
    np.testing.assert_allclose(out.header.maxs, np.round(xyz, decimals).max(axis=0), atol=1e-6)
    assert out.header.number_of_points_by_return[0] == 50 and out.header.global_encoding.wkt


def test_arrays_to_las_and_text(tmp_path):
    rng = np.random.default_rng(0)
    xyz = rng.uniform(0, 300, (60, 3)) + np.array([512000, 5403000, 300])
    number = rng.integers(1, 3, 60).astype(np.uint8)
    cloud = PointCloud.from_arrays(
        xyz, return_number=number, number_of_returns=np.full(60, 2, np.uint8), crs=pyproj.CRS.from_epsg(25832),
        classification=np.full(60, 5, np.uint8), withheld=rng.random(60) < 0.2,
        overlap=rng.random(60) < 0.4)  # fmt: skip
    result = result_of(cloud)
    write(tmp_path / "out.laz", cloud, result, extra=("height",))
    out = laspy.read(tmp_path / "out.laz")
    np.testing.assert_allclose(np.stack([out.x, out.y, out.z], axis=1), xyz, atol=1.0e-3)
    np.testing.assert_array_equal(out.return_number, number)
    np.testing.assert_array_equal(out.withheld, cloud.withheld)
    np.testing.assert_array_equal(out.overlap, cloud.overlap)
    np.testing.assert_array_equal(out.classification, np.where(result.ground, 2, 5))
    np.testing.assert_array_equal(out.height, result.height)
    assert out.header.parse_crs().to_epsg() == 25832
    again = read(tmp_path / "out.laz")
    np.testing.assert_array_equal(again.candidate, cloud.candidate)
    write(tmp_path / "out.csv", cloud, result)
    table = read(tmp_path / "out.csv")
    np.testing.assert_array_equal(table.reference, result.ground)
    np.testing.assert_allclose(table.coordinates(), xyz, atol=2e-3)


@pytest.mark.parametrize("point_format, offset, decimals", [(1, OFFSETS[1], 3), (6, -4750000.5929769, 6)])
def test_las_to_text_shows_the_scale_and_odd_offsets(tmp_path, point_format, offset, decimals):
    las = make_las(tmp_path / "in.las", point_format)
    patch(tmp_path / "in.las", "d", 163, offset)
    cloud = read(tmp_path / "in.las")
    result = result_of(cloud)
    write(tmp_path / "out.xyz", cloud, result)
    table = np.loadtxt(tmp_path / "out.xyz")
    xyz = np.stack([las.x, np.asarray(las.Y) * SCALES[1] + offset, las.z], axis=1)
    np.testing.assert_allclose(table[:, :3], xyz, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(table[:, 3] == 0, result.ground)
    assert (tmp_path / "out.xyz").read_text().split("\t")[2] == f"{las.z[0]:.{decimals}f}"


# coordinate reference systems and units


FOOT, SURVEY_FOOT = 0.3048, 1200 / 3937


@pytest.mark.parametrize("crs, xy, z", [
    (32632, 1, 1), (2992, FOOT, FOOT), (2225, SURVEY_FOOT, SURVEY_FOOT), ("EPSG:2225+8228", SURVEY_FOOT, FOOT),
    ("EPSG:32632+8228", 1, FOOT), ("EPSG:2225+5703", SURVEY_FOOT, 1),
])  # fmt: skip
def test_units_of_wkt(tmp_path, crs, xy, z):
    las = make_las(tmp_path / "in.las", 6, crs=crs)
    cloud = read(tmp_path / "in.las")
    np.testing.assert_allclose([cloud.units.xy, cloud.units.z], [xy, z], rtol=1e-12)
    local = (np.stack([las.x, las.y, las.z], axis=1) - cloud.origin) * [xy, xy, z]
    np.testing.assert_allclose(cloud.xyz, local, atol=6e-4)
    metres = cloud.origin * [xy, xy, z]
    np.testing.assert_allclose(metres, np.rint(metres), atol=1e-6)
    assert (local.min(axis=0) >= 0).all() and (local.min(axis=0) < 1).all()
    assert cloud.crs == pyproj.CRS.from_user_input(crs)


def geokeys(keys):
    return b"".join(
        struct.pack("<4H", *key) for key in [(1, 1, 0, len(keys)), *((k, 0, 1, v) for k, v in sorted(keys.items()))]
    )


@pytest.mark.parametrize("keys, xy, z", [
    ({3072: 2225}, SURVEY_FOOT, SURVEY_FOOT), ({3072: 32632, 3076: 9002}, FOOT, FOOT),
    ({3072: 32632, 4099: 9002}, 1, FOOT),
    ({3072: 32632, 4096: 8228}, 1, FOOT),
    ({3072: 32632, 3076: 9001}, 1, 1),
    ({3076: 9002, 4099: 9001}, FOOT, 1),
    ({3072: 2225, 4096: 5103}, SURVEY_FOOT, SURVEY_FOOT),  # a vertical datum, an ellipsoid
    ({3072: 2225, 4096: 5030}, SURVEY_FOOT, SURVEY_FOOT),
])  # fmt: skip
def test_units_of_geotiff_keys(tmp_path, keys, xy, z):
    make_las(tmp_path / "in.las", 1)
    replace_crs(tmp_path / "in.las", geokeys(keys))
    with warnings.catch_warnings(record=True) as caught:
        warnings.filterwarnings("ignore", ".*impossible return numbers")
        cloud = read(tmp_path / "in.las")
    np.testing.assert_allclose([cloud.units.xy, cloud.units.z], [xy, z], rtol=1e-12)
    said = [str(one.message) for one in caught]
    assert len(said) == (keys == {3072: 32632, 3076: 9002})
    assert all("in metre, but its key of linear units says foot" in one for one in said)


def test_feet_asked_for(tmp_path):
    las = make_las(tmp_path / "in.las", 6, crs=None)
    cloud = read(tmp_path / "in.las", units="us-ft,m")
    np.testing.assert_allclose(np.ptp(cloud.xyz[:, 0]), np.ptp(las.x) * SURVEY_FOOT, atol=1e-3)
    np.testing.assert_allclose(np.ptp(cloud.xyz[:, 2]), np.ptp(las.z), atol=1e-3)
    with pytest.raises(InputError, match="units 'yards'"):
        read(tmp_path / "in.las", units="yards")


# a CRS that the user states for files without one: it decides on units, is written to all outputs, and contradicts nothing


@pytest.mark.parametrize(
    "version, point_format", [("1.2", 0), ("1.2", 3), ("1.3", 5), ("1.4", 1), ("1.4", 6), ("1.4", 8)]
)
@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize("crs", ["EPSG:25832", "EPSG:2225", "EPSG:25832+5783"])
def test_every_version_states_it_and_keeps_all_else(tmp_path, version, point_format, suffix, crs):
    before = make_las(tmp_path / "in.las", point_format, version, crs=None, extra=True)
    cloud = jf.read(tmp_path / "in.las", crs=crs)
    stated = pyproj.CRS.from_user_input(crs)
    assert cloud.crs == stated and cloud.units.xy == stated.axis_info[0].unit_conversion_factor
    ground = np.arange(len(cloud)) % 3 == 0
    after = laspy.read(jf.write(tmp_path / f"out{suffix}", cloud, ground))
    if version == "1.4":
        assert after.header.global_encoding.wkt and bytes(after.evlrs[0].record_data_bytes()) == bytes(range(256)) * 300
        assert after.header.parse_crs().name == stated.name
    else:
        (keys,) = after.header.vlrs.get("GeoKeyDirectoryVlr")
        codes = {key.id: key.value_offset for key in keys.geo_keys}
        parts = stated.sub_crs_list or [stated]
        assert codes == dict(zip((1024, 3072, 4096), (1, *(part.to_epsg() for part in parts)), strict=False))
    assert [vlr.record_data_bytes() for vlr in after.header.vlrs.get_by_id("someone")] == [b"\x00\x01\xfe\xff"]
    for name in before.point_format.dimension_names:
        if name != "classification":
            np.testing.assert_array_equal(after[name], before[name], err_msg=name)
    assert jf.read(tmp_path / f"out{suffix}").crs.is_projected, "it is read back without a word on units"


def test_what_no_old_version_can_hold_is_left_out_and_said(tmp_path):
    make_las(tmp_path / "in.las", 1, crs=None)
    own = pyproj.CRS.from_proj4("+proj=tmerc +lat_0=3 +lon_0=7 +k=0.9 +x_0=1000 +y_0=2000 +ellps=GRS80 +units=m")
    cloud = jf.read(tmp_path / "in.las", crs=own)
    with pytest.warns(jf.JaxfilterWarning, match="no EPSG code, which LAS 1.2 needs.*convert the input to LAS 1.4"):
        jf.write(tmp_path / "out.las", cloud, np.zeros(len(cloud), bool))
    assert laspy.read(tmp_path / "out.las").header.parse_crs() is None


def test_text_and_laspy_take_it(tmp_path):
    las = make_las(tmp_path / "in.las", 6, crs=None)
    assert jf.read(las, crs=2225).units.xy == pytest.approx(SURVEY_FOOT, rel=1e-12)
    np.savetxt(tmp_path / "in.xyz", np.column_stack([las.x, las.y, las.z]))
    cloud = jf.read(tmp_path / "in.xyz", crs=2225)
    assert cloud.crs.to_epsg() == 2225 and cloud.units.xy == pytest.approx(SURVEY_FOOT, rel=1e-12)
    assert jf.read(tmp_path / "in.xyz", crs=2225, units="m").units.xy == 1.0, "units go before it"
    written = jf.write(tmp_path / "out.laz", cloud, np.zeros(len(cloud), bool))
    assert laspy.read(written).header.parse_crs().to_epsg() == 2225


def test_it_contradicts_no_file(tmp_path):
    make_las(tmp_path / "a.las", 6, crs=25832)
    make_las(tmp_path / "b.las", 6, crs=None, seed=1)
    assert jf.read(tmp_path / "a.las", crs="EPSG:25832+5783").crs.to_epsg() == 5555, "which states heights as well"
    words = r"a\.las: crs='EPSG:25833': the file states another CRS, ETRS89 / UTM zone 32N"
    with pytest.raises(jf.InputError, match=words):
        jf.read(tmp_path / "a.las", crs=25833)
    survey = jf.open(tmp_path, crs=25833)
    assert survey.uris == [str(tmp_path / "b.las")] and "states another CRS" in survey.unreadable[0][1]
    assert jf.open(tmp_path, crs=25832).crs.to_epsg() == 25832 and len(jf.open(tmp_path, crs=25832)) == 2
    jf.open(tmp_path, crs=25832).to_vpc(tmp_path / "all.vpc")
    assert jf.open(tmp_path / "all.vpc", crs=25832).crs.to_epsg() == 25832
    with pytest.raises(jf.InputError, match="states another CRS"):
        jf.open(tmp_path / "all.vpc", crs=25833)


@pytest.mark.parametrize(
    "crs, words", [("EPSG:4326", "not in a projected system"), ("EPSG:1", "no coordinate reference")]
)
def test_one_in_which_nothing_can_be_measured_is_refused(tmp_path, crs, words):
    make_las(tmp_path / "in.las", 6, crs=None)
    with pytest.raises(jf.InputError, match=words):
        jf.read(tmp_path / "in.las", crs=crs)
    words = ["ground", "smrf", str(tmp_path / "in.las"), str(tmp_path / "o.las"), "--crs", crs]
    result = CliRunner().invoke(main, words)
    assert result.exit_code and "--crs" in result.stderr and len(result.stderr.strip().splitlines()) == 1


def test_all_outputs_of_a_survey_state_it(tmp_path, monkeypatch):
    scene = jf.scenes.make("town", size=(60.0, 40.0), density=1.0, seed=3)
    xyz = scene.cloud.coordinates()
    (tmp_path / "in").mkdir()
    for name, rows in (("west", xyz[:, 0] < np.median(xyz[:, 0])), ("east", xyz[:, 0] >= np.median(xyz[:, 0]))):
        las_of(tmp_path / f"in/{name}.laz", xyz[rows], classification=np.where(scene.truth[rows], 2, 1))
    monkeypatch.chdir(tmp_path)
    for words in (
        ("ground", "pmf", "in", "out", "--max-window", "9", "--review", "places.gpkg"),
        ("height", "in", "heights"), ("dtm", "in", "dtm.tif"),
    ):  # fmt: skip
        result = CliRunner().invoke(main, [*words, "--crs", "EPSG:25832", "--workers", "1"])
        assert result.exit_code == 0 and "no CRS" not in result.output, result.output
    for file in (*(tmp_path / "out").glob("*.laz"), *(tmp_path / "heights").glob("*.laz")):
        assert laspy.read(file).header.parse_crs().to_epsg() == 25832
    assert jf.Raster.read(tmp_path / "dtm.tif").crs.to_epsg() == 25832
    result = CliRunner().invoke(main, ["info", "in", "--crs", "EPSG:25832", "--json"])
    assert '"crs": "ETRS89 / UTM zone 32N"' in result.stdout


# files


def test_nothing_is_replaced_by_accident(tmp_path):
    las = make_las(tmp_path / "in.las")
    cloud = read(tmp_path / "in.las")
    result = result_of(cloud)
    before = (tmp_path / "in.las").read_bytes()
    for path in (tmp_path / "in.las", Path(os.path.relpath(tmp_path / "in.las"))):
        with pytest.raises(OutputError, match="one file; pass in_place=True"):
            write(path, cloud, result, overwrite=True)
    (tmp_path / "other.las").write_bytes(b"precious")
    with pytest.raises(OutputError, match="exists; pass overwrite=True"):
        write(tmp_path / "other.las", cloud, result)
    with pytest.raises(OutputError, match="exists; pass overwrite=True"):
        write(tmp_path / "other.las", cloud, result, in_place=True)
    assert (tmp_path / "in.las").read_bytes() == before and (tmp_path / "other.las").read_bytes() == b"precious"
    write(tmp_path / "other.las", cloud, result, overwrite=True)
    (tmp_path / "in.las").chmod(0o640)
    write(tmp_path / "in.las", cloud, result, in_place=True)
    assert (tmp_path / "in.las").read_bytes() == (tmp_path / "other.las").read_bytes() != before
    assert (tmp_path / "in.las").stat().st_mode & 0o777 == 0o640
    assert len(las) == len(cloud)
    with pytest.raises(InputError, match="changed since"):
        write(tmp_path / "third.las", cloud, result)
    (tmp_path / "in.las").unlink()
    with pytest.raises(InputError, match="cannot be read again"):
        write(tmp_path / "third.las", cloud, result)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["other.las"]


def test_arguments_of_write(tmp_path):
    make_las(tmp_path / "in.las")
    cloud = read(tmp_path / "in.las")
    ground = np.zeros(len(cloud), bool)
    for options, error, message in [
        ({"reset": "some"}, ParameterError, "reset='some'"),
        ({"ground_class": 256}, ParameterError, "ground_class=256"),
        ({"extra": ("colour",)}, ParameterError, "extra=.*colour"),
        ({"extra": ("height",)}, ParameterError, "pass the FilterResult"),
        ({"noise_class": 7}, ParameterError, "noise_class=7: labels alone"),
        ({"noise_class": 256}, ParameterError, "noise_class=256"),
    ]:
        with pytest.raises(error, match=message):
            write(tmp_path / "out.las", cloud, ground, **options)
    with pytest.raises(InputError, match=r"bool\[200\]"):
        write(tmp_path / "out.las", cloud, ground[1:])
    with pytest.raises(InputError, match=r"not int64"):
        write(tmp_path / "out.las", cloud, ground.astype(np.int64))
    with pytest.raises(OutputError, match="suffix"):
        write(tmp_path / "out.ply", cloud, ground)
    with pytest.raises(OutputError, match="cannot be written: No such file"):
        write(tmp_path / "missing" / "out.las", cloud, ground)
    with pytest.raises(OutputError, match=r"needs .las or .laz"):
        write(tmp_path / "out.txt", cloud, result_of(cloud), extra=("height",))
    assert [p.name for p in tmp_path.iterdir()] == ["in.las"]


# summary


def test_info(tmp_path):
    las = make_las(tmp_path / "in.laz", 6, n=2000, crs=2225)
    found = info(tmp_path / "in.laz")
    assert found["format"] == "LAZ 1.4, point format 6" and found["points"] == 2000
    assert found["crs"] == "NAD83 / California zone 1 (ftUS)"
    np.testing.assert_allclose(found["metres_per_unit"], [SURVEY_FOOT] * 2, rtol=1e-12)
    np.testing.assert_allclose(found["bounds"], [las.x.min(), las.y.min(), las.x.max(), las.y.max()], atol=2e-3)
    np.testing.assert_allclose(found["z"], [las.z.min(), las.z.max()], atol=2e-3)
    assert found["scales"] == SCALES.tolist() and found["offsets"] == OFFSETS.tolist()
    assert found["classes"] == {int(c): int((las.classification == c).sum()) for c in np.unique(las.classification)}
    number, total = np.asarray(las.return_number), np.asarray(las.number_of_returns)
    assert found["echoes"] == {
        "only": int((total == 1).sum()), "first": int(((number == 1) & (total > 1)).sum()),
        "intermediate": int(((number > 1) & (number < total)).sum()),
        "last": int(((number == total) & (total > 1)).sum()),
        "odd": 0}  # fmt: skip
    assert found["candidates"] == expected_candidates(las).sum() and found["withheld"] == np.asarray(las.withheld).sum()
    area = np.ptp(las.x) * np.ptp(las.y) * SURVEY_FOOT**2  # points all over it
    assert found["density"] == pytest.approx(found["candidates"] / area, rel=0.1)
    assert found["spacing"] == pytest.approx(found["density"] ** -0.5)


def test_an_interrupt_is_no_damage_of_the_file():
    with pytest.raises(KeyboardInterrupt), guard.reading_errors(Path("in.laz")):
        raise KeyboardInterrupt


def test_the_day_of_a_file(tmp_path):
    make_las(tmp_path / "in.las", 1)
    content = bytearray((tmp_path / "in.las").read_bytes())
    for day, year, said in ((60, 2024, "2024-02-29"), (366, 2024, "2024-12-31"), (0, 2024, None), (1, 0, None)):
        struct.pack_into("<2H", content, 90, day, year)
        (tmp_path / "in.las").write_bytes(content)
        assert jf.open(tmp_path / "in.las")[0].date == said


@pytest.mark.parametrize(
    "returns, rows",
    [("first", [1, 4]), ("last", [2, 3, 6, 7]), ("only", [0]), ("intermediate", [5]), ("only,first", [0, 1, 4])],
)
@pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
def test_candidates_by_their_return(returns, rows):
    number, total = [1, 1, 2, 3, 1, 2, 3, 0], [1, 2, 2, 2, 3, 3, 3, 1]  # the fourth and the last are impossible
    echoes = {"return_number": np.array(number), "number_of_returns": np.array(total)}
    xyz = np.arange(24.0).reshape(8, 3)
    assert PointCloud.from_arrays(xyz, returns=returns, **echoes).candidate.nonzero()[0].tolist() == rows


def test_info_of_degrees_and_of_text(tmp_path):
    make_las(tmp_path / "in.las", 6, crs=4326)
    found = info(tmp_path / "in.las")
    assert found["crs"] == "WGS 84" and found["units"] == "degree"
    assert found["spacing"] is None and found["metres_per_unit"] is None
    (tmp_path / "in.txt").write_text("1.25 2 3 0\n4 5 6.5 1\n9 9 9 1\n")
    found = info(tmp_path / "in.txt")
    assert found["points"] == 3 and found["bounds"] == [1.25, 2, 9, 9] and found["echoes"] is None
