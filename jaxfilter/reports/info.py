"""What is in a file of points, for people and for JSON."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ..core.cloud import PointCloud
from ..core.frame import ends
from ..core.points import canonical_points
from ..core.reading import Reading
from ..core.units import Reference, Units
from ..files.reading import LasFile, open_points, warn_if_empty
from ..files.storage import Remote, place_of


def info(path: str | Path | Remote, *, units: str | Units | None = None, crs: Any = None) -> dict[str, Any]:
    """What is in a file, for people and for JSON; angular, geocentric and far-off coordinates are no error here.

    ``units``, ``crs``: as of :func:`read`.

    Returns: ``path``, ``format``, ``points``, ``crs``, ``units``, ``metres_per_unit`` [XY, Z], ``bounds`` and ``z``
    (file units, to 1 mm), ``scales`` and ``offsets`` (LAS), ``extra_bytes`` (names of extra dimensions), ``classes`` and
    ``echoes`` (counts), ``withheld``, ``overlap``, ``candidates``, and of the candidates ``spacing`` (m) and ``density``
    (per m2 of occupied area). None where a file says nothing.

    >>> facts = jf.info("scene.laz", units="m")
    >>> facts["points"] == len(cloud), facts["format"]
    (True, 'LAZ 1.4, point format 6')
    """
    place, reading = place_of(path), Reading(drop_invalid=True, units=units, crs=crs)
    file = open_points(place, reading)
    header, reference = (file.header, file.reference) if isinstance(file, LasFile) else (None, Reference())
    reference = reading.stated.of(reference, str(place))
    if angular := reference.problem is not None:
        reading = dataclasses.replace(reading, units=Units(1.0, 1.0, reference.shown))
    cloud = warn_if_empty(place, file.cloud(reading, strict=False), None)
    corners = None
    if len(cloud):
        corners = np.round(dataclasses.replace(cloud, xyz=np.stack(ends(cloud.xyz))).coordinates(), 3)
    points = canonical_points(cloud)
    extra = None if header is None else header.extra_dimensions()
    spacing = None if angular or len(points) < 2 else points.spacing()
    return {
        "path": str(place),
        "format": cloud.source.format,
        "points": len(cloud),
        "crs": None if reference.crs is None else reference.crs.name,
        "units": str(cloud.units),
        "metres_per_unit": None if angular else [cloud.units.xy, cloud.units.z],
        "bounds": None if corners is None else corners[:, :2].ravel().tolist(),
        "z": None if corners is None else corners[:, 2].tolist(),
        "scales": None if header is None else header.scales.tolist(),
        "offsets": None if header is None else header.offsets.tolist(),
        "extra_bytes": None if extra is None else [dimension.name for dimension in extra],
        "classes": _counts(cloud.classification),
        "echoes": _echo_counts(cloud),
        "withheld": None if cloud.withheld is None else int(cloud.withheld.sum()),
        "overlap": None if cloud.in_overlap is None else int(cloud.in_overlap.sum()),
        "candidates": int(cloud.candidate.sum()),
        "spacing": spacing,
        "density": None if spacing is None else 1 / spacing**2,
    }


def _counts(values: np.ndarray | None) -> dict[int, int] | None:
    if values is None:
        return None
    return dict(zip(*(part.tolist() for part in np.unique(values, return_counts=True)), strict=True))


def _echo_counts(cloud: PointCloud) -> dict[str, int] | None:
    number, total = cloud.return_number, cloud.number_of_returns
    if number is None or total is None:
        return None
    several = total > 1
    counts = {
        "only": int(((total == 1) & (number == 1)).sum()),
        "first": int((several & (number == 1)).sum()),
        "intermediate": int((several & (number > 1) & (number < total)).sum()),
        "last": int((several & (number == total)).sum()),
    }
    return {**counts, "odd": len(cloud) - sum(counts.values())}
