"""Runs of the filters on the ISPRS clouds, one row of figures each."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np

import jaxfilter as jf
from experiments.isprs import samples
from experiments.report import Row
from jaxfilter.core.points import canonical_points
from jaxfilter.stages.outliers import radius_outliers


def methods() -> dict[str, Callable[[str], jf.Filter]]:
    """What is compared: by name, the filter for a cloud such as "samp11".

    ``fptd``, ``ptd``: ours, thresholds of the cloud's terrain class. ``fptd_independent``: the same in the blocks of the
    paper. ``fptd_paper``: as printed, with nothing in place of the manual removal of low outliers. ``ptd_static``: border
    points keep their first elevation. ``smrf``: one set for all; ``smrf_oracle``: the set per sample that Pingel et al.
    chose on the labels.
    """
    terrain = samples.terrain_classes()
    oracle = samples.oracle_parameters()
    return {
        "fptd": lambda name: jf.FPTD.preset(terrain[name]),
        "fptd_independent": lambda name: jf.FPTD.preset(terrain[name], blocks="independent"),
        "fptd_paper": lambda name: jf.FPTD.preset("paper", **jf.FPTD.PRESETS[terrain[name]]),
        "ptd": lambda name: jf.PTD.preset(terrain[name]),
        "ptd_static": lambda name: jf.PTD.preset(terrain[name], refresh_border=False),
        "smrf": lambda name: jf.SMRF(cell=1.0, slope=0.15, window=18.0, threshold=0.5, scaling=1.25),
        "smrf_oracle": lambda name: jf.SMRF(cell=1.0, **oracle[name]),
    }


def timed(filter_: jf.Filter, cloud: jf.PointCloud, repeats: int) -> tuple[jf.FilterResult, float, float]:
    """The result, the seconds of a first call, and the median seconds of ``repeats`` calls after it."""
    start = time.perf_counter()
    result = filter_(cloud)
    first = time.perf_counter() - start
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = filter_(cloud)
        seconds.append(time.perf_counter() - start)
    return result, first, statistics.median(seconds)


def sample_row(name: str, method: str, filter_: jf.Filter, cloud: jf.PointCloud, repeats: int) -> tuple[Row, jf.FilterResult]:
    """Scores against the reference over all points, and seconds."""
    result, first, seconds = timed(filter_, cloud, repeats)
    scores = jf.evaluate(result, cloud.reference)
    row = {
        "sample": name,
        "method": method,
        "terrain": samples.terrain_classes()[name],
        "points": len(cloud),
        "type1": scores.type1,
        "type2": scores.type2,
        "total": scores.total,
        "kappa": scores.kappa,
        "seconds": seconds,
        "first_call_seconds": first,
        "status": result.status.name,
    }
    for key in ("seeds", "border_points", "rounds"):
        row[key] = result.info.get(key)
    return row, result


def outlier_row(name: str, cloud: jf.PointCloud, result: jf.FilterResult) -> Row:
    """What FPTD barred from its seeds without labels, and how much of it the reference calls ground.

    Beside it the paper's radius filter (r = 5 m, n = 10), which is off in our presets. Labels serve the counts only.
    """
    points = canonical_points(cloud)
    sparse = np.zeros(len(cloud), bool)
    sparse[points.index] = radius_outliers(points.xyz, points.weight, 5.0, 10)[points.member]
    truth, barred = cloud.reference, result.barred
    return {
        "sample": name,
        "barred": int(barred.sum()),
        "barred_ground": int((barred & truth).sum()),
        "barred_ground_kept": int((barred & truth & result.ground).sum()),
        "barred_object_accepted": int((barred & ~truth & result.ground).sum()),
        "radius": int(sparse.sum()),
        "radius_ground": int((sparse & truth).sum()),
        "radius_ground_share": 100 * float((sparse & truth).sum() / truth.sum()),
    }


def site_row(site: str, file: str, filter_: jf.Filter, cloud: jf.PointCloud, repeats: int) -> tuple[Row, jf.FilterResult]:
    """Points, ground points and seconds."""
    result, first, seconds = timed(filter_, cloud, repeats)
    row = {
        "site": site,
        "file": file,
        "terrain": samples.terrain_classes()[site],
        "points": len(cloud),
        "ground": int(result.ground.sum()),
        "barred": int(result.barred.sum()),
        "seconds": seconds,
        "first_call_seconds": first,
        "status": result.status.name,
    }
    return row, result
