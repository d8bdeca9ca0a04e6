"""Where a run puts its files, and the folder in which it keeps what it needs to go on."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ..core.errors import JaxfilterError, OutputError, ParameterError
from ..files.disk import check_own, existing, is_there, output_errors, remove_dead
from ..files.storage import Place, Remote, check_writable, place_of
from ..files.text import SUFFIXES as TEXT
from ..files.writing import LAS_SUFFIXES
from .options import RunOptions
from .store import Store

POINTS = (*LAS_SUFFIXES, *TEXT)
"""Suffixes of files of points."""
REPORT, MAP = "jaxfilter-run.json", "jaxfilter-run.png"
_HIDDEN, _LONGEST = ".jaxfilter-run", 255
"""Name of the folder of a run, and bytes of the longest name."""


@dataclasses.dataclass(frozen=True)
class Targets:
    """Where the outputs of a run go.

    Attributes:
        places: where each output is written to.
        folder: in which they lie, if that is the run's; its report and a map are put there. None for a file, and in place.
        store: what the run keeps.
    """

    places: list[Place]
    folder: Place | None
    store: Store

    @contextlib.contextmanager
    def claimed(self, options: RunOptions) -> Iterator[None]:
        """A block that has the outputs to itself.

        Raises: OutputError if there is something that would be lost, or another run is at it; InputError if what is left of
        a run to go on with is damaged.
        """
        folder, store = self.folder, self.store
        goes_on, overwrite = options.resume and store.begun, options.overwrite
        made = isinstance(folder, Path) and not folder.exists()
        if isinstance(folder, Path):
            with output_errors(folder):
                folder.mkdir(parents=True, exist_ok=True)
        if folder is not None:
            self.check(options)
        try:
            with store.locked():
                if folder is None:
                    self.check(options)
                if goes_on:
                    store.load()
                else:
                    store.clear()
                    self._remove_old(overwrite)
                yield
        except BaseException:
            if made and isinstance(folder, Path):
                with contextlib.suppress(OSError):  # it holds something
                    folder.rmdir()
            raise
        for place in {folder, store.path.parent}:
            if isinstance(place, Path) and place.is_dir():
                remove_dead(place)

    def check(self, options: RunOptions) -> None:
        """Raises: OutputError if there is something that would be lost, or a store refuses, before anything is done."""
        folder = self.folder
        if (options.resume and self.store.begun) or (isinstance(folder, Path) and not folder.exists()):
            return
        for place in self.places if folder is None else ():
            if is_there(place) and not (options.overwrite or options.in_place):
                raise OutputError(f"{place}: the file exists; pass overwrite=True to replace it")
            if isinstance(place, Remote):
                check_writable(place)
        if folder is None:
            return
        held = _held(folder)
        if options.resume:
            if there := [place.name for place in self.places if place.name in held]:
                raise OutputError(
                    f"{folder / there[0]}: exists, and no run was begun in {self.store.path.parent}: name another folder, or "
                    "pass overwrite=True to begin anew"
                )
        elif (held or self.store.begun) and not options.overwrite:
            seen = [name for name in held if name != self.store.path.name] or [str(self.store.path)]
            first, more = seen[0], f" and {len(seen) - 1} more" if len(seen) > 1 else ""
            raise OutputError(
                f"{folder}: is not empty, it holds {first}{more}: name another folder, pass resume=True to go on with a "
                "run, or pass overwrite=True to begin anew"
            )
        if isinstance(folder, Remote):
            check_writable(folder / REPORT)

    def _remove_old(self, overwrite: bool) -> None:
        """Remove what an earlier run has written into the folder. Raises: OutputError, before anything is removed, for what
        cannot be replaced."""
        if self.folder is None or not overwrite:
            return
        held = set(_held(self.folder))
        ours = [place for place in (*self.places, self.folder / REPORT, self.folder / MAP) if place.name in held]
        for path in (place for place in ours if isinstance(place, Path)):
            existing(path)
        for place in ours:
            with output_errors(place):
                place.unlink(missing_ok=True) if isinstance(place, Path) else place.remove()


def check_out(out: str | Path, inputs: Sequence[Any], options: RunOptions) -> None:
    """Refuse an output of one file that cannot be written, before anything is read.

    Raises: OutputError if it exists, or its folder does not; ParameterError for the name of another kind of file.
    """
    place = place_of(out)
    only = place_of(inputs[0]) if len(inputs) == 1 and isinstance(inputs[0], (str, os.PathLike)) else None
    if only is None or only.suffix.lower() == ".vpc":
        return
    if not (only.is_file() if isinstance(only, Path) else only.suffix.lower() in POINTS and "*" not in str(only)):
        return
    if str(out).endswith(("/", os.sep)) or (isinstance(place, Path) and os.path.isdir(place)) or not place.suffix:
        return
    if place.suffix.lower() not in POINTS:
        raise ParameterError(f"{place}: the suffix must be one of {', '.join(POINTS)}; to name a folder, end it with /")
    if _real(place) == _real(only):
        raise OutputError(f"{place} is both input and output: name another file, or pass in_place=True")
    if isinstance(place, Path) and not place.absolute().parent.is_dir():
        raise OutputError(f"{place.absolute().parent} is not a folder: make it first")
    if is_there(place) and not (options.overwrite or options.resume):
        raise OutputError(f"{place} exists: name another file, or pass overwrite=True")


def targets_of(out: str | Path | None, uris: Sequence[str], options: RunOptions) -> Targets:
    """The outputs for some inputs: a file for one, a folder of files, or, for ``out`` None, the inputs themselves.

    Raises: ParameterError for a name that does not fit the number of files, or without a local folder for a run into a store;
    OutputError if an output is an input, or two would have one name.
    """
    sources = [place_of(uri) for uri in uris]
    alone = len(sources) == 1
    if out is None:
        return beside(sources, options, alone)
    place = place_of(out)
    one = place.suffix.lower() in POINTS and not (isinstance(place, Path) and os.path.isdir(place))
    if one and not alone:
        raise ParameterError(
            f"{place}: {len(sources):,} files are written into a folder, and this is the name of a file: name a folder as OUT"
        )
    places = [place] if one else [place / name for name in target_names(uris)]
    inputs = {_real(source) for source in sources}
    for target in places:
        if _real(target) in inputs:
            raise OutputError(f"{target}: is an input; name another, or pass in_place=True to replace it")
    if one:
        return beside(places, options, alone)
    return Targets(places, place, Store(_local(options.work, place, place) / _HIDDEN))


def beside(places: list[Place], options: RunOptions, alone: bool, called: str = "") -> Targets:
    """Outputs with the folder of the run beside the first one, ``called`` so, by default like this output, or in the folder above
    all of them; of one input (``alone``) into a URL, in the user's folder for what programs keep.

    Raises: ParameterError; OutputError if another run was begun there, and it is not said what to do with it, or by another user.
    """
    first = places[0].absolute()
    near: Place = first if isinstance(first, Remote) else first.parent
    name, short = f".{first.name}{_HIDDEN}", f".{hashlib.sha256(str(first).encode()).hexdigest()[:16]}{_HIDDEN}"
    if called:
        name = f".{called}{_HIDDEN}"
    elif len(places) > 1:
        near, name = place_of(os.path.commonpath([str(place) for place in places])), _HIDDEN
    elif isinstance(first, Remote) and alone and options.work is None and options.client is None:
        import platformdirs

        near, name = platformdirs.user_state_path("jaxfilter"), short
        check_own(near, make=True)
    elif len(os.fsencode(name)) > _LONGEST:
        name = short
    store = Store(_local(options.work, first, near) / name)
    if not options.resume and not options.overwrite and store.unfinished():
        raise OutputError(
            f"{first}: a run for it was begun and is not complete: pass resume=True to go on with it, or pass overwrite=True to "
            "begin anew"
        )
    return Targets(places, None, store)


def _local(work: str | Path | None, target: Place, beside: Place) -> Path:
    """The local folder that is named, or the one ``beside`` the target. Raises: ParameterError."""
    if work is None and isinstance(beside, Remote):
        raise ParameterError(
            f"work=None: {target} is not on a local disk, and a run needs a folder that all workers see: pass work=..."
        )
    local = beside if work is None else place_of(work)
    if isinstance(local, Remote):
        raise ParameterError(f"work={work!r}: must be a local folder")
    return local


def _real(place: Place) -> str:
    return place.uri if isinstance(place, Remote) else os.path.realpath(place)


def target_names(uris: Sequence[str]) -> list[str]:
    """The name of the output for each input: the input's, but plain LAZ for COPC.

    Raises: OutputError if two outputs would have one name.
    """
    seen: dict[str, str] = {}
    for uri in uris:
        name = re.sub(r"\.copc\.laz$", ".laz", place_of(uri).name, flags=re.IGNORECASE)  # no signature of a URL
        if name in seen:
            raise OutputError(f"{seen[name]} and {uri} would both be written as {name}: filter them into two folders")
        seen[name] = uri
    return list(seen)


def _held(folder: Place) -> list[str]:
    """Names in a folder, sorted. Raises OutputError."""
    try:
        return folder.held() if isinstance(folder, Remote) else sorted(os.listdir(folder))
    except JaxfilterError as error:
        raise OutputError(str(error)) from error
    except OSError as error:
        raise OutputError(f"{folder}: cannot be read: {error.strerror}") from error
