"""What a run keeps on disk until its outputs are complete: this is all that it knows of itself, and resuming is looking.

A tile is done when its file lies here: what was found of its points, and a summary. A file is done when its output lies
where it belongs, and its seal (length and checksum) here. ``run.json`` holds what decides on the outcome. Every file
appears whole or not at all, and shows damage, so that a kill, a full disk or a damage repeats work and mixes nothing.

In place, ``done.json`` says that all outputs are written, and which files take the places of inputs. It stays.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import io
import json
import os
import shutil
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import filelock
import numpy as np

from ..core.errors import DAMAGED, DAMAGED_ARRAYS, InputError, OutputError
from ..core.output import output_errors, sync
from ..files.disk import Seal, check_own, seal_file
from ..files.storage import Place
from .product import KEPT, FileTask, Memory
from .report import Summary

RUN, DONE, _LOCK = "run.json", "done.json", "lock"
_SUMMARY, _STRIPPED, _PER_FOLDER = "summary", "stripped", 1000
NEW = ".jaxfilter-new-"
"""Begins the names of files that are to take the places of inputs."""


class Store(Memory):
    """The folder of a run. One process at a time has it; others may add files of tiles.

    Attributes:
        path: of the folder. Raises: OutputError for one that no run of this user has made.
        facts: what decides on the outcome, and what was found out on the way.
    """

    path: Path

    def __init__(self, path: Path) -> None:
        self.path = path
        self.facts: dict[str, Any] = {}
        check_own(path)

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """A block that has the folder, which is made if missing; it goes if nothing was recorded in the block.

        Raises: OutputError if another run has it, it cannot be made, or is not of this user's own.
        """
        check_own(self.path, make=True)
        lock = filelock.FileLock(self.path / _LOCK, timeout=0)
        with output_errors(self.path):
            try:
                lock.acquire()
            except filelock.Timeout as error:
                raise OutputError(f"{self.path}: another run is writing into this folder") from error
        try:
            yield
        finally:
            if not self.begun and not self.done:
                self.discard()
            lock.release()

    @property
    def begun(self) -> bool:
        """Whether a run was begun here."""
        return (self.path / RUN).exists()

    @property
    def done(self) -> bool:
        """Whether a run in place has written all its outputs."""
        return (self.path / DONE).exists()

    def clear(self, stays: Sequence[str] = ()) -> None:
        """Remove all but the lock, and what ``stays``. Raises: OutputError."""
        check_own(self.path)
        with output_errors(self.path):
            for place in self.path.iterdir():
                if place.is_dir() and not place.is_symlink():
                    shutil.rmtree(place)
                elif place.name not in (_LOCK, *stays):
                    place.unlink()
        self.facts = {}

    def discard(self) -> None:
        """Remove the folder. Raises: OutputError if it is not of this user's own."""
        check_own(self.path)
        shutil.rmtree(self.path, ignore_errors=True)

    def load(self) -> dict[str, Any]:
        """Read the facts again. Raises: InputError if they are damaged; OutputError if the folder holds links."""
        for folder, folders, files in os.walk(self.path):
            if links := [name for name in (*folders, *files) if os.path.islink(os.path.join(folder, name))]:
                raise OutputError(f"{folder}: holds a link ({links[0]}), which is not followed: remove it")
        self.facts = self._read(RUN, "pass overwrite=True to begin the run anew")
        return self.facts

    def _read(self, name: str, advice: str) -> dict[str, Any]:
        """What a file of facts holds; nothing if it is missing. Raises: InputError, with an advice, if it is damaged."""
        try:
            return json.loads((self.path / name).read_text()) | {}
        except FileNotFoundError:
            return {}
        except DAMAGED as error:
            words = " ".join(str(error).split())
            raise InputError(f"{self.path / name}: is damaged, or not of this version ({words}): {advice}") from error

    def begin(self, facts: dict[str, Any]) -> None:
        """Start, or go on with, the run that the facts describe. Raises: InputError if another one is recorded; OutputError."""
        if self.facts:
            self.check_facts(self.facts, facts)
        else:
            self.note(**json.loads(json.dumps(facts)))

    def check_facts(self, begun: dict[str, Any], facts: dict[str, Any]) -> None:
        """Raises: InputError if the run that was begun is another one."""
        for name, value in json.loads(json.dumps(facts)).items():
            if begun.get(name) != value:
                before, now = (f"{json.dumps(one, sort_keys=True):.200}" for one in (begun.get(name), value))
                raise InputError(
                    f"{self.path}: the run was begun with other {name} ({before}, now {now}), and results are not mixed: repeat "
                    "the first command, or pass overwrite=True to begin anew"
                )

    def note(self, **facts: Any) -> None:
        """Record facts. Raises: OutputError."""
        self.facts |= facts
        self._write_json(self.path / RUN, self.facts)

    # tiles

    def tile(self, number: int) -> Path:
        """Where the file of a tile is."""
        return self.path / "tiles" / str(number // _PER_FOLDER) / f"{number}.tile"

    def put(self, number: int, arrays: Mapping[str, np.ndarray], summary: Summary) -> None:
        """Write the file of a tile. Raises: OutputError."""
        self._put(number, {**arrays, _SUMMARY: np.frombuffer(summary.as_json().encode(), np.uint8)})

    def _put(self, number: int, arrays: dict[str, np.ndarray]) -> None:
        body = io.BytesIO()
        np.savez(body, **arrays)  # type: ignore[arg-type]
        self._write(self.tile(number), body.getbuffer())

    def summary(self, number: int) -> tuple[Summary, bool] | None:
        """The summary of a tile, and whether its labels are there; None if it is not done, or damaged."""
        try:
            arrays = self.arrays(number)
            return Summary.of_json(arrays[_SUMMARY].tobytes().decode()), _STRIPPED not in arrays
        except (InputError, *DAMAGED):
            return None

    def arrays(self, number: int, names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
        """What was found of the points of a tile; ``names``: those of them that are there. Raises: InputError if it is gone or
        damaged."""
        path = self.tile(number)
        try:
            found = _loaded(path, path.stat().st_mtime_ns)
        except DAMAGED_ARRAYS as error:
            raise InputError(f"{path}: is gone or damaged; pass resume=True, which makes it again") from error
        return found if names is None else {name: found[name] for name in names if name in found}

    def strip(self, number: int) -> None:
        """Keep of a tile whose files are written the summary, and what begins with :data:`KEPT`. Raises: OutputError."""
        arrays = self.arrays(number)
        if _STRIPPED not in arrays:
            stays = {name: array for name, array in arrays.items() if name == _SUMMARY or name.startswith(KEPT)}
            self._put(number, stays | {_STRIPPED: np.zeros(0)})

    # files

    def seal(self, number: int) -> tuple[Seal, list[str]] | None:
        """By which a finished file is known again, and what was warned of; else None."""
        try:
            known = json.loads(self._file(number).read_text())
            return Seal(**known["seal"]), list(known["remarks"])
        except DAMAGED:
            return None

    def put_seal(self, task: FileTask, remarks: list[str]) -> None:
        """Keep by what a file is known again, and what was warned of. Raises: OutputError."""
        seal = dataclasses.asdict(seal_file(written(task.target, task.how["into"])))
        self._write_json(self._file(task.number), {"seal": seal, "remarks": remarks})

    def drop_seal(self, number: int) -> None:
        """A file is to be written again."""
        self._file(number).unlink(missing_ok=True)

    def _file(self, number: int) -> Path:
        return self.path / "files" / str(number // _PER_FOLDER) / f"{number}.json"

    # all files of a run in place

    def put_done(self, facts: dict[str, Any]) -> None:
        """Say that all outputs are written. This has reached the disk when it returns. Raises: OutputError."""
        self._write_json(self.path / DONE, facts)
        with output_errors(self.path):
            sync(self.path / DONE)
        with contextlib.suppress(OSError):  # not every system can
            sync(self.path)

    def load_done(self) -> dict[str, Any]:
        """What :meth:`put_done` has kept. Raises: InputError."""
        beside = f"look whether files {NEW}* lie beside the inputs, which were to take their places"
        return self._read(DONE, f"{beside}, and remove this folder")

    # bytes

    def _write_json(self, path: Path, value: dict[str, Any]) -> None:
        self._write(path, json.dumps(value, indent=1).encode())

    def _write(self, path: Path, content: bytes | memoryview) -> None:
        with output_errors(path):
            check_own(self.path)
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_name(f"{uuid.uuid4().hex}.part")
            try:
                with open(part, "xb") as file:
                    file.write(content)
                os.replace(part, path)
            finally:
                part.unlink(missing_ok=True)


@functools.lru_cache(maxsize=2)
def _loaded(path: Path, changed: int) -> dict[str, np.ndarray]:
    """The arrays of the file of a tile. A process keeps the last ones: a tile may label a thousand files, one after the other.
    Raises: OSError, ValueError, EOFError, BadZipFile."""
    with np.load(path) as stored:
        return dict(stored)


def written(target: Place, into: Path | None) -> Place:
    """Where the content of an output lies now; ``into``: what is written first if it takes the place of an input."""
    return target if into is None or not into.exists() else into
