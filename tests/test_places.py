"""Places where the terrain may be wrong: on constructed clouds of which everything is known, and across files."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import shapely
from commands import facts, run
from test_tiles_run import Here

import jaxfilter as jf
from jaxfilter.reports.places import LARGEST_AREA, REASONS, SIDE, UNKNOWN_AREA, find_suspects, places_of

pytestmark = pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
CUT = REASONS[0]
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
    """Places of labels alone."""
    cloud = jf.PointCloud.from_arrays(xyz, **how.pop("reading", {}))
    labels = np.broadcast_to(ground, len(xyz)).copy()
    return places_of([find_suspects(cloud, labels, **how)], cloud.units.xy)


def cut(*given, **how):
    return [place for place in found(*given, **how) if place.reason == CUT]


def test_a_cut_roof_that_is_ground_is_the_first_place():
    xyz = field(ROOF)
    table = jf.review(xyz, np.ones(len(xyz), bool))
    first = table.iloc[0]
    assert first.reason == CUT and first.area == pytest.approx(120, abs=80) and first["rank"] == 1
    x0, y0, x1, y1 = ROOF
    assert x0 < first.x < x1 and y0 < first.y < y1
    inside = first.geometry.intersection(shapely.box(*ROOF)).area
    assert inside > 110 and first.volume == pytest.approx(0.5 * 8 * 120, rel=0.2), (
        "a height of 8 m, with a chance of a half"
    )
    assert jf.review(xyz, xyz[:, 2] < 104).volume.sum() < first.volume / 5, "as it should be"


@pytest.mark.parametrize("roofs, how, count", [
    (((5, 20, 17, 30),), {}, 0),  # nothing of it is missing
    ((ROOF,), {"height": 2.0}, 0),  # as low as a car, or a terrace
    (((0, 20, 1.4, 30),), {}, 0),  # too little of it
    (((0, 60, 26, 80),), {"size": 160.0, "step": 1.0}, 1),
    (((0, 60, 60, 80),), {"size": 160.0, "step": 1.0}, 0),  # what reaches far into the data is terrain
    # A ledge with higher land behind it, along a third of the border inside the data, or along two: not if it hardly falls.
    ((ROOF, *2 * [(0, 30, 100, 100)]), {"size": 100.0}, 1),
    ((ROOF, *2 * [(0, 30, 100, 100), (12, 0, 100, 30)]), {"size": 100.0}, 0),
    ((), {"slope": 0.5}, 0), ((ROOF,), {"slope": 0.5}, 1),  # a slope is no object and hides none
])  # fmt: skip
def test_what_is_a_cut_roof(roofs, how, count):
    assert (len(cut(field(*roofs, **how))) > 0) == (count > 0), "what is wider than 50 m is cut"


def test_a_cliff_taken_as_an_object_is_the_first_place_and_one_that_is_ground_is_none():
    xyz = field(size=160.0, step=1.0)
    x, y = xyz.T[:2]
    xyz[:, 2] += np.clip(2.5 * (x - 70), 0, 30)
    lost = (x > 69) & (x < 83) & (y > 30) & (y < 130)
    first, *rest = found(xyz, ~lost)
    assert first.reason == "steep face taken as an object" and 68 < first.x < 84 and 30 < first.y < 130
    area, truth = sum(place.area for place in (first, *rest) if place.reason == first.reason), 100 * 14
    assert 0.7 * truth < area < 2 * truth and first.chance > 0.3
    assert all(place.reason != first.reason for place in found(xyz))


def test_walls_and_canopies_are_no_steep_faces(rng):
    xyz = field((60, 60, 100, 90), height=12.0, size=160.0, step=1.0)
    building = xyz[:, 2] > 106
    x, y = xyz.T[:2]
    forest = (x > 20) & (x < 50) & (y > 20) & (y < 140)
    xyz[forest, 2] += rng.uniform(3, 20, forest.sum())
    assert all(place.reason == "few ground points" for place in found(xyz, ~building & ~forest))


def test_a_hole_without_ground_is_named_where_the_terrain_is_uneven():
    xyz = field(size=80.0, slope=0.4)
    x, y = xyz.T[:2]
    hole = (abs(x - 40) < 9) & (abs(y - 40) < 9)
    (place,) = found(xyz + hole[:, None] * [0, 0, 5], ~hole)
    assert place.reason == "few ground points" and place.area == pytest.approx(18**2, rel=0.4)
    assert abs(place.x - 40) < 9 and abs(place.y - 40) < 9
    empty = found(xyz[~hole])
    held = {tuple(cell) for cell in np.floor(xyz[~hole, :2] / SIDE).astype(int).tolist()}
    assert all((place.x // SIDE, place.y // SIDE) in held for place in empty), "centred on data"
    assert found(field(size=80.0)) == [], "level ground without a fault"


def test_low_points_and_doubt_are_told_apart():
    xyz = field(size=40.0, slope=0.5)
    x, y = xyz.T[:2]
    made = jf.FilterResult.of_labels(np.ones(len(xyz), bool))
    doubtful = np.where((x < 12) & (y < 12), 0.45, 0.01).astype(np.float32)
    ground = ~((x < 12) & (y < 12) & (xyz[:, 0] % 1 < 0.5))
    result = dataclasses.replace(made, ground=ground, doubt=doubtful, height=np.zeros(len(xyz), np.float32))
    (place,) = jf.review(xyz, result).itertuples()
    assert place.reason == "doubtful points" and place.x < 12 and place.y < 12
    noisy = dataclasses.replace(result, low_noise=~ground)
    assert jf.review(xyz, noisy).reason.tolist() == ["low points left out"]


def test_voids_are_no_border_but_the_outside_is():
    xyz = field((36, 30, 46, 40), size=80.0)
    x, y = xyz.T[:2]
    lake = (x >= 10) & (x < 36) & (y >= 20) & (y < 50)
    assert cut(xyz[~lake]) == []
    channel = (x < 36) & (y >= 32) & (y < 38)
    assert cut(xyz[~channel]) == [], "narrow"
    bay = (x < 36) & (y >= 20) & (y < 50)
    assert len(cut(xyz[~bay])) == 1
    classes = np.where(bay, 9, 0).astype(np.uint8)
    assert cut(xyz, reading={"classification": classes}) == [], "water that has points is part of the data"


def test_neither_order_nor_offset_nor_units_matter():
    xyz = field(ROOF, (40, 53, 50, 60))
    there = cut(xyz)
    assert len(there) == 2 and there[0].volume >= there[1].volume
    order = np.random.default_rng(0).permutation(len(xyz))
    assert [place.facts() for place in cut(xyz[order])] == [place.facts() for place in there]
    moved = cut(xyz + [512_000, 5_403_000, 0])
    assert [(o.area, o.volume) for o in moved] == [(o.area, pytest.approx(o.volume)) for o in there]
    at = np.array([(o.x, o.y) for o in there])
    np.testing.assert_allclose([(o.x - 512_000, o.y - 5_403_000) for o in moved], at, atol=1e-6)
    feet = cut(xyz / 0.3048, reading={"units": "ft"})
    assert [o.area for o in feet] == [o.area for o in there]
    np.testing.assert_allclose([(o.x * 0.3048, o.y * 0.3048) for o in feet], at, atol=0.01)


def test_the_edge_of_a_window_is_no_border():
    xyz = field(ROOF)
    box = (0.0, 0.0, 60.0, 60.0)
    assert len(cut(xyz, footprints=[box], window=(-20.0, -20.0, 80.0, 80.0))) == 1
    assert cut(xyz, footprints=[(-60.0, 0.0, 60.0, 60.0)], window=(0.0, 0.0, 60.0, 60.0)) == []
    west, east = (find_suspects(jf.PointCloud.from_arrays(xyz), np.ones(len(xyz), bool), core=core) for core in (
        (-2.0, -2.0, 6.0, 62.0), (6.0, -2.0, 62.0, 62.0),
    ))  # fmt: skip
    whole, joined = found(xyz), places_of([east, west], 1.0)
    assert [place.facts() for place in joined] == [place.facts() for place in whole]
    assert len(west.cells) and len(east.cells)


@pytest.mark.slow
def test_stray_points_are_no_error_in_a_run(tmp_path):
    write(tmp_path / "in.laz", np.concatenate([field(ROOF), [[90_000.0, 80_000.0, 100.0]]]))
    report = jf.ground(tmp_path / "in.laz", tmp_path / "out.laz", jf.PTD())
    assert report.places == [] and any("are not looked for" in remark for remark in report.remarks)


def write(path, xyz):
    jf.write(path, jf.PointCloud.from_arrays(xyz), None)


def test_a_neighbour_in_the_halo_decides(tmp_path):
    """Two thirds of a roof are too wide for the window, the whole of it is not."""
    xyz = field((20, 15, 32, 45))
    west = xyz[:, 0] < 30
    for name, rows in (("west", west), ("east", ~west)):
        write(tmp_path / f"{name}.laz", xyz[rows])
    filter_ = jf.SMRF(window=8.0)
    alone = jf.read(tmp_path / "west.laz", anchor=(0.0, 0.0))
    expected = [place.facts() for place in places_of([find_suspects(alone, filter_(alone))], 1.0)]
    assert expected[0]["reason"] == CUT and expected[0]["area"] == pytest.approx(300, rel=0.2)
    both = [tmp_path / "west.laz", tmp_path / "east.laz"]
    reports = [
        jf.ground(files, tmp_path / str(k), filter_, run=jf.RunOptions(tile=tile, wide_halos=True, executor=Here()))
        for k, (files, tile) in enumerate(((both[0], 30.0), (both, 30.0), (both[0], 15.0)))
    ]
    assert reports[0].places == reports[2].places == expected and reports[2].tiles == 8
    assert all(place["reason"] != CUT for place in reports[1].places)
    ground = jf.read(tmp_path / "1" / "west.laz").classification == 2
    assert np.array_equal(ground, xyz[west, 2] < 104), "labels are right where the neighbour is seen"


def test_the_command_tells_of_places(tmp_path):
    write(tmp_path / "in.laz", field(ROOF, (30, 48, 54, 60)))
    words = ("ground", "smrf", tmp_path / "in.laz", tmp_path / "out.laz", "--window", "8", "--overwrite")
    places = facts(*words, "--quiet", "--review", tmp_path / "places.geojson")["places"]
    written = [one["properties"] for one in json.loads((tmp_path / "places.geojson").read_text())["features"]]
    assert [one["volume"] for one in written] == pytest.approx([place["volume"] for place in places])
    assert places[0]["reason"] == CUT and places[0]["x"] > 30 and places[0]["y"] > 48, "the wide one is ground"
    said = run(*words).stderr
    assert f"where the terrain may be wrong, please check: {places[0]['area']:,.0f} m2 at" in said
    assert f"{len(places)} place" in said and CUT in said


def test_places_can_be_looked_through_and_what_hides_the_ground_is_named_once(rng):
    xyz = field(size=600.0, step=2.0, slope=0.5)
    x, y = xyz.T[:2]
    forest = (x > 300) & (y > 200)
    spots = np.hypot(x % 37 - 18, y % 37 - 18) < 6.5
    ground = ~(forest | spots)
    xyz[~ground, 2] += rng.uniform(3, 20, (~ground).sum())
    listed = found(xyz, ground)
    *places, unknown = listed
    assert unknown.reason == UNKNOWN_AREA and unknown.area == pytest.approx(300 * 400, rel=0.15)
    assert 5 < len(places) <= 60 * 0.36 and all(place.reason != UNKNOWN_AREA for place in places)
    for place in places:
        assert place.area <= LARGEST_AREA and (np.ptp(place.cells, axis=0) * SIDE <= 220).all()
    together = np.concatenate([place.cells for place in listed])
    assert len(np.unique(together, axis=0)) == len(together), "no cell is in two places"
    assert [place.volume for place in places] == sorted((place.volume for place in places), reverse=True)
