"""The papers behind the methods: the entries of ``papers.bib``, by their keys."""

from __future__ import annotations

from importlib.resources import files


def bibtex(*keys: str) -> str:
    """The entries with these keys, a blank line between them. Raises: KeyError for a key that none has.

    >>> from jaxfilter.methods.papers import bibtex
    >>> bibtex("pingel2013improved").splitlines()[0]
    '@article{pingel2013improved,'
    """
    blocks = (files(__package__) / "papers.bib").read_text(encoding="utf-8").strip().split("\n\n")
    entries = {block.partition("{")[2].partition(",")[0]: block for block in blocks}
    return "\n\n".join(entries[key] for key in keys)
