"""Labels of the ISPRS samples where the grid lies elsewhere: points shifted within a kilometre, grids from zero."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import jaxfilter as jf
from experiments.report import Row


def rows(path: Path, number: str, method: str, count: int) -> list[Row]:
    """A row for each place; these are the same for all methods."""
    shifts = np.random.default_rng(int(number)).uniform(0, 1000, (count, 2)).round(2)
    found = []
    for place, shift in enumerate(shifts.tolist()):
        cloud = jf.read(path, anchor=(-shift[0], -shift[1]))
        scores = jf.evaluate(jf.FILTERS[method].for_cloud(cloud)(cloud), cloud)
        found.append({"cloud": number, "method": method, "place": place, "total": scores.total, "kappa": scores.kappa})
    return found
