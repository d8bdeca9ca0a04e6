"""The code in README and docs is run: Python as it stands, one namespace a page; commands are parsed by the command itself.

What a page prints stands in the block ``text`` after the code, and is compared. Pages run in a folder of their own that holds
a small simulated town as site.laz, survey/ and what else they name. What is not run is listed in NOT_RUN, with the reason.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import tempfile
import warnings
from importlib.metadata import metadata
from pathlib import Path
from typing import Any
from unittest import mock

import click
from sybil import Example, Sybil
from sybil.parsers.markdown import CodeBlockParser

ROOT = Path(__file__).resolve().parent

NOT_RUN = {
    ("docs/adding_a_filter.md", '"""Top hat'): "tests/test_docs.py runs it as a file, since it registers a filter",
    (
        "docs/sweeps.md",
        "study = jf.Study(",
    ): "tests/test_calibrate.py drives a Study with Optuna; here 256 sets on a large scene",
    (
        "docs/from_one_tile_to_a_country.md",
        'report = jf.ground("survey/"',
    ): "docs/examples/tutorials/f_survey.py does it",
    ("docs/examples/tutorials/c_paper_table.py", "samples = {"): "the ISPRS samples may not be passed on",
    ("docs/examples/tutorials/e_few_clicks.py", "clicks, kinds = [], []"): "somebody has to click",
}
"""Page and beginning of a block, and why it is only compiled; of tutorials, which run when the site is built, code blocks."""

CHANGED = {
    "jf.calibrate(jf.SMRF(), cloud, labels)": "jf.calibrate(jf.SMRF(), cloud, labels, size=16, rounds=1)",
}
"""Calls that are made smaller here, since the page's take half a minute."""

OTHERS = ("pip", "python", "python3", "pytest", "dask", "sphinx-build", "curl")
"""Commands of other programs in shell blocks."""


def in_small(folder: Path) -> dict[str, Any]:
    """The files that pages name, of a small town; and the names that they use."""
    import numpy as np

    import jaxfilter as jf
    from jaxfilter.cli.demo import _write_scene

    town = jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)
    _write_scene(folder / "jaxfilter-demo", town)
    site = (folder / "jaxfilter-demo/scene_truth.laz").read_bytes()
    (folder / "survey").mkdir()
    for name in ("site.laz", "in.laz", "classified.laz", "survey/a.laz"):
        (folder / name).write_bytes(site)
    labels = np.where(np.arange(len(town)) % 50 == 0, town.truth, -1)
    patch = np.arange(len(town)) % 50 == 0
    return {"jf": jf, "np": np, "cloud": town.cloud, "truth": town.truth, "labels": labels, "patch": patch}


def in_demo(folder: Path) -> dict[str, Any]:
    """The scene of ``jaxfilter demo``, whose scores the README prints."""
    import jaxfilter as jf
    from jaxfilter.cli.demo import _write_scene

    names = in_small(folder)
    (folder / "jaxfilter-demo").rename(folder / "small")
    _write_scene(folder / "jaxfilter-demo", jf.scenes.make("mixed", size=(400.0, 300.0), density=1.5, seed=0))
    return {"small": names}


def setup(namespace: dict[str, Any]) -> None:
    """Before a page."""
    namespace["_folder"], namespace["_before"] = tempfile.TemporaryDirectory(), Path.cwd()
    os.chdir(namespace["_folder"].name)


def teardown(namespace: dict[str, Any]) -> None:
    """After a page."""
    os.chdir(namespace["_before"])
    namespace["_folder"].cleanup()


def page(example: Example) -> str:
    """Its path in the repository."""
    return Path(example.path).resolve().relative_to(ROOT).as_posix()


def run_python(example: Example) -> None:
    """Run a block; keep what it prints for the block after it."""
    source, names, name = str(example.parsed), example.namespace, page(example)
    code = "\n" * (example.line + 1) + source
    if any(where == name and source.startswith(begin) for where, begin in NOT_RUN):
        compile(code, name, "exec")
        names.pop("_said", None)
        return
    if "jf" not in names:
        names.update(in_demo(Path.cwd()) if name == "README.md" else in_small(Path.cwd()))
    if name == "README.md" and "import jaxfilter" not in source:
        names.update(names["small"])
    for whole, part in CHANGED.items():
        code = code.replace(whole, part)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(compile(code, name, "exec"), names)
    names["_said"] = printed.getvalue()


def check_text(example: Example) -> None:
    """What the code before prints."""
    said = example.namespace.pop("_said", None)
    if said is not None:
        assert said == example.parsed, f"printed:\n{said}"


def check_shell(example: Example) -> None:
    """Commands exist, with the options and the number of arguments that they are given."""
    from jaxfilter.cli import main

    example.namespace.pop("_said", None)
    text = re.sub(r"\\\n\s*", " ", str(example.parsed))
    for line in filter(None, (line.split(" #")[0].strip() for line in text.splitlines())):
        for part in line.split("&&"):
            words = shlex.split(part)
            program = Path(words[0]).name
            if program == "jaxfilter":
                parse(main, words)
                continue
            assert program in OTHERS, f"{line}: {program} is no known command"
            for extra in re.findall(r"(?:jaxfilter|\.)\[(\w+)\]", part):
                assert extra in (metadata("jaxfilter").get_all("Provides-Extra") or ()), f"no extra {extra}"
            scripts = [word for word in words[1:2] if word.endswith(".py")]
            assert all((ROOT / script).exists() or "/" not in script for script in scripts), line


def parse(main: click.Group, words: list[str]) -> None:
    """Let a command take its words apart; files need not exist."""
    with mock.patch.object(click.Path, "convert", lambda self, value, param, ctx: Path(value)):
        context, command, rest = None, main, words[1:]
        while isinstance(command, click.Group):
            context = command.make_context(command.name, list(rest), parent=context)
            _, found, rest = command.resolve_command(context, [*context._protected_args, *context.args])
            assert found is not None, words
            command = found
        command.make_context(command.name, list(rest), parent=context)


pytest_collect_file = Sybil(
    parsers=[
        CodeBlockParser("python", run_python),
        CodeBlockParser("text", check_text),
        CodeBlockParser("sh", check_shell),
    ],
    path=str(ROOT),
    patterns=["README.md", "CONTRIBUTING.md", "docs/*.md", "docs/filters/*.md"],
    setup=setup,
    teardown=teardown,
).pytest()
