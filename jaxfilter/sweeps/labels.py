"""Labels for calibration: from classes, from a file with some of the points, within patches."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ..core.cloud import GROUND_CLASS, PointCloud
from ..core.errors import InputError
from ..core.reading import Bounds, inside
from ..engines.neighbours import nearest, tree_of
from ..scoring import NEVER_CLASSIFIED

SAME = 0.01
"""Metres: points of two files that are so near to each other are one point (text is often rounded to centimetres)."""
UNLABELLED = -1


def point_labels(cloud: PointCloud, unlabelled: Iterable[int] = (NEVER_CLASSIFIED,), name: str = "cloud") -> np.ndarray:
    """i8[n]: 1 = ground, 0 = object, -1 = unlabelled, as a cloud says of its own points.

    Class 2 is ground, the ``unlabelled`` classes say nothing, all others are objects. Labels of text are all taken.
    Raises: InputError if there are neither classes nor labels.
    """
    classes, truth = cloud.classification, cloud.reference
    if classes is None and truth is None:
        raise InputError(f"{name} has neither classes nor labels: give labels in a file of their own")
    if truth is None or (classes is not None and np.array_equal(truth, classes == GROUND_CLASS)):
        assert classes is not None
        known = ~np.isin(classes, tuple(unlabelled))
        return np.where(known, classes == GROUND_CLASS, UNLABELLED).astype(np.int8)
    return truth.astype(np.int8)


def labels_from(
    cloud: PointCloud, labelled: PointCloud, labels: np.ndarray, name: str = "labels", workers: int | None = None
) -> np.ndarray:
    """i8[n]: the labels of some of a cloud's points, from another cloud that holds these, in any order.

    Args:
        cloud: n points.
        labelled: m of these points, to within :data:`SAME`.
        labels: i8[m], see :func:`point_labels`.

    A position that has both labels is unlabelled. Raises: InputError if a labelled point is not in the cloud.
    """
    metres, known = cloud.units.factor, labels != UNLABELLED
    place = (labelled.origin - cloud.origin) * metres + labelled.xyz[known]
    out = np.full(len(cloud), UNLABELLED, np.int8)
    if not known.any():
        return out
    xyz, row = np.unique(place, axis=0, return_inverse=True)
    counts = np.zeros((len(xyz), 2), np.int64)
    np.add.at(counts, (row.ravel(), labels[known]), 1)
    of_place = np.where(counts.all(axis=1), UNLABELLED, counts[:, 1] > 0).astype(np.int8)
    distance, near = (found[:, 0] for found in nearest(tree_of(xyz), cloud.xyz, 1, SAME, workers))
    hit = np.isfinite(distance)
    out[hit] = of_place[near[hit]]
    absent = np.setdiff1d(np.arange(len(xyz)), near[hit])
    if len(absent):
        distance = nearest(tree_of(cloud.xyz), xyz[absent], 1, SAME, workers)[0][:, 0]
        absent = absent[~np.isfinite(distance)]
    if len(absent):
        x, y, z = cloud.origin + xyz[absent[0]] / metres
        missing = f"{len(absent)} of {len(xyz)} labelled points are not in the cloud"
        raise InputError(f"{name}: {missing}, the first near ({x:.3f}, {y:.3f}, {z:.3f}); label points of the cloud")
    return out


def within(cloud: PointCloud, patches: Sequence[Bounds], labels: np.ndarray) -> np.ndarray:
    """i8[n]: the labels inside any of some patches, in file units; the others are dropped.

    Raises: InputError naming a patch without a labelled point.
    """
    xy, kept = cloud.coordinates(), np.zeros(len(cloud), bool)
    for patch in patches:
        here = inside(xy, patch)
        if not (here & (labels != UNLABELLED)).any():
            raise InputError(f"bounds {' '.join(f'{v:.10g}' for v in patch)}: no labelled point lies within")
        kept |= here
    return np.where(kept, labels, UNLABELLED).astype(np.int8)
