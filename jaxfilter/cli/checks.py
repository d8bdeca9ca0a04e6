"""What is refused before anything is read: outputs that cannot be written, and words that mean nothing."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import JaxfilterError
from .session import BadUsage

if TYPE_CHECKING:
    from ..files.storage import Place


def check_review(path: Path, overwrite: bool) -> None:
    """Refuse a list of places that cannot be written, before anything is read. Raises BadUsage."""
    from ..reports.review_list import check_suffix

    try:
        check_suffix(path)
    except JaxfilterError as error:
        raise BadUsage(str(error)) from error
    check_target(path, overwrite)


def checked_target(source: Place, target: Place | None, overwrite: bool, in_place: bool, text: bool = True) -> Place:
    """Where to write, or BadUsage if that would destroy something or cannot work. ``text`` may be written."""
    from ..files import writing
    from ..files.text import SUFFIXES

    if target is None:
        if not in_place:
            raise BadUsage("OUT is missing: name a file to write, or pass --in-place")
        return source
    if check_target(target, overwrite, source) and not in_place:
        raise BadUsage(f"{target} is both input and output: name another file, or pass --in-place")
    suffixes = writing.LAS_SUFFIXES + (SUFFIXES if text else ())
    if target.suffix.lower() not in suffixes:
        raise BadUsage(f"{target}: the suffix must be one of {', '.join(suffixes)}")
    return target


def check_target(target: Place, overwrite: bool, source: Place | None = None) -> bool:
    """Whether ``target`` is ``source``. Raises BadUsage if it exists otherwise and not ``overwrite``, or cannot be written."""
    from ..files.disk import is_there

    try:
        there = is_there(target)
    except JaxfilterError as error:
        raise BadUsage(str(error)) from error
    if isinstance(target, Path) and isinstance(source, Path):
        same = there and os.path.samefile(source, target)
    else:
        same = target == source
    if there and not same and not overwrite:
        raise BadUsage(f"{target} exists: name another file, or pass --overwrite")
    if isinstance(target, Path) and not target.absolute().parent.is_dir():
        raise BadUsage(f"{target.absolute().parent} is not a folder: make it first")
    return same


def check_reading(units: str | None, returns: str) -> None:
    """Refuse words that ``read`` would refuse, before it reads."""
    import numpy as np

    from ..core.cloud import PointCloud

    try:
        PointCloud.from_arrays(np.empty((0, 3)), units=units or "m", returns=returns)
    except JaxfilterError as error:
        raise BadUsage(str(error)) from error
