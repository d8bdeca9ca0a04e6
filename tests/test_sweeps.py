"""Sweeps give the labels of single runs, whatever they share, and their scores; bad axes are named before anything runs."""

import dataclasses
import itertools
import json
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas
import pytest

import jaxfilter as jf
from jaxfilter import scenes
from jaxfilter.core import compilation
from jaxfilter.core.compilation import on_processor
from jaxfilter.core.filter import ground_each, watch
from jaxfilter.core.params import FILTERS, filter_params
from jaxfilter.core.points import canonical_points, plain_points
from jaxfilter.engines.tin import ground as ground_tin
from jaxfilter.engines.tin.facets import Rule, Verdict
from jaxfilter.engines.tin.ground import GroundTin
from jaxfilter.engines.tin.growth import Adaptive, Beyond, Growth, Vertices
from jaxfilter.engines.tin.network import one_network
from jaxfilter.methods import ost


@pytest.fixture(scope="module")
def cloud():
    return unclassified(scenes.make("mixed", size=90.0, density=1.5, seed=3))


@pytest.fixture(scope="module")
def hills():
    return unclassified(scenes.make("mountain", size=80.0, density=1.5, seed=5))


def unclassified(scene):
    return dataclasses.replace(scene.cloud, classification=None)


def labels_of(filter_, sets, cloud):
    """bool[sets, n] from one call for all sets."""
    points = plain_points(cloud) if filter_.ORDER_FREE else canonical_points(cloud)
    out = np.zeros((len(sets), len(cloud)), bool)
    numbers = []
    for number, ground in ground_each(filter_, points, sets, key=None, workers=None, memory=2e9):
        out[number, points.index] = ground[points.member]
        numbers.append(number)
    assert sorted(numbers) == list(range(len(sets))), "every set once: votes are counted"
    return out


def check_equal(sets, cloud):
    """Every set has the labels of running it alone; these."""
    found = labels_of(sets[0], sets, cloud)
    for one, ground in zip(sets, found, strict=True):
        assert np.array_equal(one(cloud).ground, ground), one
    return found


def product(filter_, **axes):
    return [filter_.replace(**dict(zip(axes, values, strict=True))) for values in itertools.product(*axes.values())]


def case(filter_, slow=False, **axes):
    return pytest.param(
        product(filter_, **axes), marks=[pytest.mark.slow] * slow, id=f"{type(filter_).__name__} {[*axes]}"
    )


PMF_AXES = {"slope": (0.1, 0.3, 0.7), "initial_distance": (0.2, 0.6), "max_distance": (1.0, 3.0)}
TIN_AXES = {"max_angle": (4.0, 15.0, 30.0), "max_distance": (0.4, 1.4)}
FPTD_AXES = {"max_angle": (4.0, 15.0, 30.0), "max_elevation": (0.4, 1.4)}
SLOPES = np.random.default_rng(2).uniform(0.04, 0.5, 21).tolist()


@pytest.mark.parametrize("sets", [
    case(jf.SMRF(), slope=(0.05, 0.15, 0.4), threshold=(0.2, 0.7), scaling=(0.0, 1.25)),
    case(jf.SMRF(cut=20.0, window=12.0), slow=True, slope=SLOPES),
    case(jf.PMF(max_window=30.0), **PMF_AXES),
    case(jf.PMF(max_window=30.0, compare="points"), slow=True, **PMF_AXES),
    case(jf.PMF(max_window=30.0, compare="points", reading="points"), **PMF_AXES),
    case(jf.FPTD(window=30.0), **FPTD_AXES),
    case(jf.FPTD(window=30.0, blocks="independent"), **FPTD_AXES),
    case(jf.FPTD(window=30.0, vertex_spacing=1.5, noise_floor=0.1), **FPTD_AXES),
    *(case(jf.FPTD(window=30.0, max_rounds=limit), **FPTD_AXES) for limit in (1, 2, 3)),
    case(jf.PTD(seed_cell=30.0), **TIN_AXES),
    case(jf.ATIN(seed_cell=30.0, mirror="nearest", border="corners"), **TIN_AXES),
    case(jf.AGPTD(seed_cell=30.0), **TIN_AXES),
    case(jf.PTDF(seed_cell=30.0), **TIN_AXES),
    case(jf.SPF(window=30.0), **TIN_AXES),
    case(jf.SPF(window=30.0), slow=True, seed_filter=(True, False), max_angle=(6.0, 20.0)),
    case(jf.SPF(window=30.0), slope=(0.5, 0.3)),
    case(
        jf.SPF(window=30.0, histogram_margin=0.5, isolated_depth=0.3, outlier_fate="removed"),
        max_distance=(0.7, 1.4),
    ),
    case(jf.AGPTD(radius=2.5, min_neighbours=5, outlier_fate="removed"), max_distance=(0.7, 1.4)),
    case(jf.STIN(seed_cell=30.0), max_angle=(30.0, 18.0)),
    case(jf.IPTD(window=30.0, max_distance=0.05), noise_floor=(0.0, 0.3), max_angle=(30.0, 1.0)),
    case(jf.CSF(), threshold=(0.5, 0.3)),
    case(jf.OST(window=15.0), slope=(0.05, 0.3), roof_drop=(0.6, 1.8)),
    case(jf.PPDF(), slow=True, buffer=(0.3, 0.2)),
])  # fmt: skip
def test_sets_have_the_labels_of_single_runs(sets, hills):
    found = check_equal(sets, hills)
    assert len({ground.tobytes() for ground in found}) > (3 if len(sets) >= 6 else 1)


@pytest.mark.slow
def test_points_on_a_limit_have_the_label_of_the_single_run(cloud):
    """Programs that round differently would disagree on them."""
    points, sets = plain_points(cloud), []
    for row, slope in enumerate(np.linspace(0.05, 0.4, 16)):
        one = jf.SMRF(window=12.0, slope=slope)
        height, steep, *_ = one.test(one.model(one.cells(points)), points.xyz)
        height, steep = np.asarray(height, np.float64), np.asarray(steep, np.float64)
        at = np.flatnonzero(height > 1.25 * steep)[row]
        sets.append(one.replace(threshold=float(height[at] - 1.25 * steep[at])))
    check_equal(sets, cloud)


def test_a_filter_with_arrays_for_numbers_is_swept_and_calibrated_as_one_with_numbers(cloud):
    plain = jf.SMRF(window=12.0, threshold=0.5, scaling=1.0, slope=0.25)
    arrays = jax.tree.map(jax.numpy.float32, plain)
    given = jf.sweep(arrays, cloud, {"slope": [0.1, 0.2]})
    assert given.identical(jf.sweep(plain, cloud, {"slope": [0.1, 0.2]}))
    labels = np.where(np.arange(len(cloud)) % 20 == 0, cloud.reference, -1)
    found, expected = (jf.calibrate(one, cloud, labels, size=2, rounds=1) for one in (arrays, plain))
    assert (found.filter, found.before, found.score) == (expected.filter, expected.before, expected.score)


def test_a_cell_whose_drop_is_the_slope_of_a_set_has_the_label_of_the_single_run(cloud):
    """At this slope the cell is kept, at the next smaller one it is not."""
    smrf = jf.SMRF(window=12.0)
    opened = smrf.prepare(smrf.cells(plain_points(cloud)))
    drops = np.asarray(opened.steepest)[np.asarray(opened.bare)]
    tie = drops[(drops > 0.1) & (drops < 0.3)][0]
    check_equal(
        [smrf.replace(slope=float(slope)) for slope in (0.1, np.nextafter(tie, np.float32(0)), tie, 0.3)], cloud
    )


@pytest.mark.parametrize(
    "filter_", [jf.SPF(window=30.0), jf.FPTD(window=30.0), jf.ATIN(seed_cell=30.0)], ids=lambda f: type(f).__name__
)
def test_points_at_the_position_of_a_vertex_have_one_label_whatever_the_history(filter_, hills):
    xyz = hills.coordinates()
    xyz[:, :2] = np.rint(xyz[:, :2] / 1.25) * 1.25  # nearly two points at each position
    crowded = jf.PointCloud.from_arrays(xyz, reference=hills.reference)
    assert len(np.unique(crowded.xyz[:, :2], axis=0)) < 0.7 * len(crowded)
    sets = product(filter_, max_angle=(4.0, 9.0, 15.0, 22.0, 30.0))
    for one, ground in zip(sets, check_equal(sets, crowded), strict=True):
        assert np.array_equal(one(crowded, workers=5).ground, ground)


@pytest.mark.parametrize(("workers", "memory", "at_once"), [(1, 2e9, 1), (3, 2e9, 3), (3, 1.0, 1)])
def test_sets_share_the_start_and_grow_at_a_time_as_memory_allows(workers, memory, at_once, hills, monkeypatch):
    sets = product(jf.FPTD(window=30.0), max_angle=(4.0, 15.0, 30.0), max_elevation=(0.4, 1.4))
    alone = [one(hills).ground for one in sets]
    starts, growths, start, begin = [], [], jf.FPTD.start, GroundTin.start

    def started(self, *arguments):
        starts.append(self)
        return start(self, *arguments)

    def grown(network, growth, tin=None, workers=None):
        if tin is not None:
            growths.append(workers)
        return begin(network, growth, tin, workers)

    monkeypatch.setattr(jf.FPTD, "start", started)
    monkeypatch.setattr(GroundTin, "start", grown)
    points = canonical_points(hills)
    found = dict(ground_each(sets[0], points, sets, key=None, workers=workers, memory=memory))
    assert len(starts) == 1 and growths == [workers // at_once] * len(sets)
    for number, ground in enumerate(alone):
        assert np.array_equal(found[number][points.member], ground[points.index])


@pytest.mark.parametrize("workers", [1, 3])
def test_sets_without_shared_work_run_in_threads_and_stop_with_their_reader(workers, hills, monkeypatch):
    sets = [jf.CSF(max_step=step) for step in (0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5)]
    begun, classify = [], jf.CSF.classify

    def counted(self, points, **options):
        if self.max_step == 0.45:
            raise RuntimeError("a set that fails")
        begun.append((self.max_step, options["workers"]))
        return classify(self, points, **options)

    monkeypatch.setattr(jf.CSF, "classify", counted)
    points = canonical_points(hills)
    reader = ground_each(sets[0], points, sets, key=None, workers=workers, memory=2e9)
    assert [next(reader)[0] for _ in range(3)] == [0, 1, 2]
    reader.close()
    assert 3 <= len(begun) <= 3 + workers, "no more are begun until the reader takes another"
    assert {w for _, w in begun} == {1}
    with pytest.raises(RuntimeError, match="fails"):
        list(ground_each(sets[0], points, sets, key=None, workers=workers, memory=2e9))
    begun.clear()
    list(ground_each(sets[0], points, sets[:2], key=None, workers=workers, memory=1.0))
    assert {w for _, w in begun} == {workers}, "one at a time, with all threads, where memory is short"


@pytest.mark.parametrize(
    ("filter_", "others"),
    [(jf.CSF(), {"max_step": (0.3, 0.5)}), pytest.param(jf.PPDF(), {"buffer": (0.3, 0.5)}, marks=pytest.mark.slow)],
    ids=["CSF", "PPDF"],
)
def test_sets_that_differ_in_the_last_threshold_are_classified_once(filter_, others, hills, monkeypatch):
    (last,) = filter_.LAST
    sets = product(filter_, **{last: (0.1, 0.25, 0.6, 1.2)}, **others)
    alone = [one(hills).ground for one in sets]
    runs, classify = [], type(filter_).classify

    def counted(self, points, **options):
        runs.append(self)
        return classify(self, points, **options)

    monkeypatch.setattr(type(filter_), "classify", counted)
    assert np.array_equal(labels_of(filter_, sets, hills), alone)
    assert len(runs) == 2 and len({ground.tobytes() for ground in alone}) >= 4


def test_a_sweep_of_ost_finds_out_once_what_no_swept_field_changes(hills, monkeypatch):
    low, openings = [], []
    for found, name in ((low, "lowest_few"), (openings, "steepest_drops")):
        step = getattr(ost, name)
        monkeypatch.setattr(
            ost, name, lambda *given, step=step, found=found, **more: found.append(1) or step(*given, **more)
        )
    axes = {"slope": [0.05, 0.1], "roof_step": [0.3, 0.5], "landscape": [20.0, 30.0], "tolerance": [0.05, 0.1]}
    jf.sweep(jf.OST(window=15.0), hills, axes, workers=1)
    assert len(low) == len(openings) == 1
    jf.sweep(jf.OST(window=15.0), hills, {"rules": [(), "voids"], "slope": [0.05, 0.1]}, workers=1)
    assert len(low) == len(openings) == 3


def test_kernels_of_the_triangulation_run_on_the_processor_unless_a_device_was_chosen(hills, monkeypatch):
    devices, tested = [], ground_tin.judge

    def judge(*arrays, **named):
        devices.append(jax.config.values["jax_default_device"])
        return tested(*arrays, **named)

    monkeypatch.setattr(ground_tin, "judge", judge)
    plain = jf.PTD()(hills).ground
    assert devices and set(devices) == {None}, "kept code is of use here"
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    devices.clear()
    assert (jf.PTD()(hills).ground == plain).all() and {device.platform for device in devices} == {"cpu"}
    chosen = jax.devices()[0]
    with jax.default_device(chosen), on_processor():
        assert jax.config.values["jax_default_device"] is chosen


def test_scores_are_those_of_evaluate_and_dimensions_those_of_the_axes(cloud):
    slopes, thresholds = [0.05, 0.15, 0.3], [0.25, 0.75]
    axes = {"slope": pandas.Series(slopes), "threshold": jnp.array(thresholds)}  # as good as lists
    data = jf.sweep(jf.SMRF(), cloud, axes, votes=True)
    assert data.total.dims == ("slope", "threshold") and data.slope.values.tolist() == slopes
    votes = np.zeros(len(cloud))
    for s, t in itertools.product(slopes, thresholds):
        result = jf.SMRF(slope=s, threshold=t)(cloud)
        scores, here = jf.evaluate(result, cloud), data.sel(slope=s, threshold=t)
        votes += result.ground
        for name in ("type1", "type2", "total", "kappa"):
            assert float(here[name]) == pytest.approx(getattr(scores, name))
        assert int(here.ground) == result.ground.sum()
    np.testing.assert_allclose(data.votes, votes / 6, atol=1e-6)
    assert data.slope.attrs["units"] == "rise/run" and data.attrs["groups"] == 1
    assert json.loads(data.attrs["clouds"]) == {"cloud": cloud.digest()} and data.attrs["jaxfilter"] == jf.__version__


def test_several_clouds_and_clouds_without_reference(cloud, hills):
    bare = jf.PointCloud.from_arrays(hills.coordinates())
    data = jf.sweep(jf.SMRF(), {"town": cloud, "hills": hills, "bare": bare}, {"slope": [0.1, 0.3]}, votes=True)
    assert data.total.dims == ("slope", "cloud") and data.cloud.values.tolist() == ["town", "hills", "bare"]
    alone = jf.sweep(jf.SMRF(), hills, {"slope": [0.1, 0.3]})
    np.testing.assert_array_equal(data.total.sel(cloud="hills"), alone.total)
    assert np.isnan(data.total.sel(cloud="bare")).all() and (data.ground.sel(cloud="bare") > 0).all()
    assert data.votes_bare.dims == ("point_bare",) and len(data.votes_town) == len(cloud)


def test_designs(cloud):
    ranges = {"slope": (0.05, 0.4), "threshold": (0.2, 1.0), "window": [10.0, 18.0]}
    for design in ("random", "sobol"):
        data = jf.sweep(jf.SMRF(), cloud, ranges, design=design, size=12, seed=4)
        again = jf.sweep(jf.SMRF(), cloud, ranges, design=design, size=12, seed=4)
        assert data.identical(again) and data.total.dims == ("set",) and len(data["set"]) == 12
        assert ((data.slope >= 0.05) & (data.slope <= 0.4)).all() and len(np.unique(data.slope)) == 12
        assert set(data.window.values) == {10.0, 18.0} and data.attrs["groups"] == 2
        one = data.isel(set=7)
        filter_ = jf.SMRF(slope=float(one.slope), threshold=float(one.threshold), window=float(one.window))
        assert float(one.total) == pytest.approx(jf.evaluate(filter_(cloud), cloud).total)
    listed = jf.sweep(jf.SMRF(), cloud, {"slope": [0.1, 0.3], "threshold": [0.5, 0.2]}, design="list")
    assert float(listed.total[1]) == pytest.approx(jf.evaluate(jf.SMRF(slope=0.3, threshold=0.2)(cloud), cloud).total)


@pytest.mark.parametrize(("axes", "options", "named"), [
    ({"slop": [0.1]}, {}, "no field 'slop'"),
    ({}, {}, "at least one field"),
    ({"slope": []}, {}, "slope is empty"),
    ({"slope": [0.1, np.nan]}, {}, "slope=.*NaN"),
    ({"slope": [0.1, -0.2]}, {}, r"SMRF\(slope=-0.2\): must be > 0"),
    ({"slope": [0.1, 0.1]}, {}, "repeats"),
    ({"slope": 0.1}, {}, "list of values"),
    ({"slope": "0.1"}, {}, "list of values"),
    ({"slope": [[0.1]]}, {}, "one dimension"),
    ({"slope": [0.1], "window": [5000.0]}, {}, r"SMRF\(window=5000.0\)"),
    ({"slope": [0.1, 0.2]}, {"design": "latin"}, "design='latin'"),
    ({"slope": [0.1, 0.2]}, {"design": "sobol"}, "size=None"),
    ({"slope": [0.1, 0.2]}, {"size": 8}, "size=8"),
    ({"slope": (0.2, 0.1)}, {"design": "random", "size": 8}, "from low to high"),
    ({"slope": (0.2, 0.2)}, {"design": "random", "size": 8}, "from low to high"),
    ({"slope": [0.1, 0.2], "threshold": [0.5]}, {"design": "list"}, "as many values"),
])  # fmt: skip
def test_bad_axes_are_named_before_anything_runs(axes, options, named, cloud, monkeypatch):
    monkeypatch.setattr("jaxfilter.sweeps.sweep.ground_each", None)
    with pytest.raises(jf.ParameterError, match=named):
        jf.sweep(jf.SMRF(), cloud, axes, **options)


@pytest.mark.parametrize("filter_", ["smrf", jf.SMRF, None])
def test_only_instances_of_filters_are_swept_and_calibrated(filter_, cloud):
    for call in (
        lambda: jf.sweep(filter_, cloud, {"slope": [0.1]}),
        lambda: jf.calibrate(filter_, cloud, np.ones(len(cloud))),
    ):
        with pytest.raises(jf.ParameterError, match=r"filter_=.*an instance of a filter is needed"):
            call()


def test_an_interrupted_sweep_resumes(cloud, hills, tmp_path, monkeypatch):
    path, axes = tmp_path / "sweep.npz", {"cell": [1.0, 2.0], "threshold": [0.3, 0.5, 0.9]}
    whole = jf.sweep(jf.SMRF(), [cloud, hills], axes, votes=True)
    computed = []

    def counting(filter_, points, sets, **options):
        for number, ground in ground_each(filter_, points, sets, **options):
            computed.append(number)
            yield number, ground

    monkeypatch.setattr("jaxfilter.sweeps.sweep.ground_each", counting)

    def interrupt(fraction, step):
        if fraction > 0.6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        jf.sweep(jf.SMRF(), [cloud, hills], axes, votes=True, checkpoint=path, progress=interrupt)
    before = len(computed)
    assert 6 < before < 12 and [p.name for p in tmp_path.iterdir()] == ["sweep.npz"]
    resumed = jf.sweep(jf.SMRF(), [cloud, hills], axes, votes=True, checkpoint=path)
    assert len(computed) == 12 and resumed.identical(whole)
    with pytest.raises(jf.InputError, match="other filter"):
        jf.sweep(jf.SMRF(window=9.0), [cloud, hills], axes, votes=True, checkpoint=path)
    with pytest.raises(jf.InputError, match="other clouds"):
        jf.sweep(jf.SMRF(), [hills, cloud], axes, votes=True, checkpoint=path)
    edge = dataclasses.replace(cloud, anchor=cloud.origin[:2] - 0.5)
    half = np.where(cloud.reference, 2, np.arange(len(cloud)) % 2).astype(np.uint8)  # class 0: never classified
    for other in (edge, dataclasses.replace(cloud, classification=half)):
        with pytest.raises(jf.InputError, match="other clouds"):
            jf.sweep(jf.SMRF(), [other, hills], axes, votes=True, checkpoint=path)
    for damaged in (b"nothing", path.read_bytes()[:-400], b""):
        path.write_bytes(damaged)
        with pytest.raises(jf.InputError, match="not one of a sweep"):
            jf.sweep(jf.SMRF(), [cloud, hills], axes, votes=True, checkpoint=path)


def test_a_sweep_of_more_sets_on_another_cloud_of_the_bucket_compiles_nothing(cloud):
    def run(cloud, count):
        rng = np.random.default_rng(count)
        axes = {"slope": rng.uniform(0.05, 0.4, count).tolist(), "threshold": rng.uniform(0.2, 1.0, count).tolist()}
        jf.sweep(jf.SMRF(), cloud, axes, design="list", votes=True)
        angles = {"max_angle": rng.uniform(4.0, 40.0, count).tolist(), "max_elevation": [1.0] * count}
        jf.sweep(jf.FPTD(window=30.0), cloud, angles, design="list")

    run(cloud, 7)
    compilation.watch_compilations()
    before = compilation.compilations()[0]
    run(jf.PointCloud.from_arrays(cloud.coordinates()[cloud.candidate][:-200] * [0.95, 0.98, 1.0]), 40)
    assert compilation.compilations()[0] == before


def test_labels_of_one_class_are_named_before_anything_runs(cloud, monkeypatch):
    monkeypatch.setattr("jaxfilter.sweeps.sweep.ground_each", None)
    bad = jf.PointCloud.from_arrays(cloud.coordinates(), reference=np.ones(len(cloud), bool))
    with pytest.raises(jf.InputError, match="bad has the reference label object"):
        jf.sweep(jf.SMRF(), {"good": cloud, "bad": bad}, {"slope": [0.1]})


def test_degenerate_clouds_have_the_labels_of_their_status():
    flat = jf.PointCloud.from_arrays(np.column_stack([np.random.default_rng(0).random((50, 2)) * 9, np.full(50, 3.0)]))
    data = jf.sweep(jf.SMRF(), flat, {"slope": [0.1, 0.2]}, votes=True)
    assert data.ground.values.tolist() == [50, 50] and (data.votes == 1).all()


# Filters of users


class Limits(NamedTuple):
    far: Any
    steep: Any


class Nested(NamedTuple):
    """Limits in another order than the package's, one below the other, that are calculated with."""

    limits: Limits
    share: Any = 0.5

    def verdict(self, s, two_sided):
        over = jnp.maximum(jnp.abs(s.distance) - self.limits.far * (1.0 + self.share * s.level), 0.0)
        over += jnp.maximum(jnp.abs(s.angle) - self.limits.steep, 0.0)
        decision = jnp.where(over > 0, jf.Decision.ANGLE, jf.Decision.ACCEPTED).astype(jnp.uint8)
        return Verdict(s.planar & (over <= 0), decision, over, s)


class Swapped(NamedTuple):
    max_distance: Any
    max_angle: Any

    def verdict(self, s, two_sided):
        return Rule(self.max_angle, jnp.inf, self.max_distance).verdict(s, two_sided)


def by_node(self, network):
    far = self.max_distance + 0.01 * np.arange(len(network.xyz), dtype=np.float32) / len(network.xyz)
    return Rule(self.max_angle, max_distance=far)


class Counted(NamedTuple):
    """Numbers where the package's rule has bool and uint8."""

    max_distance: Any
    max_angle: Any

    def verdict(self, s, two_sided):
        found = Swapped.verdict(self, s, two_sided)
        return found._replace(accepted=found.accepted.astype(float), decision=found.decision.astype(int))


RULES = {
    "vars": lambda self, network: Rule(vars(self)["max_angle"], jnp.inf, vars(self)["max_distance"]),
    "nested": lambda self, network: Nested(Limits(self.max_distance, self.max_angle)),
    "swapped": lambda self, network: Swapped(self.max_distance, self.max_angle),
    "by node": by_node,
    "counted": lambda self, network: Counted(self.max_distance, self.max_angle),
}


def with_rule(rule):
    def growth(self, network):
        return dataclasses.replace(jf.PTD.growth(self, network), rule=rule(self, network))

    return {"growth": growth}


def with_vertices(self, network):
    return dataclasses.replace(jf.PTD.growth(self, network), vertices=Vertices(self.max_distance, stop_share=0.02))


def following(self, network):
    def limits(distance, angle):
        return Nested(Limits(self.max_distance * 5 * np.median(distance), self.max_angle))

    return Growth(Nested(Limits(self.max_distance, self.max_angle)), adaptive=Adaptive(limits))


def beyond(self, network):
    slope = np.full(len(network.xyz), 0.3, np.float32)
    return Growth(Swapped(self.max_distance, self.max_angle), beyond=Beyond(0.3, slope))


def without_border(self, points, seeds, outliers):
    return one_network(points, seeds, np.zeros((0, 2)), outliers)


def start_by(seed_cell):
    def start(self, points, *others, **named):
        return jf.PTD.start(self.replace(seed_cell=seed_cell(self)), points, *others, **named)

    return {"start": start}


def cut(self, points, **options):
    labels = super(type(self), self).classify(points, **options)
    labels.ground &= points.xyz[:, 0] > 30.0
    return labels


def with_threshold(method):
    def call(self, *arguments):
        return getattr(jf.SMRF, method)(self.replace(slope=0.1 + 0.2 * self.threshold), *arguments)

    return {method: call}


def cells_by_threshold(self, points, barred=None):
    barred = np.zeros(len(points), bool) if barred is None else barred
    return jf.SMRF.cells(self, points, barred | (points.xyz[:, 2] < np.quantile(points.xyz[:, 2], self.threshold / 9)))


USERS = {
    **{f"a rule, {name}": (jf.PTD(seed_cell=30.0), with_rule(rule)) for name, rule in RULES.items()},
    "limits that follow": (jf.PTD(seed_cell=30.0), {"growth": following}),
    "limits beyond the hull": (jf.PTD(seed_cell=30.0), {"growth": beyond, "network": without_border}),
    "vertices by a limit": (jf.PTD(seed_cell=30.0), {"growth": with_vertices}),
    "seeds by a limit": (jf.PTD(), start_by(lambda one: 15.0 + 20.0 * one.max_distance)),
    "seeds by a limit now and then": (jf.PTD(), start_by(lambda one: 50.0 * (one.max_angle > 5 and one.max_distance) + 9)),
    "classify of a TIN": (jf.PTD(seed_cell=30.0), {"classify": cut}),
    "classify of a grid": (jf.SMRF(window=6.0), {"classify": cut}),
    "classify of windows": (jf.PMF(max_window=9.0), {"classify": cut}),
    "classify of a cloth": (jf.CSF(), {"classify": cut}),
    "a surface by what is tested": (jf.SMRF(window=6.0), with_threshold("surface")),
    "openings by what is tested": (jf.SMRF(window=6.0), {
        "prepare": lambda self, cells: jf.SMRF.prepare(
            self, dataclasses.replace(cells, lowest=cells.lowest * self.threshold)
        ),
    }),
    "cells by what is tested": (jf.SMRF(window=6.0), {"cells": cells_by_threshold}),
    "another surface of windows": (jf.PMF(max_window=9.0), {
        "surface": lambda self, prepared: jf.PMF.surface(self.replace(slope=0.5 * self.slope), prepared),
    }),
}  # fmt: skip
"""A filter, and the methods that a user's subclass of it has."""


@pytest.fixture
def user(request, monkeypatch):
    """A set of a user's filter; it is forgotten afterwards."""
    monkeypatch.setattr(FILTERS, "data", dict(FILTERS.data))
    first, methods = USERS[request.param]
    mine = filter_params(type("Mine", (type(first),), dict(methods)))
    return mine(**{field.name: getattr(first, field.name) for field in dataclasses.fields(first)})


AXES = {
    "PTD": {"max_angle": (4.0, 15.0, 30.0), "max_distance": (0.4, 1.4)},
    "SMRF": {"slope": (0.1, 0.3), "threshold": (0.2, 0.5, 0.9)},
    "PMF": {"slope": (0.1, 0.3), "initial_distance": (0.2, 0.6)},
    "CSF": {"threshold": (0.2, 0.6)},
}


def axes_of(one):
    return AXES[type(one).__mro__[1].__name__]


@pytest.mark.parametrize("user", USERS, indirect=True)
def test_filters_of_users_have_the_labels_of_single_calls_whatever_their_methods_read(user, hills):
    found = check_equal(product(user, **axes_of(user)), hills)
    assert len({ground.tobytes() for ground in found}) > 1


@pytest.mark.parametrize("user", ["a surface by what is tested", "openings by what is tested"], indirect=True)
def test_batches_of_filters_of_users_have_the_labels_of_single_calls(user, hills):
    sets = product(user, **axes_of(user))
    made = jf.batch([hills], user)
    given = {name: [getattr(one, name) for one in sets] for name in axes_of(user)}
    np.testing.assert_array_equal(made.unstack(made.ground(given))[0], [one(hills).ground for one in sets])


@pytest.mark.parametrize("user", ["cells by what is tested"], indirect=True)
def test_a_batch_in_whose_cells_a_threshold_takes_part_is_refused(user, hills):
    with pytest.raises(jf.ParameterError, match="the cells of Mine depend on 'threshold': declare it as static"):
        jf.batch([hills], user)


@pytest.mark.parametrize("method", [jf.PTD, jf.PTDF, jf.ATIN, jf.AGPTD, jf.SPF, jf.STIN, jf.IPTD, jf.FPTD])
def test_no_limit_of_the_growth_decides_where_it_starts(method, hills):
    one, read = watch(method())
    one.start(canonical_points(hills), 1, lambda share, step: None)
    limits = {"max_angle", "max_elevation", "max_distance", "stop_ratio"}
    assert not read & limits and limits & {field.name for field in dataclasses.fields(method)}


def test_a_checkpoint_does_not_outlive_an_edit_of_the_filter(cloud, tmp_path, monkeypatch):
    monkeypatch.setattr(FILTERS, "data", dict(FILTERS.data))
    source = """
import jaxfilter as jf
from jaxfilter.core.params import filter_params

@filter_params
class Mine(jf.SMRF):
    def test(self, surface, xyz):
        return super().test(surface, xyz + [0.0, 0.0, 0.5])
"""

    def swept(text):
        (tmp_path / "mine.py").write_text(text)
        names = {"__name__": "mine"}
        exec(compile(text, tmp_path / "mine.py", "exec"), names)
        return jf.sweep(names["Mine"](), cloud, {"slope": [0.1, 0.2]}, checkpoint=tmp_path / "sweep.npz")

    assert swept(source).identical(swept(source))
    with pytest.raises(jf.InputError, match="other source of the filter"):
        swept(source.replace("0.5", "2.5"))


def test_a_field_that_is_called_as_an_argument_of_xarray_is_selected_by_a_mapping(cloud):
    clashing = {"tolerance", "method", "drop", "indexers", "missing_dims"}
    known = {name for name in jf.FILTERS for field in dataclasses.fields(jf.FILTERS[name]) if field.name in clashing}
    assert known == {"iptd", "ost"}, "docs/sweeps.md names the fields"
    data = jf.sweep(jf.IPTD(window=30.0), cloud, {"tolerance": [0.05, 0.3]})
    assert data["total"].dims == ("tolerance",)
    for number, tolerance in enumerate([0.05, 0.3]):
        expected = jf.evaluate(jf.IPTD(window=30.0, tolerance=tolerance)(cloud), cloud).total
        for found in (data["total"].sel({"tolerance": tolerance}), data["total"].isel({"tolerance": number})):
            assert float(found) == pytest.approx(expected)
    assert float(data["total"][0]) != float(data["total"][1])
