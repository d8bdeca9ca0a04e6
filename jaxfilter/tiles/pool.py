"""Who does the work of a run: processes on this machine, one task each at a time."""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of a task: its value, or why there is none."""

    value: Any = None
    reason: str | None = None


class Executor(Protocol):
    """Runs functions of picklable arguments elsewhere, some at a time."""

    def room(self) -> int:
        """How many further tasks may be submitted now."""
        ...

    def submit(self, tag: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Begin a task, which is known by its tag; only while there is room."""
        ...

    def completed(self, seconds: float) -> list[tuple[Any, Outcome]]:
        """Tasks that have ended; waits so long for the first of them. A worker that died is an outcome."""
        ...

    def close(self) -> None:
        """Stop at once whatever is running."""
        ...


def attempt(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Outcome:
    """Call a function; what it raises becomes a reason."""
    try:
        return Outcome(function(*arguments))
    except MemoryError:
        return Outcome(reason="the memory did not suffice: pass a smaller tile=, or fewer workers=")
    except Exception as error:
        own = type(error).__module__.startswith("jaxfilter")
        return Outcome(reason=" ".join((str(error) if own else f"{type(error).__name__}: {error}").split()))


class Pool:
    """Processes of this machine. They are spawned, since JAX must not be forked, and die with their parent."""

    def __init__(self, workers: int) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._size = workers
        self._idle: list[_Worker] = []
        self._busy: dict[Connection, tuple[_Worker, Any]] = {}

    def room(self) -> int:
        """Workers without a task."""
        return self._size - len(self._busy)

    def submit(self, tag: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Give a task to an idle worker, or to a new one."""
        worker = self._idle.pop() if self._idle else _Worker(self._context)
        self._busy[worker.connection] = worker, tag
        worker.connection.send((function, arguments))

    def completed(self, seconds: float) -> list[tuple[Any, Outcome]]:
        """Tasks that have ended, see :class:`Executor`."""
        found = []
        for ready in wait(list(self._busy), seconds):
            assert isinstance(ready, Connection)
            worker, tag = self._busy.pop(ready)
            try:
                outcome = ready.recv()
                self._idle.append(worker)
            except (EOFError, OSError):
                code = worker.stopped()
                how = f"killed by signal {-code}" if code is not None and code < 0 else f"exit code {code}"
                outcome = Outcome(reason=f"the worker died ({how}); where the memory was short, pass a smaller tile=")
            found.append((tag, outcome))
        return found

    def close(self) -> None:
        """End all processes."""
        workers = [*self._idle, *(worker for worker, _ in self._busy.values())]
        self._idle, self._busy = [], {}
        for worker in workers:
            worker.process.kill()
        for worker in workers:
            worker.stopped()


class _Worker:
    """A process that does one task after the other."""

    def __init__(self, context: Any) -> None:
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()

    def stopped(self) -> int | None:
        """Wait for its end; the exit code."""
        self.process.join()
        self.connection.close()
        return self.process.exitcode


def _serve(connection: Connection) -> None:
    """The life of a worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    os.environ.setdefault("RAYON_NUM_THREADS", "1")  # of the LAZ codec: one processor a worker
    threading.Thread(target=_die_with_parent, daemon=True).start()
    from ..core.compilation import use_persistent_cache

    use_persistent_cache()
    while True:
        try:
            function, arguments = connection.recv()
        except EOFError:
            return
        connection.send(attempt(function, arguments))


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)
