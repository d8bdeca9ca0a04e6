"""Files on a local disk that appear whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from .errors import OutputError

UNFINISHED = ".jaxfilter-part-"
"""Begins the names of hidden folders in which files lie while they are written."""
_DEAD = 86_400.0  # seconds after which nobody writes to such a folder any more


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A name to write to; the file gets the name ``path`` when the block ends, and vanishes if it fails.

    The file is written in a hidden folder beside ``path``, and has reached the disk before it gets its name. A process that is
    killed leaves that folder; a later write removes it when it is a day old. Raises: OSError.
    """
    remove_dead(path.parent)
    with tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=path.parent, ignore_cleanup_errors=True) as folder:
        part = Path(folder) / "part"
        yield part
        sync(part)
        os.replace(part, path)
        with contextlib.suppress(OSError):  # not every system can
            sync(path.parent)


@functools.lru_cache(1024)  # once in a process
def remove_dead(folder: Path) -> None:
    """Remove what killed processes have left in a folder: hidden folders of unfinished files, a day old and no links."""
    for place in folder.glob(f"{UNFINISHED}*"):
        with contextlib.suppress(OSError):  # no folder, or another process or user has it
            last = max(os.lstat(one).st_mtime for one in (place, *place.iterdir()))
            if time.time() - last > _DEAD and not place.is_symlink():
                shutil.rmtree(place)


@contextlib.contextmanager
def output_errors(path: object) -> Iterator[None]:
    """A block that writes ``path``. Raises: OutputError that names it, when the operating system refuses."""
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error


def sync(path: Path) -> None:
    """Wait until a file or folder has reached the disk."""
    descriptor = os.open(path, os.O_RDWR if sys.platform == "win32" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # a file system that knows no such order
            raise
    finally:
        os.close(descriptor)
