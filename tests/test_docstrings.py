"""The examples in docstrings are right, and every public name has one."""

import ast
import dataclasses
import doctest
import inspect
import shutil
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfilter as jf

SLOW = {
    "AGPTD", "ATIN", "Batch", "Batch.confusion", "Batch.ground", "Batch.soft", "Calibration", "IPTD",
    "GridFilter", "GridFilter.prepare", "PPDF", "Rule.verdict", "STIN", "bilinear", "breaklines", "fill_membrane",
    "soft_labels",
}  # fmt: skip
"""Examples that compile much; what they show has tests of its own."""


def examples():
    """Docstrings with examples, of functions and classes and of their methods, by name."""
    for path in sorted(Path(jf.__file__).parent.rglob("*.py")):
        for outer in ast.parse(path.read_text()).body:
            for node in (outer, *getattr(outer, "body", ())):
                if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and ">>>" in (ast.get_docstring(node) or ""):
                    name = node.name if node is outer else f"{outer.name}.{node.name}"
                    slow = [pytest.mark.slow] * (name in SLOW)
                    yield pytest.param(ast.get_docstring(node), marks=slow, id=f"{path.stem}.{name}")


@pytest.fixture(scope="module")
def world(scene, tmp_path_factory):
    """What examples take for granted, as the docstring of the package says: names, and a folder with files."""
    assert (scene.seed, scene.size, scene.layout) == (3, (60.0, 60.0), jf.scenes.LAYOUTS["mixed"])
    folder = tmp_path_factory.mktemp("examples")
    (folder / "survey").mkdir()
    west = scene.xyz[:, 0] < scene.origin[0] + 30
    for name, part in (("scene", west | ~west), ("survey/west", west), ("survey/east", ~west)):
        echoes = {key: getattr(scene, key)[part] for key in ("return_number", "number_of_returns")}
        cloud = jf.PointCloud.from_arrays(scene.xyz[part], classification=scene.classes[part], **echoes)
        jf.write(folder / f"{name}.laz", cloud, None)
    known = {"jf": jf, "np": np, "jax": jax, "jnp": jnp, "dataclasses": dataclasses}
    result = jf.default_filter(scene.cloud)(scene.cloud)
    return known | {"scene": scene, "cloud": scene.cloud, "truth": scene.truth, "result": result}, folder


@pytest.mark.parametrize("text", [*examples()])
def test_an_example_is_right(text, world, tmp_path, monkeypatch):
    shutil.copytree(world[1], tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    example, said = doctest.DocTestParser().get_doctest(text, dict(world[0]), "example", None, 0), []
    assert not doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(example, out=said.append).failed, "".join(said)


def test_every_public_name_has_an_example():
    assert [name for name in jf.__all__ if ">>>" not in inspect.getdoc(getattr(jf, name))] == []
    assert dir(jf) == sorted(jf.__all__) and not hasattr(jf, "no_such_name")
