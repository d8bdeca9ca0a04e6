"""Ground filtering of airborne lidar on JAX arrays: LAS in, classified LAS out.

Public names are loaded when they are first used, so that ``jaxfilter --help`` does not wait for JAX. Examples begin with
``scene = jf.scenes.make("mixed", size=60, density=1, seed=3)``, ``cloud, truth = scene.cloud, scene.truth`` and
``result = jf.default_filter(cloud)(cloud)``; ``scene.laz`` is that scene with its true classes, ``survey`` its two halves.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .core.version import __version__ as __version__

if TYPE_CHECKING:
    from . import plots, scenes
    from .citing import citation
    from .core.cloud import PointCloud
    from .core.errors import ForkError, InputError, JaxfilterError, JaxfilterWarning, OutputError, ParameterError
    from .core.filter import Filter
    from .core.result import Decision, FilterResult, GroundFilter, Status
    from .files.reading import class_changes, info, read, write
    from .methods import AGPTD, ATIN, CSF, FILTERS, FPTD, IPTD, MSF, OST, PMF, PPDF, PTD, PTDF, SMRF, SPF, STIN
    from .methods.default import default_filter
    from .pdal import from_pdal
    from .reports import report, review
    from .scoring import Scores, evaluate
    from .steps.grid_filter import soft_labels
    from .surveys.border import CutObject, cut_objects
    from .surveys.collection import Collection, open
    from .surveys.ground import ground
    from .surveys.heights import heights
    from .surveys.model import terrain_model
    from .surveys.options import RunOptions
    from .sweeps.calibrate import Calibration, Study, calibrate
    from .sweeps.comparison import Comparison, compare
    from .sweeps.sweep import sweep
    from .terrain.models import dtm, dtm_rmse, height_above_ground
    from .terrain.raster import Raster

_HOMES = {
    "citing": ("citation",),
    "core.cloud": ("PointCloud",),
    "core.errors": ("ForkError", "InputError", "JaxfilterError", "JaxfilterWarning", "OutputError", "ParameterError"),
    "core.filter": ("Filter",), "core.result": ("Decision", "FilterResult", "GroundFilter", "Status"),
    "methods": (
        "AGPTD", "ATIN", "CSF", "FILTERS", "FPTD", "IPTD", "MSF", "OST", "PMF", "PPDF", "PTD", "PTDF", "SMRF", "SPF", "STIN",
    ),
    "methods.default": ("default_filter",),
    "files.reading": ("class_changes", "info", "read", "write"),
    "terrain.raster": ("Raster",), "pdal": ("from_pdal",),
    "surveys.border": ("CutObject", "cut_objects"), "steps.grid_filter": ("soft_labels",),
    "scoring": ("Scores", "evaluate"), "sweeps.calibrate": ("Calibration", "Study", "calibrate"),
    "sweeps.comparison": ("Comparison", "compare"), "sweeps.sweep": ("sweep",),
    "terrain.models": ("dtm", "dtm_rmse", "height_above_ground"),
    "surveys.collection": ("Collection", "open"), "reports": ("report", "review"),
    "surveys.ground": ("ground",), "surveys.heights": ("heights",), "surveys.options": ("RunOptions",),
    "surveys.model": ("terrain_model",),
}  # fmt: skip
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "AGPTD", "ATIN", "CSF", "FILTERS", "FPTD", "IPTD", "MSF", "OST", "PMF", "PPDF", "PTD", "PTDF", "SMRF", "SPF", "STIN",
    "Calibration", "Collection", "Comparison", "CutObject", "Decision", "Filter", "FilterResult", "ForkError", "GroundFilter",
    "InputError", "JaxfilterError", "JaxfilterWarning", "OutputError", "ParameterError", "PointCloud", "Raster", "RunOptions",
    "Scores", "Status", "Study", "calibrate", "citation", "class_changes", "compare", "cut_objects", "default_filter", "dtm",
    "dtm_rmse", "evaluate", "from_pdal", "ground", "height_above_ground", "heights", "info", "open", "plots", "read",
    "report", "review", "scenes", "soft_labels", "sweep", "terrain_model", "write",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    if name in __all__:
        return import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
