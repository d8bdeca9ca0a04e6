"""Batches: what clouds are, with their reference labels, in padded blocks on the device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..core.errors import InputError, ParameterError, check_whole
from ..core.filter import degenerate, watch
from ..core.params import declared
from ..scoring import reference_labels
from ..steps.batch import Batch, stack_clouds
from ..steps.grid_filter import GridFilter
from .labels import named_labels
from .ranges import check_filter
from .sweep import named_clouds


def batch(clouds: Any, filter_: Any, labels: Any = None, *, blocks: int = 6) -> Batch:
    """Clouds of any sizes in padded blocks, for a method on a grid: SMRF, PMF on a grid, or MSF.

    Args:
        clouds: a sequence of clouds, or a mapping from names to them; what a filter takes.
        filter_: fixes cells and other static fields.
        labels: reference labels, a sequence or mapping like the clouds: bool[n] (True = ground), or integers with 1 = ground,
            0 = object, -1 = unlabelled. By default those of the clouds.
        blocks: how many there are at most, unless clouds of very unlike size need more. Clouds share a block where that adds
            few empty cells; each block is compiled for itself.

    Returns: Batch. Raises: ParameterError for another method; InputError for a cloud without anything to filter, and for labels
        that do not fit.

    >>> batch = jf.batch([cloud, cloud.coordinates()[:2000]], jf.SMRF(), blocks=1)
    >>> len(batch), [block.xyz.shape[0] for block in batch.blocks]
    (2, [2])
    """
    filter_ = check_filter(filter_)
    if not isinstance(filter_, GridFilter):
        raise ParameterError(
            f"batch: {type(filter_).__name__}: methods on a grid take batches (SMRF, PMF, MSF); use jf.sweep"
        )
    check_whole(blocks=blocks)
    several, named = named_clouds(clouds, "batch")
    names = tuple(named) if isinstance(clouds, Mapping) else None
    given = None if labels is None else named_labels(labels, several, named, "batch")
    taken, ready, (one, read) = [], [], watch(filter_)
    for name, cloud in named.items():
        points = filter_.points_of(cloud)
        if degenerate(cloud, points) is not None:
            raise InputError(f"batch: {name}: {cloud!r}: there is nothing to filter; leave the cloud out")
        truth, counted = np.zeros(len(cloud), bool), np.zeros(len(cloud), bool)
        if given is not None or cloud.reference is not None:
            truth, counted = reference_labels(cloud if given is None else given[name])
        if len(truth) != len(cloud):
            raise InputError(f"batch: {name}: {len(truth)} labels for {len(cloud)} points")
        totals = np.array([(counted & truth).sum(), (counted & ~truth).sum()], np.int32)
        taken.append(points)
        ready.append((one.cells(points), points.xyz, points.gather(truth), points.gather(counted), totals))
    if wrong := [field.name for field in declared(one) if field.name in read and not field.metadata["static"]]:
        raise ParameterError(f"batch: the cells of {type(one).__name__} depend on {wrong[0]!r}: declare it as static")
    return stack_clouds(filter_, taken, ready, names, blocks)
