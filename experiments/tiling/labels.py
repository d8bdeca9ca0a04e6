"""Labels of tiles against those of the whole: how many differ, by method and halo."""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import jaxfilter as jf
from experiments.report import Row
from jaxfilter.core.filter import lowest_among
from jaxfilter.surveys.collection import Collection
from jaxfilter.surveys.measures import Sampler
from jaxfilter.surveys.plan import plan_tiles
from jaxfilter.surveys.run import tile_of
from jaxfilter.surveys.tiles import joined, read_tile

READING = jf.Reading(returns="all", ignore_classes=(7, 18), units="m")
"""What producers set apart is filtered like the rest."""
LEFT_OUT = (0, 7, 9, 12, 18, 26, 65, 66, 67)
"""Classes that are not scored, as in ``experiments/tiles``."""


@dataclasses.dataclass(frozen=True, eq=False)
class Survey:
    """A collection in one cloud: n points in the order of the files, and bool[n], truth and points that are scored."""

    name: str
    collection: Collection
    cloud: jf.PointCloud
    truth: np.ndarray
    scored: np.ndarray
    first: np.ndarray


def survey(name: str, paths: Sequence[Path]) -> Survey:
    """Open files, and read them whole."""
    collection = jf.open([str(path) for path in paths], units="m")
    how = {"returns": READING.returns, "ignore_classes": READING.ignore_classes}
    clouds = [jf.read(path, units="m", **how) for path in paths]
    cloud = joined(clouds)
    assert cloud.classification is not None
    scored = ~np.isin(cloud.classification, LEFT_OUT)
    first = np.cumsum([0, *(len(one) for one in clouds)])
    return Survey(name, collection, cloud, cloud.classification == 2, scored, first)


def rows(one: Survey, methods: Sequence[str], cuts: int, halos: Sequence[float | None], folder: Path) -> Iterator[Row]:
    """A row for every method and halo (None = the default); ``cuts``: tiles along each side."""
    for name in methods:
        filter_ = jf.FILTERS[name].for_cloud(one.cloud)
        whole = filter_(one.cloud, workers=1).ground
        total = jf.evaluate(whole, one.truth, ignore=~one.scored).total
        for asked in halos:
            halo = filter_.halo() if asked is None else asked
            start = time.process_time()
            ground, seen = tiled(one, filter_, cuts, halo, folder)
            differ = int((ground != whole).sum())
            scores = jf.evaluate(ground, one.truth, ignore=~one.scored)
            row = {
                "survey": one.name, "method": name, "points": len(whole), "tiles": len(seen), "halo": halo,
                "partial": int((seen < 1).sum()), "seen": float(np.median(seen)),
                "default": asked is None, "differ": differ, "share": differ / len(whole), "total": total,
                "moved": scores.total - total, "cpu": time.process_time() - start,
            }  # fmt: skip
            print(
                f"{one.name:28} {name:6} halo {halo:5.0f} m {len(seen):3} tiles, {row['partial']} partial: "
                f"{differ:6} labels differ, "
                f"{100 * differ / len(whole):.4f} %, total error {total:.3f} % {scores.total - total:+.3f}",
                file=sys.stderr,
                flush=True,
            )
            yield row


def tiled(one: Survey, filter_: jf.Filter, cuts: int, halo: float, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """bool[n]: labels of the tiles of a run; and f64[tiles], the share of all points that each tile with points sees.

    A tile that sees all points tests nothing: it is the whole.
    """
    files = one.collection
    low, high = np.reshape(files.bounds, (2, 2))
    plan = plan_tiles(
        files.footprints,
        files.counts,
        metre=files.metre,
        halo=halo,
        lattice=filter_.lattice(),
        side=float((high - low).max()) * files.metre / cuts,
    )
    width, height = plan.largest()
    whole = Sampler(files, READING, folder / "index").whole_for(filter_)
    whole = dataclasses.replace(whole, width=width * files.metre, height=height * files.metre)
    lowest = lowest_among(filter_, points := filter_.points_of(one.cloud))
    if lowest is not None:
        height = float(points.xyz[lowest, 2].min())
        whole = dataclasses.replace(whole, lowest=float(one.cloud.origin[2]) + height)
    tiles = [tile_of(plan, files, number) for number in range(len(plan))]
    ground = np.zeros(len(one.cloud), bool)
    times = np.zeros(len(one.cloud), np.int8)
    seen = []
    for tile in tiles:
        around = read_tile(tile, READING, whole, folder / "index")
        if not around.core.any():
            continue
        found = filter_(around.cloud, workers=1).ground[around.core]
        at = one.first[around.file[around.core]] + around.record[around.core]
        ground[at] = found
        times[at] += 1
        seen.append(len(around.cloud) / len(one.cloud))
    if not (times == 1).all():
        raise AssertionError(f"{int((times != 1).sum())} points have not exactly one label")
    return ground, np.array(seen)


def draw(rows: Sequence[Row], path: Path) -> None:
    """A picture of the share of labels that differ against the halo, a line for every method."""
    from matplotlib.figure import Figure

    axes = Figure(figsize=(7.0, 4.2), layout="constrained").subplots()
    names = list(dict.fromkeys(row["method"] for row in rows))
    least = 1 / max(row["points"] for row in rows)
    for number, name in enumerate(names):
        own = [row for row in rows if row["method"] == name]
        share = [max(100 * row["share"], 50 * least) for row in own]
        axes.plot(
            [row["halo"] for row in own], share, marker="os^Dv"[number // 10 % 5], ms=4, lw=1.2,
            color=f"C{number % 10}", ls=("-", "--")[number // 10], label=name.upper(),
        )  # fmt: skip
    axes.set_yscale("log")
    axes.axhline(50 * least, color="0.8", lw=0.8, zorder=0)
    axes.text(axes.get_xlim()[0], 50 * least, " none", ha="left", va="bottom", color="0.4", fontsize=8)
    axes.set_xlabel("halo, m")
    axes.set_ylabel("labels that differ from the whole, %")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)
    axes.figure.savefig(path, dpi=150)
