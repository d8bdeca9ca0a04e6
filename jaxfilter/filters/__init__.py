"""The methods, one file each, and the papers that they cite. Importing this package enters them all in FILTERS."""

from ..core.params import FILTERS
from .agptd import AGPTD
from .atin import ATIN
from .csf import CSF
from .fptd import FPTD
from .iptd import IPTD
from .msf import MSF
from .pmf import PMF
from .ppdf import PPDF
from .ptd import PTD
from .ptdf import PTDF
from .smrf import SMRF
from .spf import SPF
from .stin import STIN

__all__ = [
    "AGPTD",
    "ATIN",
    "CSF",
    "FILTERS",
    "FPTD",
    "IPTD",
    "MSF",
    "PMF",
    "PPDF",
    "PTD",
    "PTDF",
    "SMRF",
    "SPF",
    "STIN",
]
