"""The rules of OST by name: what its core does not know of. Each is a frozen value in a file of its own, with its constants."""

from __future__ import annotations

from .crossings import Crossings
from .embankments import Embankments
from .halls import Halls
from .low_clusters import LowClusters
from .pits import Pits
from .plants import Plants
from .ramps import Ramps
from .scene import Rule, Scene
from .steep import Steep
from .voids import Voids

RULES: dict[str, Rule] = {
    "clusters": LowClusters(),
    "pits": Pits(),
    "plants": Plants(),
    "voids": Voids(),
    "halls": Halls(),
    "steep": Steep(),
    "embankments": Embankments(),
    "crossings": Crossings(),
    "ramps": Ramps(),
}
"""In the order in which they take their turn. A rule of one's own is entered here under its name."""

__all__ = ["RULES", "Rule", "Scene"]
