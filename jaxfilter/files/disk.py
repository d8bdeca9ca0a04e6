"""Files that appear whole or not at all, and by what a file is known again."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO, cast

from ..core.errors import InputError, OutputError, warn
from ..core.output import UNFINISHED, output_errors, replacing
from .storage import Place, Remote

CHANGED_IN_READING = "the file changed while it was read; read it again when it is complete"
CHANGED_SINCE = "the file has changed since the cloud was read; read it again"


@dataclasses.dataclass(frozen=True)
class Identity:
    """What tells a file from another that takes its name, and from itself after a change."""

    device: int
    inode: int  # this and the device are 0 for files that are not on a disk
    size: int  # bytes
    modified: int  # time of the last change, ns
    tag: str = ""  # of remote files, instead of the time: their ETag, or what else tells versions apart


def identify(place: int | Place) -> Identity:
    """The identity of an open file, by its descriptor, or of the file that has a name now. Raises OSError, InputError."""
    if isinstance(place, Remote):
        size, tag = place.status()
        return Identity(0, 0, size, 0, tag)
    status = os.stat(place)
    return Identity(status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)


@contextlib.contextmanager
def opened(
    place: Place, known: Identity | None = None, changed: str = CHANGED_IN_READING
) -> Iterator[tuple[BinaryIO, Identity]]:
    """An open file and its identity.

    Raises: OSError; InputError if it is no regular file; InputError with the words ``changed`` if it is not the ``known`` one,
    or if, when the block ends or fails, the name is that of another file or the file was changed: what the block then found
    wrong is not to be believed.
    """
    remote = isinstance(place, Remote)
    with place.open() if isinstance(place, Remote) else open(place, "rb") as file:
        if not remote and not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            what = "is a pipe or a device, and only regular files are read; save it as a file first"
            raise InputError(f"{place}: {what}")
        identity = identify(place if remote else file.fileno())
        if known is not None and identity != known:
            raise InputError(f"{place}: {changed}")
        try:
            yield file, identity
        except Exception as error:
            if not _is_still(place, identity):
                raise InputError(f"{place}: {changed}") from error
            raise
        if not _is_still(place, identity):
            raise InputError(f"{place}: {changed}")


def _is_still(place: Place, identity: Identity) -> bool:
    try:
        return identify(place) == identity
    except (OSError, InputError):
        return False


@dataclasses.dataclass(frozen=True)
class Seal:
    """By which a file that a run has written is known again."""

    size: int  # bytes
    checksum: str  # a hash of them, or the tag of a remote file
    status: Sequence[int]  # of a local file: changes with every change of it; only then the checksum is computed again

    def broken(self, place: Place) -> str | None:
        """In words, what is wrong with the file that has this name now; None if it is the one that was sealed."""
        try:
            if isinstance(place, Path) and _status(place) == (self.size, list(self.status)):
                return None
            found = seal_file(place)
        except (OSError, InputError):
            return "is missing"
        if found.size != self.size:
            return f"has {found.size:,} bytes instead of {self.size:,}"
        return None if found.checksum == self.checksum else "was changed"


def seal_file(place: Place) -> Seal:
    """The seal of a file that was just written. Raises OSError, InputError."""
    if isinstance(place, Remote):
        return Seal(*place.status(), ())
    size, status = _status(place)
    with open(place, "rb") as file:
        return Seal(size, hashlib.file_digest(file, "blake2b").hexdigest()[:32], status)


def _status(path: Path) -> tuple[int, list[int]]:
    facts = os.stat(path)
    return facts.st_size, [facts.st_ino, facts.st_mtime_ns, facts.st_ctime_ns]


def check_suffix(place: Place, suffixes: Sequence[str]) -> Place:
    """The place. Raises: OutputError if its name is that of another kind of file."""
    if place.suffix.lower() not in suffixes:
        raise OutputError(f"{place}: the suffix must be one of {', '.join(suffixes)}")
    return place


def existing(path: Path) -> os.stat_result | None:
    """Status of the regular file that an output of this name would replace, also through a symbolic link; None if there is
    none. Raises: OutputError if the name stands for something else (folder, pipe, device, socket) or cannot be used."""
    with output_errors(path):
        try:
            status = os.stat(path)
        except FileNotFoundError:
            return None
    if not stat.S_ISREG(status.st_mode):
        raise OutputError(
            f"{path}: is a folder, pipe, device or socket, and only regular files are replaced; name another"
        )
    return status


def is_there(place: Place) -> bool:
    """Whether an output of this name would replace a file. Raises: OutputError as :func:`existing`, or if a store refuses."""
    return place.exists(OutputError) if isinstance(place, Remote) else existing(place) is not None


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

    The file is written as by :func:`replacing`. What ``path`` replaces gives it its permissions. A symbolic link stays, and the
    file that it names is written. A remote file is written to a local disk first.

    ``into``: a local file that is written in place of ``path``, and whose content is to take that name later.

    Raises: OutputError if ``path`` is the ``source`` and not ``in_place``, if it exists and not ``overwrite``, if it is
    not a regular file, or if a store or the operating system refuses. Warns: of hard links to what is replaced in place.
    """
    with output_errors(path):
        old = existing(path) if isinstance(path, Path) else None
        final = into or (Path(os.path.realpath(path)) if isinstance(path, Path) else None)
        if into is None:
            same = old is not None and isinstance(source, Path) and os.path.samestat(old, os.stat(source))
            mine = same or path == source
            if mine and not in_place:
                raise OutputError(f"{path}: output and input are one file; pass in_place=True to replace it")
            if not mine and not overwrite and is_there(path):
                raise OutputError(f"{path}: the file exists; pass overwrite=True to replace it")
            if mine and isinstance(path, Path):
                warn_of_names(path)
        if final is None:
            with tempfile.TemporaryDirectory(prefix=UNFINISHED, ignore_cleanup_errors=True) as folder:
                part = Path(folder) / "part"
                yield part
                cast(Remote, path).put(part)
            return
        with replacing(final) as part:
            yield part
            if old is not None:
                shutil.copymode(cast(Path, path), part)


def check_writable(place: Remote) -> None:
    """Put an empty file beside ``place`` and remove it, before much is done for it. Raises: OutputError if the store refuses."""
    probe = Remote(f"{place}.jaxfilter-run")
    with new_file(probe, overwrite=True) as part:
        part.touch()
    with contextlib.suppress(OutputError):  # it may be allowed to write, but not to remove
        probe.remove()


def warn_of_names(path: Path) -> None:
    """Warn if a file that is to be replaced has other names, which keep what it holds now."""
    if (status := existing(path)) is not None and status.st_nlink > 1:
        warn(f"{path}: has {status.st_nlink} names (hard links): only this one gets the new content")


def check_own(folder: Path, make: bool = False) -> None:
    """A hidden folder is this user's own, or there is none; with ``make`` it is made, for the user alone. Raises: OutputError if
    a link, a file, or a folder that another user has or may write to has this name; or if it cannot be made."""
    with output_errors(folder):
        if make:
            folder.mkdir(0o700, parents=True, exist_ok=True)
        elif not os.path.lexists(folder):
            return
        facts, writers = os.lstat(folder), stat.S_IWGRP | stat.S_IWOTH
        mine = stat.S_ISDIR(facts.st_mode)
        if mine and hasattr(os, "getuid") and (facts.st_uid != os.getuid() or facts.st_mode & writers):
            with tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=folder.parent) as made:
                known = os.lstat(made)  # some disks know one owner, or no permissions
                mine = known.st_uid == facts.st_uid and not facts.st_mode & ~known.st_mode & writers
    if not mine:
        what = "is a link, no folder, or a folder that another user has or may write to"
        raise OutputError(f"{folder}: {what}: remove it if nobody needs it, or name another output")
