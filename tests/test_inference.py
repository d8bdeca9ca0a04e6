"""Labels of a few points are carried to others that sets of parameters call alike."""

import dataclasses

import numpy as np
import pytest
from scipy.special import expit

from jaxfilter.sweeps import inference
from jaxfilter.sweeps.inference import Sample, components, expected_confusion, ground_probability


def kinds(rng, count=3000):
    """Points of four kinds, told apart by how 40 sets call them: bool[40, m], i64[m]."""
    kind = rng.integers(4, size=count)
    share = rng.random((40, 4))
    return rng.random((40, count)) < share[:, kind], kind


def test_components_are_uncorrelated_and_do_not_depend_on_the_order_of_points(rng):
    calls, _ = kinds(rng)
    found = components(calls)
    assert found.shape == (3000, inference.COMPONENTS)
    assert np.allclose(np.cov(found.T, bias=True), np.eye(inference.COMPONENTS), atol=1e-4)
    order = rng.permutation(3000)
    assert np.allclose(components(calls[:, order]), found[order], atol=1e-5)
    assert components(np.repeat(calls[:1], 5, axis=0)).shape == (3000, 1)  # five equal sets say one thing
    assert components(np.zeros((4, 0), bool)).shape == (0, 0)


def test_without_labels_the_given_filter_is_believed(rng):
    calls, _ = kinds(rng, 200)
    call, none = calls[0], np.zeros(0, int)
    p = ground_probability(components(calls), call, none, np.zeros(0, bool), np.zeros(0))
    assert np.allclose(p, expit(np.where(call, inference.CONFIDENCE, -inference.CONFIDENCE)))


def test_labels_of_a_kind_tell_the_class_of_the_kind(rng):
    calls, kind = kinds(rng)
    truth = kind >= 2
    known = rng.permutation(3000)[:300]
    p = ground_probability(components(calls), rng.random(3000) < 0.5, known, truth[known], np.ones(300))
    assert ((p > 0.5) == truth).mean() > 0.95
    light = ground_probability(components(calls), truth, known, ~truth[known], np.full(300, 0.001))
    assert ((light > 0.5) == truth).all()  # labels that count little do not outweigh the filter


def test_expected_counts_are_those_of_the_classes_where_these_are_certain(rng):
    calls, truth = rng.random((5, 400)) < 0.6, rng.random(400) < 0.5
    found = expected_confusion(calls, np.array([truth, ~truth], np.float32))
    for one, counts in zip(calls, found[0], strict=True):
        assert counts.tolist() == [
            [(truth & one).sum(), (truth & ~one).sum()],
            [(~truth & one).sum(), (~truth & ~one).sum()],
        ]
    assert np.array_equal(found[1], found[0][:, ::-1])


def test_a_sample_is_the_same_in_any_order_and_is_scaled_to_the_cloud(rng, monkeypatch):
    monkeypatch.setattr(inference, "UNLABELLED", 300)
    xyz = (rng.random((2000, 3)) * [60, 60, 5]).astype(np.float32)
    known = rng.random(2000) < 0.05
    truth, fold = rng.random(known.sum()) < 0.5, rng.integers(5, size=known.sum())
    one = Sample.of(xyz, known, truth, fold, 1.3)
    assert known[one.index[: known.sum()]].all() and len(one.index) == known.sum() + 300
    assert one.others == (~known).sum()
    order = rng.permutation(2000)
    place = np.cumsum(known) - 1  # of a labelled point among the labels
    label = place[order[known[order]]]
    two = Sample.of(xyz[order], known[order], truth[label], fold[label], 1.3)
    assert np.array_equal(order[two.index], one.index)
    assert np.array_equal(two.truth, one.truth) and np.array_equal(two.fold, one.fold)

    calls = rng.random((6, 2000)) < 0.5
    calls[:, xyz[:, 2] > 3] = True
    bits = np.packbits(calls[:, one.index], axis=1)
    counts = one.expected(bits, calls[0, one.index], [-1, 2])
    assert counts.sum(axis=(2, 3)) == pytest.approx(one.others)
    flipped = dataclasses.replace(one, truth=one.truth ^ (one.fold == 2)).expected(bits, calls[0, one.index], [-1, 2])
    assert np.array_equal(flipped[1], counts[1]) and not np.array_equal(flipped[0], counts[0])
    rest = one.index[known.sum() :]
    assert counts[0, :, :, 0].sum(axis=1) == pytest.approx(calls[:, rest].sum(axis=1) * one.others / 300)
