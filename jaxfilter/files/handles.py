"""The LAS file that a cloud was read from, by which its points are read again."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np
from laspy import DecompressionSelection

from ..core.errors import InputError
from .disk import CHANGED_SINCE, Bounds, opened
from .header import Header
from .points import ALL, CLOUD, Points, coordinates, read_points
from .storage import Place


@dataclasses.dataclass(frozen=True)
class Handle:
    """The LAS, LAZ or COPC file that a cloud was read from: lossless writing streams it again instead of keeping a second copy.

    Attributes:
        header: of the file when it was read.
        points: number of points taken from the file, the length of the cloud.
        bounds: the cut that was applied, or None; reading with it again gives the same points in the same order.
        rows: bool of all points of the file, those that were taken; None = those inside the bounds.
    """

    header: Header
    points: int
    bounds: Bounds | None = None
    rows: np.ndarray | None = None

    @property
    def path(self) -> Place:
        """Absolute, or remote."""
        return self.header.path.absolute()

    @property
    def format(self) -> str:
        """In words, for messages."""
        return str(self.header)

    def records(self, file: BinaryIO, fields: DecompressionSelection = ALL) -> Iterator[Points]:
        """The points, read once more from the open file. Raises InputError."""
        for points, number in read_points(self.header, self.bounds, fields, opened=file):
            yield points if self.rows is None else points[self.rows[number]]

    def coordinates(self) -> np.ndarray:
        """f64[n, 3] in file units: those of the file, to the last digit. Raises: InputError as :meth:`again`."""
        with self.again() as file:
            parts = [coordinates(points, self.header) for points in self.records(file, CLOUD)]
            return np.concatenate([np.zeros((0, 3)), *parts])

    @contextlib.contextmanager
    def again(self) -> Iterator[BinaryIO]:
        """A block in which the points are read once more, from this open file. Raises: InputError if it is gone, or is another
        now."""
        with contextlib.ExitStack() as stack:
            try:
                file, found = stack.enter_context(opened(self.path))
            except OSError as error:
                lost = f"{self.path}: the source of the cloud cannot be read again: {error.strerror}"
                raise InputError(f"{lost}; put it back, or read it again where it is now") from error
            if found != self.header.identity:
                raise InputError(f"{self.path}: {CHANGED_SINCE}")
            stack.enter_context(self.header.identity.kept(self.path, CHANGED_SINCE))
            yield file
