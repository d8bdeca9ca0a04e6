"""What the label-free removal of low clusters finds, and what it costs: scenes, ISPRS samples, tiles and sites."""

from __future__ import annotations

import argparse
import dataclasses
import shlex
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import LinearNDInterpolator

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments import report
from experiments.isprs import samples
from jaxfilter import scenes
from jaxfilter.core.points import Points, canonical_points
from jaxfilter.steps.outliers import low_clusters
from jaxfilter.steps.seeds import lowest_per_window

EXTENT = {0.2: 700, 1.0: 400, 4.0: 200, 12.0: 120}
"""Metres: side of the scenes by their density in pulses per square metre."""
SEED = 21
STRAY: dict[str, Any] = {"low_clusters": 120.0, "low_outliers": 5e-5}
STEEP_CITY = {"tilt": 0.3, "relief": 40.0, "landform": 128.0, "hurst": 1.2, "river": 0.0, "cutting": 6.0, "scarp": 5.0}
LAYOUTS = {
    **{name: scenes.LAYOUTS[name] for name in ("flat", "town", "city", "hills", "mountain", "forest", "quarry")},
    **{name: scenes.LAYOUTS[name] for name in ("terraces", "mixed")},
    "city on a slope": dataclasses.replace(scenes.LAYOUTS["city"], **STEEP_CITY),
}
TILE_NOISE = (7, 9, 12, 18, 26, 65, 66, 67)
"""Classes of the tiles that are neither ground nor objects."""

COUNTS = (
    ("points", "points", ",.0f"),
    ("false", "false low", ",.0f"),
    ("found", "found", ",.0f"),
    ("clusters", "clusters", ",.0f"),
    ("ground_barred", "ground barred", ",.0f"),
    ("ground_back", "of it back", ",.0f"),
    ("seeds", "seeds", ",.0f"),
    ("bad_before", "false seeds without", ",.0f"),
    ("bad_after", "with", ",.0f"),
)
AVERAGES = (
    ("total_without", "TE without", ".2f"),
    ("total_with", "TE with", ".2f"),
    ("total_ideal", "TE ideal", ".2f"),
    ("milliseconds", "ms", ".0f"),
)
COLUMNS = (("name", "cloud", ""), *COUNTS, *AVERAGES)
SITE_COLUMNS = (
    ("name", "cloud", ""),
    ("points", "points", ",.0f"),
    ("clusters", "clusters", ".0f"),
    ("barred", "points barred", ",.0f"),
    ("per_mille", "per mille", ".2f"),
    ("ground_back", "of them ground", ",.0f"),
    ("deepest", "lowest barred, m", ".1f"),
    ("kept", "lowest kept, m", ".1f"),
    ("milliseconds", "ms", ".0f"),
)


def timed(points: Points) -> tuple[np.ndarray, int, float]:
    """Barred rows, number of clusters, and milliseconds of the second of two calls."""
    low_clusters(points)
    start = time.perf_counter()
    result = low_clusters(points)
    return result.barred, result.clusters, 1000 * (time.perf_counter() - start)


def labelled(name: str, cloud: jf.PointCloud, false_low: np.ndarray, preset: str = "recommended") -> report.Row:
    """One row on a cloud with reference labels. ``false_low``: bool[n], echoes that ought to be barred."""
    print(name, file=sys.stderr, flush=True)
    points = canonical_points(cloud)
    barred, clusters, milliseconds = timed(points)
    rows = np.zeros(len(cloud), bool)
    rows[points.index] = barred[points.member]
    false_row = np.zeros(len(points), bool)
    np.logical_or.at(false_row, points.member, false_low[points.index])
    without = lowest_per_window(points, 60.0, 10.0, np.zeros(len(points), bool))
    seeds = lowest_per_window(points, 60.0, 10.0, barred)
    ground = cloud.reference & cloud.candidate
    method = jf.FPTD.preset(preset)
    result = method(cloud)
    ideal = dataclasses.replace(cloud, candidate=cloud.candidate & ~false_low)
    return {
        "name": name,
        "points": len(points.index),
        "false": int(false_low.sum()),
        "found": int((rows & false_low).sum()),
        "clusters": clusters,
        "ground_barred": int((rows & ground).sum()),
        "ground_back": int((rows & ground & result.ground).sum()),
        "seeds": len(seeds),
        "bad_before": int(false_row[without].sum()),
        "bad_after": int(false_row[seeds].sum()),
        "total_without": jf.evaluate(method.replace(low_clusters=False)(cloud), cloud.reference).total,
        "total_with": jf.evaluate(result, cloud.reference).total,
        "total_ideal": jf.evaluate(method.replace(low_clusters=False)(ideal), cloud.reference).total,
        "milliseconds": milliseconds,
    }


def below_ground(cloud: jf.PointCloud, objects: np.ndarray) -> np.ndarray:
    """bool[n]: ``objects`` more than 1 m below the triangulated reference ground."""
    xyz, ground = cloud.xyz.astype(np.float64), cloud.reference
    surface = LinearNDInterpolator(xyz[ground, :2], xyz[ground, 2])
    out = np.zeros(len(cloud), bool)
    rows = np.flatnonzero(objects)
    with np.errstate(invalid="ignore"):
        out[rows] = xyz[rows, 2] < surface(xyz[rows, :2]) - 1.0
    return out


def scene_rows(quick: bool) -> Iterator[report.Row]:
    for density, size in list(EXTENT.items())[1 : 2 if quick else None] if quick else EXTENT.items():
        for name, layout in list(LAYOUTS.items())[: 2 if quick else None]:
            scene = scenes.make(dataclasses.replace(layout, **STRAY), size=size, density=density, seed=SEED)
            false_low = (scene.kind == scenes.Kind.LOW_OUTLIER) & scene.cloud.candidate
            yield {"density": density, **labelled(f"{name}, {density:g}/m²", scene.cloud, false_low)}


def sample_rows(folder: Path, quick: bool) -> Iterator[report.Row]:
    classes = samples.terrain_classes()
    for sample in ("24", "41") if quick else samples.SAMPLES:
        cloud = jf.read(samples.sample_path(folder, sample))
        yield labelled(f"samp{sample}", cloud, below_ground(cloud, ~cloud.reference), classes[f"samp{sample}"])


def tile_rows(folder: Path) -> Iterator[report.Row]:
    for path in sorted((folder / "tiles").glob("*.la[sz]")):
        cloud = jf.read(path, ignore_classes=TILE_NOISE)
        yield labelled(path.stem, cloud, below_ground(cloud, cloud.candidate & ~cloud.reference))


def site_rows(folder: Path, quick: bool) -> Iterator[report.Row]:
    for site in samples.SITES[4:5] if quick else samples.SITES:
        path = samples.site_path(folder, site)
        if path is None:
            continue
        print(path.stem, file=sys.stderr, flush=True)
        cloud = jf.read(path)
        points = canonical_points(cloud)
        barred, clusters, milliseconds = timed(points)
        back = jf.FPTD.preset(samples.terrain_classes()[site])(cloud).ground[points.index] & barred[points.member]
        z = points.xyz[:, 2] + cloud.origin[2]
        yield {
            "name": path.stem,
            "points": len(points.index),
            "clusters": clusters,
            "barred": int(barred.sum()),
            "per_mille": 1000 * float(barred.mean()),
            "deepest": float(z[barred].min()) if barred.any() else np.nan,
            "kept": float(z[~barred].min()),
            "ground_back": int(back.sum()),
            "milliseconds": milliseconds,
        }


def draw(axes: Any, cloud: jf.PointCloud, section: tuple[int, float, float] | None, title: str) -> None:
    """A map of a cloud, or a section (axis to look along, from, to), with barred points in colour."""
    points = canonical_points(cloud)
    barred = low_clusters(points).barred[points.member]
    xyz, ground = cloud.xyz[points.index], cloud.reference[points.index]
    across, up = 0, 1
    if section is not None:
        axis, low, high = section
        inside = (xyz[:, axis] >= low) & (xyz[:, axis] <= high)
        xyz, ground, barred = xyz[inside], ground[inside], barred[inside]
        across, up = 1 - axis, 2
    size = 0.5 if section is None else 2.0
    for mask, colour, label, scale in (
        (~ground & ~barred, "0.75", "object", 1),
        (ground & ~barred, "tab:green", "ground", 1),
        (barred & ~ground, "tab:red", "barred, object", 6),
        (barred & ground, "tab:blue", "barred, ground", 6),
    ):
        axes.scatter(xyz[mask, across], xyz[mask, up], s=scale * size, c=colour, label=label, linewidths=0)
    axes.set(title=title, xlabel="m", ylabel="m")
    if section is None:
        axes.set_aspect("equal")


def figures(folder: Path | None, out: Path) -> None:
    from matplotlib.figure import Figure

    def save(panels: list[tuple[jf.PointCloud, tuple[int, float, float] | None, str]], name: str) -> None:
        figure = Figure(figsize=(6.5 * len(panels), 5), layout="constrained")
        for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
            draw(axes, *panel)
        figure.axes[0].legend(markerscale=3, loc="best", fontsize=8)
        report.save_png(figure, out / name, dpi=90)

    quarry = scenes.make(dataclasses.replace(LAYOUTS["quarry"], **STRAY), size=500, density=1.0, seed=SEED).cloud
    city = scenes.make(dataclasses.replace(LAYOUTS["city"], **STRAY), size=400, density=1.0, seed=SEED).cloud
    save([(quarry, None, "quarry, 1/m²"), (city, None, "city, 1/m²")], "scenes.png")
    if folder is not None:
        s41, s24 = (jf.read(samples.sample_path(folder, sample)) for sample in ("41", "24"))
        save([(s41, None, "sample 41"), (s41, (1, -1e9, 1e9), "sample 41, from the south")], "samp41.png")
        save([(s24, None, "sample 24"), (s24, (1, -1e9, 1e9), "sample 24, from the south")], "samp24.png")


def summary(rows: list[report.Row]) -> list[report.Row]:
    """The rows of the scenes by density: counts added up, errors and times averaged."""
    out = []
    for density in dict.fromkeys(row["density"] for row in rows):
        group = [row for row in rows if row["density"] == density]
        total = {key: sum(row[key] for row in group) for key, _, _ in COUNTS}
        mean = {key: sum(row[key] for row in group) / len(group) for key, _, _ in AVERAGES}
        out.append({"name": f"{density:g}/m²", **total, **mean})
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "out", help="folder for results [out/]")
    parser.add_argument("--data", type=Path, help="folder with isprs/, isprs_sites/ and tiles/ [JAXFILTER_DATA]")
    parser.add_argument("--no-data", action="store_true", help="scenes only")
    parser.add_argument("--quick", action="store_true", help="two scenes, two samples, one site")
    options = parser.parse_args()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    folder = None if options.no_data else samples.data_folder(options.data)
    options.out.mkdir(parents=True, exist_ok=True)
    tables = [("Scenes", COLUMNS, list(scene_rows(options.quick)))]
    tables.append(("Scenes, by density", COLUMNS, summary(tables[0][2])))
    if folder is not None:
        rows = list(sample_rows(folder, options.quick))
        tables.append(("ISPRS samples", COLUMNS, report.with_averages(rows, "name")))
        tables.append(("ISPRS sites, unlabelled", SITE_COLUMNS, list(site_rows(folder, options.quick))))
        if not options.quick:
            tables.append(("Labelled tiles", COLUMNS, list(tile_rows(folder))))
    text = "\n\n".join(f"## {title}\n\n{report.markdown(columns, rows)}" for title, columns, rows in tables)
    text = f"# Low clusters\n\n{text}\n"
    command = shlex.join(["python", "experiments/outliers/run.py", *sys.argv[1:]])
    report.write_page(options.out / "results.md", text, command, ("fptd", "scenes"))
    report.write_csv(options.out / "results.csv", [{"table": t, **row} for t, _, rows in tables for row in rows])
    figures(folder, options.out)
    print(text)


if __name__ == "__main__":
    main()
