"""How well a few labelled patches choose the parameters of SMRF on the ISPRS samples. See README.md."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.defaults import clouds
from experiments.isprs import samples
from experiments.report import Row, markdown, read_csv, with_averages, write_csv, write_page
from experiments.tiles.run import LEFT_OUT
from jaxfilter.core.compilation import keep_compilations

HERE = Path(__file__).parent
PATCHES = 5
SHARE = 0.02
"""Of the points of a sample that are labelled, in all patches together."""


SHAPES = {"patches": "five round patches", "profiles": "five profiles 4 m wide", "points": "single points"}
"""What is labelled; patches and profiles hold both classes."""
WIDTH = 4.0
"""Of a profile, metres."""


def main(arguments: list[str] | None = None) -> None:
    """Calibrate on every sample, several times, and write the tables."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="folder with isprs/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    parser.add_argument("--clouds", choices=["isprs", "others"], default="isprs", help=others.__doc__)
    parser.add_argument("--samples", type=samples.sample_name, nargs="+", default=list(samples.SAMPLES))
    parser.add_argument("--shapes", choices=list(SHAPES), nargs="+", default=list(SHAPES))
    parser.add_argument("--draws", type=int, default=10, help="of labels, per sample [%(default)s]")
    parser.add_argument("--size", type=int, default=256, help="sets per round of the search [%(default)s]")
    options = parser.parse_args(given)
    folder = samples.data_folder(options.data)
    options.out.mkdir(parents=True, exist_ok=True)
    keep_compilations()
    clouds = others(folder) if options.clouds == "others" else isprs(folder, options.samples)
    rows: list[Row] = []
    for number, (name, cloud) in enumerate(clouds):
        for row in sample_rows(name, number, cloud, options.shapes, options.draws, options.size):
            rows.append(row)
            print(f"{row['sample']:12} {row['shape']:8}  given {row['given']:.2f}  naive {row['naive']:.2f}  "
                  f"calibrated {row['calibrated']:.2f}  oracle {row['oracle']:.2f}", flush=True)  # fmt: skip
    name = "calibration" if options.clouds == "isprs" else "calibration_others"
    rows = kept(options.out / f"{name}.csv", rows)
    command = shlex.join(["python", "experiments/sensitivity/calibration.py", *given])
    write_page(options.out / f"{name}.md", report(rows), command, ("smrf", *["scenes"] * (options.clouds == "others")))
    print(f"results are in {options.out}")


def kept(path: Path, rows: list[Row]) -> list[Row]:
    """The rows, and those of an earlier run that were not made anew, shape by shape; written to the file."""
    new = {(row["sample"], row["shape"]): row for row in rows}
    old = {(row["sample"], row["shape"]): row for row in (read_csv(path) if path.exists() else [])}
    shapes = list(SHAPES)
    out = sorted((old | new).values(), key=lambda row: shapes.index(row["shape"]))
    write_csv(path, out)
    return out


def isprs(folder: Path, numbers: Sequence[str]) -> Iterator[tuple[str, jf.PointCloud]]:
    """The ISPRS samples."""
    for number in numbers:
        yield f"samp{number}", jf.read(samples.sample_path(folder, number))


def others(folder: Path) -> Iterator[tuple[str, jf.PointCloud]]:
    """Simulated scenes and squares of labelled tiles, on which the constants of the calibration were chosen."""
    rng = np.random.default_rng(0)
    for layout in clouds.LAYOUTS:
        for seed in (1, 2) if layout != "benchmark" else ():
            scene = jf.scenes.make(layout, size=(160.0, 140.0), density=float(rng.uniform(0.4, 1.2)), seed=seed)
            last = scene.cloud.return_number == scene.cloud.number_of_returns
            yield f"{layout}-{seed}", _labelled(scene.cloud.coordinates()[last], scene.truth[last])
    for path in sorted((folder / "tiles").glob("*.la[sz]")):
        if path.stem.startswith("lidR"):  # no method comes near its reference: 37 % error as given, 17 % at best
            continue
        tile = jf.read(path, units="m", returns="all")
        scored = ~np.isin(tile.classification, (0, *LEFT_OUT)) & (tile.return_number == tile.number_of_returns)
        xyz, truth = tile.coordinates()[scored], tile.classification[scored] == 2
        low, high = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
        found = 0
        for _ in range(30):
            side = rng.uniform(120, 220)
            corner = low + rng.uniform(0, 1, 2) * np.maximum(high - low - side, 0)
            some = np.flatnonzero(((xyz[:, :2] >= corner) & (xyz[:, :2] < corner + side)).all(axis=1))
            if len(some) < 5000 or not 0.05 < truth[some].mean() < 0.95:
                continue
            some = np.sort(rng.permutation(some)[:20000])
            yield f"{path.stem.split('_')[0]}-{found}", _labelled(xyz[some], truth[some])
            found += 1
            if found == 3:
                break


def _labelled(xyz: np.ndarray, truth: np.ndarray) -> jf.PointCloud:
    return jf.PointCloud.from_arrays(xyz, reference=truth)


def draw_labels(cloud: jf.PointCloud, shape: str, seed: int) -> np.ndarray:
    """bool[n]: 2 % of the points, in five patches of the points nearest to one that is drawn at random; in five profiles, those
    nearest to it in a strip of random direction; or all drawn at random."""
    rng = np.random.default_rng(seed)
    xy, truth = cloud.xyz[:, :2].astype(np.float64), cloud.reference
    out = np.zeros(len(cloud), bool)
    if shape == "points":
        out[rng.choice(len(cloud), round(SHARE * len(cloud)), replace=False)] = True
        return out
    each = max(10, round(SHARE * len(cloud) / PATCHES))
    found = 0
    for centre in rng.permutation(len(cloud)):
        away = xy - xy[centre]
        distance = np.hypot(*away.T)
        if shape == "profiles":
            turn = rng.uniform(0, np.pi)
            distance[np.abs(away @ [-np.sin(turn), np.cos(turn)]) > WIDTH / 2] = np.inf
        near = np.argpartition(distance, each)[:each]
        if not np.isfinite(distance[near]).all() or truth[near].all() or not truth[near].any() or out[near].any():
            continue
        out[near] = True
        found += 1
        if found == PATCHES:
            return out
    raise SystemExit(f"there are no {PATCHES} {shape} of {each} points with both classes")


def sample_rows(
    name: str, number: int, cloud: jf.PointCloud, shapes: Sequence[str], draws: int, size: int
) -> Iterator[Row]:
    """Total errors on the points without labels: as given, with the set that has fewest errors on the labels, calibrated, and
    with all labels known. Medians of the draws, a row per shape."""
    truth = cloud.reference
    ceiling, given = least(jf.calibrate(jf.SMRF(), cloud, truth, size=size))(cloud).ground, jf.SMRF()(cloud).ground
    for shape in shapes:
        columns: dict[str, list[float]] = {
            which: [] for which in ("given", "naive", "calibrated", "oracle", "expected")
        }
        for draw in range(draws):
            labelled = draw_labels(cloud, shape, 1000 * draw + number)
            found = jf.calibrate(jf.SMRF(), cloud, truth, labelled=labelled, size=size, seed=draw)
            tried = {
                "given": given,
                "naive": least(found)(cloud).ground,
                "calibrated": found.filter(cloud).ground,
                "oracle": ceiling,
            }
            for which, ground in tried.items():
                columns[which].append(jf.evaluate(ground, truth, ignore=labelled).total)
            columns["expected"].append(found.score)
        loss = np.subtract(columns["calibrated"], columns["oracle"])
        yield {
            "sample": name, "shape": shape, "points": len(cloud), "labelled": int(labelled.sum()), "draws": draws, "sets": size,
            **{which: float(np.median(values)) for which, values in columns.items()},
            "loss": float(np.median(loss)), "worst": float(loss.max()),
            "better": float(np.mean(np.less(columns["calibrated"], columns["given"]))),
        }  # fmt: skip


def least(found: jf.Calibration) -> jf.Filter:
    """The set with the fewest errors on the labels."""
    trials = found.trials
    best = int(trials.total.values.argmin())
    return found.filter.replace(**{name: trials[name].values[best].item() for name in found.searched})


def report(rows: list[Row]) -> str:
    """The tables as Markdown."""
    parts = [
        "# Calibration from a few labels",
        "SMRF, two rounds of sets over slope, threshold and scaling. Total error in "
        f"percent on the points without labels, medians of several draws of labels for {100 * SHARE:g} % of the points. "
        "Naive = the set with fewest errors on the labels. Oracle = the best of the same search with all labels; loss = "
        "calibrated - oracle. Cross-validated = the score that the calibration itself reports, on its labelled points. "
        "Better = share of the draws in which calibration was better than the given filter.",
    ]
    for shape in dict.fromkeys(row["shape"] for row in rows):
        some = [row for row in rows if row["shape"] == shape]
        near = sum(row["loss"] <= 0.5 for row in some)
        parts += [
            f"## Labels of {SHAPES[shape]}",
            f"{_all(some, 'draws')} draws, rounds of {_all(some, 'sets')} sets.",
            markdown(
                [
                    ("sample", "sample", ""), ("labelled", "labelled points", ",.0f"), ("given", "as given", ".2f"),
                    ("naive", "naive", ".2f"), ("calibrated", "calibrated", ".2f"), ("oracle", "oracle", ".2f"),
                    ("loss", "loss, points", ".2f"), ("worst", "worst draw", ".2f"), ("better", "better", ".1f"),
                    ("expected", "cross-validated", ".2f"),
                ],
                with_averages(some, "sample"),
            ),
            f"The loss is at most 0.5 points on {near} of {len(some)} clouds.",
        ]  # fmt: skip
    return "\n\n".join([*parts, ""])


def _all(rows: list[Row], column: str) -> str:
    return " or ".join(sorted({f"{row[column]}" for row in rows}, key=float))


if __name__ == "__main__":
    main()
