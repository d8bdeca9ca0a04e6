"""Labels from elsewhere: of all points for comparisons and batches; for calibration also of some points, and within patches."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.cloud import GROUND_CLASS, PointCloud
from ..core.errors import DAMAGED_ARRAYS, InputError
from ..core.reading import Bounds, inside
from ..core.result import FilterResult
from ..core.units import Units
from ..engines.neighbours import nearest, tree_of
from ..files.reading import read
from ..files.writing import CLOUD_SUFFIXES
from ..scoring import NEVER_CLASSIFIED, match_points

SAME = 0.01
"""Metres: points of two files that are so near to each other are one point (text is often rounded to centimetres)."""
UNLABELLED = -1


def are_labels(given: Any) -> bool:
    """Whether this is something that :func:`ground_labels` takes."""
    if isinstance(given, str):
        return Path(given).suffix.lower() in (".npy", ".npz", *CLOUD_SUFFIXES)
    return isinstance(given, (os.PathLike, FilterResult, PointCloud)) or hasattr(given, "__array__")


def ground_labels(given: Any, cloud: PointCloud, name: str) -> np.ndarray:
    """bool[n]: the points of a cloud that are ground by labels from elsewhere.

    Args:
        given: an array [n] in the order of the cloud: True or 1 = ground, False or 0 = object, and numbers between are scores, of
            which those of 0.5 and more are ground; a FilterResult; a PointCloud with labels, in any order; or a file: ``.npy`` of
            an array, ``.npz`` by ``FilterResult.save``, or whatever :func:`jaxfilter.read` reads.
        name: what they are, in error messages.

    Raises: InputError for another number of points, for other points, and for values that are no labels.
    """
    if isinstance(given, (str, os.PathLike)):
        given = _read(Path(given), cloud.units)
    if isinstance(given, PointCloud):
        ground = point_labels(given, (), name) == 1
        return ground[match_points(cloud, given, ("the cloud", name))]
    values: Any = np.ma.asarray(given.ground if isinstance(given, FilterResult) else given)
    if values.shape != (len(cloud),) or values.dtype.kind not in "biuf":
        found = f"{values.dtype}{list(values.shape)}"
        raise InputError(f"{name}: labels {found} for {len(cloud)} points: one number or bool for each is needed")
    values = np.ma.filled(values.astype(np.float64), np.nan)
    if (wrong := ~((values >= 0) & (values <= 1))).any():
        advice = "use 1 = ground, 0 = object, or a score from 0 to 1; of classes pass classes == 2"
        raise InputError(f"{name}: the label of point {wrong.argmax()} is {values[wrong][0]:g}: {advice}")
    return np.asarray(values >= 0.5)


def _read(path: Path, units: Units) -> Any:
    """Labels of a file. Raises: InputError."""
    if path.suffix.lower() == ".npz":
        return FilterResult.load(path)
    if path.suffix.lower() != ".npy":
        return read(path, units=units)
    try:
        return np.load(path)
    except DAMAGED_ARRAYS as error:
        raise InputError(f"{path}: cannot be read as an array of labels ({error})") from error


def named_labels(labels: Any, several: bool, named: Iterable[str], caller: str) -> dict[str, Any]:
    """The labels of each cloud by its name. They are given as a mapping, as a sequence like the clouds, or as those of one cloud.

    Raises: InputError for another number, and for names of no cloud.
    """
    names = list(named)
    if isinstance(labels, Mapping):
        found = {str(name): its for name, its in labels.items()}
    else:
        its = list(labels) if several or np.ndim(labels) != 1 else [labels]
        if len(its) != len(names):
            raise InputError(
                f"{caller}: there are {len(names)} clouds and labels of {len(its)}: give those of each cloud"
            )
        found = dict(zip(names, its, strict=True))
    if other := set(names) ^ set(found):
        what = "has no labels" if min(other) in names else "is no cloud"
        raise InputError(f"{caller}: labels: {min(other)} {what}: give those of every cloud, by its name")
    return found


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
