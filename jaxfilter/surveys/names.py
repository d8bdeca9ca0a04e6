"""From what a user names (files, folders, patterns, virtual point clouds, URLs) to the files meant."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from ..core.errors import InputError
from ..core.units import Stated
from ..files.sources import Source
from ..files.storage import Remote, place_of
from ..files.text import SUFFIXES as TEXT
from ..files.writing import LAS_SUFFIXES

Entry = str | Source
"""The name of a file whose header is to be read, or what a virtual point cloud says of it."""


def expand(what: str | os.PathLike[str] | Iterable[str | os.PathLike[str]], stated: Stated) -> Iterator[Entry]:
    """The files meant, those of each name in alphabetical order; ``stated``: of the coordinates of members.

    Raises: InputError if a name stands for nothing that can be a member.
    """
    listed = [what] if isinstance(what, (str, os.PathLike)) else list(what)
    if not listed:
        raise InputError("no files are named")
    for item in listed:
        yield from _expanded(os.fspath(item), stated)


def _expanded(name: str, stated: Stated) -> Iterable[Entry]:
    place = place_of(name)
    suffix = place.suffix.lower()
    if suffix == ".vpc":
        from .vpc import read_vpc

        return read_vpc(place, stated)
    if isinstance(place, Remote):
        if suffix in (*LAS_SUFFIXES, *TEXT) and not any(c in name for c in "*["):
            return [name]
        return _some(name, place.listed(LAS_SUFFIXES))
    place = Path(os.path.abspath(place))  # which other processes understand as well
    if place.is_dir():
        return _some(name, sorted(str(p) for p in place.iterdir() if _is_member(p)))
    if not place.exists() and any(c in name for c in "*?["):
        return _some(name, sorted(p for p in glob.glob(str(place), recursive=True) if _is_member(Path(p), suffix)))
    return [str(place)]


def _is_member(path: Path, asked: str = "") -> bool:
    """Files of LAS, and of text if a pattern asks for their suffix."""
    known = (*LAS_SUFFIXES, asked) if asked in TEXT else LAS_SUFFIXES
    return path.suffix.lower() in known and not path.name.startswith(".") and path.is_file()


def _some(name: str, found: list[str]) -> list[str]:
    if not found and any(c in name for c in "*?["):
        raise InputError(f"{name}: matches no .las or .laz file")
    if not found:
        raise InputError(
            f"{name}: holds no .las or .laz file; for those in folders below, name {name.rstrip('/')}/**/*.laz"
        )
    return found
