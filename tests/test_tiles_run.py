"""Runs over collections: the labels of the whole, the bytes of single files, whatever comes between."""

from __future__ import annotations

import collections
import dataclasses
import json
import math
import multiprocessing
import os
import re
import shutil
import subprocess
import sys
import time

import laspy
import numpy as np
import pytest
from las_files import las_of

import jaxfilter as jf
from jaxfilter.plots import footprints
from jaxfilter.surveys import tiles
from jaxfilter.surveys.executors import Outcome, Pool, Task, attempt, carried_out
from jaxfilter.surveys.plan import TILE_POINTS, WHOLE, Where, plan_tiles
from jaxfilter.surveys.product import Cut, do_tile
from jaxfilter.surveys.report import TILE, RunReport, Summary
from jaxfilter.surveys.targets import target_names

pytestmark = [pytest.mark.usefixtures("plain_maps"), pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")]
PMF_FIELDS = {"max_window": 10.0, "low_clusters": False}
PMF = jf.PMF(**PMF_FIELDS)
LEFT, KEPT = [".jaxfilter-run", "jaxfilter-run.json", "jaxfilter-run.png"], ".jaxfilter-run"
ANCHOR = (0.0, 0.0)
HOW = {"tile": 25.0, "halo": 20.0, "workers": 1}


class Here:
    """An executor in this process that ends tasks in any order, and may stop in the middle."""

    def __init__(self, seed=0, width=3, stop_after=None, fail=None):
        self.rng, self.width, self.stop_after = np.random.default_rng(seed), width, stop_after
        self.fail = fail or (lambda function, task, last: None)
        self.waiting, self.calls = [], []

    def outcomes(self, take):
        while True:
            while len(self.waiting) < self.width and (given := take()) is not None:
                self.waiting.append(given)
            if not self.waiting:
                return
            yield self.completed()

    def completed(self):
        if self.stop_after is not None and len(self.calls) >= self.stop_after:
            raise KeyboardInterrupt
        tag, function, arguments = self.waiting.pop(int(self.rng.integers(len(self.waiting))))
        self.calls.append((function.__name__, arguments[1].number))
        reason = self.fail(function, *arguments[1:])
        return [(tag, Outcome(reason=reason) if reason else attempt(function, arguments))]

    def close(self):
        self.waiting = []


@pytest.fixture(scope="module")
def cloud():
    return jf.scenes.make("town", size=(100.0, 90.0), density=1.0, seed=5).cloud


@pytest.fixture(scope="module")
def files(cloud, tmp_path_factory):
    """Four LAZ files of a scene, of two point formats and scales, cut where no tile ends."""
    folder, xyz = tmp_path_factory.mktemp("survey"), cloud.coordinates()
    middle = cloud.origin[:2] + (43.0, 51.0)
    for i in range(2):
        for j in range(2):
            rows = np.flatnonzero(((xyz[:, 0] < middle[0]) == (i == 0)) & ((xyz[:, 1] < middle[1]) == (j == 0)))
            fields = {"return_number": cloud.return_number[rows], "number_of_returns": cloud.number_of_returns[rows]}
            fields |= {"intensity": rows % 60000, "classification": np.where(rows % 50 == 0, 9, 0)}
            fields |= {"scales": 0.01 if j else 0.001, "offsets": np.floor(xyz.min(axis=0))}
            las_of(folder / f"{i}{j}.laz", xyz[rows], 6 if i else 1, **fields)
    return folder


def whole_of(paths, **options):
    """The cloud of all points of files, or of those in a folder."""
    paths = paths if isinstance(paths, list) else sorted(paths.glob("*.laz"))
    clouds = [jf.read(path, anchor=ANCHOR, **options) for path in paths]
    names = ("return_number", "number_of_returns", "classification", "candidate")
    columns = {name: np.concatenate([getattr(one, name) for one in clouds]) for name in names}
    xyz = np.concatenate([one.coordinates() for one in clouds])
    return jf.PointCloud.from_arrays(xyz, anchor=ANCHOR, **columns)


def classes_of(folder):
    return np.concatenate([laspy.read(path).classification for path in sorted(folder.glob("*.laz"))])


def values(how):
    """The arguments of a run from plain options."""
    names = {kind: {f.name for f in dataclasses.fields(kind)} for kind in (jf.RunOptions, jf.Reading, jf.Classes)}
    made = {kind: kind(**{k: v for k, v in how.items() if k in own}) for kind, own in names.items()}
    rest = {k: v for k, v in how.items() if not any(k in own for own in names.values())}
    classes = {"classes": made[jf.Classes]} if any(k in names[jf.Classes] for k in how) else {}
    return (
        {"run": dataclasses.replace(made[jf.RunOptions], wide_halos=True), "reading": made[jf.Reading]} | classes | rest
    )


def model(what, target, *ground, **how):
    return jf.terrain_model(what, target, *ground, **values(how))


def heights(what, out, *ground, **how):
    return jf.heights(what, out, *ground, **values(how))


def run(files, out, executor=None, filter_=PMF, **how):
    return jf.ground(files, out, filter_, **values({"executor": executor or Here()} | HOW | how))


def contents(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.la[sz]"))}


@pytest.fixture(scope="module")
def done(files, tmp_path_factory):
    """The outputs of an undisturbed run, and its report."""
    out = tmp_path_factory.mktemp("done") / "out"
    report = run(files, out)
    assert report.complete
    return out, report


def test_files_are_those_that_the_labels_of_the_whole_make(files, done, tmp_path):
    out, report = done
    whole = whole_of(files)
    labels = PMF(whole).ground
    assert 0.3 < labels.mean() < 0.95 and report.tiles > 12
    start = 0
    for path in sorted(files.glob("*.laz")):
        cloud = jf.read(path, anchor=ANCHOR)
        expected = jf.write(tmp_path / path.name, cloud, labels[start : start + len(cloud)])
        assert (out / path.name).read_bytes() == expected.read_bytes()
        start += len(cloud)
    assert (report.points, report.ground) == (len(whole), labels.sum())
    assert report.candidates == whole.candidate.sum() and report.statuses == {"CONVERGED": report.tiles}
    pairs, number = np.unique(np.stack([whole.classification, classes_of(out)]), axis=1, return_counts=True)
    assert report.classes == {tuple(pair): n for pair, n in zip(pairs.T.tolist(), number.tolist(), strict=True)}
    assert (9, 9) in report.classes
    assert sorted(p.name for p in out.iterdir() if p.suffix != ".laz") == LEFT


def test_the_order_in_which_tiles_end_changes_no_byte(files, done, tmp_path):
    assert run(files, tmp_path / "out", Here(1, width=7)).complete
    assert contents(tmp_path / "out") == contents(done[0])


def test_a_run_that_is_killed_goes_on_and_repeats_nothing(files, done, tmp_path):
    """From a copy of the folder at that moment, which is what kill -9 leaves; also after files were written."""
    tasks, out = [], tmp_path / "0"

    class Killed(Here):
        def completed(self):
            if self.stop_after is not None and len(self.calls) >= self.stop_after:
                shutil.copytree(out, tmp_path / f"{int(out.name) + 1}")
            return super().completed()

    for stop in (5, 9, 4, 100):
        executor = Killed(stop, stop_after=stop)
        try:
            report = run(files, out, executor, resume=True)
        except KeyboardInterrupt:
            assert (out / KEPT).is_dir()
            out = tmp_path / f"{int(out.name) + 1}"
        tasks += executor.calls
    assert report.complete and contents(out) == contents(done[0])
    assert (report.points, report.classes) == (done[1].points, done[1].classes)
    assert len(tasks) == len(set(tasks))
    assert [name for name, _ in tasks[:18]].count("write_file") > 0
    last = Here()
    assert run(files, out, last, resume=True).complete and last.calls == []


def test_what_fails_is_tried_three_times_and_set_aside_with_its_reason(files, done, tmp_path):
    tried = []

    def fail(function, tile, last):
        if function is do_tile and tile.number == 0:
            tried.append(last)
            return "no luck"
        if function is do_tile and tile.number == 5 and len(tried) == 1:
            tried.append(None)
            return "once"
        return None

    report = run(files, tmp_path / "out", Here(fail=fail))
    assert tried.count(False) == 2 and tried.count(True) == 1
    assert [one["reason"] for one in report.set_aside] == ["no luck"] and not report.complete
    assert np.flatnonzero(report.table["ground"] == -1).tolist() == [0]
    assert len(report.files) == 3 and "tile 0 was set aside: no luck" in report.failed[0]["reason"]
    same = contents(done[0])
    assert all(same[name] == data for name, data in contents(tmp_path / "out").items())
    assert run(files, tmp_path / "out", resume=True).complete and contents(tmp_path / "out") == same


def test_a_damaged_file_is_left_out_and_all_others_are_written(files, done, tmp_path):
    survey = tmp_path / "survey"
    shutil.copytree(files, survey)
    data = bytearray((survey / "11.laz").read_bytes())
    data[len(data) // 3 : len(data) // 2] = os.urandom(len(data) // 2 - len(data) // 3)
    (survey / "11.laz").write_bytes(data)
    (survey / "empty.laz").write_bytes(b"")
    report = run(survey, tmp_path / "out", executor := Here())
    tries = collections.Counter(number for name, number in executor.calls if name == "do_tile")
    assert set(tries.values()) == {1, 3}, "a file is left out only when the tile is tried for the last time"
    assert sorted(contents(tmp_path / "out")) == ["00.laz", "01.laz", "10.laz"]
    assert {one["file"].rpartition("/")[2] for one in report.failed} == {"11.laz", "empty.laz"}
    assert [one["file"] for one in report.left_out] == [str(survey / "11.laz")] and not report.set_aside
    assert report.points == sum(len(jf.read(files / name)) for name in ("00.laz", "01.laz", "10.laz"))


@pytest.mark.parametrize("changes, what", [
    ({"halo": 10.0}, "tiles"), ({"filter_": PMF.replace(slope=0.5)}, "filter"), ({"other_class": 0}, "classes"),
    ({"units": "m,ft"}, "units"), ({"ignore_overlap": True}, "reading"),
])  # fmt: skip
def test_nothing_is_mixed_with_a_run_of_other_parameters(files, done, tmp_path, changes, what):
    shutil.copytree(done[0], tmp_path / "out")
    with pytest.raises(jf.InputError, match=f"begun with other {what}"):
        run(files, tmp_path / "out", resume=True, **changes)
    assert contents(tmp_path / "out") == contents(done[0])


def test_inputs_that_have_changed_are_noticed(files, tmp_path):
    survey = tmp_path / "survey"
    shutil.copytree(files, survey)
    with pytest.raises(KeyboardInterrupt):
        run(survey, tmp_path / "out", Here(stop_after=4))
    las = laspy.read(survey / "01.laz")
    las.z[0] += 1.0
    las.write(survey / "01.laz")
    with pytest.raises(jf.InputError, match="begun with other inputs"):
        run(survey, tmp_path / "out", resume=True)
    assert run(survey, tmp_path / "out", overwrite=True).complete


def test_outputs_that_are_gone_or_damaged_are_made_again_and_named(files, done, tmp_path):
    out, executor = tmp_path / "out", Here()
    shutil.copytree(done[0], out)
    times = (out / "00.laz").stat()
    data = bytearray((out / "00.laz").read_bytes())
    data[-5] ^= 1
    (out / "00.laz").write_bytes(data)
    os.utime(out / "00.laz", ns=(times.st_atime_ns, times.st_mtime_ns))
    (out / "01.laz").unlink()
    os.truncate(out / "10.laz", 500)
    report = run(files, out, executor, resume=True)
    assert report.complete and contents(out) == contents(done[0]) and len(report.files) == 4
    length = (done[0] / "10.laz").stat().st_size
    wrong = {"00.laz": "was changed", "01.laz": "is missing", "10.laz": f"has 500 bytes instead of {length:,}"}
    said = {f"{out / name}: {reason}, so it had to be made again" for name, reason in wrong.items()}
    assert said == {remark for remark in report.remarks if "made again" in remark}
    assert (report.points, report.classes) == (done[1].points, done[1].classes)
    assert ("write_file", 3) not in executor.calls, "the copy of the fourth is as it was"
    (out / "11.laz").unlink()
    (out / "11.laz").mkdir()
    report = run(files, out, resume=True)
    assert not report.complete and "is a folder" in report.failed[0]["reason"]
    with pytest.raises(jf.OutputError, match=r"11\.laz: is a folder, .*and only regular files"):
        run(files, out, overwrite=True)
    assert (out / "00.laz").exists()


def test_labels_that_are_damaged_are_made_again(files, done, tmp_path):
    """Those that are gone, cut, end in zeros, or have one other bit: in the labels, in the summary, anywhere."""
    out, again = tmp_path / "out", Here()
    with pytest.raises(KeyboardInterrupt):
        run(files, out, Here(3, stop_after=8))
    kept = sorted((out / KEPT / "tiles").rglob("*.tile"))
    assert len(kept) > 5
    os.truncate(kept[0], 100)
    kept[1].write_bytes(kept[1].read_bytes()[:-30] + bytes(30))
    kept[2].unlink()
    for path, share in zip(kept[3:], (0.3, 0.6, 0.9), strict=False):
        data = bytearray(path.read_bytes())
        data[int(share * len(data))] ^= 1
        path.write_bytes(data)
    damaged = {int(path.stem) for path in kept[:6]}
    assert run(files, out, again, resume=True).complete and contents(out) == contents(done[0])
    assert damaged <= {number for name, number in again.calls if name == "do_tile"}


REFUSED = ("empty", "cut", "something else", "noise", "zeros", "another number", "other JSON")
"""Damages of run.json that nothing makes up for."""


def damage(path, how, rng):
    """Damage a file, whose time stays."""
    if path.is_dir():
        return shutil.rmtree(path)
    status, data = path.stat(), path.read_bytes()
    if how in ("missing", "a folder"):
        path.unlink()
        return path.mkdir() if how == "a folder" else None
    third = len(data) // 3
    at = int(rng.integers(1, len(data) - third))
    changed = {
        "empty": b"",
        "cut": data[:at],
        "longer": data + rng.bytes(5000),
        "one bit": data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :],
        "noise": data[:at] + rng.bytes(third) + data[at + third :],
        "zeros": data[:at] + bytes(third) + data[at + third :],
        "something else": b"this is something else\n" * 500,
        "another number": re.sub(rb'"halo": [\d.]+', b'"halo": 16.0', data),
        "other JSON": b'{"name": "something else"}',
    }
    path.write_bytes(changed[how])
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


@pytest.mark.parametrize("what, how", [
    *[("run.json", how) for how in REFUSED],
    *[pytest.param("run.json", how, marks=pytest.mark.slow) for how in ("missing", "one bit", "longer", "a folder")],
    *[pytest.param("report", how, marks=pytest.mark.slow) for how in ("missing", "something else")],
])  # fmt: skip
def test_damage_of_what_a_run_keeps_leads_to_no_wrong_output(files, done, tmp_path, what, how):
    out, executor = tmp_path / "out", Here()
    shutil.copytree(done[0], out)
    place = {"run.json": f"{KEPT}/run.json", "report": "jaxfilter-run.json"}[what]
    damage(out / place, how, np.random.default_rng(0))
    before = contents(out)
    try:
        report = run(files, out, executor, resume=True)
    except jf.JaxfilterError as error:
        assert what == "run.json" and str(out) in str(error) and "pass overwrite=True to begin" in str(error)
        assert how not in REFUSED or re.search("run.json: is damaged|begun with other", str(error))
        assert executor.calls == [] and contents(out) == before
    else:
        assert what == "report" and report.complete and contents(out) == contents(done[0])
        assert not any("made again" in remark for remark in report.remarks)
    assert run(files, out, overwrite=True).complete and contents(out) == contents(done[0])
    assert sorted(p.name for p in out.iterdir() if p.suffix != ".laz") == LEFT


def test_one_run_at_a_time_writes_into_a_folder(files, done, tmp_path):
    out, refused = tmp_path / "out", []

    class Rival(Here):
        def completed(self):
            for how in ("resume", "overwrite") if len(self.calls) in (0, 5) else ():
                with pytest.raises(jf.OutputError, match="another run is writing into this folder") as raised:
                    run(files, out, **{how: True})
                refused.append(raised.value)
            return super().completed()

    assert run(files, out, Rival()).complete and len(refused) == 4 and contents(out) == contents(done[0])


def test_folders_that_hold_something_are_refused(files, done, tmp_path):
    with pytest.raises(jf.OutputError, match=r"is not empty, it holds 00\.laz and 5 more"):
        run(files, done[0])
    with pytest.raises(jf.OutputError, match="is an input"):
        run(files, files, overwrite=True)
    os.link(files / "00.laz", tmp_path / "link.laz")
    for options in (jf.RunOptions(overwrite=True), jf.RunOptions(resume=True)):
        with pytest.raises(jf.OutputError, match=r"link\.laz: is an input"):
            jf.ground(files / "00.laz", tmp_path / "link.laz", jf.SMRF(), run=options)
    other = tmp_path / "other"
    shutil.copytree(files, other)
    with pytest.raises(jf.ParameterError, match=r"one\.laz: 4 files are written into a folder"):
        heights(files, tmp_path / "one.laz")
    with pytest.raises(jf.ParameterError, match="filter_='smrf': is no filter"):
        jf.ground(files, tmp_path / "out", "smrf")
    assert not (tmp_path / "one.laz").exists() and not (tmp_path / "out").exists()
    with pytest.raises(jf.OutputError, match="both be written as 00"):
        run([str(files), str(other)], tmp_path / "out")
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "notes.txt").write_text("mine")
    assert run(files, tmp_path / "kept", overwrite=True).complete
    assert (tmp_path / "kept" / "notes.txt").read_text() == "mine"


def test_low_outliers_get_the_class_of_noise(cloud, tmp_path):
    """Those of the file as a whole, whichever tile they lie in, with and without their heights."""
    xyz = cloud.coordinates()
    low = xyz[::900] - (0.0, 0.0, 30.0)
    jf.write(tmp_path / "in.laz", jf.PointCloud.from_arrays(np.vstack([xyz, low])), None)
    one = jf.PMF(max_window=10.0)
    whole = one(jf.read(tmp_path / "in.laz", anchor=ANCHOR))
    assert whole.low_noise[len(xyz) :].all() and not (whole.low_noise & whole.ground).any()
    for extra in ((), ("height",)):
        out = tmp_path / "-".join(("out", *extra))
        report = run(tmp_path / "in.laz", out, filter_=one, noise_class=7, extra=extra, tile=50.0)
        assert report.complete and report.tiles >= 4 and report.classes[0, 7] == whole.low_noise.sum()
        classes = np.asarray(laspy.read(out / "in.laz").classification)
        if extra:
            np.testing.assert_array_equal(laspy.read(out / "in.laz")["height"], whole.height)
        np.testing.assert_array_equal(classes == 7, whole.low_noise)
        np.testing.assert_array_equal(classes == 2, whole.ground)


def test_points_of_the_overlap_are_counted_and_can_be_set_aside(files, tmp_path):
    """By class 12 in a file of point format 1, by the flag in one of format 6."""
    for name in ("01", "11"):
        las = laspy.read(files / f"{name}.laz")
        strip = np.abs(las.y - np.mean(las.y)) < 9
        las["classification" if name == "01" else "overlap"][strip] = 12 if name == "01" else 1
        las.write(tmp_path / f"{name}.laz")
    paths = [tmp_path / "01.laz", tmp_path / "11.laz"]
    names, whole = [str(path) for path in paths], whole_of(paths)
    marked = np.concatenate([laspy.read(paths[0]).classification == 12, laspy.read(paths[1]).overlap == 1])
    labels = PMF(whole).ground
    judged, ground = (whole.candidate & marked).sum(), (labels & marked).sum()
    counts = {"points": marked.sum(), "judged": judged, "ground": ground, "kept": 0}
    assert run(names, tmp_path / "judged").overlap == counts and counts["ground"] > 100
    report = run(names, tmp_path / "aside", ignore_overlap=True)
    after = classes_of(tmp_path / "aside")
    assert report.overlap == counts | {"judged": 0, "ground": 0} and (after[: len(laspy.read(paths[0]))] == 12).any()
    np.testing.assert_array_equal(after == 2, PMF(whole_of(paths, ignore_overlap=True)).ground)


def test_outputs_have_the_names_of_inputs():
    uris = ["/a/one.las", "s3://b/two.copc.laz", "https://c/three.laz?sv=2024&sig=x%2Fy.z"]
    assert target_names(uris) == ["one.las", "two.laz", "three.laz"]
    with pytest.raises(jf.OutputError, match=r"both be written as one\.las"):
        target_names([*uris, "s3://b/one.las"])


def deadly(name, last):
    """A task that kills its worker, beside others that take a while and die with it."""
    if name == "deadly":
        os._exit(3)
    time.sleep(0.5)
    return int(name)


def test_a_worker_that_dies_is_replaced_and_only_the_task_that_kills_it_is_set_aside():
    names, pool = ["1", "deadly", "2", "x", "3"], Pool(3)
    try:
        tasks = (Task(deadly, number, (name,)) for number, name in enumerate(names))
        done = carried_out(pool, tasks, collections.deque(), lambda: None)
        found = {names[task.number]: outcome for task, outcome in done}
    finally:
        pool.close()
    assert [found[name].value for name in "123"] == [1, 2, 3] and len(found) == len(names)
    assert "a worker died" in found["deadly"].reason and "ValueError" in found["x"].reason


def test_a_dask_cluster_writes_the_same_bytes(files, done, tmp_path):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        how = {k: v for k, v in HOW.items() if k != "workers"}
        report = jf.ground(files, tmp_path / "out", PMF, run=jf.RunOptions(client=client, wide_halos=True, **how))
    assert report.complete and contents(tmp_path / "out") == contents(done[0])


@pytest.fixture(scope="module")
def odd(files, tmp_path_factory):
    """Those files, one of them twice, one without points, and beyond them water and points that are not judged."""
    folder = tmp_path_factory.mktemp("odd") / "survey"
    shutil.copytree(files, folder)
    shutil.copy(files / "00.laz", folder / "00-again.laz")
    las = laspy.read(files / "11.laz")
    x, y = np.floor(las.x.max()), np.floor(las.y.max())
    for name, class_, withheld, rows, east in (
        ("empty", 0, 0, 0, 0.0), ("water", 9, 0, 200, 30.0), ("withheld", 0, 1, 200, 60.0)
    ):  # fmt: skip
        grid = np.arange(rows)
        xyz = np.column_stack([x + east + 1.3 * (grid % 20), y - 1.7 * (grid // 20), np.full(rows, 3.0)])
        las_of(folder / f"{name}.laz", xyz, offsets=(x, y, 0.0), classification=class_, withheld=withheld)
    return folder


@pytest.mark.slow
def test_files_that_are_twice_there_or_hold_nothing_to_judge_are_written_like_all_others(odd, tmp_path):
    for halo in (0.0, 20.0):
        out = tmp_path / f"{halo:g}"
        report = run(odd, out, halo=halo)
        before, after = ({p.name: laspy.read(p) for p in folder.glob("*.laz")} for folder in (odd, out))
        assert report.complete and before.keys() == after.keys() and len(after) == 8
        assert report.points == sum(len(one) for one in after.values()) and report.statuses["NO_CANDIDATES"] >= 2
        for name, one in before.items():
            assert np.array_equal(one.xyz, after[name].xyz), name
        classes = {name: np.asarray(one.classification) for name, one in after.items()}
        assert np.array_equal(classes["00.laz"], classes["00-again.laz"]) and (classes["00.laz"] == 2).any()
        assert (classes["water.laz"] == 9).all() and (classes["withheld.laz"] == 0).all()


def test_a_terrain_model_has_no_heights_where_there_is_neither_ground_nor_water(odd, tmp_path):
    report = model(odd, tmp_path / "a.tif", PMF, cell=1.0, tile=40.0, executor=Here())
    values = jf.Raster.read(tmp_path / "a.tif").values
    once = [path for path in odd.glob("*.laz") if path.name != "00-again.laz"]
    assert report.complete and report.points == sum(len(laspy.read(path)) for path in once)
    water, last = values[:, -55:-28], values[:, -25:]
    assert np.isnan(last).all() and np.isfinite(values[10:80, 10:90]).all()
    assert np.isfinite(water).any() and (water[np.isfinite(water)] == 3).all()


def test_feet_among_metres_end_a_run_before_it_begins(files, tmp_path):
    (tmp_path / "in").mkdir()
    for name, crs in (("m", "EPSG:25832"), ("ft", "EPSG:2263")):
        las_of(tmp_path / "in" / f"{name}.laz", laspy.read(files / "00.laz").xyz, crs=crs)
    for function in (run, heights, model):
        with pytest.raises(jf.InputError, match="different units"):
            function(tmp_path / "in", tmp_path / "out.tif", executor=Here())
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_a_script_that_its_workers_would_run_again_is_told_so(tmp_path, monkeypatch):
    script = tmp_path / "script.py"
    begin = "from jaxfilter.core.process import check_main\nfrom jaxfilter.surveys.executors import Pool\n"
    script.write_text(begin + "print('begun', flush=True)\ncheck_main()\nPool(2).close()\n")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and done.stdout.split() == ["begun"] * 2
    assert "script.py: processes that it starts import it" in done.stderr and 'if __name__ == "__main__"' in done.stderr
    monkeypatch.setattr(multiprocessing.current_process(), "_inheriting", True, raising=False)
    with pytest.raises(jf.JaxfilterError, match="processes that it starts import it"):
        run(tmp_path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_report_and_a_map_lie_beside_the_files(done):
    out, report = done
    facts = json.loads((out / "jaxfilter-run.json").read_text())
    assert facts["complete"] and facts["points"] == report.points and len(facts["files"]) == 4
    assert sum(row["points"] for row in facts["classes"]) == report.points
    image = pytest.importorskip("matplotlib.image").imread(out / "jaxfilter-run.png")
    assert min(image.shape[:2]) > 200 and len(np.unique(image.reshape(-1, image.shape[2]), axis=0)) > 20


def test_the_map_of_one_tile_says_what_was_found(tmp_path, monkeypatch):
    """Figures, and how many places there are; no scale, which would have one colour."""
    seen = []
    monkeypatch.setattr("jaxfilter.plots.footprints", lambda *a, **k: seen.append(footprints(*a, **k)) or seen[-1])
    tiles = np.array([((0.0, 0.0, 9.0, 9.0), 0.25, 0)], TILE)
    report = RunReport(Summary(points=200, ground=50), tiles, ["a.laz"], method="OST")
    report.places = [{"x": 3.0, "y": 4.0, "volume": 5.0}]
    report.draw(tmp_path / "map.png")
    (ax,) = seen
    assert "50 of 200 points are ground (25.0 %)" in ax.get_title() and "OST" in ax.get_title()
    assert "1 places" in ax.get_legend().get_texts()[0].get_text() and len(ax.figure.axes) == 1


def test_a_terrain_model_finds_the_ground_itself(files, done, tmp_path):
    how = {"cell": 1.0, "tile": 40.0}
    found = model(jf.open(str(files)), tmp_path / "a.tif", PMF, executor=Here(), **how)
    made = model(jf.open(str(done[0])), tmp_path / "b.tif", executor=Here(), **how)
    a, b = (jf.Raster.read(tmp_path / name).values for name in ("a.tif", "b.tif"))
    assert found.ground == made.ground and np.array_equal(a, b, equal_nan=True)
    with pytest.raises(jf.InputError, match="no point is ground"):
        model(jf.open(str(files)), tmp_path / "c.tif", executor=Here(), **how)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.tif", "b.tif"]


def test_a_run_that_is_refused_leaves_nothing_behind(files, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "01.laz").write_bytes(b"mine")
    with pytest.raises(jf.OutputError, match="no run was begun"):
        run(files, tmp_path / "out", resume=True)
    assert (tmp_path / "out" / "01.laz").read_bytes() == b"mine"


def test_files_that_could_not_be_reached_are_tried_again(files, done, tmp_path, monkeypatch):
    reach = tiles.read_window

    def broken(source, *arguments, **options):
        if source.uri.endswith("10.laz"):
            raise jf.InputError("no connection")
        return reach(source, *arguments, **options)

    monkeypatch.setattr(tiles, "read_window", broken)
    report = run(files, tmp_path / "out")
    assert [one["reason"] for one in report.failed] == ["no connection"] and len(report.files) == 3
    assert contents(tmp_path / "out") != {n: b for n, b in contents(done[0]).items() if n != "10.laz"}, "no halo there"
    monkeypatch.undo()
    assert run(files, tmp_path / "out", resume=True).complete
    assert contents(tmp_path / "out") == contents(done[0])


def test_heights_of_tiles_are_those_of_the_whole_and_go_on_after_a_stop(done, tmp_path):
    out = tmp_path / "out"
    first = Here(2, stop_after=7)
    with pytest.raises(KeyboardInterrupt):
        heights(str(done[0]), out, tile=40.0, executor=first)
    with pytest.raises(jf.InputError, match="begun with other heights"):
        heights(str(done[0]), out, tile=40.0, executor=Here(), resume=True, replace_z=True)
    second = Here(3)
    report = heights(str(done[0]), out, tile=40.0, executor=second, resume=True)
    assert report.complete and not set(first.calls) & set(second.calls)
    whole, xy = whole_of(done[0]), whole_of(done[0]).coordinates()[:, :2]
    expected = jf.height_above_ground(whole, whole.classification == 2)
    inner = ((xy > xy.min(axis=0) + 20) & (xy < xy.max(axis=0) - 20)).all(axis=1)  # far from the edge
    found = np.concatenate([laspy.read(path)["HeightAboveGround"] for path in sorted(out.glob("*.laz"))])
    np.testing.assert_array_equal(found[inner], expected[inner].astype(np.float32))
    assert inner.mean() > 0.2 and report.heights == pytest.approx((found.min(), found.max()), abs=1e-4)
    assert (report.points, report.ground, report.uncertain) == (len(whole), (whole.classification == 2).sum(), 0)
    assert sorted(p.name for p in out.iterdir() if p.suffix != ".laz") == LEFT


def test_heights_find_the_ground_and_take_the_place_of_z(files, done, tmp_path):
    found = heights(str(files), tmp_path / "a", PMF, replace_z=True, tile=60.0, executor=Here())
    made = heights(str(done[0]), tmp_path / "b", replace_z=True, tile=60.0, executor=Here())
    assert contents(tmp_path / "a") == contents(tmp_path / "b") and found.classes == done[1].classes
    assert found.heights == made.heights and made.classes == {}
    z = np.concatenate([laspy.read(path).z for path in sorted((tmp_path / "a").glob("*.laz"))])
    assert (z.min(), z.max()) == pytest.approx(found.heights, abs=0.006)


def test_tiles_without_any_ground_are_set_aside(files, tmp_path):
    with pytest.raises(jf.InputError, match=r"00\.laz: no point is ground; classify"):
        heights(files / "00.laz", tmp_path / "one.laz")
    report = heights(files, tmp_path / "out", executor=Here())
    assert not report.complete and not report.files and "is ground" in report.set_aside[0]["reason"]


def test_a_terrain_model_goes_on_after_a_stop(files, tmp_path):
    target, how = tmp_path / "dtm.tif", {"cell": 1.0, "tile": 40.0}
    survey = jf.open(str(files))
    first, second = Here(1, stop_after=5), Here(2)
    with pytest.raises(KeyboardInterrupt):
        model(survey, target, PMF, executor=first, **how)
    with pytest.raises(jf.OutputError, match="was begun and is not complete: pass resume=True"):
        model(survey, target, PMF, executor=Here(), **how)
    with pytest.raises(jf.InputError, match="begun with other interpolation"):
        model(survey, target, PMF, executor=Here(), resume=True, interpolation=jf.Interpolation(fill=True), **how)
    facts = tmp_path / ".dtm.tif.jaxfilter-run" / "run.json"
    sound = facts.read_bytes()
    facts.write_bytes(sound[:99])
    with pytest.raises(jf.InputError, match=r"run\.json: is damaged.*pass overwrite=True"):
        model(survey, target, PMF, executor=Here(), resume=True, **how)
    facts.write_bytes(sound)
    report = model(survey, target, PMF, executor=second, resume=True, **how)
    assert len(first.calls) == 5 and len(first.calls) + len(second.calls) == report.tiles
    assert [p.name for p in tmp_path.iterdir()] == ["dtm.tif"]
    whole = whole_of(files)
    expected = jf.dtm(whole, PMF(whole).ground, cell=1.0).values[20:-20, 20:-20]
    assert np.array_equal(jf.Raster.read(target).values[20:-20, 20:-20], expected)


def test_points_on_the_edge_of_a_terrain_model_need_no_cells(tmp_path):
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0.0, 61.0, 2.0), np.arange(0.0, 61.0, 2.0)))
    las_of(tmp_path / "in.laz", np.column_stack([x, y, 0.1 * x]), classification=2)
    target = tmp_path / "dtm.tif"
    report = model(jf.open(str(tmp_path / "in.laz")), target, cell=2.0, tile=30.0, executor=Here())
    assert report.tiles == 16 and report.complete and report.points == report.ground == len(x)
    centres = np.arange(1.0, 60.0, 2.0)
    np.testing.assert_allclose(jf.Raster.read(target).values, np.tile(0.1 * centres, (30, 1)), atol=1e-3)


def test_triangles_at_the_edge_of_the_data_stand_and_those_at_a_void_are_looked_into(tmp_path):
    """No ground within 10 m of the edge, nor in a void of 120 m."""
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0.0, 401.0, 5.0), np.arange(0.0, 121.0, 5.0)))
    z = 0.1 * x + 3 * np.sin(x / 40) * np.cos(y / 30)
    void = (x > 160) & (x < 280) | (abs(x - 200) > 190) | (abs(y - 60) > 50)
    las_of(tmp_path / "in.las", np.column_stack([x, y, z]), classification=np.where(void, 1, 2))
    how = {"cell": 10.0, "units": "m", "tile": 80.0, "executor": Here()}
    report = model(str(tmp_path / "in.las"), tmp_path / "dtm.tif", **how)
    cloud = jf.read(tmp_path / "in.las", units="m", anchor=ANCHOR)
    expected = jf.dtm(cloud, cloud.classification == 2, cell=10.0)
    found = jf.Raster.read(tmp_path / "dtm.tif")
    np.testing.assert_array_equal(found.values[2:-2, 2:-2], expected.values[2:-2, 2:-2])
    assert report.uncertain == 0 and report.complete


@pytest.mark.slow
def test_a_method_that_looks_at_the_whole_first(files, tmp_path):
    """The cloth begins to fall above the lowest point of the whole: windows hold everything, cores do not."""
    csf = jf.CSF(iterations=60, smooth=False)
    labels = csf(whole_of(files)).ground
    assert run(files, tmp_path / "out", filter_=csf, tile=50.0, halo=100.0).complete
    assert np.array_equal(classes_of(tmp_path / "out") == 2, labels)
    report = model(jf.open(str(files)), tmp_path / "dtm.tif", csf, tile=50.0, executor=Here())
    assert report.complete and report.ground == labels.sum()


# the plan of tiles: every point has one core, every window its files


def boxes(n=60, seed=0):
    """Boxes of files, some of which overlap, some of them a point or without points, far from zero."""
    rng = np.random.default_rng(seed)
    low = rng.uniform(0, 5000, (n, 2)) + [3e5, -4e6]
    bounds = np.concatenate([low, low + rng.uniform(0, 900, (n, 2))], axis=1)
    bounds[0, 2:] = bounds[0, :2]
    counts = rng.integers(1, 10**6, n)
    counts[1], bounds[1] = 0, np.nan
    return np.round(bounds, 2), counts


@pytest.mark.parametrize("metre, side, cut", [
    (1.0, None, Cut(35.0, 10.0)), (1.0, None, Cut(0.0, 1.0)), (1.0, None, Cut(60.0, 7.0)), (0.3048, 333.0, Cut(100.0, 1.0)),
])  # fmt: skip
def test_every_point_has_one_core_and_every_window_all_files_that_meet_it(metre, side, cut):
    bounds, counts = boxes()
    plan = plan_tiles(Where.from_files(bounds, counts, metre), cut, side)
    cores = np.array([plan.core(t) for t in range(len(plan))])
    windows = np.array([plan.window(t) for t in range(len(plan))])
    rng = np.random.default_rng(1)
    for file in np.flatnonzero(counts):
        x0, y0, x1, y1 = bounds[file]
        xy = np.concatenate([rng.uniform((x0, y0), (x1, y1), (40, 2)), [(x0, y0), (x1, y1), (x0, y1)]])
        inside = ((xy[:, None] >= cores[:, :2]) & (xy[:, None] < cores[:, 2:])).all(axis=2)
        assert (inside.sum(axis=1) == 1).all()
        assert set(inside.argmax(axis=1)) <= set(plan.tiles_of[file])
        meets = (windows[:, :2] <= (x1, y1)).all(axis=1) & (windows[:, 2:] > (x0, y0)).all(axis=1)
        near = np.array([file in plan.near[t] for t in range(len(plan))])
        assert (near >= meets).all() and all(file in plan.home[t] for t in plan.tiles_of[file])
    halo, steps = cut.halo / metre, windows * metre / cut.lattice
    assert np.allclose(steps, np.round(steps), rtol=0, atol=1e-4), "windows end on the lattice"
    around = np.concatenate([cores[:, :2] - windows[:, :2], windows[:, 2:] - cores[:, 2:]], axis=1)
    assert (around >= halo - 1e-4).all() and (around < halo + cut.lattice / metre + 1e-4).all()
    assert len(plan) > 1 and (side is not None or plan.points.max() <= 1.1 * TILE_POINTS)
    if side is None and not cut.halo:
        assert plan.times_read(counts.sum()) == pytest.approx(1, abs=0.01)


def test_data_of_few_points_are_one_tile_and_larger_ones_are_cut_where_they_are_dense():
    """Two files of a square kilometre with 2 and 22 points per m2: tiles are small in the second."""
    bounds, cut = np.array([[0.0, 0, 1000, 1000], [1000.0, 0, 2000, 1000]]), Cut(20.0, 10.0)
    assert plan_tiles(Where.from_files(bounds[:1], np.array([WHOLE])), cut).whole
    plan = plan_tiles(Where.from_files(bounds, np.array([2_000_000, 22_000_000])), cut)
    assert len(plan) <= 6 and plan.points.max() <= TILE_POINTS and plan.times_read(24_000_000) < 1.15
    area, middle = (plan.cores[:, 2:] - plan.cores[:, :2]).prod(axis=1), plan.cores[:, [0, 2]].mean(axis=1)
    assert area[middle < 1000].min() > 2 * area[middle > 1000].max()


@pytest.mark.parametrize("apart, tiles", [(500.0, 1), (50_000.0, 2)])
def test_files_far_from_each_other_are_no_single_tile(apart, tiles):
    """Of few points, in boxes of 250 m."""
    low = np.array([[3e5, -4e6], [3e5 + apart, -4e6 + apart]])
    where = Where.from_files(np.concatenate([low, low + 250], axis=1), np.full(2, 10**6))
    plan = plan_tiles(where, Cut(100.0, 1.0))
    assert len(plan) == tiles and plan.points.sum() == pytest.approx(2 * 10**6)
    assert (plan.cores[:, 2:] - plan.cores[:, :2]).max() < 2000


def test_tiles_of_a_corridor_that_runs_across_lie_along_it(tmp_path):
    """3 km long and 40 m wide: a box around all of it would be 37 times as large. Labels are those of the whole cloud."""
    rng = np.random.default_rng(5)
    along, across = rng.uniform(0, 3000, 90_000), rng.uniform(0, 40, 90_000)
    xy = np.stack([along - across, along + across], axis=1) / math.sqrt(2)
    xyz = np.column_stack([xy, 5 * np.sin(along / 80) + (rng.random(90_000) < 0.2) * 4]).round(2)
    las_of(tmp_path / "in.las", xyz)
    pmf, metres = jf.PMF(max_window=10.0, low_clusters=False), jf.Reading(units="m")
    report = jf.ground(tmp_path / "in.las", tmp_path / "out.las", pmf, reading=metres)
    assert report.complete and report.tiles > 1
    cores = report.table["core"][:, 2:] - report.table["core"][:, :2]
    assert cores.prod(axis=1).sum() < 0.6 * np.ptp(xyz[:, :2], axis=0).prod()
    whole = pmf.replace(cell=pmf.cell)(jf.read(tmp_path / "in.las", units="m")).ground
    np.testing.assert_array_equal(np.asarray(laspy.read(tmp_path / "out.las").classification) == 2, whole)


def test_what_cannot_be_planned_is_refused():
    where = Where.from_files(np.array([[0.0, 0, 1000, 1000]]), np.array([10**9]))
    with pytest.raises(jf.ParameterError, match="halo=inf"):
        plan_tiles(where, Cut(np.inf, 1.0))
    with pytest.raises(jf.ParameterError, match=r"tile=0\.0"):
        plan_tiles(where, Cut(0.0, 1.0), 0.0)
    with pytest.raises(jf.InputError, match="stray points"):
        plan_tiles(Where.from_files(np.array([[0.0, 0, 1e7, 1e7]]), np.array([10])), Cut(0.0, 1.0), 1.0)
    assert len(plan_tiles(Where.from_files(np.full((1, 4), np.nan), np.array([0])), Cut(10.0, 1.0))) == 0
