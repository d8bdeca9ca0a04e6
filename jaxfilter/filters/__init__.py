"""The methods, one file each. Importing this package enters them all in FILTERS."""

from ..core.params import FILTERS
from .fptd import FPTD
from .msf import MSF
from .pmf import PMF
from .ptd import PTD
from .smrf import SMRF

__all__ = ["FILTERS", "FPTD", "MSF", "PMF", "PTD", "SMRF"]
