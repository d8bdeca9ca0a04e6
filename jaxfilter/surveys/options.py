"""How a run over a collection is carried out: what all functions that make one are told alike."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypedDict

from .collection import Collection
from .collection import open as open_collection
from .pool import Executor, check_main
from .run import Standing


class RunOptions(TypedDict, total=False):
    """Keywords of :func:`jaxfilter.ground`, :func:`jaxfilter.heights` and :func:`jaxfilter.terrain_model`, all of which may be
    left out: how the run is carried out. None of them changes what is found, but ``tile`` where a label depends on points at any
    distance.

    Attributes:
        tile: side of a tile in metres; by default as large as the memory allows.
        memory: bytes for all processes together; by default seven tenths of what is free.
        workers: processes; by default one per processor, as far as the memory goes.
        client: a ``dask.distributed.Client``, or the address of a Dask scheduler, instead of processes of this machine.
        executor: any other way to have the tasks done, in place of ``workers`` and ``client``.
        work: local folder for the journal, and for what tiles have found until it is written; all workers see it. By default
            where the output goes, unless that is a URL.
        resume: go on with the run that was begun for the output.
        overwrite: begin anew; files that the run writes are replaced.
        progress: called with the :class:`Standing` about four times a second.

    >>> how: jf.RunOptions = {"tile": 50.0, "workers": 1}
    >>> jf.heights("survey", "heights", units="m", **how).complete
    True
    """

    tile: float | None
    memory: float | None
    workers: int | None
    client: Any
    executor: Executor | None
    work: str | os.PathLike[str] | None
    resume: bool
    overwrite: bool
    progress: Callable[[Standing], None] | None


def begun(caller: str, what: Any, units: str | None, run: RunOptions) -> Collection:
    """The collection of a run, before that touches anything.

    Raises: TypeError for names that are no options, as Python does; JaxfilterError if its workers would come here themselves;
    InputError if files cannot be found, or do not go together.
    """
    unknown = [name for name in run if name not in RunOptions.__annotations__]
    if unknown:
        raise TypeError(f"{caller}() got an unexpected keyword argument {unknown[0]!r}")
    check_main()
    collection = what if isinstance(what, Collection) else open_collection(what, units=units)
    _ = collection.units  # which are refused where files do not go together
    return collection
