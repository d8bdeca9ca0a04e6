"""What the labels of a few points say of the others.

Labelled patches that hold both classes lie where objects begin, and the errors there are not those of the whole scene: a
set that makes the fewest of them is often a bad set elsewhere. So labels are carried to the rest of the cloud first. How
each of many sets calls a point says what kind of point it is. Points of a kind are likely to be of one class, which is learnt
by logistic regression on the principal components of these calls. Where labels say nothing of a kind, the call of the given
filter is believed, with moderate confidence. Sets are then compared by the errors to expect on the whole cloud.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

COMPONENTS = 12
"""Principal components of the calls that are used."""
CONFIDENCE = 1.5
"""Logit of the probability that a call of the given filter is right, where calls depend on the parameters."""
LABEL_BLOCK = 10.0
"""Side of the squares, in point spacings, in which all labels together count as one: neighbours share their fate."""
LEARNT = 256
"""Sets whose calls say what kind of point a point is, the first of all."""
LABELLED, UNLABELLED = 20_000, 100_000
"""At most so many points to learn from, and others to compare the sets on."""
# Components, confidence, block and the neighbours of calibrate.py were chosen on simulated scenes and squares of labelled
# tiles, those of experiments/sensitivity/calibration.py. The ISPRS samples are left for the test.
_SETS = 64
"""Sets unpacked at a time."""


@dataclasses.dataclass(frozen=True, eq=False)
class Sample:
    """Some points of a cloud, those with labels first.

    Attributes:
        index: i64[m], the points.
        truth: bool[l], whether the labelled ones are ground.
        fold: i64[l], their folds.
        block: i64[l], number of the square that holds them.
        others: points of the cloud without a label.
    """

    index: np.ndarray
    truth: np.ndarray
    fold: np.ndarray
    block: np.ndarray
    others: int

    @classmethod
    def of(cls, xyz: np.ndarray, known: np.ndarray, truth: np.ndarray, fold: np.ndarray, spacing: float) -> Sample:
        """Points spread evenly over those with and without a label, in any point order the same.

        Args:
            xyz: f32[n, 3].
            known: bool[n], which have a label.
            truth, fold: bool[l], i64[l], of these.
            spacing: of the points, metres.
        """
        order = np.lexsort(xyz.T)
        with_label, without = order[known[order]], order[~known[order]]
        chosen, rest = _evenly(with_label, LABELLED), _evenly(without, UNLABELLED)
        place = np.searchsorted(np.flatnonzero(known), chosen)
        cell = np.floor(xyz[chosen, :2].astype(np.float64) / (LABEL_BLOCK * spacing)).astype(np.int64)
        block = np.unique(cell, axis=0, return_inverse=True)[1].ravel()
        return cls(np.concatenate([chosen, rest]), truth[place], fold[place], block, len(without))

    def expected(self, bits: np.ndarray, given: np.ndarray, without: Sequence[int]) -> np.ndarray:
        """f64[v, s, 2, 2]: counts to expect on the points without a label, reference by call, ground first.

        Args:
            bits: u8[s, ceil(m / 8)], calls of the sample by each set, packed.
            given: bool[m], calls of the given filter.
            without: per view the fold whose labels are not used; -1 = all are.
        """
        known = len(self.truth)
        calls = np.unpackbits(np.bitwise_or.reduce(bits) ^ np.bitwise_and.reduce(bits), count=len(self.index))
        contested = np.flatnonzero(calls)
        labelled = contested[contested < known]
        ground = np.empty((len(without), len(contested) - len(labelled)), np.float32)
        learnt = np.concatenate([part for _, part in _unpacked(bits[:LEARNT], contested)])
        kind = components(learnt)
        for view, fold in enumerate(without):
            use = np.flatnonzero(self.fold[labelled] != fold)
            block = self.block[labelled[use]]
            weight = 1.0 / np.bincount(block)[block] if len(use) else np.zeros(0)
            p = ground_probability(kind, given[contested], use, self.truth[labelled[use]], weight)
            ground[view] = p[len(labelled) :]
        agreed = np.setdiff1d(np.arange(known, len(self.index)), contested)
        first = np.unpackbits(bits[0], count=len(self.index))
        same = first[agreed].sum()  # all sets call these the same: taken as right
        out = np.zeros((len(without), len(bits), 2, 2))
        for start, part in _unpacked(bits, contested[len(labelled) :]):
            out[:, start : start + len(part)] = expected_confusion(part, ground)
        out[..., 0, 0] += same
        out[..., 1, 1] += len(agreed) - same
        return out * (self.others / max(1, len(self.index) - known))


def components(calls: np.ndarray) -> np.ndarray:
    """f64[m, k]: principal components of calls bool[s, m], each scaled to unit variance; k is at most COMPONENTS."""
    number, points = calls.shape
    if points == 0:
        return np.zeros((0, 0))
    both = np.zeros((number, number))
    for start in range(0, points, 1 << 16):  # whole numbers, whose sums do not depend on the order of the points
        part = calls[:, start : start + (1 << 16)].astype(np.float32)
        both += part @ part.T
    mean = calls.mean(axis=1)
    size, axes = np.linalg.eigh(both / points - np.outer(mean, mean))
    size, axes = size[::-1][:COMPONENTS], axes[:, ::-1][:, :COMPONENTS]
    some = size > 1e-9 * number
    out = np.empty((points, int(some.sum())))
    for start in range(0, points, 1 << 14):
        rows = slice(start, start + (1 << 14))
        out[rows] = (calls[:, rows].T - mean) @ axes[:, some]
    return out / np.sqrt(size[some])


def ground_probability(
    kind: np.ndarray, call: np.ndarray, known: np.ndarray, truth: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """f64[m]: probability that each point is ground.

    Args:
        kind: f64[m, k], components of the points.
        call: bool[m], what the given filter calls them.
        known: i64[l], the points with labels.
        truth: bool[l], these labels.
        weight: f64[l], how many independent labels each of them counts as, at most 1.
    """
    prior = CONFIDENCE * np.where(call, 1.0, -1.0)
    terms = np.column_stack([np.ones(len(kind)), kind])
    x, offset = terms[known], prior[known]

    def loss(b: np.ndarray) -> tuple[float, np.ndarray]:
        f = x @ b + offset
        value = weight @ (np.logaddexp(0.0, f) - truth * f) + 0.5 * b @ b
        return float(value), x.T @ (weight * (expit(f) - truth)) + b

    def hess(b: np.ndarray) -> np.ndarray:
        p = expit(x @ b + offset)
        return (x.T * (weight * p * (1.0 - p))) @ x + np.eye(len(b))

    fit = minimize(loss, np.zeros(terms.shape[1]), jac=True, hess=hess, method="trust-exact", options={"gtol": 1e-6})
    return expit(terms @ fit.x + prior)


def expected_confusion(calls: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """f64[v, s, 2, 2]: counts to expect of sets with calls bool[s, m], if points are ground with probability f32[v, m]."""
    kept = (calls.astype(np.float32) @ ground.T).astype(np.float64).T
    passed = calls.sum(axis=1) - kept
    is_ground = ground.sum(axis=1, dtype=np.float64)[:, None]
    first = np.stack([kept, is_ground - kept], axis=-1)
    second = np.stack([passed, calls.shape[1] - is_ground - passed], axis=-1)
    return np.stack([first, second], axis=-2)


def _evenly(index: np.ndarray, most: int) -> np.ndarray:
    """At most so many, at equal distances."""
    return index[np.linspace(0, len(index) - 1, most).round().astype(np.int64)] if len(index) > most else index


def _unpacked(bits: np.ndarray, columns: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """First row and bool[r, len(columns)], some sets at a time."""
    for start in range(0, len(bits), _SETS):
        yield start, np.unpackbits(bits[start : start + _SETS], axis=1)[:, columns].astype(bool)
