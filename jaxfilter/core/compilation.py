"""Compilation: bucketed array sizes, a persistent cache between processes, and a count of what was compiled."""

from __future__ import annotations

import collections
import contextlib
import functools
import os
import re
import stat
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import jax
import jax.monitoring

from .errors import warn

T = TypeVar("T")
R = TypeVar("R")
_BACKEND_COMPILE = "/jax/core/compile/backend_compile_duration"
_compiled: list[float] = []


def bucket(n: int, smallest: int = 1024) -> int:
    """Smallest power-of-two multiple of ``smallest`` that holds ``n``: arrays padded to it reuse a compilation."""
    size = smallest
    while size < n:
        size *= 2
    return size


def on_same_device(function: Callable[[T], R]) -> Callable[[T], R]:
    """The function for another thread, with the default device that the caller has set for its own (it is not inherited)."""
    device = jax.config.jax_default_device  # type: ignore[attr-defined]
    if device is None:
        return function

    def call(argument: T) -> R:
        with jax.default_device(device):
            return function(argument)

    return call


def in_turn(function: Callable[[T], R], jobs: Sequence[T], at_once: int) -> Iterator[tuple[T, R]]:
    """Jobs with what the function makes of them, in their order; so many are worked on at once, in threads, as they are read."""
    pool = ThreadPoolExecutor(at_once)
    run = on_same_device(function)
    try:
        running = collections.deque(pool.submit(run, job) for job in jobs[:at_once])
        for k, job in enumerate(jobs):
            done = running.popleft().result()
            if k + at_once < len(jobs):
                running.append(pool.submit(run, jobs[k + at_once]))
            yield job, done
    finally:
        pool.shutdown(cancel_futures=True)


def _listen(event: str, duration_secs: float, **_: str | int) -> None:
    if event == _BACKEND_COMPILE:
        _compiled.append(duration_secs)


@functools.cache
def watch_compilations() -> None:
    """Start counting; idempotent."""
    jax.monitoring.register_event_duration_secs_listener(_listen)


def compilations() -> tuple[int, float]:
    """Number of backend compilations (or cache reads) since :func:`watch_compilations`, and seconds spent on them."""
    return len(_compiled), sum(_compiled)


_troubles: list[str] = []
"""What was said of caches in this process: one line, whatever goes wrong with them."""


def cache_trouble(folder: Path, reason: Exception | str) -> None:
    """Warn, once in a process, that compiled code in the folder cannot be read or kept."""
    if not _troubles:
        _troubles.append(str(reason))
        warn(
            f"{folder}: compiled code cannot be read or kept here ({reason}) and is made anew, which takes some seconds; if this "
            "is said again, remove the folder, or set JAXFILTER_CACHE to one that only you can write to"
        )


@functools.cache
def private_folder(folder: Path) -> Path | None:
    """The folder, made if need be so that only its owner may read it. None, with a warning, where that cannot be, and where
    others may write to it: what lies there is executed."""
    try:
        folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        if hasattr(os, "getuid") and (reason := _open_to_others(folder.resolve())):
            raise PermissionError(reason)
    except OSError as error:
        cache_trouble(folder, error)
        return None
    return folder


def _open_to_others(folder: Path) -> str:
    """How others may write to a folder or replace it; "" if they may not."""
    for place in (folder, *folder.parents):
        facts = place.stat()
        if place == folder and facts.st_uid not in (0, os.getuid()):
            return f"{place} belongs to user {facts.st_uid}"
        writers = 0o022 if place in (folder, folder.parent) else 0o002
        if facts.st_mode & writers and not (place != folder and facts.st_mode & stat.S_ISVTX):
            return f"others may write to {place}"
    return ""


def cache_folder(kind: str) -> Path | None:
    """The private folder for compiled code of a kind, in ``JAXFILTER_CACHE`` if set, else in the user's cache folder; see
    :func:`private_folder`."""
    import platformdirs

    return private_folder(Path(os.environ.get("JAXFILTER_CACHE") or platformdirs.user_cache_dir("jaxfilter")) / kind)


def use_persistent_cache() -> Path | None:
    """Let the next process reuse this one's compilations. Called by the commands, never on import.

    A cache directory that JAX has already been given is left in place. Returns the directory, or None where there is none
    that can be used (a read-only home, say), in which case compilation simply is not cached.
    """
    configured = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    directory = Path(configured) if configured else cache_folder("xla")
    if directory is None:
        return None
    jax.config.update("jax_compilation_cache_dir", str(directory))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return directory


_OF_CACHE = re.compile(r"Error (?:reading|writing) persistent compilation cache entry for '(\w+)': (.*)", re.DOTALL)


def cache_warning(text: str) -> bool:
    """Whether this is what JAX says of each entry of its cache that it cannot read or write. Such entries are removed, since JAX
    keeps damaged ones, and :func:`cache_trouble` tells of the first."""
    found = _OF_CACHE.match(text)
    directory = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    if found is None or not directory:
        return False
    for entry in Path(directory).glob(f"{found[1]}-*"):
        with contextlib.suppress(OSError):
            entry.unlink()
    cache_trouble(Path(directory), found[2])
    return True
