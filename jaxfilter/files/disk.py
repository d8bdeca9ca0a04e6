"""Files that appear whole or not at all, and by what a file is known again."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import functools
import hashlib
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

from ..core.errors import InputError, OutputError, warn
from ..core.reading import Bounds as Bounds
from ..core.reading import check_bounds as check_bounds
from .storage import Place, Remote, new_object

UNFINISHED = ".jaxfilter-part-"
"""Begins the names of hidden folders in which files lie while they are written."""
_DEAD = 86_400.0  # seconds after which nobody writes to such a folder any more
CHANGED_IN_READING = "the file changed while it was read; read it again when it is complete"
CHANGED_SINCE = "the file has changed since the cloud was read; read it again"


@dataclasses.dataclass(frozen=True)
class Identity:
    """What tells a file from another that takes its name, and from itself after a change.

    Attributes:
        device, inode: which file it is; 0 for files that are not on a disk.
        size, modified: bytes and time (ns) of the last change.
        tag: of remote files, instead of the time: their ETag, or what else tells versions apart.
    """

    device: int
    inode: int
    size: int
    modified: int
    tag: str = ""

    @classmethod
    def of(cls, place: int | Place) -> Identity:
        """Of an open file, by its descriptor, or of the file that has a name now. Raises OSError, InputError."""
        if isinstance(place, Remote):
            size, tag = place.status()
            return cls(0, 0, size, 0, tag)
        status = os.stat(place)
        return cls(status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)

    @contextlib.contextmanager
    def kept(self, path: Place, message: str) -> Iterator[None]:
        """A block that reads ``path``. Raises InputError with ``message`` if, when the block ends or fails, the name is
        not that of this file any more or the file was changed: what the block then found wrong is not to be believed."""
        try:
            yield
        except Exception as error:
            if self._lost(path):
                raise InputError(f"{path}: {message}") from error
            raise
        if self._lost(path):
            raise InputError(f"{path}: {message}")

    def _lost(self, path: Place) -> bool:
        try:
            return Identity.of(path) != self
        except (OSError, InputError):
            return True


@dataclasses.dataclass(frozen=True)
class Seal:
    """By which a file that a run has written is known again.

    Attributes:
        size: bytes; checksum: a hash of them, None for remote files.
        status: numbers that change with every change of the file; where they have changed, the checksum decides.
    """

    size: int
    checksum: str | None
    status: Sequence[int | str]

    @classmethod
    def of(cls, place: Place) -> Seal:
        """Of a file that was just written. Raises OSError, InputError."""
        size, status = _state(place)
        return cls(size, None if isinstance(place, Remote) else _checksum(place), status)

    def broken(self, place: Place) -> str | None:
        """In words, what is wrong with the file that has this name now; None if it is the one that was sealed."""
        try:
            size, status = _state(place)
            if size != self.size:
                return f"has {size:,} bytes instead of {self.size:,}"
            same = status == list(self.status) or (isinstance(place, Path) and self.checksum == _checksum(place))
            return None if same else "was changed"
        except (OSError, InputError):
            return "is missing"


def _state(place: Place) -> tuple[int, list[int | str]]:
    known = Identity.of(place)
    changed = 0 if isinstance(place, Remote) else os.stat(place).st_ctime_ns
    return known.size, [known.inode, known.modified, changed, known.tag]


def _checksum(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "blake2b").hexdigest()[:32]


def check_suffix(place: Place, suffixes: Sequence[str]) -> Place:
    """The place. Raises: OutputError if its name is that of another kind of file."""
    if place.suffix.lower() not in suffixes:
        raise OutputError(f"{place}: the suffix must be one of {', '.join(suffixes)}")
    return place


def existing(path: Path) -> os.stat_result | None:
    """Status of the regular file that an output of this name would replace, also through a symbolic link; None if there is
    none. Raises: OutputError if the name stands for something else (folder, pipe, device, socket) or cannot be used."""
    try:
        status = os.stat(path)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
    if not stat.S_ISREG(status.st_mode):
        kind = "folder" if stat.S_ISDIR(status.st_mode) else "pipe, device or socket"
        raise OutputError(f"{path}: is a {kind}, and only regular files are replaced; name another file")
    return status


def is_there(place: Place) -> bool:
    """Whether an output of this name would replace a file. Raises: OutputError as :func:`existing`, or if a store refuses."""
    if not isinstance(place, Remote):
        return existing(place) is not None
    try:
        return place.exists()
    except InputError as error:
        raise OutputError(str(error)) from error


_REASONS = dict.fromkeys((errno.ENOSPC, errno.EDQUOT), "the disk is full") | {
    errno.EFBIG: "the disk is full, or the file too large for it",
    errno.ELOOP: "a link in it is not followed: remove it",
}
_OTHERS = stat.S_IWGRP | stat.S_IWOTH  # permissions of others than the owner to write


@contextlib.contextmanager
def opened(place: Place, sequential: bool = False) -> Iterator[tuple[BinaryIO, Identity]]:
    """An open file and its identity; ``sequential``: it is read from end to end. Raises: InputError, OSError."""
    if isinstance(place, Remote):
        identity = Identity.of(place)
        with place.open(sequential) as file:
            yield file, identity
    else:
        with open(place, "rb") as file:
            yield file, Identity.of(file.fileno())


@contextlib.contextmanager
def new_file(
    path: Place,
    *,
    overwrite: bool = False,
    in_place: bool = False,
    source: Place | None = None,
    into: Path | None = None,
) -> Iterator[Path]:
    """A name to write to; the file gets the name ``path`` when the block ends, and vanishes if it fails.

    The file is written in a hidden folder beside ``path``, and has reached the disk before it gets its name. A process that is
    killed leaves that folder; a later write removes it when it is a day old. What ``path`` replaces gives it its permissions.
    A symbolic link stays, and the file that it names is written; that may be a new one. A remote file is written to a local
    disk first and then sent.

    ``into``: a local file that is written in place of ``path``, and whose content is to take that name later. Errors name
    ``path``, the permissions are its own, and an older file ``into`` is replaced.

    Raises: OutputError if ``path`` is the ``source`` and not ``in_place``, if it exists and not ``overwrite``, if it is
    not a regular file, or if the operating system refuses (folder missing, disk full, no permission, name too long).
    Warns: of a file with several names that is replaced in place.
    """
    one = OutputError(f"{path}: output and input are one file; pass in_place=True to replace it")
    if isinstance(path, Remote) and into is None:
        if path == source and not in_place:
            raise one
        with new_object(path, overwrite or path == source) as part:
            yield part
        return
    final = into if into is not None else Path(os.path.realpath(path))  # type: ignore[arg-type]
    with output_errors(path):
        status = None if isinstance(path, Remote) or into else existing(path)
        mine = status is not None and isinstance(source, Path) and os.path.samestat(status, os.stat(source))
        if mine and not in_place:
            raise one
        if status is not None and not mine and not overwrite:
            raise OutputError(f"{path}: the file exists; pass overwrite=True to replace it")
        remove_dead(final.parent)
        with tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=final.parent, ignore_cleanup_errors=True) as folder:
            part = Path(folder) / "part"
            yield part
            sync(part)
            if isinstance(path, Path) and existing(path) is not None:
                if not (mine or overwrite or into):
                    hint = "pass overwrite=True to replace it, or name another"
                    raise OutputError(f"{path}: another program made this file meanwhile; {hint}")
                if mine:
                    warn_of_names(path)
                shutil.copymode(path, part)
            os.replace(part, final)
            with contextlib.suppress(OSError):  # not every system can
                sync(final.parent)


def warn_of_names(path: Path) -> None:
    """Warn if a file that is to be replaced has other names, which keep what it holds now."""
    if (status := existing(path)) is not None and status.st_nlink > 1:
        warn(f"{path}: has {status.st_nlink} names (hard links): only this one gets the new content")


@functools.lru_cache(1024)  # once in a process
def remove_dead(folder: Path) -> None:
    """Remove what killed processes have left in a folder: hidden folders of unfinished files, a day old and no links."""
    for place in folder.glob(f"{UNFINISHED}*"):
        with contextlib.suppress(OSError):  # no folder, or another process or user has it
            last = max(os.lstat(one).st_mtime for one in (place, *place.iterdir()))
            if time.time() - last > _DEAD and not place.is_symlink():
                shutil.rmtree(place)


@contextlib.contextmanager
def output_errors(path: Place) -> Iterator[None]:
    """A block that writes ``path``. Raises: OutputError that names it, when the operating system refuses."""
    try:
        yield
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        reason = error.strerror or str(error)
        if known := _REASONS.get(error.errno or 0):
            reason = f"{known} ({reason})"
        raise OutputError(f"{path}: cannot be written: {reason}") from error


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


def check_own(folder: Path, make: bool = False) -> None:
    """A hidden folder is this user's own, or there is none; with ``make`` it is made, for the user alone. Raises: OutputError if
    something else has this name, a link, a file, or what another user owns or may write to; or if it cannot be made."""
    with output_errors(folder):
        if make:
            folder.mkdir(0o700, parents=True, exist_ok=True)
        elif not os.path.lexists(folder):
            return
        facts, known = os.lstat(folder), None
        if hasattr(os, "getuid") and (facts.st_uid != os.getuid() or facts.st_mode & _OTHERS):
            with tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=folder.parent) as made:
                known = os.lstat(made)  # some disks know one owner, or no permissions
    what = None
    if not stat.S_ISDIR(facts.st_mode):
        what = "is a link, which is not followed" if stat.S_ISLNK(facts.st_mode) else "is no folder"
    elif known is not None and (known.st_uid, known.st_mode & _OTHERS) != (facts.st_uid, facts.st_mode & _OTHERS):
        what = f"belongs to another user (number {facts.st_uid}), or others may write to it"
    if what is not None:
        raise OutputError(f"{folder}: {what}: remove it if nobody needs it, or name another output")
