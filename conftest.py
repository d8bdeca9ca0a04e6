"""The code in README and docs is run: Python as it stands, one namespace a page; commands of jaxfilter in this process.

What a page prints stands in the block ``text`` after the code, and is compared. Pages run in a folder of their own that holds
a small simulated town as site.laz, survey/ and what else they name; so does every block of commands, in a fresh folder. What
is not run is listed, with the reason: code in NOT_RUN, commands in COMMANDS_NOT_RUN, other programs in OTHERS.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import io
import os
import re
import shlex
import shutil
import tempfile
import warnings
from collections.abc import Iterable
from importlib.metadata import metadata
from pathlib import Path
from typing import Any
from unittest import mock

import click
import pytest
from click.testing import CliRunner
from sybil import Example, Sybil
from sybil.parsers.markdown import CodeBlockParser

ROOT = Path(__file__).resolve().parent

NOT_RUN = {
    (
        "docs/sweeps.md",
        "study = jf.Study(",
    ): "tests/test_calibrate.py drives a Study with Optuna; here 256 sets on a large scene",
    (
        "docs/from_one_tile_to_a_country.md",
        "run = jf.RunOptions(workers=8",
    ): "docs/examples/tutorials/f_survey.py does it",
    (
        "docs/walkthrough.md",
        "import geopandas",
    ): "the tile is not in the repository; tests/test_verdicts.py has verdicts",
    **{
        ("docs/benchmarks.md", begin): "tests/test_datasets.py runs it on generated folders of these layouts"
        for begin in ("opengf =", "dales =", "made_up =", "test =")
    },
    ("docs/examples/tutorials/e_few_clicks.py", "clicks, kinds = [], []"): "somebody has to click",
}
"""Page and beginning of a block, and why it is only compiled; of tutorials, which run when the site is built, code blocks."""

SLOW = {
    ("docs/arrays.md", "towns ="): "tests/test_batch.py has smaller clouds",
    ("docs/arrays.md", "import optax"): "tests/test_grid_filter.py has the gradient",
    ("docs/arrays.md", "from jaxfilter.engines.cloth import surface"): "each operation has tests of its own",
    (
        "docs/dtm.md",
        "jaxfilter dtm classified.laz raw.tif --raw-water",
    ): "tests/test_water_level.py has the same in Python",
    (
        "docs/from_one_tile_to_a_country.md",
        "jaxfilter ground smrf survey/",
    ): "tests/test_cli_runs.py, test_surveys.py and test_layers.py have these commands",
    ("docs/products.md", "jaxfilter ground survey/ usgs/"): "tests/test_classes.py has these presets",
    ("docs/filters/iptd.md", "jf.IPTD()(cloud)"): "tests/test_iptd.py has the method",
    ("docs/filters/ppdf.md", "jf.PPDF"): "tests/test_ppdf.py has the method",
}
"""Page and beginning of a block that runs with ``--slow`` only, and what is tested without it."""

CHANGED = {
    "jf.calibrate(jf.SMRF(), cloud, labels)": "jf.calibrate(jf.SMRF(), cloud, labels, size=16, rounds=1)",
}
"""Calls that are made smaller here, since the page's take half a minute."""

COMMANDS_NOT_RUN = {
    ("README.md", "jaxfilter demo"): "tests/test_cli.py runs it on a smaller scene, and this page on its files",
    ("docs/index.md", "jaxfilter demo"): "as in README.md",
    (
        "docs/from_one_tile_to_a_country.md",
        "jaxfilter ground smrf survey/ s3://",
    ): "needs an object store; tests/test_remote.py writes into a simulated one",
    (
        "docs/from_one_tile_to_a_country.md",
        "jaxfilter dtm classified/ s3://",
    ): "needs an object store; tests/test_remote.py writes into a simulated one",
    (
        "docs/from_one_tile_to_a_country.md",
        "jaxfilter ground smrf survey/ classified/ --scheduler",
    ): "needs a cluster; tests/test_tiles_run.py starts one on this machine",
    ("docs/walkthrough.md", "jaxfilter"): "the tile is not in the repository; other pages run these commands",
    ("docs/surveys.md", "jaxfilter info s3://"): "needs an object store; tests/test_remote.py has a simulated one",
}
"""Page and beginning of a command of jaxfilter that is only parsed."""

OTHERS = {
    ".": "activates an environment",
    "pip": "installs",
    "python3": "installs",
    "pytest": "the tests; tests/test_docs.py runs them on the skeleton of a filter",
    "dask": "needs a cluster",
    "sphinx-build": "the site, which continuous integration builds",
}
"""Other programs in blocks of commands, none of which is run; names of extras and scripts are looked up."""

FEWER = {
    "--bounds 512000 5403000 512090 5403060": "--bounds 512000 5403000 512040 5403080 --size 4 --rounds 1",
    "--bounds 512110 5403170 512200 5403240": "--bounds 512050 5403000 512090 5403080",
    "--bounds 512290 5403130 512380 5403190": "",
    "--axis slope=0.05:0.3:0.05 --axis threshold=0.2:1:0.2": "--axis slope=0.1:0.2:0.1 --axis threshold=0.2:1:0.4",
}
"""Words of commands that are others here: fewer sets, and patches of the small town."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--slow``."""
    parser.addoption("--slow", action="store_true", help="Run the tests that are marked as slow, too")


BRIEF = {f"test_{name}" for name in (
    "docstrings", "experiments", "cli", "adversarial", "agptd", "bad_arguments", "batch", "csf", "docs", "facets",
    "grid_filter", "inpaint", "iptd", "morphology", "msf", "outliers", "switches", "windows", "x64",
)}  # fmt: skip
"""Tests that spend their time in XLA, which compiles many programs that run once, for a moment. It compiles them eight times as
fast if it does not optimise them. All other tests run the code that users run: above all those that hold labels of one program
against labels of another and those of published figures; tests that compute much would take longer, too."""
LONG = [f"test_{name}" for name in ("tiles_run", "surveys", "scenes", "layers", "sweeps", "isprs", "filters")]
"""They come first of those, so that no worker waits for the last of them."""


def brief(item: pytest.Item) -> bool:
    return item.path.suffix == ".md" or item.path.stem in BRIEF


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Tells this process and those that the test starts whether to optimise, and forgets what was compiled in the other way."""
    unoptimised = str(int(brief(item)))
    if os.environ.get("JAX_DISABLE_MOST_OPTIMIZATIONS", "0") != unoptimised:
        import jax

        os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = unoptimised
        jax.config.update("jax_disable_most_optimizations", brief(item))
        jax.clear_caches()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Slow tests take long; most do with another method, or with more points, what a test that is not slow does."""
    items.sort(key=lambda item: (not brief(item), item.path.stem not in LONG))
    for item in items if not config.getoption("--slow") else []:
        example = getattr(item, "example", None)
        if "slow" in item.keywords or (example is not None and begins(example, SLOW)):
            item.add_marker(pytest.mark.skip(reason="slow: runs with --slow"))


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
    """After a page, whose filters are forgotten."""
    from jaxfilter import FILTERS

    os.chdir(namespace["_before"])
    namespace["_folder"].cleanup()
    if "_filters" in namespace:
        FILTERS.data = namespace["_filters"]


def page(example: Example) -> str:
    """Its path in the repository."""
    return Path(example.path).resolve().relative_to(ROOT).as_posix()


def begins(example: Example, blocks: Iterable[tuple[str, str]]) -> bool:
    """Whether a block is one of these."""
    return any(where == page(example) and str(example.parsed).startswith(begin) for where, begin in blocks)


def run_python(example: Example) -> None:
    """Run a block; keep what it prints for the block after it. The README shall warn of nothing."""
    from jaxfilter import FILTERS
    from jaxfilter.core.errors import JaxfilterWarning

    source, names, name = str(example.parsed), example.namespace, page(example)
    code = "\n" * (example.line + 1) + source
    if begins(example, NOT_RUN):
        compile(code, name, "exec")
        names.pop("_said", None)
        return
    if "_filters" not in names:
        names.update(in_demo(Path.cwd()) if name == "README.md" else in_small(Path.cwd()))
        names["_filters"] = dict(FILTERS.data)
    if name == "README.md" and "import jaxfilter" not in source:
        names.update(names["small"])
    for whole, part in CHANGED.items():
        code = code.replace(whole, part)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), warnings.catch_warnings():
        warnings.simplefilter("error" if name == "README.md" else "ignore", JaxfilterWarning)
        exec(compile(code, name, "exec", dont_inherit=True), names)
    names["_said"] = printed.getvalue()


def check_text(example: Example) -> None:
    """What the code before prints."""
    said = example.namespace.pop("_said", None)
    if said is not None:
        assert said == example.parsed, f"printed:\n{said}"


@functools.cache
def files_for_commands() -> Path:
    """The files that commands name, made once."""
    import geopandas
    import shapely

    import jaxfilter as jf

    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder)
    names = in_small(folder)
    for name in ("reference.laz", "checked.laz"):
        shutil.copy(folder / "site.laz", folder / name)
    town = names["cloud"]
    east = jf.PointCloud.from_arrays(town.coordinates() + [90.0, 0.0, 0.0], crs=jf.read(folder / "site.laz").crs)
    jf.write(folder / "survey/b.laz", east, names["truth"])
    jf.open(str(folder / "survey")).to_vpc(folder / "survey.vpc")
    low, high = town.coordinates()[:, :2].min(axis=0), town.coordinates()[:, :2].max(axis=0)
    village = geopandas.GeoSeries([shapely.box(*low, *high).buffer(-5)], crs=east.crs)
    village.to_file(folder / "village.gpkg")
    (folder / "pipeline.json").write_text('["in.laz", {"type": "filters.smrf", "scalar": 1.2}, "out.laz"]')
    return folder


def commands(text: str) -> list[str]:
    """The commands of a block, one after the other."""
    lines = (line.split(" #")[0].strip() for line in re.sub(r"\\\n\s*", " ", text).splitlines())
    return [re.sub(r"^\S*/(?=[\w-]+( |$))", "", part.strip()) for line in lines if line for part in line.split("&&")]


def why_not(name: str, command: str) -> str | None:
    """Why a command of a page is not run; None if it is."""
    program = command.split()[0]
    if program != "jaxfilter":
        assert program in OTHERS, f"{command}: {program} is no known command"
        return OTHERS[program]
    return next(
        (why for (where, begin), why in COMMANDS_NOT_RUN.items() if (where, begin) == (name, command[: len(begin)])),
        None,
    )


def run_shell(example: Example) -> None:
    """Run the commands of a block in a fresh folder; of those that are not run, look up options, arguments and extras."""
    from jaxfilter.cli import main
    from jaxfilter.surveys.executors import Here  # the tests of runs have other processes

    example.namespace.pop("_said", None)
    found = commands(str(example.parsed))
    pool = mock.patch("jaxfilter.surveys.executors.Pool", lambda _: Here())
    with tempfile.TemporaryDirectory() as folder, pool:
        if any(why_not(page(example), command) is None for command in found):
            shutil.copytree(files_for_commands(), folder, dirs_exist_ok=True)
        with contextlib.chdir(folder):
            for command in found:
                run_command(main, page(example), command)


def run_command(main: click.Group, name: str, command: str) -> None:
    """Run one command; it must not fail."""
    words = shlex.split(command)
    if why_not(name, command) is None:
        for whole, part in FEWER.items():
            command = command.replace(whole, part)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            done = CliRunner().invoke(main, shlex.split(command)[1:])
        assert done.exit_code == 0, f"{command}: exit code {done.exit_code}\n{done.output}\n{done.exception!r}"
    elif words[0] == "jaxfilter":
        parse(main, words)
    for extra in re.findall(r"(?:jaxfilter|\.)\[(\w+)\]", command):
        assert extra in (metadata("jaxfilter").get_all("Provides-Extra") or ()), f"no extra {extra}"
    scripts = [word for word in words[1:2] if word.endswith(".py")]
    assert all((ROOT / script).exists() or "/" not in script for script in scripts), command


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
        CodeBlockParser("sh", run_shell),
    ],
    path=str(ROOT),
    patterns=["README.md", "CONTRIBUTING.md", "docs/*.md", "docs/filters/*.md"],
    setup=setup,
    teardown=teardown,
).pytest()
