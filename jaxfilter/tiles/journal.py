"""The journal of a run: which tiles and files are done, for which inputs and parameters. SQLite, beside the output.

It is written in steps that hold or do not; a run that was killed goes on from the last of them.
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

from ..core.errors import InputError, OutputError

NAME = "jaxfilter-run.sqlite"
_EVERY = 0.5  # seconds between commits
_TABLES = """
create table if not exists facts (name text primary key, value text not null) without rowid;
create table if not exists tiles (number integer primary key, done integer not null, report text not null);
create table if not exists files (number integer primary key, done integer not null, report text not null);
"""


class Journal:
    """An open journal; one process at a time has it."""

    def __init__(self, path: Path) -> None:
        """Open or make it. Raises: OutputError if another run has it, or it cannot be written."""
        self.path = path
        try:
            self._base = sqlite3.connect(path, timeout=0.2, isolation_level=None, check_same_thread=False)
            self._base.execute("pragma locking_mode = exclusive")
            self._base.execute("pragma synchronous = normal")
            self._base.execute("begin immediate")
            for statement in filter(str.strip, _TABLES.split(";")):
                self._base.execute(statement)
            self._base.execute("commit")
        except sqlite3.OperationalError as error:
            busy = "locked" in str(error)
            reason = "another run is writing into this folder" if busy else f"cannot be written: {error}"
            raise OutputError(f"{path}: {reason}") from error
        except sqlite3.DatabaseError as error:
            raise OutputError(
                f"{path}: is not a journal of jaxfilter: {error}; begin anew with overwrite=True"
            ) from error
        self._open, self._since = False, time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Commit, and let go."""
        with contextlib.suppress(OutputError):
            self.commit()
        self._base.close()
        Path(f"{self.path}-journal").unlink(
            missing_ok=True
        )  # of a run that was killed; it was rolled back when this began

    def begin(self, facts: dict[str, Any]) -> None:
        """Start, or go on with, the run that the facts describe. Raises: InputError if another one is recorded."""
        old = dict(self._base.execute("select name, value from facts"))
        new = {name: json.dumps(value, sort_keys=True) for name, value in facts.items()}
        differ = [name for name in new if name in old and old[name] != new[name]]
        if differ:
            name = differ[0]
            before, now = (text if len(text) < 200 else f"{text[:200]}..." for text in (old[name], new[name]))
            raise InputError(
                f"{self.path}: the run was begun with other {name} ({before}, now {now}), and results are not mixed: repeat "
                "the first command, or pass overwrite=True to begin anew"
            )
        self._write("insert or ignore into facts values (?, ?)", *new.items())
        self.commit()

    def fact(self, name: str) -> Any:
        """A fact that was recorded, or None."""
        row = self._base.execute("select value from facts where name = ?", (name,)).fetchone()
        return None if row is None else json.loads(row[0])

    def keep(self, name: str, value: Any) -> None:
        """Record a fact that the run has found."""
        self._write("insert or replace into facts values (?, ?)", (name, json.dumps(value)))
        self.commit()

    def done(self, table: str) -> list[int]:
        """Numbers of the tiles or files that are done, ascending."""
        return [n for (n,) in self._base.execute(f"select number from {table} where done order by number")]

    def record(self, table: str, number: int, done: bool, report: dict[str, Any]) -> None:
        """What became of a tile or a file; on disk within a second, or with the next commit."""
        self._write(f"insert or replace into {table} values (?, ?, ?)", (number, int(done), json.dumps(report)))
        if time.monotonic() - self._since > _EVERY:
            self.commit()

    def forget(self, table: str, numbers: list[int]) -> None:
        """These tiles or files have to be done again."""
        self._write(f"delete from {table} where number = ?", *((n,) for n in numbers))
        self.commit()

    def reports(self, table: str) -> Iterator[tuple[int, bool, dict[str, Any]]]:
        """Number, whether it is done, and report of each tile or file on record, ascending."""
        for number, done, report in self._base.execute(f"select number, done, report from {table} order by number"):
            yield number, bool(done), json.loads(report)

    def commit(self) -> None:
        """Put what was recorded on disk."""
        if self._open:
            self._run("commit")
        self._open, self._since = False, time.monotonic()

    def _write(self, statement: str, *rows: tuple[Any, ...]) -> None:
        if not self._open:
            self._run("begin")
            self._open = True
        for row in rows:
            self._run(statement, row)

    def _run(self, statement: str, row: tuple[Any, ...] = ()) -> None:
        try:
            self._base.execute(statement, row)
        except sqlite3.OperationalError as error:
            raise OutputError(f"{self.path}: cannot be written: {error}") from error
