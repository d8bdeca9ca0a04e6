"""The ``jaxfilter`` command."""

from . import sweeps as sweeps
from . import terrain as terrain
from .commands import main as main
