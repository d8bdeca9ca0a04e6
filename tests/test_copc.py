"""COPC as laspy reads it: all points with all they have, windows and levels, of every point format that it can hold."""

from __future__ import annotations

import laspy
import numpy as np
import pytest
from las_files import OFFSETS, make_copc, make_las, patch
from laspy.copc import Bounds, CopcReader

import jaxfilter as jf
from jaxfilter.files.copc import LEAF_POINTS, NODE_CELLS

pytestmark = pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")


def rows(points, names):
    """The points as rows of bytes, in an order of their own."""
    table = np.stack([np.asarray(points[name]).astype(np.float64).reshape(len(points), -1)[:, 0] for name in names], 1)
    return table[np.lexsort(table.T)]


def written(tmp_path, number, **how):
    """The file as LAZ, and as COPC."""
    make_las(tmp_path / "in.las", number, extra=True, **how)
    cloud = jf.read(tmp_path / "in.las")
    ground = np.arange(len(cloud)) % 3 == 0
    for name in ("out.laz", "out.copc.laz"):
        jf.write(tmp_path / name, cloud, ground)
    return laspy.read(tmp_path / "out.laz"), tmp_path / "out.copc.laz"


@pytest.mark.parametrize("number", [0, 1, 2, 3, 6, 7, 8])
def test_every_point_is_found_again(tmp_path, number):
    plain, path = written(tmp_path, number, n=20_000, version="1.5" if number == 7 else None)
    with CopcReader.open(path) as reader:
        found, header = reader.query(), reader.header
        assert header.point_format.id == (number if number >= 6 else 6 + number // 2)
    records = []
    names = [name for name in plain.point_format.dimension_names if name != "scan_angle_rank"]
    assert set(names) - set(header.point_format.dimension_names) == set()
    np.testing.assert_array_equal(rows(found, names), rows(plain.points, names))
    if number >= 6:
        for one in (found, plain.points):
            table = np.frombuffer(one.array.tobytes(), np.uint8).reshape(len(one), -1)
            records.append(table[np.lexsort(table.T)])
        np.testing.assert_array_equal(*records)
    else:
        angle = np.sort(np.asarray(found["scan_angle"]) * 0.006)
        np.testing.assert_allclose(angle, np.sort(plain.scan_angle_rank.astype(float)), atol=0.004)
    wide = [np.asarray(one["echo width"]) for one in (found, plain)]
    np.testing.assert_array_equal(*(one[np.lexsort(one.T)] for one in wide))
    assert header.parse_crs().to_epsg() == plain.header.parse_crs().to_epsg() == 32632
    np.testing.assert_array_equal(header.maxs, plain.header.maxs)
    np.testing.assert_array_equal(header.number_of_points_by_return[:5], plain.header.number_of_points_by_return[:5])
    with laspy.open(path) as file:
        assert file.header.generating_software == plain.header.generating_software
        assert any(one.record_id == 77 for one in file.header.vlrs)
        if plain.header.version.minor >= 4:
            (long,) = (one for one in file.evlrs if one.record_id == 78)
            assert long.record_data == bytes(range(256)) * 300


def test_windows_and_levels(tmp_path):
    plain, path = written(tmp_path, 6, n=60_000)
    with CopcReader.open(path) as reader:
        for low, high in (((0, 0), (10, 10)), ((33.33, 20), (34, 79)), ((50, 40), (50.01, 40.01)), ((0, 0), (100, 80))):
            low, high = (np.append(np.array(corner), z) + OFFSETS for corner, z in ((low, -99), (high, 999)))
            inside = ((plain.xyz >= low) & (plain.xyz <= high)).all(axis=1)
            assert len(reader.query(Bounds(low, high))) == inside.sum() and (inside.any() or high[0] - low[0] < 1)
        levels = [reader.query(level=level) for level in range(4)]
        cube = reader.copc_info
    assert sum(map(len, levels)) == len(plain) and min(len(levels[0]), len(levels[1])) > LEAF_POINTS
    xyz = np.stack([levels[0][axis] * 0.01 for axis in "XY"] + [levels[0]["Z"] * 0.001], axis=1) + OFFSETS
    cell = np.floor((xyz - (cube.center - cube.halfsize)) / cube.spacing)
    assert len(np.unique(cell, axis=0)) == len(xyz) and (cell >= 0).all() and (cell < NODE_CELLS).all(), (
        "one point in each"
    )
    again = tmp_path / "again.copc.laz"
    jf.write(again, jf.read(tmp_path / "in.las"), np.arange(len(plain)) % 3 == 0)
    assert again.read_bytes() == path.read_bytes()
    box = (OFFSETS[0] + 20, OFFSETS[1] + 10, OFFSETS[0] + 60, OFFSETS[1] + 30)
    parts = [jf.read(one, bounds=box).coordinates() for one in (path, tmp_path / "out.laz")]
    np.testing.assert_array_equal(*(one[np.lexsort(one.T)] for one in parts))


@pytest.mark.parametrize("n, place", [(0, 0), (1, 7), (5000, 7)])
def test_few_points_and_points_at_one_place(tmp_path, n, place):
    plain, path = written(tmp_path, 7, n=n, **{axis: np.full(n, place) for axis in "XYZ"})
    with CopcReader.open(path) as reader:
        assert len(reader.query()) == len(plain) == n
    assert len(jf.read(path)) == n


@pytest.mark.parametrize("layout, at, value, words", [
    *[(layout, 32 + at, value, "entry of the octree's page at byte {page} is damaged")  # level, offset, length, points
      for layout, at, value in (("i", 0, -1), ("i", 0, 64), ("Q", 16, 2**40), ("i", 24, -1), ("i", 28, -2))],
    ("i", 28, 399, "the octree does not name the chunks that are in the table"),
    ("Qii", 16, None, "page of the octree"),  # which names itself
])  # fmt: skip
def test_a_damaged_octree_is_named(tmp_path, layout, at, value, words):
    path = tmp_path / "in.copc.laz"
    make_copc(path)
    with CopcReader.open(path) as reader:
        page = reader.copc_info.hierarchy_root_offset
    patch(path, layout, page + at, *((page, 32, -1) if value is None else (value,)))
    with pytest.raises(jf.InputError, match=f"in.copc.laz: {words.format(page=page)}"):
        jf.read(path, bounds=(OFFSETS[0] + 1, OFFSETS[1] + 1, OFFSETS[0] + 9, OFFSETS[1] + 9))
    assert len(jf.read(path)) == 400, "all points are found without it"


@pytest.mark.parametrize("number", [4, 5, 9, 10])
def test_waveforms_are_refused_before_anything_is_written(tmp_path, number):
    make_las(tmp_path / "in.las", number)
    cloud = jf.read(tmp_path / "in.las")
    with pytest.raises(jf.OutputError, match=rf"out.copc.laz: .*waveforms of point format {number}: write .laz"):
        jf.write(tmp_path / "out.copc.laz", cloud, None)
    assert [path.name for path in tmp_path.iterdir()] == ["in.las"]


def test_the_change_of_format_is_said_and_copc_and_arrays_become_copc(tmp_path):
    make_las(tmp_path / "in.las", 3)
    with pytest.warns(jf.JaxfilterWarning, match="converted from 3 to 7"):
        jf.write(tmp_path / "a.copc.laz", jf.read(tmp_path / "in.las"), None)
    make_copc(tmp_path / "b.copc.laz")
    cloud = jf.read(tmp_path / "b.copc.laz")
    jf.write(tmp_path / "c.copc.laz", cloud, None)
    jf.write(tmp_path / "d.copc.laz", jf.PointCloud.from_arrays(cloud.coordinates()), None)
    for name in "acd":
        with CopcReader.open(tmp_path / f"{name}.copc.laz") as reader:
            found = reader.query()
        of = jf.read(tmp_path / ("in.las" if name == "a" else "b.copc.laz"))
        assert len(found) == len(of)
        xyz = np.stack([found.X, found.Y, found.Z], 1) * reader.header.scales + reader.header.offsets
        truth = of.coordinates()
        np.testing.assert_allclose(xyz[np.lexsort(xyz.round(3).T)], truth[np.lexsort(truth.round(3).T)], atol=0.002)
