"""The clouds of other sensors: simulated scenes, and real ones that lie in ``other_sensors`` of the folder with data."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import jaxfilter as jf

SEED = 101
DRAWS = 11, 12, 13, 14
"""Further seeds of the scenes, drawn after the limits of OST had been set."""
SCENES = {
    "image matching": (("town", "city", "hills"), 90.0, 40.0),
    "drone lidar": (("forest", "town", "hills"), 50.0, 100.0),
    "mobile": (("town", "city", "hills"), 100.0, 30.0),
}
"""Layouts of each sensor, metres along a side, and pulses or pixels per m2."""
REAL = {
    "odmsem3d_brighton_small": "image matching",
    "rf4pcc_test": "image matching",
    "sea_cliff": "image matching",
    "spanner_UAS": "drone lidar",
    "spanner_ALS": "airborne lidar",
}
"""What sensor the real clouds are of."""


@dataclasses.dataclass(frozen=True, eq=False)
class Sensed:
    """A cloud of a known sensor.

    Attributes:
        truth: bool[n], ground; None = not known. scored: bool[n].
        beside: f64[k, 3], ground of another survey of the place, file units, against which the terrain is held.
    """

    name: str
    sensor: str
    cloud: jf.PointCloud
    truth: np.ndarray | None
    scored: np.ndarray
    beside: np.ndarray | None = None


def scene(sensor: str, layout: str, seed: int = SEED) -> Sensed:
    """One of :data:`SCENES`. Of drone lidar last echoes are judged and scored."""
    _, side, density = SCENES[sensor]
    made = jf.scenes.make(layout, size=side, density=density, seed=seed, sensor=sensor)
    return Sensed(f"{sensor}, {layout}", sensor, made.cloud, made.truth, made.cloud.candidate)


def real(folder: Path, name: str) -> Sensed:
    """One of :data:`REAL`. Class 0 is not scored where others are."""
    cloud = jf.read(folder / "other_sensors" / f"{name}.laz", units="m", ignore_classes=(7, 18))
    truth, beside, classes = cloud.reference, None, cloud.classification
    scored = cloud.candidate if classes is None else cloud.candidate & (classes != 0)
    if truth is None or not truth.any():
        truth, scored = None, cloud.candidate
    if name == "spanner_UAS":
        other = jf.read(folder / "other_sensors" / "spanner_ALS.laz", units="m")
        beside = other.coordinates()[other.reference & other.candidate]
    return Sensed(name, REAL[name], cloud, truth, scored, beside)


def every(folder: Path | None) -> Iterator[Sensed]:
    """All scenes, and the real clouds that are at hand."""
    for sensor, (layouts, _, _) in SCENES.items():
        yield from (scene(sensor, layout) for layout in layouts)
    for name in REAL:
        if folder is not None and (folder / "other_sensors" / f"{name}.laz").exists():
            yield real(folder, name)


def terrain_errors(known: Sensed, ground: np.ndarray) -> jf.HeightErrors | None:
    """Of the terrain model of ``ground``, bool[n], against the truth, or against the other survey; None without either."""
    if known.beside is None:
        return None if known.truth is None else jf.dtm_rmse(known.cloud, ground, known.truth, near=3.0)
    own = known.cloud.coordinates()
    both = jf.PointCloud.from_arrays(np.concatenate([own, known.beside]))
    more = len(known.beside)
    return jf.dtm_rmse(
        both,
        np.append(ground, np.zeros(more, bool)),
        np.append(np.zeros(len(own), bool), np.ones(more, bool)),
        near=3.0,
    )
