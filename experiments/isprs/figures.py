"""The pictures: where every method errs on a few samples, its total errors at a glance, and accuracy against time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LightSource, LogNorm, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

import jaxfilter as jf
from experiments.report import Row, save_png
from jaxfilter import plots

SHOWN = ("11", "23", "41", "53")
"""Samples of the panel of error maps: wooded hillside with houses, large building complex, low outliers, terraces."""


def error_panel(
    clouds: Mapping[str, jf.PointCloud],
    labels: Mapping[tuple[str, str], np.ndarray],
    methods: Sequence[str],
    path: Path,
    dpi: int,
) -> None:
    """Rows are samples, columns the reference and every method; ``labels``: bool[n] by sample and method."""
    pictures = {name: _Picture(cloud) for name, cloud in clouds.items()}
    heights = [p.aspect for p in pictures.values()]
    width = 1.05
    figure = Figure(
        figsize=(width * (len(methods) + 1) + 0.3, width * sum(heights) + 0.32 * len(heights) + 0.4),
        layout="constrained",
    )
    figure.get_layout_engine().set(w_pad=0.01, h_pad=0.01, wspace=0.0, hspace=0.0)
    axes = figure.subplots(len(clouds), len(methods) + 1, squeeze=False, height_ratios=heights)
    for i, (name, cloud) in enumerate(clouds.items()):
        for j, method in enumerate(("reference", *methods)):
            ax = axes[i, j]
            ground = cloud.reference if j == 0 else labels.get((name, method))
            ax.set(xticks=[], yticks=[])
            ax.spines[:].set_linewidth(0.4)
            if i == 0:
                ax.set_title(method.upper() if j else "reference", fontsize=8)
            if j == 0:
                ax.set_ylabel(f"{name}\n{np.ptp(cloud.xyz[:, 0]):.0f} m wide", fontsize=7)
            if ground is None:
                ax.text(0.5, 0.5, "failed", transform=ax.transAxes, ha="center", fontsize=7)
                ax.set_box_aspect(pictures[name].aspect)
                continue
            ax.imshow(pictures[name].draw(ground), origin="lower", interpolation="nearest")
            if j:
                ax.set_xlabel(f"{jf.evaluate(ground, cloud.reference).total:.1f} %", fontsize=7, labelpad=2)
    handles = [
        Patch(color=colour, label=label)
        for colour, label in (
            (plots.OBJECT_COLOUR, "object, found"),
            (plots.TYPE_1, "Type I: ground lost"),
            (plots.TYPE_2, "Type II: object accepted"),
        )
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    save_png(figure, path, dpi)


class _Picture:
    """Shaded reference ground of a cloud, ready to be overlaid with labels."""

    def __init__(self, cloud: jf.PointCloud) -> None:
        surface, grid = plots.rasterise(cloud.xyz[cloud.reference], over=cloud.xyz)
        shade = LightSource(315, 45).hillshade(
            np.nan_to_num(surface, nan=np.nanmean(surface)), dx=grid.cell, dy=-grid.cell
        )
        self.base = np.repeat((0.35 + 0.65 * shade)[:, :, None], 3, axis=2)
        self.cell = grid.flat(cloud.xyz)
        self.truth = cloud.reference
        self.aspect = grid.ny / grid.nx

    def draw(self, ground: np.ndarray) -> np.ndarray:
        """f64[ny, nx, 3]: found objects tint the cells, errors fill them."""
        picture = self.base.copy()
        pixels = picture.reshape(-1, 3)
        found = np.unique(self.cell[~ground & ~self.truth])
        pixels[found] = 0.45 * pixels[found] + 0.55 * np.array(to_rgb(plots.OBJECT_COLOUR))
        pixels[self.cell[ground & ~self.truth]] = to_rgb(plots.TYPE_2)
        pixels[self.cell[~ground & self.truth]] = to_rgb(plots.TYPE_1)
        return picture


def heat_tables(
    rows: Mapping[str, Sequence[Row]], methods: Sequence[str], path: Path, dpi: int, key: str = "total"
) -> None:
    """One coloured table of ``key`` per protocol: methods by samples, with the mean; the best of each column is bold."""
    names = list(dict.fromkeys(row["sample"] for table in rows.values() for row in table))
    figure = Figure(
        figsize=(0.52 * (len(names) + 1) + 1.2, len(rows) * (0.24 * len(methods) + 0.55) + 0.3), layout="constrained"
    )
    axes = figure.subplots(len(rows), 1, squeeze=False)[:, 0]
    values = {p: _matrix(table, methods, names, key) for p, table in rows.items()}
    every = np.concatenate([v.ravel() for v in values.values()])
    norm = LogNorm(max(0.5, np.nanmin(every)), max(1.0, np.nanmax(every)))
    for ax, (protocol, matrix) in zip(axes, values.items(), strict=True):
        ax.imshow(np.clip(matrix, norm.vmin, None), norm=norm, cmap="cividis_r", aspect="auto")
        best = np.nanmin(np.where(np.isnan(matrix), np.inf, matrix), axis=0)
        for (i, j), value in np.ndenumerate(matrix):
            dark = norm(max(value, norm.vmin)) > 0.55
            ax.text(
                j,
                i,
                "–" if np.isnan(value) else f"{value:.1f}",
                ha="center",
                va="center",
                fontsize=6.5,
                color="white" if dark else "black",
                weight="bold" if value == best[j] else "normal",
            )
        ax.set_xticks(range(len(names) + 1), [*(n.removeprefix("samp") for n in names), "mean"], fontsize=7)
        ax.set_yticks(range(len(methods)), [m.upper() for m in methods], fontsize=7)
        ax.axvline(len(names) - 0.5, color="white", linewidth=2)
        ax.set_title(f"{protocol}: total error, %", fontsize=9, loc="left")
        ax.tick_params(length=0)
        ax.spines[:].set_visible(False)
    save_png(figure, path, dpi)


def _matrix(rows: Sequence[Row], methods: Sequence[str], names: Sequence[str], key: str) -> np.ndarray:
    """f64[methods, samples + 1], the last column the mean over the samples."""
    value = {(row["method"], row["sample"]): row[key] for row in rows}
    matrix = np.array([[value.get((m, s), np.nan) for s in names] for m in methods], float)
    return np.column_stack([matrix, matrix.mean(axis=1)])


def accuracy_against_time(summaries: Sequence[Row], path: Path, dpi: int) -> None:
    """Mean kappa against seconds per million points, fixed protocol, one mark per method."""
    figure = Figure(figsize=(4.6, 3.4), layout="constrained")
    ax = figure.subplots()
    ax.set(xscale="log", xlabel="seconds per million points", ylabel="mean kappa, %")
    ax.spines[["top", "right"]].set_visible(False)
    ax.margins(0.12)
    marks = [
        (row["seconds_per_million"], row["kappa"], row["method"]) for row in summaries if "seconds_per_million" in row
    ]
    for seconds, kappa, _ in marks:
        ax.scatter(seconds, kappa, s=22, color="#1b4965")
    figure.draw_without_rendering()
    taken: list[Any] = []
    for seconds, kappa, method in sorted(marks, key=lambda mark: -mark[1]):
        for x, y, side in ((5, 3, "left"), (5, -8, "left"), (-5, 3, "right"), (-5, -8, "right")):
            place: dict[str, Any] = {"textcoords": "offset points", "xytext": (x, y), "ha": side, "fontsize": 7}
            text = ax.annotate(method.upper(), (seconds, kappa), **place)
            box = text.get_window_extent()
            if not any(box.overlaps(other) for other in taken):
                break
            text.remove()
        else:
            text = ax.annotate(method.upper(), (seconds, kappa), **place)
        taken.append(text.get_window_extent())
    save_png(figure, path, dpi)
