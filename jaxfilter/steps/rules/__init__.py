"""The rules of OST by name: what its core does not know of. Each is a frozen value in a file of its own, with its constants."""

from __future__ import annotations

from .crossings import CrossingsRule
from .embankments import EmbankmentsRule
from .halls import HallsRule
from .low_clusters import LowClustersRule
from .pits import PitsRule
from .plants import PlantsRule
from .ramps import RampsRule
from .scene import OstRule, OstScene
from .steep import SteepRule
from .strays import StraysRule
from .voids import VoidsRule

RULES: dict[str, OstRule] = {
    "clusters": LowClustersRule(),
    "strays": StraysRule(),
    "pits": PitsRule(),
    "voids": VoidsRule(),
    "halls": HallsRule(),
    "steep": SteepRule(),
    "embankments": EmbankmentsRule(),
    "crossings": CrossingsRule(),
    "plants": PlantsRule(),
    "ramps": RampsRule(),
}
"""In the order in which they take their turn. A rule of one's own is entered here under its name."""

__all__ = ["RULES", "OstRule", "OstScene"]
