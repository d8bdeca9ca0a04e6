"""CSF: the cloth simulation filter of Zhang et al. (2016)."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from ..core.cloud import QUANTUM
from ..core.compilation import bucket
from ..core.errors import InputError
from ..core.filter import Filter, Labels, lowest_among, passed
from ..core.grid import grid_over
from ..core.params import Preset, filter_params, param, static
from ..core.points import Points
from ..core.result import Decision, FilterResult, Progress
from ..engines.chunks import padded
from ..engines.cloth.drape import drape, join_slopes
from ..engines.cloth.surface import fill_along_lines, lowest_below
from ..engines.grid.cells import padded_shape
from ..engines.grid.sampling import corners
from ..steps.outliers import bar_outliers
from .papers import bibtex

GRAVITY = 0.2  # m per unit of time squared, as in the authors' program
START = 0.05  # metres between the lowest point and the cloth at the start
REST = 0.005  # metres per step; at rest when no particle moves as far
MARGIN_NODES = 2  # nodes beyond the points on every side
MAX_NODES = 100_000_000  # about 6 GB
_WORK, _WORK_PER_POINT = 2_500_000_000, 640_000
"""Particles times steps for few points, some seconds of a processor, and for each point of many."""
_HOLE = 60  # nodes across a hole that a cloth of rigidness 2 or 3 bridges with a sag of less than 2 m
_HARD = {"rigidness": 3, "surface": "nearest", "low_clusters": False}


@filter_params
class CSF(Filter):
    """A cloth that falls onto the cloud turned upside down; ground are the points near to where it comes to rest.

    W. Zhang, J. Qi, P. Wan, H. Wang, D. Xie, X. Wang, G. Yan (2016): An easy-to-use airborne LiDAR data filtering
    method based on cloth simulation. Remote Sens. 8(6), 501. doi:10.3390/rs8060501

    1. Particles stand on a grid of ``resolution`` metres. Each has the elevation of one of the points that are nearer
       to it than to other particles (``surface``); without one, that of the next particle that has one.
    2. The cloud is turned upside down. The cloth falls, held together by springs of a given ``rigidness``; particles
       that reach their elevation stay there for good (:func:`jaxfilter.engines.cloth.drape.drape`).
    3. Optional (``smooth``): particles beside one that lies on the ground, at an elevation that differs by less than
       ``max_step``, are put on the ground as well, and so on from there.
    4. Ground are the points less than ``threshold`` above or below the cloth, interpolated bilinearly.

    The result's ``height`` is metres above the cloth, ``slope`` that of the cloth in degrees, ``margin`` |height| minus
    the threshold; ``info`` has the numbers of particles, of those on the ground, and of steps.

    "wheel" has the defaults of the authors' Python package, cloth-simulation-filter 1.1.7, and repeats it; "cai2023"
    are the settings of Cai et al. (2023, Table 2) for the same program. "paper" takes gravity from the equation instead, and
    the finer resolution. In "recommended" the cloth is of medium rigidness, low clusters carry no cloth, and a particle
    falls onto the lowest of its points instead of the nearest.

    >>> result = jf.CSF(resolution=1.0, threshold=0.5)(cloud)
    >>> bool((result.ground == (np.abs(result.height) < 0.5)).all())
    True
    """

    resolution: float = static("particles of the cloth are this far apart", "GR > 0 m", default=1.0)
    rigidness: int = static(
        "the cloth suits steep (1), gentle (2) or flat terrain (3)", "RI", default=2, choices=(1, 2, 3)
    )
    threshold: float = param("ground is less than this far from the cloth", "hcc > 0 m", default=0.5)
    iterations: int = param("the cloth falls for at most this many steps", ">= 1 and <= 10000", default=500)
    time_step: float = param(
        "a step takes this time (no unit); gravity is 0.2 m per its square", "dT > 0 and <= 10", default=0.65
    )
    gravity: str = static(
        "a particle falls by 0.2 dT^2 per step, or 0.2 dT^4 (program)",
        default="equation",
        choices=("equation", "program"),
    )
    smooth: bool = static("a free particle joins ground beside it if no step is between", "ST", default=True)
    max_step: float = param("an elevation difference of this much or more is a step", "hcp > 0 m", default=0.3)
    surface: str = static(
        "a particle falls onto its nearest or lowest point", default="lowest", choices=("nearest", "lowest")
    )
    low_clusters: bool = static("clusters of low outliers do not carry the cloth", default=True)

    BIBTEX: ClassVar[str] = bibtex("zhang2016easy")
    LAST: ClassVar[tuple[str, ...]] = ("threshold",)
    PRESETS: ClassVar[dict[str, Preset]] = {
        "recommended": Preset("the default: medium rigidness, lowest points, low clusters carry no cloth"),
        "paper": Preset(
            "as printed for flat terrain (0.5 m, hard cloth, gravity as in the equation), except that the shares of the "
            "springs and their order are those of the authors' program",
            **_HARD, resolution=0.5,
        ),
        "wheel": Preset(
            "the defaults of cloth-simulation-filter 1.1.7 (resolution 1 m, hard cloth), in all details",
            **_HARD, gravity="program",
        ),
        "cai2023": Preset(
            "resolution 0.3 m, hard cloth: the CSF that Cai et al. (2023) compare with; smoothing and time step are not reported",
            **_HARD, gravity="program", resolution=0.3,
        ),
    }  # fmt: skip

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """The finest cloth, in steps of 0.1 m, that bridges the largest building, 0.5 m at least, as in the paper.

        A cloth of rigidness 2 sags by less than 2 m over a square hole of 60 particles. Sparse points are no reason for a
        coarser one: over simulated scenes with 0.1 to 1 points per m2 cloths of 1 m do better than cloths of 1.5 and 2 m.
        """
        if largest_building is None:
            return {}
        return {"resolution": max(0.5, 0.1 * math.ceil(10 * largest_building / _HOLE - 1e-6))}

    def halo(self) -> float:
        """Twice the width of the widest hole that the cloth bridges, with the margin, so that what holds it there hangs as in the
        whole; metres. Membranes of cloth over voids reach further."""
        return 2.0 * self.resolution * (_HOLE + MARGIN_NODES)

    def lattice(self) -> float:
        """The distance between particles."""
        return self.resolution

    def _barred(self, points: Points, workers: int | None) -> np.ndarray:
        """bool[m]: points that carry no cloth, but for a cloud in which none would."""
        return bar_outliers(points, clusters=self.low_clusters, workers=workers).barred

    def _margin(self, above: np.ndarray) -> np.ndarray:
        """f32[m], metres by which the distance from the cloth exceeds the threshold."""
        return np.abs(above) - np.float32(self.threshold)

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        """Labels of all points; see the class for the steps and :class:`jaxfilter.core.filter.Filter` for the call."""
        cell = self.resolution
        grid = grid_over(points.xyz, cell, points.offset(cell), name="CSF(resolution)", limit=MAX_NODES)
        first = (grid.x0 - MARGIN_NODES * cell, grid.y0 - MARGIN_NODES * cell)
        high = points.extent[1]
        columns, rows = (int((float(h) - o) / cell + 1e-6) + MARGIN_NODES for h, o in zip(high, first, strict=True))
        if rows * columns * self.iterations > max(_WORK, _WORK_PER_POINT * len(points)):
            raise InputError(
                f"CSF(resolution={cell:g}, iterations={self.iterations}): so many steps of {rows:,} x {columns:,} particles for "
                f"{len(points):,} points: use a coarser cloth or fewer steps"
            )
        extent, shape = (rows, columns), padded_shape((rows, columns))

        progress(0.0, "outliers")
        barred = self._barred(points, workers)
        size = bucket(len(points))
        xyz, carries = padded(points.xyz, size), padded(~barred, size)
        frame, true = np.asarray([*first, cell], np.float32), np.asarray(extent, np.int32)

        progress(0.1, "cloth")
        low, carried = lowest_below(xyz, carries, frame, true, shape, self.surface == "nearest")
        top = np.float32(_lowest(points, barred) - np.float32(START))
        exists = np.zeros(shape, bool)
        exists[:rows, :columns] = True
        limit = top - np.asarray(fill_along_lines(low, carried, exists))[:rows, :columns]
        moves = 1 - 0.7**self.rigidness, 0.5 * (1 - 0.4**self.rigidness)
        fall = GRAVITY * self.time_step ** (2 if self.gravity == "equation" else 4)
        cloth = drape(limit, moves, fall, REST, int(self.iterations), workers)
        height, pinned = cloth.height, cloth.pinned
        if self.smooth:
            joined = join_slopes(limit, pinned, self.max_step)
            height, pinned = np.where(joined, limit, height), pinned | joined

        progress(0.9, "classifying")
        z = np.pad(top - height, [(0, n - m) for n, m in zip(shape, extent, strict=True)])
        above, slope = (np.asarray(a)[: len(points)] for a in _test(xyz, z, frame, true))
        margin = self._margin(above)
        ground = margin < 0
        decision = np.where(ground, Decision.ACCEPTED, np.where(above < 0, Decision.LOW, Decision.SURFACE))
        info = {"particles": rows * columns, "on_ground": int(pinned.sum()), "steps": cloth.steps}
        progress(1.0, "done")
        return Labels(
            ground,
            height=above,
            slope=slope,
            margin=margin,
            decision=decision.astype(np.uint8),
            barred=barred,
            info=info,
        )


@passed.register(CSF)
def _passed(filter_: CSF, labels: Labels | FilterResult) -> np.ndarray:
    """Sets that differ in the threshold share the cloth."""
    assert labels.height is not None
    return filter_._margin(labels.height) < 0


@lowest_among.register(CSF)
def _carriers(filter_: CSF, points: Points) -> np.ndarray:
    """The points that carry the cloth, which begins to fall above all of them."""
    return ~filter_._barred(points, None)


def _lowest(points: Points, barred: np.ndarray) -> np.float32:
    """The elevation above which the cloth begins to fall, local metres: that of the lowest point, or of the whole scene."""
    cloud = points.cloud
    if cloud.whole is None or cloud.whole.lowest is None:
        return points.xyz[~barred, 2].min()
    return np.float32(np.rint((cloud.whole.lowest - cloud.origin[2]) * cloud.units.z / QUANTUM) * QUANTUM)


@jax.jit
def _test(xyz: jax.Array, cloth: jax.Array, frame: jax.Array, extent: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Height of points over the cloth (m) and the slope of the cloth there (degrees), f32[n] each."""
    values, u, v = corners((xyz[:, :2] - frame[None, :2]) / frame[2], extent, cloth.shape[1])
    southwest, southeast, northwest, northeast = values(cloth)
    south, north = southwest + u * (southeast - southwest), northwest + u * (northeast - northwest)
    east = (1 - v) * (southeast - southwest) + v * (northeast - northwest)
    slope = jnp.rad2deg(jnp.arctan(jnp.hypot(east, north - south) / frame[2]))
    return xyz[:, 2] - (south + v * (north - south)), slope
