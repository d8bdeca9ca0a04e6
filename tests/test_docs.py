"""Pages list parameters as they are declared; the skeleton of a filter is one; code and links of pages are sound.

The code of the pages is run by conftest.py of the repository.
"""

import contextlib
import functools
import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxfilter import FILTERS, plots
from jaxfilter.core.params import declared
from jaxfilter.engines.cloth import surface
from jaxfilter.engines.grid import cells as grid
from jaxfilter.engines.grid import cones, inpaint, morphology, sampling, spread, windows
from jaxfilter.engines.tin import facets
from jaxfilter.steps import planes

PAGES = Path(__file__).resolve().parents[1] / "docs" / "filters"
sys.path.insert(0, str(PAGES.parents[1]))

from experiments.defaults import table  # noqa: E402


def load(path):
    """A file as a module, whatever else has its name."""
    spec = importlib.util.spec_from_file_location(f"page_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", list(FILTERS))
def test_the_page_of_a_filter_lists_its_parameters_and_presets(name):
    text = (PAGES / f"{name}.md").read_text()
    listed = [line for line in text.splitlines() if line.startswith("| `")]
    fields = table.rows(name) if table.HEAD in text else [table.row(field) for field in declared(FILTERS[name])]
    assert listed[: len(fields)] == fields, "run experiments/defaults/table.py"
    notes = [f"| `{preset}` | {values.note} |" for preset, values in FILTERS[name].PRESETS.items()]
    assert listed[len(fields) :][: len(notes)] == notes, "\n".join(notes)


def test_every_preset_says_what_it_is_and_paper_what_is_not_as_printed():
    for method in FILTERS.values():
        assert all(values.note and "\n" not in values.note for values in method.PRESETS.values()), method
        assert re.match(r"as (printed|reported)\b", method.PRESETS["paper"].note), method


def test_every_default_has_an_origin_on_the_page_of_its_method():
    fields = {(name, field.name) for name in FILTERS for field in declared(FILTERS[name])}
    assert set(table.origins()) == fields
    assert [name for name in FILTERS if table.HEAD not in (PAGES / f"{name}.md").read_text()] == ["ost"]
    text = (PAGES.parent / "fidelity.md").read_text()
    assert all(f"`{field}`" in text for name, field in fields if name == "ost")


@pytest.mark.parametrize("name, words, passes", [
    ("sieve", " and edited", 1), ("tilted", " and edited", 1),  # test_sweeps.py has what sets of such filters share
    *(pytest.param(name, "", 40, marks=pytest.mark.slow) for name in ("tophat", "sieve", "tilted")),
])  # fmt: skip
def test_filters_of_users_pass_the_suite_of_all_filters(name, words, passes, tmp_path):
    """The two on the page, one of which has a rule of its own, and another one on a grid."""
    file = Path(__file__).parent / "user_filter.py"
    if name != "sieve":
        blocks = re.findall(r"```python\n(.*?)```", (PAGES.parent / "adding_a_filter.md").read_text(), re.DOTALL)
        (text,) = (block for block in blocks if re.search(rf"^class {name}\(", block, re.MULTILINE | re.IGNORECASE))
        file = tmp_path / "mine.py"
        file.write_text(text)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-v", "-x", "-n", "0", "-p", "no:cacheprovider", "tests/test_filters.py"]
        + ["--filter-file", str(file), "-k", name + words],
        cwd=PAGES.parents[1],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert int(re.search(r"(\d+) passed", done.stdout)[1]) >= passes, done.stdout[-300:]


def test_code_blocks_name_a_language_that_is_run():
    """conftest.py of the repository runs ``python`` and ``sh``, and compares ``text`` with what the code before prints."""
    root = PAGES.parents[1]
    pages = [root / "README.md", root / "CONTRIBUTING.md", *PAGES.parent.glob("*.md"), *PAGES.glob("*.md")]
    for page in pages:
        fences = re.findall(r"^ *```(.*)$", page.read_text(), re.MULTILINE)
        kinds = {kind for kind in fences[::2] if not kind.startswith("{")}
        assert kinds <= {"python", "sh", "text"}, f"{page}: {kinds}: name the language, python, sh or text"


def test_commands_of_pages_that_are_not_run_are_listed_and_nothing_else_is():
    root, rules = PAGES.parents[1], load(PAGES.parents[1] / "conftest.py")
    found = [
        (page.relative_to(root).as_posix(), command)
        for page in [root / "README.md", root / "CONTRIBUTING.md", *PAGES.parent.glob("*.md"), *PAGES.glob("*.md")]
        for block in re.findall(r"```sh\n(.*?)```", page.read_text(), re.DOTALL)
        for command in rules.commands(block)
    ]
    run = [command for name, command in found if rules.why_not(name, command) is None]
    assert len(run) > 20 and all(command.startswith("jaxfilter ") for command in run)
    for name, begin in rules.COMMANDS_NOT_RUN:
        assert any(where == name and command.startswith(begin) for where, command in found), begin
    assert {command.split()[0] for _, command in found} == {"jaxfilter", *rules.OTHERS}
    assert all(any(words in command for _, command in found) for words in rules.FEWER)


def test_code_that_tutorials_only_show_is_listed_with_a_reason_and_compiles():
    listed = {key for key in load(PAGES.parents[1] / "conftest.py").NOT_RUN if key[0].endswith(".py")}
    shown = set()
    for page in PAGES.parent.glob("examples/*/*.py"):
        for block in re.findall(r"# \.\. code-block:: python\n#\n((?:#(?:     .*)?\n)+)", page.read_text()):
            code = re.sub(r"^#(?:     )?", "", block, flags=re.MULTILINE)
            compile(code, str(page), "exec")
            shown.add((page.relative_to(PAGES.parents[1]).as_posix(), code))
    assert len(shown) == len(listed)
    for name, code in shown:
        assert any(name == where and code.startswith(begin) for where, begin in listed), (name, code)


def test_every_plot_is_in_the_gallery():
    code = "".join(page.read_text() for page in PAGES.parent.glob("examples/plots/*.py"))
    drawn = {name for name, value in vars(plots).items() if callable(value)}
    assert drawn == set(re.findall(r"jf\.plots\.(\w+)\(", code))


def test_links_of_a_site_that_lead_nowhere_are_found(tmp_path):
    (tmp_path / "a.html").write_text(
        '<h1 id="top"></h1><a href="b.html#here">1</a><a href="#top">2</a><a href="https://example.org">3</a>'
        '<a href="b.html#gone">4</a><a href="c.html">5</a><img src="https://example.org/x.png"><img src="x%20y.png">'
    )
    (tmp_path / "b.html").write_text('<a name="here"></a>')
    (tmp_path / "x y.png").write_bytes(bytes(1000))
    checks = load(PAGES.parent / "checks.py")
    found = checks.broken_links(tmp_path)
    assert [line.split(": ")[1].split()[0] for line in found] == ["b.html#gone", "c.html", "loads"]
    assert checks.weight(tmp_path, "a.html") == 1000 + (tmp_path / "a.html").stat().st_size


@pytest.mark.parametrize("name", list(FILTERS))
def test_help_on_a_filter_has_unit_range_and_default_of_every_field(name):
    said = re.sub(r"\s+", " ", FILTERS[name].__doc__.partition("\nArgs:\n")[2])
    for field in declared(FILTERS[name]):
        meta = field.metadata
        facts = re.search(rf"(?:^| ){field.name} \(([^)]*)\): {re.escape(meta['doc'])}", said)
        assert facts, field.name
        assert f"default {field.default!r}" in facts[1]
        assert (meta.get("unit") or "") in facts[1]
        for sign, bound in meta["limits"].items():
            assert f"{sign} {bound:g}" in facts[1], (field.name, sign)


GRID = np.random.default_rng(1).normal(size=(24, 20)).astype(np.float32)
KNOWN, INSIDE, EXTENT = GRID < 0.3, np.ones_like(GRID, bool), np.array([24, 20], np.int32)
XYZ = np.random.default_rng(2).uniform(0, 15, (50, 3)).astype(np.float32)
CELL = np.floor(XYZ[:, 1]).astype(np.int32) * 20 + np.floor(XYZ[:, 0]).astype(np.int32)
BLOCKS = np.random.default_rng(3).random((6, 10, 3), np.float32)
FITTED = planes.Planes(BLOCKS.mean(axis=1), BLOCKS[:, 0, :2], np.ones(6, bool))
RULE = facets.Rule(max_angle=10.0, max_distance=1.0)


def opened(z):
    def look(k, before, after, most):
        return jnp.maximum(most, before - after)

    return sum(morphology.progressive_opening(z, INSIDE, jnp.array([1, 2]), look, jnp.zeros_like(z), reach=2))


def judged(points, max_angle):
    rule = RULE._replace(max_angle=max_angle)
    corners = jnp.moveaxis(BLOCKS[:, 1:4], 0, 2)
    return facets.judge(rule, jnp.zeros(6, bool), points.T, corners, names=("margin",))["margin"]


def lowest_windows(z):
    number = jnp.arange(z.size, dtype=jnp.int32).reshape(z.shape)
    return windows.window_minima(z, number, jnp.array([5, 4]), 5, 4)[0][:5, :4]


DERIVED = {
    ("morphology.erosion", "z"): (lambda z: morphology.erosion(z, 2, 3), GRID),
    ("morphology.dilation", "z"): (lambda z: morphology.dilation(z, 2, 3), GRID),
    ("morphology.opening", "z"): (lambda z: morphology.opening(z, 2, 3), GRID),
    ("morphology.progressive_opening", "z"): (opened, GRID),
    ("morphology.run_minima", "z"): (lambda z: morphology.run_minima(z, jnp.int32(3), 4, 0), GRID),
    ("cones.cone_erosion", "z"): (lambda z: cones.cone_erosion(z, 0.3, 3.0, 3), GRID),
    ("cones.cone_erosion", "slope"): (lambda s: cones.cone_erosion(GRID, s, 3.0, 3), np.float32(0.3)),
    ("inpaint.fill_membrane", "z"): (lambda z: inpaint.fill_membrane(z, KNOWN, INSIDE, 1e-6).z, GRID),
    ("inpaint.fill_nearest", "z"): (lambda z: inpaint.fill_nearest(z, KNOWN, INSIDE), GRID),
    ("spread.fill_from_neighbours", "z"): (lambda z: spread.fill_from_neighbours(z, KNOWN, INSIDE, 3)[0], GRID),
    ("surface.fill_along_lines", "z"): (lambda z: surface.fill_along_lines(z, KNOWN, INSIDE), GRID),
    ("sampling.bilinear", "grid"): (lambda z: sampling.bilinear(XYZ[:, :2], EXTENT, 20)(z), GRID),
    ("sampling.bilinear", "at"): (lambda at: sampling.bilinear(at, EXTENT, 20)(jnp.asarray(GRID)), XYZ[:, :2]),
    ("cells.block_minima", "z"): (lambda z: grid.block_minima(CELL, z, 480)[0][CELL], XYZ[:, 2]),
    ("windows.window_minima", "lowest"): (lowest_windows, GRID),
    ("planes.fit_planes", "xyz"): (lambda xyz: planes.fit_planes(xyz, jnp.ones((6, 10), bool)).gradient, BLOCKS),
    ("planes.plane_residuals", "xyz"): (lambda xyz: planes.plane_residuals(FITTED, xyz), BLOCKS),
    ("facets.judge", "points"): (lambda points: judged(points, 10.0), BLOCKS[:, 0]),
    ("facets.judge", "rule"): (lambda angle: judged(BLOCKS[:, 0], angle), np.float32(10.0)),
    ("facets.mirrored", "points"): (lambda p: facets.mirrored(p, BLOCKS[:, 1:4], jnp.bool_(True)), BLOCKS[:, 0]),
}


def derivatives(function, at):
    """Which modes give the finite difference along a random direction, and those that give zero."""
    rng = np.random.default_rng(5)
    along = np.float32(rng.normal(size=np.shape(at)))
    weights = np.float32(rng.normal(size=jax.eval_shape(function, at).shape))

    quick = functools.partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})  # to compile

    @quick
    def forward(x):
        return jax.jvp(function, (x,), (along,))

    @quick
    def reverse(x):
        return jnp.vdot(jax.grad(lambda x: (weights * function(x)).sum())(x), along)

    step = 1e-3 if np.ndim(at) == 0 else 1e-4  # of many values few may change places
    up, down = (np.asarray(forward(at + np.float32(sign * step) * along)[0], np.float64) for sign in (1, -1))
    difference = (weights * (up - down)).sum() / (2 * step)
    assert abs(difference) > 0.05
    values = {"forward": float((weights * forward(at)[1]).sum())}
    with contextlib.suppress(ValueError):
        values["reverse"] = float(reverse(at))
    if not any(values.values()):
        return ["zero"]
    assert list(values.values()) == pytest.approx([difference] * len(values), rel=0.03)
    return [mode for mode in ("reverse", "forward") if mode in values]


@pytest.mark.slow
def test_operations_differentiate_as_the_table_says():
    said = {}
    for name, column in re.findall(r"^\| `(\w+\.\w+)` \|.*\| (.*) \|$", (PAGES.parent / "arrays.md").read_text(), re.M):
        for field, modes in re.findall(r"`(\w+)`: ([^;]*)", column):
            said[name, field] = [mode for mode in ("reverse", "forward", "zero") if mode in modes.split(", ")]
    assert said == {key: derivatives(*DERIVED[key]) for key in DERIVED}
