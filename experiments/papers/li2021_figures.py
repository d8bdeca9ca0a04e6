"""The pictures: Figs. 5 to 12 of Li et al. (2021), drawn from our results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from scipy import ndimage
from scipy.stats import linregress

import jaxfilter as jf
from experiments.isprs import samples
from experiments.report import Row, save_png
from jaxfilter import plots
from jaxfilter.core.grid import Grid

if TYPE_CHECKING:
    import xarray

SHOWN = {"12": "Fig. 9", "61": "Fig. 10", "24": "Fig. 11", "53": "Fig. 12"}
"""Samples of Figs. 9 to 12."""
INK, SEED, SEED_PTD = "#1b4965", "#D55E00", "#0072B2"

CURVES = {
    "kappa": ("kappa", "#009E73"),
    "type1": ("Type I", plots.TYPE_1),
    "type2": ("Type II", plots.TYPE_2),
    "total": ("total error", "black"),
}
"""Label and colour of the scores of Figs. 5 and 6."""


def thresholds(lines: Mapping[tuple[str, str], xarray.Dataset], axis: str, chosen: Mapping[str, Row]) -> Figure:
    """Fig. 5 or 6: kappa and errors against one threshold; a column per sample, a row per run.

    ``lines``: the scores along ``axis`` for each (run, sample); ``chosen``: by sample the row of Table I.
    """
    runs, names = (list(dict.fromkeys(key[i] for key in lines)) for i in (0, 1))
    figure = Figure(figsize=(2.3 * len(names) + 0.6, 2.0 * len(runs) + 0.9), layout="constrained")
    panels = figure.subplots(len(runs), len(names), sharex=True, sharey=True, squeeze=False)
    for (run, name), line in lines.items():
        ax = panels[runs.index(run), names.index(name)]
        for score, (label, colour) in CURVES.items():
            ax.plot(line[axis], line[score], color=colour, marker="o", markersize=2.5, linewidth=1.2, label=label)
        best = int(line.kappa.values.argmax())
        ax.plot(line[axis][best], line.kappa[best], "o", markersize=7, color="none", markeredgecolor=CURVES["kappa"][1])
        ax.axvline(chosen[name][axis], color="0.4", linestyle=":", linewidth=1.2)
        ax.set_ylim(0, 100)
        ax.set_xticks(line[axis].values[::2], [f"{value:g}" for value in line[axis].values[::2]])
        ax.tick_params(labelsize=8)
        ax.grid(color="0.92", linewidth=0.6)
        ax.spines[["top", "right"]].set_visible(False)
    for ax, name in zip(panels[0], names, strict=True):
        ax.set_title(f"{name} ({chosen[name]['terrain']})", fontsize=10)
    for ax, run in zip(panels[:, 0], runs, strict=True):
        ax.set_ylabel(f"{run} (%)", fontsize=9)
    unit = {"max_angle": "largest angle a (degrees)", "max_elevation": "largest relative elevation e (m)"}[axis]
    figure.supxlabel(unit, fontsize=9)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(CURVES), frameon=False, fontsize=9)
    return figure


def time_fit(points: Sequence[float], seconds: Sequence[float]) -> tuple[float, float, float]:
    """Least-squares line of seconds against millions of points: slope, intercept, and R squared."""
    line = linregress(np.asarray(points, float) / 1e6, np.asarray(seconds, float))
    return float(line.slope), float(line.intercept), float(line.rvalue**2)


def time_against_points(tables: Mapping[str, Sequence[Row]], path: Path, dpi: int) -> None:
    """Fig. 7: ``seconds`` against number of ``points`` of each ``site`` with a line; a panel per title of ``tables``."""
    figure = Figure(figsize=(3.5 * len(tables), 3.0), layout="constrained")
    for ax, (title, table) in zip(figure.subplots(1, len(tables)), tables.items(), strict=True):
        points, seconds = np.array([r["points"] for r in table]), np.array([r["seconds"] for r in table])
        slope, intercept, r2 = time_fit(points, seconds)
        line = np.array([0.0, points.max() * 1.05])
        ax.plot(
            line / 1e3,
            slope * line / 1e6 + intercept,
            color="0.6",
            linewidth=1,
            zorder=1,
            label=f"{slope:.3g} s per million {intercept:+.2g} s, R² = {r2:.3f}",
        )
        ax.scatter(points / 1e3, seconds, s=16, color=INK, zorder=2)
        for rank, row in enumerate(sorted(table, key=lambda r: r["points"])):
            place = {"xytext": (-4, 3), "ha": "right"} if rank % 2 else {"xytext": (4, -6), "ha": "left"}
            ax.annotate(
                row["site"][0] + row["site"][-1],
                (row["points"] / 1e3, row["seconds"]),
                fontsize=6,
                textcoords="offset points",
                **place,
            )
        ax.set(
            title=title, xlabel="points (thousands)", ylabel="seconds", xlim=(0, None), ylim=(0, seconds.max() * 1.3)
        )
        ax.title.set_fontsize(10)
        ax.legend(frameon=False, fontsize=7, loc="upper left")
        ax.spines[["top", "right"]].set_visible(False)
    save_png(figure, path, dpi)


def sample(name: str, cloud: jf.PointCloud, results: dict[str, jf.FilterResult], path: Path, dpi: int) -> None:
    """Figs. 9 to 12: reference, seeds, PTD and FPTD as error maps, and a section through the worst of both."""
    width, height = np.ptp(cloud.xyz[:, :2], axis=0)
    map_height = 4.0 * float(height / width) + 0.8
    figure = Figure(figsize=(9.0, 2 * map_height + 3.6), layout="constrained")
    places = figure.add_gridspec(4, 2, height_ratios=(map_height, map_height, 1.8, 1.8))
    maps = [figure.add_subplot(places[i // 2, i % 2]) for i in range(4)]
    surface = plots.rasterise(cloud.xyz[cloud.reference], over=cloud.xyz)
    _reference(maps[0], cloud, surface, f"(a) {name}, reference")
    _seeds(maps[1], name, cloud, surface, results)
    strip = 4.0
    line = _worst_line(cloud, results, strip)
    for i, method in enumerate(("ptd", "fptd")):
        ax = maps[2 + i]
        scores = jf.evaluate(results[method], cloud.reference)
        title = f"({'cd'[i]}) {method.upper()}, total error {scores.total:.2f} %"
        plots.error_map(cloud, results[method], cloud.reference, surface=surface, ax=ax, title=title)
        ax.plot(*np.array(line).T, color="k", linewidth=0.6, linestyle=(0, (4, 3)))
        section = figure.add_subplot(places[2 + i, :])
        plots.profile(
            cloud,
            results[method],
            line,
            strip,
            reference=cloud.reference,
            ax=section,
            title=f"{method.upper()}, section at y = {line[0][1]:.0f} m, {strip:.0f} m wide",
        )
    for ax in maps:
        ax.set(xlabel="", ylabel="")
        ax.get_legend().set_bbox_to_anchor((0.5, -0.28 / (map_height - 0.8)), ax.transAxes)
    save_png(figure, path, dpi)


def _reference(ax: Any, cloud: jf.PointCloud, surface: Any, title: str) -> None:
    plots.error_map(cloud, cloud.reference, cloud.reference, surface=surface, ax=ax, title=title)
    ax.scatter([], [], s=14, marker="s", c=plots.OBJECT_COLOUR, label="objects, over the reference ground")
    _legend(ax)


def _seeds(ax: Any, name: str, cloud: jf.PointCloud, surface: Any, results: dict[str, jf.FilterResult]) -> None:
    printed = next(row for row in samples.published("li2021_seeds") if row["sample"] == name)
    plots.hillshade(surface, ax=ax, title="(b) seeds")
    for method, marker, size, colour in (("ptd", "s", 20, SEED_PTD), ("fptd", "o", 5, SEED)):
        result = results[method]
        where = result.decision == jf.Decision.SEED
        ax.scatter(
            *cloud.xyz[where, :2].T,
            s=size,
            marker=marker,
            linewidths=0.8,
            edgecolors=colour,
            facecolors="none" if method == "ptd" else colour,
            label=f"{method.upper()}: {result.info['seeds']} and {result.info['border_points']} simulated; "
            f"printed, together: {printed[method]}",
        )
    _legend(ax)


def _legend(ax: Any) -> None:
    ax.legend(loc="upper center", frameon=False, fontsize=7, handletextpad=0.4)


def _worst_line(
    cloud: jf.PointCloud, results: dict[str, jf.FilterResult], strip: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """West to east through the strip with the most errors of PTD and FPTD together."""
    wrong = np.concatenate([cloud.xyz[r.ground != cloud.reference, 1] for r in results.values()])
    count = np.bincount((wrong / strip).astype(int))
    y = (float(np.argmax(count)) + 0.5) * strip
    return (0.0, y), (float(cloud.xyz[:, 0].max()), y)


def site(name: str, cloud: jf.PointCloud, result: jf.FilterResult, path: Path, dpi: int) -> None:
    """Fig. 8: the points and the filtered ground by elevation, with a section from north to south and one from west to east."""
    figure = Figure(figsize=(9.0, 7.2), layout="constrained")
    places = figure.add_gridspec(3, 2, height_ratios=(3.4, 1, 1))
    found = plots.rasterise(cloud.xyz[result.ground], over=cloud.xyz)
    limits = np.nanpercentile(found[0], (1, 99))
    highest = _highest(cloud.xyz[cloud.xyz[:, 2] < np.nanmax(found[0]) + 60], found[1])
    x, y = (float(v) for v in cloud.xyz[:, :2].max(axis=0) / 2)
    end_x, end_y = 2 * x, 2 * y
    surfaces = (("(a) highest points", highest), (f"(b) ground, {int(result.ground.sum()):,} points", found[0]))
    for i, (title, z) in enumerate(surfaces):
        ax = figure.add_subplot(places[0, i])
        plots.hillshade((z, found[1]), ax=ax, title=f"{name} {title}")
        extent = (
            found[1].x0,
            found[1].x0 + found[1].nx * found[1].cell,
            found[1].y0,
            found[1].y0 + found[1].ny * found[1].cell,
        )
        tint = ax.imshow(
            z,
            cmap="viridis",
            vmin=limits[0],
            vmax=limits[1],
            alpha=0.45,
            extent=extent,
            origin="lower",
            interpolation="nearest",
        )
        ax.plot([x, x], [0, end_y], [0, end_x], [y, y], color="#c1121f", linewidth=0.8)
    figure.colorbar(tint, ax=ax, label="height (m)", shrink=0.8)
    sections = (
        (f"section at x = {x:.0f} m, from south to north", ((x, 0.0), (x, end_y))),
        (f"section at y = {y:.0f} m, from west to east", ((0.0, y), (end_x, y))),
    )
    for i, (title, line) in enumerate(sections):
        ax = figure.add_subplot(places[1 + i, :])
        plots.profile(cloud, result, line, 5.0, ax=ax, title=title)
        ax.set_ylim(limits[0] - 15, limits[1] + 45)
    save_png(figure, path, dpi)


def _highest(xyz: np.ndarray, grid: Grid) -> np.ndarray:
    """f32[ny, nx]: the highest point of each cell and its eight neighbours, NaN where there is none."""
    z = np.full(grid.ny * grid.nx, -np.inf, np.float32)
    np.maximum.at(z, grid.flat(xyz), xyz[:, 2])
    z = ndimage.maximum_filter(z.reshape(grid.shape), 3)
    return np.where(np.isfinite(z), z, np.nan)
