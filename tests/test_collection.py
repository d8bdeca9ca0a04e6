"""Surveys of many files: what is named, what their headers say, what does not fit together, virtual point clouds."""

from __future__ import annotations

import itertools
import json
import os
import re

import laspy
import numpy as np
import pyproj
import pytest
from commands import done, facts, run
from las_files import OFFSETS, make_copc, make_las

import jaxfilter as jf
from jaxfilter.files.sources import Source
from jaxfilter.surveys.collection import Collection

WKT = pyproj.CRS.from_epsg(32632).to_wkt()


def tile(uri, x=0.0, y=0.0, side=100.0, count=10, **fields):
    return Source(uri, "laz", (x, y, x + side, y + side), count, (0.0, 9.0), **{"wkt": WKT, "point_format": 6} | fields)


@pytest.fixture
def folder(tmp_path):
    """Three files with points, one without, and others that are no members."""
    place = tmp_path / "survey"
    (place / "below").mkdir(parents=True)
    make_las(place / "b.laz", 6, n=120)
    make_las(place / "a.LAS", 1, n=100)
    make_copc(place / "c.copc.laz", n=400)
    make_las(place / "empty.laz", 6, n=0)
    make_las(place / "below" / "d.laz", 6, n=50, seed=3)
    make_las(place / ".hidden.laz", 6, n=50)
    (place / "notes.txt").write_text("1 2 3\n")
    return place


def names(survey):
    return [os.path.basename(uri) for uri in survey.uris]


def test_ways_to_name_files(folder):
    members = ["a.LAS", "b.laz", "c.copc.laz", "empty.laz"]
    assert names(jf.open(folder)) == members
    assert names(jf.open(str(folder) + "/")) == members and names(jf.open(f"file://{folder}")) == members
    assert names(jf.open(folder / "*.laz")) == members[1:]
    assert names(jf.open(folder / "notes.txt")) == names(jf.open(folder / "*.txt")) == ["notes.txt"]
    assert names(jf.open(folder / "[ab].*")) == members[:2]
    assert names(jf.open(folder / "**" / "*.laz")) == ["b.laz", "d.laz", "c.copc.laz", "empty.laz"]
    assert names(jf.open(folder / "b.laz")) == ["b.laz"]
    make_las(folder / "below" / "tile[1].laz", 6, n=20)
    assert jf.open(folder / "below" / "tile[1].laz").count == 20, "letters of a pattern in a name"
    survey = jf.open([folder / "c.copc.laz", folder, folder / "b.laz"])
    assert names(survey) == ["c.copc.laz", "a.LAS", "b.laz", "empty.laz"]
    assert [os.path.basename(uri) for uri in survey.repeated] == ["c.copc.laz", "b.laz"]


@pytest.mark.parametrize("name, words", [
    ("absent.laz", "no such file"), ("below/none", "no such file"), ("absent.txt", "no such file"),
    ("absent*.laz", "matches no .las or .laz file"), ("nothing", r"name .*nothing/\*\*/\*.laz"),
])  # fmt: skip
def test_names_that_stand_for_nothing(folder, name, words):
    (folder / "nothing").mkdir()
    with pytest.raises(jf.InputError, match=words):
        jf.open(folder / name)
    with pytest.raises(jf.InputError, match="no files are named"):
        jf.open([])


def test_what_headers_say(folder):
    survey = jf.open(folder)
    assert [s.format for s in survey] == ["las", "laz", "copc", "laz"]
    assert [s.point_format for s in survey] == [1, 6, 6, 6]
    assert survey.counts.tolist() == [100, 120, 400, 0] and survey.count == 620
    clouds = [jf.read(source.uri) for source in survey[:3]]
    for source, cloud in zip(survey[:3], clouds, strict=True):
        xyz = cloud.coordinates()
        if source.format != "copc":  # whose header states the cube
            np.testing.assert_allclose(source.bounds, [*xyz[:, :2].min(axis=0), *xyz[:, :2].max(axis=0)], atol=2e-3)
            np.testing.assert_allclose(source.z, [xyz[:, 2].min(), xyz[:, 2].max()], atol=2e-3)
        assert source.crs == cloud.crs and source.units == cloud.units and len(source.identity) == 32
    assert np.isnan(survey[3].bounds).all() and survey.areas[3] == 0
    table = survey.table()
    assert table["points"].tolist() == survey.counts.tolist() and table["crs"][1] == "WGS 84 / UTM zone 32N"
    assert survey.areas.sum() == pytest.approx(table["area"].sum())
    np.testing.assert_allclose(survey.bounds[:2], OFFSETS[:2], atol=1.0)
    assert [*survey][:3] == [*survey[:3]] == [survey[i] for i in range(3)]


def test_units_and_crs_that_differ(tmp_path):
    for name, crs in (("m.laz", 32632), ("other.laz", 25833), ("ft.laz", 2225), ("none.laz", None), ("m2.laz", 32632)):
        make_las(tmp_path / name, 6, n=30, crs=crs)

    def opened(*found, **options):
        return jf.open([tmp_path / f"{name}.laz" for name in found], **options)

    assert opened("m", "m2", "none").crs == pyproj.CRS.from_epsg(32632)
    assert opened("none").crs is None and opened("none").metre == 1.0
    assert opened("ft").metre == pytest.approx(1200 / 3937)
    for found, words in (
        (("m", "ft"), r"m\.laz is in metre, .*ft\.laz in US survey foot: .* different units"),
        (("ft", "none"), "different units"),
        (("none", "m", "other"), r"m\.laz is in WGS 84 / UTM zone 32N, .*other\.laz in ETRS89.* reproject one"),
    ):
        survey = opened(*found)
        for what in ("crs", "units", "metre"):
            with pytest.raises(jf.InputError, match=words):
                getattr(survey, what)
        assert survey.check().mixed is not None and survey.count > 0
    assert opened("ft", "none", units="us-ft").metre == pytest.approx(1200 / 3937)


@pytest.mark.parametrize("crs, spoil, words", [
    (4326, lambda path: None, "not in a projected system"),
    (32632, lambda path: path.write_bytes(path.read_bytes()[:200]), "too few for a LAS header"),
    (32632, lambda path: path.write_bytes(b""), r"empty \(0 bytes\)"),
])  # fmt: skip
def test_what_is_no_member(tmp_path, crs, spoil, words):
    for name in ("a", "b", "c"):
        make_las(tmp_path / f"{name}.laz", 6, n=30, crs=crs if name == "a" else 32632)
    spoil(tmp_path / "a.laz")
    survey = jf.open(tmp_path)
    assert names(survey) == ["b.laz", "c.laz"]
    ((uri, reason),) = survey.unreadable
    assert uri == str(tmp_path / "a.laz") and re.search(words, reason)
    found = survey.check()
    assert found.unreadable == survey.unreadable and len(found.doubles) == 1
    with pytest.raises(jf.InputError, match=rf"a\.laz: .*{words}"):
        jf.open(tmp_path / "a.laz")


def boxes(rng, n):
    low = rng.uniform(0, 1000, (n, 2))
    return np.column_stack([low, low + rng.choice([1, 10, 100, 600], (n, 1)) * rng.uniform(0.5, 1, (n, 2))])


def test_footprints_by_brute_force(rng):
    """Rectangles of very different sizes, some twice, some without points."""
    bounds = boxes(rng, 300)
    bounds[50:60] = bounds[40:50]
    bounds[100:110] = np.nan
    counts = np.where(np.isnan(bounds[:, 0]), 0, np.arange(1, 301)).tolist()
    survey = Collection(Source(f"{k}", "laz", tuple(bounds[k].tolist()), counts[k], wkt=WKT) for k in range(300))
    for box in boxes(rng, 50):
        met = (bounds[:, 0] < box[2]) & (bounds[:, 2] >= box[0]) & (bounds[:, 1] < box[3]) & (bounds[:, 3] >= box[1])
        np.testing.assert_array_equal(survey.within(tuple(box)), np.flatnonzero(met))
    expected = {}
    for i, j in itertools.combinations(np.flatnonzero(counts).tolist(), 2):
        width, height = (min(bounds[i, k + 2], bounds[j, k + 2]) - max(bounds[i, k], bounds[j, k]) for k in (0, 1))
        areas = [(bounds[k, 2] - bounds[k, 0]) * (bounds[k, 3] - bounds[k, 1]) for k in (i, j)]
        if width > 0 and height > 0 and width * height >= 0.001 * min(areas):
            expected[f"{i}", f"{j}"] = width * height / min(areas)
    found = survey.check().overlaps
    assert {(a, b) for a, b, _ in found} == set(expected)
    shares = [share for *_, share in found]
    np.testing.assert_allclose(shares, [expected[a, b] for a, b, _ in found])
    assert shares == sorted(shares, reverse=True)


def test_gaps_overlaps_and_doubles():
    """A 6 x 5 block of tiles without two that neighbours enclose and one at the rim; one tile twice, one too large."""
    missing = {(2, 2), (3, 2), (5, 0)}
    tiles = [tile(f"{i}{j}.laz", 100 * i, 100 * j) for i in range(6) for j in range(5) if (i, j) not in missing]
    found = Collection([*tiles, tile("double.laz", 0, 0), tile("large.laz", 300, 300, 130)]).check()
    (gap,) = found.gaps
    np.testing.assert_allclose(gap, (200, 200, 400, 300), atol=26)
    assert found.doubles == (("00.laz", "double.laz"),)
    shares = {(a, b): share for a, b, share in found.overlaps}
    assert set(shares) == {(f"{i}{j}.laz", "large.laz") for i in (3, 4) for j in (3, 4)}
    assert shares["33.laz", "large.laz"] == 1.0 and shares["44.laz", "large.laz"] == pytest.approx(0.09)
    text = "\n".join(found.lines())
    assert "same bounds: 1 (" in text and "overlapping pairs: 4 (" in text and "gaps enclosed by files: 1 (" in text
    assert not Collection(tiles[:9]).check().overlaps  # tiles that touch do not overlap


@pytest.mark.parametrize("more", [-1, 1])
def test_files_with_other_points_than_their_virtual_point_cloud_says_are_refused(folder, more):
    jf.open(folder / "below" / "d.laz").to_vpc(folder / "d.vpc")
    content = json.loads((folder / "d.vpc").read_text())
    content["features"][0]["properties"]["pc:count"] += more
    (folder / "d.vpc").write_text(json.dumps(content))
    words = r"d\.laz: holds .* points, and the \.vpc that names it says .*: make the .vpc anew"
    with pytest.raises(jf.InputError, match=words):
        jf.ground(folder / "d.vpc", folder / "out", jf.SMRF())


def test_virtual_point_cloud_there_and_back(folder):
    survey = jf.open([folder, folder / "below" / "d.laz"])
    with pytest.warns(jf.JaxfilterWarning, match="1 files without points are left out"):
        survey.to_vpc(folder / "below" / "all.vpc")
    back = jf.open(folder / "below" / "all.vpc")
    kept = [source for source in survey if source.count]
    for one, other in zip(kept, back, strict=True):
        assert (other.uri, other.format, other.count, other.units) == (one.uri, one.format, one.count, one.units)
        assert other.bounds == one.bounds and other.z == one.z and other.identity == ""
        assert other.crs.equals(one.crs)
    with pytest.raises(jf.OutputError, match="exists"):
        survey.to_vpc(folder / "below" / "all.vpc")
    moved = folder.parent / "moved"
    folder.rename(moved)
    assert jf.open(moved / "below" / "all.vpc").uris[0] == str(moved / "a.LAS")


def test_items_are_those_of_stac(folder, monkeypatch):
    """The fields that PDAL wrench and QGIS read: type, stac_version, first asset, geometry and bbox in degrees, and
    pc:count, proj:wkt2, proj:bbox, proj:geometry, pc:schemas."""
    monkeypatch.chdir(folder)
    survey = jf.open(["b.laz", "below/../below/d.laz"])
    assert list(survey.uris) == [str(folder / "b.laz"), str(folder / "below" / "d.laz")]
    survey.to_vpc("all.vpc")
    content = json.loads((folder / "all.vpc").read_text())
    assert content["type"] == "FeatureCollection" and len(content["features"]) == 2
    item, source = content["features"][1], survey[1]
    assert (item["type"], item["stac_version"], item["id"]) == ("Feature", "1.0.0", "d")
    assert item["assets"] == {"data": {"href": "./below/d.laz", "roles": ["data"]}}
    facts, (x0, y0, x1, y1) = item["properties"], source.bounds
    assert facts["pc:count"] == 50 and facts["proj:bbox"] == [x0, y0, source.z[0], x1, y1, source.z[1]]
    assert pyproj.CRS(facts["proj:wkt2"]).equals(pyproj.CRS.from_epsg(32632))
    assert facts["datetime"].endswith("T00:00:00Z")
    assert facts["pc:schemas"][0] == {"name": "X", "size": 8, "type": "floating"}
    assert "GpsTime" in {schema["name"] for schema in facts["pc:schemas"]}
    ring = item["geometry"]["coordinates"][0]
    project = pyproj.Proj(32632)
    np.testing.assert_allclose([project(*place) for place in ring[:2]], [(x0, y0), (x1, y0)], atol=1e-3)
    np.testing.assert_allclose(item["bbox"][0], min(place[0] for place in ring))
    assert ring[0] == ring[-1] and facts["proj:geometry"]["coordinates"][0][2] == [x1, y1]


def test_items_list_the_dimensions_of_their_point_format(tmp_path):
    whole = Collection(tile(f"{n}.laz", point_format=n) for n in range(11))
    whole.to_vpc(tmp_path / "all.vpc")
    named = {"red": "Red", "green": "Green", "blue": "Blue", "nir": "Infrared", "gps_time": "GpsTime"}
    for n, item in enumerate(json.loads((tmp_path / "all.vpc").read_text())["features"]):
        listed = {schema["name"] for schema in item["properties"]["pc:schemas"]}
        there = {named[name] for name in laspy.PointFormat(n).dimension_names if name in named}
        assert listed & set(named.values()) == there and {"X", "Y", "Z", "Classification"} <= listed


def an_item(href="./a.laz", **properties):
    facts = {"pc:count": 7, "proj:bbox": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "proj:wkt2": WKT}
    facts["datetime"] = "2013-07-17T00:00:00Z"
    assets = {"data": {"href": href, "roles": ["data"]}}
    item = {"type": "Feature", "stac_version": "1.0.0", "id": "a", "geometry": None, "links": [], "assets": assets}
    return item | {"properties": {k: v for k, v in (facts | properties).items() if v is not None}}


def write_items(path, items):
    path.write_text(json.dumps({"stac_version": "1.0.0", "type": "FeatureCollection", "features": items, "x": [1]}))
    return path


def test_other_writers(tmp_path):
    """Names of all kinds, overviews beside the data, boxes without Z, codes instead of WKT; and what has to be read."""
    make_las(tmp_path / "real.laz", 6, n=33)
    overview = an_item()
    overview["assets"] = {"a": {"href": "./a-overview.copc.laz", "roles": ["overview"]}, "b": {"href": "b.copc.laz"}}
    items = [
        overview, an_item("/else/where.las"), an_item("https://x.org/t/1.laz"), an_item("../up.laz"),
        an_item("flat.laz", **{"proj:bbox": [1, 2, 4, 5]}),
        an_item("code.laz", **{"proj:wkt2": None, "proj:epsg": 2225}),
        an_item("json.laz", **{"proj:wkt2": None, "proj:projjson": json.loads(pyproj.CRS.from_epsg(2225).to_json())}),
        an_item("none.laz", **{"proj:wkt2": ""}),
        an_item("real.laz", **{"proj:bbox": None}), an_item("absent.laz", **{"pc:count": None}), an_item("x/ept.json"),
    ]  # fmt: skip
    survey = jf.open(write_items(tmp_path / "a.vpc", items))
    up, here = tmp_path.parent, tmp_path
    expected = [here / "b.copc.laz", "/else/where.las", "https://x.org/t/1.laz", up / "up.laz"]
    assert list(survey.uris)[:4] == [str(uri) for uri in expected]
    assert [s.format for s in survey] == ["copc", "las", "laz", "laz", "laz", "laz", "laz", "laz", "laz"]
    assert survey[4].bounds == (1, 2, 4, 5) and survey[0].z == (3.0, 6.0)
    assert survey[5].metre == survey[6].metre == pytest.approx(1200 / 3937) and survey[7].crs is None
    assert survey[8].count == 33 and survey[8].identity and survey[0].date == "2013-07-17"
    assert [os.path.basename(uri) for uri, _ in survey.unreadable] == ["absent.laz", "ept.json"]
    written = json.loads(survey.to_vpc(tmp_path / "b.vpc").read_text(), parse_constant=pytest.fail)  # NaN is no JSON
    assert [len(written["features"][k]["properties"]["proj:bbox"]) for k in (3, 4)] == [6, 4]
    assert jf.open(tmp_path / "b.vpc").footprints[:8].tolist() == survey.footprints[:8].tolist()


def features(**properties):
    return json.dumps({"features": [an_item(**properties)]})


@pytest.mark.parametrize("content, words", [
    ('{"features": {}}', "no list"), ("[]", "no list"), ('{"features": []}', "names no files"),
    ("", "cannot be decoded"), ('{"features": [', "cannot be decoded"),
    *[(f'{{"features": [{item}]}}', "item 1 is not as it should be")
      for item in ('{"type": "Feature"}', '{"assets": {}, "properties": {}}')],
    *[(features(**{"pc:count": count}), f"item 1 .*pc:count.*{words} points") for count, words in (
        (-1, "-1"), (1e30, "1e.30"), (1e308, "1e.308"), (2**63, "9223372036854775808"), (1.5, "1.5"), (float("inf"), "inf"))],
    *[(features(**{"proj:bbox": box}), f"item 1 {words}") for box, words in (
        ([4, 0, 1, 1], "is not as it should be"), ([-1e308, 0, 1e308, 1], ".*proj:bbox"),
        ([10**400, 0, 10**400, 1], ".*too large"), ([0, 0, float("nan"), 1], ".*proj:bbox"))],
    (features(**{"proj:wkt2": "EPSG:0"}), "item 1 is not as it should be"),
    (features(href="a\0.laz"), r"names 'a\\x00\.laz'"),
    (features(**{"pc:count": 10}).replace("10", "1" * 5000), "cannot be decoded"), ("\xff\xfe", "cannot be decoded"),
    ('{"features": ' + "[" * 100_000 + "]" * 100_000 + "}", "cannot be decoded: maximum recursion"),
    ('{"features": [{"a": ' * 50_000, "cannot be decoded: maximum recursion"),
])  # fmt: skip
def test_damaged_virtual_point_clouds(tmp_path, content, words):
    (tmp_path / "a.vpc").write_bytes(content.encode("latin-1"))
    with pytest.raises(jf.InputError, match=rf"a\.vpc.*{words}"):
        jf.open(tmp_path / "a.vpc")


def spelled(code, kind="WKT1_GDAL", **changes):
    """The WKT of a CRS without the codes in it, with other words."""
    text = re.sub(r',AUTHORITY\["[^"]*","[^"]*"\]', "", pyproj.CRS.from_epsg(code).to_wkt(kind))
    for old, new in changes.items():
        text = re.sub(old, new, text)
    return text


COMPOUND = pyproj.CRS.from_epsg(7415)
LAMBERT = {"Reseau_Geodesique_Francais_1993_v1": "Not_specified", "RGF93 v1 / Lambert-93": "ours"}


@pytest.mark.parametrize("texts, one", [
    ([spelled(2154, Reseau_Geodesique_Francais_1993_v1="Reseau Geodesique Francais 1993"), pyproj.CRS(2154).to_wkt()], True),
    ([spelled(2154, **LAMBERT, **{"298.257222101": "298.2572221"}), spelled(2154), spelled(2154, "WKT1_ESRI")], True),
    ([spelled(2154, **LAMBERT, **{"46.5": "46.5000000000001"}), spelled(2154, "WKT1_ESRI")], True),
    ([spelled(31466), pyproj.CRS(31466).to_wkt()], True),
    ([COMPOUND.to_wkt(), COMPOUND.sub_crs_list[0].to_wkt(), pyproj.CRS.from_epsg(28992).to_wkt("WKT1_GDAL")], True),
    ([spelled(2154, **LAMBERT, **{"46.5": "46.6"}), spelled(2154)], False),
    ([spelled(2154, **LAMBERT, **{"298.257222101": "298.257223563"}), spelled(2154)], False),
    ([spelled(2154, **LAMBERT), spelled(3942), spelled(2154)], False),
    ([spelled(26910), spelled(6339)], False),  # NAD83 and NAD83(2011), which differ by a metre
    ([spelled(32632), spelled(25832)], False),
])  # fmt: skip
def test_files_of_one_crs_in_any_order_and_spelling(texts, one):
    for order in itertools.permutations(texts):
        files = Collection([tile(str(k), 10.0 * k, 0.0, wkt=text) for k, text in enumerate(order)])
        assert (files.check().mixed is None) == one
        assert order[0] != COMPOUND.to_wkt() or files.crs == COMPOUND


@pytest.mark.parametrize("base", ["", "memory://all"])
@pytest.mark.parametrize("href", [
    "reference://a.laz::file:///r.json", "./a.laz::s3://b", "reference://a.laz", "zip://a.laz", "ssh://x/a.laz",
])  # fmt: skip
def test_virtual_point_clouds_name_plain_files_only(tmp_path, monkeypatch, base, href):
    """A reference is a file that says what is done to reach another; so nothing of the name may get to fsspec."""
    import fsspec

    written = write_items(tmp_path / "a.vpc", [an_item(), an_item(href, **{"pc:count": None})])
    if base:
        fsspec.filesystem("memory").put_file(str(written), "/all/a.vpc")
    url_to_fs, asked = fsspec.core.url_to_fs, []
    monkeypatch.setattr(fsspec.core, "url_to_fs", lambda uri: asked.append(uri) or url_to_fs(uri))
    with pytest.raises(jf.InputError, match=rf"a\.vpc: names {href!r}.*file, s3, gs, az, abfs, http, https"):
        jf.open(f"{base}/a.vpc" if base else written)
    assert set(asked) <= {"memory://all/a.vpc"}


def test_the_map_of_a_survey():
    survey = Collection(
        [tile("a.laz"), tile("b.laz", 100, 0, count=40), tile("c.laz", 150, 50), tile("d.laz", count=0)]
    )
    ax = survey.plot()
    drawn = ax.collections[0]
    assert len(drawn.get_paths()) == 4 and len(ax.patches) == 2  # overlaps: a with d, b with c
    np.testing.assert_allclose(drawn.get_array()[:2], [0.001, 0.004])
    ax.figure.canvas.draw()
    np.testing.assert_allclose(drawn.get_facecolor()[1], drawn.cmap(1.0))


def test_the_command(folder):
    result = done("info", folder)
    assert "4 files, 620 points" in result.stdout and "files without points: 1 (" in result.stdout
    for row in jf.open(folder).table().itertuples():  # a line for each, nothing cut
        spans = [f"{low:.2f} to {high:.2f} " for low, high in ((row.xmin, row.xmax), (row.ymin, row.ymax))]
        line = next(line for line in result.stdout.splitlines() if os.path.basename(row.uri) in line)
        assert all(span in line for span in spans) and (not isinstance(row.crs, str) or row.crs in line), line
    said = facts("info", folder / "*.laz")
    assert said["files"] == 3 and said["points"] == 520 and [m["points"] for m in said["members"]] == [120, 400, 0]
    assert len(said["findings"]["empty"]) == 1
    quiet = run("info", folder, "--vpc", folder / "all.vpc", "--map", folder / "map.png", "--quiet")
    assert "a.LAS" in quiet.stdout and "note" not in quiet.stderr, "the table is what the command is for"
    assert (folder / "map.png").read_bytes().startswith(b"\x89PNG")
    said = facts("info", folder / "all.vpc")
    assert said["points"] == 620 and said["crs"] is None and "reproject one" in said["findings"]["mixed"]
    said = facts("info", folder / "b.laz", folder / "below")
    assert said["files"] == 2 and said["crs"] == "WGS 84 / UTM zone 32N" and said["units"] == "metre"
    for arguments, code, words in (
        ([folder / "absent"], 2, "there is no such file or folder"),
        ([folder / "none*"], 1, "matches no .las or .laz file"),
        ([folder, "--vpc", folder / "all.vpc"], 2, "exists"),
        ([folder, "--vpc", folder / "all.json"], 2, "suffix"),
    ):
        result = run("info", *arguments)
        assert result.exit_code == code and words in result.stderr, result.output
