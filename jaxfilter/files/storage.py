"""Files that are not on a local disk but in object stores and on web servers, through fsspec.

Local files are ``Path``, all others :class:`Remote`; :func:`place_of` tells them apart. What a store needs to be reached
(keys, endpoints, tokens) comes from its own configuration: the environment, its files, or fsspec's
(``FSSPEC_S3_ENDPOINT_URL=...``, ``~/.config/fsspec``), so that no result, record or message holds a secret.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import posixpath
import tempfile
import time
import urllib.parse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, TypeVar, cast

from ..core.errors import InputError, OutputError

ATTEMPTS = 5
"""Times that a request is made before it is given up."""

FIRST_WAIT = 0.25
"""Seconds before the second attempt; each further one waits twice as long."""

_SMALL, _LARGE = 1 << 16, 8 << 20  # bytes read ahead: of headers and chunks, and of files that are read from end to end
_MISSING = (404, 410)
_PASSING = (408, 425, 429, 500, 502, 503, 504)  # HTTP status of failures that may pass
_LASTING = (PermissionError, IsADirectoryError, NotADirectoryError, NotImplementedError, ImportError, ValueError)

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

    def open(self, sequential: bool = False) -> BinaryIO:
        """The file, which can be sought; ``sequential`` reads far ahead. Raises: InputError, also when it is read."""
        ahead = _LARGE if sequential else _SMALL
        file = self._ask(lambda system, path: system.open(path, "rb", block_size=ahead, cache_type="readahead"))
        if not file.seekable():
            raise InputError(f"{self.uri}: the server sends files only as a whole; copy it to a local disk")
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
        """Names in this folder, sorted; none if there is no such folder. Raises InputError if the store cannot be reached."""
        found = self._ask(lambda system, path: system.ls(path, detail=False)) if self.exists() else []
        return sorted({name for one in found if (name := posixpath.basename(one.rstrip("/")))})

    def remove(self) -> None:
        """Remove the file. Raises InputError."""
        self._ask(lambda system, path: system.rm_file(path))

    def exists(self) -> bool:
        """Whether there is such a file. Raises InputError if the store cannot be reached."""
        return self._ask(lambda system, path: bool(system.exists(path)))

    def put(self, local: Path) -> None:
        """Copy a local file there; it appears when all of it has arrived. Raises InputError."""
        self._ask(lambda store, path: store.put_file(str(local), path), "there is no such bucket or folder to write to")

    def _ask(self, act: Callable[[Any, str], _T], missing: str = "no such file") -> _T:
        """What ``act`` returns for the file system and the path there, tried again after failures that may pass. Raises
        InputError that names the URI; ``missing``: what is said of "not found"."""
        import fsspec

        try:
            system, path = fsspec.core.url_to_fs(self.uri)
        except Exception as error:  # a store raises what it likes where a URL is not what it expects
            hint = "; pip install 'jaxfilter[remote]' brings s3:// and https://" * isinstance(error, ImportError)
            raise InputError(f"{self.uri}: cannot be reached: {type(error).__name__}: {error}{hint}") from error
        system.invalidate_cache()
        for attempt in range(1, ATTEMPTS + 1):
            try:
                return act(system, path)
            except InputError:
                raise
            except Exception as error:
                known = error.__cause__  # fsspec calls much "not found" that has another cause
                cause = known if isinstance(known, Exception) else error
                status = _status(cause)
                if status in _MISSING or (status is None and isinstance(cause, FileNotFoundError)):
                    raise InputError(f"{self.uri}: {missing}") from error
                reason = f"{type(cause).__name__}: {cause}" if str(cause) else type(cause).__name__
                if isinstance(cause, _LASTING) or (status is not None and status not in _PASSING):
                    raise InputError(f"{self.uri}: cannot be reached: {reason}") from error
                if attempt == ATTEMPTS:
                    raise InputError(f"{self.uri}: failed {ATTEMPTS} times, the last time with {reason}") from error
            time.sleep(FIRST_WAIT * 2 ** (attempt - 1))
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


@contextlib.contextmanager
def new_object(place: Remote, overwrite: bool) -> Iterator[Path]:
    """A local name to write to; when the block ends, the file is copied to ``place``, where it appears whole. Raises:
    OutputError if it exists and not ``overwrite``, or if the store refuses."""
    try:
        if not overwrite and place.exists():
            raise OutputError(f"{place}: the file exists; pass overwrite=True to replace it")
        with tempfile.TemporaryDirectory(prefix="jaxfilter-", ignore_cleanup_errors=True) as folder:
            part = Path(folder) / "part"
            yield part
            place.put(part)
    except InputError as error:
        if str(error).startswith(f"{place}:"):
            raise OutputError(str(error)) from error
        raise


def check_writable(place: Remote) -> None:
    """Put an empty file beside ``place`` and remove it, before much is done for it. Raises: OutputError if the store refuses."""
    probe = Remote(f"{place}.jaxfilter-run")
    with new_object(probe, overwrite=True) as part:
        part.touch()
    with contextlib.suppress(InputError):  # it may be allowed to write, but not to remove
        probe.remove()


def _status(error: Exception) -> int | None:
    """The HTTP status that an error of aiohttp or of botocore tells of."""
    response = getattr(error, "response", None)
    told = response.get("ResponseMetadata", {}).get("HTTPStatusCode") if isinstance(response, dict) else None
    status = getattr(error, "status", told)
    return status if isinstance(status, int) else None
