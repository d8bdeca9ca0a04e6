"""Where the outputs of a command go, and what must not be lost there."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar

from ..core.errors import OutputError, ParameterError
from ..core.output import output_errors
from ..files.disk import check_writable, is_there
from ..files.storage import Place, Remote, place_of
from ..files.text import TEXT_SUFFIXES as TEXT
from ..files.writing import LAS_SUFFIXES
from .options import RunOptions
from .report import REPORT

POINTS = (*LAS_SUFFIXES, *TEXT)
"""Suffixes of files of points."""


@dataclasses.dataclass(frozen=True)
class Targets:
    """Where the outputs of a command go.

    Attributes:
        places: where each output is written to.
        folder: in which they lie, if the command has it to itself; its report and a map are put there. None for a file, and in
            place.
        in_place: the places are those of the inputs.
        called: begins the name of the folder in which a run keeps what it needs; by default the name of the first output does.
    """

    GO_ON: ClassVar = ""
    """What else can be done where the folder holds something, in a message."""
    places: list[Place]
    folder: Place | None = None
    in_place: bool = False
    called: str = ""

    def check(self, options: RunOptions) -> None:
        """Raises: OutputError if there is something that would be lost, or a store refuses, before anything is done."""
        folder, replaced = self.folder, options.overwrite or options.resume
        held = [] if folder is None else self.held()
        if held and not replaced:
            first, more = held[0], f" and {len(held) - 1} more" if len(held) > 1 else ""
            raise OutputError(
                f"{folder}: is not empty, it holds {first}{more}: name another folder, {self.GO_ON}or pass overwrite=True to "
                "begin anew"
            )
        for place in self.places if folder is None else [folder / REPORT]:
            if folder is None and is_there(place) and not (replaced or self.in_place):
                raise OutputError(f"{place}: the file exists; pass overwrite=True to replace it")
            if isinstance(place, Remote):
                check_writable(place)

    def complete(self, options: RunOptions) -> bool:
        """Whether a run that goes on finds all that it would make; files appear whole."""
        made = [*self.places, *([] if self.folder is None else [self.folder / REPORT])]
        return options.resume and not (options.overwrite or self.in_place) and all(map(is_there, made))

    def held(self) -> list[str]:
        """Names in the folder, sorted. Raises: OutputError."""
        if isinstance(self.folder, Remote):
            return self.folder.held()
        with output_errors(self.folder or Path()):
            return [] if self.folder is None or not self.folder.exists() else sorted(os.listdir(self.folder))

    @contextlib.contextmanager
    def made_folder(self) -> Iterator[None]:
        """A block before which the folder of the outputs is made; it goes if the block fails and has put nothing there.

        Raises: OutputError.
        """
        folder = self.folder
        if not isinstance(folder, Path) or folder.exists():
            yield
            return
        with output_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        try:
            yield
        except BaseException:
            with contextlib.suppress(OSError):  # it holds something
                folder.rmdir()
            raise


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
    if isinstance(place, Path) and not place.absolute().parent.is_dir():
        raise OutputError(f"{place.absolute().parent} is not a folder: make it first")
    targets_of(place, [str(only)]).check(options)


def targets_of(out: str | Place | None, uris: Sequence[str]) -> Targets:
    """The outputs for some inputs: a file for one, a folder of files, or, for ``out`` None, the inputs themselves.

    Raises: ParameterError for a name that does not fit the number of files; OutputError if an output is an input, or two would
    have one name.
    """
    sources = [place_of(uri) for uri in uris]
    alone = len(sources) == 1
    if out is None:
        return Targets(list(sources), in_place=True)
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
    return Targets(places, None if one else place)


def _real(place: Place) -> str:
    """The same for all names of a file, hard links too."""
    if isinstance(place, Remote):
        return place.uri
    with contextlib.suppress(OSError):
        found = os.stat(place)
        if found.st_ino:  # some file systems number no files
            return f"{found.st_dev} {found.st_ino}"
    return os.path.realpath(place)


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
