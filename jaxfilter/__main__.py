"""``python -m jaxfilter``: the command."""

from .cli import main

main(prog_name="jaxfilter")
