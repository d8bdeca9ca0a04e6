"""What every command that works has in common: progress, a log, warnings and errors as lines, timing, the compile cache."""

from __future__ import annotations

import atexit
import contextlib
import logging
import os
import re
import shlex
import shutil
import signal
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Self

import click

from ..core.errors import JaxfilterError, JaxfilterWarning, ParameterError
from ..core.version import __version__

if TYPE_CHECKING:
    from ..files.storage import Place

LINE_EVERY, _DRAWN_EVERY = 60.0, 0.5
"""Seconds between lines of progress where there is no terminal, and between changes of the line on a terminal."""
_RATED = 0.5
"""Seconds before a rate is shown."""

logger = logging.getLogger("jaxfilter.cli")
logger.setLevel(logging.INFO)
logger.propagate = False
logger.addHandler(logging.NullHandler())  # without --log, nothing of it is printed


class BadUsage(click.ClickException):
    """Wrong usage that is found before anything is read: one line, exit code 2."""

    exit_code = 2


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
        number = next((one for one in error.args if isinstance(one, int)), signal.SIGINT)
        notes = getattr(error, "__notes__", [])
        click.echo("; ".join([f"stopped by {signal.Signals(number).name}", *notes]), err=True)
        raise SystemExit(128 + number) from None
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)
        if old:  # else Ctrl-C at the end of the process prints a traceback of what JAX does there
            atexit.register(signal.signal, signal.SIGINT, signal.SIG_DFL)


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
    raise KeyboardInterrupt(number)


def short(value: float, unit: str) -> str:
    """Two digits or three, with a prefix: 12.3 M points, 1.2 GB."""
    size, prefix = next((n, p) for n, p in ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k"), (0, "")) if value >= n)
    number = f"{value / (size or 1):.{0 if value >= 99.5 * (size or 1) else 1}f}"
    return f"{number} {prefix}{unit}" if unit == "B" or not prefix else f"{number} {prefix} {unit}"


def memory() -> float:
    """Bytes of resident memory of this process and of those that it has started."""
    import psutil

    total, own = 0.0, psutil.Process()
    for process in (own, *own.children(recursive=True)):
        with contextlib.suppress(psutil.Error):  # it has ended meanwhile
            total += process.memory_info().rss
    return total


class Session:
    """A context in which a command runs. Messages go to standard error, one line each, and with steps and times to the file
    ``log``. Errors of this package and of the system become one line and an exit code: 2 for parameters, and for all that is
    wrong before the first step, 1 for the rest. Compilations are counted and kept for the next process."""

    running = 0
    """How many there are now."""
    stopped_by: int | None = None
    """The signal that ``stoppable`` has received in them."""

    def __init__(self, quiet: bool, debug: bool, log: Path | None = None, progress_every: float = LINE_EVERY) -> None:
        self.quiet, self.debug, self.log = quiet, debug, log
        self.seconds: dict[str, float] = {}
        self.steps: dict[str, float] = {}
        self.warnings: list[str] = []
        self.pipe: Path | None = None
        context = click.get_current_context(silent=True)
        options = [p for p in context.command.params if isinstance(p, click.Option)] if context else []
        self._flags = {option.name: option.opts[0] for option in options}
        self._terminal = sys.stderr.isatty() and not quiet
        self._every = _DRAWN_EVERY if self._terminal else progress_every
        self._working = False
        self._items: tuple[float | None, str] = None, ""
        self._since: tuple[float, float] | None = None  # time and fraction at the first report of a step
        self._shown_at = self._start = perf_counter()
        self._mark = ("", 0.0)
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Self:
        from ..core import compilation, process

        process.share_heaps()
        compilation.watch_compilations()
        if self.log is not None:
            handler = self._stack.enter_context(contextlib.closing(_open_log(self.log)))
            logger.addHandler(handler)
            self._stack.callback(logger.removeHandler, handler)
            logger.info(f"jaxfilter {__version__}: {shlex.join(sys.argv[1:])}")
        self._stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("always", JaxfilterWarning)
        warnings.showwarning = lambda message, *_, **__: self.warn(str(message))
        compilation.keep_compilations()
        Session.running, Session.stopped_by = Session.running + 1, None
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            self._clear()
            shown = self._as_shown(error)
            self._stack.close()
        finally:
            Session.running -= 1
        if shown is not None and shown is not error:
            raise shown from error

    def _as_shown(self, error: BaseException | None) -> BaseException | None:
        """An error as it is shown to the user; it is the last line of the log."""
        if Session.stopped_by is not None and not isinstance(error, KeyboardInterrupt):
            error = KeyboardInterrupt(Session.stopped_by)  # finalisers and decoders had swallowed it
        # what goes to standard output is not kept, so that no advice on it helps
        notes = [self.in_flags(note) for note in getattr(error, "__notes__", []) if self.pipe is None]
        if error is None:
            logger.info(f"done in {perf_counter() - self._start:.2f} s")
        elif isinstance(error, KeyboardInterrupt):
            error.__notes__ = notes
            logger.error("stopped by a signal")
        elif isinstance(error, click.ClickException):
            logger.error(error.format_message())
        elif isinstance(error, JaxfilterError):
            logger.error(f"{type(error).__name__}: {error}", exc_info=error if self.debug else None)
            usage = isinstance(error, ParameterError) or not self._working
            return (
                error
                if self.debug
                else (BadUsage if usage else click.ClickException)("; ".join([self.in_flags(str(error)), *notes]))
            )
        elif isinstance(error, Exception):
            logger.error(f"{type(error).__name__}: {error}", exc_info=error)
            return error if self.debug else click.ClickException(" ".join(f"{type(error).__name__}: {error}".split()))
        return error

    @contextlib.contextmanager
    def step(self, name: str, items: float | None = None, unit: str = "points") -> Iterator[None]:
        """Show and time a step of the command; ``items``: how many points or other things it deals with, for its rate."""
        start = perf_counter()
        self._working, self._items, self._since = True, (items, unit), None
        yield
        self._next("")
        self._clear()
        self.seconds[name] = perf_counter() - start
        logger.info(f"{name}: {self.seconds[name]:.2f} s")

    def reading(self, *paths: Place) -> contextlib.AbstractContextManager[None]:
        """The step in which files are read; its rate is that of their bytes. Raises: InputError for URLs."""
        return self.step("read", sum(p.stat().st_size if isinstance(p, Path) else p.status()[0] for p in paths), "B")

    def piped(self, suffix: str, resume: bool = False) -> Path:
        """Where a command writes the file that goes to standard output at its end. Raises BadUsage if that cannot be."""
        if resume or sys.stdout.isatty():
            why = "keeps nothing to resume: name a file" if resume else "is a terminal: add | or >, or name a file"
            raise BadUsage(f"-: standard output {why}")
        self.pipe = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="jaxfilter-"))) / f"out{suffix}"
        return self.pipe

    def progress(self, fraction: float, step: str, note: str = "", rate: float | None = None) -> None:
        """The callback for a filter: shows the fraction done, with a note, and adds up seconds by step. ``rate``: items per
        second, where it is not that of the fraction."""
        self._next(step)
        now = perf_counter()
        self._since = self._since or (now, fraction)
        if now - self._shown_at >= self._every:
            self._shown_at = now
            line = f"{step} {note}".rstrip() + f": {self.standing(fraction, rate)}"
            if self._terminal:
                click.echo(f"\r\x1b[2K{line[: shutil.get_terminal_size().columns - 1]}", err=True, nl=False)
            else:
                self.note(line)

    def standing(self, fraction: float, rate: float | None = None) -> str:
        """The fraction of a step that is done, the rate, the time left by the mean rate since its first report, and memory.
        What a sweep that goes on had done before does not count as speed."""
        (items, unit), (since, before) = self._items, self._since or (perf_counter(), fraction)
        seconds, done = perf_counter() - since, fraction - before
        if rate is None and items and seconds >= _RATED:
            rate = done * items / seconds
        left = f"{seconds * (1 - fraction) / done:,.0f} s left" if done > 0 else ""
        words = (f"{100 * fraction:.0f} %", f"{short(rate, unit)}/s" if rate else "", left, short(memory(), "B"))
        return ", ".join(filter(None, words))

    def note(self, text: str) -> None:
        """A line for the log and for standard error that is no warning."""
        logger.info(text)
        if not self.quiet:
            self._clear()
            click.echo(text, err=True)

    def warn(self, text: str, times: int = 1) -> None:
        """A line of warning, in the words of the command, the first time that it comes; ``times``: how often it came at once."""
        if (text := self.in_flags(text)) in self.warnings:
            return
        self.warnings.append(text)
        text += f" ({times} times)" if times > 1 else ""
        logger.warning(text)
        self._clear()
        click.echo(f"warning: {text}", err=True)

    def in_flags(self, text: str) -> str:
        """A message of the library for users of the command: ``name=value`` is ``--name value`` and ``name=True`` is ``--name``,
        where the command has such an option. Arguments in brackets and parts of paths stay."""

        def flag(found: re.Match[str]) -> str:
            name, value = found.groups()
            return f"{self._flags[name]} {value}".rstrip() if name in self._flags else found[0]

        return re.sub(r"(?<![\w(/?&])(\w+)=(?:True\b)?([^\s,;:.)]?)", flag, " ".join(text.split()))

    def _clear(self) -> None:
        """Take the line of progress away."""
        if self._terminal:
            click.echo("\r\x1b[2K", err=True, nl=False)

    def _next(self, step: str) -> None:
        if Session.stopped_by is not None:  # see _as_shown
            raise KeyboardInterrupt(Session.stopped_by)
        now = perf_counter()
        running, since = self._mark
        if running:
            self.steps[running] = self.steps.get(running, 0.0) + now - since
        self._mark = (step, now)

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


class _LogFile(logging.FileHandler):
    """A log whose disk may be full: that is said once, and the work goes on."""

    def handleError(self, record: logging.LogRecord) -> None:
        logger.removeHandler(self)
        click.echo(f"warning: --log {self.baseFilename}: cannot be written on: {sys.exc_info()[1]}", err=True)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            super().close()


def _open_log(path: Path) -> _LogFile:
    """Appends what the ``logger`` gets to a file. Raises BadUsage if that cannot be, or it is no text."""
    try:
        if path.is_file():
            with path.open("rb") as file:
                if b"\0" in file.read(4096):
                    raise BadUsage(f"--log {path}: exists and is no log, since it holds no text: name another file")
        handler = _LogFile(path, encoding="utf-8")
    except OSError as error:
        raise BadUsage(f"--log {path}: cannot be written: {error.strerror}") from error
    handler.setFormatter(logging.Formatter("{asctime}.{msecs:03.0f} {levelname} {message}", "%Y-%m-%dT%H:%M:%S", "{"))
    return handler
