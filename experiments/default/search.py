"""The constants of OST: their ranges, the sets that are tried, and what each set does on every cloud."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.stats import qmc

import jaxfilter as jf
from experiments.defaults import clouds
from experiments.isprs import samples
from experiments.remake import word
from experiments.report import Row, read_csv, write_csv

RANGES: dict[str, tuple[float, float]] = {
    "slope": (0.06, 0.11), "relief": (0.3, 0.6), "landscape": (20.0, 45.0),
    "roof_step": (0.2, 0.45), "roof_share": (0.5, 0.75), "roof_drop": (1.5, 3.5), "roof_drop_share": (0.4, 0.65),
    "tolerance": (0.06, 0.16), "tolerance_spacing": (0.1, 0.25), "scaling": (0.6, 1.2),
    "max_distance": (0.9, 1.6), "distance_relief": (0.5, 1.2), "max_angle": (5.0, 12.0),
    "angle_relief": (35.0, 80.0), "noise": (0.05, 0.15), "scene_spread": (4.0, 9.0), "local_spread": (2.2, 3.6),
}  # fmt: skip
"""Constants that are searched, and between what. The first set is the one the method began with, by hand."""
REASONED = {
    "cell": "a metre, which furrows and vehicles do not fill; a quarter of the spacing where that is more",
    "window": "buildings are up to 50 m wide", "roof_area": "a small house", "spacing": "as measured",
    "sensor": "by the points", "rules": "those for the sensor",
    "low_points": "tried: 15, 30, 45, 60 on the ISPRS samples at eight places of the grid; where a disk of the window holds "
    "fewer than 1500 points, a fiftieth of these",
    "rounds": "tried: 0 to 6 on the ISPRS samples, 3 to 10 on all clouds",
}  # fmt: skip
"""Constants that are not searched, and why they are as they are."""
SCENES = 1.0
"""Density of the scenes that constants are chosen on, pulses per square metre."""


def every_cloud(folder: Path) -> Iterator[clouds.Known]:
    """The samples, all 18 labelled tiles, and the scenes that constants are chosen on."""
    for number in samples.SAMPLES:
        cloud = jf.read(samples.sample_path(folder, number))
        assert cloud.reference is not None
        yield clouds.Known(f"samp{number}", f"site {number[0]}", cloud, cloud.reference, np.ones(len(cloud), bool))
    for path in sorted((folder / "tiles").glob("*.la[sz]")):
        known = clouds.load("tiles", path.stem, path.stem, folder)
        assert known is not None
        source = "ign" if path.stem.startswith("ign") else path.stem.split("_")[0]
        yield clouds.Known(path.stem, f"source {source}", known.cloud, known.ground, known.scored)
    for layout in clouds.LAYOUTS:
        known = clouds.load(f"{SCENES:g} per m2", layout, SCENES, folder)
        assert known is not None
        yield clouds.Known(f"scene {layout}", "scenes", known.cloud, known.ground, known.scored)


def sets(count: int) -> list[dict[str, float]]:
    """The defaults of the method, then sets that fill the ranges evenly (Sobol)."""
    first = {name: float(getattr(jf.FILTERS["ost"](), name)) for name in RANGES}
    low, high = np.array(list(RANGES.values())).T
    unit = qmc.Sobol(len(RANGES), seed=7).random_base2(max(count - 1, 1).bit_length())[:count]
    return [first, *(dict(zip(RANGES, map(float, low + (high - low) * row), strict=True)) for row in unit)]


def tried(folder: Path, count: int, out: Path) -> list[Row]:
    """A row for every set and cloud, with errors of both kinds as counts; those that are in the file, by the labels of now,
    are not run again."""
    path, now = out / "search.csv", word("ost")
    rows = [row for row in (read_csv(path) if path.exists() else []) if row["labels"] == now]
    done, known = {(row["set"], row["cloud"]) for row in rows}, list(every_cloud(folder))
    for number, values in enumerate(sets(count)):
        for one in known:
            if (number, one.name) in done:
                continue
            found = jf.OST.for_cloud(one.cloud, **values)(one.cloud).ground[one.scored]
            truth = one.ground[one.scored]
            rows.append({
                "set": number, "cloud": one.name, "group": one.group, "points": len(truth), "ground": int(truth.sum()),
                "lost": int((truth & ~found).sum()), "wrong": int((~truth & found).sum()), "labels": now,
            })  # fmt: skip
        write_csv(path, rows)
        print(f"set {number} of {count}", file=sys.stderr, flush=True)
    return rows
