"""Ground filtering of a survey of any size: the files of a collection in, as many classified files out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Unpack

from ..core.cloud import KEPT_CLASSES, Whole
from ..core.errors import ParameterError
from ..core.filter import Filter
from ..core.inputs import class_numbers
from .capacity import Layout, layout
from .collection import Collection
from .folder import Folder, run_in
from .options import RunOptions, begun
from .outputs import write_file
from .plan import Plan
from .run import RunReport, Step
from .setup import filter_for, sampled, whole_for
from .task import Job, filter_tile, labels_path

GROUND = Step(filter_tile, labels_path, write_file)


def ground(
    what: Any,
    out: str | Path,
    filter_: Filter | None = None,
    *,
    units: str | None = None,
    halo: float | None = None,
    returns: str = "last,only",
    ignore_classes: Iterable[int] = KEPT_CLASSES,
    ignore_overlap: bool = False,
    keep_withheld: bool = False,
    drop_invalid: bool = False,
    ground_class: int = 2,
    other_class: int = 1,
    reset: str = "ground",
    only_ground: bool = False,
    noise_class: int | None = None,
    extra: Iterable[str] = (),
    setup: Callable[[Collection, dict[str, Any], Path], tuple[Filter, Whole]] | None = None,
    **run: Unpack[RunOptions],
) -> RunReport:
    """Classify the ground points of the files of a collection, tile by tile, into one file for each in a folder.

    Every file is written as it was, with classes changed, when all its tiles are done. The journal in the folder lets a run
    that was stopped, in whatever way, go on with ``resume``; the files are those of an undisturbed run.

    Args:
        what: a :class:`Collection`, or what :func:`jaxfilter.open` takes.
        out: a folder, made if missing; it must be empty, but for ``resume`` and ``overwrite``. May be a URL that fsspec can
            write to (``"s3://bucket/prefix"``); every file appears there whole or not at all.
        filter_: by default the default method, set up for the collection.
        halo: metres around each tile that are read as well; by default what the method needs (``Filter.tile_halo``).
        returns, ignore_classes, ignore_overlap, keep_withheld, drop_invalid: as in :func:`jaxfilter.read`.
        ground_class, other_class, reset, only_ground, noise_class, extra: as in :func:`jaxfilter.write`.
        setup: in place of ``filter_``: makes filter and whole of the collection, the reading options and the folder for
            what is found out about files.
        run: how it is carried out, see :class:`RunOptions`: tiles, memory, workers or a cluster, going on after a stop.

    Returns: RunReport; what could not be done is in it.
    Raises: InputError, ParameterError, OutputError before anything is filtered, JaxfilterError if workers cannot be started;
    OutputError if the journal cannot be written.

    >>> report = jf.ground("survey", "classified", jf.SMRF(), units="m", workers=1)
    >>> len(report.files), report.set_aside, 0 < report.ground < report.candidates
    (2, [], True)
    """
    if not isinstance(filter_, Filter | None):
        raise ParameterError(f"filter_={filter_!r}: is no filter; pass one, such as jaxfilter.SMRF()")
    collection = begun("ground", what, units, run)
    reading = {
        "returns": returns,
        "ignore_classes": class_numbers(ignore_classes),
        "ignore_overlap": ignore_overlap,
        "keep_withheld": keep_withheld,
        "drop_invalid": drop_invalid,
    }
    classes = {
        "ground_class": ground_class,
        "other_class": other_class,
        "reset": reset,
        "only_ground": only_ground,
        "noise_class": noise_class,
    }
    folder = Folder.prepared(out, collection, run)
    index = folder.scratch / "index"

    def prepared(most: float | None) -> tuple[Job, Layout, Plan, dict[str, Any]]:
        if setup is not None:
            chosen, whole = setup(collection, reading, index)
        else:
            sample = sampled(collection, reading, index)
            chosen = filter_.replace() if filter_ else filter_for(sample, None, {})
            whole = whole_for(chosen, sample, collection, reading, index)
        cut = layout(
            collection,
            halo=chosen.tile_halo() if halo is None else halo,
            lattice=chosen.lattice(),
            most_points=most,
            **run,
        )
        width, height = (side * collection.metre for side in cut.plan.largest())
        whole = dataclasses.replace(whole, width=width, height=height)
        return Job(chosen, reading, classes, tuple(extra), whole, folder.scratch, index), cut, cut.plan, {}

    return run_in(folder, collection, GROUND, prepared, run)
