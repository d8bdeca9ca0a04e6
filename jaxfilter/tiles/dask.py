"""A Dask cluster as the executor of a run. Needs the extra ``cluster``."""

from __future__ import annotations

import math
import queue
import time
import uuid
from collections.abc import Callable
from typing import Any

from ..core.errors import InputError, warn
from .pool import Outcome, attempt

_AHEAD = 2
"""Tasks in flight per thread of the cluster, so that no worker waits for the next one and few are lost with it."""


_ASK = 1.0  # seconds between questions for the workers there are


class Cluster:
    """Workers of a Dask cluster, which see the input files and the output folder by the same names as this process.

    Only paths and numbers travel. The scheduler never holds more than a few tasks per worker; those of a worker that dies
    are given to others.
    """

    def __init__(self, client: Any) -> None:
        """``client``: a ``dask.distributed.Client``, or the address of a scheduler.

        Raises: InputError if the scheduler cannot be reached; ImportError if Dask is missing.
        """
        try:
            from distributed import Client
        except ImportError as error:
            raise ImportError("a Dask cluster needs dask: pip install 'jaxfilter[cluster]'") from error
        self._own = isinstance(client, str)
        if self._own:
            try:
                client = Client(client, timeout=10, set_as_default=False)
            except (OSError, ValueError, TimeoutError) as error:
                raise InputError(f"scheduler {client}: cannot be reached: {error}") from error
        self._client = client
        self._run = uuid.uuid4().hex[:12]
        self._tasks = 0
        self._flying: dict[str, tuple[Any, Any]] = {}
        self._known: list[int] = []
        self._asked = -math.inf
        self._ended: queue.SimpleQueue[str] = queue.SimpleQueue()
        threads = self._threads()
        if threads and max(threads) > 1:
            warn(
                "workers of the cluster have several threads: start them with --nthreads 1, so that memory is as planned"
            )

    def room(self) -> int:
        """Tasks that the workers there are now may be given."""
        return max(1, _AHEAD * sum(self._threads())) - len(self._flying)

    def submit(self, tag: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Give a task to the scheduler."""
        self._tasks += 1
        key = f"jaxfilter-{self._run}-{self._tasks}"
        future = self._client.submit(attempt, function, arguments, key=key, pure=False)
        self._flying[key] = tag, future
        future.add_done_callback(lambda done: self._ended.put(done.key))

    def completed(self, seconds: float) -> list[tuple[Any, Outcome]]:
        """Tasks that have ended, see :class:`jaxfilter.tiles.pool.Executor`."""
        found = []
        try:
            key = self._ended.get(timeout=seconds)
            while True:
                tag, future = self._flying.pop(key)
                try:
                    found.append((tag, future.result()))
                except Exception as error:  # KilledWorker, CancelledError, what cannot be pickled
                    found.append((tag, Outcome(reason=f"{type(error).__name__}: {' '.join(str(error).split())}")))
                future.release()
                key = self._ended.get_nowait()
        except queue.Empty:
            return found

    def close(self) -> None:
        """Cancel what is in flight; a client that was made here is closed."""
        flying = [future for _, future in self._flying.values()]
        self._flying = {}
        if flying:
            self._client.cancel(flying)
        if self._own:
            self._client.close()

    def _threads(self) -> list[int]:
        """Of each worker, as of a second ago at most: it is a question to the scheduler, and asked before every task."""
        if time.monotonic() - self._asked > _ASK:
            self._known, self._asked = list(self._client.nthreads().values()), time.monotonic()
        return self._known
