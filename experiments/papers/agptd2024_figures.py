"""The pictures: Figs. 5 to 11 of Zheng et al. (2024), and the trial and error of Sec. 3.3, from our results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

import jaxfilter as jf
from experiments.report import Row
from jaxfilter import plots

if TYPE_CHECKING:
    import xarray

RIGHT, WRONG = "#0072B2", "#D55E00"
SCALE = (0.0, 5.0)
"""Percentage points: colours of :func:`trial_maps`, the same on all samples."""
PRINTED, MEASURED, BY_LABELS = "0.6", "#0072B2", "#E69F00"


def sample_bars(bars: Mapping[str, Sequence[float]], names: Sequence[str], what: str) -> Figure:
    """A bar for each label of ``bars`` per sample; ``what``: the axis. Fig. 6, and total errors."""
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    axes = figure.subplots()
    for i, (label, values) in enumerate(bars.items()):
        axes.bar(np.arange(len(names)) + 0.16 * (i - 2), values, 0.15, label=label, color=f"C{i}")
    axes.set_xticks(range(len(names)), [name.removeprefix("samp") for name in names])
    axes.set(xlabel="sample", ylabel=what)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    return figure


def outlier_maps(name: str, cloud: jf.PointCloud, removed: Mapping[str, np.ndarray]) -> Figure:
    """Fig. 5: the points that were removed, from above and from the south, for each of the ways in ``removed``."""
    size = np.ptp(cloud.xyz, axis=0)
    height = 4.4 * float(size[1] / size[0])
    figure = Figure(figsize=(4.9 * len(removed) + 0.6, height + 3.1), layout="constrained")
    panels = figure.subplots(2, len(removed), squeeze=False, sharex=True, sharey="row", height_ratios=(height, 1.7))
    surface = plots.rasterise(cloud.xyz[cloud.reference], over=cloud.xyz)
    for (top, side), (title, gone) in zip(panels.T, removed.items(), strict=True):
        plots.hillshade(surface, ax=top, title=f"{name}, {title}: {int(gone.sum()):,} removed")
        side.scatter(*cloud.xyz[~gone][:, [0, 2]].T, s=0.5, c="0.7", linewidths=0, rasterized=True)
        for kind, colour, label in ((~cloud.reference, RIGHT, "objects"), (cloud.reference, WRONG, "ground")):
            which = gone & kind
            for ax, columns in ((top, [0, 1]), (side, [0, 2])):
                ax.scatter(
                    *cloud.xyz[which][:, columns].T, s=4, c=colour, linewidths=0, label=f"{label}: {int(which.sum()):,}",
                    rasterized=True,
                )  # fmt: skip
        top.set_xlabel("")
        side.set(xlabel="x (m)", ylabel="height (m)")
        side.legend(loc="upper right", fontsize=8, markerscale=2, handletextpad=0.2)
    for ax in panels[:, 1:].ravel():
        ax.set_ylabel("")
    return figure


def seed_maps(name: str, cloud: jf.PointCloud, runs: Sequence[Mapping[str, jf.FilterResult]]) -> Figure:
    """Fig. 7: the seeds of each run over the shaded reference ground; a row per mapping."""
    size = np.ptp(cloud.xyz[:, :2], axis=0)
    columns = max(len(row) for row in runs)
    figure = Figure(figsize=(3.9 * columns, len(runs) * (3.3 * float(size[1] / size[0]) + 0.5)), layout="constrained")
    panels = figure.subplots(len(runs), columns, squeeze=False, sharex=True, sharey=True)
    surface = plots.rasterise(cloud.xyz[cloud.reference], over=cloud.xyz)
    for axes, row in zip(panels, runs, strict=True):
        for ax, (title, result) in zip(axes, row.items(), strict=True):
            seed = result.decision == jf.Decision.SEED
            plots.hillshade(surface, ax=ax, title=f"{name}, {title}")
            point = 14.0 if seed.sum() < 1000 else 3.0
            for kind, colour, label in ((cloud.reference, RIGHT, "on ground"), (~cloud.reference, WRONG, "on objects")):
                which = seed & kind
                ax.scatter(
                    *cloud.xyz[which, :2].T, s=point if kind is cloud.reference else 3 * point, c=colour,
                    linewidths=0, label=f"{label}: {int(which.sum()):,}", rasterized=True,
                )  # fmt: skip
            ax.legend(loc="upper left", fontsize=7.5, markerscale=1.6, handletextpad=0.1)
            ax.label_outer()
    return figure


def every_sample(clouds: Mapping[str, jf.PointCloud], results: Mapping[str, Mapping[str, jf.FilterResult]]) -> Figure:
    """Fig. 9: error maps of all samples, two samples in a row, the results of each side by side."""
    each = len(next(iter(results.values())))
    rows = -(-len(clouds) // 2)
    figure = Figure(figsize=(2.3 * 2 * each, 2.5 * rows), layout="constrained")
    panels = iter(figure.subplots(rows, 2 * each, squeeze=False).ravel())
    for name, cloud in clouds.items():
        surface = plots.rasterise(cloud.xyz[cloud.reference], over=cloud.xyz)
        for title, result in results[name].items():
            ax = next(panels)
            total = jf.evaluate(result, cloud.reference).total
            plots.error_map(
                cloud, result, cloud.reference, surface=surface, ax=ax, title=f"{name}, {title}: {total:.1f} %"
            )
            ax.set(xticks=[], yticks=[], xlabel="", ylabel="")
            ax.title.set_fontsize(7)
            if (legend := ax.get_legend()) is not None:
                legend.remove()
    for ax in panels:
        ax.set_axis_off()
    return figure


def means(rows: Sequence[Row], keys: Mapping[str, str]) -> Figure:
    """Figs. 10 and 11: a panel of horizontal bars for each of the ``keys`` (column to title), the best row on top.

    ``rows``: ``method``, ``kind`` (printed, measured, labels) and the columns.
    """
    from matplotlib.patches import Patch

    colours = {"printed": PRINTED, "measured": MEASURED, "labels": BY_LABELS}
    order = sorted(rows, key=lambda row: -row[list(keys)[-1]])
    figure = Figure(figsize=(3.2 * len(keys) + 2.6, 0.23 * len(rows) + 1.4), layout="constrained")
    for ax, (key, title) in zip(
        figure.subplots(1, len(keys), sharey=True, squeeze=False)[0], keys.items(), strict=True
    ):
        values = [row[key] for row in order]
        ax.barh(range(len(order)), values, 0.75, color=[colours[row["kind"]] for row in order])
        for y, value in enumerate(values):
            ax.text(value, y, f" {value:.2f}", va="center", fontsize=7.5)
        ax.set_yticks(range(len(order)), [row["method"] for row in order], fontsize=8)
        ax.set_xlabel(f"{title} (%)", fontsize=9)
        ax.set_xlim(0, 1.14 * max(values))
        ax.set_ylim(-0.6, len(order) - 0.4)
        ax.tick_params(labelsize=8)
        ax.spines[["top", "right"]].set_visible(False)
    handles = [
        Patch(color=PRINTED, label="printed"),
        Patch(color=MEASURED, label="measured, one set for all samples"),
        Patch(color=BY_LABELS, label="measured, thresholds or removal by the labels of the sample"),
    ]
    ncols = 3 if len(keys) > 1 else 1
    figure.legend(handles=handles, loc="outside upper center", ncols=ncols, frameon=False, fontsize=8)
    return figure


def trial_maps(grid: xarray.Dataset, printed: Mapping[str, tuple[float, float]]) -> Figure:
    """Total error above the least of the sample over angle and distance; a panel per sample, all in one scale.

    ``grid``: a sweep over ``max_angle`` and ``max_distance`` on several clouds. ``printed``: angle and distance of Table 1.
    """
    names = grid["cloud"].values.tolist()
    least = grid.total.min(("max_angle", "max_distance"))
    above = grid.assign(total=grid.total - least)
    columns = min(5, len(names))
    lines = -(-len(names) // columns)
    figure = Figure(figsize=(2.25 * columns + 1.1, 2.15 * lines + 0.6), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True)
    for ax, name in zip(panels.ravel(), names, strict=False):
        plots.sweep_map(
            above.sel(cloud=name), "max_angle", "max_distance", limits=SCALE, ax=ax,
            title=f"{name}: {float(least.sel(cloud=name)):.2f} %",
        )  # fmt: skip
        place = [
            np.interp(value, grid[axis].values, np.arange(grid.sizes[axis]))
            for value, axis in zip(printed[name], ("max_angle", "max_distance"), strict=True)
        ]
        ax.plot(*place, "x", color="white", markersize=9, markeredgewidth=3.4)
        ax.plot(*place, "x", color="black", markersize=7, markeredgewidth=1.6)
        ax.label_outer()
    for ax in panels.ravel()[len(names) :]:
        ax.remove()
    bar = figure.colorbar(panels[0, 0].collections[0], ax=panels, shrink=0.7, extend="max")
    bar.set_label("total error above the least of the sample (points)", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    return figure
