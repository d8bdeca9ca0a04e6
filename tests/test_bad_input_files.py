"""Files that are damaged, odd or not what they seem: a typed error or warning that names the file, never a crash."""

from __future__ import annotations

import io
import logging
import struct
import warnings
from types import SimpleNamespace

import laspy
import lazrs
import numpy as np
import psutil
import pytest
from las_files import OFFSETS, Effort, las_of, make_copc, make_las, patch
from laspy import LazBackend

from jaxfilter.core.cloud import PointCloud, as_cloud
from jaxfilter.core.errors import InputError, JaxfilterWarning, OutputError
from jaxfilter.files.reading import read, write
from jaxfilter.reports.info import info


@pytest.fixture(autouse=True)
def quiet_decoders():
    """laspy logs what it also raises."""
    logging.disable(logging.ERROR)
    yield
    logging.disable(logging.NOTSET)


def offset_to_points(path):
    return struct.unpack_from("<I", path.read_bytes(), 96)[0]


def assert_refused(path, message):
    """An InputError that names the file, after few steps and without much memory."""
    with Effort() as effort, pytest.raises(InputError, match=message) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert effort.calls < 100_000 and effort.peak < 20e6
    with pytest.raises(InputError):
        info(path)


# not a point cloud at all


@pytest.mark.parametrize("name, content, message", [
    ("in.las", b"", "the file is empty"), ("in.laz", b"", "the file is empty"),
    ("in.las", b"PK\x03\x04" + bytes(500), "not a LAS file"), ("in.las", b"LAS", "not a LAS file"),
    ("in.las", b"1 2 3\n4 5 6\n", "not a LAS file"), ("in.las", b"LASF" + bytes(100), "too few for a LAS header"),
])  # fmt: skip
def test_what_is_no_point_cloud(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    assert_refused(tmp_path / name, message)


def test_missing_file_folder_and_unknown_suffix(tmp_path):
    make_las(tmp_path / "in.las")
    (tmp_path / "in.las").rename(tmp_path / "in.bin")
    assert len(read(tmp_path / "in.bin")) == 200, "LAS is known by its signature"
    with pytest.raises(InputError, match=r"absent\.laz: is the name of a file.*jaxfilter\.read"):
        as_cloud(tmp_path / "absent.laz")
    with pytest.raises(InputError, match="no such file"):
        read(tmp_path / "none.las")
    with pytest.raises(InputError, match=r"is a folder.*jaxfilter\.open"):
        read(tmp_path)
    (tmp_path / "in.ply").write_text("ply\n")
    with pytest.raises(InputError, match="neither LAS nor one of"):
        read(tmp_path / "in.ply")


# truncated


@pytest.mark.parametrize("version, point_format", [("1.2", 1), ("1.4", 6)])
def test_truncated_las(tmp_path, version, point_format):
    path = tmp_path / "in.las"
    make_las(path, point_format, version)
    whole, start = path.read_bytes(), offset_to_points(path)
    length = laspy.open(path).header.point_format.size
    path.write_bytes(whole[: start + 10 * length + 3])
    assert_refused(path, "announces 200 points, but the file holds 10")
    path.write_bytes(whole[: start - 1])
    assert_refused(path, "offset to point data")
    path.write_bytes(whole[:240])
    assert_refused(path, "header|offset to point data")


@pytest.mark.parametrize("point_format", [1, 6])
@pytest.mark.parametrize("keep", [0.0, 0.3, 0.9, 0.999])
def test_truncated_laz(tmp_path, point_format, keep):
    path = tmp_path / "in.laz"
    make_las(path, point_format, "1.2" if point_format == 1 else None, n=3000)
    if point_format == 6:
        patch(path, "QI", 235, 0, 0)  # no extended records, whose absence would be noticed first
        size = len(path.read_bytes()) - 60 - 256 * 300
    else:
        size = len(path.read_bytes())
    start = offset_to_points(path)
    path.write_bytes(path.read_bytes()[: start + int((size - start) * keep)])
    assert_refused(path, "truncated|damaged")


def test_damaged_chunk_table(tmp_path):
    path = tmp_path / "in.laz"
    make_las(path, 1, n=3000)
    start = offset_to_points(path)
    table = struct.unpack_from("<q", path.read_bytes(), start)[0]
    whole = path.read_bytes()
    for at, layout, value in ((start, "q", table + 5), (start, "q", -7), (start, "q", 2**40), (start, "q", -1),
                              (table + 4, "I", 0), (table + 4, "I", 2**31), (table + 8, "I", 0xFFFFFFFF)):  # fmt: skip
        path.write_bytes(whole)
        patch(path, layout, at, value)
        assert_refused(path, "truncated|damaged|decoded")


def table_of(file):
    """The place of the points of an open LAZ file, that of its table, its LASzip record, and its chunks' counts and sizes."""
    content = file.read()
    start = struct.unpack_from("<I", content, 96)[0]
    at = content.find(b"laszip encoded") + 52
    record = lazrs.LazVlr(content[at : at + 34 + 6 * struct.unpack_from("<H", content, at + 32)[0]])
    file.seek(start)
    return start, struct.unpack_from("<q", content, start)[0], record, lazrs.read_chunk_table(file, record)


def with_table(content, sizes):
    """The LAZ file with other sizes of chunks in its table, which an independent encoder writes."""
    with io.BytesIO(content) as file:
        _, table, record, chunks = table_of(file)
        old = file.tell()
        file.seek(table)
        lazrs.write_chunk_table(file, [(count, size) for (count, _), size in zip(chunks, sizes, strict=True)], record)
        return file.getvalue()[: file.tell()] + content[old:]


@pytest.mark.parametrize("point_format", [1, 6])
def test_chunks_of_other_lengths_than_in_the_table(tmp_path, point_format):
    """Their sum is right, so that all but the ends between them are where they should be."""
    path = tmp_path / "in.laz"
    make_las(path, point_format, "1.2" if point_format == 1 else None, n=50_100)
    content = path.read_bytes()
    start, table, _, ((_, first), (_, second)) = table_of(io.BytesIO(content))
    assert first + second == table - start - 8
    for moved in (7, -7, second - first):
        path.write_bytes(with_table(content, [first + moved, second - moved]))
        assert_refused(path, "chunk [12] of 2 is not as long as its table says|extended record 1 of 1 .* ends behind")
    path.write_bytes(with_table(content, [first, second + 2]))
    assert_refused(path, "do not end where their table begins|extended record 1 of 1 .* ends behind")


def test_layers_that_do_not_fill_their_chunk(tmp_path):
    path = tmp_path / "in.laz"
    make_las(path, 6, n=300)
    at, content = offset_to_points(path) + 8 + 30, path.read_bytes()
    count, *sizes = struct.unpack_from("<10I", content, at)
    assert count == 300
    for layer, size in enumerate(sizes):
        for wrong in {size + 1, size // 2, max(size - 1, 0), 0} - {size}:
            path.write_bytes(content)
            patch(path, "I", at + 4 + 4 * layer, wrong)
            assert_refused(path, "chunk 1 of 1 is not as long as its table says")
    path.write_bytes(content)
    patch(path, "I", at, 299)
    assert_refused(path, "announces 300 points, but the compressed chunks hold 299")


@pytest.mark.parametrize("backend", LazBackend)
@pytest.mark.parametrize("point_format", [0, 6, 8])
def test_sound_laz_of_any_writer_is_read(tmp_path, point_format, backend):
    if not backend.is_available():
        pytest.skip(f"{backend.name} is not installed")
    for n in (0, 1, 2, 50_001):
        las = make_las(tmp_path / "in.las", point_format, n=n, extra=n == 2)
        las.write(tmp_path / "in.laz", laz_backend=backend)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            cloud = read(tmp_path / "in.laz", drop_invalid=True) if n else None
        if cloud is not None:
            np.testing.assert_allclose(cloud.coordinates(), las.xyz, atol=0.002)
            np.testing.assert_array_equal(cloud.classification, las.classification)
    with pytest.warns(JaxfilterWarning, match=r"in\.laz: holds no points") as given:
        las = make_las(tmp_path / "in.las", point_format, n=0)
        las.write(tmp_path / "in.laz", laz_backend=backend)
        assert len(read(tmp_path / "in.laz")) == 0
    assert len(given) == 1


def test_truncated_extended_records(tmp_path):
    path = tmp_path / "in.las"
    make_las(path, 6)
    path.write_bytes(path.read_bytes()[:-10])
    assert_refused(path, "extended record 1 of 1")
    patch(path, "I", 243, 2**31)
    assert_refused(path, "announces 2147483648 extended records")
    make_las(path, 6)
    patch(path, "Q", 235, offset_to_points(path) + 199 * 30)
    assert_refused(path, "extended records begin at byte .*, before the end of the points")


# headers that lie


@pytest.mark.parametrize("name, point_format, layout, at, value, message", [
    ("in.las", 1, "I", 107, 10_000_000, "announces 10000000 points, but the file holds 200"),
    ("in.las", 6, "Q", 247, 2**62, f"announces {2**62} points"),
    ("in.laz", 1, "I", 107, 2**31, f"announces {2**31} points"), ("in.laz", 1, "I", 107, 100_001, "announces 100001 points"),
    ("in.copc.laz", 6, "Q", 247, 401, "announces 401 points"),
    *[("in.las", 1, "I", 100, count, f"announces {count} variable length records") for count in (2**31, 1000)],
    ("in.las", 1, "H", 227 + 20, 60_000, "variable length record 1 of"),
    *[("in.las", 6, "d", 131 + 8, value, "Y scale factor is")
      for value in (0.0, -0.01, float("nan"), float("inf"), 1e300, 1e-300, 100.1, 1e-12)],
    ("in.las", 6, "d", 155 + 16, float("nan"), "Z offset is nan"),
    ("in.las", 6, "B", 24, 2, "version 2.4 is not supported"), ("in.las", 6, "B", 25, 6, "version 1.6 is not supported"),
    ("in.las", 6, "H", 94, 100, "header size 100"), ("in.las", 6, "H", 94, 60_000, "header size 60000|offset to point data"),
    ("in.las", 6, "I", 96, 0, "offset to point data 0"), ("in.las", 6, "I", 96, 2**32 - 1, "offset to point data"),
    ("in.las", 6, "B", 104, 11, "point format 11 is unknown"),
    ("in.las", 6, "H", 105, 29, "records of 29 bytes are too short"),
    ("in.las", 6, "B", 104, 6 | 0x80, "laszip record is missing"),
])  # fmt: skip
def test_header_fields(tmp_path, name, point_format, layout, at, value, message):
    path = tmp_path / name
    if "copc" in name:
        make_copc(path)
    else:
        make_las(path, point_format, n=60_000 if name == "in.laz" else 200)
    patch(path, layout, at, value)
    assert_refused(path, message)


@pytest.mark.parametrize("damage", ["centre", "half", "small", "key"])
def test_octree_whose_cubes_are_elsewhere(tmp_path, damage):
    """Points are found all the same: the first of each chunk is outside of its cube, so every chunk is read."""
    path = tmp_path / "in.copc.laz"
    make_copc(path)
    bounds = (*(OFFSETS[:2] + 10), *(OFFSETS[:2] + 30))
    expected = read(path, bounds=bounds).xyz
    entries = struct.unpack_from("<Q", path.read_bytes(), 235)[0] + 60
    at, layout, value = {
        "centre": (375 + 54, "d", OFFSETS[0] + 1000), "half": (375 + 54 + 24, "d", float("nan")),
        "key": (entries + 32 + 4, "i", 7), "small": (375 + 54 + 24, "d", 20.0),
    }[damage]  # fmt: skip
    patch(path, layout, at, value)
    with pytest.warns(JaxfilterWarning, match=r"in.copc.laz: points lie outside the cubes"):
        assert read(path, bounds=bounds).xyz.tobytes() == expected.tobytes()
    assert 5 < len(expected) < 100


def test_chunk_that_no_memory_holds(tmp_path, monkeypatch):
    """One chunk, of which neither its bytes nor its table tell how many points it has."""
    path = tmp_path / "in.laz"
    make_las(path, 1, n=240_000)
    content = bytearray(path.read_bytes())
    sizes = content.find(b"laszip encoded") + 52 + 12
    struct.pack_into("<I", content, sizes, 2**32 - 2)
    struct.pack_into("<I", content, 107, 4_200_000_000)
    path.write_bytes(content)
    assert len(content) > 4.2e6
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(total=16 * 2**30))
    assert_refused(path, "chunk of 4200000000 points does not fit into the memory of this machine")
    make_las(path, 1)
    monkeypatch.setattr(np, "empty", lambda *_: bytearray(2**62))
    with pytest.raises(InputError, match=r"in\.laz: its points need more memory than there is.*by bounds"):
        read(path)


def test_laszip_record_of_another_point_size(tmp_path):
    path = tmp_path / "in.laz"
    make_las(path, 1)
    patch(path, "H", 105, 40)
    assert_refused(path, "describes other points than point format 1 of 40 bytes")
    make_las(path, 1)
    items = path.read_bytes().find(b"laszip encoded") + 52 + 34
    for at, value in ((4, 1), (6, 0), (-34, 3)):  # POINT10 of version 1, bytes in place of times, layers
        make_las(path, 1)
        patch(path, "H", items + at, value)
        assert_refused(path, "describes other points than point format 1")


@pytest.mark.parametrize("point_format", [1, 6])
def test_kinds_of_laz_that_cannot_be_read_are_named(tmp_path, point_format):
    """They are sound files, only of another time."""
    path = tmp_path / "in.laz"
    make_las(path, point_format)
    record = path.read_bytes().find(b"laszip encoded") + 52
    patch(path, "H", record, 1)  # points one by one
    assert_refused(path, r"LAZ without chunks \(of LASzip 1, before 2011\) cannot be read: compress the file anew")
    if point_format == 6:
        make_las(path, 6)
        patch(path, "H", record + 34 + 4, 4)
        assert_refused(path, r"items have version 4 .* cannot be read yet: compress the file anew with an older LASzip")


# content


def test_echoes_that_cannot_be(tmp_path):
    path, xyz = tmp_path / "in.las", np.arange(600.0).reshape(200, 3)
    las_of(path, xyz, crs=32632, return_number=0, number_of_returns=0)
    with pytest.warns(JaxfilterWarning, match=r"in.las: return number and number of returns are 0 throughout"):
        assert read(path).candidate.all()
    number, total = 1 + np.arange(200) % 2, np.full(200, 2)
    number[:3], total[:3] = (0, 3, 1), (0, 2, 0)
    las_of(path, xyz, crs=32632, return_number=number, number_of_returns=total)
    with pytest.warns(JaxfilterWarning, match=r"in.las: 3 points have impossible return numbers"):
        assert np.flatnonzero(read(path).candidate).tolist() == [0, 1, 2, *range(3, 200, 2)]


def test_coordinates_that_las_cannot_hold(tmp_path):
    (tmp_path / "in.xyz").write_text("0 0 0\n1 nan 0\n2 2 2\n")
    with pytest.warns(JaxfilterWarning, match="1 points with NaN"):
        invalid = read(tmp_path / "in.xyz", drop_invalid=True)
    far = PointCloud.from_arrays(np.array([[0.0, 0, 0], [1e7, 0, 0], [0, 5, 0]]))
    for cloud, words in ((invalid, ""), (far, r"coordinate \[10000000.0, 0.0, 0.0\] ")):
        for suffix in (".las", ".laz"):
            with pytest.raises(OutputError, match=f"{words}does not fit into 32 bits"):
                write(tmp_path / f"out{suffix}", cloud, np.zeros(3, bool))
    assert [path.name for path in tmp_path.iterdir()] == ["in.xyz"]


@pytest.mark.parametrize("point_format, where, at, damage, words", [
    (6, b"PROJC", 2, b"\xff", "the WKT of its CRS cannot be understood"),
    (1, b"LASF_Projection", 52 + 6, b"\x60\xea", "the GeoTIFF keys of its CRS cannot be understood"),  # their number
    (6, b"LASF_Spec", 52 + 2, b"\xc8\0", "the description of its extra bytes is damaged; they are kept"),  # type
    (6, b"LASF_Spec", 52 + 2, b"\0\xff", "the description of its extra bytes is damaged; they are kept"),  # size
])  # fmt: skip
def test_records_that_cannot_be_understood_are_said_and_kept(tmp_path, point_format, where, at, damage, words):
    path = tmp_path / "in.las"
    make_las(path, point_format, extra=where == b"LASF_Spec")
    content = path.read_bytes()
    at += content.index(where)
    content = content[:at] + damage + content[at + len(damage) :]
    path.write_bytes(content)
    with pytest.warns(JaxfilterWarning) as caught:
        cloud = read(path)
    messages = " | ".join(str(w.message) for w in caught)
    assert f"in.las: {words}" in messages and ("CRS" not in words or "metres are assumed" in messages)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write(tmp_path / "out.las", cloud, np.zeros(200, bool), reset="none")
    assert (tmp_path / "out.las").read_bytes() == content


# coordinate reference systems


def test_no_crs(tmp_path):
    make_las(tmp_path / "in.las", 6, crs=None)
    with pytest.warns(JaxfilterWarning, match=r"in.las: no CRS states the units, metres are assumed") as caught:
        cloud = read(tmp_path / "in.las")
    assert {warning.filename for warning in caught} == {__file__}, "the caller's line is named"
    assert cloud.units.xy == cloud.units.z == 1 and cloud.crs is None
    with warnings.catch_warnings():
        warnings.simplefilter("error", JaxfilterWarning)
        warnings.filterwarnings("ignore", ".*impossible return numbers")
        read(tmp_path / "in.las", units="m")


@pytest.mark.parametrize("crs, point_format", [(4326, 6), (4979, 6), (4326, 1)])
def test_angles(tmp_path, crs, point_format):
    make_las(tmp_path / "in.las", point_format, crs=crs)
    with pytest.raises(InputError, match=r"in.las: .*not in a projected system \(WGS 84\).*reproject"):
        read(tmp_path / "in.las")
    assert len(read(tmp_path / "in.las", units="m")) == 200


@pytest.mark.parametrize("options", [{"ground_class": 32}, {"other_class": 64}])
def test_class_that_the_point_format_cannot_hold(tmp_path, options):
    make_las(tmp_path / "old.las", 1)
    cloud = read(tmp_path / "old.las")
    with pytest.raises(OutputError, match=r"does not fit into point format 1.*upgrade"):
        write(tmp_path / "out.las", cloud, np.ones(200, bool), **options)
    assert not (tmp_path / "out.las").exists()
