"""What needs the labels of the cloud that is classified: for studies of what printed figures rest on, no way to filter."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np

import jaxfilter as jf
from jaxfilter.core.compilation import bucket
from jaxfilter.core.points import canonical_points


def without_labelled_objects(cloud: jf.PointCloud, share: float, key: jax.Array) -> jf.PointCloud:
    """The cloud with a share (0 to 1) of its objects, by its reference labels, set aside at random.

    Which ones depends on ``key`` and on the coordinates, not on the order of the points. Points that coincide go
    together, and stay if one of them is ground. Raises: ValueError without reference labels, or for another share.
    """
    if cloud.reference is None:
        raise ValueError("without_labelled_objects: the cloud has no reference labels; read one that has")
    if not 0 <= share <= 1:
        raise ValueError(f"share={share!r}: must be from 0 to 1")
    points = canonical_points(cloud)
    is_object = np.ones(len(points), bool)
    is_object[points.member[cloud.reference[points.index]]] = False
    objects = np.flatnonzero(is_object)
    draw = np.asarray(jax.random.uniform(key, (bucket(len(points)),)))[objects]
    removed = np.zeros(len(points), bool)
    removed[objects[np.argsort(draw, kind="stable")[: round(share * len(objects))]]] = True
    candidate = cloud.candidate.copy()
    candidate[points.index[removed[points.member]]] = False
    return dataclasses.replace(cloud, candidate=candidate)
