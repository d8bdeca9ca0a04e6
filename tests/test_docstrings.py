"""Every public name says what it is, in units, and shows it in an example that is run."""

import dataclasses
import doctest
import functools
import inspect
import re
import shutil
from importlib import import_module
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfilter as jf
from jaxfilter.core.params import declared
from jaxfilter.steps.grid_filter import GridFilter

ARRAYS = Path(__file__).resolve().parents[1] / "docs" / "arrays.md"
UNITS = r"metre|degrees|percent|per cent|rise over run|file (units|coordinates)|units? of|per m2|m2\b|bytes|seconds|cells|0 to 1"
METHODS = [method for name, method in inspect.getmembers(jf, inspect.isclass) if name.lower() in jf.FILTERS]


def operations():
    """The functions and types of the modules that docs/arrays.md imports and names."""
    text = ARRAYS.read_text()
    lines = re.findall(r"^from (jaxfilter[\w.]*) import (.+)$", text, re.MULTILINE)
    homes = {name: f"{place}.{name}" for place, names in lines for name in names.split(", ")}
    for module, name in sorted(set(re.findall(r"\b([a-z]+)\.([A-Za-z]\w*)", text))):
        if module in homes and callable(found := getattr(import_module(homes[module]), name, None)):
            yield f"{module}.{name}", found


def is_described(member):
    return inspect.isroutine(member) or isinstance(member, (property, functools.cached_property, classmethod))


def is_plain(member):
    """Whether it takes nothing but the object."""
    return isinstance(member, property) or list(inspect.signature(member).parameters) == ["self"]


def public():
    """Names with what they stand for: of the package, its modules, and the methods and properties of its classes.

    Of what a method adds to those of all filters: what takes no arguments. Its steps are for people who change it.
    """
    found = {name: getattr(jf, name) for name in jf.__all__} | {"GridFilter": GridFilter}
    for module in (jf.datasets, jf.plots, jf.scenes):
        short = module.__name__.partition(".")[2]
        names = {
            name: value
            for name, value in vars(module).items()
            if name[0] != "_" and callable(value) and value.__module__.startswith("jaxfilter." + short)
        }
        found |= {f"{short}.{name}": value for name, value in names.items()}
    found |= dict(operations())
    for name, value in list(found.items()):
        if inspect.isclass(value) and value not in METHODS:
            shown = {key for base in value.__mro__[1:] if base in found.values() for key in vars(base)}
            own = {key: member for key, member in vars(value).items() if is_described(member) and key not in shown}
            found |= {f"{name}.{key}": member for key, member in own.items() if key[0] != "_"}
    shared = {*dir(jf.Filter), *dir(GridFilter)}
    for method in METHODS:
        own = {key: member for key, member in vars(method).items() if is_described(member) and key not in shared}
        found |= {
            f"{method.__name__}.{key}": member for key, member in own.items() if key[0] != "_" and is_plain(member)
        }
    return found | {"Filter.__call__": jf.Filter.__call__}


PUBLIC = public()
SLOW = {
    *("AGPTD", "ATIN", "Batch", "Batch.confusion", "Batch.ground", "Batch.soft", "Calibration", "Filter.classify"),
    *("Fit", "GridFilter", "GridFilter.prepare", "IPTD", "PPDF", "STIN", "breaklines", "facets.Rule.verdict", "fit"),
    *("inpaint.fill_membrane", "plots.fit_curves", "sampling.bilinear", "soft_labels"),
}
"""Examples that compile much; what they show has tests of its own."""


@pytest.fixture(scope="module")
def names(scene):
    """What examples take for granted, as the docstring of the package says."""
    result = jf.default_filter(scene.cloud)(scene.cloud)
    known = {"jf": jf, "np": np, "jax": jax, "jnp": jnp}
    return known | {"scene": scene, "cloud": scene.cloud, "truth": scene.truth, "result": result}


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    """scene.laz with its true classes, and its two halves in survey/."""
    folder = tmp_path_factory.mktemp("examples")
    (folder / "survey").mkdir()
    classified = dataclasses.replace(scene.cloud, classification=scene.classes)
    jf.write(folder / "scene.laz", classified, None)
    west = scene.xyz[:, 0] < scene.origin[0] + 30
    for name, part in (("west", west), ("east", ~west)):
        half = jf.PointCloud.from_arrays(
            scene.xyz[part], return_number=scene.return_number[part], number_of_returns=scene.number_of_returns[part]
        )
        jf.write(folder / "survey" / f"{name}.laz", dataclasses.replace(half, classification=scene.classes[part]), None)
    return folder


def text_of(value):
    return inspect.getdoc(value) or ""


def test_the_scene_of_the_examples_is_that_of_the_docstring(scene):
    assert 'scene = jf.scenes.make("mixed", size=60, density=1, seed=3)' in jf.__doc__
    assert (scene.seed, scene.size, scene.layout) == (3, (60.0, 60.0), jf.scenes.LAYOUTS["mixed"])
    assert (jf.scenes.make("mixed", size=60, density=1, seed=3).xyz == scene.xyz).all()


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in PUBLIC])
def test_a_public_name_has_an_example_that_is_right(name, names, folder, tmp_path, monkeypatch):
    text = text_of(PUBLIC[name])
    here = tmp_path / "here"
    shutil.copytree(folder, here)
    monkeypatch.chdir(here)
    example = doctest.DocTestParser().get_doctest(text, dict(names), name, None, 0)
    assert example.examples, f"{name} has no example in its docstring"
    said = []
    outcome = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(example, out=said.append)
    assert outcome.failed == 0, "".join(said)


@pytest.mark.parametrize("name", PUBLIC)
def test_lengths_and_arrays_have_units(name):
    text = text_of(PUBLIC[name])
    summary = text.partition(">>>")[0].strip()
    assert summary, f"{name} has no docstring"
    try:
        annotations = [str(one.annotation) for one in inspect.signature(PUBLIC[name]).parameters.values()]
    except (TypeError, ValueError):  # properties have none
        annotations = []
    measured = any("float" in one for one in annotations) or re.search(r"\bf(32|64)?\[", summary)
    assert not measured or re.search(UNITS, summary), f"{name}: of what unit are its numbers?"


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.__name__)
def test_steps_of_a_method_say_what_they_are(method):
    steps = {
        key: getattr(method, key) for key, member in vars(method).items() if is_described(member) and key[0] != "_"
    }
    assert [key for key, member in steps.items() if not text_of(member)] == []


def test_methods_of_classes_operations_and_modules_are_among_the_public_names():
    assert {"read", "PointCloud.select", "Collection.crs", "plots.profile", "morphology.opening"} < set(PUBLIC)
    assert len(METHODS) == len(jf.FILTERS) and len(dict(operations())) >= 20


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.__name__)
def test_every_measured_parameter_has_a_unit_or_is_said_to_have_none(method):
    """Whole numbers are counts or codes, which their text names."""
    measured = [field for field in declared(method) if "float" in str(field.type)]
    assert measured
    for field in measured:
        meta = field.metadata
        assert meta.get("unit") or re.search(r"\bshare\b|no unit", meta["doc"]), f"{method.__name__}.{field.name}"
