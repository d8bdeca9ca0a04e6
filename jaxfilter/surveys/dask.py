"""A Dask cluster as the executor of a run. Needs the extra ``cluster``."""

from __future__ import annotations

import collections
import math
import pickle
import queue
import time
import uuid
from collections.abc import Callable
from typing import Any

from ..core.errors import InputError, warn
from .executors import Outcome, attempt

_AHEAD = 2
"""Bundles in flight per thread of the cluster, so that no worker waits for the next one and few are lost with it."""
_LASTS, _MOST = 1.0, 100
"""A bundle begins no further task after so many seconds, and holds no more tasks than this."""
_ASK = 1.0  # seconds between questions for the workers there are

Call = tuple[Callable[..., Any], tuple[Any, ...]]


class Cluster:
    """Workers of a Dask cluster, which see the input files and the output folder by the same names as this process.

    Only paths and numbers travel. Tasks that take long go one by one, short ones in bundles: each submission takes the
    scheduler some milliseconds, and it keeps about half a kilobyte of it as long as it lives. It never holds more than a few
    bundles per worker; those of a worker that dies are given to others.
    """

    def __init__(self, client: Any, most: int = _MOST) -> None:
        """``client``: a ``dask.distributed.Client``, or the address of a scheduler; ``most``: tasks in a bundle.

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
        self._waiting: collections.deque[tuple[Any, Call]] = collections.deque()
        self._suspects: set[Any] = set()
        """Tags of tasks that were lost, with others or alone: from then on each is tried alone."""
        self._flying: dict[str, tuple[list[tuple[Any, Call]], Any]] = {}
        self._most, self._size = most, 1
        self._threads: list[int] = []
        self._asked = -math.inf
        self.submissions = 0
        """Bundles that were given to the scheduler so far."""
        self._ended: queue.SimpleQueue[str] = queue.SimpleQueue()
        if max(self._look(), default=1) > 1:
            warn(
                "workers of the cluster have several threads: start them with --nthreads 1, so that memory is as planned"
            )

    def room(self) -> int:
        """Tasks that the workers there are now may be given."""
        given = len(self._waiting) + sum(len(bundle) for bundle, _ in self._flying.values())
        return self._bundles * self._size - given

    def submit(self, tag: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Put a task, whose tag can be hashed, into the next bundle."""
        self._waiting.append((tag, (function, arguments)))

    def completed(self, seconds: float) -> list[tuple[Any, Outcome]]:
        """Tasks that have ended, see :class:`jaxfilter.surveys.executors.Executor`."""
        self._look()
        self._send()
        found: list[tuple[Any, Outcome]] = []
        try:
            key = self._ended.get(timeout=seconds)
            while True:
                bundle, future = self._flying.pop(key)
                found += self._taken(bundle, future)
                future.release()
                key = self._ended.get_nowait()
        except queue.Empty:
            return found

    def _send(self) -> None:
        """Give what waits to the scheduler, in one message, as far as there is room for further bundles."""
        bundles: dict[str, list[tuple[Any, Call]]] = {}
        free = self._bundles - len(self._flying)
        size = min(self._size, math.ceil(len(self._waiting) / max(free, 1)))
        while len(bundles) < free and self._waiting:
            self.submissions += 1
            bundle = [self._waiting.popleft()]
            while len(bundle) < size and self._waiting and not {bundle[0][0], self._waiting[0][0]} & self._suspects:
                bundle.append(self._waiting.popleft())
            bundles[f"jaxfilter-{self._run}-{self.submissions}"] = bundle
        if not bundles:
            return
        # As bytes, in which what tasks have in common is held once: Dask would wrap each argument, and keeps old messages.
        calls = [pickle.dumps([call for _, call in bundle]) for bundle in bundles.values()]
        futures = self._client.map(together, calls, key=list(bundles), pure=False)
        for (key, bundle), future in zip(bundles.items(), futures, strict=True):
            self._flying[key] = bundle, future
            future.add_done_callback(lambda done: self._ended.put(done.key))

    def _taken(self, bundle: list[tuple[Any, Call]], future: Any) -> list[tuple[Any, Outcome]]:
        """The tasks of a bundle that were done; the others wait again."""
        try:
            outcomes, seconds = future.result()
        except Exception as error:  # KilledWorker, CancelledError, what cannot be pickled
            self._suspects.update(tag for tag, _ in bundle)
            if len(bundle) > 1:  # what kills workers is told from what was with it
                self._waiting.extendleft(reversed(bundle))
                return []
            reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
            return [(bundle[0][0], Outcome(reason=reason))]
        if len(outcomes) < len(bundle):
            self._size = len(outcomes)
            self._waiting.extendleft(reversed(bundle[len(outcomes) :]))
        elif seconds < _LASTS / 2 and len(bundle) == self._size:
            self._size = min(2 * self._size, self._most)
        return [(tag, outcome) for (tag, _), outcome in zip(bundle, outcomes, strict=False)]

    def close(self) -> None:
        """Cancel what is in flight; a client that was made here is closed."""
        flying = [future for _, future in self._flying.values()]
        self._flying = {}
        self._waiting.clear()
        if flying:
            self._client.cancel(flying)
        if self._own:
            self._client.close()

    def _look(self) -> list[int]:
        """The threads of each worker, as of a second ago at most, which decide how many bundles may be in flight."""
        if time.monotonic() - self._asked > _ASK:
            self._threads, self._asked = list(self._client.nthreads().values()), time.monotonic()
        self._bundles = max(1, _AHEAD * sum(self._threads))
        return self._threads


def together(bundle: bytes) -> tuple[list[Outcome], float]:
    """Outcomes of a pickled list of calls, one after the other until the time of a bundle is over, and the seconds they took;
    at least one is done."""
    start = time.perf_counter()
    outcomes: list[Outcome] = []
    for function, arguments in pickle.loads(bundle):
        if outcomes and time.perf_counter() - start > _LASTS:
            break
        outcomes.append(attempt(function, arguments))
    return outcomes, time.perf_counter() - start
