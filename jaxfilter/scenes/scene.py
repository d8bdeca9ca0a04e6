"""Scenes: a cloud, the truth about each of its points, and the terrain it was taken from."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ..core.cloud import PointCloud
from ..core.errors import ParameterError, check_choice, check_positive, check_whole
from ..core.grid import Grid, grid_over
from ..core.params import is_number
from .lattice import box_of
from .layouts import ASPRS, LAYOUTS, Kind, SceneLayout
from .objects import open_deck
from .scan import Echoes, echoes, pulses
from .sensors import SENSORS, mobile, photographs
from .terrain import Patch, Terrain

_TILE = 1024.0
ROUNDING = (0.01, 0.001)
"""Coordinate steps in metres that a scene may have."""


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """A simulated survey. Arrays have length n, in the order of time, echoes of a pulse from first to last.

    Attributes:
        layout: what stands in it.
        seed: of every random choice.
        size: east-west and north-south extent, metres.
        origin: f64[3], metres: easting and northing of the lower left corner, and what is added to elevations.
        xyz: f64[n, 3], projected coordinates, metres.
        kind: u8[n], see :class:`Kind`.
        return_number, number_of_returns: u8[n].

    >>> scene
    Scene(5033 points on 60 x 60 m, 49.0 % ground, seed 3)
    >>> scene.truth.shape == scene.kind.shape == (len(scene),)
    True
    """

    layout: SceneLayout
    seed: int
    size: tuple[float, float]
    origin: np.ndarray
    xyz: np.ndarray
    kind: np.ndarray
    return_number: np.ndarray
    number_of_returns: np.ndarray

    def __len__(self) -> int:
        return len(self.xyz)

    def __repr__(self) -> str:
        share = 100 * float(self.truth.mean()) if len(self) else float("nan")
        width, height = self.size
        return f"Scene({len(self)} points on {width:g} x {height:g} m, {share:.1f} % ground, seed {self.seed})"

    @functools.cached_property
    def truth(self) -> np.ndarray:
        """bool[n]: ground.

        >>> bool((scene.classes[scene.truth] == 2).all())
        True
        """
        return self.kind == Kind.GROUND

    @functools.cached_property
    def classes(self) -> np.ndarray:
        """u8[n]: the ASPRS class each point ought to have.

        >>> bool(set(scene.classes.tolist()) <= set(jf.scenes.ASPRS.tolist()))
        True
        """
        return ASPRS[self.kind]

    @functools.cached_property
    def cloud(self) -> PointCloud:
        """The cloud as delivered before classification: class 0 throughout, and the truth as its reference.

        >>> len(scene.cloud) == len(scene), bool((scene.cloud.reference == scene.truth).all())
        (True, True)
        """
        return PointCloud.from_arrays(
            self.xyz,
            return_number=self.return_number,
            number_of_returns=self.number_of_returns,
            classification=np.zeros(len(self), np.uint8),
            reference=self.truth,
            name="scene",
        )

    def terrain(self, x: Any, y: Any) -> np.ndarray:
        """Elevation of the bare terrain, without noise, f64 of the broadcast shape, at projected x and y in metres.

        Under buildings, bridges and water it is the ground or the bed below; :meth:`water_level` is the surface of water. It is
        the function that the points were made with, and is defined beyond the scene as well.

        >>> x, y, z = scene.xyz[scene.truth].T
        >>> bool(np.abs(z - scene.terrain(x, y)).mean() < 0.05)
        True
        """
        return self._sampled(x, y, lambda patch, *at: patch(*at).z) + self.origin[2]

    def water(self, x: Any, y: Any) -> np.ndarray:
        """Whether there is water, bool of the broadcast shape, at projected x and y in metres.

        >>> scene.water(*scene.xyz[:, :2].T).shape == (len(scene),)
        True
        """
        return self._sampled(x, y, lambda patch, *at: patch(*at).water) > 0

    def water_level(self, x: Any, y: Any) -> np.ndarray:
        """Elevation of the surface of water that returns echoes, f64 of the broadcast shape, at projected x and y in metres; NaN
        elsewhere.

        >>> bool(np.isnan(scene.water_level(*scene.xyz[:, :2].T)).all())  # that of this layout returns none
        True
        """
        return self._sampled(x, y, lambda patch, *at: patch(*at).level) + self.origin[2]

    def deck(self, x: Any, y: Any) -> np.ndarray:
        """Elevation of bridge decks and jetties, f64 of the broadcast shape, at projected x and y in metres; NaN elsewhere.

        >>> np.isfinite(scene.deck(*scene.xyz[:, :2].T)).sum() >= (scene.kind == jf.scenes.Kind.BRIDGE).sum()
        np.True_
        """
        return self._sampled(x, y, lambda patch, *at: open_deck(patch, patch(*at), *at)) + self.origin[2]

    def _sampled(self, x: Any, y: Any, sample: Callable[[Patch, np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        """f64 of the broadcast shape of projected x and y: what ``sample`` finds on patches, there in the scene's frame."""
        bx, by = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        fx, fy = bx.ravel() - self.origin[0], by.ravel() - self.origin[1]
        found, terrain = np.empty(len(fx)), Terrain(self.layout, self.seed)
        tile = np.floor(fx / _TILE) * 2.0**24 + np.floor(fy / _TILE)
        order = np.argsort(tile, kind="stable")
        for part in np.split(order, np.flatnonzero(np.diff(tile[order])) + 1) if len(order) else []:
            found[part] = sample(terrain.patch(box_of(fx[part], fy[part])), fx[part], fy[part])
        return found.reshape(bx.shape)

    def terrain_grid(self, cell: float) -> tuple[np.ndarray, Grid]:
        """The bare terrain at the centres of the cells of the cloud's own grid.

        Returns elevations f64[ny, nx] (projected frame, metres; row 0 is the southern edge) and the grid, in the local
        frame of ``cloud``. Raises: ParameterError for a cell that is not positive, InputError for one that is too fine.

        >>> z, grid = scene.terrain_grid(2.0)
        >>> z.shape == (grid.ny, grid.nx)
        True
        """
        check_positive(" of metres", cell=cell)
        cloud = self.cloud
        grid = grid_over(cloud.xyz, cell, cloud.grid_offset(cell))
        x = cloud.origin[0] + grid.x0 + (np.arange(grid.nx) + 0.5) * cell
        y = cloud.origin[1] + grid.y0 + (np.arange(grid.ny) + 0.5) * cell
        return self.terrain(x[None, :], y[:, None]), grid


def make(
    layout: str | SceneLayout = "mixed",
    *,
    size: float | tuple[float, float] = (400.0, 300.0),
    density: float | None = None,
    seed: int = 0,
    noise: float | None = None,
    pattern: str = "parallel",
    swath: float | None = None,
    overlap: float = 0.0,
    rounding: float = 0.01,
    origin: tuple[float, float, float] = (512_000.0, 5_403_000.0, 350.0),
    sensor: str = "airborne lidar",
) -> Scene:
    """Simulate a survey, by default one with lidar from the air. The same arguments give the same scene, bit for bit.

    Terrain and objects depend on the layout and the seed alone; extent, density and flight only decide where they are
    sampled, so one place can be surveyed twice.

    Args:
        layout: the name of a ready layout (see :data:`LAYOUTS`) or a :class:`SceneLayout`.
        size: east-west and north-south extent in metres; one number for a square.
        density: pulses per square metre, 0.1 to 1000, by default 4. Every pulse has one last (or only) echo, except over water;
            vegetation and roof edges add echoes before it.
        seed: of every random choice, 0 or more.
        noise: standard deviation of the ranging noise in elevation, metres, 0 to 0.5, by default 0.03.
        pattern: ``"parallel"`` scan lines, as of a rotating mirror, or ``"zigzag"``, as of an oscillating one.
        swath: width of a flight strip, metres, at least 50, by default 600.
        overlap: share of the swath that neighbouring strips have in common, 0 to 0.6; the mean density stays as asked.
        rounding: step of the coordinates, 0.01 or 0.001 m.
        origin: easting and northing of the lower left corner, and what is added to elevations; metres, rounded to
            whole steps of ``rounding``.
        sensor: the name of one of :data:`SENSORS`, by which density, noise and swath have other defaults: ``"drone lidar"`` is as
            ``"airborne lidar"``; ``"image matching"`` makes points of photographs, and ``"mobile"`` those of a scanner on a car.
            Both have single echoes, and know neither pattern nor strips.

    Raises: ParameterError for an unknown name or a value out of range.

    >>> scene = jf.scenes.make("mixed", size=60, density=1, seed=3)
    >>> scene
    Scene(5033 points on 60 x 60 m, 49.0 % ground, seed 3)
    >>> scene.cloud.xyz.shape == (len(scene), 3)
    True
    """
    layout = LAYOUTS.get(layout, layout) if isinstance(layout, str) else layout
    if not isinstance(layout, SceneLayout):
        raise ParameterError(f"make(layout={layout!r}): choose one of {', '.join(LAYOUTS)}, or pass a SceneLayout")
    check_choice(SENSORS, sensor=sensor)
    usual = SENSORS[sensor]
    density, noise, swath = (
        getattr(usual, name) if value is None else value
        for name, value in (("density", density), ("noise", noise), ("swath", swath))
    )
    width, height = (size, size) if is_number(size) else _numbers("size", size, 2)
    for name, value, low, high, unit in (
        ("size", width, 1, 100_000, " m"),
        ("size", height, 1, 100_000, " m"),
        ("density", density, 0.1, 1000, " pulses per square metre"),
        ("noise", noise, 0, 0.5, " m"),
        ("swath", swath, 50, 5000, " m"),
        ("overlap", overlap, 0, 0.6, ""),
    ):
        if not (is_number(value) and low <= value <= high):
            raise ParameterError(f"make({name}={value!r}): must be between {low:g} and {high:g}{unit}")
    if width * height * density > 1e9:
        raise ParameterError(f"make(size={size!r}, density={density:g}): must be at most 1e9 pulses")
    check_whole(0, seed=seed)
    check_choice(("parallel", "zigzag"), pattern=pattern)
    check_choice(ROUNDING, rounding=rounding)
    corner = np.rint(np.array(_numbers("origin", origin, 3), np.float64) / rounding) * rounding

    terrain = Terrain(layout, int(seed))
    taken: Iterator[Echoes]
    if sensor == "image matching":
        taken = photographs(terrain, (width, height), density, noise)
    elif sensor == "mobile":
        taken = mobile(terrain, (width, height), density, noise)
    else:
        shots = pulses(terrain, (width, height), density, pattern, swath, overlap, rounding)
        taken = (echoes(terrain.patch(box_of(s.x, s.y)), s, usual.footprint, noise, density) for s in shots)
    parts = [Echoes(np.zeros((0, 3)), *np.zeros((3, 0), np.uint8))]  # no pulse may meet a small scene
    for part in taken:
        part.xyz[:] = np.rint((part.xyz + corner) / rounding) * rounding
        parts.append(part)
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Scene(layout, int(seed), (float(width), float(height)), corner, *columns)


def _numbers(name: str, values: Any, length: int) -> tuple[Any, ...]:
    several = isinstance(values, (tuple, list, np.ndarray)) and len(values) == length
    if not several or not all(is_number(v) and math.isfinite(v) for v in values):
        raise ParameterError(f"make({name}={values!r}): must be {length} finite numbers")
    return tuple(values)
