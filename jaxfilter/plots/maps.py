"""Hillshades, error maps and profiles, and maps of the files of a survey."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy

from ..core.cloud import QUANTUM, PointCloud
from ..core.errors import InputError
from ..core.grid import Grid, grid_over
from ..core.result import FilterResult
from ..scoring import reference_labels
from ..terrain.rasters import Hillshade

TYPE_1 = "#D55E00"
TYPE_2 = "#0072B2"
LOW = "#56B4E9"
OBJECT_COLOUR = "#E8D9A0"
GROUND_COLOUR = "#8C6D46"
PICTURE_CELLS = 600
LOW_ERROR = 1.0
"""Metres above the reference ground below which an object that was accepted is drawn apart: low plants, mostly."""
PICTURE_REACH = 30.0
"""Metres: a picture's surface extends this far into places without points."""
LEGEND: dict[str, Any] = {"frameon": False, "fontsize": 7}
"""How all legends look."""
_NEIGHBOURS = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]]) / 4


def rasterise(xyz: np.ndarray, cell: float | None = None, *, over: np.ndarray | None = None) -> tuple[np.ndarray, Grid]:
    """A picture's surface through points: the lowest point per cell, and smooth interpolation between those.

    Args:
        xyz: f32[n, 3], local metres.
        cell: metres; by default what gives about one point per cell and at most 600 cells along the longer side.
        over: points that the grid has to cover; by default ``xyz``.

    Returns: z f32[ny, nx] in metres, NaN farther than :data:`PICTURE_REACH` from every point; and the grid.
    Raises: InputError if there are no points.

    >>> z, grid = jf.plots.rasterise(cloud.xyz[truth], cell=2.0)
    >>> z.shape == (grid.ny, grid.nx), grid.cell
    (True, 2.0)
    """
    if len(xyz) == 0:
        raise InputError("rasterise: there are no points to draw")
    if cell is None:
        width, height = (max(float(v), QUANTUM) for v in np.ptp(xyz[:, :2], axis=0))
        cell = max(math.sqrt(width * height / len(xyz)), max(width, height) / PICTURE_CELLS)
    grid = grid_over(xyz if over is None else over, cell)
    lowest = np.full(grid.ny * grid.nx, np.nan, np.float32)
    np.fmin.at(lowest, grid.flat(xyz), xyz[:, 2])
    z = lowest.reshape(grid.shape)
    far = scipy.ndimage.distance_transform_edt(np.isnan(z), sampling=cell) > PICTURE_REACH
    return np.where(far, np.nan, _fill(z)), grid


def _fill(z: np.ndarray) -> np.ndarray:
    """Every NaN replaced, smoothly: from the grid at half the resolution, filled alike, then relaxed."""
    empty = np.isnan(z)
    if not empty.any() or empty.all():
        return z
    ny, nx = z.shape
    padded = np.pad(z, ((0, ny % 2), (0, nx % 2)), mode="edge")
    blocks = padded.reshape(padded.shape[0] // 2, 2, -1, 2)
    known = (~np.isnan(blocks)).sum(axis=(1, 3))
    half = np.where(known > 0, np.nansum(blocks, axis=(1, 3)) / np.maximum(known, 1), np.nan)
    rows, columns = np.mgrid[:ny, :nx] / 2 - 0.25
    out = np.where(empty, scipy.ndimage.map_coordinates(_fill(half), (rows, columns), order=1, mode="nearest"), z)
    for _ in range(8):
        out[empty] = scipy.ndimage.convolve(out, _NEIGHBOURS, mode="nearest")[empty]
    return out


def new_figure(size: tuple[float, float]) -> Any:
    """An empty figure of this size in inches, without pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def axes_or_new(ax: Any, size: tuple[float, float]) -> Any:
    """The given Axes, or those of a new figure."""
    return new_figure(size).add_subplot() if ax is None else ax


def map_size(grid: Grid, legend: float = 0.0) -> tuple[float, float]:
    """Inches of a figure for a map, with room for labels."""
    return 5.0, float(np.clip(4.3 * grid.ny / grid.nx, 1.5, 9.0)) + 0.8 + legend


def shade(z: np.ndarray, cell: float) -> np.ndarray:
    """f32[ny, nx], 0 (dark) to 1: the light of :func:`jaxfilter.hillshade`, for heights whose row 0 is the southern edge."""
    return Hillshade().shade(z[::-1], cell, 1.0)[::-1] / 255


def _image(ax: Any, picture: np.ndarray, grid: Grid, **style: Any) -> Any:
    """Draw an array with a value, or a colour, for each cell."""
    extent = grid.x0, grid.x0 + grid.nx * grid.cell, grid.y0, grid.y0 + grid.ny * grid.cell
    return ax.imshow(picture, extent=extent, origin="lower", interpolation="nearest", **style)


def _frame(ax: Any, title: str) -> None:
    """Equal axes in metres and a scale bar of a round length."""
    from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

    ax.set_aspect("equal")
    ax.set_xlabel("x (m)")
    ax.set_ylabel("y (m)")
    ax.set_title(title, fontsize=10)
    low, high = ax.get_xlim()
    power = 10.0 ** math.floor(math.log10((high - low) / 4))
    length = max(f * power for f in (1, 2, 5) if f * power <= (high - low) / 4)
    style = {"pad": 0.3, "borderpad": 0.4, "size_vertical": (high - low) / 250, "fontproperties": {"size": 7}}
    ax.add_artist(AnchoredSizeBar(ax.transData, length, f"{length:g} m", "lower right", **style))


def legend_below(ax: Any, handles: list[Any]) -> None:
    """A legend in two columns below the label of the x axis."""
    from matplotlib.transforms import ScaledTranslation

    below_label = ax.transAxes + ScaledTranslation(0.0, -0.42, ax.figure.dpi_scale_trans)
    place = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0), "bbox_transform": below_label}
    ax.legend(handles=handles, ncols=2, handlelength=1.2, columnspacing=1.0, **place, **LEGEND)


def hillshade(surface: np.ndarray | tuple[np.ndarray, Grid], *, ax: Any = None, title: str = "") -> Any:
    """Shaded relief of a surface, lit from the north-west at 45 degrees.

    Args:
        surface: points f32[n, 3] in local metres, drawn through :func:`rasterise`; or (z f32[ny, nx], Grid).
        ax: matplotlib Axes; by default those of a new figure.

    Returns: the Axes.

    >>> ax = jf.plots.hillshade(cloud.xyz[truth], title="ground")
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('x (m)', 'y (m)')
    """
    z, grid = surface if isinstance(surface, tuple) else rasterise(surface)
    ax = axes_or_new(ax, map_size(grid))
    _image(ax, shade(z, grid.cell), grid, cmap="gray", vmin=0, vmax=1)
    _frame(ax, title)
    return ax


def error_map(
    cloud: PointCloud,
    result: FilterResult | np.ndarray,
    reference: np.ndarray | None = None,
    *,
    surface: tuple[np.ndarray, Grid] | None = None,
    ax: Any = None,
    title: str = "",
) -> Any:
    """Where a labelling errs: Type I and Type II errors as points over the shaded relief of the reference ground.

    Cells with an object that was found are tinted. Type II errors less than a metre above that ground, low plants mostly, have a
    colour of their own: they change the terrain little.

    Args:
        cloud: n points.
        result: FilterResult or bool[n], True = ground.
        reference: as for :func:`jaxfilter.evaluate`; by default the cloud's own. Points without a label are not drawn.
        surface: (z, Grid) to shade instead of the reference ground points.
        ax: matplotlib Axes; by default those of a new figure.

    Returns: the Axes. Raises: InputError without a reference.

    >>> ax = jf.plots.error_map(cloud, result, truth)
    >>> ax.figure.savefig("errors.png")
    """
    ground, (truth, counted) = _labels(result), reference_labels(cloud if reference is None else reference)
    z, grid = surface or rasterise(cloud.xyz[truth & counted], over=cloud.xyz)
    ax = axes_or_new(ax, map_size(grid, legend=0.4))
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Patch

    picture = np.repeat(np.nan_to_num(shade(z, grid.cell), nan=1.0)[:, :, None], 3, axis=2)
    real = _valid(cloud) & counted
    objects = np.unique(grid.flat(cloud.xyz[~ground & ~truth & real]))
    pixels = picture.reshape(-1, 3)
    pixels[objects] = 0.45 * pixels[objects] + 0.55 * np.array(to_rgb(OBJECT_COLOUR))
    _image(ax, picture, grid)
    handles = [Patch(color=OBJECT_COLOUR, label="objects found")]
    (lost, gone, ours), (_, wrong, theirs) = _errors(ground, truth)
    high = wrong & (cloud.xyz[:, 2] - z.ravel()[grid.flat(cloud.xyz)] >= LOW_ERROR)
    low = (f"Type II, less than {LOW_ERROR:g} m high", wrong & ~high, LOW)
    for label, where, colour in (low, (lost, gone, ours), ("Type II, higher", high, theirs)):
        where = where & real
        ax.scatter(*cloud.xyz[where, :2].T, s=1.6, c=colour, linewidths=0, rasterized=True)
        handles.append(Patch(color=colour, label=f"{label} ({int(where.sum()):,})"))
    _frame(ax, title)
    legend_below(ax, handles)
    return ax


def doubt_map(cloud: PointCloud, result: FilterResult, *, ax: Any = None, title: str = "") -> Any:
    """The mean doubt of the points in each cell, 0 to 50 %, over the shaded relief of the ground that was found.

    Args:
        cloud: n points.
        result: of a filter that states its doubt.
        ax: matplotlib Axes; by default those of a new figure.

    Returns: the Axes. Raises: InputError if the result has no doubt, or there are no points.

    >>> jf.plots.doubt_map(cloud, result, title="doubt").get_title()
    'doubt'
    """
    if result.doubt is None:
        raise InputError("doubt_map: the result states no doubt; OST does")
    real = _valid(cloud)
    z, grid = rasterise(cloud.xyz[result.ground if result.ground.any() else real], over=cloud.xyz[real])
    judged = np.flatnonzero(np.isfinite(result.doubt) & real)
    at = grid.flat(cloud.xyz[judged])
    count = np.bincount(at, minlength=grid.nx * grid.ny)
    total = np.bincount(at, weights=result.doubt[judged], minlength=grid.nx * grid.ny)
    mean = np.ma.masked_where(count == 0, total / np.maximum(count, 1)).reshape(grid.shape)
    ax = axes_or_new(ax, map_size(grid))
    hillshade((z, grid), ax=ax, title=title)
    image = _image(ax, 100 * mean, grid, cmap="YlOrRd", vmin=0, vmax=50, alpha=0.65)
    ax.figure.colorbar(image, ax=ax, label="mean doubt (%)", shrink=0.7)
    return ax


def profile(
    cloud: PointCloud,
    result: FilterResult | np.ndarray,
    line: tuple[tuple[float, float], tuple[float, float]],
    width: float = 2.0,
    *,
    reference: np.ndarray | None = None,
    ax: Any = None,
    title: str = "",
) -> Any:
    """A vertical section: the points within half of ``width`` of a line, by distance along it.

    Args:
        cloud: n points.
        result: FilterResult or bool[n], True = ground.
        line: two points (x, y) in local metres.
        width: metres, of the strip.
        reference: bool[n]; if given, errors are marked apart.
        ax: matplotlib Axes; by default those of a new figure.

    Returns: the Axes. Raises: InputError if the line has no length.

    >>> ax = jf.plots.profile(cloud, result, ((0, 30), (60, 30)), width=2.0, reference=truth)
    >>> ax.get_xlabel()
    'distance along the profile (m)'
    """
    start, end = np.asarray(line, np.float64)
    length = float(np.hypot(*(end - start)))
    if length == 0:
        raise InputError(f"profile: line {line} has no length")
    along = (end - start) / length
    offset = cloud.xyz[:, :2] - start
    s = offset @ along
    near = (np.abs(offset @ np.array([-along[1], along[0]])) <= width / 2) & (s >= 0) & (s <= length) & _valid(cloud)
    ground = _labels(result)
    ax = axes_or_new(ax, (7.0, 2.6))
    groups = [("non-ground", ~ground, "0.7", 2.0), ("ground", ground, GROUND_COLOUR, 2.0)]
    if reference is not None:
        groups += [(*error, 7.0) for error in _errors(ground, reference)]
    for label, where, colour, size in groups:
        chosen = near & where
        ax.scatter(s[chosen], cloud.xyz[chosen, 2], s=size, c=colour, linewidths=0, label=label, rasterized=True)
    ax.set_xlim(0, length)
    ax.set_xlabel("distance along the profile (m)")
    ax.set_ylabel("height (m)")
    ax.set_title(title, fontsize=10, loc="left")
    place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.1}
    ax.legend(markerscale=2, ncols=len(groups), **place, **LEGEND)
    return ax


def panel(
    cloud: PointCloud,
    result: FilterResult | np.ndarray,
    reference: np.ndarray | None = None,
    *,
    surface: tuple[np.ndarray, Grid] | None = None,
) -> Any:
    """A figure of five: the surface on top of all points, that of the reference ground and that of the result, the error map, and
    a west-east profile.

    Args:
        cloud: n points.
        result: FilterResult or bool[n], True = ground.
        reference: bool[n], True = ground; by default the cloud's own.
        surface: (z, Grid) of the true ground, as of :func:`error_map`.

    Returns: the matplotlib Figure. Raises: InputError without a reference.

    >>> len(jf.plots.panel(cloud, result, truth).axes)
    5
    """
    reference = reference_labels(cloud if reference is None else reference)[0]
    truth = surface or rasterise(cloud.xyz[reference], over=cloud.xyz)
    map_height = float(np.clip(3.2 * truth[1].ny / truth[1].nx, 1.0, 8.0))
    figure = new_figure((14.5, map_height + 3.1))
    places = figure.add_gridspec(2, 4, height_ratios=(map_height + 1.0, 1.7))
    middle = float(np.median(cloud.xyz[reference, 1]))
    ends = (0.0, middle), (float(cloud.xyz[:, 0].max()), middle)
    before, *top = [figure.add_subplot(places[0, i]) for i in range(4)]
    hillshade(top_of(cloud, truth[1].cell), ax=before, title="all points, before")
    hillshade(truth, ax=top[0], title="reference ground")
    found = rasterise(cloud.xyz[_labels(result)], truth[1].cell, over=cloud.xyz)
    hillshade(found, ax=top[1], title="filtered ground")
    error_map(cloud, result, reference, surface=truth, ax=top[2], title="errors")
    bottom = figure.add_subplot(places[1, :])
    profile(cloud, result, ends, reference=reference, ax=bottom, title=f"section at y = {middle:.0f} m")
    return figure


def footprints(
    bounds: np.ndarray,
    values: np.ndarray | None = None,
    *,
    label: str = "",
    overlaps: np.ndarray | None = None,
    gaps: Sequence[tuple[float, float, float, float]] = (),
    ax: Any = None,
) -> Any:
    """Rectangles, coloured by a value each, with what they share and what they leave open.

    Args:
        bounds: f64[n, 4], xmin, ymin, xmax, ymax in file units; rows with NaN are not drawn.
        values: f64[n], shown as colours with a bar named ``label``; by default all are grey.
        overlaps: i64[m, 2], pairs of rows whose common area is outlined.
        gaps: rectangles that are outlined by dashes.
        ax: matplotlib Axes; by default those of a new figure.

    Returns: the Axes.

    >>> bounds = np.array([[0.0, 0.0, 50.0, 50.0], [40.0, 0.0, 90.0, 50.0]])
    >>> ax = jf.plots.footprints(bounds, np.array([4.0, 6.0]), label="points per m2", overlaps=np.array([[0, 1]]))
    >>> ax.get_aspect()
    1.0
    """
    ax = axes_or_new(ax, (5.0, 5.0))
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Rectangle

    known = np.isfinite(bounds).all(axis=1)
    x0, y0, x1, y1 = bounds[known].T
    corners = np.stack([x0, y0, x1, y0, x1, y1, x0, y1], axis=1).reshape(-1, 4, 2)
    drawn = PolyCollection(list(corners), edgecolors="black", linewidths=0.2, facecolors="0.7")
    if values is not None:
        drawn.set_array(np.ma.masked_invalid(values[known]))
        drawn.set_cmap("viridis")
        ax.figure.colorbar(drawn, ax=ax, label=label, shrink=0.7)
    ax.add_collection(drawn)
    for i, j in [] if overlaps is None else overlaps.tolist():
        low, high = np.maximum(bounds[i, :2], bounds[j, :2]), np.minimum(bounds[i, 2:], bounds[j, 2:])
        ax.add_patch(Rectangle(low, *(high - low), fill=False, edgecolor=TYPE_1, linewidth=0.8))
    for gap in gaps:
        size = gap[2] - gap[0], gap[3] - gap[1]
        ax.add_patch(Rectangle(gap[:2], *size, fill=False, edgecolor=TYPE_2, linewidth=1.0, linestyle="--"))
    ax.autoscale_view()
    ax.set_aspect("equal")
    ax.ticklabel_format(useOffset=False, style="plain")
    ax.tick_params(axis="x", labelrotation=45)
    return ax


def top_of(cloud: PointCloud, cell: float | None = None) -> tuple[np.ndarray, Grid]:
    """The surface on top of all valid points, as :func:`rasterise` makes that below them."""
    z, grid = rasterise(cloud.xyz[_valid(cloud)] * np.array([1, 1, -1], np.float32), cell)
    return -z, grid


def _labels(result: FilterResult | np.ndarray) -> np.ndarray:
    return result.ground if isinstance(result, FilterResult) else np.asarray(result)


def _errors(ground: np.ndarray, reference: np.ndarray) -> list[tuple[str, np.ndarray, str]]:
    """Name, bool[n] and colour of both kinds of errors."""
    lost, accepted = reference & ~ground, ground & ~reference
    return [("Type I, ground lost", lost, TYPE_1), ("Type II, object accepted", accepted, TYPE_2)]


def _valid(cloud: PointCloud) -> np.ndarray:
    return np.ones(len(cloud), bool) if cloud.valid is None else cloud.valid
