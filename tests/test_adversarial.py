"""Clouds that are made to hurt: every method gives labels or a clear error, soon.

``experiments/faults/adversarial.py`` measures time and memory on large versions of the same clouds.
"""

import time
import warnings

import pytest

import jaxfilter as jf
from experiments.faults.adversarial import CLOUDS

FILTERS = sorted(jf.FILTERS)
SECONDS = 10.0  # of the processor, without what is compiled once for all clouds


@pytest.fixture(scope="module", params=FILTERS)
def method(request, town):
    method = jf.FILTERS[request.param]
    method()(town.xyz)  # compiles
    return method


@pytest.mark.parametrize("name", CLOUDS)
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
