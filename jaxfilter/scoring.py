"""Scores of a ground labelling against a reference, as the filtering literature defines them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from .core.cloud import QUANTUM, PointCloud
from .core.errors import InputError
from .core.inputs import GROUND_CLASS, class_numbers, is_laspy
from .core.result import Decision, FilterResult

NEVER_CLASSIFIED = 0
"""The ASPRS class of points that nobody has classified."""


@dataclasses.dataclass(frozen=True, eq=False)
class Scores:
    """Errors and agreement in percent. A figure whose denominator is zero is NaN.

    With a = ground labelled ground, b = ground labelled object, c = object labelled ground, d = object labelled object
    and e = a + b + c + d (Li et al. 2021, Table II):

    Attributes:
        type1: Type I error, ground lost: b / (a + b).
        type2: Type II error, objects accepted: c / (c + d).
        total: total error: (b + c) / e.
        kappa: Cohen's kappa: (Po - Pe) / (1 - Pe), Po = (a + d) / e, Pe = ((a + b)(a + c) + (c + d)(b + d)) / e^2.
        accuracy: (a + d) / e.
        precision: a / (a + c), for ground.
        recall: a / (a + b), for ground; 100 - type1.
        f1: 2a / (2a + b + c), for ground.
        confusion: i64[2, 2] = [[a, b], [c, d]]; rows reference ground and object, columns labelled ground and object.

    >>> scores = jf.Scores.from_confusion([[90, 10], [5, 95]])
    >>> print(scores)
    Type I 10.00   Type II 5.00   total 7.50   kappa 85.00   F1 92.31  (percent)
                        as ground  as object
    reference ground           90         10
    reference object            5         95
    """

    type1: float
    type2: float
    total: float
    kappa: float
    accuracy: float
    precision: float
    recall: float
    f1: float
    confusion: np.ndarray

    @classmethod
    def from_confusion(cls, confusion: Any) -> Scores:
        """Scores of a 2 x 2 matrix of counts laid out as ``confusion`` is. Raises InputError.

        >>> jf.Scores.from_confusion([[90, 10], [5, 95]]).total
        7.5
        """
        matrix = np.asarray(confusion)
        if matrix.shape != (2, 2) or not np.issubdtype(matrix.dtype, np.integer) or (matrix < 0).any():
            raise InputError(f"confusion must hold 2 x 2 counts, not {matrix.dtype} of shape {matrix.shape}")
        (a, b), (c, d) = matrix.tolist()  # Python integers: products of counts do not overflow
        e = a + b + c + d
        by_chance = (a + b) * (a + c) + (c + d) * (b + d)
        return cls(
            type1=_percent(b, a + b),
            type2=_percent(c, c + d),
            total=_percent(b + c, e),
            kappa=_percent(e * (a + d) - by_chance, e * e - by_chance),
            accuracy=_percent(a + d, e),
            precision=_percent(a, a + c),
            recall=_percent(a, a + b),
            f1=_percent(2 * a, 2 * a + b + c),
            confusion=matrix.astype(np.int64),
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain Python numbers by name, ``confusion`` as nested lists; ready for JSON but for NaN.

        >>> jf.Scores.from_confusion([[90, 10], [5, 95]]).as_dict()["type1"]
        10.0
        """
        figures = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        return figures | {"confusion": self.confusion.tolist()}

    def __str__(self) -> str:
        (a, b), (c, d) = self.confusion.tolist()
        width = max(len(f"{v:,}") for v in (a, b, c, d, 100_000))
        return "\n".join(
            [
                f"Type I {_two(self.type1)}   Type II {_two(self.type2)}   total {_two(self.total)}   "
                f"kappa {_two(self.kappa)}   F1 {_two(self.f1)}  (percent)",
                f"{'':18}{'as ground':>{width + 4}}{'as object':>{width + 4}}",
                f"{'reference ground':18}{a:>{width + 4},}{b:>{width + 4},}",
                f"{'reference object':18}{c:>{width + 4},}{d:>{width + 4},}",
            ]
        )


def _percent(numerator: int, denominator: int) -> float:
    return 100 * numerator / denominator if denominator else math.nan


def _two(value: float) -> str:
    return "undefined" if math.isnan(value) else f"{value:.2f}"


def evaluate(
    result: FilterResult | np.ndarray,
    reference: PointCloud | np.ndarray | None,
    *,
    ignore: np.ndarray | None = None,
    classes: np.ndarray | None = None,
    ignore_classes: Iterable[int] = (),
    candidates_only: bool = False,
) -> Scores:
    """Compare ground labels with reference labels, point by point.

    Args:
        result: a FilterResult, or bool[n] with True = ground.
        reference: bool[n] with True = ground; or integers with 1 = ground, 0 = object, -1 = unlabelled; or a PointCloud
            with reference labels, or a ``laspy.LasData`` with points of class 2. If labels come from classes, points of
            class 0 (never classified) are unlabelled.
        ignore: bool[n]; True leaves a point out.
        classes: int[n], ASPRS classes that ``ignore_classes`` refers to; by default those of a reference PointCloud.
        ignore_classes: points of these classes are left out.
        candidates_only: leave out the points that the filter had set aside (a FilterResult knows them; else the
            ``candidate`` array of a reference PointCloud decides).

    Returns: Scores. Unlabelled points never count.
    Raises: InputError for a missing reference, or for arrays of the wrong length or dtype.

    >>> jf.evaluate(np.array([True, True, False]), np.array([True, False, False])).type2
    50.0
    >>> jf.evaluate(result, cloud, candidates_only=True).kappa > 80
    True
    """
    for name, given in {"result": result, "reference": reference, "ignore": ignore, "classes": classes}.items():
        if np.ma.is_masked(given):
            raise InputError(f"{name} has masked entries; give them values, and leave their points out by ignore=")
    ground = result.ground if isinstance(result, FilterResult) else np.asarray(result)
    if ground.ndim != 1 or ground.dtype != bool:
        raise InputError(f"result must be a FilterResult or bool[n] (True = ground), not {_describe(ground)}")
    n = len(ground)
    if is_laspy(reference):
        reference = PointCloud.from_laspy(reference, units="m")  # units do not matter here
    truth, counted = reference_labels(reference)
    if len(truth) != n:
        raise InputError(f"reference has {len(truth)} labels for the {n} points of the result: use the same points")
    if ignore is not None:
        ignore = np.asarray(ignore)
        if ignore.shape != (n,) or ignore.dtype != bool:
            raise InputError(f"ignore must be bool[{n}], not {_describe(ignore)}")
        counted = counted & ~ignore
    if ignored := class_numbers(ignore_classes):
        if classes is None and isinstance(reference, PointCloud):
            classes = reference.classification
        if classes is None:
            raise InputError("ignore_classes needs classes: pass classes=, or a reference PointCloud that has them")
        classes = np.asarray(classes)
        if classes.shape != (n,) or not np.issubdtype(classes.dtype, np.integer):
            raise InputError(f"classes must be int[{n}], not {_describe(classes)}")
        counted = counted & ~np.isin(classes, ignored)
    if candidates_only:
        if isinstance(result, FilterResult):
            counted = counted & (result.decision != Decision.SET_ASIDE)
        elif isinstance(reference, PointCloud):
            counted = counted & reference.candidate
        else:
            raise InputError("candidates_only needs a FilterResult as result or a PointCloud as reference")
    rows = (truth & counted, ~truth & counted)
    return Scores.from_confusion([[np.count_nonzero(row & one) for one in (ground, ~ground)] for row in rows])


def match_points(
    cloud: PointCloud, reference: PointCloud, names: tuple[str, str] = ("cloud", "reference")
) -> np.ndarray:
    """i64[n] such that ``reference.xyz[match]`` are the points of ``cloud``, whatever the order of either.

    Points are the same if all coordinates agree to the quantum of the local frame (about 1 mm). Points with identical
    coordinates are matched in the order in which they stand in each cloud.

    Raises: InputError, with ``names`` in the message, when the two do not hold the same points.
    """
    n, m = len(cloud), len(reference)
    if n != m:
        raise InputError(f"{names[0]} has {n} points and {names[1]} has {m}: they must hold the same points")
    if n == 0:
        return np.zeros(0, np.int64)
    shift = np.rint((cloud.origin - reference.origin) * reference.units.factor / QUANTUM) * QUANTUM
    ours, theirs = cloud.xyz + shift, reference.xyz.astype(np.float64)
    if np.array_equal(ours, theirs):
        return np.arange(n)
    order, target = np.lexsort(ours.T), np.lexsort(theirs.T)
    differs = (ours[order] != theirs[target]).any(axis=1)
    if differs.any():
        x, y, z = cloud.coordinates()[order[np.argmax(differs)]]
        place = f"({x:.3f}, {y:.3f}, {z:.3f})"
        raise InputError(f"{names[0]} and {names[1]} do not hold the same points: they differ near {place}")
    match = np.empty(n, np.int64)
    match[order] = target
    return match


def reference_labels(reference: PointCloud | np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """bool[n] truth and bool[n] whether there is one."""
    if isinstance(reference, PointCloud):
        if reference.reference is None:
            raise InputError("reference: the cloud has no reference labels (a label column, or points of class 2)")
        truth, classes = reference.reference, reference.classification
        if classes is not None and truth.any() and np.array_equal(truth, classes == GROUND_CLASS):
            return truth, classes != NEVER_CLASSIFIED
        return truth, np.ones(len(truth), bool)
    if reference is None:
        raise InputError("reference is None: the cloud that it was taken from has no reference labels")
    if np.ma.is_masked(reference):
        raise InputError("reference: some labels are masked: pass integers, with -1 for points without a label")
    truth = np.asarray(reference)
    if truth.ndim == 1 and truth.dtype == bool:
        return truth, np.ones(len(truth), bool)
    if truth.ndim != 1 or not np.issubdtype(truth.dtype, np.integer):
        raise InputError(f"reference must be bool[n], or integers 1, 0 and -1, not {_describe(truth)}")
    strange = np.setdiff1d(truth, (-1, 0, 1))
    if len(strange):
        raise InputError(f"reference holds {strange[:5].tolist()}: use 1 = ground, 0 = object, -1 = unlabelled")
    return truth == 1, truth >= 0


def _describe(values: np.ndarray) -> str:
    return f"{values.dtype} of shape {values.shape}"
