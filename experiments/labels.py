"""What the labels of the methods are now: numbers of ground points on fixed clouds. A page of results says which it stands on."""

from __future__ import annotations

import functools
import hashlib

import numpy as np

import jaxfilter as jf

SCENES = "scenes"
"""Named among the methods of a page that stands on simulated scenes; its numbers are those of points and of ground points."""
LAYOUTS = (
    "flat", "town", "city", "hills", "mountain", "forest", "quarry", "terraces", "mixed", "benchmark", "coast", "gorge",
    "benches", "vineyard", "canopy",
)  # fmt: skip


@functools.cache
def clouds() -> list[jf.PointCloud]:
    """A village at 0.7 points per m2, a steep wood at 9, and one at 4 that hides the ground; of points that no change of the
    package moves: last echoes in whole centimetres, with a step of terrain, boxes, trees, single low points and a pit."""
    found = []
    for side, density, slope, houses, trees in (
        (100.0, 0.7, 0.08, 0.25, 0.3),
        (30.0, 9.0, 0.3, 0.2, 0.4),
        (60.0, 4.0, 0.4, 0.0, 0.97),
    ):
        rng = np.random.default_rng(int(side))
        x, y = xy = rng.uniform(0, side, (2, int(density * side**2)))
        z = slope * (x + 0.4 * y) + 2 * np.sin(x / 15) * np.cos(y / 22) + 1.5 * (y > 0.6 * side + 4 * np.sin(x / 9))
        block = np.floor(x / 18).astype(int) + 97 * np.floor(y / 18).astype(int)
        built = (rng.random(1000)[block] < houses) & (np.abs(xy % 18 - 9) < 6).all(axis=0)
        z += built * (4 + 3 * rng.random(1000)[block]) + rng.normal(0, 0.03, len(x))
        z += ~built * (rng.random(len(x)) < trees) * rng.uniform(0.2, 14, len(x))
        z -= (rng.random(len(x)) < 0.0005) * rng.uniform(2, 9, len(x)) + 3 * (
            np.hypot(x - side / 3, y - side / 4) < 0.8
        )
        found.append(jf.PointCloud.from_arrays(np.column_stack([x + 5e5, y + 5.4e6, z + 300]).round(2)))
    return found


@functools.cache
def counts(name: str) -> str:
    """Ground points that a method finds by ``for_cloud`` on the first two of :func:`clouds`, and by its preset "paper" on the
    first; OST, which has rules for it, on the third, too."""
    if name == SCENES:
        made = [jf.scenes.make(layout, size=60.0, density=0.5, seed=1) for layout in LAYOUTS]
        return f"{sum(map(len, made))} {sum(int(scene.truth.sum()) for scene in made)}"
    method = jf.FILTERS[name]
    seen = clouds()[: 3 if name == "ost" else 2]
    results = [method.for_cloud(cloud)(cloud) for cloud in seen] + [method.preset("paper")(clouds()[0])]
    return " ".join(str(int(result.ground.sum())) for result in results)


def word(name: str) -> str:
    """A short word for :func:`counts`, for tables whose rows are kept from run to run: rows with another word are made anew."""
    return "l" + hashlib.blake2b(counts(name).encode(), digest_size=3).hexdigest()
