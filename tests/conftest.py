"""Where the ISPRS samples are, if they are anywhere; filters from other files."""

import functools
import os
import runpy
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import platformdirs
import pytest

os.environ.setdefault("NUMBA_CACHE_DIR", str(Path(platformdirs.user_cache_dir("jaxfilter"), "numba")))
"""Tests that move JAXFILTER_CACHE, to see what JAX compiles, need not compile the host loops anew."""

if (_SHARED := Path(__file__).parents[2] / "shared" / "data").is_dir():
    os.environ.setdefault("JAXFILTER_DATA", str(_SHARED))


def pytest_addoption(parser):
    parser.addoption("--filter-file", action="append", default=[], help="Python file with a filter to test like ours")


def pytest_configure(config):
    for path in config.getoption("--filter-file"):
        runpy.run_path(path, run_name="filter_file")  # the class registers itself


@pytest.fixture(scope="session")
def data():
    """The folder with isprs/, isprs_sites/ and tiles/, as of ``jf.datasets.home``."""
    import jaxfilter as jf

    try:
        place = jf.datasets.home()
    except jf.InputError:
        place = Path()
    if not (place / "isprs" / "samp11.txt").exists():
        pytest.skip(
            "the ISPRS samples are not here: point JAXFILTER_DATA to a folder with isprs/samp11.txt and the rest"
        )
    return place


@pytest.fixture(scope="session")
def sample(data):
    """Reads an ISPRS sample by its number.

    ``own_corner``: its grids count from its lower left corner, as in the papers whose figures are compared with.
    """
    import jaxfilter as jf

    @functools.cache
    def read(number, own_corner=False):
        path = data / "isprs" / f"samp{number}.txt"
        cloud = jf.read(path)
        return jf.read(path, anchor=cloud.coordinates()[:, :2].min(axis=0)) if own_corner else cloud

    return read


@pytest.fixture(scope="session")
def town():
    """A small simulated town with every kind of object, 9 000 pulses."""
    from jaxfilter import scenes

    return scenes.make("town", size=(90, 80), density=1.3, seed=4)


@pytest.fixture(scope="session")
def scene():
    """A small simulated scene for the commands; other tests have scenes of their own."""
    from jaxfilter import scenes

    return scenes.make("mixed", size=(60.0, 60.0), density=1.0, seed=3)


@pytest.fixture
def private_folder():
    """A folder that only the user may write to or replace: those in the system's temporary folder are none, and not used for
    compiled code."""
    home = platformdirs.user_cache_path("jaxfilter")
    home.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=home) as folder:
        yield Path(folder)


@pytest.fixture
def rng():
    return np.random.default_rng(20210)


@pytest.fixture
def disk(tmp_path):
    """A function that mounts a disk of a size, such as "32k", or makes it larger, and returns its folder."""
    folder = tmp_path / "disk"

    def mounted(size):
        options = f"remount,size={size}" if folder.exists() else f"size={size}"
        folder.mkdir(exist_ok=True)
        mount = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder]
        if not sys.platform.startswith("linux") or subprocess.run(mount, capture_output=True).returncode:
            pytest.skip("a small disk cannot be mounted here")
        return folder

    yield mounted
    subprocess.run(["umount", folder], capture_output=True)


@pytest.fixture
def plain_maps(monkeypatch):
    """Maps are put together and not rendered, which takes longer than a small run."""
    monkeypatch.setattr(
        "matplotlib.figure.Figure.savefig",
        lambda figure, place, **how: (place.write if hasattr(place, "write") else Path(place).write_bytes)(b"map"),
    )
