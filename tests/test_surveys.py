"""One file is a survey of one: the same labels, options and bytes for a file by itself, several, and text, and after a stop."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import laspy
import numpy as np
import pytest
import rasterio
from commands import done as completed
from commands import facts, run
from las_files import las_of
from test_tiles_run import Here

import jaxfilter as jf

pytestmark = [pytest.mark.usefixtures("plain_maps"), pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")]
PMF = jf.PMF(max_window=10.0, low_clusters=False)
BORDER = 160.0


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """West and east of a scene of 280 x 60 m, as LAS."""
    folder = tmp_path_factory.mktemp("survey")
    scene = jf.scenes.make("mixed", size=(280.0, 60.0), density=1.0, seed=8)
    xyz, cloud = scene.xyz, scene.cloud
    west = xyz[:, 0] < xyz[:, 0].min() + BORDER
    for name, rows in (("west", west), ("east", ~west)):
        fields = {"return_number": cloud.return_number[rows], "number_of_returns": cloud.number_of_returns[rows]}
        fields["classification"] = np.where(np.flatnonzero(rows) % 40 == 0, 9, 5)
        las_of(folder / f"{name}.las", xyz[rows], offsets=np.floor(xyz.min(axis=0)), **fields)
    return folder


def classes_of(path):
    return np.asarray(laspy.read(path).classification)


def las_of_folder(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.la[sz]"))}


@pytest.mark.parametrize("filter_", [
    jf.PTD(seed_cell=12.0, low_clusters=False), jf.STIN(seed_cell=10.0),
    *[pytest.param(one, marks=pytest.mark.slow) for one in (jf.SMRF(window=9.0), PMF, jf.OST(window=6.0, landscape=8.0))],
], ids=lambda one: type(one).__name__)  # fmt: skip
def test_away_from_its_border_a_file_alone_has_the_labels_that_it_has_in_a_folder_of_tiles(survey, tmp_path, filter_):
    """Windows have 100 m of halo: OST needs more than the default."""
    tiles = {"tile": 70.0, "halo": 100.0, "wide_halos": True}
    folder = jf.ground(survey, tmp_path / "folder", filter_, run=jf.RunOptions(**tiles, executor=Here()))
    assert folder.complete and folder.tiles >= 4 and folder.parameters == vars(filter_)
    options = jf.RunOptions(measures=folder.measures)
    alone = jf.ground(survey / "west.las", tmp_path / "west.las", filter_, run=options)
    assert alone.complete and alone.tiles == 1 and alone.measures["spacing"] == folder.measures["spacing"]
    las = laspy.read(survey / "west.las")
    far = las.x < las.x.min() + BORDER - 50.0
    one, other = classes_of(tmp_path / "west.las"), classes_of(tmp_path / "folder" / "west.las")
    assert far.sum() > 2000 and 0.1 < (one[far] == 2).mean() < 0.9
    np.testing.assert_array_equal(one[far], other[far])


def test_measures_of_another_run_are_taken_as_they_are(survey, tmp_path):
    """STIN grows as many rounds as they say."""

    def made(name, measures=None):
        run = jf.RunOptions(tile=70.0, halo=30.0, wide_halos=True, measures=measures, workers=1)
        return jf.ground(survey, tmp_path / name, jf.STIN(seed_cell=12.0), run=run).measures

    first = made("first")
    assert made("same", first) == first and las_of_folder(tmp_path / "same") == las_of_folder(tmp_path / "first")
    fewer = first | {"rounds": (1,) * len(first["rounds"])}
    assert made("fewer", fewer) == fewer and las_of_folder(tmp_path / "fewer") != las_of_folder(tmp_path / "first")


def test_tiles_of_a_small_scene_take_its_measures_as_in_memory(tmp_path):
    """Points lie four times as dense in the middle, where a sample would look."""
    rng = np.random.default_rng(5)
    x, y = np.concatenate([rng.uniform(0, 300, (24_000, 2)), rng.uniform(100, 200, (8_000, 2))]).round(2).T
    las_of(tmp_path / "in.las", np.column_stack([x, y, np.sin(x / 20) + (rng.random(len(x)) < 0.2) * 4]))
    cloud = jf.read(tmp_path / "in.las", units="m")
    how = jf.RunOptions(tile=150.0, halo=20.0, workers=1)
    found = jf.ground(tmp_path / "in.las", tmp_path / "out.las", PMF, reading=jf.Reading(units="m"), run=how)
    assert found.tiles > 1
    assert found.measures["spacing"] == pytest.approx(PMF.points_of(cloud).spacing(), rel=1e-4)  # a sample: 7 % less


def test_tiles_depend_neither_on_memory_nor_on_workers(survey, tmp_path, monkeypatch):
    monkeypatch.setattr("jaxfilter.surveys.plan.WHOLE", 4000)
    monkeypatch.setattr("jaxfilter.surveys.run.WHOLE", 4000)
    monkeypatch.setattr("jaxfilter.surveys.small.WHOLE", 4000)
    monkeypatch.setattr("jaxfilter.surveys.plan.TILE_POINTS", 6000)
    ways = {"one": {"workers": 1}, "two": {"workers": 2}, "little": {"memory": 4e8}}
    ways["much"] = {"memory": 1e12, "workers": 1}
    for name, how in ways.items():
        report = jf.ground(survey, tmp_path / name, PMF, run=jf.RunOptions(**how))
        assert report.complete and report.tiles > 1
    facts = [json.loads((tmp_path / name / ".jaxfilter-run" / "run.json").read_text()) for name in ways]
    assert len({each["tiles"]["digest"] for each in facts}) == 1
    same = las_of_folder(tmp_path / "one")
    assert all(las_of_folder(tmp_path / name) == same for name in ways)


FIELDS = ("--max-window", 10, "--no-low-clusters")


@pytest.mark.parametrize("several", [False, True], ids=["file", "folder"])
def test_options_of_one_file_and_of_many(survey, tmp_path, several):
    """Points outside of the bounds are not written, classes that are not ground stay, and the places to look at are listed."""
    where = survey if several else survey / "west.las"
    out = tmp_path / ("out" if several else "west.las")
    west = out / "west.las" if several else out
    before = laspy.read(survey / "west.las")
    x, y = before.x.min(), before.y.min()
    box = (x + 20, y + 10, x + (200 if several else 100), y + 50)
    tiles = ("--tile", 50, "--wide-halos") if several else ()
    words = ("ground", "pmf", where, out, *FIELDS, "--bounds", *box, "--only-ground", *tiles, "--workers", 1)
    report = facts(*words, "--quiet")
    inside = (before.x >= box[0]) & (before.x < box[2]) & (before.y >= box[1]) & (before.y < box[3])
    assert (report["tiles"] > 4) == several and report["complete"] and report["output"] == str(out)
    found = laspy.read(west)
    np.testing.assert_array_equal(found.xyz, before.xyz[inside])
    old, new = np.asarray(before.classification)[inside], np.asarray(found.classification)
    assert set(np.unique(new)) == {2, 5, 9} and (new[new != 2] == old[new != 2]).all()
    written = [laspy.read(path) for path in (out.glob("*.las") if several else [out])]
    assert report["points"] == sum(len(one) for one in written)
    assert report["ground"] == sum(int((one.classification == 2).sum()) for one in written)
    cloud = jf.read(survey / "west.las", units="m", bounds=box)
    if not several:
        np.testing.assert_array_equal(new == 2, PMF(cloud).ground)
    same = west.read_bytes()
    again = completed(*words, "--resume" if several else "--overwrite")
    assert west.read_bytes() == same
    assert f"{report['ground']:,} of {report['points']:,}" in again.stdout


def test_places_to_look_at_are_listed_for_a_folder(survey, tmp_path):
    pytest.importorskip("geopandas")
    words = ("ground", "pmf", survey, tmp_path / "out", "--max-window", 3, "--review", tmp_path / "places.geojson")
    listed = facts(*words, "--tile", 60, "--wide-halos", "--workers", 1, "--quiet")["places"]
    places = json.loads((tmp_path / "places.geojson").read_text())["features"]
    assert len(places) == len(listed) > 0
    volumes = [place["properties"]["volume"] for place in places]
    assert volumes == pytest.approx([one["volume"] for one in listed], rel=1e-3)
    refused = run(*words)
    assert refused.exit_code == 2 and "places.geojson exists" in refused.stderr


def test_a_folder_is_classified_in_place(survey, tmp_path):
    files, out = tmp_path / "files", tmp_path / "out"
    shutil.copytree(survey, files)
    how = (*FIELDS, "--tile", 50, "--workers", 1)
    completed("ground", "pmf", files, out, *how)
    report = facts("ground", "pmf", files, "--in-place", *how, "--quiet")
    assert las_of_folder(files) == las_of_folder(out) and report["output"] == str(files)
    assert sorted(path.name for path in files.iterdir()) == [".jaxfilter-run", "east.las", "west.las"]
    completed("height", files / "west.las", files / "east.las", "--in-place", "--quiet")
    assert all("HeightAboveGround" in laspy.read(path).point_format.dimension_names for path in files.glob("*.las"))


@pytest.mark.slow
def test_text_beside_las(survey, tmp_path):
    """Text has the labels that its points have as LAS, with the neighbour in another format."""
    las = laspy.read(survey / "east.las")
    las.classification[:], las.return_number[:], las.number_of_returns[:] = 0, 1, 1
    plain = tmp_path / "east.las"
    las.write(plain)
    table = np.column_stack([las.xyz, las.intensity])
    np.savetxt(tmp_path / "east.csv", table, fmt="%.2f", delimiter=",", header="x,y,z,i", comments="")
    labels = {}
    for source in (plain, tmp_path / "east.csv"):
        out = tmp_path / f"out-{source.suffix[1:]}"
        how = (*FIELDS, "--tile", 50, "--workers", 1, "-q")
        report = facts("ground", "pmf", survey / "west.las", source, f"{out}/", *how)
        assert report["complete"] and len(report["files"]) == 2 and report["tiles"] > 4
        labels[source.suffix] = jf.read(out / source.name, units="m").reference
    np.testing.assert_array_equal(labels[".las"], labels[".csv"])
    assert 0.1 < labels[".csv"].mean() < 0.98
    lines = (tmp_path / "out-csv" / "east.csv").read_text().splitlines()
    before = (tmp_path / "east.csv").read_text().splitlines()
    assert [line.rpartition(",")[0] for line in lines[1:]] == before[1:]
    csv = tmp_path / "out-csv" / "east.csv"
    completed("dtm", survey / "west.las", csv, tmp_path / "dtm.tif", "--filter", "pmf")
    assert np.isfinite(jf.Raster.read(tmp_path / "dtm.tif").values).mean() > 0.9


def test_a_small_file_goes_through_memory(survey, tmp_path):
    """What it has no use for is not loaded; nothing lies beside the output; its labels are those of a run in tiles."""
    code = """
import sys, jaxfilter as jf
made = []
sys.addaudithook(lambda event, found: made.append(str(found[0])) if event == "os.mkdir" else None)
jf.ground(sys.argv[1], sys.argv[2], jf.PMF(max_window=10.0))
print(sum("jaxfilter-run" in name for name in made))
print([name for name in ("run", "plan", "store", "claim", "executors", "vpc") if f"jaxfilter.surveys.{name}" in sys.modules])
"""
    source, out = survey / "west.las", tmp_path / "out" / "west.las"
    out.parent.mkdir()
    done = subprocess.run([sys.executable, "-c", code, source, out], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[:2] == ["0", "[]"] and os.listdir(out.parent) == ["west.las"]
    filter_ = jf.PMF(max_window=10.0)
    tiled = jf.ground(source, tmp_path / "tiled.las", filter_, run=jf.RunOptions(tile=1000.0, workers=1))
    assert tiled.tiles == 1 and out.read_bytes() == (tmp_path / "tiled.las").read_bytes()
    before = out.stat().st_mtime_ns
    again = jf.ground(source, out, filter_, run=jf.RunOptions(resume=True))
    assert again.was_complete and out.stat().st_mtime_ns == before
    shutil.copy(source, tmp_path / "in.las")
    for how in ({}, {"resume": True}):  # the labels are the same ones again
        executor = Here()
        run = jf.RunOptions(in_place=True, executor=executor, **how)
        assert jf.ground(tmp_path / "in.las", None, filter_, run=run).complete and executor.calls == []
        assert (tmp_path / "in.las").read_bytes() == out.read_bytes()


def test_bounds_in_place_are_refused_since_points_would_be_lost(survey, tmp_path):
    path = shutil.copy(survey / "west.las", tmp_path)
    for function in (jf.ground, jf.heights):
        with pytest.raises(jf.ParameterError, match="would remove points"):
            function(path, None, PMF, reading=jf.Reading(bounds=(0, 0, 20, 20)), run=jf.RunOptions(in_place=True))
    assert (
        las_of_folder(tmp_path) == {"west.las": (survey / "west.las").read_bytes()}
        and len(list(tmp_path.iterdir())) == 1
    )


def test_bounds_without_points_are_an_error_beside_the_data_and_in_a_gap(survey, tmp_path):
    xyz = jf.read(survey / "west.las").coordinates()
    path = tmp_path / "gap.laz"
    las_of(path, np.concatenate([xyz, xyz + [1000, 0, 0]]), classification=2)
    x, y = xyz[:, :2].max(axis=0)
    for act, filter_ in ((jf.ground, (PMF,)), (jf.heights, ())):
        for what in (path, survey):
            with pytest.raises(jf.InputError, match="no point is in bounds 0, 0, 20, 20: pass other bounds="):
                act(what, tmp_path / "out", *filter_, reading=jf.Reading(bounds=(0, 0, 20, 20)))
    gap = jf.Reading(bounds=(x + 100, y - 50, x + 200, y), units="m")
    for out, how in (("out.laz", {}), ("tiles/", {"tile": 50.0, "wide_halos": True, "workers": 1})):
        with pytest.raises(jf.InputError, match=r"no point is in bounds .*: pass other bounds= within 512000"):
            jf.heights(path, f"{tmp_path}/{out}", reading=gap, run=jf.RunOptions(**how))
    for bounds, words in (
        (gap.bounds, "no cell of the dtm in bounds"),
        ((0, 0, 20, 20), "no point is in bounds 0, 0, 20"),
    ):
        with pytest.raises(jf.InputError, match=words):
            interpolation = jf.Interpolation(max_gap=5.0)
            jf.terrain_model(path, tmp_path / "dtm.tif", interpolation=interpolation, reading=jf.Reading(bounds=bounds))
    assert [one.name for one in tmp_path.iterdir()] == ["gap.laz"]


def test_what_damaged_files_cover_has_no_value_and_is_named(tmp_path):
    """One of nine files, in the middle, is cut; in another one, at the edge, the points are overwritten."""
    rng = np.random.default_rng(3)
    (tmp_path / "in").mkdir()
    for i, j in np.ndindex(3, 3):
        xy = rng.uniform(0, 40, (3000, 2)) + np.array([i, j]) * 40
        las_of(tmp_path / "in" / f"t{i}{j}.laz", np.column_stack([xy, np.sin(xy[:, 0] / 20)]))
    for name, much in (("t11", b""), ("t20", bytes(range(1, 256)) * 20)):
        place = tmp_path / "in" / f"{name}.laz"
        content = place.read_bytes()
        half = len(content) // 2
        place.write_bytes(content[:half] + much + content[half + len(much) :] * bool(much))
    made = run("products", tmp_path / "in", tmp_path / "out", "--filter", "pmf", "--only", "dtm,count", "--units", "m")
    assert made.exit_code == 1 and all(f"{name}.laz" in made.stdout for name in ("t11", "t20"))
    page = (tmp_path / "out" / "survey.html").read_text()
    about = run("info", tmp_path / "in", "--units", "m")
    assert about.exit_code == 1 and all(
        f"{name}.laz" in text for name in ("t11", "t20") for text in (page, about.stdout)
    )
    for name in ("dtm", "count"):
        with rasterio.open(tmp_path / "out" / f"{name}.tif") as file:
            known = file.read_masks(1)[::-1] > 0  # from the south
        assert not known[42:78, 42:78].any() and not known[5:35, 85:115].any()
        assert known[5:35, 5:75].all() and known[85:115, 5:115].all()


def test_a_dry_run_tells_what_the_run_then_does_and_writes_nothing(survey, tmp_path, monkeypatch):
    before, names = sorted(tmp_path.rglob("*")), ["east.las", "west.las"]
    how = {"tile": 80.0, "wide_halos": True, "workers": 1}
    runs = {
        "ground": lambda **more: jf.ground(survey, tmp_path / "out", PMF, run=jf.RunOptions(**how, **more)),
        "heights": lambda **more: jf.heights(survey, tmp_path / "heights", PMF, run=jf.RunOptions(**how, **more)),
        "model": lambda **more: jf.terrain_model(survey, tmp_path / "dtm.tif", PMF, run=jf.RunOptions(**how, **more)),
    }
    for name, act in runs.items():
        plan = act(dry_run=True).forecast
        assert sorted(tmp_path.rglob("*")) == before, name
        done = act()
        assert (plan.points, plan.tiles, sorted(plan.files)) == (done.points, done.tiles, done.files), name
        assert plan.times_read == pytest.approx(done.read / done.points, rel=0.25), "by mean densities of the files"
        assert 3 < plan.seconds < 60 and plan.memory > 3e8 and plan.workers == 1 and done.forecast is None
        assert name == "model" or [path.rsplit("/")[-1] for path in sorted(plan.files)] == names
        before = sorted(tmp_path.rglob("*"))
    with pytest.raises(jf.OutputError, match="exists"):
        runs["model"](dry_run=True)
    monkeypatch.setattr(jf.OST, "__call__", lambda *_, **__: pytest.fail("a dry run filters nothing"))
    assert jf.ground(survey, tmp_path / "ost", run=jf.RunOptions(dry_run=True)).forecast.points == plan.points
    assert runs["heights"](dry_run=True, overwrite=True, halo=60.0).forecast.times_read > 2
    result = completed("ground", "pmf", survey, tmp_path / "new", "--tile", 80, "--wide-halos", "--dry-run")
    assert "tiles of 80 m with" in result.stdout and "nothing was written" in result.stdout
    assert sorted(tmp_path.rglob("*")) == before


# folders of a run's own


@pytest.fixture
def elsewhere(tmp_path):
    """Somebody's folder, in which a lock has not been written to for years, and what it holds, each time it is asked."""
    folder = tmp_path / "elsewhere"
    (folder / "deep").mkdir(parents=True)
    for name in ("lock", "precious.txt", "run.json", "deep/1.tile"):
        (folder / name).write_text(f"this is {name}")
        os.utime(folder / name, (1e9, 1e9))
    for each in (folder / "deep", folder):
        os.utime(each, (1e9, 1e9))
    return folder, lambda: held(folder)


def held(folder):
    """What there is in a folder, with bytes, owners, permissions and times of change."""
    found = {}
    for path in (folder, *sorted(folder.rglob("*"))):
        facts = path.lstat()
        content = path.read_bytes() if path.is_file() else None
        found[str(path.relative_to(folder))] = content, facts.st_uid, facts.st_mode, facts.st_mtime_ns
    return found


def of_another(place, folder):
    if not hasattr(os, "getuid") or os.getuid():
        pytest.skip("only root can give a folder to another user")
    shutil.copytree(folder, place)
    for each in (place, *place.rglob("*")):
        os.chown(each, 12345, 12345)


def open_to_others(place, folder):
    of_another(place, folder)
    place.chmod(0o777)


def own_open_to_others(place, folder):
    shutil.copytree(folder, place)
    place.chmod(0o775)


KINDS = {
    "link": lambda place, folder: place.symlink_to(folder),
    "link to nothing": lambda place, folder: place.symlink_to(folder / "missing"),
    "plain file": lambda place, folder: place.write_text("mine"),
    "of another": of_another, "open to others": open_to_others, "own, open to others": own_open_to_others,
}  # fmt: skip


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="needs owners of files")
@pytest.mark.parametrize("how", ["", "--resume", "--overwrite"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("in_place", [False, True])
def test_a_folder_that_no_run_of_ours_has_made_is_refused_by_its_name(survey, tmp_path, elsewhere, in_place, kind, how):
    """Whatever it is, it stays, and so does what it leads to."""
    d, name, (folder, content) = tmp_path / "d", ".jaxfilter-run", elsewhere
    shutil.copytree(survey, d) if in_place else d.mkdir()
    KINDS[kind](d / name, folder)
    before, beside = content(), held(d)
    done = run("ground", "pmf", *([d, "--in-place"] if in_place else [survey, f"{d}/"]), *filter(None, [how]))
    assert done.exit_code in (1, 2) and f"{d / name}: " in done.stderr and "remove it" in done.stderr, done.output
    assert content() == before and held(d) | {".": None} == beside | {".": None}


def stopped(survey, out):
    """Options of a run that is stopped after two tasks."""
    how = {"tile": 60.0, "wide_halos": True}
    with pytest.raises(KeyboardInterrupt):
        jf.ground(survey, out, PMF, run=jf.RunOptions(executor=Here(stop_after=2), **how))
    return how


@pytest.mark.parametrize("name", ["tiles", "tiles/0", "files", "lock", "run.json", "tiles/0/planted.tile"])
def test_links_in_the_folder_of_a_run_are_not_followed(survey, tmp_path, elsewhere, name):
    """To go on with such a run is refused; to begin anew leaves what they lead to as it is."""
    out, (folder, content) = tmp_path / "out", elsewhere
    how = stopped(survey, out)
    place = out / ".jaxfilter-run" / name
    if place.is_dir():
        shutil.rmtree(place)
    place.unlink(missing_ok=True)
    place.symlink_to(folder / (place.name if place.name in ("lock", "run.json") else ""))
    before = content()
    with pytest.raises(jf.OutputError, match="link") as caught:
        jf.ground(survey, out, PMF, run=jf.RunOptions(executor=Here(), resume=True, **how))
    assert str(out / ".jaxfilter-run") in str(caught.value) and content() == before and place.is_symlink()
    if name == "lock":
        place.unlink()
    assert jf.ground(survey, out, PMF, run=jf.RunOptions(executor=Here(), overwrite=True, **how)).complete
    assert content() == before


@pytest.mark.parametrize("how", ["resume", "overwrite"])
def test_hard_links_in_the_folder_of_a_run_change_nothing_elsewhere(survey, tmp_path, elsewhere, how):
    out, (folder, _) = tmp_path / "out", elsewhere
    some = stopped(survey, out)
    kept = out / ".jaxfilter-run"
    for place in [path for path in kept.rglob("*") if path.is_file()]:
        other = folder / place.name
        shutil.copy(place, other)
        place.unlink()
        os.link(other, place)
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    assert jf.ground(survey, out, PMF, run=jf.RunOptions(executor=Here(), **some, **{how: True})).complete
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before


def test_a_disk_that_knows_one_owner_only_is_no_reason_to_refuse(survey, tmp_path, monkeypatch):
    """There everything that is made belongs to somebody else, also what this run makes."""
    if not hasattr(os, "getuid"):
        pytest.skip("needs owners of files")
    another = os.getuid() + 1
    monkeypatch.setattr(os, "getuid", lambda: another)
    for how in ({}, {"overwrite": True}, {"resume": True}):
        assert jf.ground(survey, tmp_path / "out", PMF, run=jf.RunOptions(workers=1, **how)).complete
    assert (tmp_path / "out" / ".jaxfilter-run").stat().st_mode & 0o777 == 0o700
    assert sorted(p.name for p in (tmp_path / "out").iterdir() if p.name.startswith(".")) == [".jaxfilter-run"]
