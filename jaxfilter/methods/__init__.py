"""The methods, one file each, and the papers that they cite. A file is imported when its method is first asked for."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..core.params import FILTERS
    from .agptd import AGPTD
    from .atin import ATIN
    from .csf import CSF
    from .fptd import FPTD
    from .iptd import IPTD
    from .msf import MSF
    from .ost import OST
    from .pmf import PMF
    from .ppdf import PPDF
    from .ptd import PTD
    from .ptdf import PTDF
    from .smrf import SMRF
    from .spf import SPF
    from .stin import STIN

__all__ = [
    "AGPTD", "ATIN", "CSF", "FILTERS", "FPTD", "IPTD", "MSF", "OST", "PMF", "PPDF", "PTD", "PTDF", "SMRF", "SPF", "STIN",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name == "FILTERS":
        from ..core.params import FILTERS

        own = {one.lower(): f"{__name__}.{one.lower()}" for one in __all__ if one != name}
        FILTERS.data = own | FILTERS.data  # in this order; classes that are there already stay
        return FILTERS
    if name in __all__:
        return getattr(import_module(f"{__name__}.{name.lower()}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
