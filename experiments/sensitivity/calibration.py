"""How well a few labels choose the parameters of SMRF. See README.md."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.defaults.clouds import LAYOUTS
from experiments.report import Column, Row, markdown, with_averages
from experiments.sensitivity.study import Study
from experiments.tiles.run import LEFT_OUT
from jaxfilter.core.compilation import keep_compilations

PATCHES, WIDTH = 5, 4.0
"""How many patches or profiles, and the width of a profile in metres."""
SHARE = 0.02
"""Of the points of a cloud that are labelled, in all patches together."""
SIZE = 256
"""Sets per round of the search."""
SHAPES = {"patches": "five round patches", "profiles": "five profiles 4 m wide", "points": "single points"}
"""What is labelled; patches and profiles hold both classes."""
CLOUDS = {"isprs": "ISPRS samples", "others": "Scenes and tiles on which the constants of the calibration were chosen"}
COLUMNS: list[Column] = [
    ("sample", "cloud", ""), ("labelled", "labelled points", ",.0f"), ("given", "as given", ".2f"), ("naive", "naive", ".2f"),
    ("calibrated", "calibrated", ".2f"), ("oracle", "oracle", ".2f"), ("loss", "loss, points", ".2f"),
    ("worst", "worst draw", ".2f"), ("better", "better", ".1f"), ("expected", "cross-validated", ".2f"),
]  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    """Calibrate on every cloud, several times, and write the tables."""
    study = Study("calibration", __doc__, arguments, draws=10)
    keep_compilations()
    rows: list[Row] = []
    for which in CLOUDS:
        clouds = study.clouds().items() if which == "isprs" else others(study.folder)
        shapes, draws = (
            (SHAPES, study.options.draws) if which == "isprs" else (["patches"], min(3, study.options.draws))
        )
        for number, (name, cloud) in enumerate(clouds):
            for shape in shapes:
                rows.append({"clouds": which, "sample": name} | measured(cloud, number, shape, draws))
                print(rows[-1], flush=True)
    study.write("calibration", report(rows), rows, ("smrf", "scenes"))


def others(folder: Path) -> Iterator[tuple[str, jf.PointCloud]]:
    """Simulated scenes and squares of labelled tiles, on which the constants of the calibration were chosen."""
    rng = np.random.default_rng(0)
    for layout in LAYOUTS:
        for seed in (1, 2) if layout != "benchmark" else ():
            scene = jf.scenes.make(layout, size=(160.0, 140.0), density=float(rng.uniform(0.4, 1.2)), seed=seed)
            last = scene.cloud.return_number == scene.cloud.number_of_returns
            xyz = scene.cloud.coordinates()[last]
            yield f"{layout}-{seed}", jf.PointCloud.from_arrays(xyz, reference=scene.truth[last])
    for path in sorted((folder / "tiles").glob("*.la[sz]")):
        if path.stem.startswith("lidR"):  # no method comes near its reference
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
            yield f"{path.stem.split('_')[0]}-{found}", jf.PointCloud.from_arrays(xyz[some], reference=truth[some])
            found += 1
            if found == 3:
                break


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
        if out.sum() == PATCHES * each:
            return out
    raise SystemExit(f"there are no {PATCHES} {shape} of {each} points with both classes")


def measured(cloud: jf.PointCloud, number: int, shape: str, draws: int) -> Row:
    """Total errors on the points without labels, medians of the draws: as given, with the set that has fewest errors on the
    labels, calibrated, and with all labels known."""
    truth, totals = cloud.reference, []
    ceiling = least(jf.calibrate(jf.SMRF(), cloud, truth, size=SIZE))
    for draw in range(draws):
        labelled = draw_labels(cloud, shape, 1000 * draw + number)
        found = jf.calibrate(jf.SMRF(), cloud, truth, labelled=labelled, size=SIZE, seed=draw)
        tried = jf.SMRF(), least(found), found.filter, ceiling
        errors = [jf.evaluate(filter_(cloud).ground, truth, ignore=labelled).total for filter_ in tried]
        totals.append([*errors, found.score])
    medians = dict(zip(("given", "naive", "calibrated", "oracle", "expected"), np.median(totals, axis=0), strict=True))
    as_given, _, calibrated, oracle, _ = np.transpose(totals)
    return {
        "shape": shape, "points": len(cloud), "labelled": int(labelled.sum()), "draws": draws, **medians,
        "loss": float(np.median(calibrated - oracle)), "worst": float((calibrated - oracle).max()),
        "better": float(np.mean(calibrated < as_given)),
    }  # fmt: skip


def least(found: jf.Calibration) -> jf.Filter:
    """The set with the fewest errors on the labels."""
    best = int(found.trials.total.values.argmin())
    return found.filter.replace(**{name: found.trials[name].values[best].item() for name in found.searched})


def report(rows: list[Row]) -> list[str]:
    """The parts of the page as Markdown."""
    parts = [
        "# Calibration from a few labels",
        f"SMRF, two rounds of {SIZE} sets over slope, threshold and scaling. Total error in "
        f"percent on the points without labels, medians of several draws of labels for {100 * SHARE:g} % of the points. "
        "Naive = the set with fewest errors on the labels. Oracle = the best of the same search with all labels; loss = "
        "calibrated - oracle. Cross-validated = the score that the calibration itself reports, on its labelled points. "
        "Better = share of the draws in which calibration was better than the given filter.",
    ]
    for which, shape in dict.fromkeys((row["clouds"], row["shape"]) for row in rows):
        some = [row for row in rows if (row["clouds"], row["shape"]) == (which, shape)]
        near = sum(row["loss"] <= 0.5 for row in some)
        parts += [
            f"## {CLOUDS[which]}: labels of {SHAPES[shape]}",
            f"{some[0]['draws']} draws. The loss is at most 0.5 points on {near} of {len(some)} clouds.",
            markdown(COLUMNS, with_averages(some, "sample")),
        ]
    return parts


if __name__ == "__main__":
    main()
