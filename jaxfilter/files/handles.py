"""The LAS file that a cloud was read from, by which its points are read again."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..core.errors import InputError
from . import records
from .disk import CHANGED_SINCE, Bounds, Identity, Tally
from .header import Header, read_header
from .storage import Place


@dataclasses.dataclass(frozen=True)
class Handle:
    """The LAS, LAZ or COPC file that a cloud was read from: lossless writing streams it again instead of keeping a second copy.

    Attributes:
        path: absolute, or remote.
        format: in words, for messages.
        points: number of points taken from the file, the length of the cloud.
        bounds: the cut that was applied, or None; reading with it again gives the same points in the same order.
        identity: of the file when it was read.
        checksum: of the coordinates of the points, see :class:`jaxfilter.files.disk.Tally`: labels can so never get to
            other points, even if a file is changed and its time set back. None where the points were read in windows.
        rows: bool of all points of a LAS file, those that were taken; None = those inside the bounds.
        blocks: of a file that was read in windows, all its runs of records with their checksums, which do the same.
    """

    path: Place
    format: str
    points: int
    bounds: Bounds | None
    identity: Identity
    checksum: int | None
    blocks: Any = None
    rows: np.ndarray | None = None

    def header(self) -> Header:
        """That of a LAS file. Raises InputError."""
        with records.reading_errors(self.path):
            return read_header(self.path)

    def records(self, header: Header, tally: Tally, every_field: bool = True) -> Iterator[np.ndarray]:
        """The records of a LAS file, u8[k, record_length], read once more and added to ``tally``. Raises InputError."""
        for chunk, number in records.read_records(header, self.bounds, every_field, self.blocks):
            chunk = chunk if self.rows is None else chunk[self.rows[number]]
            tally.add(chunk[:, :12].view("V12"))  # in one piece, which is copied faster
            yield chunk

    def runs(self, tally: Tally) -> Iterator[np.ndarray]:
        """Coordinates f64[k, 3] in file units, read once more and added to ``tally``. Raises InputError."""
        header = self.header()
        for chunk in self.records(header, tally, every_field=False):
            yield records.coordinates(chunk, header)

    def coordinates(self) -> np.ndarray:
        """f64[n, 3] in file units: those of the file, to the last digit. Raises: InputError as :meth:`again`."""
        with self.again() as tally:
            return np.concatenate([np.zeros((0, 3)), *self.runs(tally)])

    @contextlib.contextmanager
    def again(self) -> Iterator[Tally]:
        """A block in which the points are read once more, and added to what it is given. Raises: InputError if the file is
        gone, or if the file or its points are not those that were read."""
        try:
            found = Identity.of(self.path)
        except OSError as error:
            lost = f"{self.path}: the source of the cloud cannot be read again: {error.strerror}"
            raise InputError(f"{lost}; put it back, or read it again where it is now") from error
        if found != self.identity:
            raise InputError(f"{self.path}: {CHANGED_SINCE}")
        tally = Tally(self.path, self.points, self.checksum)
        with self.identity.kept(self.path, CHANGED_SINCE):
            yield tally
            tally.finish()
