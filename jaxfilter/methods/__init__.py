"""The methods, one file each, and the papers that they cite. A file is imported when its method is first asked for."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ..core.params import FILTERS

if TYPE_CHECKING:
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

for _name in __all__:
    if _name != "FILTERS":
        FILTERS[_name] = f"{__name__}.{_name.lower()}"


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(import_module(f"{__name__}.{name.lower()}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
