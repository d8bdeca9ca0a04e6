"""Compilation: bucketed array sizes, a persistent cache between processes, and a count of what was compiled."""

from __future__ import annotations

import collections
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import jax
import jax.monitoring

T = TypeVar("T")
R = TypeVar("R")
_BACKEND_COMPILE = "/jax/core/compile/backend_compile_duration"
_compiled: list[float] = []
_listening = False


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


def watch_compilations() -> None:
    """Start counting; idempotent."""
    global _listening
    if not _listening:
        jax.monitoring.register_event_duration_secs_listener(_listen)
        _listening = True


def compilations() -> tuple[int, float]:
    """Number of backend compilations (or cache reads) since :func:`watch_compilations`, and seconds spent on them."""
    return len(_compiled), sum(_compiled)


def cache_directory() -> Path:
    """Where compiled kernels are kept: ``JAXFILTER_CACHE`` if set, else the user's cache folder."""
    import platformdirs

    return Path(os.environ.get("JAXFILTER_CACHE") or platformdirs.user_cache_dir("jaxfilter")) / "xla"


def use_persistent_cache() -> Path | None:
    """Let the next process reuse this one's compilations. Called by the commands, never on import.

    A cache directory that JAX has already been given is left in place. Returns the directory, or None if it cannot
    be made (a read-only home, say), in which case compilation simply is not cached.
    """
    configured = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    directory = Path(configured) if configured else cache_directory()
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    jax.config.update("jax_compilation_cache_dir", str(directory))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return directory
