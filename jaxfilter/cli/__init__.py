"""The ``jaxfilter`` command."""

from . import report as report
from . import sweeps as sweeps
from . import terrain as terrain
from .commands import main as main
