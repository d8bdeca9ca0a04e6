"""JAX_ENABLE_X64=1 changes nothing, nor does strict promotion of ranks and types: all methods in a process that has them."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import jaxfilter as jf

VARIANTS = {
    **{name: {} for name in sorted(jf.FILTERS)},
    "csf smooth": {"smooth": True, "rigidness": 1},
    "pmf points": {"reading": "points", "compare": "points"},
    "smrf cut": {"cut": 20.0},
}
"""Parameters that take other ways through the compiled functions than the defaults do."""

STRICT = {"JAX_NUMPY_RANK_PROMOTION": "raise", "JAX_NUMPY_DTYPE_PROMOTION": "strict"}
SCRIPT = """
import sys
import jax
import numpy as np
from test_x64 import results
assert jax.config.jax_enable_x64
np.savez(sys.argv[1], **results())
"""


def cloud():
    """As large as that of test_filters.py, so that its compilations serve here."""
    rng = np.random.default_rng(6)
    xy = rng.uniform(0, 80, (6000, 2)).round(1)
    z = 0.05 * xy[:, 0] + rng.normal(0, 0.03, len(xy))
    z[(np.abs(xy - 40) < 8).all(axis=1)] += 5
    z[rng.random(len(xy)) < 0.1] += 2
    z[:3] -= 9
    return np.column_stack([xy, z]).round(2)


def results():
    """Labels, heights and margins of every variant, f32 or bool [n]."""
    out = {}
    for name, changes in VARIANTS.items():
        result = jf.FILTERS[name.split()[0]](**changes)(cloud())
        out |= {f"{name} {key}": getattr(result, key) for key in ("ground", "height", "margin")}
    out["counts"] = np.array(jf.evaluate(out["smrf ground"], out["pmf ground"]).total)
    return out


@pytest.mark.slow
@pytest.mark.skipif(os.environ.get("JAX_ENABLE_X64") == "1", reason="this process has it")
def test_all_methods_give_the_same_with_64_bits(tmp_path):
    path = str(tmp_path / "x64.npz")
    environment = {**os.environ, "JAX_ENABLE_X64": "1", **STRICT}
    other = subprocess.Popen([sys.executable, "-c", SCRIPT, path], cwd=Path(__file__).parent, env=environment)
    here = results()
    assert other.wait(timeout=300) == 0
    with np.load(path) as there:
        assert set(there) == set(here)
        for name, values in here.items():
            np.testing.assert_array_equal(there[name], values, err_msg=name)
