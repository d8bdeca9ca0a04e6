"""All methods on clouds of other sensors, simulated and real; how alike the two are; and pictures. See README.md.

python experiments/sensors/run.py clouds
python experiments/sensors/run.py methods
python experiments/sensors/run.py draws
python experiments/sensors/run.py pictures
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples
from experiments.report import Column, Row, markdown, read_csv, save_png, write_csv, write_page
from experiments.sensors import clouds
from jaxfilter.core.compilation import keep_compilations
from jaxfilter.core.points import canonical_points
from jaxfilter.steps.sensors import Sensed

HERE = Path(__file__).parent
PICTURES = HERE.parents[1] / "docs" / "static"
PROFILES = {"odmsem3d_brighton_small": 0.25, "rf4pcc_test": 0.27, "sea_cliff": 0.5, "spanner_UAS": 0.5}
"""Clouds that are drawn, and at which share of their extent from the south."""


def main(arguments: list[str] | None = None) -> None:
    """Run one part, or all, and write the page."""
    given = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(given)
    try:
        folder: Path | None = samples.data_folder(options.data)
    except SystemExit:
        folder = None
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.part in ("clouds", "all"):
        write_csv(options.out / "clouds.csv", [alike(known) for known in clouds.every(folder)])
    if options.part in ("methods", "all"):
        rows: list[Row] = []
        for known in clouds.every(folder):
            for method in options.methods:
                print(known.name, method, file=sys.stderr, flush=True)
                rows.append(measured(known, method))
                write_csv(options.out / "methods.csv", rows)
    if options.part in ("draws", "all"):
        rows = []
        for seed in clouds.DRAWS:
            for sensor, (layouts, _, _) in clouds.SCENES.items():
                for known in (clouds.scene(sensor, layout, seed) for layout in layouts):
                    for method in options.methods:
                        print(known.name, seed, method, file=sys.stderr, flush=True)
                        rows.append({"seed": seed} | measured(known, method))
                        write_csv(options.out / "draws.csv", rows)
    if options.part in ("pictures", "all") and folder is not None:
        for name, share in PROFILES.items():
            draw(clouds.real(folder, name), share, PICTURES / f"sensors_{name.partition('_')[0]}.png")
    tables = {
        part: read_csv(path)
        for part in ("clouds", "methods", "draws")
        if (path := options.out / f"{part}.csv").exists()
    }
    command = shlex.join(["python", "experiments/sensors/run.py", *given])
    write_page(options.out / "results.md", page(tables), command, (*options.methods, "scenes"))


def alike(known: clouds.Sensed) -> Row:
    """Spacing, noise by the width of windows on ground, voids and how uneven the density is; and what is told of the sensor."""
    points = canonical_points(known.cloud)
    told, spacing = Sensed.of(points), points.spacing()
    ground = known.cloud.xyz if known.truth is None else known.cloud.xyz[known.truth]
    row: Row = {"cloud": known.name, "sensor": known.sensor, "told": told.kind, "points": len(known.cloud)}
    row |= {"spacing": spacing, "thickness": told.thickness}
    row |= {f"noise_{width:g}": scatter(ground, width / 2) for width in (0.5, 1.0, 2.0)}
    count = np.unique(np.floor(points.xyz[:, :2]).astype(int) @ (1, 1 << 20), return_counts=True)[1]
    low, high = (points.xyz[:, :2].min(axis=0), points.xyz[:, :2].max(axis=0))
    row["empty"] = 100 * (1 - len(count) / np.prod(np.floor(high) - np.floor(low) + 1))
    return row | {"uneven": float(np.percentile(count, 90) / np.percentile(count, 10))}


def scatter(xyz: np.ndarray, radius: float, windows: int = 1500) -> float:
    """Metres: median over level windows of the scatter of points about planes, 1.4826 times the median deviation."""
    from scipy.spatial import cKDTree

    rng, tree, found = np.random.default_rng(0), cKDTree(xyz[:, :2]), []
    for centre in rng.choice(len(xyz), min(windows, len(xyz)), replace=False):
        near = tree.query_ball_point(xyz[centre, :2], radius)
        if len(near) >= 8:
            d = xyz[near].astype(float) - xyz[centre]
            plane, *_ = np.linalg.lstsq(np.c_[d[:, :2], np.ones(len(d))], d[:, 2], rcond=None)
            if np.hypot(*plane[:2]) < 0.5:
                rest = d[:, 2] - d[:, :2] @ plane[:2] - plane[2]
                found.append(1.4826 * np.median(np.abs(rest - np.median(rest))))
    return float(np.median(found)) if found else float("nan")


def measured(known: clouds.Sensed, method: str) -> Row:
    """Scores and terrain errors of a method as ``for_cloud`` gives it."""
    row: Row = {"cloud": known.name, "sensor": known.sensor, "method": method}
    start = time.process_time()
    try:
        result = jf.FILTERS[method].for_cloud(known.cloud)(known.cloud)
        errors = clouds.terrain_errors(known, result.ground)
    except jf.JaxfilterError as error:
        return row | {"status": f"{type(error).__name__}: {error}"}
    row |= {"seconds": time.process_time() - start, "ground": 100 * float(result.ground[known.scored].mean())}
    if known.truth is not None:
        scores = jf.evaluate(result, known.truth, ignore=~known.scored)
        row |= {"total": scores.total, "kappa": scores.kappa, "type1": scores.type1, "type2": scores.type2}
    if errors is not None:
        row |= {"rmse": errors.rmse, "high": errors.high, "low": errors.low}
    return row


def draw(known: clouds.Sensed, share: float, path: Path) -> None:
    """A map and a profile of a cloud with the ground that the default finds, as a small picture."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    result = jf.default_filter(known.cloud)(known.cloud)
    xyz, colour = known.cloud.xyz, np.where(result.ground, "saddlebrown", "mediumseagreen")
    middle = xyz[:, 1].min() + share * np.ptp(xyz[:, 1])
    figure, (plan, profile) = plt.subplots(1, 2, figsize=(11, 3.6), width_ratios=(1, 2.2))
    some = slice(None, None, max(1, len(xyz) // 60_000))
    plan.scatter(xyz[some, 0], xyz[some, 1], s=0.3, c=colour[some])
    plan.axhline(middle, color="k", lw=0.5)
    plan.set_aspect("equal")
    plan.set(xlabel="easting, m", ylabel="northing, m")
    near = np.abs(xyz[:, 1] - middle) < (1.0 if np.ptp(xyz[:, 0]) > 200 else 0.25)
    profile.scatter(xyz[near, 0], xyz[near, 2], s=1, c=colour[near])
    profile.set_title(f"{path.stem.removeprefix('sensors_')}: {known.sensor}; brown is ground", fontsize=9)
    profile.set(xlabel="easting, m", ylabel="elevation, m")
    figure.tight_layout()
    save_png(figure, path, 75)
    plt.close(figure)


def page(tables: dict[str, list[Row]]) -> str:
    """The tables as Markdown."""
    text = ["# Clouds of other sensors", "", ""]
    if "clouds" in tables:
        columns: list[Column] = [
            ("cloud", "cloud", ""), ("told", "told as", ""), ("points", "points", ",d"), ("spacing", "spacing, m", ".3f"),
            ("thickness", "sheet, m", ".4f"), ("noise_0.5", "noise in 0.5 m", ".3f"), ("noise_1", "in 1 m", ".3f"),
            ("noise_2", "in 2 m", ".3f"), ("empty", "empty, %", ".1f"), ("uneven", "uneven", ".1f"),
        ]  # fmt: skip
        text += [
            "## Scenes and real clouds side by side", "",
            "Noise: median scatter about planes in windows of ground that are so wide (of rf4pcc_test and sea_cliff in all that "
            "is level). Empty: cells of 1 m in the bounding box without points. Uneven: density that a tenth of the cells exceed "
            "over that which nine tenths do.", "", markdown(columns, tables["clouds"]), "",
        ]  # fmt: skip
    rows = tables.get("methods", [])
    for key, title, form in (
        ("total", "Total error, %", ".2f"), ("kappa", "Kappa, %", ".1f"), ("rmse", "Terrain RMSE, m", ".3f"),
        ("low", "Terrain more than 0.5 m too low, % of cells", ".2f"), ("ground", "Points called ground, %", ".1f"),
    ):  # fmt: skip
        text += wide(rows, key, f"## {title}", form)
    if rows := tables.get("draws", []):
        seeds = ", ".join(str(seed) for seed in dict.fromkeys(row["seed"] for row in rows))
        text += [
            "## The scenes drawn anew", "",
            f"Means over seeds {seeds}, drawn after the limits had been set; one alternative was turned down with them in view. "
            "–: a method has failed on one.", "",
        ]  # fmt: skip
        for key, title, form in (("total", "Total error, %", ".2f"), ("rmse", "Terrain RMSE, m", ".3f")):
            text += wide(means(rows, key), key, f"### {title}, drawn anew", form)
    return "\n".join(text).rstrip()


def means(rows: list[Row], key: str) -> list[Row]:
    """One row for each cloud and method: the mean of ``key`` over the seeds, where all have it."""
    values: dict[tuple[str, str], list[object]] = {}
    for row in rows:
        values.setdefault((row["cloud"], row["method"]), []).append(row.get(key))
    return [
        {"cloud": cloud, "method": method, key: float(np.mean(known))}
        for (cloud, method), found in values.items()
        if len(known := [one for one in found if isinstance(one, (int, float))]) == len(found)
    ]


def wide(rows: list[Row], key: str, title: str, form: str) -> list[str]:
    """Lines of a table with a row for each cloud and a column for each method."""
    methods = sorted({row["method"] for row in rows})
    by_cloud: dict[str, Row] = {}
    for row in rows:
        if isinstance(row.get(key), (int, float)):
            by_cloud.setdefault(row["cloud"], {"cloud": row["cloud"]})[row["method"]] = row[key]
    heading: list[Column] = [("cloud", "cloud", ""), *((m, m, form) for m in methods)]
    return [title, "", markdown(heading, list(by_cloud.values())), ""] if by_cloud else []


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=["clouds", "methods", "draws", "pictures", "all"])
    parser.add_argument("--data", type=Path, help="folder with other_sensors/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    parser.add_argument("--methods", nargs="+", choices=list(jf.FILTERS), default=list(jf.FILTERS), metavar="METHOD")
    return parser


if __name__ == "__main__":
    main()
