"""Files that appear whole or not at all, and the handle by which a cloud remembers where it came from."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

from ..core.errors import InputError, OutputError

Bounds = tuple[float, float, float, float]
"""xmin, ymin, xmax, ymax in file units; half open: xmin <= x < xmax, ymin <= y < ymax."""


@dataclasses.dataclass(frozen=True)
class Source:
    """The file that a cloud was read from: lossless writing streams it again instead of keeping a second copy.

    Attributes:
        path: absolute.
        kind: ``"las"`` (LAS, LAZ and COPC) or ``"text"``.
        format: in words, for messages.
        points: number of points taken from the file, the length of the cloud.
        bounds: the cut that was applied, or None; reading with it again gives the same points in the same order.
        size, modified: bytes and time (ns) of the file when it was read, to notice that it has changed since.
    """

    path: Path
    kind: str
    format: str
    points: int
    bounds: Bounds | None
    size: int
    modified: int

    @classmethod
    def of(cls, path: Path, kind: str, description: str, points: int, bounds: Bounds | None) -> Source:
        """The handle of a file as it is now."""
        status = path.stat()
        return cls(path.absolute(), kind, description, points, bounds, status.st_size, status.st_mtime_ns)

    def check_unchanged(self) -> None:
        """Raises InputError when the file is gone, or is not the one that was read."""
        try:
            status = self.path.stat()
        except OSError as error:
            raise InputError(f"{self.path}: the source of the cloud cannot be read again: {error.strerror}") from error
        if (status.st_size, status.st_mtime_ns) != (self.size, self.modified):
            raise InputError(f"{self.path}: the file has changed since the cloud was read; read it again")


def check_bounds(bounds: object) -> Bounds:
    """Four finite numbers that enclose an area. Raises InputError."""
    try:
        x0, y0, x1, y1 = (float(v) for v in bounds)  # type: ignore[attr-defined]
    except (TypeError, ValueError) as error:
        raise InputError(f"bounds={bounds!r}: four numbers (xmin, ymin, xmax, ymax) are needed") from error
    if not (x0 < x1 and y0 < y1):
        raise InputError(f"bounds={bounds!r}: xmin < xmax and ymin < ymax are needed")
    return x0, y0, x1, y1


@contextlib.contextmanager
def new_file(
    path: Path, *, overwrite: bool = False, in_place: bool = False, source: Path | None = None
) -> Iterator[Path]:
    """A name in the folder of ``path`` to write to; it becomes ``path`` when the block ends, and vanishes if it fails.

    Raises: OutputError if ``path`` is the ``source`` and not ``in_place``, if it exists and not ``overwrite``, or if
    the operating system refuses (folder missing, disk full, no permission).
    """
    mine = source is not None and path.exists() and path.samefile(source)
    if mine and not in_place:
        raise OutputError(f"{path}: output and input are one file; pass in_place=True to replace it")
    if path.exists() and not mine and not overwrite:
        raise OutputError(f"{path}: the file exists; pass overwrite=True to replace it")
    final = path.resolve() if path.is_symlink() else path
    temporary = final.with_name(f".{final.name}.{secrets.token_hex(4)}.part")
    try:
        yield temporary
        if final.exists():
            shutil.copymode(final, temporary)
        os.replace(temporary, final)
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)
