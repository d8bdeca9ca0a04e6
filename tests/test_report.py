"""The report: labels at every step, counts, maps and the file. What a browser makes of it: test_report_browser.py."""

from __future__ import annotations

import base64
import dataclasses
import json
import re
import zlib
from html.parser import HTMLParser

import laspy
import numpy as np
import pytest
from commands import done, facts, run
from scipy.spatial import cKDTree

import jaxfilter as jf
from jaxfilter.core.grid import Grid
from jaxfilter.reports.steps import step_values, swept_field


@pytest.fixture(scope="module")
def cloud(town):
    """With classes as delivered (6 = building) and the truth as the reference."""
    return dataclasses.replace(town.cloud, classification=town.classes, reference=town.truth)


@pytest.fixture(scope="module")
def result(cloud):
    return jf.SMRF()(cloud)


def facts_of(path):
    return json.loads(re.search(r'id="facts">(.*?)</script>', path.read_text(), re.DOTALL)[1])


def array_of(path, name):
    """An array of the page, unpacked without the page's own code."""
    found = re.search(rf'id="data-{name}" data-bytes="(\d)">([^<]*)<', path.read_text())
    width = int(found[1])
    planes = np.frombuffer(zlib.decompress(base64.b64decode(found[2])), np.uint8).reshape(width, -1)
    joined = sum(plane.astype(np.int64) << 8 * i for i, plane in enumerate(planes))
    return np.cumsum(joined) % 256**width


# ---- labels at every step ----


def test_without_a_slider_the_labels_are_the_result(cloud, result, tmp_path):
    by_hand = dataclasses.replace(result, run=None)
    changed = dataclasses.replace(result, ground=~result.ground)
    free = dataclasses.replace(result, run=dataclasses.replace(result.run, filter=jf.SMRF(threshold=np.inf)))
    for one, count, reason in (
        (result, 0, "fewer than three steps were asked for"),
        (result, 2, "fewer than three steps were asked for"),
        (by_hand, None, "the filter is not known"),
        (changed, None, "the filter by itself gives other labels"),
        (free, None, "no threshold has a range"),
        (jf.FilterResult.of_labels(result.ground), None, "the filter is not known"),
    ):
        options = jf.ReportOptions(steps=count)
        page = jf.report(cloud, one, tmp_path / "page.html", options=options, overwrite=True)
        assert reason in Page(page.read_text()).text
        assert facts_of(page)["ground"] == [one.ground.sum()]


def test_large_clouds_and_labels_that_do_not_nest_have_no_slider(cloud, tmp_path, monkeypatch):
    monkeypatch.setattr("jaxfilter.reports.steps._WORK", 2 * len(cloud))
    page = Page(jf.report(cloud, jf.MSF()(cloud), tmp_path / "a.html").read_text())
    assert "each step would be a classification" in page.text
    monkeypatch.setattr("jaxfilter.reports.steps.passed", lambda one, labels: np.abs(labels.height) > one.threshold)
    page = Page(jf.report(cloud, jf.CSF()(cloud), tmp_path / "b.html").read_text())
    assert "not so at all larger ones" in page.text


@pytest.mark.parametrize("name", list(jf.FILTERS))
def test_every_method_has_values_to_slide_over_that_it_takes(name):
    filter_ = jf.FILTERS[name]()
    field = swept_field(filter_)
    for count in (3, 9, 49):
        values = step_values(filter_, field, count)
        assert count - 2 <= len(values) <= count and getattr(filter_, field) in values
        assert all(filter_.replace(**{field: value}) for value in values)


# ---- counts ----


@pytest.mark.parametrize(
    "filter_, count, tested",
    [
        (jf.SMRF(), None, (0, 11, 29)),
        (jf.SMRF(threshold=0.0, scaling=0.7), None, (0, 20)),
        (jf.CSF(), None, (0, 12, 30)),
        (jf.PPDF(), None, (0, 30)),
        (jf.FPTD(), 3, (0, 2)),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, jf.Filter) else None,
)
def test_counts_classes_and_scores_of_every_step_are_those_of_the_library(cloud, tmp_path, filter_, count, tested):
    reference = np.where(np.arange(len(cloud)) % 7 == 0, -1, cloud.reference).astype(np.int8)
    options = jf.ReportOptions(steps=count)
    facts = facts_of(jf.report(cloud, filter_(cloud), tmp_path / "a.html", reference=reference, options=options))
    field, values = facts["threshold"]["name"], facts["values"]
    units = {one.name: one.metadata.get("unit") for one in dataclasses.fields(filter_)}
    assert field == swept_field(filter_) and facts["threshold"]["unit"] == units[field]
    assert len(values) >= (count or 25) and values == sorted(set(values))
    assert values[facts["step"]] == pytest.approx(getattr(filter_, field))
    for k in {*tested, facts["step"]}:
        ground = filter_.replace(**{field: values[k]})(cloud).ground
        assert facts["ground"][k] == ground.sum()
        moved = {(old, new): points[k] for old, new, points in facts["classes"] if points[k]}
        assert moved == jf.class_changes(cloud, ground)
        scores = jf.evaluate(ground, reference)
        assert facts["confusion"][k] == scores.confusion.tolist()
        for name in ("type1", "type2", "total", "kappa"):
            assert facts["scores"][name][k] == pytest.approx(getattr(scores, name), nan_ok=True)


def test_points_are_a_sample_of_the_cloud_with_their_labels(cloud, result, tmp_path):
    reference = np.where(cloud.classification == 6, -1, cloud.reference).astype(np.int8)
    path = jf.report(
        cloud, result, tmp_path / "page.html", reference=reference, options=jf.ReportOptions(max_points=2000)
    )
    sample, step = facts_of(path)["sample"], np.array(facts_of(path)["sample"]["step"])
    assert (sample["number"], sample["of"]) == (2000, len(cloud))
    xyz = np.column_stack([array_of(path, axis) for axis in "xyz"]) * step + sample["low"]
    distance, row = cKDTree(cloud.xyz).query(xyz)
    assert distance.max() <= np.linalg.norm(step) / 2 + 1e-3 and step.max() < 0.005
    assert len(np.unique(row)) > 1900  # some stand on others
    flags = array_of(path, "flags")
    alike = (array_of(path, "code") <= facts_of(path)["step"]) == result.ground[row]
    assert alike.mean() > 0.99 and ((flags & 1 > 0) == cloud.candidate[row]).mean() > 0.99
    assert ((flags & 6) == np.array([4, 6, 0])[reference[row]]).mean() > 0.99 and len(np.unique(flags & 6)) == 3


# ---- maps ----


def test_maps_hold_heights_errors_and_doubt_of_their_cells(cloud, result, tmp_path):
    truth, how = cloud.reference, {"reference": cloud, "options": jf.ReportOptions(steps=0)}
    path = jf.report(cloud, result, tmp_path / "margin.html", **how)
    page, grid = facts_of(path), Grid(**facts_of(path)["grid"])

    def cells(name, path=path):
        return array_of(path, name).reshape(grid.shape)[::-1].ravel()[grid.flat(cloud.xyz)]

    assert 0.5 * len(cloud) < grid.nx * grid.ny < 2 * len(cloud)
    above = cloud.xyz[:, 2] - page["elevation"]["low"] - cells("elevation") * page["elevation"]["step"]
    highest = np.full(grid.nx * grid.ny, 0.0)
    np.maximum.at(highest, grid.flat(cloud.xyz), above)
    expected = highest[grid.flat(cloud.xyz)]
    np.testing.assert_allclose(cells("height") / 100, expected, atol=0.006 + page["elevation"]["step"])
    for bit, wrong in ((1, truth & ~result.ground), (2, result.ground & ~truth)):
        assert set(grid.flat(cloud.xyz)[wrong]) == set(grid.flat(cloud.xyz)[(cells("errors") & bit) > 0])
    passed = np.flatnonzero(result.decision == jf.Decision.ACCEPTED)
    nearest = passed[np.abs(result.margin[passed]).argmin()]
    assert page["doubt_of"] == "margin" and cells("doubt")[nearest] == 100, "largest at the threshold"
    own = np.linspace(0, 0.5, len(cloud), dtype=np.float32)
    path = jf.report(cloud, dataclasses.replace(result, doubt=own), tmp_path / "own.html", **how)
    assert facts_of(path)["doubt_of"] == "probability" and cells("doubt", path)[-1] == 50, "as it is"


def test_places_to_look_at_are_where_errors_are(cloud, result, tmp_path):
    wrong = result.ground.copy()
    corner = (cloud.xyz[:, 0] > 65) & (cloud.xyz[:, 1] > 55)
    wrong[corner] = ~cloud.reference[corner]
    found = facts_of(jf.report(cloud, wrong, tmp_path / "a.html", reference=cloud))["places"]
    assert found[0]["what"] == "errors" and found[0]["x"] > 60 and found[0]["y"] > 50
    listed, table = facts_of(jf.report(cloud, result, tmp_path / "b.html"))["places"], jf.review(cloud, result)
    assert [one["what"] for one in listed] == table["reason"].tolist()[:12]
    assert [one["x"] for one in listed] == pytest.approx((table["x"] - cloud.origin[0]).tolist()[:12])


# ---- the file ----


class Page(HTMLParser):
    """What stands open at the end, what is loaded from elsewhere, and ids."""

    VOID = ("meta", "link", "input", "br")

    def __init__(self, text):
        super().__init__()
        self.open, self.links, self.ids, self.text = [], [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.links += [given[key] for key in ("src", "href") if key in given]
        self.ids += [given["id"]] if "id" in given else []
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.text += data


def test_the_page_is_whole_and_loads_nothing(cloud, result, tmp_path):
    title = 'Tile <7> & "west"'
    path = jf.report(cloud, result, tmp_path / "page.html", reference=cloud, options=jf.ReportOptions(title=title))
    page, words = Page(path.read_text()), ("pingel2013improved", "ground is at most this far from level terrain")
    assert page.open == [] and page.links == ["data:,"] and len(page.ids) == len(set(page.ids))
    assert all(one in page.text for one in (title, *words, f"{len(cloud):,}", jf.__version__))
    assert not re.search(r"https?://|@import|url\(", re.sub(r"<pre>.*?</pre>", "", path.read_text(), flags=re.DOTALL))


def test_the_same_result_gives_the_same_bytes(cloud, result, tmp_path):
    pages = [jf.report(cloud, result, tmp_path / f"{i}.html").read_bytes() for i in range(2)]
    assert pages[0] == pages[1]


NOTHING = np.zeros((0, 3))
STRIP = np.column_stack([np.arange(40) * 0.5, np.zeros(40), np.sin(np.arange(40))])


@pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
@pytest.mark.parametrize(
    "xyz, ground, words",
    [
        (NOTHING, None, "The cloud has no points"),
        (STRIP, None, "fewer than four distinct positions"),
        (np.repeat(STRIP, 3, axis=0) + np.tile(np.arange(3)[:, None], (40, 3)), "none", "No point is ground"),
        (np.full((5, 3), np.nan), None, "No point has valid coordinates"),
        (np.vstack([np.random.default_rng(1).random((300, 3)) * 20, [[np.nan] * 3]]), None, "There is no slider"),
    ],
    ids=["no points", "a line", "no ground", "nothing valid", "one invalid"],
)
def test_what_there_is_of_odd_clouds_is_shown(tmp_path, xyz, ground, words):
    cloud = jf.PointCloud.from_arrays(xyz, drop_invalid=True)
    result = jf.FPTD()(cloud)
    if ground == "none":
        result = dataclasses.replace(result, ground=np.zeros(len(cloud), bool))
    if words == "There is no slider":
        result = result.ground
    path = jf.report(cloud, result, tmp_path / "page.html")
    page = Page(path.read_text())
    assert words in page.text and page.open == []
    facts = facts_of(path)
    assert facts["points"] == len(xyz) and ("grid" in facts) == (np.isfinite(xyz).any() and len(xyz) > 0)


def test_heights_that_are_not_known_are_left_out(cloud, result, tmp_path):
    unknown = np.full(len(cloud), np.nan, np.float32)
    blind = dataclasses.replace(result, height=unknown, margin=unknown)
    path = jf.report(cloud, blind, tmp_path / "page.html")
    assert 'id="data-doubt"' not in path.read_text() and 'id="data-height"' in path.read_text()


def test_what_cannot_be_written_is_said_and_leaves_nothing(cloud, result, tmp_path):
    (tmp_path / "page.html").write_text("mine")
    three = np.ones(3, bool)
    for labels, name, how, error, words in (
        (result, "page.pdf", {}, jf.OutputError, r"page\.pdf: the suffix must be one of \.html, \.htm"),
        (result, "no/page.html", {}, jf.OutputError, "cannot be written"),
        (result, "page.html", {}, jf.OutputError, "exists"),
        (result, "other.html", {"reference": three}, jf.InputError, "reference has 3 labels"),
        (three, "other.html", {}, jf.InputError, r"result: bool\[\d+\]"),
    ):
        with pytest.raises(error, match=words):
            jf.report(cloud, labels, tmp_path / name, **how)
    with pytest.raises(jf.ParameterError, match=r"steps=-1"):
        jf.ReportOptions(steps=-1)
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"page.html": "mine"}


def test_progress_goes_from_none_to_all(cloud, result, tmp_path):
    seen = []
    jf.report(cloud, result, tmp_path / "page.html", progress=lambda done, step: seen.append((done, step)))
    shares = [done for done, _ in seen]
    assert shares == sorted(shares) and shares[0] == 0 and shares[-1] == 1
    assert {"slider", "maps", "points", "page"} <= {step for _, step in seen}


# ---- the command ----


def test_the_command_filters_or_takes_the_classes(cloud, tmp_path):
    file = jf.write(tmp_path / "town.laz", cloud, np.zeros(len(cloud), bool), reset="none")
    how = ("--filter", "smrf", "--set", "threshold=0.4", "--reference", "own")
    said, page = facts("report", file, tmp_path / "a.html", *how), facts_of(tmp_path / "a.html")
    cloud = jf.read(file, units="m")
    expected = jf.SMRF(threshold=0.4)(cloud)
    assert said["ground"] == page["ground"][page["step"]] == expected.ground.sum()
    assert page["confusion"][page["step"]] == jf.evaluate(expected, cloud).confusion.tolist()
    las = laspy.read(file)
    las.points = las.points[np.arange(len(las))[::-1]]
    las.write(tmp_path / "turned.laz")
    how = ("--reference", tmp_path / "turned.laz", "--title", "As delivered")
    assert "points are ground" in done("report", file, tmp_path / "b.html", *how).stdout
    delivered = facts_of(tmp_path / "b.html")
    assert delivered["ground"] == [int((cloud.classification == 2).sum())]
    assert delivered["scores"]["total"] == [0.0]


@pytest.mark.parametrize("arguments, words", [
    (("page.pdf",), "suffix"),
    (("page.html", "--filter", "no"), "no method 'no'"),
    (("page.html", "--filter", "smrf", "--set", "slope=-1"), "slope"),
    (("page.html", "--set", "slope=1"), "--filter"),
    (("page.html", "--reference", "own"), "--filter"),
    (("page.html", "--reference", "nowhere.laz"), "no such file"),
    (("no/page.html",), "not a folder"),
])  # fmt: skip
def test_wrong_usage_is_found_before_reading(tmp_path, arguments, words):
    (tmp_path / "broken.laz").write_bytes(b"")
    wrong = run("report", tmp_path / "broken.laz", tmp_path / arguments[0], *arguments[1:])
    assert wrong.exit_code == 2 and words in wrong.stderr, wrong.output
