"""What happens around the files: inputs that change, outputs that exist, kills, signals, races and full disks."""

import contextlib
import errno
import os
import resource
import signal
import socket
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import jaxfilter as jf
from experiments.faults import run as faults
from experiments.faults.worker import SCALE, rule
from jaxfilter.cli.commands import main
from jaxfilter.core.errors import InputError, OutputError
from jaxfilter.files import blocks, records, text
from jaxfilter.files import disk as files
from jaxfilter.files.disk import new_file
from jaxfilter.terrain.raster import Raster

KINDS = (".las", ".laz", ".xyz")


def ticks_of(seed, n=400):
    return np.random.default_rng(seed).integers(10_000, 100_000, (n, 3)).astype(np.int32)


def make(path, seed=0, n=400):
    faults.make_cloud(path, ticks_of(seed, n))
    return path


def read(path, **options):
    return jf.read(path, units="m", **options)


def truth(cloud):
    """The labels that belong to the coordinates of a cloud."""
    return rule(np.rint(cloud.coordinates() / SCALE))


def names(folder):
    return sorted(p.name for p in folder.iterdir())


# inputs that change


def replaced(path, seed=1, n=400):
    """By another file of the same size and time, under the same name."""
    status = path.stat()
    other = make(path.with_name(f"other{path.suffix}"), seed, n)
    os.utime(other, ns=(status.st_atime_ns, status.st_mtime_ns))
    os.replace(other, path)


def shorter(path):
    replaced(path, n=100)


def longer(path):
    replaced(path, n=900)


def rewritten(path):
    """In place, with the time set back: only the points tell."""
    status = path.stat()
    other = make(path.with_name(f"other{path.suffix}"), 1)
    content = other.read_bytes()
    other.unlink()
    with open(path, "r+b") as file:
        file.write(content)
    if path.suffix != ".laz":
        assert len(content) == status.st_size
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def cut(path):
    os.truncate(path, path.stat().st_size * 2 // 3)


def removed(path):
    path.unlink()


def at_call(monkeypatch, owner, name, number, action):
    """Do something before the ``number``-th call of a function."""
    original, calls = getattr(owner, name), iter(range(1000))

    def call(*arguments):
        if next(calls) == number:
            action()
        return original(*arguments)

    monkeypatch.setattr(owner, name, call)


CHANGES = (replaced, shorter, longer, rewritten, cut, removed)


@pytest.mark.parametrize("suffix", KINDS)
@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("chunk", [0, 2])
def test_input_that_changes_while_it_is_copied(tmp_path, monkeypatch, suffix, change, chunk):
    source = make(tmp_path / f"in{suffix}")
    cloud = read(source)
    monkeypatch.setattr(records, "CHUNK", 100)
    monkeypatch.setattr(blocks, "RUN", 100)
    at_call(monkeypatch, files.Tally, "add", chunk if suffix == ".las" else 0, lambda: change(source))
    target = tmp_path / ("out.laz" if chunk else f"out{suffix}")
    with (
        contextlib.suppress(InputError)
        if change is rewritten
        else pytest.raises(InputError, match=r"in\..*changed since")
    ):
        jf.write(target, cloud, truth(cloud))
    if target.exists():  # what was to be copied had been read before the change
        found, ground = faults.labelled(target)
        np.testing.assert_array_equal(found, ticks_of(0))
        np.testing.assert_array_equal(ground, rule(found))
    assert set(names(tmp_path)) <= {source.name, target.name}


@pytest.mark.parametrize("suffix", KINDS)
def test_input_that_was_rewritten_with_its_time_set_back(tmp_path, suffix):
    """Nothing but the points differs."""
    source = make(tmp_path / f"in{suffix}")
    cloud = read(source)
    rewritten(source)
    with pytest.raises(InputError, match="changed since the cloud was read; read it again"):
        jf.write(tmp_path / "out.laz", cloud, truth(cloud))
    with pytest.raises(InputError, match="changed since"):
        jf.write(source, cloud, truth(cloud), in_place=True)
    assert names(tmp_path) == [source.name]
    cloud = read(source)
    jf.write(tmp_path / "out.laz", cloud, truth(cloud))
    assert not faults.not_one_of(tmp_path / "out.laz", [ticks_of(1)])


@pytest.mark.parametrize("suffix", KINDS)
@pytest.mark.parametrize("change", CHANGES)
def test_input_that_changes_while_it_is_read(tmp_path, monkeypatch, suffix, change):
    source = make(tmp_path / f"in{suffix}")
    with monkeypatch.context() as patch:
        patch.setattr(records, "CHUNK", 100)
        patch.setattr(blocks, "RUN", 100)
        if suffix == ".xyz":
            at_call(patch, text, "read_text", 0, lambda: change(source))
        else:
            at_call(patch, files.Tally, "add", 2 if suffix == ".las" else 0, lambda: change(source))
        if change is not rewritten:
            with pytest.raises(InputError, match=r"in\..*changed while it was read"):
                read(source)
            return
        with contextlib.suppress(InputError):
            cloud = read(source)
            assert truth(cloud).shape == (400,)
            patch.undo()
            jf.write(tmp_path / "out.las", cloud, truth(cloud))  # all of it came from one version, or it is refused
            assert not faults.not_one_of(tmp_path / "out.las", [ticks_of(0), ticks_of(1)])


def test_a_file_put_back_does_not_mix_two(tmp_path, monkeypatch):
    """Header of one file, points of another, the first back in place at the end."""
    source, other = make(tmp_path / "in.las"), make(tmp_path / "other.las", 1)
    real = records.Header.open

    @contextlib.contextmanager
    def elsewhere(header):
        source.rename(tmp_path / "aside.las")
        other.rename(source)
        try:
            with real(header) as file:
                yield file
        finally:
            source.rename(other)
            (tmp_path / "aside.las").rename(source)

    monkeypatch.setattr(records.Header, "open", elsewhere)
    with pytest.raises(InputError, match="changed while it was read"):
        read(source)


@pytest.mark.parametrize("lines", [2, 8])
def test_another_number_of_points_in_as_many_bytes(tmp_path, lines):
    source, widths = (
        tmp_path / "in.xyz",
        {2: "10.0000000000 20.000000000 30.00000\n", 4: "10.00 20.00 30.00\n", 8: "1 22 333\n"},
    )
    source.write_text(widths[4] * 4)
    cloud, status = read(source), source.stat()
    source.write_text(widths[lines] * lines)
    assert source.stat().st_size == status.st_size
    os.utime(source, ns=(status.st_atime_ns, status.st_mtime_ns))
    for target in ("out.xyz", "out.las"):
        with pytest.raises(InputError, match="changed since"):
            jf.write(tmp_path / target, cloud, truth(cloud))


def test_order_and_bounds_count(tmp_path):
    """The same points in another order are another file."""
    source = make(tmp_path / "in.las")
    bounds = (200.0, 200.0, 800.0, 800.0)
    cloud, status = read(source, bounds=bounds), source.stat()
    jf.write(tmp_path / "out.las", cloud, truth(cloud))
    faults.make_cloud(tmp_path / "turned.las", ticks_of(0)[::-1])
    with open(source, "r+b") as file:
        file.write((tmp_path / "turned.las").read_bytes())
    os.utime(source, ns=(status.st_atime_ns, status.st_mtime_ns))
    with pytest.raises(InputError, match="changed since"):
        jf.write(tmp_path / "again.las", cloud, truth(cloud))
    assert names(tmp_path) == ["in.las", "out.las", "turned.las"]


# names and what is there


def special(folder, kind):
    """Something that is not a regular file, and the word for it."""
    path = folder / "out.las"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/null")
    elif kind == "socket":
        server = socket.socket(socket.AF_UNIX)
        server.bind(str(path))
        server.close()
    else:
        path.mkdir()
    return path


@pytest.mark.parametrize("kind", ["pipe", "device", "socket", "folder"])
@pytest.mark.parametrize("linked", [False, True])
def test_only_regular_files_are_replaced(tmp_path, monkeypatch, kind, linked):
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    path = special(Path(), kind)
    if linked:
        Path("link.las").symlink_to(path)
        path = Path("link.las")
    before, mode = names(tmp_path), os.stat(path).st_mode
    cloud = jf.PointCloud.from_arrays(ticks_of(0) * SCALE)
    for overwrite in (False, True):
        with pytest.raises(OutputError, match=f"is a {kind}, and only regular files"):
            jf.write(path, cloud, truth(cloud), overwrite=overwrite)
    make(Path("in.las"))
    if kind != "folder":  # that of a run over a collection, for the command
        result = CliRunner().invoke(main, ["ground", "pmf", "in.las", str(path), "--overwrite"])
        assert result.exit_code == 2 and "only regular files" in result.stderr
    assert names(tmp_path) == sorted([*before, "in.las"]) and os.stat(path).st_mode == mode


def test_a_target_that_becomes_a_pipe_is_not_replaced(tmp_path):
    path = tmp_path / "out.txt"
    with pytest.raises(OutputError, match="is a pipe"), new_file(path, overwrite=True) as part:
        part.write_text("new")
        os.mkfifo(path)
    assert stat.S_ISFIFO(path.stat().st_mode) and names(tmp_path) == ["out.txt"]


def test_symbolic_links(tmp_path):
    (tmp_path / "there").mkdir()
    link, real = tmp_path / "link.txt", tmp_path / "there" / "real.txt"
    link.symlink_to("there/real.txt")
    with new_file(link) as part:  # a dangling link: the file that it names is made
        assert part.parent.parent == real.parent
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
    path = tmp_path / ("n" * (length - 4) + ".las")
    cloud = jf.PointCloud.from_arrays(ticks_of(0) * SCALE)
    with (
        contextlib.nullcontext() if length <= 255 else pytest.raises(OutputError, match="cannot be written: File name")
    ):
        jf.write(path, cloud, truth(cloud))
    if length <= 255:
        jf.write(path, cloud, truth(cloud), overwrite=True)
    assert names(tmp_path) == ([path.name] if length <= 255 else [])


def test_long_names_are_wrong_usage(tmp_path):
    result = CliRunner().invoke(
        main, ["ground", "pmf", str(make(tmp_path / "in.las")), str(tmp_path / f"{'n' * 300}.las")]
    )
    assert result.exit_code == 2 and "File name too long" in result.stderr


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


@pytest.mark.parametrize("links", [True, False])
def test_a_name_that_is_taken_meanwhile(tmp_path, monkeypatch, links):
    if not links:

        def link(*_):
            raise OSError(errno.EPERM, "no hard links here")

        monkeypatch.setattr(os, "link", link)
    with new_file(tmp_path / "first") as part:
        part.write_text("new")
    assert (tmp_path / "first").read_text() == "new"
    with (
        pytest.raises(OutputError, match="another program made this file meanwhile"),
        new_file(tmp_path / "out") as part,
    ):
        part.write_text("mine")
        (tmp_path / "out").write_text("theirs")
    assert (tmp_path / "out").read_text() == "theirs" and names(tmp_path) == ["first", "out"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_on_disk_before_it_is_named(tmp_path, monkeypatch, overwrite):
    done, path = [], tmp_path / "out"

    def note(owner, name):
        original = getattr(owner, name)

        def call(*arguments):
            what = os.readlink(f"/proc/self/fd/{arguments[0]}") if name == "fsync" else arguments[1]
            done.append((name, Path(what).name))
            return original(*arguments)

        monkeypatch.setattr(owner, name, call)

    if not Path("/proc/self/fd").exists():
        pytest.skip("names of open files come from /proc")
    for name in ("fsync", "link", "replace"):
        note(os, name)
    with new_file(path, overwrite=overwrite) as part:
        part.write_text("new")
    assert done == [("fsync", "part"), ("replace" if overwrite else "link", "out"), ("fsync", tmp_path.name)]


# what killed writers leave


def dead(folder, host=None, age=0.0):
    """What a writer leaves that is killed."""
    place = folder / f".jaxfilter-{host or files._host()}-{len(names(folder)):08x}"
    (place / "aux").mkdir(parents=True)
    for name in ("lock", "part", "aux/more"):
        (place / name).write_bytes(b"")
    for each in (*place.rglob("*"), place):
        os.utime(each, (time.time() - age,) * 2)
    return place


@pytest.mark.parametrize("call", ["mkdir", "open", "flock", "fstat", "fsync", "replace", "scandir", "unlink", "rmdir"])
def test_an_interrupt_at_any_step_leaves_nothing(tmp_path, monkeypatch, call):
    """It comes as soon as the step is done, the first, the second, and so on until there is none."""
    owner = files.fcntl if call == "flock" else os
    original = getattr(owner, call)

    def ours(arguments, options):  # a descriptor, or a name below one, where a folder is emptied
        return isinstance(arguments[0], int) or "dir_fd" in options or ".jaxfilter-" in os.fspath(arguments[0])

    for last in range(20):
        steps = []

        def interrupted(*arguments, steps=steps, last=last, **options):
            result = original(*arguments, **options)
            if call not in ("open", "scandir", "unlink") or ours(arguments, options):
                steps.append(arguments)
                if len(steps) > last:
                    monkeypatch.undo()
                    raise KeyboardInterrupt
            return result

        monkeypatch.setattr(owner, call, interrupted)
        try:
            with new_file(tmp_path / "out", overwrite=True) as part:
                part.write_text("whole")
        except KeyboardInterrupt:
            assert names(tmp_path) in ([], ["out"])
            assert names(tmp_path) == [] or (tmp_path / "out").read_text() == "whole"
        else:
            monkeypatch.undo()
            break
    assert 0 < last < 19 and names(tmp_path) == ["out"]


def test_dead_folders_are_removed_and_no_others(tmp_path):
    gone = [dead(tmp_path), dead(tmp_path, "00000000", age=100_000), tmp_path / f".jaxfilter-{files._host()}-ffffffff"]
    gone[-1].mkdir()  # killed before it had made its lock
    stay = [
        dead(tmp_path, "00000000"),
        tmp_path / ".jaxfilter-notes",
        tmp_path / f".jaxfilter-{files._host()}-eeeeeeee",
    ]
    stay[1].mkdir()
    stay[2].write_text("a file")
    with new_file(tmp_path / "slow") as part, pytest.raises(ZeroDivisionError), new_file(tmp_path / "failed") as other:
        assert part.parent.is_dir() and not any(place.exists() for place in gone)
        part.write_text("slow")
        with new_file(tmp_path / "quick") as third:
            third.write_text("quick")
        assert part.exists() and other.parent.is_dir() and not third.exists()
        raise ZeroDivisionError
    assert (tmp_path / "slow").read_text() == "slow"
    assert names(tmp_path) == sorted(["slow", "quick", *(p.name for p in stay)])


def test_without_locks_nothing_is_taken_for_dead(tmp_path, monkeypatch):
    def flock(*_):
        raise OSError(errno.ENOSYS, "no locks here")

    monkeypatch.setattr(files.fcntl, "flock", flock)
    left = dead(tmp_path)
    with new_file(tmp_path / "out") as part:
        part.write_text("new")
    assert names(tmp_path) == [left.name, "out"]


def test_the_demo_passes_over_dead_folders(tmp_path):
    dead(tmp_path)
    result = CliRunner().invoke(main, ["demo", str(tmp_path), "--method", "nosuch"])
    assert result.exit_code == 2 and "no method 'nosuch'" in result.stderr and names(tmp_path) == []


# signals


@pytest.fixture
def heard():
    """No signal is ignored, as some are where tests run in the background."""
    old = {number: signal.signal(number, signal.SIG_DFL) for number in (signal.SIGTERM, signal.SIGHUP)}
    old[signal.SIGINT] = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in old.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
@pytest.mark.parametrize("suffix, call", [(".las", 0), (".laz", 3), (".laz", 5)])
def test_signals_while_a_file_is_written(tmp_path, monkeypatch, heard, name, suffix, call):
    """In the LAZ encoder an exception passes through code that knows only words."""
    source, target, number = make(tmp_path / "in.las"), tmp_path / f"out{suffix}", signal.Signals[name]
    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    if suffix == ".laz":
        at_call(monkeypatch, records._Recording, "__getattr__", call, lambda: os.kill(os.getpid(), number))
    else:
        at_call(monkeypatch, records.Writer, "write", 0, lambda: os.kill(os.getpid(), number))
    result = CliRunner().invoke(main, ["ground", "pmf", str(source), str(target), "--units", "m"])
    assert result.exit_code == 128 + number, result.output
    assert result.stderr.splitlines() == [f"stopped by {name}"] and result.stdout == ""
    assert names(tmp_path) == ["in.las"]
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)] == before


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_signal_that_gets_lost_in_a_finaliser_comes_again(tmp_path, monkeypatch):
    class Finaliser:
        def __del__(self):
            signal.raise_signal(signal.SIGTERM)  # os.kill may reach another thread, and this one too late
            time.sleep(0)  # the handler runs here, and what it raises goes nowhere

    at_call(monkeypatch, records.Writer, "write", 0, Finaliser)
    source = make(tmp_path / "in.las")
    result = CliRunner().invoke(main, ["ground", "pmf", str(source), str(tmp_path / "out.las"), "--units", "m"])
    assert (
        result.exit_code == 143 and result.stderr == "stopped by SIGTERM; pass --resume to go on\n"
    )  # the output is there


def test_the_library_installs_no_handlers(tmp_path):
    code = (
        "import signal\n"
        "before = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)]\n"
        "import jaxfilter as jf, numpy as np; from jaxfilter.cli import main\n"
        "c = jf.PointCloud.from_arrays(np.random.rand(50, 3)); jf.write('out.las', c, np.zeros(50, bool))\n"
        "assert before == [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)]"
    )
    root = str(Path(__file__).resolve().parents[1])
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path, env={**os.environ, "PYTHONPATH": root})


# full disks


OUTPUTS = (*KINDS, ".tif", ".png", ".npz", ".nc", ".csv")


def output(path, cloud):
    """Write something large of the kind that the suffix says."""
    if path.suffix in KINDS:
        jf.write(path, cloud, truth(cloud), overwrite=True)
        return
    noise = np.random.default_rng(0).random((300, 300))
    if path.suffix == ".tif":
        Raster(noise.astype(np.float32), (1.0, 0.0, 9.0, 0.0, -1.0, 9.0)).write(path, overwrite=True)
    elif path.suffix == ".npz":
        from jaxfilter.sweeps.sweep import _State

        state = object.__new__(_State)
        state.path, state.dirty, state.facts, state.arrays = path, True, {}, {"done": noise}
        state.save()
    else:
        with new_file(path, overwrite=True) as part:
            if path.suffix == ".png":
                from matplotlib.image import imsave

                imsave(part, noise, format="png")
            elif path.suffix == ".nc":
                import xarray

                xarray.Dataset({"a": (("x", "y"), noise)}).to_netcdf(part, engine="scipy")
            else:
                import pandas

                pandas.DataFrame(noise).to_csv(part)


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    return read(make(tmp_path_factory.mktemp("large") / "in.las", n=10_000))


@pytest.mark.parametrize("suffix", OUTPUTS)
def test_a_file_that_may_grow_no_further(tmp_path, large, suffix):
    old, path = resource.getrlimit(resource.RLIMIT_FSIZE), tmp_path / f"out{suffix}"
    path.write_bytes(b"older")
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, old[1]))
    try:
        with pytest.raises(OutputError, match=r"out\..*: cannot be written: the disk is full, or the file too large"):
            output(path, large)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
    assert names(tmp_path) == [path.name] and path.read_bytes() == b"older"


def test_a_full_disk(disk, large):
    small_disk = disk("32k")
    for suffix in OUTPUTS:
        with pytest.raises(OutputError, match=r"the disk is full \(No space left on device\)"):
            output(small_disk / f"out{suffix}", large)
        assert names(small_disk) == [], suffix
    with contextlib.suppress(OSError), open(small_disk / "all", "wb") as file:
        file.write(bytes(2**20))
    with pytest.raises(OutputError, match="the disk is full"):
        output(small_disk / "out.las", large)
    assert names(small_disk) == ["all"]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_what_only_the_last_sync_tells(tmp_path, monkeypatch, large, number):
    def fsync(_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(OutputError, match="the disk is full"):
        output(tmp_path / "out.las", large)
    assert names(tmp_path) == []


# a tenth of the experiment


TENTH = {"kill -9, writing without end": 6, "kill -9, the command": 2, "SIGTERM": 2, "race for one name": 4,
         "input replaced or changed": 4, "full disk": 2}  # fmt: skip


@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=pytest.mark.slow) if "kill" in kind or kind == "SIGTERM" else kind for kind in TENTH],
)
def test_faults(tmp_path, kind):
    """Real processes, see experiments/faults."""
    rows = list(faults.run_all(tmp_path, {kind: TENTH[kind]}, seed=1))
    assert len(rows) == TENTH[kind]
    for row in rows:
        assert not (row["wrong"] or row["lost"] or row["left_over"]), row


def test_the_experiment_sees_what_is_wrong(tmp_path):
    """Unfinished files, labels of other points and rests do not pass."""
    ticks = ticks_of(0)
    path = make(tmp_path / "out.las")
    assert "labels of other points" in faults.not_one_of(path, [ticks])
    cloud = read(path)
    jf.write(tmp_path / "good.las", cloud, truth(cloud))
    assert faults.not_one_of(tmp_path / "good.las", [ticks]) == ""
    assert "no version" in faults.not_one_of(tmp_path / "good.las", [ticks[::-1]])
    os.truncate(path, 2000)
    assert "cannot be read" in faults.not_one_of(path, [ticks]) or "no version" in faults.not_one_of(path, [ticks])
    bench = faults.Bench(tmp_path, np.random.default_rng(0), [], 0)
    assert bench.left_over(path) == "good.las"
