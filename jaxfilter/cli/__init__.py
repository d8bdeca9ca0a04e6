"""The ``jaxfilter`` command."""

from . import demo as demo
from . import pdal as pdal
from . import report as report
from . import surveys as surveys
from . import sweeps as sweeps
from . import terrain as terrain
from . import verdicts as verdicts
from .commands import main as main
