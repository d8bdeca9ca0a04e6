"""Pages list parameters as they are declared; the skeleton of a filter is one; the code of a page prints what it says."""

import contextlib
import functools
import io
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxfilter import FILTERS
from jaxfilter.core.params import declared
from jaxfilter.ops import cloth, cones, facets, grid, inpaint, morphology, planes, sampling, spread, windows

PAGES = Path(__file__).resolve().parents[1] / "docs" / "filters"
sys.path.insert(0, str(PAGES.parents[1]))

from experiments.defaults import table  # noqa: E402


def row(field):
    """The table row of a parameter."""
    meta = field.metadata
    symbol, unit = (meta.get(key) or "" for key in ("symbol", "unit"))
    default = f"{field.default:g}" if isinstance(field.default, float) else f"{field.default}"
    return f"| `{field.name}` | {symbol} | {unit} | {default} | {meta['doc']} |"


@pytest.mark.parametrize("name", list(FILTERS))
def test_the_page_of_a_filter_lists_its_parameters_and_presets(name):
    text = (PAGES / f"{name}.md").read_text()
    listed = [line for line in text.splitlines() if line.startswith("| `")]
    fields = [row(field) for field in declared(FILTERS[name])]
    assert listed[: len(fields)] == fields, "\n".join(fields)
    notes = [f"| `{preset}` | {values.note} |" for preset, values in FILTERS[name].PRESETS.items()]
    assert listed[len(fields) :][: len(notes)] == notes, "\n".join(notes)


@pytest.mark.parametrize("name", list(FILTERS))
def test_every_preset_says_what_it_is_and_paper_what_is_not_as_printed(name):
    for preset, values in FILTERS[name].PRESETS.items():
        assert values.note and "\n" not in values.note, preset
    paper = FILTERS[name].PRESETS["paper"].note
    assert re.match(r"as (printed|reported)\b", paper), paper


def test_the_table_of_defaults_names_every_field_with_its_present_default():
    text = (PAGES.parent / "fidelity.md").read_text()
    assert text == table.page(text), "run experiments/defaults/table.py"
    lines = [line.split(" | ") for line in text.partition(table.START)[2].splitlines() if line.startswith("| `")]
    listed = [(name, cells[1], cells[2]) for cells in lines for name in re.findall(r"`(\w+)`", cells[0])]
    for name in FILTERS:
        for field in declared(FILTERS[name]):
            default = f"{field.default:g}" if isinstance(field.default, float) else f"{field.default}"
            assert listed.count((name, f"`{field.name}`", default)) == 1, (name, field.name, default)


def test_the_skeleton_of_a_filter_passes_the_suite_of_all_filters(tmp_path):
    text = (PAGES.parent / "adding_a_filter.md").read_text()
    skeleton = tmp_path / "skeleton.py"
    skeleton.write_text(re.search(r"```python\n(.*?)```", text, re.DOTALL)[1])
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-v", "-x", "-p", "no:cacheprovider", "tests/test_filters.py"]
        + ["--filter-file", str(skeleton), "-k", "tophat"],
        cwd=PAGES.parents[1],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert re.search(r"[3-9]\d passed", done.stdout), done.stdout[-300:]


def test_the_code_of_the_page_on_arrays_prints_what_the_page_says():
    text = (PAGES.parent / "arrays.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", text, re.DOTALL)
    names = {}
    for code, said in blocks:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(code, "arrays.md", "exec"), names)
        assert printed.getvalue() == said, code
    assert len(blocks) >= 5


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
    return facets.judge(rule, jnp.zeros(6, bool), points, BLOCKS[:, 1:4], names=("margin",))["margin"]


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
    ("cloth.fill_along_lines", "z"): (lambda z: cloth.fill_along_lines(z, KNOWN, INSIDE), GRID),
    ("sampling.bilinear", "grid"): (lambda z: sampling.bilinear(XYZ[:, :2], EXTENT, 20)(z), GRID),
    ("sampling.bilinear", "at"): (lambda at: sampling.bilinear(at, EXTENT, 20)(jnp.asarray(GRID)), XYZ[:, :2]),
    ("grid.block_minima", "z"): (lambda z: grid.block_minima(CELL, z, 480)[0][CELL], XYZ[:, 2]),
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


def test_operations_differentiate_as_the_table_says():
    said = {}
    for name, column in re.findall(r"^\| `(\w+\.\w+)` \|.*\| (.*) \|$", (PAGES.parent / "arrays.md").read_text(), re.M):
        for field, modes in re.findall(r"`(\w+)`: ([^;]*)", column):
            said[name, field] = [mode for mode in ("reverse", "forward", "zero") if mode in modes.split(", ")]
    assert said == {key: derivatives(*DERIVED[key]) for key in DERIVED}
