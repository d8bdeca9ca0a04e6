"""The papers behind the methods: the entries of ``papers.bib``, by their keys."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

from ..core.errors import ParameterError
from ..core.params import FILTERS


def bibtex(*keys: str) -> str:
    """The entries with these keys, a blank line between them. Raises: KeyError for a key that none has.

    >>> from jaxfilter.methods.papers import bibtex
    >>> bibtex("pingel2013improved").splitlines()[0]
    '@article{pingel2013improved,'
    """
    blocks = (files(__package__) / "papers.bib").read_text(encoding="utf-8").strip().split("\n\n")
    entries = {block.partition("{")[2].partition(",")[0]: block for block in blocks}
    return "\n\n".join(entries[key] for key in keys)


def citation(method: Any) -> str:
    """BibTeX for a method, given as its name, its class or an instance: what the class has in ``BIBTEX``.

    Raises: ParameterError if there is none.

    >>> print(jf.citation("smrf").partition(",")[0])
    @article{pingel2013improved
    """
    if isinstance(method, str):
        if method not in FILTERS:
            raise ParameterError(f"no citation for {method!r}; there are citations for {', '.join(FILTERS)}")
        method = FILTERS[method]
    cls = method if isinstance(method, type) else type(method)
    entries = getattr(cls, "BIBTEX", "")
    if not entries:
        raise ParameterError(f"no citation for {cls.__name__}: give the class an entry in BIBTEX")
    return str(entries)
