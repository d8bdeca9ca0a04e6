"""Scores against published tables, independent formulas and invariants."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from jaxfilter.core.cloud import PointCloud
from jaxfilter.core.errors import InputError
from jaxfilter.core.filter import Labels, expand
from jaxfilter.core.points import canonical_points
from jaxfilter.metrics import confusion_counts
from jaxfilter.scoring import Scores, evaluate, match_points

# Sample, ground and object points of the ISPRS reference, and Type I, Type II, total error and kappa of FPTD or PTD as
# Li et al. (2021) print them in Table IV.
PUBLISHED = [
    ("samp12 FPTD", 26691, 25428, 9.86, 4.01, 7.01, 86.00),
    ("samp12 PTD", 26691, 25428, 10.25, 2.06, 6.26, 87.50),
    ("samp24 FPTD", 5434, 2058, 21.79, 6.95, 17.71, 61.59),
    ("samp41 PTD", 5602, 5629, 58.69, 0.64, 29.60, 40.72),
    ("samp42 FPTD", 12443, 30027, 1.45, 1.44, 1.44, 96.54),
    ("samp51 FPTD", 13950, 3895, 0.06, 24.31, 5.35, 82.83),
    ("samp53 PTD", 32989, 1389, 16.35, 27.14, 16.79, 20.70),
]


def labels(a: int, b: int, c: int, d: int) -> tuple[np.ndarray, np.ndarray]:
    """Shuffled (result, reference) with these counts."""
    order = np.random.default_rng(7).permutation(a + b + c + d)
    return np.repeat([True, False, True, False], (a, b, c, d))[order], np.repeat([True, False], (a + b, c + d))[order]


@pytest.mark.parametrize("name, ground, objects, type1, type2, total, kappa", PUBLISHED)
def test_published_rates_give_the_published_total_error_and_kappa(name, ground, objects, type1, type2, total, kappa):
    b, c = round(type1 * ground / 100), round(type2 * objects / 100)
    scores = evaluate(*labels(ground - b, b, c, objects - c))
    np.testing.assert_array_equal(scores.confusion, [[ground - b, b], [c, objects - c]])
    assert scores.type1 == pytest.approx(type1, abs=0.006)
    assert scores.type2 == pytest.approx(type2, abs=0.037)  # half a point of the 1389 objects of samp53
    assert scores.total == pytest.approx(total, abs=0.006)
    assert scores.kappa == pytest.approx(kappa, abs=0.011)


def test_figures_by_hand_and_of_large_counts():
    expected = {"type1": 25, "type2": 25, "total": 25, "accuracy": 75, "precision": 600 / 7, "recall": 75}
    expected |= {"f1": 2 / (7 / 600 + 1 / 75), "kappa": 100 * (0.75 - 19 / 36) / (1 - 19 / 36)}
    figures = Scores.from_confusion([[6, 2], [1, 3]]).as_dict()
    assert {name: figures[name] for name in expected} == pytest.approx(expected)
    scores = Scores.from_confusion(np.array([[2**31 - 1, 2**30], [2**30, 2**31 - 1]]))
    assert scores.kappa == pytest.approx(100 / 3, abs=1e-6)


@pytest.mark.parametrize("confusion, undefined", [
    ([[0, 0], [0, 0]], {"type1", "type2", "total", "kappa", "accuracy", "precision", "recall", "f1"}),
    ([[5, 0], [0, 0]], {"type2", "kappa"}),
    ([[0, 0], [0, 5]], {"type1", "kappa", "precision", "recall", "f1"}),
    ([[0, 5], [0, 5]], {"precision"}),
])  # fmt: skip
def test_undefined_figures_are_nan(confusion, undefined):
    scores = Scores.from_confusion(confusion)
    figures = {k: v for k, v in scores.as_dict().items() if k != "confusion"}
    assert {k for k, v in figures.items() if math.isnan(v)} == undefined


@pytest.mark.parametrize("n", [0, 1, 1023, 1024, 1025, 70_001])
def test_counts_equal_numpy_whatever_the_padding(n):
    rng = np.random.default_rng(n)
    result, reference, ignore = rng.random((3, n)) < 0.4
    keep = ~ignore
    expected = np.histogram2d(~reference[keep], ~result[keep], bins=2, range=((0, 1), (0, 1)))[0]
    np.testing.assert_array_equal(evaluate(result, reference, ignore=ignore).confusion, expected)


def test_counts_are_exact_beyond_float32():
    n = 2**24 + 3
    ones = np.ones(n, bool)
    assert int(confusion_counts(ones, ones, ones)[0, 0]) == n


def test_unlabelled_and_ignored_points_do_not_count():
    result = np.array([True, False, True, False, True])
    assert evaluate(result, np.array([1, 0, -1, 1, 0])).confusion.tolist() == [[1, 1], [1, 1]]
    ignore = np.array([False, False, False, True, False])
    assert evaluate(result, np.array([1, 0, -1, 1, 0]), ignore=ignore).confusion.tolist() == [[1, 0], [1, 1]]
    scores = evaluate(result, np.array([1, 0, -1, 1, 0]), classes=np.array([2, 9, 0, 2, 6]), ignore_classes=(9, 6))
    assert scores.confusion.tolist() == [[1, 1], [0, 0]]


def classified_cloud() -> PointCloud:
    """Six points: ground, ground, building, never classified, noise, water."""
    classes = np.array([2, 2, 6, 0, 7, 9], np.uint8)
    xyz = np.column_stack([np.arange(6.0) * 10, np.arange(6.0) % 3 * 7, np.arange(6.0)])
    return PointCloud.from_arrays(xyz, classification=classes, reference=classes == 2)


def test_a_cloud_as_reference_knows_unlabelled_classes_and_candidates():
    cloud = classified_cloud()
    result = np.array([True, False, True, True, True, True])
    assert evaluate(result, cloud).confusion.tolist() == [[1, 1], [3, 0]]
    assert evaluate(result, cloud, ignore_classes=[9]).confusion.tolist() == [[1, 1], [2, 0]]
    assert evaluate(result, cloud, candidates_only=True).confusion.tolist() == [[1, 1], [1, 0]]


def test_a_result_knows_which_points_were_set_aside():
    cloud = classified_cloud()
    points = canonical_points(cloud)
    result = expand(cloud, points, Labels(np.ones(len(points), bool)))
    assert evaluate(result, cloud.reference).confusion.tolist() == [[2, 0], [2, 2]]
    assert evaluate(result, cloud.reference, candidates_only=True).confusion.tolist() == [[2, 0], [2, 0]]


@pytest.mark.parametrize("result, reference, options, message", [
    (np.ones(3, bool), None, {}, "reference is None"),
    (np.ones(3), np.ones(3, bool), {}, "result must be"),
    (np.ones((3, 1), bool), np.ones(3, bool), {}, "result must be"),
    (np.ones(3, bool), np.ones(4, bool), {}, "4 labels for the 3 points"),
    (np.ones(3, bool), np.ones(3), {}, "reference must be"),
    (np.ones(3, bool), np.array([1, 0, 2]), {}, r"\[2\]"),
    (np.ones(3, bool), np.ones(3, bool), {"ignore": np.ones(2, bool)}, "ignore must be"),
    (np.ones(3, bool), np.ones(3, bool), {"ignore_classes": (9,)}, "ignore_classes needs classes"),
    (np.ones(3, bool), np.ones(3, bool), {"ignore_classes": (9,), "classes": np.ones(2, int)}, "classes must be"),
    (np.ones(3, bool), np.ones(3, bool), {"candidates_only": True}, "candidates_only needs"),
    (np.ones(6, bool), dataclasses.replace(classified_cloud(), reference=None), {}, "no reference labels"),
])  # fmt: skip
def test_wrong_arguments_are_named(result, reference, options, message):
    with pytest.raises(InputError, match=message):
        evaluate(result, reference, **options)


def test_match_finds_the_same_points_in_another_order():
    rng = np.random.default_rng(3)
    xyz = np.round(rng.uniform(0, 500, (4000, 3)), 2) + np.array([500_000.37, 4_800_000.81, 300])
    xyz[100] = xyz[200]
    order = rng.permutation(len(xyz))
    cloud, shuffled = PointCloud.from_arrays(xyz), PointCloud.from_arrays(xyz[order])
    match = match_points(cloud, shuffled)
    np.testing.assert_array_equal(xyz[order][match], xyz)
    np.testing.assert_array_equal(np.sort(match), np.arange(len(xyz)))
    np.testing.assert_array_equal(match_points(cloud, cloud), np.arange(len(xyz)))


def test_match_refuses_other_points():
    xyz = np.arange(30.0).reshape(10, 3)
    cloud = PointCloud.from_arrays(xyz)
    with pytest.raises(InputError, match="10 points and OTHER has 9"):
        match_points(cloud, PointCloud.from_arrays(xyz[:9]), ("OUT", "OTHER"))
    moved = xyz.copy()
    moved[4, 2] += 0.01
    with pytest.raises(InputError, match=r"do not hold the same points.*12\.000, 13\.000, 14\.0"):
        match_points(cloud, PointCloud.from_arrays(moved))
