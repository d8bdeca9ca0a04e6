"""Labels of tiles, on their way into files."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np

from ..core.cloud import PointCloud
from ..core.errors import InputError
from ..files.classes import Found
from ..files.windows import file_cloud
from .product import FileTask, Product
from .store import Store
from .tiles import Around

CANDIDATE, GROUND, _STORED, _CODE = 1, 2, 0x80, 2
"""Bits of a label, and the bit at which the number of what was found begins."""


def packed(around: Around, found: Found, quantities: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Arrays of the core of a tile, file by file: records i64[k] (or the first of k in succession), labels u8[k], and
    quantities f[k].

    ``found``: of all points of the tile; ``quantities``: f[k], of those of the core.
    """
    arrays: dict[str, np.ndarray] = {}
    own = around.own
    label = around.cloud.candidate[own] * np.uint8(CANDIDATE) | found.ground[own] * np.uint8(GROUND)
    label |= found.code[own] << np.uint8(_CODE)
    file = around.file[own]  # ascending
    edges = [*np.flatnonzero(np.diff(file, prepend=-1)).tolist(), len(own)]
    for start, stop in itertools.pairwise(edges):
        one, record = file[start], around.record[own[start:stop]]
        if record[-1] - record[0] == len(record) - 1:
            record = record[:1]  # the first of all that follow it
        arrays[f"record_{one}"], arrays[f"label_{one}"] = record, label[start:stop]
        arrays[f"checksum_{one}"] = np.array(around.checksums.get(int(one), -1))
        arrays |= {f"{name}_{one}": values[start:stop] for name, values in quantities.items()}
    return arrays


def collected(
    product: Product, task: FileTask, kinds: Mapping[str, type]
) -> tuple[PointCloud, Found, dict[str, np.ndarray]]:
    """What stands for the points of a file, what tiles have found of them, and f[n]: quantities of such ``kinds``.

    Raises: InputError if a point has no label.
    """
    store, reader, source = product.store, product.reader, task.source
    label, quantities, checksum = gathered(store, task, kinds)
    reading, rows = reader.reading, label > 0
    if reading.bounds is not None or reading.aoi is not None:
        label, quantities = label[rows], {name: values[rows] for name, values in quantities.items()}
    elif missing := int(np.count_nonzero(~rows)):
        raise InputError(
            f"{source.uri}: {missing:,} of {source.count:,} points lie outside of the bounds in its header, so no tile holds "
            "them: correct the header"
        )
    candidate = (label & CANDIDATE) > 0
    if reading.aoi is None:
        cloud = file_cloud(source, candidate, reader.index, bounds=reading.bounds, checksum=checksum)
    else:  # the checksum is of all points
        cloud = file_cloud(source, candidate, reader.index, rows=rows)
    return cloud, found_in(label), quantities


def found_in(label: np.ndarray) -> Found:
    """What labels u8[n] say of points."""
    return Found((label & GROUND) > 0, (label & ~np.uint8(_STORED)) >> np.uint8(_CODE))


def gathered(
    store: Store, task: FileTask, kinds: Mapping[str, type]
) -> tuple[np.ndarray, dict[str, np.ndarray], int | None]:
    """u8[n]: the labels of all points of a file, 0 where there is none; f[n]: quantities; and the checksum of the points, if
    they were read in one piece."""
    checksum = -1
    label = np.zeros(task.source.count, np.uint8)
    quantities: dict[str, np.ndarray] = {name: np.full(task.source.count, np.nan, kind) for name, kind in kinds.items()}
    for number in task.tiles:
        stored = store.arrays(number)
        if f"record_{task.number}" not in stored:
            continue
        checksum = int(stored[f"checksum_{task.number}"])
        found, record = stored[f"label_{task.number}"], stored[f"record_{task.number}"]
        rows = record if len(record) == len(found) else slice(record[0], record[0] + len(found))
        label[rows] = found | np.uint8(_STORED)
        for name, values in quantities.items():
            values[rows] = stored[f"{name}_{task.number}"]
    return label, quantities, None if checksum < 0 else checksum
