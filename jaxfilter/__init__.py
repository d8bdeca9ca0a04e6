"""Ground filtering of airborne lidar on JAX arrays: LAS in, classified LAS out.

Public names are loaded when they are first used, so that ``jaxfilter --help`` does not wait for JAX. Examples begin with
``scene = jf.scenes.make("mixed", size=60, density=1, seed=3)``, ``cloud, truth = scene.cloud, scene.truth`` and
``result = jf.default_filter(cloud)(cloud)``; ``scene.laz`` is that scene with its true classes, ``survey`` its two halves.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .core.version import __version__ as __version__
from .methods import __all__ as METHODS

if TYPE_CHECKING:
    from . import datasets, ops, plots, scenes
    from .core.cloud import PointCloud
    from .core.errors import ForkError, InputError, JaxfilterError, JaxfilterWarning, OutputError, ParameterError
    from .core.filter import Filter
    from .core.reading import Reading
    from .core.result import Decision, FilterResult, GroundFilter, Status
    from .files.reading import Classes, class_changes, read, write
    from .methods import *  # noqa: F403
    from .methods.default import default_filter
    from .methods.papers import citation
    from .reports.info import info
    from .reports.page import ReportOptions, report
    from .reports.places import review
    from .reviews.accuracy import accuracy_statement
    from .reviews.repair import apply
    from .reviews.survey import apply_survey, review_survey
    from .scoring import Scores, evaluate
    from .steps.batch import Batch
    from .steps.grid_filter import soft_labels
    from .surveys.collection import Collection, open
    from .surveys.ground import ground
    from .surveys.heights import heights
    from .surveys.model import terrain_model
    from .surveys.options import RunOptions
    from .surveys.products import products
    from .sweeps.batch import batch
    from .sweeps.calibrate import Calibration, CrossValidation, Study, calibrate
    from .sweeps.comparison import Comparison, compare
    from .sweeps.sweep import SweepOptions, sweep
    from .terrain.accuracy import HeightErrors, dtm_rmse
    from .terrain.contours import contours
    from .terrain.interpolation import Interpolation
    from .terrain.models import dtm, height_above_ground
    from .terrain.raster import Raster
    from .terrain.rasters import breaklines, chm, count, density, dsm, hillshade, voids

_HOMES = {
    "methods.papers": ("citation",), "core.cloud": ("PointCloud",), "core.reading": ("Reading",), "core.errors": ("ForkError",
    "InputError", "JaxfilterError", "JaxfilterWarning", "OutputError", "ParameterError"), "core.filter": ("Filter",),
    "core.result": ("Decision", "FilterResult", "GroundFilter", "Status"), "methods": METHODS,
    "methods.default": ("default_filter",), "files.reading": ("class_changes", "Classes", "read", "write"),
    "reports.info": ("info",), "terrain.raster": ("Raster",), "surveys.options": ("RunOptions",),
    "steps.grid_filter": ("soft_labels",), "scoring": ("evaluate", "Scores"),
    "sweeps.calibrate": ("calibrate", "Calibration", "CrossValidation", "Study"), "sweeps.comparison": ("compare", "Comparison"),
    "sweeps.sweep": ("sweep", "SweepOptions"), "terrain.interpolation": ("Interpolation",),
    "terrain.models": ("dtm", "height_above_ground"), "terrain.accuracy": ("dtm_rmse", "HeightErrors"), "reports.page": ("report",
    "ReportOptions"), "reports.places": ("review",), "surveys.collection": ("Collection", "open"), "surveys.ground": ("ground",),
    "surveys.heights": ("heights",), "surveys.model": ("terrain_model",), "surveys.products": ("products",),
    "terrain.contours": ("contours",), "terrain.rasters": ("breaklines", "chm",
    "count", "density", "dsm", "hillshade", "voids"), "reviews.repair": ("apply",),
    "reviews.survey": ("apply_survey", "review_survey"),
    "reviews.accuracy": ("accuracy_statement",), "sweeps.batch": ("batch",), "steps.batch": ("Batch",),
}  # fmt: skip
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "Batch", "Calibration", "Classes", "Collection", "Comparison", "CrossValidation", "Decision", "Filter", "FilterResult",
    "ForkError", "GroundFilter", "HeightErrors", "InputError", "Interpolation", "JaxfilterError", "JaxfilterWarning",
    "OutputError", "ParameterError", "PointCloud", "Raster", "Reading", "ReportOptions", "RunOptions", "Scores", "Status",
    "Study", "SweepOptions", "accuracy_statement", "apply", "apply_survey", "batch", "breaklines", "calibrate", "chm",
    "citation", "class_changes", "compare", "contours", "count", "datasets", "default_filter", "density", "dsm", "dtm",
    "dtm_rmse", "evaluate", "ground", "height_above_ground", "heights", "hillshade", "info", "open", "ops", "plots", "products",
    "read", "report", "review", "review_survey", "scenes", "soft_labels", "sweep", "terrain_model", "voids", "write",
]  # fmt: skip
__all__ += METHODS


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    if name in __all__:
        return import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
