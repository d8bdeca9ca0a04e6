"""Labels of a few points are carried to others that sets of parameters call alike."""

import numpy as np
from scipy.special import expit

from jaxfilter.sweeps import inference
from jaxfilter.sweeps.inference import components, expected_confusion, ground_probability


def kinds(rng, count=3000):
    """Points of four kinds, told apart by how 40 sets call them: bool[40, m], i64[m]."""
    kind = rng.integers(4, size=count)
    share = rng.random((40, 4))
    return rng.random((40, count)) < share[:, kind], kind


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
