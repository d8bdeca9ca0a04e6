"""The ``jaxfilter`` command."""

from . import surveys as surveys
from . import sweeps as sweeps
from . import terrain as terrain
from .commands import main as main
