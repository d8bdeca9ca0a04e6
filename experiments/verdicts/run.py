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
from jaxfilter.reports.places import SIDE, places_of, suspects
from jaxfilter.terrain.layer import extent_of
from jaxfilter.terrain.models import interpolated
from jaxfilter.terrain.raster import RasterGrid

HERE = Path(__file__).parent
MOST, RATES, OFF, NEAR, LEVEL = 2500.0, (5, 10, 20, 50), 0.5, 3.0, 0.3
"""Square metres of a place, at most; places per square kilometre; metres from which on a cell is off, to reference ground, and
from its terrain within which a point is ground."""
ORDERS = {
    "list": "in the order of the list",
    "random": "places of the list at random",
    "points": "around isolated points",
}
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
        grid = RasterGrid.over(extent_of(cloud), 1.0 / cloud.units.xy, cloud.units.xy)
        near = dataclasses.replace(FILLED, max_gap=NEAR / cloud.units.xy)
        return cls(known, jf.default_filter(cloud)(cloud), grid, interpolated(cloud, known.ground, grid, near).values)

    def errors(self, result: jf.FilterResult) -> Row:
        """Wrong points and cells of a result, with how many count."""
        known = self.known
        model = interpolated(known.cloud, result.ground, self.grid, FILLED).values
        off = np.abs(model.astype(float) - self.truth) * known.cloud.units.z > OFF
        wrong = (result.ground != known.ground) & known.scored
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


def verdict(site: Site, shape: shapely.Geometry) -> str:
    """What the reference says of a place, by its cells of 2 m.

    ``fine`` if less than a tenth of them is wrong: most points that are labelled ground are none, or there is no such point
    and the lowest one is ground. Else ``ground`` if most of it lies within :data:`NEAR` of ground, and ``object`` if not. Points
    within :data:`LEVEL` of the terrain of the reference are ground, since references label some of their ground points only.
    """
    known, cloud, grid = site.known, site.known.cloud, site.grid
    x0, y0, x1, y1 = shape.bounds
    xyz = cloud.origin + cloud.xyz / np.array([cloud.units.xy, cloud.units.xy, cloud.units.z])
    near = (
        known.scored & cloud.candidate & (xyz[:, 0] >= x0) & (xyz[:, 0] <= x1) & (xyz[:, 1] >= y0) & (xyz[:, 1] <= y1)
    )
    rows = np.flatnonzero(near)
    rows = rows[shapely.intersects_xy(shape, xyz[rows, 0], xyz[rows, 1])]
    if not len(rows):
        return "fine"
    column, row = (np.floor(xyz[rows, :2] / grid.cell).astype(int) - (grid.left, grid.bottom)).T
    terrain = site.truth[np.clip(grid.rows - 1 - row, 0, grid.rows - 1), np.clip(column, 0, grid.columns - 1)]
    truth = known.ground[rows] | (np.abs(xyz[rows, 2] - terrain) * cloud.units.z <= LEVEL)
    label = site.result.ground[rows]
    cell = np.unique(np.floor(xyz[rows, :2] * cloud.units.xy / SIDE), axis=0, return_inverse=True)[1].ravel()
    order = np.lexsort((xyz[rows, 2], cell))
    lowest = truth[order[np.diff(cell[order], prepend=-1) > 0]]
    labelled, right = np.bincount(cell, label), np.bincount(cell, label & truth)
    wrong = np.where(labelled > 0, 2 * right < labelled, lowest)
    if wrong.mean() < 0.1:
        return "fine"
    x, y = grid.centres()
    columns, lines = (np.flatnonzero((at > low) & (at < high)) for at, low, high in ((x, x0, x1), (y, y0, y1)))
    box = site.truth[np.ix_(lines, columns)]
    held = shapely.intersects_xy(shape, *np.meshgrid(x[columns], y[lines]))
    return "ground" if np.isfinite(box[held]).mean() > 0.5 else "object"


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
    options.work.mkdir(parents=True, exist_ok=True)
    folder = samples.data_folder(options.data)
    names = [n for n in cloud_names(folder) if not options.clouds or any(n.startswith(c) for c in options.clouds)]
    names = [n for n in names if not any(n.startswith(c) for c in options.without)]
    sites: dict[str, Site] = {}
    known: dict[tuple[str, tuple[str, ...]], Row] = {}  # what was found with the same places

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
    every = pd.concat([table.assign(cloud=name) for name, table in tables.items()])
    every["hard"] = every["cloud"].isin([path.stem for path in (folder / "tiles_hard").glob("*.la[sz]")])
    first = {
        (hard, order): own.sort_values(["key", "cloud"], ascending=False)
        for (hard, order), own in every.groupby(["hard", "order"])
    }
    area = {hard: float(own.groupby("cloud")["km2"].first().sum()) for hard, own in every.groupby("hard")}
    kept = {name: options.work / f"{name.replace(' ', '_')}.csv" for name in names}
    for name in (n for n in names if not kept[n].exists()):
        if options.only and not any(name.startswith(one) for one in options.only):
            continue
        rows: list[Row] = []
        for order in ORDERS:
            for rate in (0, *RATES):
                hard = bool(every["hard"][every["cloud"] == name].iloc[0])
                chosen = first[hard, order].head(round(rate * area[hard]))
                own = chosen[chosen["cloud"] == name]
                own = own.assign(verdict=[verdict(site(name), shape) for shape in own.geometry])
                key = name, tuple(sorted(own.geometry.to_wkb(hex=True)))
                if key not in known:
                    before = site(name).result
                    after = jf.apply(before, own[["verdict", "geometry"]]) if len(own) else before
                    known[key] = site(name).errors(after)
                row = {"cloud": name, "group": site(name).known.group, "order": order, "rate": rate, "places": len(own)}
                said = {f"said_{word}": int((own["verdict"] == word).sum()) for word in ("ground", "object", "fine")}
                rows.append(row | known[key] | said)
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
    columns = ["wrong", "points", "off", "cells", "places", "said_ground", "said_object", "said_fine"]
    parts = [table, table[table["group"] != "hard tiles"].assign(group=TOGETHER)]
    sums = pd.concat(parts).groupby(["group", "order", "rate"])[columns].sum().reset_index()
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
        ("share", "cells off by > 0.5 m, %", ".2f"), ("left", "of the start", ".2f"),
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
        for (order, words), style in zip(ORDERS.items(), ("o-", "s--", "^:"), strict=True):
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
