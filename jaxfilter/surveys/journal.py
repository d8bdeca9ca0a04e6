"""The journal of a run: which tiles and files are done, for which inputs and parameters. SQLite, beside the output.

It is written in steps that hold or do not; a run that was killed goes on from the last of them. Every row has a checksum.
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

from ..core.errors import InputError, JaxfilterError, OutputError
from ..files.disk import remove

NAME = "jaxfilter-run.sqlite"
_EVERY = 0.5  # seconds between commits
_TABLES = """
create table if not exists facts (name text primary key, value text not null, checksum integer) without rowid;
create table if not exists tiles (number integer primary key, done integer not null, report text not null, checksum integer);
create table if not exists files (number integer primary key, done integer not null, report text not null, checksum integer);
"""
_COLUMNS = {"facts": "name, value", "tiles": "number, done, report", "files": "number, done, report"}
_NO_ACCESS = {
    sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_PERM, sqlite3.SQLITE_READONLY
}  # fmt: skip


class Journal:
    """An open journal; one process at a time has it."""

    def __init__(self, path: Path) -> None:
        """Open or make it. Raises: OutputError if another run has it, or it cannot be written; InputError if it is damaged."""
        self.path, self._open, self._since = path, False, time.monotonic()
        if path.is_dir():
            raise self._damaged("it is a folder")
        with self._told():
            self._base = sqlite3.connect(path, timeout=0.2, isolation_level=None, check_same_thread=False)
        try:
            with self._told():
                self._base.execute("pragma locking_mode = exclusive")
                self._base.execute("pragma synchronous = normal")
                self._base.execute("begin immediate")
                for statement in filter(str.strip, _TABLES.split(";")):
                    self._base.execute(statement)
                self._base.execute("commit")
                self._check()
        except BaseException:
            self._base.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Commit, and let go."""
        with contextlib.suppress(JaxfilterError):
            self.commit()
        self._base.close()
        Path(f"{self.path}-journal").unlink(
            missing_ok=True
        )  # of a run that was killed; it was rolled back when this began

    def begin(self, facts: dict[str, Any]) -> None:
        """Start, or go on with, the run that the facts describe. Raises: InputError if another one is recorded."""
        old = dict(self._base.execute("select name, value from facts"))
        new = {name: json.dumps(value, sort_keys=True) for name, value in facts.items()}
        differ = [name for name in new if old and old.get(name) != new[name]]
        if differ:
            name = differ[0]
            before, now = (
                text if len(text) < 200 else f"{text[:200]}..." for text in (old.get(name, "none"), new[name])
            )
            raise InputError(
                f"{self.path}: the run was begun with other {name} ({before}, now {now}), and results are not mixed: repeat "
                "the first command, or pass overwrite=True to begin anew"
            )
        if not old:
            self._write("facts", *new.items())
        self.commit()

    def fact(self, name: str) -> Any:
        """A fact that was recorded, or None."""
        row = self._base.execute("select value from facts where name = ?", (name,)).fetchone()
        return None if row is None else json.loads(row[0])

    def keep(self, name: str, value: Any) -> None:
        """Record a fact that the run has found."""
        self._write("facts", (name, json.dumps(value)))
        self.commit()

    def record(self, table: str, number: int, done: bool, report: dict[str, Any]) -> None:
        """What became of a tile or a file; on disk within a second, or with the next commit."""
        self._write(table, (number, int(done), json.dumps(report)))
        if time.monotonic() - self._since > _EVERY:
            self.commit()

    def forget(self, table: str, numbers: list[int]) -> None:
        """These tiles or files have to be done again."""
        self._run(f"delete from {table} where number = ?", *((n,) for n in numbers))
        self.commit()

    def reports(self, table: str) -> Iterator[tuple[int, bool, dict[str, Any]]]:
        """Number, whether it is done, and report of each tile or file on record, ascending."""
        for number, done, report in self._base.execute(f"select number, done, report from {table} order by number"):
            yield number, bool(done), json.loads(report)

    def commit(self) -> None:
        """Put what was recorded on disk."""
        if self._open:
            with self._told():
                self._base.execute("commit")
        self._open, self._since = False, time.monotonic()

    def _write(self, table: str, *rows: tuple[Any, ...]) -> None:
        marks = ", ".join("?" * (len(rows[0]) + 1))
        self._run(f"insert or replace into {table} values ({marks})", *((*row, _sum(row)) for row in rows))

    def _run(self, statement: str, *rows: tuple[Any, ...]) -> None:
        with self._told():
            if not self._open:
                self._base.execute("begin")
                self._open = True
            self._base.executemany(statement, rows)

    def _check(self) -> None:
        """Look at all that is there."""
        (word,) = self._base.execute("pragma quick_check(1)").fetchone()
        if word != "ok":
            raise self._damaged(word)
        for table, columns in _COLUMNS.items():
            for *row, found in self._base.execute(f"select {columns}, checksum from {table}"):
                if _sum(tuple(row)) != found:
                    raise self._damaged(f"row {row[0]!r} of its {table} was changed")

    def _damaged(self, why: object) -> InputError:
        reason = " ".join(str(why).split())
        return InputError(
            f"{self.path}: the journal is damaged, or not one of this version ({reason}): pass overwrite=True to begin the run "
            "anew"
        )

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        """A block that uses the base. Raises: as ``__init__``."""
        try:
            yield
        except sqlite3.Error as error:
            code = getattr(error, "sqlite_errorcode", 0)
            if code & 0xFF in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
                raise OutputError(f"{self.path}: another run is writing into this folder") from error
            if code & 0xFF in _NO_ACCESS and code != sqlite3.SQLITE_IOERR_SHORT_READ:
                raise OutputError(f"{self.path}: cannot be written: {error}") from error
            raise self._damaged(error) from error


def _sum(row: tuple[Any, ...]) -> int:
    return zlib.crc32(repr(row).encode("utf-8", "replace"))


def discard(path: Path) -> None:
    """Remove a journal, in whatever state it is. Raises: OutputError if another run has it, or it cannot be removed."""
    if path.is_file():
        with contextlib.suppress(InputError), Journal(path):  # nobody else is at it
            pass
    for end in ("", "-journal", "-wal", "-shm"):
        remove(Path(f"{path}{end}"))
