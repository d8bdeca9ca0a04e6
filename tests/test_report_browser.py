"""The report in a browser: Chromium without a screen. Skipped where there is none."""

from __future__ import annotations

import dataclasses
import os
import shutil

import numpy as np
import pytest

import jaxfilter as jf
from jaxfilter.files.classes import class_name

playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright, see the extra dev")
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
READY = "report.state.ready || report.state.failed"


@pytest.fixture(scope="module")
def browser():
    """Without WebGL and GPU, and without any network."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium")
    flags = ["--disable-gpu", "--disable-3d-apis", "--host-resolver-rules=MAP * ~NOTFOUND"]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        flags.append("--no-sandbox")
    with playwright.sync_playwright() as driver:
        one = driver.chromium.launch(executable_path=found, args=flags)
        yield one
        one.close()


@pytest.fixture(scope="module")
def cloud(town):
    return dataclasses.replace(town.cloud, classification=town.classes, reference=town.truth)


@pytest.fixture(scope="module")
def path(cloud, tmp_path_factory):
    return jf.report(cloud, jf.CSF()(cloud), tmp_path_factory.mktemp("report") / "page.html", reference=cloud)


@pytest.fixture
def opened(browser, path):
    """The page, loaded; afterwards the console is clean and nothing but the file was asked for."""
    yield from open_page(browser, path, {"width": 1200, "height": 900})


def open_page(browser, path, viewport, **options):
    page = browser.new_page(viewport=viewport, **options)
    faults, asked = [], []
    page.on("console", lambda message: faults.append(message.text) if message.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(path.as_uri())
    page.wait_for_function(READY)
    assert page.evaluate("report.state.failed") is None
    yield page
    assert faults == []
    assert [url for url in asked if not url.startswith("data:")] == [path.as_uri()]
    page.close()


def figure(page, name):
    return page.inner_text(f"#card-{name}")


def slide(page, k):
    page.evaluate(
        "k => { const s = document.getElementById('slider'); s.value = k; s.dispatchEvent(new Event('input')); }", k
    )


def colours(page, canvas):
    """How many different colours a canvas shows."""
    return page.evaluate(
        """id => { const c = document.getElementById(id);
        return new Set(new Uint32Array(c.getContext('2d').getImageData(0, 0, c.width, c.height).data.buffer)).size; }""",
        canvas,
    )


def test_the_slider_shows_the_counts_that_the_library_gives_for_the_value(opened, cloud):
    values = opened.evaluate("report.facts.values")
    assert colours(opened, "base") > 20 and colours(opened, "over") >= 3
    for k in (5, 28):
        before = opened.evaluate("document.getElementById('over').toDataURL()")
        slide(opened, k)
        result = jf.CSF(threshold=values[k])(cloud)
        assert figure(opened, "ground") == f"{int(result.ground.sum()):,}"
        scores = jf.evaluate(result, cloud)
        assert figure(opened, "total") == f"{scores.total:.2f} %" and figure(opened, "kappa") == f"{scores.kappa:.2f} %"
        moved = [
            f"{class_name(old)}|{'kept' if old == new else class_name(new)}|{n:,}"
            for (old, new), n in jf.class_changes(cloud, result).items()
        ]
        rows = opened.locator("#classes tbody tr").all()
        assert sorted("|".join(row.locator("th,td").all_inner_texts()) for row in rows) == sorted(moved)
        assert opened.inner_text("#slider-value") == f"{values[k]:g} m"
        assert opened.evaluate("document.getElementById('over').toDataURL()") != before
    opened.click("#slider-reset")
    assert figure(opened, "ground") == f"{int(jf.CSF()(cloud).ground.sum()):,}"


def test_labels_of_drawn_points_are_those_of_the_library(opened, cloud):
    slide(opened, 12)
    result = jf.CSF(threshold=opened.evaluate("report.facts.values")[12])(cloud)
    assert opened.input_value("#points") == "errors"  # with a reference, the page opens on what is wrong
    opened.select_option("#points", "labels")
    kinds = np.array(opened.evaluate("[...report.state.kinds]"))
    assert (kinds == 0).sum() == result.ground.sum() and (kinds == 2).sum() == (~cloud.candidate).sum()
    opened.select_option("#points", "errors")
    kinds = np.array(opened.evaluate("[...report.state.kinds]"))
    assert (kinds == 3).sum() == (cloud.reference & ~result.ground).sum()
    assert (kinds == 4).sum() == (~cloud.reference & result.ground).sum()
    opened.select_option("#points", "changes")
    kinds, run = np.array(opened.evaluate("[...report.state.kinds]")), jf.CSF()(cloud)
    assert (kinds == 5).sum() == (result.ground & ~run.ground).sum()
    assert (kinds == 6).sum() == (run.ground & ~result.ground).sum()


def test_two_clicks_make_a_profile_of_the_points_of_a_band(opened, cloud):
    opened.locator("#map").scroll_into_view_if_needed()
    box = opened.locator("#map").bounding_box()
    assert not opened.is_visible("#profile")
    for share in (0.35, 0.65):
        opened.mouse.click(box["x"] + share * box["width"], box["y"] + 0.5 * box["height"])
    assert opened.is_visible("#profile") and colours(opened, "profile") > 3
    a, b = np.array(opened.evaluate("report.state.line"))
    along = (b - a) / np.linalg.norm(b - a)
    offset = cloud.xyz[:, :2] - a
    s, side = offset @ along, offset @ np.array([-along[1], along[0]])
    for width in (2.0, 7.0):
        opened.fill("#width", str(width))
        inside = ((s >= 0) & (s <= np.linalg.norm(b - a)) & (np.abs(side) <= width / 2)).sum()
        found = opened.evaluate("report.state.band.index.length")
        assert abs(found - inside) <= 3  # on the edge, coordinates are quantised
        assert f"{found:,} points" in opened.inner_text("#profile-count") and found > 20


def test_maps_and_places_can_be_chosen(opened):
    seen = {opened.evaluate("document.getElementById('base').toDataURL()")}
    for layer in ("height", "elevation", "doubt", "errors"):
        opened.select_option("#layer", layer)
        opened.wait_for_timeout(60)
        seen.add(opened.evaluate("document.getElementById('base').toDataURL()"))
    assert len(seen) == 5
    opened.click("#places button")
    assert opened.is_visible("#profile") and opened.evaluate("report.state.view.scale") > 5


def test_everything_can_be_done_with_the_keyboard(opened):
    opened.focus("#slider")
    before = figure(opened, "ground")
    opened.keyboard.press("ArrowLeft")
    assert figure(opened, "ground") != before
    opened.focus("#map")
    opened.keyboard.press("Enter")
    for _ in range(6):
        opened.keyboard.press("ArrowRight")
    assert "ground" in opened.inner_text("#readout")
    opened.keyboard.press("Enter")
    assert opened.is_visible("#profile")
    scale = opened.evaluate("report.state.view.scale")
    opened.keyboard.press("+")
    assert opened.evaluate("report.state.view.scale") > scale
    opened.keyboard.press("Escape")
    assert not opened.is_visible("#profile")


def test_dragging_moves_the_map_and_the_wheel_zooms_at_the_pointer(opened):
    opened.locator("#map").scroll_into_view_if_needed()
    box = opened.locator("#map").bounding_box()
    x, y = box["x"] + 0.4 * box["width"], box["y"] + 0.4 * box["height"]
    view = opened.evaluate("({...report.state.view})")
    opened.mouse.move(x, y)
    opened.mouse.down()
    opened.mouse.move(x + 50, y + 20, steps=3)
    opened.mouse.up()
    moved = opened.evaluate("({...report.state.view})")
    assert moved["x"] == pytest.approx(view["x"] - 50 / view["scale"])
    assert moved["y"] == pytest.approx(view["y"] + 20 / view["scale"])
    assert opened.evaluate("report.state.line") == []
    place = """([x, y]) => { const v = report.state.view, m = document.getElementById('map');
        return [v.x + (x - m.clientWidth / 2) / v.scale, v.y - (y - m.clientHeight / 2) / v.scale]; }"""
    under = opened.evaluate(place, [x + 50 - box["x"], y + 20 - box["y"]])
    opened.mouse.wheel(0, -400)
    opened.wait_for_function(f"report.state.view.scale > {1.2 * view['scale']}")
    assert opened.evaluate(place, [x + 50 - box["x"], y + 20 - box["y"]]) == pytest.approx(
        under, abs=1 / view["scale"]
    )  # a pixel


def test_a_phone_shows_it_without_scrolling_sideways(browser, path):
    for page in open_page(browser, path, {"width": 375, "height": 700}, device_scale_factor=2, has_touch=True):
        assert page.evaluate("document.documentElement.scrollWidth") <= 375
        page.locator("#map").scroll_into_view_if_needed()
        box = page.locator("#map").bounding_box()
        for share in (0.4, 0.6):
            page.touchscreen.tap(box["x"] + share * box["width"], box["y"] + 0.5 * box["height"])
        assert page.is_visible("#profile")
        for cell in page.locator(".parameters td:last-child").all()[:3]:  # what a parameter means has a line of its own
            assert cell.bounding_box()["width"] > 300
        assert "Click twice" in page.inner_text("#map-section")


@pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
def test_pages_without_a_map_have_their_tables_and_no_errors(browser, tmp_path):
    empty = jf.PointCloud.from_arrays(np.zeros((0, 3)))
    path = jf.report(empty, jf.SMRF()(empty), tmp_path / "empty.html")
    page = browser.new_page()
    faults = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto(path.as_uri())
    assert figure(page, "ground") == "0" and not page.is_visible("#map") and faults == []
    assert "no points" in page.inner_text("main")
    page.close()


def test_an_old_browser_is_told_and_keeps_slider_and_tables(browser, path):
    page = browser.new_page()
    page.add_init_script("delete window.DecompressionStream")
    page.goto(path.as_uri())
    page.wait_for_function(READY)
    assert page.is_visible("#problem") and not page.is_visible("#map")
    before = figure(page, "ground")
    slide(page, 3)
    assert figure(page, "ground") != before and page.locator("#classes tbody tr").count() > 1
    page.close()
