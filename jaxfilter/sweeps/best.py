"""What the labelled result of a sweep says: its axes, its scores over all clouds, and its best sets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..core.errors import InputError, check_choice

if TYPE_CHECKING:
    import pandas
    import xarray

SCORE_NAMES = {"type1": "Type I error", "type2": "Type II error", "total": "total error", "kappa": "kappa"}
SCORES = tuple(SCORE_NAMES)
LARGER_IS_BETTER = ("kappa",)


def word(value: Any) -> str:
    """A value of a field, short."""
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def cost(values: Any, score: str) -> Any:
    """Scores such that less is better."""
    return -values if score in LARGER_IS_BETTER else values


def is_grid(dataset: xarray.Dataset) -> bool:
    """Whether each axis is a dimension; else all lie along the dimension ``set``."""
    return "set" not in dataset.sizes


def axes_of(dataset: xarray.Dataset) -> tuple[str, ...]:
    """The fields that were swept, in order."""
    if is_grid(dataset):
        scored = next((name for name in SCORES if name in dataset), None)
        if scored is None:
            raise InputError(f"dataset: none of {', '.join(SCORES)} is in it; give what jaxfilter.sweep returned")
        return tuple(str(name) for name in dataset[scored].dims if name != "cloud")
    return tuple(str(name) for name, values in dataset.coords.items() if values.dims == ("set",) and name != "set")


def mean_score(dataset: xarray.Dataset, score: str) -> xarray.DataArray:
    """The score over the axes of a grid, or over ``set``: percent, the mean over those clouds that have labels.

    Raises: ParameterError for a score that does not exist, InputError for one that no cloud had labels for.
    """
    check_choice([name for name in SCORES if name in dataset], score=score)
    values = dataset[score]
    if not values.notnull().any():
        raise InputError(f"score={score!r} is undefined for every set: there are no reference labels of both classes")
    return values.mean("cloud", keep_attrs=True) if "cloud" in values.dims else values


def best_sets(dataset: xarray.Dataset, score: str = "total", count: int | None = 10) -> pandas.DataFrame:
    """A table of the sets with the best scores, the best first; equal ones stay in the order of the sweep.

    Args:
        dataset: from :func:`jaxfilter.sweep`, or the ``trials`` of a :class:`jaxfilter.Calibration`.
        score: what decides: the lowest "type1", "type2" or "total", or the highest "kappa"; of trials also "expected".
        count: rows; None for all.

    Returns: pandas.DataFrame with the number of the set as index. Columns: the fields; type1, type2, total, kappa
        (percent) and ground (points), means over the clouds; for several clouds the score of each, as total_NAME.
        Without any score the sets are in the order of the sweep.
    Raises: ParameterError for a score that does not exist.
    """
    import pandas as pd

    check_choice([name for name in (*SCORES, "expected") if name in dataset], score=score)
    names, figures = axes_of(dataset), [name for name in (*SCORES, "expected", "ground") if name in dataset]
    every = dataset[figures]
    if is_grid(dataset):
        every = every.stack({"set": names}, create_index=False)
    means = every.mean("cloud") if "cloud" in every.dims else every
    columns = {name: means[name].values for name in (*names, *figures)}
    if "cloud" in every.dims:
        columns |= {f"{score}_{one}": every[score].sel(cloud=one).values for one in every["cloud"].values}
    frame = pd.DataFrame(columns, index=pd.RangeIndex(every.sizes["set"], name="set"))
    decides = dataset.attrs["score"] if score == "expected" else score
    sorted_ = frame.sort_values(score, ascending=decides not in LARGER_IS_BETTER, kind="stable", na_position="last")
    return sorted_ if count is None else sorted_.head(count)
