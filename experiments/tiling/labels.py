"""Labels of tiles against those of the whole: how many differ, by method and halo."""

from __future__ import annotations

import dataclasses
import functools
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import jaxfilter as jf
from experiments.report import Row
from jaxfilter.core.compilation import keep_compilations
from jaxfilter.core.filter import lowest_among
from jaxfilter.surveys.collection import Collection
from jaxfilter.surveys.measures import Sampler
from jaxfilter.surveys.plan import plan_tiles, where_of
from jaxfilter.surveys.product import Cut
from jaxfilter.surveys.run import tile_of
from jaxfilter.surveys.tiles import joined, part_of, read_tile

READING = jf.Reading(returns="all", ignore_classes=(7, 18), units="m")
"""What producers set apart is filtered like the rest."""
LEFT_OUT = (0, 7, 9, 12, 18, 26, 65, 66, 67)
"""Classes that are not scored, as in ``experiments/tiles``."""


@dataclasses.dataclass(frozen=True, eq=False)
class Survey:
    """A collection in one cloud: n points in the order of the files, and bool[n], truth and points that are scored."""

    collection: Collection
    cloud: jf.PointCloud
    truth: np.ndarray
    scored: np.ndarray
    first: np.ndarray


def generated(folder: Path, side: int, files: int, density: float, layout: str = "mixed") -> list[Path]:
    """``files`` times ``files`` LAZ files of a simulated scene of ``side`` metres, with the truth as classes."""
    name = folder / f"{layout}-{side}-{files}-{density:g}"
    paths = [name / f"{i}-{j}.laz" for i in range(files) for j in range(files)]
    if all(path.exists() for path in paths):
        return paths
    name.mkdir(parents=True, exist_ok=True)
    scene = jf.scenes.make(layout, size=float(side), density=density, seed=7)
    cloud = dataclasses.replace(scene.cloud, classification=scene.classes)
    cell = np.minimum(cloud.xyz[:, :2] // (side / files), files - 1).astype(int)
    for path, number in zip(paths, np.ndindex(files, files), strict=True):
        jf.write(path, part_of(cloud, (cell == number).all(axis=1)), None, overwrite=True)
    return paths


@functools.lru_cache(maxsize=1)
def survey(paths: tuple[Path, ...]) -> Survey:
    """Open files, and read them whole."""
    collection = jf.open([str(path) for path in paths], units="m")
    how = {"returns": READING.returns, "ignore_classes": READING.ignore_classes}
    clouds = [jf.read(path, units="m", **how) for path in paths]
    cloud = joined(clouds)
    assert cloud.classification is not None
    scored = ~np.isin(cloud.classification, LEFT_OUT)
    first = np.cumsum([0, *(len(one) for one in clouds)])
    return Survey(collection, cloud, cloud.classification == 2, scored, first)


def rows(
    name: str, paths: tuple[Path, ...], method: str, cuts: int, halos: Sequence[float | None], folder: Path
) -> list[Row]:
    """A row for every halo (None = the default) of a method on a survey. ``cuts``: tiles along each side."""
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    one, found = survey(paths), []
    filter_ = jf.FILTERS[method].for_cloud(one.cloud)
    whole = filter_(one.cloud, workers=1).ground
    total = jf.evaluate(whole, one.truth, ignore=~one.scored).total
    for asked in halos:
        halo = filter_.halo() if asked is None else asked
        ground, seen = tiled(one, filter_, cuts, halo)
        differ = int((ground != whole).sum())
        moved = jf.evaluate(ground, one.truth, ignore=~one.scored).total - total
        found.append({
            "survey": name, "method": method, "points": len(whole), "tiles": len(seen), "halo": halo,
            "seen": float(np.median(seen)), "differ": differ, "share": differ / len(whole), "total": total, "moved": moved,
        })  # fmt: skip
    return found


def tiled(one: Survey, filter_: jf.Filter, cuts: int, halo: float) -> tuple[np.ndarray, np.ndarray]:
    """bool[n]: labels of the tiles of a run; and f64[tiles], the share of all points that each tile with points sees.

    A tile that sees all points tests nothing: it is the whole.
    """
    files = one.collection
    low, high = np.reshape(files.bounds, (2, 2))
    side = float((high - low).max()) * files.metre / cuts
    plan = plan_tiles(where := where_of(files), Cut(halo, filter_.lattice()), side)
    whole = Sampler(files, READING, where).whole_for(filter_)
    lowest = lowest_among(filter_, points := filter_.points_of(one.cloud))
    if lowest is not None:
        height = float(points.xyz[lowest, 2].min())
        whole = dataclasses.replace(whole, lowest=float(one.cloud.origin[2]) + height)
    ground = np.zeros(len(one.cloud), bool)
    times = np.zeros(len(one.cloud), np.int8)
    seen = []
    for number in range(len(plan)):
        around = read_tile(tile_of(plan, files, number), READING, whole)
        if not around.core.any():
            continue
        at = one.first[around.file[around.core]] + around.record[around.core]
        ground[at] = filter_(around.cloud, workers=1).ground[around.core]
        times[at] += 1
        seen.append(len(around.cloud) / len(one.cloud))
    if not (times == 1).all():
        raise AssertionError(f"{int((times != 1).sum())} points have not exactly one label")
    return ground, np.array(seen)


def draw(rows: Sequence[Row], path: Path) -> None:
    """A picture of the share of labels that differ against the halo, a line for every method."""
    from matplotlib.figure import Figure

    axes = Figure(figsize=(7.0, 4.2), layout="constrained").subplots()
    least = 50 / max(row["points"] for row in rows)
    for number, name in enumerate(dict.fromkeys(row["method"] for row in rows)):
        own = [row for row in rows if row["method"] == name]
        line = {"marker": "os^Dv"[number // 10 % 5], "ls": ("-", "--")[number // 10], "color": f"C{number % 10}"}
        share = [max(100 * row["share"], least) for row in own]
        axes.plot([row["halo"] for row in own], share, ms=4, lw=1.2, label=name.upper(), **line)
    axes.set_yscale("log")
    axes.axhline(least, color="0.8", lw=0.8, zorder=0)
    axes.text(axes.get_xlim()[0], least, " none", ha="left", va="bottom", color="0.4", fontsize=8)
    axes.set_xlabel("halo, m")
    axes.set_ylabel("labels that differ from the whole, %")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)
    axes.figure.savefig(path, dpi=150)
