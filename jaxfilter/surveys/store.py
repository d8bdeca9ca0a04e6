"""What a run keeps on disk until its outputs are complete: this is all that it knows of itself, and resuming is looking.

A tile is done when its file lies here: what was found of its points, and a summary. A file is done when its output lies
where it belongs, and its seal (length and checksum) here. ``run.json`` holds what decides on the outcome. Every file
appears whole or not at all, and holds checksums, so that a kill, a full disk or a damage repeats work and mixes nothing.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import uuid
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import DAMAGED, InputError, OutputError
from ..files.disk import output_errors, remove, try_lock

RUN, LOCK = "run.json", "lock"
_SUMMARY, _CHECKSUM, _PER_FOLDER = "summary", 4, 1000
KEPT = "kept_"
"""What arrays begin with that are kept until the run is complete; others go when the files that need them are written."""


class Store:
    """The folder of a run. One process at a time has it; others may add files of tiles.

    Attributes:
        path: of the folder.
        facts: what decides on the outcome, and what was found out on the way.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.facts: dict[str, Any] = {}

    @property
    def index(self) -> Path:
        """Where it is kept what files hold where, see :func:`jaxfilter.files.windows.read_window`."""
        return self.path / "index"

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """A block that has the folder, which is made if missing; it goes if nothing was recorded in the block.

        Raises: OutputError if another run has it, or it cannot be made.
        """
        with output_errors(self.path):
            if self.path.exists() and not self.path.is_dir():
                remove(self.path)
            self.path.mkdir(parents=True, exist_ok=True)
            lock = os.open(self.path / LOCK, os.O_CREAT | os.O_RDWR, 0o600)
        try:
            if try_lock(lock) is False:
                raise OutputError(f"{self.path}: another run is writing into this folder")
            try:
                yield
            finally:
                if not (self.path / RUN).exists():
                    self.discard()
        finally:
            os.close(lock)

    @property
    def begun(self) -> bool:
        """Whether a run was begun here."""
        return (self.path / RUN).exists()

    def unfinished(self) -> bool:
        """Whether there are finished tiles of a run of several."""
        try:
            return self.begun and self.load()["tiles"]["number"] > 1 and any((self.path / "tiles").rglob("*.tile"))
        except (InputError, KeyError, TypeError):
            return True

    def clear(self) -> None:
        """Remove all but the lock. Raises: OutputError."""
        for entry in self.path.iterdir():
            if entry.name != LOCK:
                remove(entry)
        self.facts = {}

    def drop_index(self) -> None:
        """Remove what was found out about inputs."""
        shutil.rmtree(self.index, ignore_errors=True)

    def discard(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.path, ignore_errors=True)

    def load(self) -> dict[str, Any]:
        """Read the facts again. Raises: InputError if they are damaged."""
        path = self.path / RUN
        try:
            self.facts = _checked(path.read_text())
        except FileNotFoundError:
            self.facts = {}
        except DAMAGED as error:
            raise InputError(
                f"{path}: is damaged, or not of this version ({' '.join(str(error).split())}): pass overwrite=True to begin "
                "the run anew"
            ) from error
        return self.facts

    def begin(self, facts: dict[str, Any]) -> None:
        """Start, or go on with, the run that the facts describe. Raises: InputError if another one is recorded; OutputError."""
        new = json.loads(json.dumps(facts))
        for name, value in new.items():
            if self.facts and self.facts.get(name) != value:
                before, now = (_cut(json.dumps(one, sort_keys=True)) for one in (self.facts.get(name), value))
                raise InputError(
                    f"{self.path}: the run was begun with other {name} ({before}, now {now}), and results are not mixed: repeat "
                    "the first command, or pass overwrite=True to begin anew"
                )
        if not self.facts:
            self.note(**new)

    def note(self, **facts: Any) -> None:
        """Record facts. Raises: OutputError."""
        self.facts |= facts
        self._write_json(self.path / RUN, self.facts)

    # tiles

    def tile(self, number: int) -> Path:
        """Where the file of a tile is."""
        return self.path / "tiles" / str(number // _PER_FOLDER) / f"{number}.tile"

    def put(self, number: int, arrays: Mapping[str, np.ndarray], summary: dict[str, Any]) -> None:
        """Write the file of a tile, an .npz with its CRC-32 behind it. Raises: OutputError."""
        body, told = io.BytesIO(), np.frombuffer(json.dumps(summary).encode(), np.uint8)
        np.savez(body, **arrays, **{_SUMMARY: told})  # type: ignore[arg-type]
        checksum = zlib.crc32(body.getbuffer())
        body.seek(0, io.SEEK_END)
        body.write(checksum.to_bytes(_CHECKSUM))
        self._write(self.tile(number), body.getbuffer())

    def summary(self, number: int, with_arrays: bool = False) -> dict[str, Any] | None:
        """The summary of a tile; None if it is not done, damaged, or without the arrays that are asked for."""
        try:
            summary: dict[str, Any] = json.loads(self.arrays(number)[_SUMMARY].tobytes())
        except InputError:
            return None
        return None if summary.pop("stripped", False) and with_arrays else summary

    def arrays(self, number: int, names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
        """What was found of the points of a tile; ``names``: those of them that are there. Raises: InputError if it is gone or
        damaged."""
        path, data = self.tile(number), memoryview(b"")
        with contextlib.suppress(OSError):
            data = memoryview(path.read_bytes())
        body, checksum = data[:-_CHECKSUM], data[-_CHECKSUM:]
        if not len(body) or zlib.crc32(body) != int.from_bytes(checksum):
            raise InputError(f"{path}: is gone or damaged; pass resume=True, which makes it again")
        with np.load(io.BytesIO(body)) as stored:
            return {name: stored[name] for name in (stored if names is None else names) if name in stored}

    def strip(self, number: int) -> None:
        """Keep of a tile whose files are written the summary, and what begins with :data:`KEPT`. Raises: OutputError."""
        if (summary := self.summary(number)) is not None:
            arrays = {name: array for name, array in self.arrays(number).items() if name.startswith(KEPT)}
            self.put(number, arrays, summary | {"stripped": True})

    # files

    def seal(self, number: int) -> dict[str, Any] | None:
        """What is known of a file that is finished, or, without ``"seal"``, is being replaced in place; else None."""
        try:
            return _checked(self._file(number).read_text())
        except DAMAGED:
            return None

    def put_seal(self, number: int, facts: dict[str, Any]) -> None:
        """Keep what is known of a file. Raises: OutputError."""
        self._write_json(self._file(number), facts)

    def drop_seal(self, number: int) -> None:
        """A file is to be written again."""
        self._file(number).unlink(missing_ok=True)

    def _file(self, number: int) -> Path:
        return self.path / "files" / str(number // _PER_FOLDER) / f"{number}.json"

    # bytes

    def _write_json(self, path: Path, value: dict[str, Any]) -> None:
        text = json.dumps(value, indent=1)
        self._write(path, json.dumps({"checksum": zlib.crc32(text.encode()), "holds": value}, indent=1).encode())

    def _write(self, path: Path, content: bytes | memoryview) -> None:
        with output_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_name(f"{uuid.uuid4().hex}.part")
            try:
                part.write_bytes(content)
                os.replace(part, path)
            finally:
                part.unlink(missing_ok=True)


def _checked(text: str) -> dict[str, Any]:
    """What a file with a checksum holds. Raises: ValueError."""
    found = json.loads(text)
    if not isinstance(found, dict) or not isinstance(found.get("holds"), dict):
        raise ValueError("it holds something else")
    if zlib.crc32(json.dumps(found["holds"], indent=1).encode()) != found.get("checksum"):
        raise ValueError("its checksum is another")
    return found["holds"]


def _cut(text: str) -> str:
    return text if len(text) < 200 else f"{text[:200]}..."
