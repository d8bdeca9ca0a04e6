"""Timed runs of the filters, one row of figures each."""

from __future__ import annotations

import numpy as np

import jaxfilter as jf
from experiments.isprs import protocols, samples, search
from experiments.report import Row, machine
from jaxfilter.sweeps.comparison import timed


def sample_row(
    name: str, method: str, filter_: jf.Filter, cloud: jf.PointCloud, repeats: int
) -> tuple[Row, jf.FilterResult]:
    """Scores against the reference over all points, seconds, and how much of the ground was barred from the seeds."""
    result, first, seconds = timed(filter_, cloud, repeats)
    counts = jf.evaluate(result, cloud.reference).confusion.ravel().tolist()
    row: Row = {"sample": name, "method": method, "terrain": samples.terrain_classes().get(name), "points": len(cloud)}
    row |= dict(zip(search.COUNTS, counts, strict=True))
    row |= protocols.scores(row) | {"seconds": seconds, "first_call_seconds": first, "status": result.status.name}
    row |= {key: result.info.get(key) for key in ("seeds", "border_points", "rounds")}
    row["barred"] = int(result.barred.sum())
    row["barred_ground"] = int((result.barred & cloud.reference).sum())
    row["barred_ground_kept"] = int((result.barred & cloud.reference & result.ground).sum())
    return row | {"parameters": search.digest(filter_), "machine": machine()}, result


def failed_row(name: str, method: str, cloud: jf.PointCloud, error: Exception) -> Row:
    """What stands in the table for a filter that gave no labels."""
    row: Row = {"sample": name, "method": method, "terrain": samples.terrain_classes().get(name), "points": len(cloud)}
    return row | dict.fromkeys(protocols.SCORES, np.nan) | {"status": f"{type(error).__name__}: {error}"[:200]}
