"""Files that are not on a local disk but in object stores and on web servers, through fsspec.

Local files are ``Path``, all others :class:`Remote`; :func:`place_of` tells them apart. What a store needs to be reached
(keys, endpoints, tokens) comes from its own configuration: the environment, its files, or fsspec's
(``FSSPEC_S3_ENDPOINT_URL=...``, ``~/.config/fsspec``), so that no result, record or message holds a secret.
"""

from __future__ import annotations

import dataclasses
import os
import posixpath
import time
import urllib.parse
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, TypeVar, cast

from ..core.errors import InputError, JaxfilterError, OutputError

WAITS = (0.25, 0.5, 1.0, 2.0)
"""Seconds before each further attempt of a request that has failed."""

_AHEAD = 1 << 16  # bytes that are read ahead
_LASTING = (PermissionError, IsADirectoryError, NotADirectoryError, NotImplementedError, TypeError, ValueError)

_T = TypeVar("_T")


@dataclasses.dataclass(frozen=True)
class Remote:
    """A file that is reached by its URI, with what of :class:`pathlib.Path` the readers use. Raises: InputError for a chain
    of stores (``::``) and for ``reference:``: they lead to what a file says, not the user."""

    uri: str

    def __post_init__(self) -> None:
        if "::" in self.uri or self.uri.lower().startswith("reference:"):
            raise InputError(
                f"{self.uri}: chains of stores (::) and reference: are not followed; name the file itself, or copy it"
            )
        try:
            urllib.parse.urlsplit(self.uri)
        except ValueError as error:
            raise InputError(f"{self.uri}: is no URL: {error}") from error

    def __str__(self) -> str:
        return self.uri

    @property
    def name(self) -> str:
        return posixpath.basename(urllib.parse.urlsplit(self.uri).path)

    @property
    def suffix(self) -> str:
        return posixpath.splitext(self.name)[1]

    def __truediv__(self, name: str) -> Remote:
        return Remote(f"{self.uri.rstrip('/')}/{name}")

    def absolute(self) -> Remote:
        """Itself."""
        return self

    def status(self) -> tuple[int, str]:
        """Bytes, and what changes with the content: the ETag, or else the time of the last change. Raises: InputError."""
        facts = self._ask(lambda system, path: system.info(path))
        if facts.get("type") == "directory":
            raise InputError(f"{self.uri}: is a folder, a file is needed")
        if facts.get("size") is None:
            raise InputError(f"{self.uri}: the server does not say how large it is; copy it to a local disk")
        known = (facts.get(key) for key in ("ETag", "Last-Modified", "LastModified", "mtime", "created"))
        return int(facts["size"]), str(next((value for value in known if value), ""))

    def open(self) -> BinaryIO:
        """The file, which can be sought. Raises: InputError, also when it is read."""
        file = self._ask(lambda system, path: system.open(path, "rb", block_size=_AHEAD, cache_type="readahead"))
        if (cache := getattr(file, "cache", None)) is not None:  # stores in memory have none, and do not fail
            fetch = cache.fetcher
            cache.fetcher = lambda start, end: self._ask(lambda *_: fetch(start, end))
        return cast(BinaryIO, file)

    def listed(self, suffixes: tuple[str, ...]) -> list[str]:
        """URIs of the files in this folder, or that match it as a pattern, that end so (in any case), sorted."""

        def find(system: Any, path: str) -> list[str]:
            found = system.glob(path) if any(c in self.uri for c in "*[") else system.ls(path, detail=False)
            return sorted(system.unstrip_protocol(one) for one in found if one.lower().endswith(suffixes))

        return self._ask(find)

    def held(self) -> list[str]:
        """Names in this folder, sorted; none if there is no such folder. Raises OutputError if the store refuses."""
        if not self.exists(OutputError):
            return []
        found = self._ask(lambda system, path: system.ls(path, detail=False), OutputError)
        return sorted({posixpath.basename(one.rstrip("/")) for one in found} - {""})

    def remove(self) -> None:
        """Remove the file. Raises OutputError."""
        self._ask(lambda system, path: system.rm_file(path), OutputError)

    def exists(self, error: type[JaxfilterError] = InputError) -> bool:
        """Whether there is such a file. Raises ``error`` if the store cannot be reached."""
        return self._ask(lambda system, path: bool(system.exists(path)), error)

    def put(self, local: Path) -> None:
        """Copy a local file there; it appears when all of it has arrived. Raises OutputError."""
        self._ask(lambda store, path: store.put_file(str(local), path), OutputError)

    def _ask(self, act: Callable[[Any, str], _T], error: type[JaxfilterError] = InputError) -> _T:
        """What ``act`` returns for the file system and the path there, tried again after failures that may pass. Raises an
        ``error`` that names the URI."""
        import fsspec

        for wait in (*WAITS, None):
            try:
                system, path = fsspec.core.url_to_fs(self.uri)
                system.invalidate_cache()
                return act(system, path)
            except JaxfilterError:
                raise
            except Exception as failure:  # a store raises what it likes
                cause = failure.__cause__ or failure  # fsspec calls much "not found" that has another cause
                status = _status(cause)
                why = f"cannot be reached: {type(cause).__name__}: {cause}"
                if status in (404, 410) or (status is None and isinstance(cause, FileNotFoundError)):
                    why = "no such bucket or folder to write to" if error is OutputError else "no such file"
                elif "range requests" in str(cause):
                    why = "the server does not support range requests, which read parts of a file; download the file first"
                elif isinstance(cause, ImportError):
                    why += "; pip install 'jaxfilter[remote]' brings s3:// and https://"
                elif wait and not isinstance(cause, _LASTING) and (status or 500) in (408, 425, 429, *range(500, 600)):
                    time.sleep(wait)
                    continue
                raise error(f"{self.uri}: {why}") from failure
        raise AssertionError("unreachable")


Place = Path | Remote


def place_of(what: str | os.PathLike[str] | Remote) -> Place:
    """A local path, or a URI; ``file://`` is local. Raises: InputError for a name that is not UTF-8."""
    if isinstance(what, Remote):
        return what
    text = os.fsdecode(what)
    try:
        text.encode()
    except UnicodeEncodeError as error:
        shown = os.fsencode(text).decode("utf-8", "backslashreplace")
        raise InputError(f"{shown}: the name of the file is not UTF-8; rename it") from error
    if "://" not in text:
        return Path(text)
    scheme, _, rest = text.partition("://")
    return Path(urllib.parse.unquote(rest)) if scheme in ("file", "local") else Remote(text)


def _status(error: BaseException) -> int | None:
    """The HTTP status that an error of aiohttp or of botocore tells of."""
    response = getattr(error, "response", None)
    told = response.get("ResponseMetadata", {}).get("HTTPStatusCode") if isinstance(response, dict) else None
    status = getattr(error, "status", told)
    return status if isinstance(status, int) else None
