"""Clouds that are made to hurt: every method gives labels or a clear error, soon.

``experiments/faults/adversarial.py`` measures time and memory on large versions of the same clouds.
"""

import time
import warnings

import numpy as np
import pytest

import jaxfilter as jf
from experiments.faults.adversarial import CLOUDS

QUICK = "ost", "ptd", "smrf"
FILTERS = [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in sorted(jf.FILTERS)]
SECONDS = 10.0  # of the processor, without what is compiled once for all clouds


@pytest.fixture(scope="module", params=FILTERS)
def method(request, town):
    method = jf.FILTERS[request.param]
    method()(town.xyz)  # compiles
    return method


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n == "millimetres" else n for n in CLOUDS])
def test_labels_or_a_clear_error(method, name):
    xyz = CLOUDS[name](0.01)
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jf.JaxfilterWarning)
        try:
            result = method()(xyz)
        except jf.InputError as error:
            assert name.startswith("far") and "stray points" in str(error) and "1 of" in str(error)
        else:
            assert not name.startswith("far")
            assert len(result) == len(xyz) and result.ground.any()
    assert time.process_time() - start < SECONDS


SPARSE = np.random.default_rng(3).uniform(0, (600, 500, 0.1), (300, 3)) + [0, 0, 1000]
"""300 points on level ground at 1,000 m, in every 30th cell of a metre."""


@pytest.mark.parametrize(("filter_", "words"), [
    (lambda: jf.SPF(cell=1.0, fill="zero"), None),  # cells at elevation 0 all round raise every other: no seed is left
    (lambda: jf.STIN(outlier_surface="quadratic", outlier_distance=1e-6), None),  # all points are outliers
    (lambda: jf.OST(spacing=1e9), ""),
    (lambda: jf.FPTD(radius=1.0, min_neighbours=10**9), "must be >= 1 and <= 4096"),
    pytest.param(lambda: jf.OST(landscape=1e9, window=1000.0), "", marks=pytest.mark.slow),
    (lambda: jf.CSF(resolution=0.3, iterations=10_000), "so many steps of .* particles for 300 points"),
    (lambda: jf.CSF(time_step=1e9), "must be > 0 and <= 10"),
    (lambda: jf.AGPTD(neighbours=10**6), "must be >= 0 and <= 4096"),
    (lambda: jf.PTD(seed_cell=0.001), "cells of 0.001 m for the seeds make .* use larger ones"),
    (lambda: jf.SMRF(cell=0.5, window=300.0), "600 openings of .* cells for 300 points: use larger cells or a smaller"),
    (lambda: jf.PPDF(window=3000.0), "more than 1000 cells of canopy_cell=2 m"),
])  # fmt: skip
def test_odd_parameters_give_labels_or_a_clear_error(filter_, words):
    """``experiments/faults/parameters.py`` tries a thousand sets."""
    if words == "":
        assert filter_()(SPARSE * [0.05, 0.05, 1.0]).ground.any()
    elif words is None:
        with pytest.warns(jf.JaxfilterWarning, match="no point is left as a seed of the ground"):
            ground = filter_()(SPARSE).ground
        assert ground[SPARSE[:, 2].argmin()]
    else:
        with pytest.raises((jf.ParameterError, jf.InputError), match=words):
            filter_()(SPARSE)
