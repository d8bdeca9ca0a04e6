"""Compilation: bucketed array sizes, a persistent cache between processes, and a count of what was compiled."""

from __future__ import annotations

import collections
import contextlib
import functools
import os
import stat
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.monitoring

from .errors import warn

T = TypeVar("T")
R = TypeVar("R")
_compiled: list[float] = []
"""Seconds of each compilation."""
_troubles: list[str] = []
"""What was said of caches in this process: one line, whatever goes wrong with them."""


def bucket(n: int, smallest: int = 1024) -> int:
    """Smallest power-of-two multiple of ``smallest`` that holds ``n``: arrays padded to it reuse a compilation."""
    size = smallest
    while size < n:
        size *= 2
    return size


def on_processor() -> contextlib.AbstractContextManager[Any]:
    """In this block JAX runs on the processor, unless the caller has chosen a default device: for kernels that do so little
    with so many small arrays that the way to another device and back takes longer."""
    with contextlib.suppress(RuntimeError):  # JAX was told to leave the processor alone
        if jax.config.jax_default_device is None and jax.default_backend() != "cpu":  # type: ignore[attr-defined]
            return jax.default_device(jax.local_devices(backend="cpu")[0])
    return contextlib.nullcontext()


def in_turn(function: Callable[[T], R], jobs: Sequence[T], at_once: int) -> Iterator[tuple[T, R]]:
    """Jobs with what the function makes of them, in their order; so many are worked on at once, in threads, as they are read.
    Threads have the default device of the caller, which they do not inherit."""
    pool, device = ThreadPoolExecutor(at_once), jax.config.jax_default_device  # type: ignore[attr-defined]

    def run(job: T) -> R:
        with contextlib.nullcontext() if device is None else jax.default_device(device):
            return function(job)

    try:
        running = collections.deque(pool.submit(run, job) for job in jobs[:at_once])
        for k, job in enumerate(jobs):
            done = running.popleft().result()
            if k + at_once < len(jobs):
                running.append(pool.submit(run, jobs[k + at_once]))
            yield job, done
    finally:
        pool.shutdown(cancel_futures=True)


@functools.cache
def watch_compilations() -> None:
    """Start counting; idempotent."""

    def listen(event: str, duration_secs: float, **_: str | int) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            _compiled.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)


def count_compilation(seconds: float) -> None:
    """Count what another compiler than that of JAX has compiled, or read from its cache."""
    _compiled.append(seconds)


def compilations() -> tuple[int, float]:
    """Number of compilations (or cache reads), those of JAX since :func:`watch_compilations`, and seconds spent on them."""
    return len(_compiled), sum(_compiled)


def cache_trouble(folder: Path, reason: Exception | str) -> None:
    """Warn, once in a process, that compiled code in the folder cannot be read or kept."""
    if not _troubles:
        _troubles.append(str(reason))
        warn(
            f"{folder}: compiled code cannot be read or kept here ({reason}) and is made anew, which takes some seconds; if this "
            "is said again, remove the folder, or set JAXFILTER_CACHE to one that only you can write to"
        )


def private_folder(folder: Path) -> Path | None:
    """The folder, made if need be so that only its owner may read it. None, with a warning, where that cannot be, and where
    others may write to it or to a folder on the way: what lies there is executed. To be asked before each use."""
    try:
        _make_private(folder.absolute())
    except OSError as error:
        cache_trouble(folder, error)
        return None
    return folder


def _make_private(folder: Path) -> None:
    """Make what is missing of a folder. Raises: PermissionError if another user than root owns a part of its path, or may write
    to it, sticky or not; the same holds for what links lead to."""
    for place in (*reversed(folder.parents), folder):
        place.mkdir(mode=0o700, exist_ok=True)
        if not hasattr(os, "getuid"):
            continue
        facts = place.lstat()
        if facts.st_uid not in (0, os.getuid()):
            raise PermissionError(f"{place} belongs to user {facts.st_uid}")
        if stat.S_ISLNK(facts.st_mode):
            _make_private(place.parent / place.readlink())
        elif facts.st_mode & 0o022:
            raise PermissionError(f"others may write to {place.resolve()}, which chmod go-w forbids")


def cache_folder(kind: str) -> Path | None:
    """The private folder for compiled code of a kind, in ``JAXFILTER_CACHE`` if set, else in the user's cache folder; None where
    that is "off". See :func:`private_folder`."""
    import platformdirs

    given = os.environ.get("JAXFILTER_CACHE") or platformdirs.user_cache_dir("jaxfilter")
    return None if given.lower() == "off" else private_folder(Path(given) / kind)


def keep_compilations() -> None:
    """Let JAX keep what it compiles from now on in the private folder, for this process and later ones. Nothing changes where JAX
    has a cache directory or none is wanted. Commands, workers and :meth:`jaxfilter.Filter.points_of` call it."""
    config: Any = jax.config
    if config.jax_compilation_cache_dir is None and (folder := cache_folder("jax")) is not None:
        config.update("jax_compilation_cache_dir", str(folder))
        config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
