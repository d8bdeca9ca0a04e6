"""Finds and runs the installed command ``jaxfilter``. Nothing here needs QGIS."""

from __future__ import annotations

import contextlib
import glob
import os
import queue
import re
import shutil
import site
import subprocess
import threading
from collections.abc import Sequence
from typing import IO, Any

NAME = "jaxfilter"
INSTALL = "Run this in a copy of its repository, with any Python from version 3.11 on:\n\n    pip install .\n\n"
PLACE = "If it is not found then, set its path in Settings > Options > Processing > Providers > jaxfilter."
OTHER = "The installed jaxfilter is of another version than this plugin: in a new copy of it, run pip install ."
OF_QGIS = ("PYTHONHOME", "PYTHONPATH", "GDAL_DATA", "GDAL_DRIVER_PATH", "PROJ_LIB", "PROJ_DATA")
"""Variables that QGIS sets for its own Python, GDAL and PROJ; the command has other versions of these."""


class CommandError(Exception):
    """The command is missing, or it failed; the text is what it said."""


def find(setting: str = "") -> str:
    """The path of the command: that of the setting, which may also name the environment that holds it, or else of what PATH
    and the user's own scripts have. Raises CommandError."""
    place = os.path.expanduser(setting.strip())
    versions = glob.glob(os.path.join(glob.escape(site.getuserbase()), "Python3*"))  # each has Scripts on Windows
    roots = [place] if place else [*os.get_exec_path(), site.getuserbase(), *sorted(versions, reverse=True)]
    folders = os.pathsep.join(os.path.join(root, part) for root in roots for part in ("", "bin", "Scripts"))
    found = (place and shutil.which(place)) or shutil.which(NAME, path=folders)
    if not found:
        raise CommandError(f"The command jaxfilter was not found{place and f' at {place}'}. {INSTALL}{PLACE}")
    return found


def run(line: Sequence[str], feedback: Any) -> bool:
    """Run a command; True if it ended well, False if it was cancelled.

    ``feedback`` is that of QGIS: it gets progress, warnings and what the command prints, and says whether to stop. The
    command then gets SIGTERM, and removes what is unfinished. Raises CommandError.
    """
    own = {name: value for name, value in os.environ.items() if name not in OF_QGIS}
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    text = {"encoding": "utf-8", "errors": "replace", "env": {**own, "PYTHONIOENCODING": "utf-8"}}
    try:
        process = subprocess.Popen(line, **streams, **text, creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0))
    except OSError as error:
        raise CommandError(f"{line[0]}: cannot be started: {error.strerror}") from error
    lines: queue.Queue[str | None] = queue.Queue()
    threading.Thread(target=_read, args=(process.stdout, lines), daemon=True).start()
    said, ended = [], False
    try:
        while not ended and not feedback.isCanceled():
            with contextlib.suppress(queue.Empty):
                one = lines.get(timeout=0.2)
                ended = one is None
                if one:
                    said.append(one)
                    tell(one, feedback)
    finally:
        if not ended:
            process.terminate()
        try:
            process.wait(60)  # it may clean up
        except subprocess.TimeoutExpired:
            process.kill()
    if process.returncode and ended:
        error = (
            "\n".join(said[-40:]).rpartition("Error: ")[2]
            or f"it ended with code {process.returncode} and said nothing"
        )
        other = error.startswith(("No such option", "No such command"))
        raise CommandError(f"{error}\n{OTHER}" if other else error)
    return ended


def _read(stream: IO[str], lines: queue.Queue[str | None]) -> None:
    with stream:
        for text in stream:
            lines.put(text.rstrip())
    lines.put(None)


def tell(text: str, feedback: Any) -> None:
    """Pass on a line of the command: progress, a warning, or what else it is."""
    if share := re.search(r": (\d+) %(?:,|$)", text):
        feedback.setProgress(float(share[1]))
        feedback.setProgressText(text)
    else:
        (feedback.pushWarning if text.startswith("warning: ") else feedback.pushConsoleInfo)(text)
