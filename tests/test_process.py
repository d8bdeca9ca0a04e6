"""Children of fork, in processes of their own: an error instead of waiting for ever."""

import os
import subprocess
import sys

import pytest

import jaxfilter as jf

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="fork is not here")

SCRIPT = """
import os, sys, warnings
import numpy as np
import jaxfilter as jf

laz = sys.argv[1]
xyz = np.random.default_rng(0).uniform(0, 20, (500, 3))
ground = xyz[:, 2] < 10

def forked(*steps):
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    try:
        for step in steps:
            try:
                step()
            except jf.ForkError as error:
                assert "spawn" in str(error) and isinstance(error, jf.JaxfilterError)
            else:
                os._exit(1)
        os._exit(7)
    except BaseException as error:
        print(error, flush=True)
        os._exit(2)

cloud = jf.PointCloud.from_arrays(xyz)
read, classify = lambda: jf.read(laz), lambda: jf.SMRF()(xyz)
steps = [read, classify]
if sys.argv[2] != "nothing":
    {"read": read, "classify": classify}[sys.argv[2]]()
    steps += [
        lambda: jf.write(laz + ".2.laz", cloud, ground),
        lambda: jf.sweep(jf.SMRF(), xyz, {"slope": [0.1, 0.2]}),
        lambda: jf.calibrate(jf.SMRF(), xyz, ground.astype(np.int8)),
    ]
print([forked(step) for step in steps])
"""


@pytest.mark.parametrize(
    ("first", "codes"),
    [("read", [7] * 5), pytest.param("classify", [7] * 5, marks=pytest.mark.slow), ("nothing", [1, 1])],
)
def test_children_of_fork_say_spawn_where_threads_were_lost(tmp_path, rng, first, codes):
    laz = tmp_path / "cloud.laz"
    jf.write(laz, jf.PointCloud.from_arrays(rng.uniform(0, 20, (500, 3))), rng.random(500) < 0.5)
    run = subprocess.run([sys.executable, "-c", SCRIPT, laz, first], capture_output=True, text=True, timeout=120)
    assert run.stdout.strip() == str(codes), run.stdout + run.stderr
