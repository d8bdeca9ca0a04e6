"""What every command that works has in common: progress, a log, warnings and errors as lines, timing, the compile cache."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import re
import shlex
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Self

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from ..core.errors import JaxfilterError, JaxfilterWarning, ParameterError
from ..core.version import __version__

if TYPE_CHECKING:
    from ..files.storage import Place


class BadUsage(click.ClickException):
    """Wrong usage that is found before anything is read: one line, exit code 2."""

    exit_code = 2


class Stopped(KeyboardInterrupt):
    """A signal asked the command to stop; clean-up runs as it does for Ctrl-C."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


_STOPS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@contextlib.contextmanager
def stoppable() -> Iterator[None]:
    """A block that SIGINT (Ctrl-C), SIGTERM and SIGHUP end in order: what is unfinished is removed, one line is printed,
    and the exit code is 128 and the number of the signal. A signal that was ignored before stays so, as nohup wants it."""
    old = {}
    if threading.current_thread() is threading.main_thread():
        signals = [number for number in _STOPS if signal.getsignal(number) not in (signal.SIG_IGN, None)]
        old = {number: signal.signal(number, _stop) for number in signals}
    try:
        yield
    except KeyboardInterrupt as error:
        number = getattr(error, "number", signal.SIGINT)
        notes = getattr(error, "__notes__", [])
        click.echo("; ".join([f"stopped by {signal.Signals(number).name}", *notes]), err=True)
        raise SystemExit(128 + number) from None
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)


def _stop(number: int, frame: FrameType | None) -> None:
    if not Session.running:  # nothing to clean up yet, and JAX aborts when its import is interrupted by an exception
        os.write(2, f"stopped by {signal.Signals(number).name}\n".encode())
        os._exit(128 + number)
    if frame is not None and frame.f_code.co_name == "_xla_gc_callback":  # what is raised there is ignored, and printed
        threading.Timer(0.01, os.kill, (os.getpid(), number)).start()
        return
    Session.stopped_by = number
    for other in _STOPS:
        if other != signal.SIGINT:  # Ctrl-C can end a clean-up that hangs, the others come in pairs
            signal.signal(other, signal.SIG_IGN)
    raise Stopped(number)


def session_options() -> list[click.Parameter]:
    """The options of every command that works."""
    return [
        click.Option(["--quiet", "-q"], is_flag=True, help="Show no progress and no summary; warnings stay."),
        click.Option(["--json", "as_json"], is_flag=True, help="Print the result as JSON."),
        click.Option(
            ["--log"],
            type=click.Path(dir_okay=False, path_type=Path),
            expose_value=False,
            callback=_remember_log,
            help="Append every step with its time, warnings and errors to this file.",
        ),
        click.Option(["--debug"], is_flag=True, help="Show the traceback of an error."),
    ]


_LOG = "jaxfilter.log"
"""Where the context of a command has the path of its log."""


def _remember_log(context: click.Context, _: click.Parameter, path: Path | None) -> None:
    context.meta[_LOG] = path


logger = logging.getLogger("jaxfilter")
logger.addHandler(logging.NullHandler())  # without --log, nothing of it is printed


@contextlib.contextmanager
def _logged(context: click.Context | None) -> Iterator[None]:
    """A block whose messages to the ``logger`` are appended to the file of --log. Raises BadUsage if that cannot be."""
    path: Path | None = context.meta.get(_LOG) if context is not None else None
    if context is None or path is None:
        yield
        return
    named = [v for value in context.params.values() for v in (value if isinstance(value, tuple) else [value])]
    if any(isinstance(v, (str, Path)) and os.path.realpath(v) == os.path.realpath(path) for v in named):
        raise BadUsage(f"--log {path}: is an input or output as well: name another file")
    try:
        handler = logging.FileHandler(path, encoding="utf-8")
    except OSError as error:
        raise BadUsage(f"--log {path}: cannot be written: {error.strerror}") from error
    handler.setFormatter(logging.Formatter("{asctime}.{msecs:03.0f} {levelname} {message}", "%Y-%m-%dT%H:%M:%S", "{"))
    before = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    try:
        yield
    finally:
        logger.removeHandler(handler)
        handler.close()
        logger.level, logger.propagate = before


LINE_EVERY = 60.0
"""Seconds between lines of progress where there is no terminal, and in the log."""


_RATED = 0.5
"""Seconds before a rate is shown."""


class Rate(ProgressColumn):
    """Items per second; the step has said how many there are."""

    def render(self, task: Task) -> Text:
        """Nothing while it is not known."""
        items, unit, rate, since = (task.fields[key] for key in ("items", "unit", "rate", "since"))
        if rate is None and items and since is not None:
            start, before = since
            seconds = task.get_time() - start  # up to now: a first short step says nothing on the long one after it
            rate = (task.completed - before) * items / seconds if seconds >= _RATED else None
        return Text(f"{short(rate, unit)}/s" if rate else "")


class Memory(ProgressColumn):
    """Resident memory of the process and of those that it has started."""

    max_refresh = 0.5

    def render(self, task: Task) -> Text:
        """In bytes."""
        return Text(short(memory(), "B"))


def short(value: float, unit: str) -> str:
    """Two digits or three, with a prefix: 12.3 M points, 1.2 GB."""
    prefix, size = next(
        (p, n) for p, n in (("T", 1e12), ("G", 1e9), ("M", 1e6), ("k", 1e3), ("", 1.0)) if value >= n or not p
    )
    number = f"{value / size:.{0 if value >= 99.5 * size else 1}f}"
    return f"{number} {prefix}{unit}" if unit == "B" else f"{number} {prefix} {unit}" if prefix else f"{number} {unit}"


def memory() -> float:
    """Bytes of resident memory of this process and of those that it has started."""
    import psutil

    total, own = 0.0, psutil.Process()
    for process in (own, *own.children(recursive=True)):
        with contextlib.suppress(psutil.Error):  # it has ended meanwhile
            total += process.memory_info().rss
    return total


def in_flags(text: str) -> str:
    """A message of the library in the words of the running command: ``pass drop_invalid=True`` becomes
    ``pass --drop-invalid``. Arguments that the command has no flag for stay."""
    context = click.get_current_context(silent=True)
    options = {p.name: p for p in context.command.params if isinstance(p, click.Option)} if context else {}

    def flag(found: re.Match[str]) -> str:
        option = options.get(found[1])
        if option is None:
            return found[0]
        return f"pass {option.opts[0]}" + (f" {found[2]}" if found[2] and not option.is_flag else "")

    return re.sub(r"\bpass (\w+)=([\w.]*)", flag, " ".join(text.split()))


class Session:
    """A context in which a command runs.

    Messages go to standard error, one line each, and with steps and times to the file of --log. Errors of this package and
    of the system become one line and an exit code: 2 for parameters, 1 for the rest. Compilations are counted and kept for
    the next process.
    """

    running = 0
    """How many there are now."""
    stopped_by: int | None = None
    """The signal that ``stoppable`` has received in them."""

    def __init__(self, *, quiet: bool, debug: bool) -> None:
        self.quiet, self.debug = quiet, debug
        self.seconds: dict[str, float] = {}
        self.steps: dict[str, float] = {}
        self.warnings: list[str] = []
        self._console = Console(stderr=True, soft_wrap=True, markup=False, highlight=False)
        self._bar = Progress(
            TextColumn("{task.description:18}"),
            BarColumn(bar_width=12),
            Rate(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),  # by the mean rate of the step so far
            Memory(),
            transient=True,
            speed_estimate_period=math.inf,
            console=self._console,
            disable=quiet or not self._console.is_terminal,
        )
        self._task = self._bar.add_task("", total=1.0, items=None, unit="", rate=None, since=None)
        self._last_line = self._start = time.perf_counter()
        self._stack = contextlib.ExitStack()
        self._mark = ("", 0.0)

    def __enter__(self) -> Self:
        from ..core import compilation

        compilation.watch_compilations()
        context = click.get_current_context(silent=True)
        self._stack.enter_context(_logged(context))
        if context is not None:
            logger.info(f"jaxfilter {__version__}: {shlex.join(sys.argv[1:])}")
        self._stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("always", JaxfilterWarning)
        warnings.showwarning = self._warn
        compilation.use_persistent_cache()
        if not self._bar.disable:  # when it ends, rich before 14.1 prints an empty line even if it is disabled
            self._stack.enter_context(self._bar)
        Session.running, Session.stopped_by = Session.running + 1, None
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            self._end(error)
            self._stack.close()
        finally:
            Session.running -= 1
        if isinstance(error, KeyboardInterrupt) and hasattr(error, "__notes__"):
            error.__notes__ = [in_flags(note) for note in error.__notes__]
        if Session.stopped_by is not None and not isinstance(error, KeyboardInterrupt):
            raise Stopped(Session.stopped_by)  # finalisers and decoders had swallowed it
        if error is None or self.debug or not isinstance(error, Exception) or isinstance(error, click.ClickException):
            return
        if isinstance(error, ParameterError):
            raise BadUsage(in_flags(str(error))) from error
        text = in_flags(str(error)) if isinstance(error, JaxfilterError) else f"{type(error).__name__}: {error}"
        raise click.ClickException(" ".join(text.split())) from error

    def _end(self, error: BaseException | None) -> None:
        """The last line of the log."""
        if isinstance(error, KeyboardInterrupt):
            logger.error("stopped by a signal")
        elif isinstance(error, click.ClickException):
            logger.error(error.format_message())
        elif error is not None and not isinstance(error, SystemExit):
            known = isinstance(error, JaxfilterError)
            logger.error(f"{type(error).__name__}: {error}", exc_info=None if known and not self.debug else error)
        else:
            logger.info(f"done in {time.perf_counter() - self._start:.2f} s")

    @contextlib.contextmanager
    def step(self, name: str, items: float | None = None, unit: str = "points") -> Iterator[None]:
        """Show and time a step of the command; ``items``: how many points or other things it deals with, for its rate."""
        start = time.perf_counter()
        self._bar.reset(self._task, description=name, items=items, unit=unit, rate=None, since=None)
        yield
        self._next("")
        self.seconds[name] = time.perf_counter() - start
        logger.info(f"{name}: {self.seconds[name]:.2f} s")

    def reading(self, *paths: Place) -> contextlib.AbstractContextManager[None]:
        """The step in which files are read; its rate is that of their bytes. Raises: InputError for URLs."""
        return self.step("read", sum(p.stat().st_size if isinstance(p, Path) else p.status()[0] for p in paths), "B")

    def progress(self, fraction: float, step: str, note: str = "", rate: float | None = None) -> None:
        """The callback for a filter: shows the fraction done, with a note, and adds up seconds by step.

        ``rate``: items per second, where it is not that of the fraction.
        """
        self._next(step)
        if self._bar.tasks[0].fields["since"] is None:  # what a resumed sweep had done before does not count as speed
            self._bar.reset(self._task)
            fraction = max(fraction, 1e-9)
            self._bar.update(self._task, since=(self._bar.get_time(), fraction))
        self._bar.update(self._task, description=f"{step} {note}".rstrip(), completed=fraction, rate=rate)
        if time.perf_counter() - self._last_line > LINE_EVERY:
            self._last_line = time.perf_counter()
            self.say(self._line())

    def say(self, text: str) -> None:
        """A line for the log, and for standard error if that is no terminal, which shows the bar."""
        logger.info(text)
        if not self.quiet and not self._console.is_terminal:
            self._console.print(text)

    def note(self, text: str) -> None:
        """A line for the log and for standard error that is no warning."""
        logger.info(text)
        if not self.quiet:
            self._console.print(text)

    def warn(self, text: str) -> None:
        """A line of warning."""
        logger.warning(text)
        self._console.print(f"warning: {text}")

    def _line(self) -> str:
        """What the bar shows, in words."""
        task = self._bar.tasks[0]
        left = "" if task.time_remaining is None else f"{task.time_remaining:,.0f} s left"
        share = f"{100 * task.completed:.0f} %"
        shown = (share, Rate().render(task).plain, left, short(memory(), "B"))
        return f"{task.description}: {', '.join(word for word in shown if word)}"

    def _next(self, step: str) -> None:
        if Session.stopped_by is not None:  # see __exit__
            raise Stopped(Session.stopped_by)
        now = time.perf_counter()
        running, since = self._mark
        if running:
            self.steps[running] = self.steps.get(running, 0.0) + now - since
        self._mark = (step, now)

    def _warn(self, message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        from ..core.compilation import cache_warning

        if cache_warning(str(message)):
            return
        self.warn_of(str(message))

    def warn_of(self, message: str) -> None:
        """A line on a warning of the library, the first time that it comes."""
        text = in_flags(message)
        if text not in self.warnings:
            self.warnings.append(text)
            self.warn(text)

    def as_dict(self) -> dict[str, Any]:
        """Seconds by step of the command and of the filter, compilations, and warnings."""
        from ..core.compilation import compilations

        count, seconds = compilations()
        return {
            "seconds": self.seconds,
            "filter_seconds": self.steps,
            "compilations": {"count": count, "seconds": seconds},
            "warnings": self.warnings,
        }
