"""Pictures of what a method does, step by step, on one simulated town: `python docs/stages.py FOLDER` draws them all."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import jaxfilter as jf
from jaxfilter.core.grid import Grid
from jaxfilter.steps.grid_filter import GridFilter
from jaxfilter.steps.tin_filter import TinFilter


@cache
def scene() -> jf.scenes.Scene:
    """The town that all pictures show."""
    return jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)


def inner(values: Any, surface: Any) -> tuple[np.ndarray, Grid]:
    """The cells that exist of a padded array, and their grid."""
    rows, columns = (int(n) for n in surface.grid.shape)
    x0, y0, cell = (float(v) for v in (surface.grid.x0, surface.grid.y0, surface.grid.cell))
    return np.asarray(values)[:rows, :columns], Grid(x0, y0, cell, columns, rows)


def shaded(xyz: np.ndarray) -> Callable[[Any], None]:
    """A panel with the relief of points."""
    return lambda ax: jf.plots.hillshade(jf.plots.rasterise(xyz, 1.0, over=scene().cloud.xyz), ax=ax)


def dots(rows: np.ndarray) -> Callable[[Any], None]:
    """A panel with points over the relief of the whole cloud."""

    def draw(ax: Any) -> None:
        xyz = scene().cloud.xyz
        shaded(xyz)(ax)
        ax.scatter(*xyz[rows, :2].T, s=28 if rows.sum() < 100 else 2, c=jf.plots.TYPE_1, linewidths=0)

    return draw


def coloured(values: tuple[np.ndarray, Grid], label: str, **style: Any) -> Callable[[Any], None]:
    """A panel with a quantity per cell; a colour bar if it has a label."""

    def draw(ax: Any) -> None:
        z, grid = values
        extent = (grid.x0, grid.x0 + grid.nx * grid.cell, grid.y0, grid.y0 + grid.ny * grid.cell)
        image = ax.imshow(z, extent=extent, origin="lower", interpolation="nearest", **{"cmap": "viridis", **style})
        if label:
            ax.figure.colorbar(image, ax=ax, label=label, shrink=0.8)

    return draw


def relief(values: tuple[np.ndarray, Grid]) -> Callable[[Any], None]:
    """A panel with the relief of a surface of cells."""
    return lambda ax: jf.plots.hillshade(values, ax=ax)


Stage = tuple[str, Callable[[Any], None]]


def grown(result: jf.FilterResult) -> list[Stage]:
    """Of methods that grow a triangulation or a set of references: seeds, the first round, one in the middle."""
    xyz, trace = scene().cloud.xyz, result.trace
    seeds = result.decision == jf.Decision.SEED
    first, middle = trace[0]["ground"] | seeds, trace[len(trace) // 2]["ground"] | seeds
    if seeds.sum() < 100:
        return [
            (f"seeds ({seeds.sum():,})", dots(seeds)),
            (f"ground after round 1 ({first.sum():,} points)", shaded(xyz[first])),
            (f"after round {len(trace) // 2 + 1} of {len(trace)} ({middle.sum():,})", shaded(xyz[middle])),
        ]
    return [
        (f"seeds ({seeds.sum():,})", dots(seeds)),
        ("relief of the seeds", shaded(xyz[seeds])),
        (f"ground after round 1 of {len(trace)} ({first.sum():,} points)", shaded(xyz[first])),
    ]


def gridded(filter_: GridFilter) -> list[Stage]:
    """Of methods that make a surface of cells: the lowest points, what changes them, the surface."""
    points = filter_.points_of(scene().cloud)
    cells = filter_.cells(points)
    prepared, surface = filter_.prepare(cells), filter_.model(cells)
    filled = jf.plots.rasterise(scene().cloud.xyz, float(filter_.cell), over=scene().cloud.xyz)  # type: ignore[attr-defined]
    lowest: Stage = ("lowest point of each cell", relief(filled))
    if isinstance(filter_, jf.SMRF):
        drop = inner(np.minimum(np.asarray(prepared.steepest), 1.0), cells)
        marked: Stage = ("largest drop per cell of radius", coloured(drop, "m, at most 1", vmin=0, vmax=1))
        return [lowest, marked, ("terrain without objects", relief(inner(surface.z, surface)))]
    z, name = np.asarray(surface.z), "opened with the largest window"
    if isinstance(filter_, jf.MSF):
        name = "lowest elevation that the slope allows"
    known = np.isfinite(z) & np.asarray(cells.seen)
    lowered = inner(np.subtract(cells.lowest, z, out=np.zeros_like(z), where=known), cells)
    change: Stage = ("cells above that surface", coloured(lowered, "m", vmin=0, vmax=3))
    return [lowest, (name, relief(inner(z, surface))), change]


def draped(filter_: jf.CSF, result: jf.FilterResult) -> list[Stage]:
    """Of CSF: the cloud, the cloth, and how far points are from it."""
    xyz = scene().cloud.xyz
    judged = np.isfinite(result.height)
    cloth = xyz[judged].copy()
    cloth[:, 2] -= result.height[judged]
    grid = jf.plots.rasterise(xyz, 1.0)[1]
    above = np.full(grid.nx * grid.ny, np.nan)
    np.fmax.at(above, grid.flat(xyz[judged]), result.height[judged])
    return [
        ("lowest points", shaded(xyz)),
        (f"the cloth at rest, after {result.info['steps']} steps", shaded(cloth)),
        ("highest point over the cloth", coloured((above.reshape(grid.shape), grid), "m", vmin=0, vmax=3)),
    ]


def segmented(filter_: jf.OST) -> list[Stage]:
    """Of OST: drops in terms of their limit, cells that are objects, ground of the cells."""
    points = filter_.points_of(scene().cloud)
    found = filter_.measured(points, None)
    limit = filter_.judge(found, filter_.active())
    share, grid = inner(np.minimum(found.steepest / limit, 3.0), found.cells)
    kept = points.xyz[found.lowest]
    kept = kept[~found.objects.ravel()[grid.flat(kept)]]
    return [
        ("steepest drop, in terms of the limit", coloured((share, grid), "at most 3; cells above 1 are marked")),
        ("cells that are objects, segments joined", coloured((found.objects, grid), "", cmap="cividis")),
        (f"relief of the seeds ({len(kept):,})", shaded(kept)),
    ]


def steps(name: str) -> tuple[list[Stage], jf.FilterResult]:
    """The stages of a method, and its result."""
    filter_ = jf.FILTERS[name].for_cloud(scene().cloud)
    result = filter_(scene().cloud, trace=True)
    if isinstance(filter_, TinFilter) or result.trace:
        return grown(result), result
    if isinstance(filter_, GridFilter):
        return gridded(filter_), result
    return (segmented(filter_) if isinstance(filter_, jf.OST) else draped(filter_, result)), result


def draw(name: str, path: Path) -> str:
    """Draw the stages of a method; returns the caption."""
    found, result = steps(name)
    truth = scene().truth
    scores = jf.evaluate(result, truth, candidates_only=True)
    last: Stage = (
        f"errors: {scores.total:.1f} %",
        lambda ax: jf.plots.error_map(scene().cloud, result, truth, ax=ax),
    )
    figure = Figure(figsize=(8.0, 7.4), layout="constrained")
    for ax, (title, panel) in zip(figure.subplots(2, 2).ravel(), [*found, last], strict=True):
        panel(ax)
        ax.set_title(title, fontsize=10)
        ax.set(xticks=[], yticks=[], xlabel="", ylabel="")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    titles = "; ".join(title for title, _ in found)
    return (
        f"{name.upper()} on a simulated town of 90 x 80 m with {len(scene()):,} points, set up by `for_cloud`: {titles}; "
        f"and the errors, {scores.total:.1f} % of the judged points."
    )


def sample_report(path: Path) -> None:
    """The report of SMRF on the town."""
    filter_ = jf.SMRF.for_cloud(scene().cloud)
    path.parent.mkdir(parents=True, exist_ok=True)
    jf.report(scene().cloud, filter_(scene().cloud), path, reference=scene().truth, overwrite=True)


if __name__ == "__main__":
    for method in jf.FILTERS:
        print(draw(method, Path(sys.argv[1]) / f"{method}.png"))
