"""Run a command: ``python timed.py REPORT COMMAND ...``; REPORT gets its exit code, seconds and peak memory as JSON.

It exists because Linux adds the memory of the parent to the peak of a child, so that the parent must be small.
"""

import json
import resource
import subprocess
import sys
import time


def main() -> None:
    """Run the command of the command line and report on it."""
    start = time.perf_counter()
    code = subprocess.call(sys.argv[2:])
    seconds = time.perf_counter() - start
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    peak = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    figures = {"code": code, "seconds": seconds, "cpu_seconds": usage.ru_utime + usage.ru_stime, "peak_bytes": peak}
    with open(sys.argv[1], "w") as report:
        json.dump(figures, report)


if __name__ == "__main__":
    main()
