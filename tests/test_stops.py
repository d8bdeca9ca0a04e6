"""Commands that are stopped at a change of a file, at every one in turn, and then resumed: the files are those of a run that
nobody has disturbed. Nothing is kept of one small file: in place it is as it was, or as it is to be."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shutil
import sys

import fsspec
import geopandas
import numpy as np
import pytest
import shapely
from las_files import las_of

import jaxfilter as jf
from jaxfilter.core.output import UNFINISHED
from jaxfilter.surveys.kept import WATER_FILE

pytestmark = [
    pytest.mark.usefixtures("plain_maps"),
    pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning"),
]
FILTER = jf.PMF(max_window=10.0, low_clusters=False)
CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.symlink", "os.truncate", "os.chmod")
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC


class Killed(BaseException):
    """Nothing that the process does after it changes a file."""


class Stops:
    """Counts the changes of files below a folder, and ends the process, or what is like it, before the change number ``at``.
    ``seen``: those in which a file gets a name that users see, and the one after which a run in place replaces its inputs.

    ``killed``: no later change succeeds, not those of clean-ups either. ``stopped``: as by Ctrl-C, after which clean-ups work.
    ``full``: no file can be opened to be written from then on, since the disk is full.
    """

    def __init__(self) -> None:
        self.folder, self.count, self.at, self.kind, self.seen = None, 0, 0, "", []
        sys.addaudithook(self.hear)

    def hear(self, event, arguments):
        if self.folder is None or not (event in CHANGES or event == "open"):
            return
        name = arguments[0]
        if isinstance(name, (str, bytes, os.PathLike)) and os.path.isabs(name):
            if not os.fsdecode(name).startswith(self.folder):
                return
        elif event == "open" or isinstance(name, int):
            return
        if event == "open" and not (isinstance(arguments[2], int) and arguments[2] & WRITES):
            return
        self.count += 1
        if event == "os.rename" and (
            arguments[1].endswith("done.json") or ("/." not in arguments[1] and os.path.isabs(arguments[1]))
        ):
            self.seen.append(self.count)
        if self.kind == "killed" and self.count >= self.at:
            raise Killed
        if self.kind == "stopped" and self.count == self.at:
            raise KeyboardInterrupt
        if self.kind == "full" and self.count >= self.at and event in ("open", "os.mkdir"):
            raise OSError(errno.ENOSPC, "No space left on device")

    @contextlib.contextmanager
    def below(self, folder, kind="", at=0):
        """A block in which changes below the folder count."""
        self.folder, self.kind, self.at, self.count, self.seen = str(folder), kind, at, 0, []
        try:
            yield
        except (Killed, KeyboardInterrupt, jf.OutputError):
            if not kind:
                raise
        finally:
            self.folder = None


STOPS = Stops()


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """West and east of a small scene with a house on a slope; some points have classes that are not judged."""
    folder = tmp_path_factory.mktemp("survey")
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 80, 1.25) + 0.2, np.arange(0, 40, 1.25) + 0.2))
    house = (x > 30) & (x < 42) & (y > 15) & (y < 27)
    z = 50 + 0.1 * x + np.where(house, 6.0, 0.0)
    classes = np.where(house, 6, 5).astype(np.uint8)
    classes[::40], classes[7::40] = 9, 2
    for name, rows in (("west", x < 40), ("east", x >= 40)):
        xyz = np.column_stack([x, y, z])[rows] + [500_000, 5_400_000, 0]
        las_of(folder / f"{name}.laz", xyz, classification=classes[rows])
    return folder


READING = jf.Reading(units="m")


def options_of(many, **how):
    """Of a run in several tiles, or in one."""
    return jf.RunOptions(workers=1, **({"tile": 45.0, "wide_halos": True, "halo": 20.0} if many else {}), **how)


def in_place(function, *arguments, **options):
    """A command that writes its inputs: all files, or the east one alone, which is one tile."""

    def act(folder, many, **how):
        what, run = folder if many else folder / "east.laz", options_of(many, in_place=True, **how)
        return function(what, None, *arguments, reading=READING, run=run, **options)

    return act


def into(function, *arguments, review=None, **options):
    """A command that writes other files."""

    def act(folder, many, **how):
        what, out = (folder, folder / "out") if many else (folder / "east.laz", folder / "out.laz")
        more = options | ({} if review is None else {"review": folder / review})
        return function(what, out, *arguments, reading=READING, run=options_of(many, **how), **more)

    return act


def verdicts(folder, many, **how):
    shape = shapely.box(500_028, 5_400_013, 500_045, 5_400_029)
    table = geopandas.GeoDataFrame({"verdict": ["ground"]}, geometry=[shape], crs="EPSG:25832")
    reading, run = jf.Reading(units="m", crs="EPSG:25832"), jf.RunOptions(workers=1, **how)
    return jf.apply_survey(table, folder if many else folder / "west.laz", reading=reading, run=run)


def products(folder, many, **how):
    what = [folder / "west.laz", folder / "east.laz"] if many else folder / "east.laz"
    options = {"only": ["dtm", "hillshade"], "cell": 4.0, "reading": READING}
    return jf.products(what, folder / "made", FILTER, **options, run=options_of(many, **how))


USGS = jf.Classes.preset("usgs")
COMMANDS = {
    "ground-in-place": in_place(jf.ground, FILTER, classes=USGS),
    "heights-in-place": in_place(jf.heights, FILTER, replace_z=True),
    "ground": into(jf.ground, FILTER, classes=USGS, review="places.geojson"),
    "heights": into(jf.heights, FILTER, replace_z=True),
    "apply": verdicts,
    "products": products,
}
FEW = 3
"""Without --slow so many changes of a run are tried, and those beside the names that users see, of runs into other files only
the first; with it all are."""


def contents(folder):
    """What the files hold that a user sees; of the log of verdicts what does not change with the time."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_dir() or any(part.startswith(".") for part in path.parts):
            continue
        if path.name == "verdicts.json":
            found[name] = json.loads(path.read_text())["verdicts"]
        elif path.suffix not in (".json", ".png", ".html"):
            found[name] = path.read_bytes()
    return found


def copy_of(survey, work):
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(survey, work)


def left_over(folder, notes):
    """Hidden files and folders that a run in place has left, but for the unfinished files of a killed one, which stay for a
    day, and, if it ``notes`` what was done, the folder of the run with nothing but that."""
    found = [path for path in folder.rglob(".*") if "out" not in path.parts and "made" not in path.parts]
    kept = {path.name for path in folder.glob(".jaxfilter-run/*")}
    named = [".jaxfilter-run"] if notes and kept <= {"done.json", "lock"} else []
    return [path for path in found if not path.name.startswith(UNFINISHED) and path.name not in named]


@pytest.mark.parametrize("kind", ["killed", "stopped", "full"])
@pytest.mark.parametrize("many", [True, False], ids=["tiles", "one"])
@pytest.mark.parametrize("command", COMMANDS)
def test_a_run_that_is_stopped_at_any_change_of_a_file_and_resumed_has_the_files_of_another(
    survey, tmp_path, request, command, many, kind
):
    work, slow = tmp_path / "work", request.config.getoption("--slow")

    def act(**how):
        return COMMANDS[command](work, many, **how)

    copy_of(survey, work)
    with STOPS.below(work):
        act()
    changes, seen, expected, before = STOPS.count, STOPS.seen, contents(work), contents(survey)
    assert changes > 3 and expected != before
    spread = {round(one) for one in np.linspace(1, changes, changes if slow else FEW)}
    seen, alone_in_place = seen if "in-place" in command else seen[:1], "in-place" in command and not many
    for at in sorted(spread | {change + step for change in seen for step in (0, 1) if change + step <= changes}):
        copy_of(survey, work)
        with STOPS.below(work, kind, at):
            act()
        if "in-place" in command and not all(path.exists() for path in (work / "west.laz", work / "east.laz")):
            pytest.fail(f"an input is gone at change {at}")
        if alone_in_place and contents(work) == expected:
            continue
        left = {name: one for name, one in contents(work).items() if not str(name).endswith(WATER_FILE)}  # comes first
        assert left == before or not alone_in_place, f"{kind} before change {at} of {changes}"
        act(resume=True)
        assert contents(work) == expected, f"{kind} before change {at} of {changes}"
        if "in-place" in command or command == "apply":
            assert left_over(work, command != "apply") == [], f"{kind} before change {at} of {changes}"
        if alone_in_place:
            continue
        act(resume=True)  # what is complete stays as it is
        assert contents(work) == expected, f"{kind} before change {at} of {changes}, resumed twice"


def test_a_complete_run_in_place_is_not_begun_anew_and_other_files_are_not_passed_over(survey, tmp_path):
    work, act = tmp_path / "work", COMMANDS["heights-in-place"]
    copy_of(survey, work)
    act(work, True)
    done = contents(work)
    assert act(work, True, resume=True).was_complete and contents(work) == done
    shutil.copy(survey / "east.laz", work / "new.laz")
    with pytest.raises(jf.InputError, match="begun with other names"):
        act(work, True, resume=True)
    (work / "new.laz").unlink()
    for name in ("east.laz", "west.laz"):
        shutil.copy(survey / name, work / name)
    assert not act(work, True, overwrite=True).was_complete and contents(work) == done


def test_an_input_that_changes_after_all_is_written_is_not_replaced(survey, tmp_path):
    work, act = tmp_path / "work", COMMANDS["heights-in-place"]
    copy_of(survey, work)
    with STOPS.below(work):
        act(work, True)
    copy_of(survey, work)
    with STOPS.below(work, "killed", STOPS.seen[1]):  # the first input is about to be replaced
        act(work, True)
    before = (survey / "east.laz").read_bytes()
    assert (work / ".jaxfilter-run" / "done.json").exists() and (work / "east.laz").read_bytes() == before
    (work / "east.laz").write_bytes(before[:-1] + b"?")
    with pytest.raises(jf.InputError, match=r"east\.laz: was changed after the run in place"):
        act(work, True, resume=True)
    with pytest.raises(jf.OutputError, match="pass resume=True"):
        act(work, True, overwrite=True)
    assert (work / "east.laz").read_bytes() == before[:-1] + b"?"


def test_inputs_in_a_store_are_replaced_once(survey, tmp_path):
    store = fsspec.filesystem("memory")
    for path in survey.iterdir():
        store.pipe(f"/in-place/{path.name}", path.read_bytes())
    local = tmp_path / "work"
    copy_of(survey, local)
    COMMANDS["heights-in-place"](local, True)

    def act(**how):
        run = options_of(True, in_place=True, work=tmp_path, **how)
        return jf.heights("memory://in-place/*.laz", None, FILTER, replace_z=True, reading=READING, run=run)

    for how, done in (({}, False), ({"resume": True}, True)):
        report = act(**how)
        assert report.complete and report.was_complete == done
        assert all(store.cat_file(f"/in-place/{name}") == data for name, data in contents(local).items())


def test_room_for_all_outputs_is_needed_before_one_is_written(survey, tmp_path, monkeypatch):
    work = tmp_path / "work"
    copy_of(survey, work)
    needed, usage = sum(path.stat().st_size for path in survey.iterdir()), shutil.disk_usage(work)
    free = needed // 2
    monkeypatch.setattr(shutil, "disk_usage", lambda place: usage._replace(free=free))
    words = f"{needed / 1e9:.3g} GB, {free / 1e9:.3g} GB are free, {(needed - free) / 1e9:.3g} GB are missing"
    with pytest.raises(jf.OutputError, match=re.escape(words)):
        COMMANDS["heights-in-place"](work, True)
    assert contents(work) == contents(survey)
