"""What messages advise works: each command is refused or warned, and then repeated as its message says."""

from __future__ import annotations

import errno
import os
import re
import shlex
import shutil
import struct
from pathlib import Path

import laspy
import numpy as np
import pytest
from commands import run
from las_files import las_of

import jaxfilter as jf
from jaxfilter.files import points
from jaxfilter.surveys.store import Store

pytestmark = pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
PACKAGE = Path(jf.__file__).parent


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Small files of a plane, for each thing that messages are about."""
    import geopandas
    import shapely

    folder = tmp_path_factory.mktemp("made")
    (folder / "in").mkdir()
    rng = np.random.default_rng(2)
    xyz = np.column_stack([rng.uniform(0, 60, (2000, 2)), rng.uniform(0, 0.1, 2000)])
    xyz[::10, 2] += 3
    classes = np.where(np.arange(2000) % 10 == 0, 5, 2)
    for name, shift in (("a", 0), ("b", 60)):
        las_of(folder / "in" / f"{name}.laz", xyz + [shift, 0, 0], classification=0)
    las_of(folder / "labelled.las", xyz, classification=classes)
    las_of(folder / "stray.las", np.concatenate([xyz, [[3e5, 0, 0]]]), classification=0)
    las_of(folder / "old.las", xyz, 1, classification=0)
    las_of(folder / "degrees.las", np.column_stack([xyz[:, :2] / 1e3, xyz[:, 2] * 50]), scales=1e-7, classification=0)
    cloud = jf.PointCloud.from_arrays(xyz, crs="EPSG:25832")
    jf.write(folder / "utm.las", cloud, None)
    feet = struct.pack("<8H", 1, 1, 0, 1, 3076, 0, 1, 9003)
    las = las_of(None, xyz + [60, 0, 0], 1, classification=2)
    las.vlrs.append(laspy.VLR("LASF_Projection", 34735, record_data=feet))
    las.write(folder / "feet.las")
    np.savetxt(folder / "plain.txt", xyz, fmt="%.3f")
    np.savetxt(folder / "nan.txt", np.concatenate([xyz, [[np.nan, 1, 1]]]), fmt="%.3f")
    area = geopandas.GeoSeries([shapely.box(5, 5, 50, 50)], crs=25832)
    area.to_file(folder / "area.gpkg")
    (folder / "full").mkdir()
    (folder / "full" / "something.txt").touch()
    return folder


PMF = "--max-window 9 -q"
CASES = {  # a command; words of what it says; and what is added to it, or put in place of other words
    "units": (f"ground pmf in/a.laz out.laz {PMF}", "pass --units if that is wrong", "--units m --overwrite"),
    "crs": (f"ground pmf in/a.laz out.laz {PMF}", "or pass --crs", "--crs EPSG:25832 --overwrite"),
    "units of degrees": (f"ground pmf degrees.las out.las {PMF}", "or pass --units if X and Y are lengths", "--units m"),
    "overwrite a file": (f"ground pmf in/a.laz labelled.las {PMF}", "pass --overwrite to replace it", "--overwrite"),
    "in place": (f"ground pmf utm.las utm.las {PMF}", "pass --in-place to replace it", "utm.las utm.las > utm.las --in-place"),
    "no output": (f"ground pmf utm.las {PMF}", "or pass --in-place", "--in-place"),
    "overwrite a folder": (f"ground pmf in full {PMF}", "or pass --overwrite to begin anew", "--overwrite"),
    "overwrite a raster": ("dtm labelled.las there.tif -q", "pass --overwrite", "--overwrite"),
    "resume products": ("products labelled.las had --ground-class 2 --only dtm -q", "or pass --resume to go on", "--resume"),
    "overwrite products": ("products labelled.las had --ground-class 2 --only dtm -q", "pass --overwrite", "--overwrite"),
    "overwrite what is complete": ("ground pmf utm.las there.las --resume", "Pass --overwrite",
                                   "--resume > --overwrite"),
    "stray points": (f"ground pmf stray.las out.las {PMF} --units m", "or pass --bounds to read", "--bounds 0 0 60 60"),
    "other bounds": (f"ground pmf utm.las out.las {PMF} --bounds 900 900 990 990", "pass other --bounds within",
                     "900 900 990 990 > 0 0 50 50"),
    "bounds of a raster": ("dtm labelled.las out.tif -q --bounds 900 900 990 990", "pass other --bounds within",
                           "900 900 990 990 > 0 0 50 50"),
    "invalid text": (f"ground pmf nan.txt out.txt {PMF}", "or pass --drop-invalid", "--drop-invalid"),
    "area of text": (f"ground pmf plain.txt out.txt {PMF} --aoi area.gpkg", "pass --bounds",
                     "--aoi area.gpkg > --bounds 5 5 50 50"),
    "area and no CRS": (f"ground pmf in/a.laz out.laz {PMF} --aoi area.gpkg", "pass --crs to state it", "--crs EPSG:25832"),
    "small tiles": (f"ground pmf utm.las out.las {PMF} --tile 5 --halo 20", "pass --tile with more", "--tile 5 > --tile 60"),
    "no tiles": (f"ground pmf utm.las out.las {PMF} --tile 5 --halo 20", "leave it out", "--tile 5 > "),
    "wide halos": (f"ground pmf utm.las out.las {PMF} --tile 15 --halo 20", "or pass --wide-halos", "--wide-halos"),
    "memory": (f"ground pmf utm.las out.las {PMF} --memory 1MB", "pass --memory with more", "1MB > 1GB"),
    "no ground": ("dtm in/a.laz out.tif -q", "or --filter smrf", "--filter smrf"),
    "no ground for heights": ("height in/a.laz out.laz -q", "or --filter smrf", "--filter smrf"),
    "no lines": ("contours labelled.las out.gpkg -q --interval 500", "pass a smaller --interval", "500 > .02"),
    "too many lines": ("contours labelled.las out.gpkg -q --interval 1e-7", "pass a larger --interval", "1e-7 > .05"),
    "a gap": ("dtm labelled.las out.tif -q --max-gap 1e-6", "pass a larger --max-gap", "1e-6 > 5"),
    "no filter": ("dtm labelled.las out.tif -q --for-cloud", "need --filter METHOD", "--filter smrf"),
    "own labels": ("report labelled.las out.html -q --reference own", "pass --filter METHOD", "--filter pmf"),
    "votes": ("sweep pmf in/a.laz sets --axis slope=.5,1", "pass --votes", "--votes"),
    "drawn ranges": ("sweep pmf labelled.las sets --axis slope=.1..1", "needs --design random or sobol, and --size",
                     "--design random --size 2"),
    "another sweep": ("sweep pmf labelled.las swept --axis slope=.5,2", "--fresh replaces it", "--fresh"),
    "a demo": ("demo full --size 40 30", "or pass --overwrite", "--overwrite"),
    "a large raster": ("dtm labelled.las out.tif -q --cell .0005", "pass a larger --cell", ".0005 > 1"),
    "other units": ("dtm labelled.las feet.las out.tif -q", "or pass --units if one", "--units m"),
}  # fmt: skip


def words_of(line: str, added: str) -> list[str]:
    """A command with words added, or, by >, put in place of others."""
    old, arrow, new = added.partition(" > ") if " > " in added else (added, "", "")
    return shlex.split(line.replace(old, new) if arrow else f"{line} {added}")


@pytest.mark.parametrize("name", CASES)
def test_what_a_message_advises_is_done(made, tmp_path, monkeypatch, name):
    line, message, added = CASES[name]
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    if "there" in line:
        run("ground", "pmf", "utm.las", "there.las", "-q")
        run("dtm", "labelled.las", "there.tif", "-q", "--units", "m")
    if "had" in line:
        run("products", "labelled.las", "had", "--ground-class", 2, "--only", "dtm", "-q")
    if "swept" in line:
        run("sweep", "pmf", "labelled.las", "swept", "--axis", "slope=.5,1")
    first = run(*shlex.split(line))
    assert message in " ".join(first.output.split()), first.output
    second = run(*words_of(line, added))
    assert second.exit_code == 0 and message not in " ".join(second.output.split()), second.output


@pytest.mark.parametrize("line", [
    f"ground pmf in/a.laz out.laz --tile 500 --units m {PMF}", f"ground pmf in out --units m {PMF}",
    f"ground pmf in out --tile 20 --wide-halos --workers 1 --units m {PMF}",
])  # fmt: skip
def test_a_run_whose_disk_was_full_goes_on_with_resume(made, tmp_path, monkeypatch, line):
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    for kind, name in ((points.Writer, "write"), (Store, "put")):
        with monkeypatch.context() as full:
            full.setattr(kind, name, no_room)
            first = run(*shlex.split(line))
        assert first.exit_code == 1 and "No space left" in first.stderr and "make room on the disk" in first.stderr
        words = shlex.split(line) + ["--resume"] * ("pass --resume to go on" in first.stderr)
        assert run(*words).exit_code == 0
        piped = run(*words, "--overwrite")
        shutil.rmtree("out", ignore_errors=True)
        Path("out.laz").unlink(missing_ok=True)
        assert piped.exit_code == 0


def no_room(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_nothing_is_advised_that_standard_output_refuses(made, monkeypatch):
    monkeypatch.setattr(points.Writer, "write", no_room)
    line = f"ground pmf {made}/in/a.laz - --tile 20 --wide-halos --workers 1 --units m {PMF}"
    assert "make room" in run(*shlex.split(line)).stderr and "resume" not in run(*shlex.split(line)).stderr


def test_other_messages_advise_what_works(made, tmp_path):
    """Of classes that a point format cannot hold, of doubt, and of functions."""
    words = ("ground", "pmf", made / "old.las", tmp_path / "out.las", "-q", "--max-window", 9, "--ground-class", 40)
    assert "laspy.convert(las, point_format_id=6)" in run(*words).stderr
    laspy.convert(laspy.read(made / "old.las"), point_format_id=6).write(tmp_path / "new.las")
    assert run(*words[:2], tmp_path / "new.las", *words[3:]).exit_code == 0
    assert run("dtm", made / "labelled.las", tmp_path / "dtm.tif", "-q").exit_code == 0
    stated = ("accuracy", made / "labelled.las", tmp_path / "dtm.tif", tmp_path / "out.html", "--overwrite")
    assert "jaxfilter ground --extra doubt" in run(*stated).stderr
    doubt = run("ground", made / "labelled.las", tmp_path / "doubt.las", "--extra", "doubt", "-q")
    assert doubt.exit_code == 0 and "--extra" not in run(stated[0], tmp_path / "doubt.las", *stated[2:]).stderr
    cloud, rows = jf.read(made / "labelled.las", units="m"), np.arange(2000)
    nan = np.where(rows[:, None] == 3, np.nan, cloud.coordinates())
    calls = {
        "drop_invalid=True": lambda **how: jf.PointCloud.from_arrays(nan, **how),
        "heights=": lambda **how: jf.write(tmp_path / "h.las", cloud, None, replace_z=True, **how),
        "result=": lambda **how: jf.height_above_ground(jf.PointCloud.from_arrays(cloud.coordinates()), **how),
        "classes=": lambda **how: jf.evaluate(rows > 9, rows > 5, ignore_classes=[7], **how),
        "bounds=": lambda **how: jf.dtm(jf.PointCloud.from_arrays(np.zeros((0, 3))), np.zeros(0, bool), **how),
    }
    values = {"heights": np.zeros(2000), "result": rows > 9, "classes": rows % 9, "bounds": (0, 0, 9, 9)}
    for advice, call in calls.items():
        with pytest.raises(jf.JaxfilterError, match=f"pass {advice}"):
            call()
        name = advice.partition("=")[0]
        call(**{name: values.get(name, True)})


def test_every_option_that_a_message_advises_is_tried():
    """Here, or in tests of stopped runs (resume), of URLs (work), of calibration (block) and of workers."""
    text = " ".join(path.read_text() for path in PACKAGE.rglob("*.py"))
    advised = set(re.findall(r"pass (?:an? |smaller |larger |other )*(?:--)?([a-z_]+)=", text))
    tried = Path(__file__).read_text()
    elsewhere = {"resume", "work", "block"}
    left = {one for one in advised - elsewhere if f"--{one.replace('_', '-')}" not in tried and f'"{one}=' not in tried}
    assert not left
