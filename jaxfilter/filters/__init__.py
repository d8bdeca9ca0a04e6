"""The methods, one file each. Importing this package enters them all in FILTERS."""

from collections.abc import Mapping

from ..core.filter import Filter
from ..core.params import FILTERS as _REGISTRY
from .fptd import FPTD
from .ptd import PTD

FILTERS: Mapping[str, type[Filter]] = _REGISTRY
"""Every filter class by name, for example ``FILTERS["fptd"]``; look-ups ignore case."""

__all__ = ["FILTERS", "FPTD", "PTD"]
