"""The ``jaxfilter`` command."""

from .commands import main as main
