"""Maps of the files of a survey."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .maps import TYPE_1, TYPE_2, axes_or_new


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
