"""Which sets of parameters a sweep runs: a full grid, a random or Sobol design, or a list."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..core.errors import ParameterError, check_choice, check_whole
from ..core.filter import Filter, group_equal
from ..core.params import is_number
from .ranges import check_filter, fields_of

MAX_SETS = 1_000_000
DESIGNS = ("grid", "random", "sobol", "list")
"""All combinations; independent draws; a low-discrepancy sequence; the i-th value of every axis together."""


@dataclasses.dataclass(frozen=True)
class Design:
    """The sets of a sweep.

    Attributes:
        kind: one of :data:`DESIGNS`.
        axes: values by field. For a grid those along each dimension, else one per set.
        sets: field values of every set; for a grid the last axis varies fastest.
        filters: the filter with each of them.
        groups: numbers of the sets that differ in traced fields only, in the order in which the groups first occur.
    """

    kind: str
    axes: dict[str, list[Any]]
    sets: list[dict[str, Any]]
    filters: list[Filter]
    groups: list[list[int]]


def make_design(
    filter_: Filter, axes: Mapping[str, Any], design: str = "grid", size: int | None = None, seed: int = 0
) -> Design:
    """Check the axes and lay out the sets; arguments as for :func:`jaxfilter.sweep`.

    Raises: ParameterError naming the axis and what is wrong, before anything is computed.
    """
    filter_ = check_filter(filter_)
    check_choice(DESIGNS, design=design)
    if not isinstance(axes, Mapping) or not axes:
        raise ParameterError(f"axes={axes!r}: map at least one field of {type(filter_).__name__} to its values")
    drawn = design in ("random", "sobol")
    if not drawn and size is not None:
        raise ParameterError(f"size={size!r}: only random and sobol designs have one; a {design} follows from its axes")
    check_whole(0, seed=seed)
    fields = fields_of(filter_, axes)
    if drawn:
        check_whole(1, MAX_SETS, size=size)
        columns = _drawn(filter_, fields, axes, design, int(size or 0), seed)
    else:
        columns = {name: _values(name, values) for name, values in axes.items()}
    if design == "grid":
        if (count := math.prod(map(len, columns.values()))) > MAX_SETS:
            raise ParameterError(f"axes: {count:,} sets, more than {MAX_SETS:,}: pass fewer values, or design='sobol'")
        for name, values in columns.items():
            if len(set(map(repr, values))) < len(values):
                raise ParameterError(f"axes: {name}={values!r} repeats a value")
    else:
        lengths = {name: len(values) for name, values in columns.items()}
        if len(set(lengths.values())) > 1:
            raise ParameterError(f"axes: all axes of a list need as many values, not {lengths}")
    rows = itertools.product(*columns.values()) if design == "grid" else zip(*columns.values(), strict=True)
    sets = [dict(zip(columns, values, strict=True)) for values in rows]
    filters = [filter_.replace(**one) for one in sets]  # raises ParameterError, naming field and value
    statics = [name for name in columns if fields[name].metadata["static"]]
    groups = group_equal(tuple(one[name] for name in statics) for one in sets)
    return Design(design, columns, sets, filters, groups)


def _values(name: str, values: Any) -> list[Any]:
    if hasattr(values, "__array__"):
        values = np.asarray(values)
    listed = isinstance(values, Sequence) or (isinstance(values, np.ndarray) and values.ndim > 0)
    if isinstance(values, (str, bytes)) or not listed:
        raise ParameterError(f"axes: {name}={values!r}: give a list of values")
    if len(values) == 0:
        raise ParameterError(f"axes: {name} is empty")
    out = [value.item() if isinstance(value, np.generic) else value for value in values]
    for value in out:
        if isinstance(value, float) and math.isnan(value):
            raise ParameterError(f"axes: {name}={out!r} holds NaN")
        names = isinstance(value, tuple) and all(isinstance(one, str) for one in value)
        if isinstance(value, (list, tuple, dict, np.ndarray)) and not names:
            raise ParameterError(f"axes: {name}={out!r}: values must be plain numbers or words, in one dimension")
    return out


def _drawn(
    filter_: Filter, fields: Mapping[str, Any], axes: Mapping[str, Any], kind: str, size: int, seed: int
) -> dict[str, list[Any]]:
    """Values of every set: a tuple of two numbers is a range, a list the values to choose from."""
    shape = size, len(axes)
    unit = sobol(*shape, seed) if kind == "sobol" else np.random.default_rng(seed).random(shape)
    columns: dict[str, list[Any]] = {}
    for (name, given), u in zip(axes.items(), unit.T, strict=True):
        values = _values(name, given)
        meta = fields[name].metadata
        pair = isinstance(given, tuple) and len(values) == 2 and all(map(is_number, values))
        if not pair or meta.get("choices"):
            columns[name] = [values[i] for i in np.minimum((u * len(values)).astype(int), len(values) - 1)]
            continue
        low, high = values
        for bound in values:
            filter_.replace(**{name: bound})
        if not low < high:
            raise ParameterError(f"axes: {name}={values!r}: the range must go from low to high")
        whole = isinstance(low, int) and isinstance(high, int) and isinstance(fields[name].default, int)
        drawn = np.minimum(low + np.floor(u * (high - low + 1)), high).astype(int) if whole else low + u * (high - low)
        columns[name] = drawn.tolist()
    return columns


def sobol(size: int, dimensions: int, seed: Any) -> np.ndarray:
    """f64[size, dimensions]: the first points of a scrambled Sobol sequence."""
    from scipy.stats import qmc  # late: it takes half a second

    return qmc.Sobol(dimensions, rng=np.random.default_rng(seed)).random_base2(math.ceil(math.log2(size)))[:size]
