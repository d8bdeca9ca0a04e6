"""What every filter owes: the same suite for all of them."""

import ast
import dataclasses
import importlib.util
import re
import sys
import warnings
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxfilter as jf
from jaxfilter import scenes
from jaxfilter.core import compilation
from jaxfilter.core.frame import QUANTUM
from jaxfilter.core.params import declared
from jaxfilter.core.points import canonical_points
from jaxfilter.steps.grid_filter import GridFilter
from jaxfilter.sweeps import sweep

FILTERS = sorted(jf.FILTERS)
OURS = {name for name in FILTERS if jf.FILTERS[name].__module__.startswith("jaxfilter.")}
"""The classes that nobody has asked for yet: those from files are here."""
SHIFT = (500000.37, 4800000.81, 300.0)


@pytest.fixture(scope="module", params=FILTERS)
def method(request):
    return jf.FILTERS[request.param]


@pytest.fixture(scope="module")
def small():
    """Coordinates in decimetre steps (ties and cocircular positions everywhere), with a house, bushes and a pit."""
    rng = np.random.default_rng(1)
    xy = rng.uniform(0, 80, (6000, 2)).round(1)
    z = 0.05 * xy[:, 0] + np.sin(xy[:, 1] / 15) + rng.normal(0, 0.03, 6000)
    truth = np.ones(6000, bool)
    house = (np.abs(xy[:, 0] - 40) < 9) & (np.abs(xy[:, 1] - 30) < 7)
    bush = (rng.random(6000) < 0.15) & ~house
    z[house] += 5
    z[bush] += rng.uniform(0.8, 3, bush.sum())
    truth[house | bush] = False
    return np.column_stack([xy, z]).round(2), truth


@pytest.fixture(scope="module")
def found(method, small):
    """What the method makes of those points."""
    return method()(small[0])


def labels(method, xyz, **options):
    return method()(jf.PointCloud.from_arrays(xyz, **options)).ground


def test_protocol(method, small):
    f = method()
    assert isinstance(f, jf.GroundFilter)
    assert 0 < f.halo() < 1000
    seen = []
    result = f(small[0], key=jax.random.key(0), workers=1, progress=lambda share, step: seen.append((share, step)))
    assert result.ground.dtype == bool and len(result) == len(small[0])
    for name in ("height", "slope", "angle", "elevation", "margin", "decision", "barred"):
        assert len(getattr(result, name)) == len(result)
    assert seen and all(0 <= share <= 1 and isinstance(step, str) for share, step in seen)
    assert result.status == jf.Status.CONVERGED and result.status.message
    assert np.isfinite(result.height).all()
    assert ((result.slope >= 0) & (result.slope <= 90)).all()


def test_it_finds_the_ground_of_ordinary_input_without_a_warning_and_does_not_modify_it(method, small, found):
    scores = jf.evaluate(found, small[1])
    assert scores.total < 6 and scores.kappa > 80
    xyz = small[0].copy()
    cloud = jf.PointCloud.from_arrays(xyz)
    before = cloud.xyz.copy()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        method()(cloud)
    assert (xyz == small[0]).all() and (cloud.xyz == before).all()


def test_presets_registry_and_what_is_said_of_fields(method):
    assert jf.FILTERS[method.__name__.upper()] is method
    assert {"paper", "recommended"} <= set(method.PRESETS)
    assert method.preset("recommended") == method()
    ours = method.__module__.startswith("jaxfilter.")
    assert not (ours and getattr(method.preset("paper"), "low_clusters", False)), "no paper has these"
    fields = dataclasses.fields(method)
    for name in method.PRESETS:
        assert isinstance(method.preset(name), method)
    first = next(field.name for field in fields if isinstance(field.default, float) and field.default > 0)
    half = getattr(method(), first) / 2
    assert getattr(method.preset("paper", **{first: half}), first) == half
    with pytest.raises(jf.ParameterError, match=r"no preset 'moon'.*recommended"):
        method.preset("moon")
    for field in fields:
        said, unit = field.metadata["doc"], field.metadata["unit"]
        assert said and ("float" not in str(field.type) or unit or re.search(r"\bshare\b|\bno unit", said) or not ours)
    assert "=" not in method.__doc__.splitlines()[0], "a dataclass without docstring gets its signature"
    assert jf.citation(method()) == jf.citation(method.__name__) and jf.citation(method).startswith("@")


def test_a_filter_is_a_pytree_of_its_thresholds(method):
    f = method()
    leaves, tree = jax.tree_util.tree_flatten(f)
    traced = [d.name for d in dataclasses.fields(method) if not d.metadata["static"]]
    assert leaves == [getattr(f, name) for name in traced] and len(traced) >= 2
    assert jax.tree_util.tree_unflatten(tree, leaves) == f
    doubled = jax.vmap(lambda p: jax.tree_util.tree_map(lambda leaf: leaf * 2, p))(
        jax.tree_util.tree_map(lambda leaf: np.full(3, leaf, np.float32), f)
    )
    np.testing.assert_allclose(getattr(doubled, traced[0]), 2 * np.full(3, getattr(f, traced[0])), rtol=1e-6)


def test_a_filter_with_arrays_for_numbers_is_called_as_one_with_numbers(method):
    cloud = np.array([[0, 0, 0], [10, 0, 0.1], [0, 10, 0.2], [9, 9, 0.3]])
    for number in (jax.numpy.float32, np.asarray):
        one = jax.tree.map(number, method())
        one.replace()  # checks its fields
        assert (one(cloud).ground == method()(cloud).ground).all()
        assert all(isinstance(leaf, int | float) for leaf in jax.tree.leaves(one(cloud).run.filter))


def test_calls_that_are_traced_say_what_can_be(method):
    match = "test\\(model" if hasattr(method, "model") else "SMRF, PMF and MSF"
    name = jax.tree_util.tree_flatten_with_path(method())[0][0][0][0].name
    for transform in (jax.jit, jax.grad, lambda f: lambda value: jax.vmap(f)(jax.numpy.full(2, value))):
        with pytest.raises(jf.ParameterError, match=f"{method.__name__}\\({name}=...\\).*{match}"):
            transform(lambda value: method(**{name: value})(np.zeros((5, 3))).height.sum())(1.0)
    with pytest.raises(jf.InputError, match=f"{method.__name__}.*the cloud is a traced array.*{match}"):
        jax.jit(method())(np.zeros((5, 3)))


def test_out_of_range_values_are_named(method):
    for field in dataclasses.fields(method):
        for low in (bound for sign, bound in field.metadata["limits"].items() if ">" in sign):
            with pytest.raises(jf.ParameterError, match=rf"{method.__name__}\({field.name}=-?[\d.]+\)"):
                method(**{field.name: low - 1})
        numeric = not field.metadata.get("choices") and field.type not in ("str", str)
        for value in (float("nan"), 1e300, -1e300, 1e-300, 5e-324, 10**400) if numeric else ():
            with pytest.raises(jf.ParameterError, match=rf"{method.__name__}\({field.name}="):
                method(**{field.name: value})
    with pytest.raises(jf.ParameterError, match="workers=0"):
        method()(np.zeros((5, 3)), workers=0)


def test_any_order_of_the_points_gives_the_same_labels(method, small, found, rng):
    order = rng.permutation(len(small[0]))
    shuffled = method()(small[0][order])
    for name in ("ground", "height", "margin", "decision", *["doubt"] * method.DOUBTS):
        np.testing.assert_array_equal(getattr(found, name)[order], getattr(shuffled, name))


def test_a_cloud_that_is_shifted_with_its_anchor_has_the_same_labels(method, small, found):
    for shift in (SHIFT, (-3.0e6, -1.2e7, -450.0), (1.0e7, 1.0e7, 8000.0)):
        assert (labels(method, small[0] + np.array(shift), anchor=shift[:2]) == found.ground).all()


def test_threads_give_the_same_labels(method, small, found):
    for workers in (1, 4):
        assert (method()(small[0], workers=workers).ground == found.ground).all()


@pytest.mark.parametrize("unit", ["ft", "us-ft", "us-ft,m"])
def test_feet_and_metres_agree(method, small, found, unit):
    xyz = small[0]
    xy, z = jf.core.units.parse_units(unit).xy, jf.core.units.parse_units(unit).z
    feet = np.column_stack([xyz[:, :2] / xy, xyz[:, 2] / z]).round(3)
    assert (labels(method, feet, units=unit) == found.ground).mean() >= 0.999


@pytest.fixture(scope="module")
def rough():
    """Coordinates of two scenes in decimetre steps, with clusters of echoes from below the ground."""
    found, rng = [], np.random.default_rng(0)
    for layout, size, density in (("mountain", (120, 110), 0.6), ("town", (150, 140), 0.4)):
        cloud = scenes.make(layout, size=size, density=density, seed=4).cloud
        xyz = cloud.coordinates()[cloud.candidate]
        low = xyz[rng.integers(0, len(xyz), 12)] - [0, 0, 6]
        clusters = [low + step * np.array([0.3, 0.2, 0.1]) for step in range(4)]
        found.append(np.unique(np.concatenate([xyz, *clusters]).round(1), axis=0))
    return found


def test_copies_of_points_change_no_label(method, rough, rng):
    """A filter sees distinct points, and sets its parameters by them."""
    xyz, every = rough[0], np.arange(len(rough[0]))
    cloud = jf.PointCloud.from_arrays(xyz)
    for at in (np.tile(every, 2), rng.permutation(every.repeat(rng.choice([1, 2, 7], len(xyz))))):
        copies = jf.PointCloud.from_arrays(xyz[at])
        for one, other in ((method(), method()), (method.for_cloud(cloud), method.for_cloud(copies))):
            assert one == other
            np.testing.assert_array_equal(other(copies).ground, one(cloud).ground[at])
        assert method().points_of(copies).spacing() == method().points_of(cloud).spacing()


def by_lattice(method):
    """A filter of which all cells count from the anchor: without low clusters, and not by a measured spacing."""
    own = {"low_clusters": False, "low_points": 0, "spacing": 1.0}
    return method(
        **{name: value for name, value in own.items() if name in {f.name for f in dataclasses.fields(method)}}
    )


@pytest.mark.parametrize("number", [0, 1])
def test_a_shift_by_the_lattice_of_the_filter_changes_no_label(method, rough, number):
    filter_, xyz = by_lattice(method), rough[number]
    expected, side = filter_(xyz).ground, filter_.lattice()
    for steps in ((1, 0), (0, 2), (-5, 7), (50_000, 480_000)):
        moved = filter_((xyz + side * np.array([*steps, 0])).round(1)).ground
        assert (moved != expected).sum() <= of_order(method, xyz), steps


def of_order(method, xyz):
    """Labels that may change with the order of the points: OST counts what hangs over a facet at its first corner."""
    return len(xyz) // 500 if method is jf.OST else 0


def test_only_candidates_become_ground_and_others_change_nothing(method, town):
    cloud = town.cloud
    result = method()(cloud)
    echoes = {name: getattr(cloud, name) for name in ("return_number", "number_of_returns")}
    elsewhere = cloud.coordinates() + np.where(cloud.candidate, 0.0, 0.3)[:, None]
    assert (labels(method, elsewhere, **echoes) == result.ground).all()
    assert not result.ground[~cloud.candidate].any()
    assert (result.decision[~cloud.candidate] == jf.Decision.SET_ASIDE).all()
    assert np.isnan(result.height[~cloud.candidate]).all()
    everything = method()(cloud.select(returns="all", ignore_classes=(), keep_withheld=True))
    assert (everything.decision != jf.Decision.SET_ASIDE).all()


def test_a_second_cloud_of_another_size_compiles_nothing(method, small):
    compilation.watch_compilations()
    method()(small[0])
    before = compilation.compilations()[0]
    method()(small[0][:5600] * [0.97, 0.98, 1.0])
    assert compilation.compilations()[0] == before


# Bad and odd input


def test_no_points(method):
    with pytest.warns(jf.JaxfilterWarning, match="no points"):
        result = method()(np.zeros((0, 3)))
    assert len(result) == 0 and result.status == jf.Status.NO_POINTS


def heap(spots, count=10_000):
    """So many points above each of a few positions f64[n, 2]."""
    xy = np.repeat(np.array(spots, float), count, axis=0)
    return np.column_stack([xy, np.arange(len(xy)) % count * 0.01])


@pytest.mark.parametrize(
    "xyz",
    [
        [[5, 5, 5]],
        [[0, 0, 0], [1, 1, 2]],
        [[0, 0, 0], [1, 1, 2], [2, 2, 1]],
        [[3, 3, 9], [3, 3, 1], [3, 3, 4]],
        [[k, 2 * k, k % 3] for k in range(30)],
        [[0, 0, 0], [10, 0, 0.1], [0, 10, 0.2]],
        [[0, 0, 0], [10, 0, 0.1], [0, 10, 9], [0, 10, 0.2]],
        heap([[7.0, 3.0]]),
        heap([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]]),
        heap([[0.0, 0.0], [9.0, 3.0], [18.0, 6.0], [27.0, 9.0]]),
        np.column_stack([k := np.arange(10_000) * 0.003, k / 3, k % 1]).round(3),
    ],
)
def test_too_few_points_or_points_on_a_line(method, xyz):
    """At each position the lowest is ground."""
    xyz = np.array(xyz, float)
    with pytest.warns(jf.JaxfilterWarning, match="fewer than four"):
        result = method()(xyz)
    assert result.status == jf.Status.TOO_FEW_POINTS
    position, spot = np.unique(xyz[:, :2], axis=0, return_inverse=True)
    lowest = np.full(len(position), np.inf)
    np.minimum.at(lowest, spot, xyz[:, 2])
    assert (result.ground == (xyz[:, 2] == lowest[spot])).all()


def test_ten_thousand_points_on_one_spot_of_a_cloud_are_filtered_like_one(method, small):
    many = np.concatenate([small[0], heap([[41.0, 61.0]]) + [0, 0, 0.3]])
    result = method()(many)
    assert result.status == jf.Status.CONVERGED
    assert (result.ground[:6000] == labels(method, np.concatenate([small[0], many[6000:6001]]))[:6000]).mean() > 0.98


def test_one_elevation_is_all_ground(method, rng):
    xyz = np.column_stack([rng.uniform(0, 50, (400, 2)), np.full(400, 7.25)])
    with pytest.warns(jf.JaxfilterWarning, match="one elevation"):
        result = method()(xyz)
    assert result.ground.all() and result.status == jf.Status.FLAT


def test_all_set_aside(method, small):
    cloud = jf.PointCloud.from_arrays(small[0], classification=np.full(len(small[0]), 7, np.uint8))
    with pytest.warns(jf.JaxfilterWarning, match="no point is a candidate"):
        result = method()(cloud)
    assert not result.ground.any() and result.status == jf.Status.NO_CANDIDATES


def test_invalid_coordinates(method, small):
    xyz = small[0].copy()
    xyz[[3, 40], 2] = np.nan
    xyz[77, 0] = np.inf
    with pytest.raises(jf.InputError, match="3 of 6000 points"):
        method()(xyz)
    with pytest.warns(jf.JaxfilterWarning, match="3 points"):
        cloud = jf.PointCloud.from_arrays(xyz, drop_invalid=True)
    result = method()(cloud)
    keep = np.ones(len(xyz), bool)
    keep[[3, 40, 77]] = False
    assert not result.ground[~keep].any()
    assert (result.ground[keep] == labels(method, small[0][keep])).all()


def test_the_lowest_of_points_at_one_position_is_taken(method, small, found):
    xyz, truth = small
    inner = (np.abs(xyz[:, :2] - 40) < 39).all(axis=1)
    above = xyz[truth & inner][:200] + [0, 0, 4.0]
    ground = labels(method, np.concatenate([xyz, above]))
    assert not ground[len(xyz) :].any()
    assert (ground[: len(xyz)] == found.ground).mean() > 0.99


def test_low_outliers_do_bounded_damage_and_high_ones_change_nothing(method, small, found):
    low = [[41.0, 61.0, -500.0], [20.0, 20.0, -80.0]]
    for others, damage in ((low, 0.01), ([[30.0, 30.0, 10000.0], [10.0, 60.0, 300.0]], 0.0)):
        ground = labels(method, np.concatenate([small[0], others]))
        assert not ground[-2:].any() and (ground[:-2] != found.ground).mean() <= damage


def test_a_stray_point_far_away_is_an_error_with_a_size(method, small):
    for far in (4.0e6, -1.0e6):
        with pytest.raises(jf.InputError, match=r"extend over \d.* x \d.* km.*: 1 of 6,001 lie.*stray points"):
            method()(np.concatenate([small[0], [[far, 0.0, 0.0]]]))


def test_parameters_follow_spacing_and_building_size(method, small):
    xyz = small[0]
    near, far = method.for_cloud(xyz, largest_building=20.0), method.for_cloud(xyz, largest_building=90.0)
    assert far.halo() > near.halo()
    assert isinstance(near(xyz), jf.FilterResult)
    unknown = method.for_cloud(xyz)
    for name in [
        "window",
        "max_window",
        "seed_cell",
        "resolution",
        "max_height",
    ]:  # what follows from a building's size
        assert getattr(unknown, name, None) == getattr(method(), name, None)
    assert len(method.for_cloud(xyz, largest_building=33.3)(xyz)) == len(xyz)
    with pytest.raises(jf.ParameterError, match="largest_building=-1"):
        method.for_cloud(xyz, largest_building=-1)
    with pytest.raises(jf.ParameterError, match="largest_building='33'"):
        method.for_cloud(xyz, largest_building="33")


def test_points_that_were_sorted_for_the_parameters_are_not_sorted_again(small, monkeypatch):
    cloud = jf.PointCloud.from_arrays(small[0])
    jf.FPTD.for_cloud(cloud)
    monkeypatch.setattr("jaxfilter.core.points._sorted", None)
    jf.FPTD()(cloud)
    with pytest.raises(TypeError):  # they are held until they are used
        jf.FPTD()(cloud)


@pytest.mark.parametrize("corner", [(0, 0), (500_991, 5_401_052), (2**20 - 20, 2**21 - 33), (-7, 2**22 - 5)])
def test_points_are_in_morton_order_from_the_anchor_wherever_they_lie(rng, corner):
    xyz = rng.integers(0, 40 / QUANTUM, (2000, 3)) * QUANTUM + [*corner, 0]
    east, north = ([int(v) for v in np.round(column / QUANTUM).astype(np.int64) % 2**32] for column in xyz[:, :2].T)
    code = [int(f"{y:b}", 4) * 2 + int(f"{x:b}", 4) for x, y in zip(east, north, strict=True)]
    expected = xyz[sorted(range(len(xyz)), key=lambda k: (code[k], xyz[k, 2]))]
    points = canonical_points(jf.PointCloud.from_arrays(xyz))
    np.testing.assert_array_equal(points.xyz + points.cloud.origin, expected)


# Sweeps, batches, calibration, and edits


@dataclasses.dataclass
class Alone:
    """Sets of a filter that each differ from the first in one traced field, and the last in all; with their single calls."""

    cloud: jf.PointCloud
    sets: list
    ground: np.ndarray

    @property
    def axes(self):
        names = [field.name for field in declared(self.sets[0]) if not field.metadata["static"]]
        return {name: [getattr(one, name) for one in self.sets] for name in names}


@pytest.fixture(
    scope="module",
    params=[pytest.param(n, marks=[pytest.mark.slow] * (n in OURS - {"smrf", "fptd"})) for n in FILTERS],
)
def alone(request, small):
    first = jf.FILTERS[request.param]()
    others = {field.name: moved(first, field.name) for field in declared(first) if not field.metadata["static"]}
    sets = [first, *(first.replace(**{name: value}) for name, value in others.items()), first.replace(**others)]
    cloud = jf.PointCloud.from_arrays(noisy(small[0]), reference=small[1])
    found = Alone(cloud, sets, np.array([one(cloud).ground for one in sets]))
    assert len(np.unique(found.ground, axis=0)) > 2, "sets with the same labels show nothing"
    return found


def noisy(xyz):
    """So that points lie near every limit."""
    return xyz + np.random.default_rng(2).normal(0, [0, 0, 0.3], xyz.shape).round(2)


def moved(filter_, name):
    """Another value that a field may have."""
    value = getattr(filter_, name)
    for other in (0.6 * value, 0.3, 1.0):
        try:
            if np.isfinite(other) and other != value:
                return getattr(filter_.replace(**{name: other}), name)
        except jf.ParameterError:
            continue
    raise AssertionError(name)


def test_sets_of_a_sweep_have_the_labels_of_single_calls(alone):
    data = jf.sweep(alone.sets[0], alone.cloud, alone.axes, design="list", votes=True)
    np.testing.assert_array_equal(data["ground"], alone.ground.sum(axis=1))
    np.testing.assert_array_equal(data["votes"], np.float32(alone.ground.sum(axis=0) / len(alone.sets)))
    wrong = (alone.ground != alone.cloud.reference).mean(axis=1)
    np.testing.assert_allclose(data["total"], 100 * wrong, rtol=1e-12)
    for one, ground in zip(
        alone.sets[1:-1], alone.ground[1:-1], strict=True
    ):  # what the others share may be wrong in none
        (name,) = [name for name in alone.axes if getattr(one, name) != getattr(alone.sets[0], name)]
        pair = jf.sweep(alone.sets[0], alone.cloud, {name: [getattr(alone.sets[0], name), getattr(one, name)]})
        assert pair["ground"].values.tolist() == [alone.ground[0].sum(), ground.sum()]


def test_sets_of_a_batch_have_the_labels_of_single_calls(alone):
    if not isinstance(alone.sets[0], GridFilter):
        with pytest.raises(jf.ParameterError, match=r"use jf\.sweep"):
            jf.batch([alone.cloud], alone.sets[0])
        return
    made = jf.batch([alone.cloud], alone.sets[0])
    np.testing.assert_array_equal(made.unstack(made.ground(alone.axes))[0], alone.ground)


def test_a_calibration_chooses_what_single_calls_choose(alone, monkeypatch):
    cloud, labels = alone.cloud, np.where(np.arange(len(alone.cloud)) % 7 == 0, alone.cloud.reference, -1)
    axes = {name: (min(values), max(values)) for name, values in alone.axes.items()}
    found = jf.calibrate(alone.sets[0], cloud, labels, axes=axes, size=4, rounds=1, folds=2)

    def single(self, filters, numbers):
        for number in numbers:
            yield number, self.points.gather(filters[number](cloud).ground)

    monkeypatch.setattr(sweep.Subject, "ground_each", single)
    expected = jf.calibrate(alone.sets[0], cloud, labels, axes=axes, size=4, rounds=1, folds=2)
    assert found.filter == expected.filter and found.score == expected.score
    assert found.trials.identical(expected.trials)


def labels_by_text(path, text, name, xyz):
    """bool[k, n]: labels of the filter in a file of this text: of a call, of a sweep, and of a batch."""
    path.write_text(text)
    spec = importlib.util.spec_from_file_location("mine", path)
    sys.modules["mine"] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    filter_, cloud = jf.FILTERS[name](), jf.PointCloud.from_arrays(xyz)
    field = next(field.name for field in declared(filter_) if not field.metadata["static"])
    other = moved(filter_, field)
    sets = {field: [getattr(filter_, field), other]}
    found = [filter_(cloud).ground, filter_.replace(**{field: other})(cloud).ground]
    found += [jf.sweep(filter_, cloud, sets, votes=True)["votes"].values == 1.0]
    if isinstance(filter_, GridFilter):
        made = jf.batch([cloud], filter_)
        found += [*made.unstack(made.ground(sets))[0]]
    return np.array(found)


def edited(source):
    """A file with every number that has a fraction a fifth smaller: limits in methods, in functions and of traced fields."""

    class Smaller(ast.NodeTransformer):
        def visit_Call(self, node):
            static = isinstance(node.func, ast.Name) and node.func.id == "static"
            return node if static else self.generic_visit(node)

        def visit_Constant(self, node):
            return ast.copy_location(ast.Constant(0.8 * node.value), node) if isinstance(node.value, float) else node

    return ast.unparse(Smaller().visit(ast.parse(source)))


@pytest.mark.parametrize("name", [name for name in FILTERS if name not in OURS])
def test_an_edited_file_is_what_runs_from_then_on(name, small, request, tmp_path, monkeypatch):
    """As one of another name does, of which nothing was compiled before."""
    monkeypatch.setattr(jf.FILTERS, "data", dict(jf.FILTERS.data))
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    texts = {path: Path(path).read_text() for path in request.config.getoption("--filter-file")}
    code = {part.__code__.co_filename for part in vars(jf.FILTERS[name]).values() if hasattr(part, "__code__")}
    (text,), xyz = (texts[path] for path in texts if path in code), noisy(small[0][:2000])
    before, after = (labels_by_text(tmp_path / "mine.py", one, name, xyz) for one in (text, edited(text)))
    other = re.sub(rf"\b{jf.FILTERS[name].__name__}\b", "Other", edited(text))
    fresh = labels_by_text(tmp_path / "other.py", other, "other", xyz)
    assert (before[0] != fresh[0]).any(), "the edit changes no label"
    np.testing.assert_array_equal(after, fresh)
