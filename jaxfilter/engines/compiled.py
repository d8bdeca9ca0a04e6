"""Host loops as machine code: Numba, without the GIL, kept on disk between processes."""

from __future__ import annotations

import functools
import os
import pickle
import sys
import threading
import time
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from ..core.compilation import cache_folder, cache_trouble, count_compilation, private_folder


def compiled(
    function: Callable[..., Any] | None = None, *, fused: bool = False, allocates: bool = False
) -> Callable[..., Any]:
    """The function, compiled at its first call for the types of its arguments.

    What is compiled is kept in the user's cache folder (see :func:`jaxfilter.core.compilation.cache_folder`;
    ``NUMBA_CACHE_DIR`` sets another), and read by the next process. Where that cannot be, each process compiles for itself,
    and says so once.

    A division by zero raises nothing: it gives infinity, NaN, or 0 of integers.

    ``fused``: a product and the sum it goes into may be one instruction, which rounds once instead of twice, as XLA does.
    ``allocates``: it makes arrays. Such functions count the references to all arrays that they hold. The others do not: a
    count is atomic, takes as long as a test of a triangle, and threads with the same arrays wait for each other at it.
    """
    if function is None:
        return functools.partial(compiled, fused=fused, allocates=allocates)
    options: Any = {"nogil": True, "fastmath": {"contract"} if fused else False, "_nrt": allocates}
    options |= {"error_model": "numpy", "no_cfunc_wrapper": True}  # less to compile
    out: Any = numba.njit(**options)(function)
    if out is not function:  # as with NUMBA_DISABLE_JIT
        out.__class__, out._cache = _Interruptible, _DiskCache(function)
    return out


class _Interruptible(CPUDispatcher):  # type: ignore[misc]
    """A signal that comes while machine code runs is handled when that returns its arrays; Numba then gives a SystemError.

    Where compiled code calls it with constants it is not compiled anew for each.
    """

    depth = 0
    """Compilations that run now, one within the other."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return super().get_call_template([numba.types.unliteral(one) for one in args], kws)

    def compile(self, sig: Any) -> Any:
        """As by Numba, and counted. What it compiles on the way is part of it, and waiting for another thread is none."""
        with global_compiler_lock:
            start, _Interruptible.depth = time.perf_counter(), _Interruptible.depth + 1
            try:
                return super().compile(sig)
            finally:
                _Interruptible.depth -= 1
                if _Interruptible.depth == 0:
                    count_compilation(time.perf_counter() - start)

    def __call__(self, *arguments: Any) -> Any:
        try:
            return super().__call__(*arguments)
        except SystemError as error:
            if error.__cause__ is None:
                raise
            raise error.__cause__ from None


class _DiskCache(NullCache):  # type: ignore[misc]
    """Machine code of a function on disk: a file for the types of its arguments, which holds the SHA-256 of what follows, the
    stamp, and the code.

    ``sources``: digests of the files of the function and of those that it calls, as they are when it is made: they may have been
    edited when it is compiled.
    """

    def __init__(self, function: Any) -> None:
        self.function, self.file = function, Path(function.__code__.co_filename)
        used: Any = (one._cache for one in function.__globals__.values() if isinstance(one, _Interruptible))  # type: ignore[attr-defined]
        own = sha256(self.file.read_bytes()).digest() if self.file.is_file() else b""
        self.sources = {own}.union(*(one.sources for one in used))

    @property
    def cache_path(self) -> str | None:
        own = os.environ.get("NUMBA_CACHE_DIR")
        folder = private_folder(Path(own)) if own else cache_folder("numba")
        return None if folder is None else str(folder)

    @property
    def stamp(self) -> bytes:
        if b"" in self.sources:
            raise FileNotFoundError(f"no such file: {self.file}")
        return sha256(repr((numba.__version__, sys.version, sorted(self.sources))).encode()).digest()

    def _path(self, signature: Any, codegen: Any) -> Path | None:
        if (folder := self.cache_path) is None:
            return None
        key = (self.file, self.function.__code__.co_firstlineno, signature, codegen.magic_tuple(), sys.version)
        name = f"{self.function.__module__}.{self.function.__qualname__}-{sha256(repr(key).encode()).hexdigest()[:32]}"
        return Path(folder, f"{name}.nbc")

    def load_overload(self, signature: Any, context: Any) -> CompileResult | None:
        rtsys.initialize(context)  # all that kept code needs: what Numba knows of functions is for compiling them
        if (path := self._path(signature, context.codegen())) is None:
            return None
        try:
            if not path.exists():
                return None
            content = path.read_bytes()
            if sha256(content[32:]).digest() != content[:32]:
                raise ValueError("the file is damaged")
            return (
                CompileResult._rebuild(context, *pickle.loads(content[64:])) if content[32:64] == self.stamp else None
            )
        except Exception as error:
            cache_trouble(path.parent, error)
            return None

    def save_overload(self, signature: Any, result: Any) -> None:
        path = self._path(signature, result.codegen)
        if path is None or result.library.has_dynamic_globals:
            return
        part = path.with_name(f"{path.name}.{os.getpid()}-{threading.get_ident()}")
        try:
            content = self.stamp + dumps(result._reduce())
            part.write_bytes(sha256(content).digest() + content)
            part.replace(path)
        except OSError as error:
            cache_trouble(path.parent, error)
        finally:
            part.unlink(missing_ok=True)
