"""What to cite for a method: BibTeX entries of the papers behind it."""

from __future__ import annotations

from typing import Any

from .core.errors import ParameterError


def citation(method: Any) -> str:
    """BibTeX for a method, given as its name, its class or an instance: what the class has in ``BIBTEX``.

    Raises: ParameterError if there is none.

    >>> print(jf.citation("smrf").partition(",")[0])
    @article{pingel2013improved
    """
    if isinstance(method, str):
        from .methods import FILTERS

        if method not in FILTERS:
            raise ParameterError(f"no citation for {method!r}; there are citations for {', '.join(FILTERS)}")
        method = FILTERS[method]
    cls = method if isinstance(method, type) else type(method)
    entries = getattr(cls, "BIBTEX", "")
    if not entries:
        raise ParameterError(f"no citation for {cls.__name__}: give the class an entry in BIBTEX")
    return str(entries)
