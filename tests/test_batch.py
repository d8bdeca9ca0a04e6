"""Batches: clouds of unlike size under many sets at once have the labels and scores that each has alone."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfilter as jf
from jaxfilter.steps import batch as module

SMRF, MSF = jf.SMRF(window=6.0), jf.MSF(window=4.0)


@pytest.fixture(scope="module")
def scenes():
    sizes = {"a": (60, 50), "b": (30, 75), "c": (280, 40)}
    return {name: jf.scenes.make("town", size=size, density=0.8, seed=4) for name, size in sizes.items()}


@pytest.fixture(scope="module")
def smrf(scenes):
    clouds = {name: scene.cloud for name, scene in scenes.items()}
    return jf.batch(clouds, SMRF, {name: scene.truth for name, scene in scenes.items()}, blocks=1)


def each(filter_, sets):
    return [filter_.replace(**dict(zip(sets, values, strict=True))) for values in zip(*sets.values(), strict=True)]


@pytest.mark.parametrize("filter_, sets", [
    pytest.param(jf.PMF(max_window=9.0), {"slope": [0.1, 0.6], "initial_distance": [0.2, 0.5]}, marks=pytest.mark.slow),
    (MSF, {"slope": [0.2, 0.6], "max_height": [2.0, 5.0]}),
], ids=["pmf", "msf"])  # fmt: skip
def test_other_methods_take_batches(scenes, filter_, sets):
    clouds = [scenes["a"].cloud, scenes["b"].cloud]
    made = jf.batch(clouds, filter_, blocks=1)
    for cloud, labels in zip(clouds, made.unstack(made.ground(sets)), strict=True):
        np.testing.assert_array_equal(labels, [one(cloud).ground for one in each(filter_, sets)])


@pytest.mark.slow
def test_counts_are_those_of_evaluate_and_of_the_labels(scenes):
    clouds = {name: scene.cloud for name, scene in scenes.items()}
    made, sets = jf.batch(clouds, MSF, {name: one.truth for name, one in scenes.items()}), {"slope": [0.2, 0.6]}
    counts, labels = made.confusion(sets), made.unstack(made.ground(sets))
    assert len(made.blocks) == 3 and not np.array_equal(*labels["c"])
    for c, (name, scene) in enumerate(scenes.items()):
        for s in range(2):
            np.testing.assert_array_equal(counts[c, s], jf.evaluate(labels[name][s], scene.truth).confusion)


def test_unlabelled_points_and_clouds_without_labels_do_not_count(scenes):
    cloud, truth = scenes["a"].cloud, scenes["a"].truth.astype(int)
    truth[::3] = -1
    counts = jf.batch([cloud], MSF, [truth]).confusion()
    assert counts.shape == (1, 2, 2) and int(counts.sum()) == (truth >= 0).sum()
    assert not jf.batch([dataclasses.replace(cloud, reference=None)], MSF).confusion().any()


def test_one_program_under_jit_vmap_and_in_chunks(scenes, monkeypatch):
    clouds, truths = zip(*((scenes[name].cloud, scenes[name].truth) for name in "ab"), strict=True)
    made = jf.batch(clouds, MSF, truths, blocks=1)
    sets = {"slope": jnp.array([0.1, 0.3, 0.6]), "max_height": jnp.array([1.0, 3.0, 5.0])}
    expected = made.confusion(sets)

    def of_set(fields):
        return dataclasses.replace(made, filter=dataclasses.replace(made.filter, **fields)).confusion()

    np.testing.assert_array_equal(np.moveaxis(jax.jit(jax.vmap(of_set))(sets), 0, 1), expected)
    monkeypatch.setattr(module, "_at_once", lambda block, sets, memory: 3)
    np.testing.assert_array_equal(jax.jit(lambda batch, sets: batch.confusion(sets))(made, sets), expected)


@pytest.mark.slow
def test_soft_labels_and_their_gradients_are_those_of_single_clouds(scenes):
    filter_ = jf.PMF(max_window=9.0)
    made, cloud = jf.batch([scenes["a"].cloud], filter_), scenes["a"].cloud
    points = filter_.points_of(cloud)
    cells = filter_.cells(points)

    def alone(slope):
        return jf.soft_labels(dataclasses.replace(filter_, slope=slope), cells, points.xyz, width=0.3).sum()

    def batched(slope):
        return made.soft({"slope": slope[None]}, width=0.3)[0].sum()

    got, expected = (jax.value_and_grad(function)(jnp.float32(0.3)) for function in (batched, alone))
    np.testing.assert_allclose(got, expected, rtol=1e-3)


@pytest.mark.parametrize("sets, message", [
    ({"window": [5.0]}, "window"), ({"slop": [0.1]}, "slop"), ({"slope": [-0.1, 0.2]}, "slope=-0.1"),
    ({"slope": [0.1], "threshold": [0.1, 0.2]}, "one length"), ({"slope": 0.1}, "one length"),
])  # fmt: skip
def test_sets_that_cannot_be_are_an_error_that_names_them(smrf, sets, message):
    with pytest.raises((jf.ParameterError, TypeError), match=message):
        smrf.ground(sets)


def test_what_cannot_be_batched_is_an_error_that_names_it(scenes):
    cloud = scenes["a"].cloud
    with pytest.raises(jf.ParameterError, match=r"PTD.*methods on a grid"):
        jf.batch([cloud], jf.PTD())
    with pytest.raises(jf.InputError, match=r"flat: .*nothing to filter"):
        jf.batch({"flat": np.zeros((5, 3))}, SMRF)
    with pytest.raises(jf.InputError, match=f"a: 3 labels for {len(cloud)} points"):
        jf.batch({"a": cloud}, SMRF, {"a": np.ones(3, bool)})
