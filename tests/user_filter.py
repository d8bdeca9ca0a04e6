"""A filter on a grid as a user writes it: what an opening leaves standing by more than a tolerance is an object."""

import math
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxfilter.core.params import Preset, filter_params, param, static
from jaxfilter.engines.grid.inpaint import fill_membrane
from jaxfilter.engines.grid.morphology import opening
from jaxfilter.steps.grid_filter import Heights, LowOutlierFilter, Surface
from jaxfilter.steps.surfaces import Cells

STEEP = 0.4


@filter_params
class Sieve(LowOutlierFilter):
    """Cells that sink in the opening by more than ``drop`` are filled from the others. Lengths in metres."""

    BIBTEX: ClassVar[str] = "@misc{sieve, title = {A user's filter on a grid}}"
    PRESETS: ClassVar[dict[str, Preset]] = {
        "paper": Preset("as printed, but there is no paper"),
        "recommended": Preset("the default"),
    }

    window: float = static("radius of the opening: half the width of the largest building", "> 0 m", default=15.0)
    drop: float = param("a cell that sinks by more is an object", "> 0 m", default=0.5)
    below: float = param("tolerance below the surface", "> 0 m", default=0.6)
    above: float = param("tolerance above the surface", "> 0 m", default=0.4)

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        own = {} if largest_building is None else {"window": largest_building / 2}
        return own | {"cell": max(1.0, spacing / 2)}

    def halo(self) -> float:
        return 2 * self.window + 3 * self.cell + 30.0 * self.low_clusters

    def surface(self, prepared: Cells) -> Surface:
        cells, reach = prepared, math.ceil(self.window / self.cell)
        filled = fill_membrane(cells.lowest, cells.seen, cells.valid).z
        sunk = filled - opening(filled, reach, reach, valid=cells.valid)
        kept = cells.seen & (sunk <= self.drop)
        return Surface.over(cells, fill_membrane(filled, kept, cells.valid).z)

    def test(self, surface: Surface, xyz: jax.Array) -> Heights:
        height, slope = surface.at(xyz)
        more = 0.5 * jnp.minimum(slope, STEEP)
        return Heights(height, slope, above=height - self.above - more, below=-height - self.below - more)
