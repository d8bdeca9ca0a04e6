"""The ``jaxfilter`` command."""

from . import terrain as terrain
from .commands import main as main
