"""The ``jaxfilter`` command."""

from . import demo, report, surveys, sweeps, terrain, verdicts  # noqa: F401
from .commands import main as main
