"""Compilation: bucketed array sizes, a persistent cache between processes, and a count of what was compiled."""

from __future__ import annotations

import collections
import contextlib
import functools
import inspect
import itertools
import os
import pickle
import platform
import stat
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.monitoring
import numpy as np
from jax.experimental import serialize_executable

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


def on_processor() -> contextlib.AbstractContextManager[Any]:
    """In this block JAX runs on the processor, unless the caller has chosen a default device: for kernels that do so little
    with so many small arrays that the way to another device and back takes longer."""
    chosen = jax.config.jax_default_device is not None  # type: ignore[attr-defined]
    if chosen or jax.default_backend() == "cpu":
        return contextlib.nullcontext()
    try:
        return jax.default_device(jax.local_devices(backend="cpu")[0])
    except RuntimeError:  # JAX was told to leave the processor alone
        return contextlib.nullcontext()


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
    """The private folder for compiled code of a kind, in ``JAXFILTER_CACHE`` if set, else in the user's cache folder; None where
    that is "off". See :func:`private_folder`."""
    import platformdirs

    given = os.environ.get("JAXFILTER_CACHE") or platformdirs.user_cache_dir("jaxfilter")
    return None if given.lower() == "off" else private_folder(Path(given) / kind)


def read_kept(path: Path, stamp: bytes) -> bytes | None:
    """What :func:`write_kept` has written, if it is whole and was made with this stamp. Warns: as :func:`cache_trouble`."""
    try:
        content = path.read_bytes()
        if sha256(content[32:]).digest() != content[:32]:
            raise ValueError("the file is damaged")
        return content[64:] if content[32:64] == stamp else None
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        cache_trouble(path.parent, error)
        return None


def write_kept(path: Path, stamp: bytes, content: bytes) -> None:
    """Write a file that appears whole: the SHA-256 of what follows, the stamp, and the content. Warns: as
    :func:`cache_trouble`."""
    part = path.with_name(f"{path.name}.{os.getpid()}-{threading.get_ident()}")
    try:
        part.write_bytes(sha256(stamp + content).digest() + stamp + content)
        part.replace(path)
    except OSError as error:
        cache_trouble(path.parent, error)
    finally:
        part.unlink(missing_ok=True)


class jit:
    """``jax.jit``, but the machine code for each kind of arguments is kept on disk.

    The next process calls it without tracing the function anew, which takes longer than reading it. It is executed, so it
    lies in a private folder (:func:`cache_folder`), and is used only for the same source, versions, settings and processor.
    """

    def __init__(self, function: Callable[..., Any], static_argnames: str | Sequence[str] = ()) -> None:
        self._static = (static_argnames,) if isinstance(static_argnames, str) else tuple(static_argnames)
        self._name, self._names = function.__qualname__, tuple(inspect.signature(function).parameters)
        self._jit = jax.jit(function, static_argnames=self._static)
        self.lower, self._ready = self._jit.lower, dict[Any, Callable[..., Any]]()
        functools.update_wrapper(self, function)

    def __get__(self, instance: Any, kind: type | None = None) -> Callable[..., Any]:
        return self if instance is None else functools.partial(self, instance)

    def __call__(self, *args: Any, **named: Any) -> Any:
        if not _keeps or _unusual() or (folder := _kept_folder()) is None:
            return self._jit(*args, **named)
        given = dict(zip(self._names, args, strict=False)) | named
        fixed = tuple((name, given[name]) for name in self._static if name in given)
        places = [value for value, name in zip(args, self._names, strict=False) if name not in self._static]
        others = {name: value for name, value in named.items() if name not in self._static}
        leaves, tree = jax.tree.flatten((places, others))
        if any(isinstance(leaf, jax.Array) and not _plain(leaf) for leaf in leaves):
            return self._jit(*args, **named)
        key = tree, fixed, tuple(_kind(leaf) for leaf in leaves), _precision()
        if key not in self._ready:
            digest = sha256(repr((self.__module__, key)).encode()).hexdigest()
            path = folder / f"{self._name}-{digest[:32]}.jax"
            self._ready[key] = _loaded(path) or self._compiled(path, args, named)
        return self._ready[key](*places, **others)

    def _compiled(self, path: Path, args: tuple[Any, ...], named: dict[str, Any]) -> Callable[..., Any]:
        made = self._jit.lower(*args, **named).compile()
        try:
            content = pickle.dumps(serialize_executable.serialize(made))
        except (NotImplementedError, TypeError, ValueError, pickle.PicklingError):
            return made  # JAX cannot serialise every program: this one is compiled anew in each process
        _say_once(path.parent)
        write_kept(path, _stamp(), content)
        return made


def _precision() -> tuple[Any, ...]:
    """Settings that a program depends on and that may be others in a block ``with``."""
    config: Any = jax.config
    return config.jax_enable_x64, config.jax_default_matmul_precision, config.jax_numpy_dtype_promotion


def _unusual() -> bool:
    """Whether JAX shall run functions in a way that kept code does not know: on another device, or watched."""
    config: Any = jax.config
    watched = config.jax_disable_jit or config.jax_debug_nans or config.jax_debug_infs
    return bool(watched) or config.jax_default_device is not None


def _plain(leaf: jax.Array) -> bool:
    """Whether an array has values, on the device that is the default."""
    return not isinstance(leaf, jax.core.Tracer) and leaf.sharding.device_set == _default_device()


@functools.cache
def _default_device() -> set[Any]:
    return {jax.local_devices()[0]}


def _kind(leaf: Any) -> Any:
    """What machine code depends on of an argument."""
    if isinstance(leaf, (np.ndarray, np.generic, jax.Array)):
        return leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)
    return type(leaf).__name__


def _loaded(path: Path) -> Callable[..., Any] | None:
    content = read_kept(path, _stamp())
    try:
        return None if content is None else serialize_executable.deserialize_and_load(*pickle.loads(content))
    except Exception as error:
        cache_trouble(path.parent, error)
        return None


@functools.cache
def _stamp() -> bytes:
    """What machine code depends on besides arguments: sources, versions, settings and the processor."""
    package = Path(__file__).parents[1]
    files = (package.glob(f"{room}*.py") for room in ("", "core/", "engines/**/", "steps/", "methods/"))
    sources = [path.read_bytes() for path in sorted(itertools.chain(*files))]
    settings = {name: value for name, value in jax.config.values.items() if "cache" not in name}
    machine = [platform.machine(), platform.processor(), os.cpu_count(), os.environ.get("XLA_FLAGS")]
    with contextlib.suppress(OSError), open("/proc/cpuinfo") as file:
        machine += [line for line in itertools.islice(file, 40) if line.startswith(("flags", "Features", "model name"))]
    versions = sys.version, jax.__version__, version("jaxlib"), np.__version__
    return sha256(repr((sources, settings, machine, versions)).encode()).digest()


_keeps = True
"""Whether :class:`jit` keeps machine code now."""
_quiet = False
"""Whether somebody has asked for it, who need not be told."""


@functools.cache
def _kept_folder() -> Path | None:
    """Where :class:`jit` keeps machine code. For other devices than the processor JAX keeps it in its own way; where it was
    given a cache directory, that is all there is."""
    if jax.config.jax_compilation_cache_dir:  # type: ignore[attr-defined]
        return None
    if jax.default_backend() == "cpu":
        return cache_folder("jax")
    if (folder := cache_folder("xla")) is not None:
        _say_once(folder)
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return None


def _say_once(folder: Path) -> None:
    """Warn of a folder in which nothing is kept yet."""
    if not _quiet and not any(folder.iterdir()):
        warn(
            f"{folder}: compiled code is kept here from now on, so that the next process need not compile it (said once); set "
            "JAXFILTER_CACHE to another folder, or to off for none"
        )


def keep_compilations(on: bool = True) -> bool:
    """Let the next process reuse what this one compiles from now on, which is so by default, or no longer. Returns: whether it
    was so before. Who calls it is not told of the folder."""
    global _keeps, _quiet
    before, _keeps, _quiet = _keeps, on, True
    return before
