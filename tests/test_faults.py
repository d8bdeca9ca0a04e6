"""What happens around the files: inputs that change, outputs that exist, signals and full disks."""

import errno
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import laspy
import numpy as np
import pytest
from click.testing import CliRunner

import jaxfilter as jf
from jaxfilter.cli.commands import main
from jaxfilter.core.errors import InputError, OutputError
from jaxfilter.files import disk as files
from jaxfilter.files import points, reading
from jaxfilter.files.disk import new_file
from jaxfilter.terrain.raster import Raster

KINDS = (".las", ".laz", ".xyz")
SCALE = 0.01


def ticks_of(seed, n=400):
    return np.random.default_rng(seed).integers(10_000, 100_000, (n, 3)).astype(np.int32)


def make(path, ticks=ticks_of(0)):  # noqa: B008
    """A file, by laspy or NumPy, of points of class 1 at multiples of SCALE."""
    if path.suffix == ".xyz":
        np.savetxt(path, ticks * SCALE, fmt="%.2f")
        return path
    las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    las.header.scales = np.full(3, SCALE)
    las.X, las.Y, las.Z = ticks.T
    las.return_number = las.number_of_returns = las.classification = np.ones(len(ticks), np.uint8)
    las.write(path)
    return path


def rule(ticks):
    """Labels that are a function of the coordinates of each point, so that those of other points are noticed."""
    return (ticks.astype(np.int64) @ np.array([7, 13, 29]) >> 3 & 1).astype(bool)


def truth(cloud):
    return rule(np.rint(cloud.coordinates() / SCALE))


def read(path, **options):
    return jf.read(path, units="m", **options)


def names(folder):
    return sorted(p.name for p in folder.iterdir())


# inputs that change


def changed(path, how):
    """Replace a file, or its bytes, or some of them; size and time are those of before as far as they can be."""
    status, other = path.stat(), path.with_name(f"other{path.suffix}")
    if how == "removed":
        path.unlink()
    elif how == "cut":
        os.truncate(path, status.st_size * 2 // 3)
    else:
        make(other, ticks_of(1, {"shorter": 100, "longer": 900}.get(how, 400)))
        os.utime(other, ns=(status.st_atime_ns, status.st_mtime_ns))
        os.replace(other, path)


def at_call(monkeypatch, owner, name, number, action):
    """Do something before the ``number``-th call of a function."""
    original, calls = getattr(owner, name), iter(range(1000))

    def call(*arguments):
        if next(calls) == number:
            action()
        return original(*arguments)

    monkeypatch.setattr(owner, name, call)


@pytest.fixture
def in_parts(monkeypatch):
    """Files are read a hundred points at a time."""
    monkeypatch.setattr(points, "POINTS_AT_ONCE", 100)
    monkeypatch.setattr(points, "RUN_LENGTH", 100)


CHANGES = ("replaced", "shorter", "longer", "cut", "removed")


@pytest.mark.usefixtures("in_parts")
@pytest.mark.parametrize("suffix", KINDS)
@pytest.mark.parametrize("how", CHANGES)
def test_input_that_changes_while_it_is_read(tmp_path, monkeypatch, suffix, how):
    source = make(tmp_path / f"in{suffix}")
    with monkeypatch.context() as patch:
        place = (files, "identify", 1) if suffix == ".xyz" else (reading, "integers", 2 * (suffix == ".las"))
        at_call(patch, *place, lambda: changed(source, how))
        with pytest.raises(InputError, match=r"in\..*changed while it was read"):
            read(source)


# names and what is there


@pytest.mark.parametrize("kind", ["pipe", "device", "socket", "folder"])
@pytest.mark.parametrize("linked", [False, True])
def test_only_regular_files_are_replaced(tmp_path, monkeypatch, kind, linked):
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    path = Path("out.las")
    if kind == "socket":
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(str(path))
    else:
        {"pipe": os.mkfifo, "device": lambda p: p.symlink_to("/dev/null"), "folder": Path.mkdir}[kind](path)
    if linked:
        Path("link.las").symlink_to(path)
        path = Path("link.las")
    before, mode = names(tmp_path), os.stat(path).st_mode
    cloud = jf.PointCloud.from_arrays(ticks_of(0) * SCALE)
    for overwrite in (False, True):
        with pytest.raises(OutputError, match=rf"is a .*{kind}.*, and only regular files"):
            jf.write(path, cloud, truth(cloud), overwrite=overwrite)
    make(Path("in.las"))
    if kind != "folder":  # that of a run over a collection, for the command
        result = CliRunner().invoke(main, ["ground", "pmf", "in.las", str(path), "--overwrite"])
        assert result.exit_code == 2 and "only regular files" in result.stderr
    assert names(tmp_path) == sorted([*before, "in.las"]) and os.stat(path).st_mode == mode


def test_symbolic_links(tmp_path):
    (tmp_path / "there").mkdir()
    link, real = tmp_path / "link.txt", tmp_path / "there" / "real.txt"
    link.symlink_to("there/real.txt")
    with new_file(link) as part:  # a dangling link: the file that it names is made
        part.write_text("new")
    with pytest.raises(OutputError, match="exists; pass overwrite"), new_file(link):
        pass
    with new_file(link, overwrite=True) as part:
        part.write_text("newer")
    assert link.is_symlink() and real.read_text() == "newer" and not real.is_symlink()
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(OutputError, match="cannot be written"), new_file(tmp_path / "a", overwrite=True):
        pass
    assert names(tmp_path / "there") == ["real.txt"] and names(tmp_path) == ["a", "b", "link.txt", "there"]


@pytest.mark.parametrize("length", [244, 255, 256, 1000])
def test_long_names(tmp_path, length):
    path, cloud = tmp_path / ("n" * (length - 4) + ".las"), jf.PointCloud.from_arrays(ticks_of(0) * SCALE)
    if length <= 255:
        for overwrite in (False, True):
            jf.write(path, cloud, truth(cloud), overwrite=overwrite)
        assert names(tmp_path) == [path.name]
        return
    with pytest.raises(OutputError, match="cannot be written: File name"):
        jf.write(path, cloud, truth(cloud))
    result = CliRunner().invoke(main, ["ground", "pmf", str(make(tmp_path / "in.las")), str(path)])
    assert result.exit_code == 2 and "File name too long" in result.stderr and names(tmp_path) == ["in.las"]


def test_permissions(tmp_path):
    old = os.umask(0o027)
    try:
        with new_file(tmp_path / "new") as part:
            part.write_text("new")
        assert (tmp_path / "new").stat().st_mode & 0o777 == 0o640
        (tmp_path / "new").chmod(0o604)
        with new_file(tmp_path / "new", overwrite=True) as part:
            part.write_text("newer")
        assert (tmp_path / "new").stat().st_mode & 0o777 == 0o604
    finally:
        os.umask(old)


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="names of open files come from /proc")
@pytest.mark.parametrize("overwrite", [False, True])
def test_on_disk_before_it_is_named(tmp_path, monkeypatch, overwrite):
    done = []

    def note(name):
        original = getattr(os, name)

        def call(*arguments):
            what = os.readlink(f"/proc/self/fd/{arguments[0]}") if name == "fsync" else arguments[1]
            done.append((name, Path(what).name))
            return original(*arguments)

        monkeypatch.setattr(os, name, call)

    for name in ("fsync", "replace"):
        note(name)
    with new_file(tmp_path / "out", overwrite=overwrite) as part:
        part.write_text("new")
    assert done == [("fsync", "part"), ("replace", "out"), ("fsync", tmp_path.name)]


def test_other_names_of_a_file_that_is_replaced_in_place(tmp_path):
    source = make(tmp_path / "in.las")
    os.link(source, tmp_path / "other.las")
    cloud, before = read(source), source.read_bytes()
    with pytest.warns(
        jf.JaxfilterWarning, match=r"in\.las: has 2 names \(hard links\): only this one gets the new content"
    ):
        jf.write(source, cloud, truth(cloud), in_place=True)
    assert (tmp_path / "other.las").read_bytes() == before != source.read_bytes()
    os.link(source, tmp_path / "third.las")
    result = CliRunner().invoke(main, ["ground", "pmf", str(source), "--in-place", "--units", "m"])
    assert result.exit_code == 0 and "has 2 names (hard links)" in " ".join(result.stderr.split())


@pytest.mark.skipif(sys.platform != "linux", reason="needs names that are any bytes")
def test_names_that_are_not_utf8(tmp_path):
    path, sound = os.fsdecode(bytes(tmp_path) + b"/in\xe9.las"), make(tmp_path / "in.las")
    cloud = read(sound)
    for act in (read, jf.info, jf.open, lambda name: jf.write(name, cloud, None)):
        with pytest.raises(InputError, match=r"in\\xe9\.las: the name of the file is not UTF-8"):
            act(path)
    sound.rename(path)
    for words in ([path, str(tmp_path / "out.las")], [str(tmp_path), str(tmp_path / "out")], [path, "--in-place"]):
        result = CliRunner().invoke(main, ["ground", "pmf", *words])
        assert result.exit_code in (1, 2) and r"in\xe9.las: the name" in result.stderr, result.output
    assert len(names(tmp_path)) == 1


# what killed writers leave


def test_what_killed_writers_leave_is_removed_when_it_is_a_day_old(tmp_path):
    def left(name, age):
        place = tmp_path / f"{files.UNFINISHED}{name}"
        place.mkdir()
        (place / "part").write_bytes(b"")
        for each in (place / "part", place):
            os.utime(each, (time.time() - age,) * 2)
        return place

    old, new, elsewhere = left("old", 90_000), left("new", 80_000), left("moved", 90_000).rename(tmp_path / "elsewhere")
    (link := tmp_path / f"{files.UNFINISHED}link").symlink_to(elsewhere)
    (file := tmp_path / f"{files.UNFINISHED}file").write_text("a file")
    with new_file(tmp_path / "out") as part, pytest.raises(ZeroDivisionError), new_file(tmp_path / "failed") as other:
        assert part.exists() is other.exists() is False and not old.exists()
        part.write_text("out")
        raise ZeroDivisionError
    assert names(tmp_path) == sorted(["out", "elsewhere", new.name, link.name, file.name]) and names(elsewhere) == [
        "part"
    ]


def test_the_demo_passes_over_what_killed_writers_leave(tmp_path):
    (tmp_path / f"{files.UNFINISHED}0").mkdir()
    result = CliRunner().invoke(main, ["demo", str(tmp_path), "--method", "nosuch"])
    assert result.exit_code == 2 and "no method 'nosuch'" in result.stderr


# signals

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture
def not_ignored():
    """Some signals are ignored where tests run in the background."""
    old = [signal.signal(one, signal.SIG_DFL) for one in SIGNALS]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for one, handler in zip(SIGNALS, old, strict=True):
        signal.signal(one, handler)


@pytest.mark.usefixtures("not_ignored")
@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize("suffix, call", [(".las", 0), (".laz", 3), (".laz", 5)])
def test_signals_while_a_file_is_written(tmp_path, monkeypatch, number, suffix, call):
    """In the LAZ encoder an exception passes through code that knows only words."""
    source, target = make(tmp_path / "in.las"), tmp_path / f"out{suffix}"
    before = [signal.getsignal(one) for one in SIGNALS]
    place = (points._Output, "__getattr__") if suffix == ".laz" else (points.Writer, "write")
    at_call(monkeypatch, *place, call, lambda: os.kill(os.getpid(), number))
    result = CliRunner().invoke(main, ["ground", "pmf", str(source), str(target), "--units", "m"])
    assert result.exit_code == 128 + number, result.output
    assert result.stderr.splitlines() == [f"stopped by {number.name}"] and result.stdout == ""
    assert names(tmp_path) == ["in.las"]
    assert [signal.getsignal(one) for one in SIGNALS] == before


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_signal_that_gets_lost_in_a_finaliser_comes_again(tmp_path, monkeypatch):
    class Finaliser:
        def __del__(self):
            signal.raise_signal(signal.SIGTERM)  # os.kill may reach another thread, and this one too late
            time.sleep(0)  # the handler runs here, and what it raises goes nowhere

    at_call(monkeypatch, points.Writer, "write", 0, Finaliser)
    source = make(tmp_path / "in.las")
    result = CliRunner().invoke(main, ["ground", "pmf", str(source), str(tmp_path / "out.las"), "--units", "m"])
    assert result.exit_code == 143 and result.stderr == "stopped by SIGTERM\n"


def test_the_library_installs_no_handlers(tmp_path):
    code = (
        "import signal; before = [signal.getsignal(one) for one in (signal.SIGTERM, signal.SIGINT)]\n"
        "import jaxfilter as jf, numpy as np; from jaxfilter.cli import main\n"
        "c = jf.PointCloud.from_arrays(np.random.rand(50, 3)); jf.write('out.las', c, np.zeros(50, bool))\n"
        "assert before == [signal.getsignal(one) for one in (signal.SIGTERM, signal.SIGINT)]"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)


# full disks

OUTPUTS = (*KINDS, ".tif")


def output(path, cloud):
    if path.suffix in KINDS:
        jf.write(path, cloud, truth(cloud), overwrite=True)
    else:
        noise = np.random.default_rng(0).random((300, 300), np.float32)
        Raster(noise, (1.0, 0.0, 9.0, 0.0, -1.0, 9.0)).write(path, overwrite=True)


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    return read(make(tmp_path_factory.mktemp("large") / "in.las", ticks_of(0, 10_000)))


@pytest.mark.parametrize("suffix", OUTPUTS)
def test_a_file_that_may_grow_no_further(tmp_path, large, suffix):
    old, path = resource.getrlimit(resource.RLIMIT_FSIZE), tmp_path / f"out{suffix}"
    path.write_bytes(b"older")
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, old[1]))
    try:
        with pytest.raises(OutputError, match=r"out\..*: cannot be written: File too large"):
            output(path, large)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
    assert names(tmp_path) == [path.name] and path.read_bytes() == b"older"


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_what_only_the_last_sync_tells(tmp_path, monkeypatch, large, number):
    def fsync(_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(OutputError, match=os.strerror(number)):
        output(tmp_path / "out.las", large)
    assert names(tmp_path) == []
