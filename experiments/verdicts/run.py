"""What verdicts on places are worth: errors left after so many places per square kilometre, in three orders. See README.md.

    python experiments/verdicts/run.py
    python experiments/verdicts/run.py --scenes 0.25    # a quarter of the length of each scene, for a quick look

What is done lies in ``--out`` and is not done again.
"""

from __future__ import annotations

import argparse
import dataclasses
import shlex
import sys
import warnings
from pathlib import Path

import geopandas
import numpy as np
import pandas as pd
import shapely

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.defaults.clouds import Known
from experiments.failures.run import FILLED, SEED, SIZES, SWATH, load
from experiments.isprs import samples
from experiments.report import Column, Row, markdown, read_csv, save_png, write_csv, write_page
from jaxfilter.core.compilation import keep_compilations
from jaxfilter.reports.places import OFF, SIDE, places_of, suspects
from jaxfilter.reports.verdicts import RIM
from jaxfilter.terrain import layer
from jaxfilter.terrain.models import interpolated
from jaxfilter.terrain.raster import RasterGrid

HERE = Path(__file__).parent
MOST, RATES, NEAR, ENOUGH = 2500.0, (5, 10, 20, 50), 3.0, 50
"""Square metres of a place, at most; places per square kilometre; metres to reference ground within which cells count; cells
that are off in a cloud whose share counts in the mean of clouds."""
ORDERS = {
    "list": "in the order of the list",
    "random": "places of the list at random",
    "points": "around isolated points",
    "edited": "of the list, every point there as in the reference",
}
WORDS = ("ground", "object", "fine")
GROUPS, TOGETHER = ("tiles", "scenes", "hard tiles"), "tiles and scenes"


@dataclasses.dataclass
class Site:
    """A cloud, what OST has made of it, and the terrain by its reference, f32[rows, columns], metres."""

    known: Known
    result: jf.FilterResult
    grid: RasterGrid
    truth: np.ndarray

    @classmethod
    def of(cls, known: Known) -> Site:
        cloud = known.cloud
        grid = RasterGrid.over(layer.extent_of(cloud), 1.0 / cloud.units.xy, cloud.units.xy)
        near = dataclasses.replace(FILLED, max_gap=NEAR / cloud.units.xy)
        truth = interpolated(layer.Site(cloud, known.ground, grid, interpolation=near))
        return cls(known, jf.default_filter(cloud)(cloud), grid, truth)

    def off(self, ground: np.ndarray) -> np.ndarray:
        """bool[rows, columns]: cells whose terrain is off by these labels, bool[n]."""
        model = interpolated(layer.Site(self.known.cloud, ground, self.grid, interpolation=FILLED))
        return np.abs(model.astype(float) - self.truth) * self.known.cloud.units.z > OFF

    def errors(self, ground: np.ndarray) -> Row:
        """Wrong points and cells by these labels, with how many count."""
        known, off = self.known, self.off(ground)
        wrong = (ground != known.ground) & known.scored
        counted = int(np.isfinite(self.truth).sum())
        return {"wrong": int(wrong.sum()), "points": int(known.scored.sum()), "off": int(off.sum()), "cells": counted}


def listed(site: Site) -> geopandas.GeoDataFrame:
    """The places of the list, in parts of at most :data:`MOST`, with the expected error volume of each."""
    cloud = site.known.cloud
    found = suspects(cloud, site.result)
    error = {tuple(cell): float(e) for cell, e in zip(found.cell.tolist(), found.error, strict=True)}
    parts = [part for place in places_of(found, cloud.units.xy) for part in _halved(place.cells)]
    side = SIDE / cloud.units.xy
    shapes = [
        shapely.union_all(shapely.box(*(cells * side).T, *((cells + 1) * side).T), grid_size=side / 1e4)
        for cells in parts
    ]
    volume = [SIDE**2 * sum(error[tuple(cell)] for cell in cells.tolist()) for cells in parts]
    return geopandas.GeoDataFrame({"key": volume}, geometry=shapes)


def _halved(cells: np.ndarray) -> list[np.ndarray]:
    """Cells i32[k, 2] in parts of at most :data:`MOST`, cut across the longer side."""
    if len(cells) * SIDE**2 <= MOST:
        return [cells]
    axis = int(np.argmax(np.ptp(cells, axis=0)))
    high = cells[:, axis] > np.median(cells[:, axis])
    return [*_halved(cells[~high]), *_halved(cells[high])] if high.any() else [cells]


def around_points(site: Site, count: int, radius: float) -> geopandas.GeoDataFrame:
    """Circles of so many metres around the most doubtful points, none of which lies in the circle of another."""
    cloud, doubt = site.known.cloud, np.nan_to_num(site.result.doubt)
    xy, chosen = cloud.coordinates()[:, :2] * cloud.units.xy, []
    for row in np.argsort(-doubt, kind="stable").tolist():
        if all(np.hypot(*(xy[row] - xy[other])) > 2 * radius for other in chosen):
            chosen.append(row)
            if len(chosen) == count:
                break
    shapes = shapely.buffer(shapely.points(xy[chosen] / cloud.units.xy), radius / cloud.units.xy)
    return geopandas.GeoDataFrame({"key": doubt[chosen].astype(float)}, geometry=shapes)


def verdicts(site: Site, places: geopandas.GeoDataFrame) -> list[str]:
    """What the reference says of each place: that with which the fewest cells are off, in it and in its rim.

    ``fine`` is the terrain as it is, ``object`` and ``ground`` that which follows if the same is said of all places. If two are
    equal, it is the first of these.
    """
    x, y = site.grid.centres()
    words, counts = ("fine", "object", "ground"), []
    for word in words:
        ground = site.result.ground
        if word != "fine":
            ground = jf.apply(site.result, places.assign(verdict=word)).ground
        row, column = np.nonzero(site.off(ground))
        points = shapely.points(x[column], y[row])
        held = shapely.STRtree(points).query(places.buffer(RIM / site.known.cloud.units.xy), predicate="contains")
        counts.append(np.bincount(held[0], minlength=len(places)))
    return [words[k] for k in np.argmin(counts, axis=0)]


def edited(site: Site, places: geopandas.GeoDataFrame) -> np.ndarray:
    """bool[n]: the labels, but those of the reference in places."""
    known, cloud = site.known, site.known.cloud
    xy = cloud.coordinates()[:, :2]
    inside = np.unique(shapely.STRtree(shapely.points(xy)).query(places.geometry, predicate="intersects")[1])
    ground = site.result.ground.copy()
    inside = inside[known.scored[inside]]
    ground[inside] = known.ground[inside]
    return ground


def prepared(site: Site, path: Path) -> geopandas.GeoDataFrame:
    """All places of a cloud in all orders; kept in a file."""
    if path.exists():
        return read_places(path)
    places = listed(site)
    area = float(np.prod(np.ptp(site.known.cloud.xyz[:, :2], axis=0))) / 1e6
    square = site.known.cloud.units.xy**2
    mean = float(places.area.mean() * square) if len(places) else 400.0
    points = around_points(site, max(1, round(2 * max(RATES) * area)), float(np.sqrt(mean / np.pi)))
    rng = np.random.default_rng(SEED)
    random = places.assign(key=rng.random(len(places)))
    table = pd.concat(
        [one.assign(order=order) for order, one in (("list", places), ("random", random), ("points", points))]
    )
    table["km2"] = area
    table.to_file(path, driver="GPKG", layer="places")
    return read_places(path)


def read_places(path: Path) -> geopandas.GeoDataFrame:
    """Places of a cloud, whose coordinates are its own."""
    return geopandas.read_file(path).set_crs(None, allow_override=True)


def cloud_names(folder: Path) -> list[str]:
    """Tiles, hard tiles, and a scene of every layout."""
    files = [path.stem for part in ("tiles", "tiles_hard") for path in sorted((folder / part).glob("*.la[sz]"))]
    return files + [f"{layout} 2" for layout in jf.scenes.LAYOUTS]


def opened(folder: Path, name: str, share: float) -> Known:
    """A cloud; of scenes a share of the length."""
    layout = name.partition(" ")[0]
    if layout not in jf.scenes.LAYOUTS or share == 1:
        return load(folder, name)
    size = (SIZES[2.0][0] * share, SIZES[2.0][1])
    scene = jf.scenes.make(layout, size=size, density=2.0, seed=SEED, swath=SWATH)
    return Known(name, "scenes", scene.cloud, scene.truth, scene.cloud.candidate)


def main(arguments: list[str] | None = None) -> None:
    """All clouds, the page and the figure."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with tiles/ and tiles_hard/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    parser.add_argument("--work", type=Path, default=HERE / "out", help="folder for lists of places [%(default)s]")
    parser.add_argument("--scenes", type=float, default=1.0, help="share of the length of scenes [%(default)s]")
    parser.add_argument("--clouds", nargs="*", default=[], help="begins of names")
    parser.add_argument("--without", nargs="*", default=[], help="begins of names of clouds that are left out")
    parser.add_argument("--only", nargs="*", default=[], help="begins of names whose rows this process makes")
    options = parser.parse_args(given)
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    warnings.filterwarnings("ignore", "'crs' was not provided", UserWarning)
    for target in (options.out, options.work):
        target.mkdir(parents=True, exist_ok=True)
    folder = samples.data_folder(options.data)
    names = [n for n in cloud_names(folder) if not options.clouds or any(n.startswith(c) for c in options.clouds)]
    names = [n for n in names if not any(n.startswith(c) for c in options.without)]
    sites: dict[str, Site] = {}
    known: dict[tuple[str, bool, tuple[str, ...]], Row] = {}  # what was found with the same places

    def site(name: str) -> Site:
        if name not in sites:
            sites.clear()
            sites[name] = Site.of(opened(folder, name, options.scenes))
        return sites[name]

    tables = {}
    for name in names:
        path = options.work / f"{name.replace(' ', '_')}.gpkg"
        tables[name] = prepared(site(name), path) if not path.exists() else read_places(path)
        print("places", name, len(tables[name]), file=sys.stderr, flush=True)
    every = pd.concat([table.assign(cloud=name) for name, table in tables.items()], ignore_index=True)
    every["hard"] = every["cloud"].isin([path.stem for path in (folder / "tiles_hard").glob("*.la[sz]")])
    every = every.sort_values(["key", "cloud"], ascending=False)
    area = {hard: float(own.groupby("cloud")["km2"].first().sum()) for hard, own in every.groupby("hard")}
    kept = {name: options.work / f"{name.replace(' ', '_')}.csv" for name in names}
    for name in (n for n in names if not kept[n].exists()):
        if options.only and not any(name.startswith(one) for one in options.only):
            continue
        rows: list[Row] = []
        hard = bool(every["hard"][every["cloud"] == name].iloc[0])
        for order in ORDERS:
            pooled = every[(every["hard"] == hard) & (every["order"] == ("list" if order == "edited" else order))]
            most = pooled.head(round(max(RATES) * area[hard]))
            most = most[most["cloud"] == name]
            if order != "edited":
                most = most.assign(verdict=verdicts(site(name), most) if len(most) else [])
            for rate in (0, *RATES):
                own = most.loc[most.index.isin(pooled.index[: round(rate * area[hard])])]
                key = name, order == "edited", tuple(sorted(own.geometry.to_wkb(hex=True)))
                if key not in known:
                    ground = site(name).result.ground
                    if len(own):
                        ground = (
                            edited(site(name), own) if order == "edited" else jf.apply(site(name).result, own).ground
                        )
                    known[key] = site(name).errors(ground)
                row = {"cloud": name, "group": site(name).known.group, "order": order, "rate": rate, "places": len(own)}
                said = own["verdict"] if order != "edited" else pd.Series([], dtype=str)
                rows.append(row | known[key] | {f"said_{word}": int((said == word).sum()) for word in WORDS})
        write_csv(kept[name], rows)
        print("done", name, file=sys.stderr, flush=True)
    if not all(path.exists() for path in kept.values()):
        return
    rows = [row for path in kept.values() for row in read_csv(path)]
    write_csv(options.out / "verdicts.csv", rows)
    command = shlex.join(["python", "experiments/verdicts/run.py", *given])
    write_page(options.out / "results.md", page(rows, sum(area.values())), command, ["ost", "scenes"])
    figure(summed(rows), options.out / "verdicts.png")


def summed(rows: list[Row]) -> pd.DataFrame:
    """Errors by group, order and rate, all clouds of a group together, and all groups."""
    table = pd.DataFrame(rows)
    columns = ["wrong", "points", "off", "cells", "places", *(f"said_{word}" for word in WORDS)]
    begin = table[table["rate"] == 0].set_index(["cloud", "order"])["off"]
    before = np.array([begin[row.cloud, row.order] for row in table.itertuples()])
    table["mean"] = np.where(before >= ENOUGH, table["off"] / np.maximum(before, 1), np.nan)
    parts = [table, table[table["group"] != "hard tiles"].assign(group=TOGETHER)]
    grouped = pd.concat(parts).groupby(["group", "order", "rate"])
    sums = grouped[columns].sum().assign(mean=grouped["mean"].mean()).reset_index()
    sums["error"], sums["share"] = 100 * sums["wrong"] / sums["points"], 100 * sums["off"] / sums["cells"]
    start = sums[sums["rate"] == 0].set_index(["group", "order"])["off"]
    sums["left"] = [row.off / start[row.group, row.order] for row in sums.itertuples()]
    return sums


def page(rows: list[Row], area: float) -> str:
    """Tables by group."""
    sums = summed(rows)
    columns: list[Column] = [
        ("how", "places", ""), ("rate", "per km2", "d"), ("places", "places", "d"), ("said_ground", "ground", "d"),
        ("said_object", "object", "d"), ("said_fine", "fine", "d"), ("error", "total error, %", ".2f"),
        ("share", "cells off by > 0.5 m, %", ".2f"), ("left", "of the start", ".2f"), ("mean", "mean of clouds", ".2f"),
    ]  # fmt: skip
    text = [f"# Errors left after verdicts\n\n{len({r['cloud'] for r in rows})} clouds, {area:.2f} km2 in all.\n\n"
            "![Share of cells that are off, by places per km2](verdicts.png)"]  # fmt: skip
    for group in (*GROUPS, TOGETHER):
        own = sums[sums["group"] == group]
        table = [
            row | {"how": ORDERS[row["order"]]}
            for order in ORDERS
            for row in own[own["order"] == order].to_dict("records")
        ]
        if table:
            text.append(f"## {group[0].upper()}{group[1:]}\n\n{markdown(columns, table)}")
    return "\n\n".join(text)


def figure(sums: pd.DataFrame, path: Path) -> None:
    """Curves of the cells that are left, a panel for each group."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    groups = [group for group in (*GROUPS, TOGETHER) if (sums["group"] == group).any()]
    drawn = Figure(figsize=(3.2 * len(groups), 3.0), layout="constrained")
    FigureCanvasAgg(drawn)
    for ax, group in zip(drawn.subplots(1, len(groups), sharey=True, squeeze=False)[0], groups, strict=True):
        for (order, words), style in zip(ORDERS.items(), ("o-", "s--", "^:", "x-."), strict=True):
            own = sums[(sums["group"] == group) & (sums["order"] == order)]
            ax.plot(own["rate"], own["left"], style, label=words, markersize=4)
        ax.axhline(0.5, color="grey", linewidth=0.8)
        ax.set(title=group, xlabel="places per km2")
    drawn.axes[0].set_ylim(0, 1.05 * max(1.0, float(sums["left"].max())))
    drawn.axes[0].set_ylabel("cells off by > 0.5 m, of the start")
    drawn.axes[-1].legend(fontsize=7)
    save_png(drawn, path, 150)


if __name__ == "__main__":
    main()
