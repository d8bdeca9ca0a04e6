"""CSF (Zhang et al. 2016) on a LAS file, with the wheel ``cloth-simulation-filter``: ``python csf_wheel.py IN OUT``.

Last and only echoes are filtered; ground becomes class 2, the rest 1. Prints the seconds of the call alone as JSON.
"""

from __future__ import annotations

import json
import sys
import time

import CSF
import laspy
import numpy as np


def main() -> None:
    """Filter the file named on the command line with the wheel's defaults."""
    las = laspy.read(sys.argv[1])
    chosen = np.flatnonzero(np.asarray(las.return_number) == np.asarray(las.number_of_returns))
    xyz = np.ascontiguousarray(las.xyz[chosen])
    start = time.perf_counter()
    csf = CSF.CSF()
    csf.setPointCloud(xyz)
    ground, rest = CSF.VecInt(), CSF.VecInt()
    csf.do_filtering(ground, rest, False)
    seconds = time.perf_counter() - start
    classes = np.ones(len(las.points), np.uint8)
    classes[chosen[np.asarray(ground, np.int64)]] = 2
    las.classification = classes
    las.write(sys.argv[2])
    print(json.dumps({"seconds": seconds}))


if __name__ == "__main__":
    main()
