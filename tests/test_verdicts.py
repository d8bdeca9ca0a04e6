"""What people have decided at places: labels in memory and in files, what cannot be carried out, and runs that are stopped."""

from __future__ import annotations

import dataclasses
import json
import shutil

import geopandas
import laspy
import numpy as np
import pyproj
import pytest
import shapely
from commands import done, facts, run

import jaxfilter as jf
from jaxfilter.core.result import Call
from jaxfilter.files.vectors import write_features
from jaxfilter.reviews.verdicts import HALO, PLACE_RIM, read_verdicts, sites_of
from jaxfilter.surveys.measures import Recipe, Sampler
from jaxfilter.surveys.plan import where_of

pytestmark = pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
UTM, TM = (pyproj.CRS(one) for one in (25832, "+proj=tmerc +lon_0=9 +x_0=500000 +datum=WGS84 +units=m"))
WIDE, HIGH = 160.0, 120.0
ONE = jf.RunOptions(workers=1)


@pytest.fixture(scope="module")
def scene():
    """A plain of half-metre points with a hill, a house, a bridge over a level river, and stakes in it. Elevation is 50 m."""
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0, WIDE, 0.8) + 0.2, np.arange(0, HIGH, 0.8) + 0.3))
    rng = np.random.default_rng(1)
    z = 50 + rng.normal(0, 0.02, x.size)
    z += 6 * np.exp(-((x - 40) ** 2 + (y - 90) ** 2) / 2 / 6**2)  # too steep for a filter that is told of small slopes
    z += np.where(within(x, y, HOUSE), 5.0, 0.0)
    z -= np.where(within(x, y, RIVER), 2.0, 0.0)
    z += np.where(within(x, y, BRIDGE), 5.0, 0.0)
    stake = within(x, y, RIVER) & ~within(x, y, BRIDGE) & (rng.random(x.size) < 0.1)
    z += np.where(stake, rng.uniform(0.6, 3, x.size), 0.0)
    return np.column_stack([x + 500_000, y + 5_400_000, z]).round(3), stake


def box(x0, y0, x1, y1):
    return shapely.box(500_000 + x0, 5_400_000 + y0, 500_000 + x1, 5_400_000 + y1)


HOUSE, HILL, RIVER, BRIDGE = (100, 80, 120, 100), (25, 75, 55, 105), (50, 0, 74, 50), (50, 20, 74, 30)


def within(x, y, limits):
    x0, y0, x1, y1 = limits
    return (x >= x0) & (x < x1) & (y >= y0) & (y < y1)


def inside(xyz, *limits, by=0.0):
    x0, y0, x1, y1 = limits
    return within(xyz[:, 0] - 500_000, xyz[:, 1] - 5_400_000, (x0 - by, y0 - by, x1 + by, y1 + by))


def table(*boxes, **places):
    """Verdicts by name of a place, or on other boxes."""
    shapes = {"house": box(*HOUSE), "hill": box(*HILL), "river": box(*RIVER) - box(*BRIDGE), "bridge": box(*BRIDGE)}
    found = [box(*one) for one in boxes] or [shapes.get(k.rstrip("_")) for k in places]
    return geopandas.GeoDataFrame({"verdict": list(places.values())}, geometry=found, crs=UTM)


def labelled(xyz, ground):
    """A result with these labels."""
    run = Call(jf.OST(spacing=0.8), jf.PointCloud.from_arrays(xyz, crs=UTM), seconds=0.0)
    return dataclasses.replace(jf.FilterResult.of_labels(ground), run=run)


@pytest.fixture(scope="module")
def xyz(scene):
    return scene[0]


@pytest.fixture(scope="module")
def wrong(xyz):
    """Labels with the hill as an object, and all else, roof, deck and stakes, as ground."""
    return ~(inside(xyz, *HILL) & (xyz[:, 2] > 50.3))


@pytest.mark.parametrize("word", ["object", "bridge"])
def test_an_object_is_no_ground_and_its_rim_is_judged_again(xyz, wrong, word):
    made = jf.apply(labelled(xyz, wrong), table(house=word))
    house, near = inside(xyz, *HOUSE), inside(xyz, *HOUSE, by=PLACE_RIM)
    assert not made.ground[house].any() and made.ground[near & ~house].all()
    np.testing.assert_array_equal(made.ground[~near], wrong[~near])
    np.testing.assert_array_equal(made.deck, house & (word == "bridge"))
    assert (made.decision[house] == jf.Decision.SURFACE).all()


def test_false_ground_beside_an_object_goes_with_it(xyz, wrong):
    """The place is smaller than the house: the roof goes on in the rim, and there it does not pass again."""
    x0, y0, x1, y1 = HOUSE
    made = jf.apply(labelled(xyz, wrong), table((x0 + 3, y0 + 3, x1 - 3, y1 - 3), house="object"))
    house = inside(xyz, *HOUSE)
    assert not made.ground[house].any() and made.ground[~house & wrong].all()


def test_an_object_takes_off_what_sticks_out_and_no_terrain(xyz):
    """A roof at the edge of the data goes, though no point lies beyond it; a smooth hill does not, whatever is said."""
    cut = inside(xyz, 110, 80, WIDE, HIGH)  # the house is at the western edge of this part
    part, roof = xyz[cut], inside(xyz[cut], 110, 80, HOUSE[2], HOUSE[3])
    made = jf.apply(labelled(part, np.ones(len(part), bool)), table((110, 78, 122, 102), roof="object"))
    assert not made.ground[roof].any() and made.ground[~roof].all()
    assert jf.apply(labelled(xyz, np.ones(len(xyz), bool)), table(hill="object")).ground.all()


def test_terrain_in_a_place_of_an_object_stays(xyz):
    """The place holds the edges of a terrace, which goes on beside it, and a house on top."""
    terrace, house = inside(xyz, 80, 70, WIDE, HIGH), inside(xyz, *HOUSE)
    z = xyz[:, 2] + 3.0 * terrace
    scene = np.column_stack([xyz[:, :2], z])
    made = jf.apply(labelled(scene, np.ones(len(xyz), bool)), table((70, 76, 124, 104), mixed="object"))
    assert not made.ground[house].any() and (~made.ground & ~house).sum() < 10  # 166 if the edges did not grow again


def test_ground_keeps_off_what_rises_more_steeply_than_terrain(xyz, wrong):
    """The place holds a shed: its ground is what lies around it."""
    shed, place = inside(xyz, 140, 20, 148, 28), inside(xyz, 134, 14, 154, 34)
    before = labelled(xyz + np.outer(shed, [0, 0, 5]), wrong & ~place)
    made = jf.apply(before, table((134, 14, 154, 34), shed="ground"))
    np.testing.assert_array_equal(made.ground[place], ~shed[place])


def test_ground_grows_from_the_lowest_points_of_a_place(xyz, wrong):
    hill = inside(xyz, *HILL)
    before = labelled(xyz, wrong)
    made = jf.apply(before, table(hill="ground"))
    assert wrong[hill].mean() < 0.75 and made.ground[hill].mean() > 0.95
    np.testing.assert_array_equal(made.ground[~hill], wrong[~hill])


def test_what_stands_in_water_is_no_ground(scene, wrong):
    xyz, stakes = scene
    made = jf.apply(labelled(xyz, wrong), table(river="water", bridge="bridge"))
    river = inside(xyz, *RIVER) & ~inside(xyz, *BRIDGE)
    np.testing.assert_array_equal(made.ground[river], ~stakes[river])
    np.testing.assert_array_equal(made.water, river & ~stakes)
    np.testing.assert_array_equal(made.deck, inside(xyz, *BRIDGE))


def test_fine_places_keep_their_labels_in_the_rim_of_others(xyz, wrong):
    x0, y0, x1, y1 = HOUSE
    places = table((x0, y0, x1 - 5, y1), (x1 - 5, y0, x1, y1), house="bridge", fine="fine")
    made = jf.apply(labelled(xyz, wrong), places)
    rest = inside(xyz, x1 - 4.9, y0, x1, y1)
    assert made.ground[rest].all() and not made.ground[inside(xyz, x0, y0, x1 - 5, y1)].any()


def test_order_of_points_and_of_places_does_not_count(xyz, wrong):
    order = np.random.default_rng(2).permutation(len(xyz))
    places = table(house="object", hill="ground", river="water")
    made = jf.apply(labelled(xyz, wrong), places)
    other = jf.apply(labelled(xyz[order], wrong[order]), places.iloc[::-1])
    np.testing.assert_array_equal(made.ground[order], other.ground)


@pytest.mark.parametrize("suffix, crs, words", [
    (".gpkg", TM, ()), (".geojson", TM, ("GeoJSON cannot state the CRS unknown",)),
    (".gpkg", None, ("has none: set",)), (".geojson", None, ("for degrees: set",)),
])  # fmt: skip
def test_places_are_read_back_in_a_crs_that_has_no_code_and_in_none(suffix, crs, words, tmp_path, recwarn):
    """GeoJSON cannot state such a CRS, and GDAL then takes coordinates for degrees."""
    places = geopandas.GeoDataFrame({"verdict": ["object"]}, geometry=[box(0, 0, 10, 10)], crs=crs)
    write_features(tmp_path / f"list{suffix}", [places], "review")
    (one,), problems = read_verdicts(tmp_path / f"list{suffix}", crs, box(0, 0, 100, 100).bounds)
    assert not problems and one.shape.bounds == box(0, 0, 10, 10).bounds
    said = [str(one.message) for one in recwarn if issubclass(one.category, jf.JaxfilterWarning)]
    assert len(said) == len(words) and all(f"list{suffix}" in text and words[0] in text for text in said)


def test_what_cannot_be_carried_out_is_named_and_the_rest_is_done(xyz, wrong):
    places = table(house="Object ", hill="ground", hill_="object", bridge="road", river=None)
    flat = shapely.Polygon([(500_010, 5_400_010), (500_020, 5_400_010), (500_015, 5_400_010)])
    for shape in (box(900, 900, 950, 950), flat):
        places.loc[len(places)] = ["object", shape]
    places.insert(0, "rank", [*range(1, 7), None])  # who draws a place gives it none
    with pytest.warns(jf.JaxfilterWarning) as caught:
        made = jf.apply(labelled(xyz, wrong), places)
    words = [str(one.message) for one in caught]
    assert len(words) == 4
    assert any("'road' is no verdict: choose one of ground" in one for one in words)
    assert any("place 6: lies outside of the data" in one for one in words)
    assert any("the place in row 7: is no polygon" in one for one in words)
    assert any("place 2 is ground and place 3, which overlaps it, object" in one for one in words)
    np.testing.assert_array_equal(made.ground, wrong & ~inside(xyz, *HOUSE))


def test_places_in_another_crs_are_transformed_and_that_is_said(xyz, wrong):
    places = table(house="object")
    with pytest.warns(jf.JaxfilterWarning, match="transformed from WGS 84 to ETRS89"):
        made = jf.apply(labelled(xyz, wrong), places.to_crs(4326))
    np.testing.assert_array_equal(made.ground, jf.apply(labelled(xyz, wrong), places).ground)


def test_a_result_that_was_put_together_by_hand_is_refused(wrong):
    with pytest.raises(jf.InputError, match="put together by hand"):
        jf.apply(jf.FilterResult.of_labels(wrong), table(house="object"))


def test_places_whose_rims_meet_are_a_site():
    boxes = (0, 0, 10, 10), (17, 0, 20, 10), (40, 0, 50, 10), (90, 0, 99, 9)
    places = table(*boxes, a="object", b="ground", c="water", d="fine")
    found = sites_of(read_verdicts(places, UTM, (5e5, 5.4e6, 6e5, 5.5e6))[0], 1.0)
    assert [len(site.verdicts) for site in found] == [2, 1], "where all is fine there is nothing to do"
    np.testing.assert_allclose(found[1].touched, box(40, 0, 50, 10).buffer(PLACE_RIM, join_style="mitre").bounds)
    np.testing.assert_allclose(found[1].window, box(40, 0, 50, 10).buffer(PLACE_RIM + HALO, join_style="mitre").bounds)


# files


@pytest.fixture
def survey(xyz, wrong, tmp_path):
    """Four files of the scene with wrong classes; every fifth point, in the house as well, is vegetation for somebody."""
    folder = tmp_path / "survey"
    folder.mkdir()
    classes = np.where(wrong, 2, 5).astype(np.uint8)
    classes[::37] = 20
    for name, x, y in (("sw", 0, 0), ("se", 80, 0), ("nw", 0, 60), ("ne", 80, 60)):
        rows = inside(xyz, x, y, x + 80, y + 60)
        las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
        las.header.add_crs(UTM)
        las.header.scales, las.header.offsets = np.full(3, 0.001), np.floor(xyz.min(axis=0))
        las.x, las.y, las.z = xyz[rows].T
        las.gps_time, las.classification = np.flatnonzero(rows).astype(float), classes[rows]
        las.write(folder / f"{name}.laz")
    return folder


def classes_of(folder, n):
    out = np.zeros(n, np.uint8)
    for path in sorted(folder.glob("*.laz")):
        las = laspy.read(path)
        out[las.gps_time.astype(int)] = las.classification
    return out


def states(folder):
    return {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in sorted(folder.glob("*.laz"))}


def test_only_files_with_changes_are_written_and_nothing_is_done_twice(survey, xyz, tmp_path):
    places = tmp_path / "places.gpkg"
    table(house="object", bridge="bridge", river="water").to_file(places, layer="review")
    before, old = states(survey), classes_of(survey, len(xyz))
    report = facts("apply", places, survey, "--bridge-class", "17")
    assert [path.rpartition("/")[2] for path in report["files"]] == ["ne.laz", "sw.laz"]
    after, new = states(survey), classes_of(survey, len(xyz))
    assert {name for name in after if after[name] != before[name]} == {"ne.laz", "sw.laz"}
    changed = old != new
    assert report["changed"] == changed.sum() and set(old[changed]) == {2} and set(new[changed]) == {1, 17}
    house, deck = inside(xyz, *HOUSE), inside(xyz, *BRIDGE)
    assert set(new[house]) == {1, 20} and set(new[deck]) == {17, 20}, "what somebody has edited is kept"
    assert not list(survey.glob(".*")), "nothing is left of the run"
    log = json.loads((survey / "verdicts.json").read_text())
    assert [one["verdict"] for one in log["verdicts"]] == ["object", "bridge", "water"]
    again = done("apply", places, survey).output
    assert "0 verdicts carried out (none), 3 earlier" in again and states(survey) == after


def test_files_have_the_labels_of_memory(survey, xyz, wrong, tmp_path):
    places = table(house="object", hill="ground", river="water")
    old = classes_of(survey, len(xyz))
    jf.apply_survey(places, survey, run=ONE)
    cloud = jf.PointCloud.from_arrays(xyz, crs=UTM, classification=old)
    like = dataclasses.replace(labelled(xyz, wrong & (old == 2)))
    files = jf.open(survey)
    filter_ = Sampler(files, jf.Reading(), where_of(files)).filter_for(Recipe())
    memory = jf.apply(dataclasses.replace(like, run=dataclasses.replace(like.run, cloud=cloud, filter=filter_)), places)
    np.testing.assert_array_equal(classes_of(survey, len(xyz)) == 2, memory.ground)


@pytest.mark.parametrize("tile", [None, pytest.param(60.0, marks=pytest.mark.slow)])
def test_the_limits_are_those_that_found_the_ground(survey, tmp_path, tile):
    run = jf.RunOptions(tile=tile, wide_halos=True, workers=1)
    made = jf.ground(survey, tmp_path / "made", jf.OST(window=9.0, max_angle=5.0), run=run)
    report = jf.apply_survey(table(house="object"), tmp_path / "made", run=ONE)
    spacing = made.measures["spacing"] if tile else None
    assert report.method == "OST" and report.parameters == made.parameters | {"spacing": spacing}
    jf.ground(survey, tmp_path / "other", jf.SMRF(window=9.0), run=ONE)
    other = jf.apply_survey(table(house="object"), tmp_path / "other", run=ONE)
    assert other.method == "OST" and other.parameters["max_angle"] == jf.OST().max_angle


def test_a_log_that_is_damaged_is_named(survey):
    jf.apply_survey(table(house="object"), survey)
    path, before = survey / "verdicts.json", states(survey)
    whole = path.read_text()
    for changes in (
        {"files": None}, {"files": 1e30}, {"files": [1]}, {"files": [["a"]]}, {"x": None}, {"x": "a"}, {"y": 10**400},
        {"verdict": 1}, {"key": []}, {"key": "[" * 100_000 + "]" * 100_000},
    ):  # fmt: skip
        log = json.loads(whole)
        log["verdicts"][0] |= changes
        path.write_text(json.dumps(log).replace('"[[', "[[").replace(']]"', "]]"))
        with pytest.raises(jf.InputError, match=r"verdicts\.json: is damaged"):
            jf.apply_survey(table(house="fine"), survey)
        assert states(survey) == before


@pytest.mark.parametrize(
    "text", ["[" * 100_000 + "]" * 100_000, '{"method": "OST", "parameters": {"spacing": 0}, "measures": [1]}']
)
def test_a_report_that_is_damaged_does_not_count(survey, text):
    (survey / "jaxfilter-run.json").write_text(text)
    assert jf.apply_survey(table(house="object"), survey).complete


def test_who_goes_back_to_a_verdict_gets_it_again(survey, xyz):
    """Another verdict on the same place was carried out in between."""
    for word in ("bridge", "ground", "bridge"):
        report = jf.apply_survey(table(house=word), survey, run=ONE)
        assert report.applied == {word: 1} and report.before == 0
        on_roof = (classes_of(survey, len(xyz))[inside(xyz, *HOUSE)] == 2).any()
        assert on_roof == (word == "ground")
        (known,) = json.loads((survey / "verdicts.json").read_text())["verdicts"]
        assert known["verdict"] == word


def test_verdicts_are_done_for_files_that_come_later(survey, xyz):
    """A place in two files, of which one is given first."""
    places = table((70, 20, 90, 30), deck="bridge")
    n = len(xyz)
    jf.apply_survey(places, survey / "sw.laz", run=ONE)
    deck, done = inside(xyz, 70, 20, 90, 30), classes_of(survey, n)
    assert (done[deck] == 2).any(), "the eastern part is in another file"
    for before, applied in enumerate(({"bridge": 1}, {})):
        report = jf.apply_survey(places, survey, run=ONE)
        assert (report.applied, report.before) == (applied, before)
        assert not (classes_of(survey, n)[deck] == 2).any()


def test_what_was_undone_stays_known_as_undone(survey, xyz, tmp_path, recwarn):
    """Another verdict on a changed file does not vouch for what was said of it before."""
    kept = shutil.copytree(survey, tmp_path / "kept")
    jf.apply_survey(table(house="object"), survey, run=ONE)
    done = classes_of(survey, len(xyz))
    shutil.copy(kept / "ne.laz", survey / "ne.laz")
    jf.apply_survey(table(hill="ground"), survey, run=ONE)
    assert sum("since verdicts" in str(one.message) for one in recwarn) == 1
    report = jf.apply_survey(table(house="object"), survey, run=ONE)
    house = inside(xyz, *HOUSE)
    assert report.applied == {"object": 1}
    np.testing.assert_array_equal(classes_of(survey, len(xyz))[house], done[house])


def test_the_command_says_what_it_leaves_out(survey, tmp_path):
    for layer in ("drafts", "final"):
        table(house="object").to_file(tmp_path / "several.gpkg", layer=layer, mode="a")
    table(house="object", hill="grond").to_file(tmp_path / "places.geojson")
    table(house=5).to_file(tmp_path / "number.geojson")
    table(house="object").rename(columns={"verdict": "word"}).to_file(tmp_path / "none.geojson")
    for name, code, *words in (
        ("places.geojson", 0, "'grond' is no verdict", "1 verdict carried out (1 object)", "1 verdict left out"),
        ("number.geojson", 1, "5 is no verdict"),
        ("none.geojson", 1, "no column verdict; it has word, geometry"),
        ("several.gpkg", 1, "one layer of shapes is needed", "it has drafts, final"),
    ):
        said = run("apply", tmp_path / name, survey)
        assert said.exit_code == code and all(one in said.output for one in words), said.output


def test_review_lists_the_places_of_classified_files(survey, tmp_path):
    listed, places = facts("review", survey, tmp_path / "places.gpkg"), geopandas.read_file(tmp_path / "places.gpkg")
    assert len(places) == len(listed["places"]) > 0
    assert places.verdict.fillna("").eq("").all() and places.geometry.intersects(box(*HILL)).any()
    done("dtm", survey, tmp_path / "dtm.tif", "-q")

    def count():
        stated = facts("accuracy", survey, tmp_path / "dtm.tif", tmp_path / "said.html", "--overwrite", "-q")
        return stated["labels"]["named_places"]

    assert count() == len(places)
    places.loc[1:, "verdict"] = "fine"
    places.to_file(tmp_path / "decided.gpkg", layer="review")
    done("apply", tmp_path / "decided.gpkg", survey, "-q")
    assert count() == 1


@pytest.mark.parametrize("name", [".verdicts.jaxfilter-run", ".verdicts.json.jaxfilter-run"])
def test_verdicts_follow_no_link_in_place_of_their_folders(survey, tmp_path, name):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "precious.txt").write_text("mine")
    (survey / name).symlink_to(elsewhere)
    table(house="object").to_file(tmp_path / "places.gpkg", layer="review")
    before = states(survey)
    said = run("apply", tmp_path / "places.gpkg", survey)
    assert said.exit_code != 0 and f"{survey / name}: is a link" in " ".join(said.stderr.split()), said.output
    assert states(survey) == before and (survey / name).is_symlink()
    assert {one.name: one.read_text() for one in elsewhere.iterdir()} == {"precious.txt": "mine"}


def test_a_dry_run_notes_no_verdict(survey):
    before, places = states(survey), table(house="object", hill="fine")
    jf.apply_survey(places, survey, run=jf.RunOptions(dry_run=True))
    assert states(survey) == before and sorted(p.name for p in survey.iterdir()) == sorted(before)
    assert jf.apply_survey(places, survey).applied == {"object": 1, "fine": 1} and states(survey) != before
