"""Runs pytest again and again in forks of one process that has imported what the tests need, except the package itself.

Each line of standard input is a task; the answer is a line with the exit status, negative for a signal.
"""

import contextlib
import importlib
import json
import os
import resource
import signal
import sys

import pytest

BEFORE = (
    "jax jax.numpy jax.scipy numba scipy.spatial scipy.sparse scipy.ndimage scipy.optimize scipy.stats laspy lazrs pyproj pandas "
    "xarray matplotlib.pyplot rasterio geopandas click.testing sybil hypothesis fsspec psutil"
)
MEMORY = 4 * 2**30
"""Bytes that a changed program may take."""


def run(task: dict) -> None:
    """In the fork: a group of processes of its own, that ends after a time whatever it does."""
    os.setsid()
    for number, name, how in ((0, os.devnull, os.O_RDONLY), (1, task["said"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)):
        os.dup2(os.open(name, how), number)
    os.dup2(1, 2)
    os.environ.update(task["environment"])
    os.chdir(task["tree"])
    sys.path.insert(0, task["tree"])
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    signal.alarm(task["limit"])
    code = 3
    try:
        code = int(pytest.main(task["arguments"]))
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def main() -> None:
    """Import, then serve."""
    for name in BEFORE.split():
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    for line in sys.stdin:
        child = os.fork()
        if not child:
            run(json.loads(line))
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        with contextlib.suppress(ProcessLookupError):  # what the tests started
            os.killpg(child, signal.SIGKILL)
        print(status, flush=True)


if __name__ == "__main__":
    main()
