"""Calibration finds parameters from few labels, judges them on blocks it did not use, and refuses labels it cannot use."""

import itertools

import numpy as np
import pytest

import jaxfilter as jf
from jaxfilter import scenes
from jaxfilter.sweeps.best import best_sets
from jaxfilter.sweeps.ranges import RANGES, Range, search_ranges


@pytest.fixture(scope="module")
def scene():
    return scenes.make("mixed", size=120.0, density=1.5, seed=8)


@pytest.fixture(scope="module")
def patches(scene):
    """bool[n]: what lies in four squares."""
    xy = scene.cloud.xyz[:, :2]
    near = [np.abs(xy - centre).max(axis=1) < 12 for centre in ((25, 25), (90, 30), (30, 95), (85, 85))]
    return np.any(near, axis=0) & scene.cloud.candidate


def known(truth, where):
    """Labels of which only some are known."""
    return np.where(where, truth, -1).astype(int)


def test_calibrated_parameters_are_better_than_bad_ones_on_the_points_without_labels(scene, patches):
    bad = jf.SMRF(slope=0.9, threshold=1.4, scaling=0.0)
    found = jf.calibrate(bad, scene.cloud, scene.truth, labelled=patches, size=48, rounds=2)
    rest = ~patches

    def error(filter_):
        return jf.evaluate(filter_(scene.cloud).ground, scene.truth, ignore=~rest).total

    assert error(found.filter) < 0.7 * error(bad) and found.score < found.before
    assert found.filter.window == bad.window and len(found.trials["set"]) == 96
    assert "cross-validated" in str(found) and 0 <= found.spread < 30
    assert float(found.trials.total.min()) <= found.score + 1e-9  # what was not seen is not judged better than what was


def test_trials_are_scored_as_evaluate_does(scene, patches):
    study = jf.Study(jf.SMRF(), scene.cloud, known(scene.truth, patches))
    sets = [{"slope": 0.1, "threshold": 0.4}, {"slope": 0.3, "threshold": 0.9}]
    scores = study.evaluate(sets)
    for one, score in zip(sets, scores, strict=True):
        labels = jf.SMRF(**one)(scene.cloud).ground
        assert score == pytest.approx(jf.evaluate(labels, scene.truth, ignore=~patches).total)
    trials = study.result().trials
    assert trials.confusion.sum() == 2 * patches.sum() and trials.total.values.tolist() == scores.tolist()


@pytest.mark.parametrize("score", ["total", "kappa"])
def test_labels_of_a_fold_do_not_choose_the_set_that_it_is_scored_with(scene, patches, score):
    sets = [{"slope": s, "threshold": t} for s in (0.05, 0.15, 0.4) for t in (0.3, 0.8, 2.0)]

    def evaluated(truth):
        validation = jf.CrossValidation(folds=3)
        study = jf.Study(jf.SMRF(), scene.cloud, known(truth, patches), score=score, validation=validation)
        study.evaluate(sets)
        return study

    study, rows = evaluated(scene.truth), np.flatnonzero(patches)
    assert study.folds == 3
    called = np.zeros(len(scene.truth), bool)
    for fold in range(3):
        held = rows[study.fold == fold]
        without = study.expected([fold])
        called[held] = jf.SMRF(**sets[int(study.best(without)[0])])(scene.cloud).ground[held]
        wrong = scene.truth.copy()
        wrong[held] ^= True
        other = evaluated(wrong)
        assert np.array_equal(other.expected([fold]), without)
        assert not np.array_equal(other.expected(), study.expected())  # they count where no fold is left out

    found, nowhere = study.result(), ~patches
    expected, seen = (
        getattr(jf.evaluate(labels, scene.truth, ignore=nowhere), score)
        for labels in (called, found.filter(scene.cloud).ground)
    )
    assert found.score == pytest.approx(expected)
    assert expected > seen + 0.5 if score == "total" else expected < seen - 0.5  # what all labels chose looks better


def test_an_optimiser_drives_a_study_in_batches(scene, patches):
    optuna = pytest.importorskip("optuna")
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = jf.Study(jf.SMRF(), scene.cloud, known(scene.truth, patches))
    optimiser = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=1))
    for _ in range(3):
        trials = [optimiser.ask() for _ in range(12)]
        sets = [{name: t.suggest_float(name, r.low, r.high) for name, r in study.ranges.items()} for t in trials]
        for trial, score in zip(trials, study.evaluate(sets), strict=True):
            optimiser.tell(trial, score)
    assert len(study.sets) == 36 and optimiser.best_value == pytest.approx(float(study.result().trials.total.min()))


@pytest.mark.slow
def test_scores_are_not_averaged_over_words_and_what_is_none_or_endless(scene):
    for filter_, sets in (
        (jf.OST(window=15.0), [{"spacing": spacing} for spacing in (None, 1.5, 3.0)]),
        (jf.PTDF(seed_cell=30.0, max_below=np.inf), [{"max_below": limit} for limit in (np.inf, 0.1)]),
        (jf.PMF(), [{"compare": word, "slope": s} for s in (0.1, 0.2) for word in ("surfaces", "points")]),
    ):
        study = jf.Study(filter_, scene.cloud, scene.truth)  # all labels are known
        assert np.array_equal(study.evaluate(sets), study.expected()[0])
    assert f"compare={study.result().filter.compare}" in str(study.result())


@pytest.mark.parametrize("seed", [3, 5, 8, 12])
def test_the_best_set_is_that_of_the_cloud_not_that_of_the_patches(seed):
    place = scenes.make("mixed", size=120.0, density=1.5, seed=seed)
    cloud, truth = place.cloud, place.truth
    patches = [np.abs(cloud.xyz[:, :2] - at).max(axis=1) < 6 for at in ((25, 25), (90, 30), (30, 95), (85, 85))]
    study = jf.Study(jf.SMRF(), cloud, known(truth, np.any(patches, axis=0) & cloud.candidate))
    axes = itertools.product((0.05, 0.1, 0.2, 0.4, 0.8), (0.15, 0.3, 0.6, 1.2), (0.0, 1.5, 3.0))
    naive = study.evaluate([dict(zip(("slope", "threshold", "scaling"), values, strict=True)) for values in axes])

    def error(**values):
        return jf.evaluate(jf.SMRF(**values)(cloud).ground, truth).total

    best = study.sets[study.best(study.expected()[0])]
    assert error(**best) < 0.95 * min(error(), error(**study.sets[int(naive.argmin())]))


def test_a_given_filter_without_limit_is_searched(scene, patches):
    endless, axes = jf.PTDF(seed_cell=30.0, max_below=np.inf), {"max_below": (0.5, 5.0)}
    found = jf.calibrate(endless, scene.cloud, scene.truth, labelled=patches, axes=axes, size=6)
    assert np.isinf(found.trials.max_below.values[0]) and found.trials.sizes["set"] == 12


def test_the_order_of_points_does_not_matter(scene, patches, rng):
    order, labels = rng.permutation(len(scene.truth)), known(scene.truth, patches)
    echoes = {name: getattr(scene.cloud, name)[order] for name in ("return_number", "number_of_returns")}
    shuffled = jf.PointCloud.from_arrays(scene.cloud.coordinates()[order], **echoes)
    one = jf.calibrate(jf.SMRF(), scene.cloud, labels, size=16, rounds=2)
    two = jf.calibrate(jf.SMRF(), shuffled, labels[order], size=16, rounds=2)
    assert one.filter == two.filter != jf.SMRF() and one.score == pytest.approx(two.score)


@pytest.mark.filterwarnings("error::UserWarning")
def test_trials_are_tabled_and_stored(scene, patches, tmp_path):
    found = jf.calibrate(jf.SMRF(), scene.cloud, scene.truth, labelled=patches, size=24, rounds=1, score="kappa")
    table = best_sets(found.trials, "expected", None)
    assert table.expected.is_monotonic_decreasing and table.slope.iloc[0] == found.filter.slope
    found.trials.to_netcdf(tmp_path / "trials.nc")


def test_labels_that_say_nothing_are_refused_or_warned_of(scene):
    cloud = scene.cloud
    with pytest.raises(jf.InputError, match="set aside"):
        jf.Study(jf.SMRF(), cloud, known(np.arange(len(cloud)) % 2 == 0, ~cloud.candidate))
    line = np.column_stack([np.arange(40.0), np.zeros(40), np.arange(40) % 2])
    with pytest.warns(jf.JaxfilterWarning, match="SMRF"):
        found = jf.calibrate(jf.SMRF(), line, np.arange(40) % 2 == 0, size=4, rounds=1)
    assert found.score == found.before


@pytest.mark.parametrize("count", [2, 5])
def test_folds_are_whole_blocks_of_about_the_same_size(count, rng):
    xyz = (rng.random((900, 3)) * [200, 80, 9]).astype(np.float32)
    fold = jf.CrossValidation(count, 20.0).assign(xyz)
    block = np.floor(xyz[:, :2] / 20).astype(int) @ [1000, 1]
    assert all(len(set(fold[block == b])) == 1 for b in set(block.tolist()))
    sizes = np.bincount(fold)
    assert len(sizes) == count and sizes.max() < 1.5 * sizes.min()
    assert int(jf.CrossValidation(count).assign(xyz).max()) + 1 == count


def test_bad_labels_and_arguments_are_named(scene, patches):
    cloud, truth = scene.cloud, scene.truth
    for labels, message in (
        (truth[:-1], "one per point"),
        (np.ones(len(cloud), bool), "labelled object"),
        (np.full(len(cloud), -1), "labelled ground"),
    ):
        with pytest.raises(jf.InputError, match=message):
            jf.calibrate(jf.SMRF(), cloud, labels)
    with pytest.raises(jf.InputError, match="labelled must be bool"):
        jf.calibrate(jf.SMRF(), cloud, truth, labelled=patches[:-1])
    for options, message in (
        ({"axes": {"slop": (0.1, 0.2)}}, "no field 'slop'"),
        ({"axes": {"slope": (0.2, 0.1)}}, "from low to high"),
        ({"axes": {"slope": (-0.2, 0.1)}}, r"SMRF\(slope=-0.2\)"),
        ({"axes": {"slope": 0.1}}, "pair"),
        ({"axes": ["slope"]}, "map fields of SMRF"),
        ({"axes": {"slope": Range(0.1, 0.2, "linear"), "window": (9.0, float("inf"))}}, "window=.*from low to high"),
        ({"size": 0}, "size=0"),
        ({"size": 2.5}, "size=2.5"),
        ({"seed": -1}, "seed=-1"),
        ({"workers": 0}, "workers=0"),
        ({"memory": float("inf")}, "memory=inf"),
        ({"block": float("inf")}, "block=inf"),
        ({"rounds": 0}, "rounds=0"),
        ({"folds": 1}, "folds=1"),
        ({"block": 0.0}, "block=0.0"),
        ({"score": "f1"}, "score='f1'"),
    ):
        with pytest.raises(jf.ParameterError, match=message):
            jf.calibrate(jf.SMRF(), cloud, truth, labelled=patches, **options)


@pytest.mark.parametrize("method", list(jf.FILTERS))
def test_search_ranges_hold_values_that_the_method_takes(method):
    ranges = search_ranges(jf.FILTERS[method])
    assert ranges
    for name, r in ranges.items():
        for u in (0.0, 0.3, 1.0):
            jf.FILTERS[method](**{name: r.at(u)})
            assert r.position(r.at(u)) == pytest.approx(u, abs=0.35 if r.scale == "whole" else 0.01)


def test_ranges_map_the_unit_interval():
    assert Range(0.1, 10.0, "log").at(0.5) == 1.0 and Range(2.0, 4.0).at(0.25) == 2.5
    assert [Range(1, 3, "whole").at(u) for u in (0.0, 0.34, 0.99, 1.0)] == [1, 2, 3, 3]
    assert RANGES["max_angle"].position(4.0) == 0.0 and RANGES["slope"].position(np.inf) == 2.0
    for arguments, message in (((1.0, 0.1), "low to high"), ((0.0, 1.0, "log"), "above 0"), ((0.1, 1.0, "sqrt"), "scale"),
                               ((0.5, 3.0, "whole"), "whole ends")):  # fmt: skip
        with pytest.raises(jf.ParameterError, match=message):
            Range(*arguments)
