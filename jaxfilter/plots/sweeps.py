"""What a sweep found: scores along each parameter and over pairs of them, and where labels depend on them."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.cloud import PointCloud
from ..core.errors import InputError, ParameterError, check_choice
from ..core.grid import Grid
from ..sweeps.best import LARGER_IS_BETTER, SCORE_NAMES, axes_of, cost, is_grid, mean_score, word
from .maps import LEGEND, TYPE_1, TYPE_2, axes_or_new, hillshade, legend_below, map_size, new_figure, rasterise

if TYPE_CHECKING:
    import xarray

BEST = TYPE_1
"""Colour of what belongs to the best set."""
SURE, EVEN = "#F0E442", "#7A0403"
"""Colours of points that nearly all sets agree on, and that half of the sets call ground."""
SHOWN = 0.9
"""This share of scores, from the best, is within the frame and the range of colours; worse ones are cut off."""
_BINS, _PER_BIN = 12, 8
_TICKS = 6
_STAR: dict[str, Any] = {"marker": "*", "color": BEST, "markersize": 9, "linestyle": "none", "zorder": 4}


def sweep_curves(dataset: xarray.Dataset, score: str = "total") -> Any:
    """A figure with a panel of :func:`sweep_curve` for each axis.

    Args: as for :func:`sweep_curve`. Returns: the matplotlib Figure.

    >>> data = jf.sweep(jf.SMRF(), cloud, {"slope": [0.1, 0.2], "threshold": [0.3, 0.5]}, votes=True)
    >>> len(jf.plots.sweep_curves(data).axes)
    2
    """
    names = axes_of(dataset)
    columns = min(len(names), 3)
    rows = math.ceil(len(names) / columns)
    figure = new_figure((2.4 * columns + 0.5, 2.2 * rows + 0.4))
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for ax, name in itertools.zip_longest(panels.ravel(), names):
        if name is None:
            ax.remove()
            continue
        sweep_curve(dataset, name, score, ax=ax)
        ax.get_legend().remove()
        if ax is not panels[ax.get_subplotspec().rowspan.start, 0]:
            ax.set_ylabel("")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, **LEGEND)
    return figure


def sweep_curve(dataset: xarray.Dataset, axis: str, score: str = "total", *, ax: Any = None, title: str = "") -> Any:
    """A score against one parameter.

    In a grid the line is the best score that any values of the other parameters reach, the grey line their median, and the
    band holds four fifths of them. In a design every set is a point, and the line joins the best in each of at most
    twelve parts of the axis. Several clouds count by their mean.

    Args:
        dataset: from :func:`jaxfilter.sweep`, or the ``trials`` of a :class:`jaxfilter.Calibration`.
        axis: field that was swept.
        score: "total", "kappa", "type1" or "type2".
        ax: matplotlib Axes; by default those of a new figure.

    Returns: the Axes. Raises: ParameterError for an axis or a score that does not exist; InputError without scores.

    >>> data = jf.sweep(jf.SMRF(), cloud, {"slope": [0.1, 0.2], "threshold": [0.3, 0.5]}, votes=True)
    >>> jf.plots.sweep_curve(data, "slope", "kappa").get_ylabel()
    'kappa (%)'
    """
    values = mean_score(dataset, score)
    check_choice(axes_of(dataset), axis=axis)
    ax = axes_or_new(ax, (3.2, 2.6))
    place = _Places(dataset[axis].values)
    if is_grid(dataset):
        others = [name for name in values.dims if name != axis]
        table = values.transpose(axis, *others).values.reshape(len(place.x), -1)
        if others:
            low, middle, high = np.nanquantile(table, (0.1, 0.5, 0.9), axis=1)
            ax.fill_between(place.x, low, high, color="0.88", linewidth=0, label="four fifths of the sets")
            ax.plot(place.x, middle, color="0.55", linewidth=1, label="median of the sets")
        x, y = place.x, cost(np.fmin.reduce(cost(table, score), axis=1), score)
        label = "best of the sets" if others else "all sets"
        every, rows = table.ravel(), np.repeat(np.arange(len(table)), table.shape[1])
    else:
        ax.scatter(place.x, values.values, s=5, c="0.65", linewidths=0, label="sets", rasterized=True)
        x, y = _envelope(place, values.values, score)
        label = "best of nearby sets"
        every, rows = values.values, np.arange(values.size)
    ax.plot(x, y, color=TYPE_2, linewidth=0 if place.named else 1.4, marker="o", markersize=2.5, label=label)
    best = _best(every, score)
    ax.plot(place.x[rows[best]], every[best], label="best set", **_STAR)
    _label(ax.xaxis, dataset, axis, place)
    ax.set_ylabel(f"{SCORE_NAMES[score]} (%)", fontsize=8)
    ax.tick_params(labelsize=7)
    ax.set_title(title, fontsize=10)
    low, high = _limits([every], score)
    margin = 0.06 * (high - low) or 0.5
    ax.set_ylim(low - margin, high + margin)
    ax.legend(**LEGEND)
    return ax


def sweep_maps(dataset: xarray.Dataset, score: str = "total") -> Any:
    """A figure with a panel of :func:`sweep_map` for each pair of axes, in one scale of colours.

    Args: as for :func:`sweep_map`. Returns: the matplotlib Figure. Raises: InputError if there is only one axis.

    >>> data = jf.sweep(jf.SMRF(), cloud, {"slope": [0.1, 0.2], "threshold": [0.3, 0.5]}, votes=True)
    >>> jf.plots.sweep_maps(data, "kappa").savefig("maps.png")
    """
    names = axes_of(dataset)
    values = mean_score(dataset, score)
    if len(names) < 2:
        raise InputError(f"sweep_maps: only {names[0]} was swept; a map needs two axes")
    limits = _limits([_drawn(dataset, values, *pair, score) for pair in itertools.combinations(names, 2)], score)
    side = len(names) - 1
    figure = new_figure((2.1 * side + 1.4, 1.9 * side + 0.6))
    panels = figure.subplots(side, side, squeeze=False)
    for (row, column), ax in np.ndenumerate(panels):
        if column > row:
            ax.remove()
            continue
        sweep_map(dataset, names[column], names[row + 1], score, limits=limits, ax=ax)
        if row < side - 1:
            ax.set_xlabel("")
            ax.tick_params(labelbottom=False)
        if column > 0:
            ax.set_ylabel("")
            ax.tick_params(labelleft=False)
    shown = panels[np.tril_indices(side)].tolist()
    _colour_bar(shown[0], dataset, score, shown)
    return figure


def sweep_map(
    dataset: xarray.Dataset,
    x: str,
    y: str,
    score: str = "total",
    *,
    limits: tuple[float, float] | None = None,
    ax: Any = None,
    title: str = "",
) -> Any:
    """A score over two parameters, the best over the others, with the best set of all marked by a star.

    A grid is drawn as a cell per pair of values, evenly spaced whatever the values; a design as a point per set, the best
    on top. Several clouds count by their mean.

    Args:
        dataset: from :func:`jaxfilter.sweep`, or the ``trials`` of a :class:`jaxfilter.Calibration`.
        x, y: fields that were swept.
        score: "total", "kappa", "type1" or "type2".
        limits: percent, of the colours, for maps that share a colour bar, which is then not drawn; by default from the best
            to where a tenth of what is drawn is worse.
        ax: matplotlib Axes; by default those of a new figure.

    Returns: the Axes. Raises: ParameterError for an axis or a score that does not exist; InputError without scores.

    >>> data = jf.sweep(jf.SMRF(), cloud, {"slope": [0.1, 0.2], "threshold": [0.3, 0.5]}, votes=True)
    >>> ax = jf.plots.sweep_map(data, "slope", "threshold")
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('slope (rise/run)', 'threshold (m)')
    """
    values = mean_score(dataset, score)
    check_choice(axes_of(dataset), x=x, y=y)
    if x == y:
        raise ParameterError(f"sweep_map: x and y are both {x!r}; name two axes")
    ax = axes_or_new(ax, (4.0, 3.1))
    grid, drawn = is_grid(dataset), _drawn(dataset, values, x, y, score)
    low, high = limits or _limits([drawn], score)
    style = {"cmap": "viridis" if score in LARGER_IS_BETTER else "viridis_r", "vmin": low, "vmax": high}
    across, up = (_Places(dataset[name].values, even=grid) for name in (x, y))
    best = _best(values.values.ravel(), score)
    if grid:
        ax.pcolormesh(across.edges, up.edges, drawn, **style)
        at = dict(zip(values.dims, np.unravel_index(best, values.shape), strict=True))
        star = across.x[at[x]], up.x[at[y]]
    else:
        order = np.argsort(-cost(drawn, score))
        ax.scatter(across.x[order], up.x[order], s=14, c=drawn[order], linewidths=0, rasterized=True, **style)
        star = across.x[best], up.x[best]
    ax.plot(*star, **_STAR | {"markersize": 11, "markeredgecolor": "white", "markeredgewidth": 0.6})
    _label(ax.xaxis, dataset, x, across)
    _label(ax.yaxis, dataset, y, up)
    ax.tick_params(labelsize=7)
    ax.set_title(title, fontsize=10)
    if limits is None:
        _colour_bar(ax, dataset, score, [ax])
    return ax


def votes_map(
    cloud: PointCloud,
    votes: np.ndarray,
    *,
    surface: tuple[np.ndarray, Grid] | None = None,
    ax: Any = None,
    title: str = "",
) -> Any:
    """Where the parameters matter: the points that some sets call ground and others do not, over the shaded relief.

    Args:
        cloud: n points.
        votes: f[n], share of the sets that call a point ground: ``votes`` of a sweep's result.
        surface: (z, Grid) to shade; by default through the points that most sets call ground.
        ax: matplotlib Axes; by default those of a new figure.

    Returns: the Axes. Raises: InputError for votes of the wrong length or out of 0 to 1.

    >>> data = jf.sweep(jf.SMRF(), cloud, {"slope": [0.1, 0.2], "threshold": [0.3, 0.5]}, votes=True)
    >>> jf.plots.votes_map(cloud, data.votes.values, title="votes").get_title()
    'votes'
    """
    share = np.asarray(votes, np.float64)
    if share.shape != (len(cloud),) or not ((share >= 0) & (share <= 1)).all():
        raise InputError(f"votes: shares between 0 and 1 of {len(cloud)} points are needed, not shape {share.shape}")
    if surface is None:
        mostly = share > 0.5
        surface = rasterise(cloud.xyz[mostly if mostly.any() else slice(None)], over=cloud.xyz)
    width, height = map_size(surface[1], legend=0.4)
    ax = hillshade(surface, ax=axes_or_new(ax, (width + 0.9, height)), title=title)  # room for the colour bar
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.patches import Patch

    minority = np.minimum(share, 1 - share)
    disputed = np.flatnonzero(minority > 0)
    disputed = disputed[np.argsort(minority[disputed], kind="stable")]
    colours = LinearSegmentedColormap.from_list("dispute", [SURE, TYPE_1, EVEN])
    style = {"s": 1.6, "cmap": colours, "vmin": 0, "vmax": 50, "linewidths": 0, "rasterized": True}
    points = ax.scatter(*cloud.xyz[disputed, :2].T, c=100 * minority[disputed], **style)
    bar = ax.figure.colorbar(points, cax=ax.inset_axes((1.03, 0.0, 0.03, 1.0)))
    bar.set_label("sets that contradict the majority (%)", fontsize=7)
    bar.ax.tick_params(labelsize=7)
    judged = int(cloud.candidate.sum())
    percent = 100 * len(disputed) / max(judged, 1)
    text = f"label depends on the parameters: {len(disputed):,} of {judged:,} judged points ({percent:.1f} %)"
    legend_below(ax, [Patch(color=TYPE_1, label=text)])
    return ax


class _Places:
    """Where the values of an axis are drawn: numbers at their value, or evenly spaced; words side by side."""

    def __init__(self, values: np.ndarray, even: bool = False) -> None:
        numeric = np.issubdtype(values.dtype, np.number) and bool(np.isfinite(values).all())
        self.named = not numeric
        self.log = self.ticked = False
        if numeric and not even:
            self.x = values.astype(np.float64)
            self.kinds = np.unique(self.x)
            low, middle, high = self.kinds[0], float(np.median(self.kinds)), self.kinds[-1]
            if low > 0 and high >= 4 * low:  # are they spread evenly in their logarithm rather than evenly?
                self.log = abs(math.log(middle / math.sqrt(low * high))) < abs(math.log(middle / ((low + high) / 2)))
            return
        kinds = list(dict.fromkeys(values.tolist()))
        self.x = np.array([kinds.index(value) for value in values.tolist()], np.float64)
        self.kinds = np.arange(len(kinds), dtype=np.float64)
        self.labels = [word(value) for value in kinds]
        self.edges = np.arange(len(kinds) + 1) - 0.5
        self.ticked = True

    def mark(self, axis: Any) -> None:
        """Ticks where the values are, or at round numbers if there are too many of them."""
        from matplotlib.ticker import FormatStrFormatter, LogLocator, NullLocator

        if self.ticked:
            step = math.ceil(len(self.kinds) / (len(self.kinds) if self.named else _TICKS))
            axis.set_ticks(self.kinds[::step], self.labels[::step])
            axis.set_view_interval(self.edges[0], self.edges[-1], ignore=True)
            return
        if self.log:
            (axis.axes.set_xscale if axis.axis_name == "x" else axis.axes.set_yscale)("log")
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.set_major_formatter(FormatStrFormatter("%.4g"))
            axis.set_minor_locator(NullLocator())
        if len(self.kinds) <= _TICKS:
            axis.set_ticks(self.kinds, [f"{tick:.4g}" for tick in self.kinds])


def _label(axis: Any, dataset: xarray.Dataset, name: str, place: _Places) -> None:
    """Ticks at the values of a field, and its name and unit."""
    place.mark(axis)
    unit = dataset[name].attrs.get("units", "")
    axis.set_label_text(f"{name} ({unit})" if unit else name, fontsize=8)


def _best(values: np.ndarray, score: str) -> int:
    """Number of the best of f[s], the first of equals."""
    return int(np.nanargmin(cost(values, score)))


def _envelope(place: _Places, values: np.ndarray, score: str) -> tuple[np.ndarray, np.ndarray]:
    """The best set of each part of the axis, of equal widths as it is drawn; of each value if there are no more of them."""
    bins = int(np.clip(len(values) // _PER_BIN, 3, _BINS))
    part = np.searchsorted(place.kinds, place.x)
    if len(place.kinds) > bins:
        x = np.log(place.x) if place.log else place.x
        part = np.clip(((x - x.min()) / np.ptp(x) * bins).astype(int), 0, bins - 1)
    parts = (np.flatnonzero((part == number) & np.isfinite(values)) for number in np.unique(part))
    best = np.array([where[_best(values[where], score)] for where in parts if len(where)])
    return place.x[best], values[best]


def _drawn(dataset: xarray.Dataset, values: xarray.DataArray, x: str, y: str, score: str) -> np.ndarray:
    """What a map shows: f[ny, nx] of a grid, the best over all other axes; f[s] of a design."""
    if not is_grid(dataset):
        return values.values
    others = [name for name in values.dims if name not in (x, y)]
    return cost(cost(values, score).min(others), score).transpose(y, x).values


def _limits(drawn: list[np.ndarray], score: str) -> tuple[float, float]:
    """From the best of what is drawn to where the rest of it is worse, which would press the others together; lower first."""
    costs = cost(np.concatenate([values.ravel() for values in drawn]), score)
    ends = sorted(cost(np.nanquantile(costs, (0.0, SHOWN)), score).tolist())
    return ends[0], ends[1]


def _colour_bar(ax: Any, dataset: xarray.Dataset, score: str, panels: list[Any]) -> None:
    extend = "min" if score in LARGER_IS_BETTER else "max"
    bar = ax.figure.colorbar(ax.collections[0], ax=panels, shrink=0.9, extend=extend)
    others = is_grid(dataset) and len(axes_of(dataset)) > 2
    bar.set_label(f"{SCORE_NAMES[score]} (%)" + others * ", best over the other parameters", fontsize=8)
    bar.ax.tick_params(labelsize=7)
