"""What needs the labels of the cloud that is classified: for studies of what printed figures rest on, no way to filter."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxfilter as jf
from experiments.report import read_csv
from jaxfilter.core.compilation import bucket
from jaxfilter.core.points import canonical_points

TUNED = {(row.pop("method"), row.pop("sample")): row for row in read_csv(Path(__file__).with_suffix(".csv"))}
"""What authors chose for each ISPRS sample on its labels, by method and sample: fields and their values, "" for none.

SMRF: the optima of Pingel et al. (2013). AGPTD: Zheng et al. (2024), Table 1, ``seed_cell`` by the number of seeds in Table 4,
``radius`` by section 3.1.1. STIN, ATIN, IPTD: Uray and Varlik (2024), Table 2."""
UNLIKE_PAPER: dict[str, dict[str, Any]] = {
    "agptd": {"outlier_fate": "barred"},
    "stin": {"outlier_fate": "barred", "mirror": "off"},
    "atin": {"mirror": "off"},
    "iptd": {"cell": 1.0, "vertex_spacing": 2.0, "translation": "none", "low_clusters": True},
}
"""Fields in which all samples differ from the preset "paper" of the method."""


def tuned(method: str, sample: str, **changes: Any) -> Any:
    """A method as its authors tuned it to a sample such as "samp11", on its labels: no setting to expect on other data.
    ``changes`` come on top. Raises: KeyError for a method or a sample that has none."""
    chosen = {name: value for name, value in TUNED[method, sample].items() if value != ""}
    return jf.FILTERS[method].preset("paper", **UNLIKE_PAPER.get(method, {}) | chosen | changes)


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
