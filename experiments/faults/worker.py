"""A process that reads and writes clouds as it is told, one JSON object a line, to be killed, raced and misled by run.py.

Its labels are a function of each point's own coordinates, so that a label on another point shows in the output.
"""

from __future__ import annotations

import json
import sys
import time
import zlib
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from jaxfilter.core.errors import JaxfilterError
from jaxfilter.files import records
from jaxfilter.files.reading import read, write

SCALE = 0.01


def rule(ticks: np.ndarray) -> np.ndarray:
    """bool[n], ground, of the integer coordinates i[n, 3]."""
    return (ticks.astype(np.int64) @ np.array([7, 13, 29]) >> 3 & 1).astype(bool)


def checksum(ticks: np.ndarray) -> int:
    """Of integer coordinates in their order."""
    return zlib.crc32(np.ascontiguousarray(ticks, "<i8").tobytes())


def label(source: Path, target: Path, overwrite: bool = False) -> int:
    """Read, label and write; the checksum of the coordinates that were read."""
    cloud = read(source, units="m")
    ticks = np.rint(cloud.coordinates() / SCALE)
    write(target, cloud, rule(ticks), overwrite=overwrite)
    return checksum(ticks)


def main() -> None:
    """Jobs: source, target, overwrite, at (when to begin, seconds of time.monotonic), chunk (points), forever."""
    print("ready", flush=True)
    for line in sys.stdin:
        job: dict[str, Any] = json.loads(line)
        records.CHUNK = job.get("chunk", 1_000_000)
        time.sleep(max(job.get("at", 0.0) - time.monotonic(), 0.0))
        outcome: dict[str, Any] = {"error": None, "message": ""}
        try:
            outcome["read"] = label(Path(job["source"]), Path(job["target"]), job.get("overwrite", False))
            while job.get("forever"):
                label(Path(job["source"]), Path(job["target"]), True)
        except JaxfilterError as error:
            outcome |= {"error": type(error).__name__, "message": str(error)}
        except Exception as error:  # anything else is what is looked for
            outcome |= {"error": "crash", "message": repr(error)}
        print(json.dumps(outcome), flush=True)


if __name__ == "__main__":
    main()
