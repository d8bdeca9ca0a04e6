"""The file that a cloud was read from, by which its points are read again."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import numpy as np

from ..core.errors import InputError
from . import text
from .disk import CHANGED_SINCE, Bounds, Identity
from .header import Header
from .points import Points, coordinates, read_points
from .storage import Place


@dataclasses.dataclass(frozen=True)
class Handle:
    """The file that a cloud was read from: lossless writing streams it again instead of keeping a second copy.

    Attributes:
        path: absolute, or remote.
        format: in words, for messages.
        points: number of points taken from the file, the length of the cloud.
        bounds: the cut that was applied, or None; reading with it again gives the same points in the same order.
        identity: of the file when it was read.
        header: of LAS, LAZ and COPC; None = text.
        rows: bool of all points of a LAS file, those that were taken; None = those inside the bounds.
    """

    path: Place
    format: str
    points: int
    bounds: Bounds | None
    identity: Identity
    header: Header | None = None
    rows: np.ndarray | None = None

    def layout(self) -> text.Layout:
        """That of a text file. Raises InputError."""
        return text.layout_of(cast(Path, self.path))

    def records(self, every_field: bool = True) -> Iterator[Points]:
        """The points of a LAS file, read once more. Raises InputError."""
        assert self.header is not None
        for points, number in read_points(self.header, self.bounds, every_field):
            yield points if self.rows is None else points[self.rows[number]]

    def runs(self) -> Iterator[tuple[np.ndarray, dict[str, np.ndarray]]]:
        """The points, read once more: coordinates f64[k, 3] in file units and, of text, columns named as those of a cloud.
        Raises InputError."""
        if self.header is not None:
            for points in self.records(every_field=False):
                yield coordinates(points, self.header), {}
        else:
            yield from text.read_text(self.layout(), self.bounds)

    def coordinates(self) -> np.ndarray:
        """f64[n, 3] in file units: those of the file, to the last digit. Raises: InputError as :meth:`again`."""
        with self.again():
            return np.concatenate([np.zeros((0, 3)), *(xyz for xyz, _ in self.runs())])

    @contextlib.contextmanager
    def again(self) -> Iterator[None]:
        """A block in which the points are read once more. Raises: InputError if the file is gone, or is another now."""
        try:
            found = Identity.of(self.path)
        except OSError as error:
            lost = f"{self.path}: the source of the cloud cannot be read again: {error.strerror}"
            raise InputError(f"{lost}; put it back, or read it again where it is now") from error
        if found != self.identity:
            raise InputError(f"{self.path}: {CHANGED_SINCE}")
        with self.identity.kept(self.path, CHANGED_SINCE):
            yield
