"""The outputs of a run in tiles, and the folder in which it keeps what it needs to go on."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

from ..core.errors import InputError, OutputError, ParameterError
from ..core.output import output_errors, sync
from ..files.copc import SUFFIX as COPC
from ..files.copc import is_copc
from ..files.disk import check_own, existing, identify, is_there, warn_of_names
from ..files.storage import Place, Remote, place_of
from .options import RunOptions
from .report import MAP, REPORT
from .store import DONE, NEW, Store
from .targets import Targets

_HIDDEN, _LONGEST = ".jaxfilter-run", 255
"""Name of the folder of a run, and bytes of the longest name."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Claim(Targets):
    """Outputs that a run in tiles has to itself. In place, what is written lies beside the inputs until all is written, and then
    takes their places: before that no input is touched, and after it nothing is left to do but to rename.

    Attributes:
        store: what the run keeps.
    """

    GO_ON: ClassVar = "pass resume=True to go on with a run, "
    store: Store

    @contextlib.contextmanager
    def claimed(self, options: RunOptions) -> Iterator[None]:
        """A block that has the outputs to itself.

        Raises: OutputError if there is something that would be lost, or another run is at it; InputError if what is left of
        a run to go on with is damaged.
        """
        store = self.store
        goes_on = options.resume and (store.begun or store.done)
        with self.made_folder(), store.locked():
            self.check(options)
            if goes_on:
                store.load()
            else:
                self._drop_parts()
                store.clear()
                if options.overwrite:
                    self._remove_old()
            yield

    def check(self, options: RunOptions) -> None:
        """Raises: OutputError if there is something that would be lost, or a store refuses, before anything is done."""
        if options.resume and self.store.begun:
            return
        held = self.held() if options.resume and self.folder is not None else []
        if there := [place for place in self.places if place.name in held]:
            raise OutputError(
                f"{there[0]}: exists, and no run was begun in {self.store.path.parent}: name another folder, or pass "
                "overwrite=True to begin anew"
            )
        super().check(options)

    def held(self) -> list[str]:
        """What the folder, or the run, holds besides the folder of the run. Raises: OutputError."""
        held = [name for name in super().held() if name != self.store.path.name]
        return held or ([str(self.store.path)] if self.store.begun else [])

    def _remove_old(self) -> None:
        """Remove what an earlier run has written into the folder. Raises: OutputError, before anything is removed, for what
        cannot be replaced."""
        if self.folder is None:
            return
        held = set(self.held())
        ours = [place for place in (*self.places, self.folder / REPORT, self.folder / MAP) if place.name in held]
        for path in (place for place in ours if isinstance(place, Path)):
            existing(path)
        for place in ours:
            with output_errors(place):
                place.unlink(missing_ok=True) if isinstance(place, Path) else place.remove()

    def complete(self, options: RunOptions) -> bool:
        """Whether there is nothing to go on with: no run is under way, and the output is there."""
        return self.folder is None and not self.store.begun and super().complete(options)

    def discard(self) -> None:
        """Remove all that the run has kept. Raises: OutputError."""
        self._drop_parts()
        self.store.discard()

    # in place

    def part(self, number: int) -> Path | None:
        """The file that is to take the place of an input, None unless ``in_place``: it lies beside the input, or what its link
        leads to; for an input in a store in the folder of the run."""
        if not self.in_place:
            return None
        place = self.places[number]
        folder = self.store.path if isinstance(place, Remote) else Path(os.path.realpath(place)).parent
        return folder / f"{self._begin}{number}{COPC if is_copc(place) else place.suffix}"

    @property
    def _begin(self) -> str:
        """What the names of such files of this run begin with."""
        return f"{NEW}{hashlib.sha256(str(self.store.path.absolute()).encode()).hexdigest()[:16]}-"

    def _folders(self) -> set[Path]:
        """The folders in which such files lie."""
        return {part.parent for number in range(len(self.places)) if (part := self.part(number)) is not None}

    def _drop_parts(self) -> None:
        """Remove those of an earlier run. Raises: OutputError if they have begun to take the places of inputs."""
        if self.store.done and (left := _left(self.store.load_done())):
            raise OutputError(
                f"{left[0][1]}: a run in place was stopped while its outputs took the places of the inputs: repeat its command "
                "and pass resume=True, which ends that, before anything else is done with them"
            )
        for part in [one for folder in self._folders() for one in folder.glob(f"{self._begin}*")]:
            with output_errors(part):
                part.unlink()

    def check_room(self, sizes: Mapping[int, int]) -> None:
        """``sizes``: bytes of inputs, by number. Raises: OutputError if a disk has no room for them beside the inputs."""
        disks: dict[int, tuple[Path, int]] = {}
        for number, size in sizes.items():
            part = self.part(number)
            assert part is not None
            with output_errors(part.parent):
                disk, there = os.stat(part.parent).st_dev, part.stat().st_size if part.exists() else 0
            disks[disk] = part.parent, disks.get(disk, (part, 0))[1] + size - there
        for folder, needed in disks.values():
            if needed > (free := shutil.disk_usage(folder).free):
                need, have, lack = (f"{one / 1e9:.3g} GB" for one in (needed, free, needed - free))
                raise OutputError(
                    f"{folder}: in place, all outputs are written before the first input is replaced: they need about {need}, "
                    f"{have} are free, {lack} are missing: make room, or name a folder on another disk as the output"
                )

    def replace(self, facts: dict[str, Any], failed: list[dict[str, str]]) -> None:
        """All outputs are written: they take the places of the inputs.

        ``facts``: that tell the command; ``failed``: what the run could not do. Raises: as :meth:`finish`.
        """
        files = []
        for number, place in enumerate(self.places):
            if (part := self.part(number)) is not None and part.exists():
                files.append({"file": str(place), "part": str(part), "before": _identity(place)})
        self.store.put_done({"facts": facts, "failed": failed, "files": files})
        self.finish()

    def finish(self, facts: dict[str, Any] | None = None) -> list[dict[str, str]]:
        """Rename what is written and has not its place yet. ``facts``: that tell the command. Returns: what the run could not do.

        Raises: InputError if another run was begun, or an input was changed meanwhile; OutputError.
        """
        store, done = self.store, self.store.load_done()
        if facts is not None:
            store.check_facts(done["facts"], facts)
        left = _left(done)
        for before, place, part in left:
            if isinstance(place, Path) and before != _identity(place):
                raise InputError(
                    f"{place}: was changed after the run in place, whose output {part} was to replace it: remove the one or "
                    "the other, and pass resume=True"
                )
        for _, place, part in left:
            with output_errors(place):
                if isinstance(place, Path):
                    warn_of_names(place)
                    os.replace(part, os.path.realpath(place))
                else:  # it appears whole, and may be sent twice
                    place.put(part)
                    part.unlink()
        for folder in self._folders():
            with contextlib.suppress(OSError):  # not every system can
                sync(folder)
        self._drop_parts()
        store.clear((DONE,))
        return list(done["failed"])


def _left(done: dict[str, Any]) -> list[tuple[dict[str, Any] | None, Place, Path]]:
    """The outputs that have not taken their places yet: what was there before, its place, and the file that was written."""
    found = ((one["before"], place_of(one["file"]), Path(one["part"])) for one in done["files"])
    return [(before, place, part) for before, place, part in found if part.exists()]


def _identity(place: Place) -> dict[str, Any] | None:
    """Of the file that has this name now. Raises: OSError, InputError."""
    return dataclasses.asdict(identify(place)) if is_there(place) else None


def claim_of(targets: Targets, options: RunOptions, alone: bool) -> Claim:
    """Outputs with the folder of the run: in the folder of all of them, beside the only one, or in the folder above them; of one
    input (``alone``) into a URL, in the user's folder for what programs keep.

    Raises: ParameterError without a local folder for a run into a store; OutputError if another run was begun there, and it is
    not said what to do with it, or by another user.
    """
    import platformdirs

    places, name = targets.places, _HIDDEN
    first = places[0].absolute()
    short = f".{hashlib.sha256(str(first).encode()).hexdigest()[:16]}{_HIDDEN}"
    near: Place = first if isinstance(first, Remote) else first.parent
    if targets.folder is not None:
        near = targets.folder
    elif targets.called:
        name = f".{targets.called}{_HIDDEN}"
    elif len(places) > 1:
        near = place_of(os.path.commonpath([str(place) for place in places]))
    elif isinstance(first, Remote) and alone and options.work is None and options.client is None:
        near, name = platformdirs.user_state_path("jaxfilter"), short
        check_own(near, make=True)
    elif len(os.fsencode(name := f".{first.name}{_HIDDEN}")) > _LONGEST:
        name = short
    work = near if options.work is None else place_of(options.work)
    if isinstance(work, Remote):
        raise ParameterError(
            f"work={options.work!r}: {targets.folder or first} is not on a local disk, and a run needs a local folder that all "
            "workers see: pass work=..."
        )
    store = Store(work / name)
    if targets.folder is None and store.begun and not (options.resume or options.overwrite):
        raise OutputError(
            f"{first}: a run for it was begun and is not complete: pass resume=True to go on with it, or pass overwrite=True to "
            "begin anew"
        )
    return Claim(**vars(targets), store=store)
