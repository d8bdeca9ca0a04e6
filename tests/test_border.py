"""Objects that the border of the data cuts: on scenes of which everything is known, and a roof between two files."""

from __future__ import annotations

import dataclasses
import json

import laspy
import numpy as np
import pytest
from click.testing import CliRunner
from test_tiles_run import Here

import jaxfilter as jf
from jaxfilter.cli import main

pytestmark = pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
ROOF = (0.0, 20.0, 12.0, 30.0)
"""Cut by the western border: 12 by 10 metres are left of it."""


def field(*roofs, height=8.0, size=60.0, step=0.5, slope=0.0):
    """f64[n, 3]: points every half metre on a plane, raised where a rectangle is."""
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0, size, step) + 0.2, np.arange(0, size, step) + 0.3))
    z = 100.0 + slope * x
    for x0, y0, x1, y1 in roofs:
        z[(x >= x0) & (x < x1) & (y >= y0) & (y < y1)] += height
    return np.column_stack([x, y, z])


def found(xyz, ground=True, **how):
    cloud = jf.PointCloud.from_arrays(xyz, **how.pop("reading", {}))
    labels = np.broadcast_to(ground, len(xyz)).copy()
    return jf.cut_objects(cloud, labels, **how)


def test_a_cut_roof_is_measured():
    (one,) = found(field(ROOF))
    assert (one.area, one.touch, one.fall) == (pytest.approx(120, abs=12), 10, pytest.approx(8))
    assert (one.x, one.y) == (pytest.approx(6, abs=0.8), pytest.approx(25, abs=0.8)) and one.ground == 1
    assert one.bounds == pytest.approx(ROOF, abs=1) and one.is_ground
    xyz = field(ROOF)
    (half,) = found(xyz, (xyz[:, 2] < 104) | (xyz[:, 1] < 23))
    assert half.ground == pytest.approx(0.3, abs=0.05) and not half.is_ground


@pytest.mark.parametrize(
    "roofs, how",
    [
        (((5, 20, 17, 30),), {}),  # nothing of it is missing
        ((ROOF,), {"height": 2.0}),  # as low as a car, or a terrace
        (((0, 20, 1.4, 30),), {}),  # too little of it
    ],
)
def test_what_is_no_cut_roof(roofs, how):
    assert found(field(*roofs, **how)) == []


def test_what_reaches_far_into_the_data_is_terrain():
    for length, count in ((90.0, 1), (130.0, 0)):
        assert len(found(field((0, 120, length, 140), size=260.0, step=1.0))) == count


def test_a_slope_is_no_object_and_hides_none():
    assert found(field(slope=0.6)) == []
    assert len(found(field(ROOF, slope=0.6))) == 1


def test_voids_are_no_border_but_the_outside_is():
    xyz = field((20, 20, 30, 30))
    x, y = xyz.T[:2]
    lake = (x >= 10) & (x < 20) & (y >= 15) & (y < 35)
    assert found(xyz[~lake]) == []
    channel = (x < 20) & (y >= 23) & (y < 27)
    assert found(xyz[~channel]) == [], "narrow"
    bay = (x < 20) & (y >= 15) & (y < 35)
    assert len(found(xyz[~bay])) == 1
    classes = np.where(bay, 9, 0).astype(np.uint8)
    assert found(xyz, reading={"classification": classes}) == [], "water that has points is part of the data"


def test_neither_order_nor_offset_nor_units_matter():
    xyz = field(ROOF, (40, 53, 50, 60))
    there = found(xyz)
    assert len(there) == 2 and there[0].y < there[1].y
    order = np.random.default_rng(0).permutation(len(xyz))
    assert found(xyz[order]) == there
    moved = found(xyz + [512_000, 5_403_000, 0])
    assert [(o.area, o.touch, o.fall) for o in moved] == [(o.area, o.touch, o.fall) for o in there]
    places = np.array([(o.x, o.y) for o in there])
    np.testing.assert_allclose([(o.x - 512_000, o.y - 5_403_000) for o in moved], places, atol=1e-6)
    feet = found(xyz / 0.3048, reading={"units": "ft"})
    assert [o.area for o in feet] == [o.area for o in there]
    np.testing.assert_allclose([(o.x * 0.3048, o.y * 0.3048) for o in feet], places, atol=0.01)


def test_the_edge_of_a_window_is_no_border():
    xyz = field(ROOF)
    box = (0.0, 0.0, 60.0, 60.0)
    assert len(found(xyz, footprints=[box], window=(-20.0, -20.0, 80.0, 80.0))) == 1
    assert found(xyz, footprints=[(-60.0, 0.0, 60.0, 60.0)], window=(0.0, 0.0, 60.0, 60.0)) == []
    assert len(found(xyz, footprints=[box], core=(0.0, 15.0, 10.0, 25.0))) == 1
    assert found(xyz, footprints=[box], core=(0.0, 25.0, 10.0, 40.0)) == [], "another tile lists it"


def test_labels_must_fit():
    with pytest.raises(jf.InputError, match=r"bool\[14400\] is needed"):
        jf.cut_objects(jf.PointCloud.from_arrays(field()), np.zeros(3, bool))
    assert jf.cut_objects(jf.PointCloud.from_arrays(np.zeros((0, 3))), np.zeros(0, bool)) == []


def test_stray_points_are_no_error():
    with pytest.warns(jf.JaxfilterWarning, match="are not looked for: .* remove stray points"):
        assert found(np.concatenate([field(ROOF), [[90_000.0, 80_000.0, 100.0]]])) == []


def write(path, xyz):
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales, las.header.offsets = np.full(3, 0.01), np.zeros(3)
    las.x, las.y, las.z = xyz.T
    las.return_number[:] = las.number_of_returns[:] = 1
    las.write(path)


def test_a_neighbour_in_the_halo_decides(tmp_path):
    """Two thirds of a roof are too wide for the window, the whole of it is not."""
    xyz = field((20, 15, 32, 45))
    west = xyz[:, 0] < 30
    for name, rows in (("west", west), ("east", ~west)):
        write(tmp_path / f"{name}.laz", xyz[rows])
    filter_ = jf.SMRF(window=8.0)
    alone = jf.read(tmp_path / "west.laz", anchor=(0.0, 0.0))
    (cut,) = jf.cut_objects(alone, filter_(alone))
    assert cut.is_ground and cut.area == pytest.approx(300, rel=0.1) and cut.bounds[2] == pytest.approx(30, abs=1)
    both = [tmp_path / "west.laz", tmp_path / "east.laz"]
    reports = [
        jf.ground(files, tmp_path / str(k), filter_, run=jf.RunOptions(tile=tile, executor=Here()))
        for k, (files, tile) in enumerate(((both[0], 30.0), (both, 30.0), (both[0], 15.0)))
    ]
    expected = [dataclasses.asdict(cut) | {"bounds": list(cut.bounds)}]
    assert [report.cut_objects for report in reports] == [expected, [], expected] and reports[2].tiles == 8
    ground = jf.read(tmp_path / "1" / "west.laz").classification == 2
    assert np.array_equal(ground, xyz[west, 2] < 104), "labels are right where the neighbour is seen"


def test_the_command_tells_of_cut_roofs(tmp_path):
    write(tmp_path / "in.laz", field(ROOF, (30, 48, 54, 60)))
    words = ["ground", "smrf", str(tmp_path / "in.laz"), str(tmp_path / "out.laz"), "--window", "8", "--overwrite"]
    told = CliRunner().invoke(main, [*words, "--json", "--quiet"])
    cloud = jf.read(tmp_path / "in.laz")
    cut = jf.cut_objects(cloud, jf.read(tmp_path / "out.laz").classification == 2)
    assert json.loads(told.stdout)["cut_objects"] == [
        dataclasses.asdict(one) | {"bounds": list(one.bounds)} for one in cut
    ] and [one.is_ground for one in cut] == [False, True]
    text = CliRunner().invoke(main, words)
    assert "1 object cut by the edge of the data was classified as non-ground; please check it" in text.stderr
    assert "1 object at the edge of the data may be a cut roof and was classified as ground: 288 m2 at" in text.stderr
