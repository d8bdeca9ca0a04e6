"""One measurement in a process of its own: ``python measure.py TASK``, TASK and the answer on standard output as JSON.

A task names a ``method`` of the registry, the ``cloud`` (LAS) with its ``truth`` (bool[n], .npy), and
how many ``repeats`` of the warm call to make. Filters return NumPy arrays, so a call has ended when it returns.
"""

from __future__ import annotations

import time

START = time.perf_counter()

import json  # noqa: E402
import resource  # noqa: E402
import statistics  # noqa: E402
import sys  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402


def main() -> None:
    """Measure the task given on the command line."""
    print(json.dumps(measure(json.loads(sys.argv[1]))))


def measure(task: dict[str, Any]) -> dict[str, Any]:
    """Seconds of import, reading, first call and warm calls; compilations; peak memory; scores."""
    import jax
    import numpy as np

    import jaxfilter as jf
    from jaxfilter.core import compilation

    filter_ = jf.FILTERS[task["method"]]()
    jax.devices()
    imported = time.perf_counter() - START
    compilation.watch_compilations()
    compilation.keep_compilations()
    start = time.perf_counter()
    cloud = jf.read(task["cloud"], units="m")
    read = time.perf_counter() - start
    out: dict[str, Any] = {"points": len(cloud), "import_seconds": imported, "read_seconds": read}
    start = time.perf_counter()
    result = filter_(cloud)
    out["first_seconds"] = time.perf_counter() - start
    out["compilations"], out["compile_seconds"] = compilation.compilations()
    wall, cpu = [], []
    for _ in range(task["repeats"]):
        start, busy = time.perf_counter(), time.process_time()
        result = filter_(cloud)
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - busy)
    if wall:
        out["warm_seconds"], out["warm_cpu_seconds"] = statistics.median(wall), statistics.median(cpu)
    out["peak_bytes"] = peak_bytes()
    truth = np.load(task["truth"])
    scores = jf.evaluate(result, truth, candidates_only=True)
    out |= {"type1": scores.type1, "type2": scores.type2, "total": scores.total, "kappa": scores.kappa}
    if wall:
        before = compilation.compilations()[0]
        other = another_of_its_bucket(cloud)
        filter_(other)
        out["second_points"], out["second_compilations"] = len(other), compilation.compilations()[0] - before
    return out


def another_of_its_bucket(cloud: Any) -> Any:
    """The cloud without a strip along its eastern side: other points in other cells, in arrays of the same padded sizes.

    The strip is 3 % of the width, or less where that would take the points, or a grid with cells of 1 or 10 m, to
    another size. Raises: SystemExit if there is none.
    """
    import numpy as np

    from jaxfilter.core.compilation import bucket
    from jaxfilter.engines.grid.cells import padded_length
    from jaxfilter.surveys.tiles import part_of

    def sizes(points: int, width: float) -> list[int]:
        return [bucket(points), *(padded_length(int(width / cell) + more) for cell in (1.0, 10.0) for more in (0, 3))]

    x, width = cloud.xyz[:, 0], float(cloud.xyz[:, 0].max())
    for share in (0.97, 0.98, 0.99, 0.995):
        kept = x < np.float32(share * width)
        if sizes(int(kept.sum()), share * width) == sizes(len(cloud), width):
            return part_of(cloud, kept)
    raise SystemExit(
        f"{len(cloud)} points over {width:.0f} m are at the edge of a bucket: choose another number of points"
    )


def peak_bytes() -> int:
    """Largest resident memory of this process so far.

    Linux counts what the parent held at the fork in ``ru_maxrss``, but not in the status file.
    """
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
        return 1024 * int(line.split()[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    main()
