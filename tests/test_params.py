"""Parameters: validation from the declaration, the pytree, and the registry."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfilter as jf
from jaxfilter.core.errors import ParameterError
from jaxfilter.core.params import check_fields, filter_params, param, static
from jaxfilter.methods import FILTERS, SMRF
from jaxfilter.methods.papers import bibtex, citation

METHODS = pytest.mark.parametrize("method", list(FILTERS.values()), ids=list(FILTERS))


@filter_params
class Toy:
    """A parameter set of every kind; without ``classify`` it stays out of the registry."""

    angle: float = param("steepest angle", "a > 0 and <= 90 degrees", default=20.0)
    floor: float = param("noise floor", ">= 0 m", default=0.0)
    window: float | None = static("window", "> 0 m", default=18.0, optional=True)
    rounds: int = static("rounds", ">= 1 and < 1000", default=10)
    mode: str = static("mode", default="global", choices=("global", "blocks"))

    def __post_init__(self) -> None:
        check_fields(self)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"angle": 0}, r"Toy\(angle=0\): must be > 0 and <= 90 degrees"),
        ({"angle": 90.5}, "angle=90.5"),
        ({"angle": math.nan}, "angle=nan"),
        ({"angle": "20"}, "angle='20'.*number"),
        ({"angle": None}, "angle=None.*number"),
        ({"angle": True}, "angle=True.*number"),
        ({"angle": 1j}, "angle=1j.*number"),
        ({"angle": object()}, "angle=<object.*number"),
        ({"floor": -1e-9}, "must be >= 0 m"),
        ({"window": 0.0}, "window=0.0"),
        ({"window": math.inf}, "window=inf.*finite and > 0 m"),
        ({"rounds": 1000}, "must be >= 1 and < 1000"),
        ({"rounds": 2.5}, r"Toy\(rounds=2.5\): a whole number is needed"),
        ({"rounds": math.inf}, "rounds=inf.*whole number"),
        ({"mode": "tiles"}, "choose one of 'global', 'blocks'"),
    ],
)
def test_values_out_of_range_are_named(changes, message):
    with pytest.raises(ParameterError, match=message):
        Toy(**changes)


def test_a_domain_is_a_symbol_limits_and_a_unit():
    facts = [
        param("doc", domain, default=1.0).metadata for domain in ("a >= 0 and < 1e3 m/m", "> -1", "<= 9 %", "n", "")
    ]
    assert [(f["symbol"], f["unit"]) for f in facts] == [("a", "m/m"), ("", ""), ("", "%"), ("n", ""), ("", "")]
    assert [f["limits"] for f in facts] == [{">=": 0, "<": 1000}, {">": -1}, {"<=": 9}, {}, {}]
    for domain in ("> 0 or < 1 m", ">= 0 m per m", "a > x", "== 3"):
        with pytest.raises(ValueError):
            param("doc", domain, default=1.0)


def test_a_plain_value_of_an_inherited_field_is_its_default():
    @filter_params
    class Steep(Toy):
        angle: float = 40.0
        window: float | None = None

    assert (Steep().angle, Steep().window, Steep().rounds) == (40.0, None, 10)
    with pytest.raises(ParameterError, match=r"Steep\(angle=0\): must be > 0 and <= 90 degrees"):
        Steep(angle=0)


def test_limits_are_inclusive_where_declared_and_optional_fields_may_be_none():
    assert Toy(angle=90, floor=0, window=None, rounds=1).window is None
    assert Toy(angle=np.float32(45)).angle == 45
    Toy(floor=1e-9, angle=math.pi), Toy(floor=1e9, window=None), Toy(floor=math.inf)


@pytest.mark.parametrize("scalar", [np.float32, np.float64, np.array, jnp.float32, jnp.asarray])
def test_scalars_of_numpy_and_jax_are_numbers(scalar):
    assert type(SMRF(slope=scalar(0.25)).slope) is float and SMRF(slope=scalar(0.25)) == SMRF(slope=0.25)
    assert hash(jax.tree_util.tree_structure(SMRF(window=scalar(12.0)))) is not None
    for value in (-3, math.nan):
        with pytest.raises(ParameterError, match=rf"SMRF\(slope={value}.*\): must be > 0 rise/run"):
            SMRF(slope=scalar(value))
    with pytest.raises(ParameterError, match=r"SMRF\(window=-3"):
        SMRF(window=scalar(-3))


@pytest.mark.parametrize("value", [np.array([0.1, 0.2]), jnp.array([[0.1]]), [0.1, 0.2], np.zeros(0)])
def test_arrays_of_values_are_refused_by_name(value):
    for name in ("slope", "window"):
        with pytest.raises(ParameterError, match=rf"SMRF\({name}=.*\): a single value.*jaxfilter.sweep"):
            SMRF(**{name: value})
    with pytest.raises(ParameterError, match=r"CSF\(rigidness=.*single value"):
        FILTERS["csf"](rigidness=np.array([1, 2]))


@pytest.mark.parametrize("value", [3.0, np.float64(3)])
def test_whole_numbers_may_come_as_floats(value):
    made = FILTERS["fptd"](max_rounds=value)
    assert type(made.max_rounds) is int and made == FILTERS["fptd"](max_rounds=3)


def test_trees_are_rebuilt_with_any_leaf():
    leaves, structure = jax.tree_util.tree_flatten(SMRF())
    for leaf in (object(), None, -1.0, np.zeros(3), jax.ShapeDtypeStruct((), np.float32)):
        assert jax.tree_util.tree_unflatten(structure, [leaf] * len(leaves)).slope is leaf
    shapes = jax.eval_shape(lambda one: one.replace(slope=2 * one.slope), SMRF())
    assert shapes.slope.shape == ()
    assert jax.tree_util.keystr(jax.tree_util.tree_flatten_with_path(SMRF())[0][0][0]) == ".slope"


def test_a_stack_of_sets_is_no_filter():
    stacked = jax.tree_util.tree_map(lambda leaf: np.full(2, leaf), SMRF())
    with pytest.raises(ParameterError, match=r"SMRF\(slope=.*single value"):
        stacked(np.zeros((9, 3)))


def test_parameters_are_immutable():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Toy().angle = 3.0  # type: ignore[misc]


def test_registry_looks_up_by_name_in_any_case():
    assert FILTERS["FPTD"] is FILTERS["fptd"]
    assert "Fptd" in FILTERS and "toy" not in FILTERS and 3 not in FILTERS
    assert all(name == name.lower() for name in FILTERS)
    with pytest.raises(KeyError, match=r"no filter named 'nosuch'; known filters: .*fptd"):
        FILTERS["nosuch"]


@METHODS
def test_notes_of_presets_say_their_values(method):
    symbols = {f.metadata["symbol"]: f.name for f in dataclasses.fields(method)}
    for name, preset in method.PRESETS.items():
        for symbol, value in re.findall(r"(\w+) = ([\d.]*\d)", preset.note):
            if symbol in symbols:
                assert getattr(method.preset(name), symbols[symbol]) == float(value), (name, symbol)


def test_parameters_from_spacing_and_largest_building():
    tin = {"noise_floor": 0.0, "vertex_spacing": 0.0}
    ptd = tin | {"seed_cell": 80.0}
    expected = {
        "agptd": ptd | {"radius": 13.2},
        "atin": ptd,
        "csf": {"resolution": 1.4},
        "fptd": tin | {"window": 80.4, "stride": 13.4},
        "iptd": tin | {"window": 80.0, "cell": 1.5},
        "ost": {"window": 40.0, "spacing": 2.2, "cell": 1.0, "low_points": 21},
        "ppdf": {"window": 40.0, "reach": 40.0, "canopy_cell": 3.3, "cell": 15.4, "min_points": 10, "reference_cell": 2.2},
        "ptd": ptd,
        "ptdf": ptd,
        "spf": tin | {"window": 80.0, "cell": 1.5},
        "stin": {"noise_floor": 0.0, "seed_cell": 80.0, "final_cell": 2.0},
    }  # fmt: skip
    for name, fields in expected.items():
        assert FILTERS[name].from_spacing(2.2, 80.0) == pytest.approx(fields), name
    assert FILTERS["ptd"].from_spacing(0.4, None) == pytest.approx({"noise_floor": 0.1, "vertex_spacing": 0.7})
    dense = {"canopy_cell": 2.0, "cell": 10.0, "min_points": 20, "reference_cell": 1.0}
    assert FILTERS["ppdf"].from_spacing(0.4, None) == FILTERS["ppdf"].from_spacing(0.75, None) | dense == dense
    assert FILTERS["ppdf"].from_spacing(0.4, 40.0)["reach"] == 30.0


@METHODS
def test_parameters_from_the_cloud_are_valid(method):
    for spacing in (0.05, 0.5, 5.0):
        for building in (5.0, 60.0, 300.0, None):
            method(**method.from_spacing(spacing, building))


def test_the_window_of_fptd_is_the_least_multiple_of_six_strides_that_holds_the_building():
    """Strides are whole decimetres; sizes that are such a multiple themselves have the window of their own size."""
    for decimetres in range(10, 3000, 7):
        found = FILTERS["fptd"].from_spacing(1.0, decimetres / 10)
        window, stride = round(10 * found["window"], 6), round(10 * found["stride"], 6)
        assert window == 6 * stride == -(-decimetres // 6) * 6


def test_an_unknown_citation_names_the_known_ones():
    with pytest.raises(ParameterError, match=r"no citation for 'nosuch'; .*fptd"):
        citation("nosuch")
    with pytest.raises(ParameterError, match=r"no citation for Toy: .*BIBTEX"):
        citation(Toy)


def test_every_paper_is_written_once_and_cited():
    keys = re.findall(
        r"^@article\{(\w+),$", (Path(jf.__file__).parent / "methods" / "papers.bib").read_text(), re.MULTILINE
    )
    assert len(set(keys)) == len(keys) == 12
    for method in FILTERS.values():
        assert all(f"{{{doi}}}" in method.BIBTEX for doi in re.findall(r"doi:(10\.[^\s,]+[^\s,.])", method.__doc__))
    cited = [key for name in FILTERS for key in re.findall(r"^@article\{(\w+),$", citation(name), re.MULTILINE)]
    assert set(cited) == set(keys) and len(cited) == 18
    blocks = {block for name in FILTERS for block in citation(name).split("\n\n")}
    assert blocks == {bibtex(key) for key in keys}
    with pytest.raises(KeyError, match="nosuch"):
        bibtex("nosuch")
