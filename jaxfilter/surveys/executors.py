"""Who does the work of a run: this process, or processes on this machine, one task each at a time."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import errno
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol

from ..core.errors import JaxfilterError, OutputError
from ..core.process import UNGUARDED, WORKER, unguarded
from ..core.process import check_main as check_main
from ..core.result import Progress, silent
from .tiles import LOCAL, Local

RETRIES = 2
"""Times that a task that failed is tried again before it is set aside."""
_WAIT = 0.25  # seconds between ticks


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of a task: its value, or why there is none; ``full``: because a disk was, so that no other will do better."""

    value: Any = None
    reason: str | None = None
    full: bool = False


class Executor(Protocol):
    """Runs functions of picklable arguments elsewhere, some at a time."""

    def room(self) -> int:
        """How many further tasks may be submitted now."""

    def submit(self, tag: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Begin a task, which is known by its tag; only while there is room."""

    def completed(self, seconds: float) -> list[tuple[Any, Outcome]]:
        """Tasks that have ended; waits so long for the first of them. A worker that died is an outcome."""

    def close(self) -> None:
        """Stop at once whatever is running."""


@dataclasses.dataclass(frozen=True)
class Task:
    """Something to be done for a tile or a file.

    Attributes:
        function: called elsewhere with what ``arguments`` returns; number: of the tile or file.
        arguments: called when the task is submitted, with whether it is the last try.
    """

    function: Callable[..., Any]
    number: int
    arguments: Callable[[bool], tuple[Any, ...]]


def carried_out(
    executor: Executor,
    todo: Iterator[Task],
    now: collections.deque[Task],
    tick: Callable[[], None],
) -> Iterator[tuple[Task, Outcome]]:
    """Tasks with their outcomes, in the order in which they end. What fails is tried again, :data:`RETRIES` times.

    ``now`` holds tasks that come before the rest, and may be added to meanwhile; ``tick`` is called now and then.

    Raises: OutputError when a disk is full.
    """
    running, tries = 0, collections.Counter[Task]()
    while True:
        while executor.room() > 0:
            task = now.popleft() if now else next(todo, None)
            if task is None:
                break
            executor.submit(task, task.function, *task.arguments(tries[task] >= RETRIES))
            running += 1
        if not running:
            return
        for task, outcome in executor.completed(_WAIT):
            running -= 1
            if outcome.full:
                raise OutputError(f"{outcome.reason}; make room, then pass resume=True to go on")
            if outcome.reason is not None and tries[task] < RETRIES:
                tries[task] += 1
                now.appendleft(task)
                continue
            yield task, outcome
        tick()


def attempt(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Outcome:
    """Call a function; what it raises becomes a reason."""
    try:
        return Outcome(function(*arguments))
    except MemoryError:
        return Outcome(reason="the memory did not suffice: pass a smaller tile=, or fewer workers=")
    except Exception as error:
        own = type(error).__module__.startswith("jaxfilter")
        words = str(error) if own else f"{type(error).__name__}: {error}"
        return Outcome(reason=" ".join(words.split()), full=_is_full(error))


class Here:
    """This process, one task at a time, which may use threads, and a callback for its progress."""

    def __init__(self, threads: int | None = 1, progress: Progress = silent) -> None:
        self._local = Local(threads, progress)
        self._waiting: list[tuple[Any, Callable[..., Any], tuple[Any, ...]]] = []

    def room(self) -> int:
        """One, if nothing waits."""
        return 1 - len(self._waiting)

    def submit(self, tag: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Keep a task for ``completed``."""
        self._waiting.append((tag, function, arguments))

    def completed(self, seconds: float) -> list[tuple[Any, Outcome]]:
        """Do what waits."""
        tag, function, arguments = self._waiting.pop()
        before = LOCAL.set(self._local)
        try:
            return [(tag, attempt(function, arguments))]
        finally:
            LOCAL.reset(before)

    def close(self) -> None:
        """Nothing is running."""


def _is_full(error: BaseException | None) -> bool:
    """Whether an error, or what it comes from, is that of a full disk."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return True
        error = error.__cause__
    return False


class Pool:
    """Processes of this machine. They are spawned, since JAX must not be forked, and die with their parent."""

    def __init__(self, workers: int) -> None:
        """The first worker is started, to know that it can be. Raises: JaxfilterError."""
        self._context = multiprocessing.get_context("spawn")
        self._size = workers
        self._idle: list[_Worker] = []
        self._busy: dict[Connection, tuple[_Worker, Any]] = {}
        first = _Worker(self._context)
        try:
            first.connection.send((os.getpid, ()))
            first.connection.recv()
        except (EOFError, OSError) as error:
            code = first.stopped()
            if code == UNGUARDED:
                raise JaxfilterError(unguarded()) from error
            raise JaxfilterError(
                f"a worker process ended as it began ({_end(code)}); what it said stands above"
            ) from error
        except BaseException:
            first.process.kill()
            raise
        self._idle.append(first)

    def room(self) -> int:
        """Workers without a task."""
        return self._size - len(self._busy)

    def submit(self, tag: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Give a task to an idle worker, or to a new one."""
        worker = self._idle.pop() if self._idle else _Worker(self._context)
        self._busy[worker.connection] = worker, tag
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # it died meanwhile: ``completed`` tells
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
                how = _end(worker.stopped())
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


def _end(code: int | None) -> str:
    return f"killed by signal {-code}" if code is not None and code < 0 else f"exit code {code}"


class _Worker:
    """A process that does one task after the other."""

    def __init__(self, context: Any) -> None:
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), name=WORKER, daemon=True)
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
    from ..core.compilation import keep_compilations
    from ..core.process import collect_seldom, share_heaps

    collect_seldom()
    share_heaps()
    keep_compilations()
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
