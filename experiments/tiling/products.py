"""CPU time and memory of ``products`` against those of ``ground`` and ``dtm`` one after the other, on one survey of 16 files.

    python experiments/tiling/products.py [--points 10_000_000] [--workers 2] [--work DIR]

Prints a line for each command, and the ratios. Memory is that of all processes together, sampled ten times a second.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf

SIDE = 4  # files along each side of the survey


def survey(folder: Path, points: int) -> None:
    """Simulated files beside each other, with terrain, trees and buildings, 5 pulses per m2."""
    folder.mkdir(parents=True, exist_ok=True)
    side = (points / SIDE**2 / 6.9) ** 0.5
    for k in range(SIDE**2):
        path, corner = folder / f"{k:02}.laz", (512_000 + k % SIDE * side, 5_403_000 + k // SIDE * side, 350.0)
        if not path.exists():
            cloud = jf.scenes.make("mixed", size=(side, side), density=5.0, seed=k, origin=corner).cloud
            jf.write(path, cloud, None)


def measured(*words: str | Path) -> tuple[float, float, float]:
    """CPU seconds, seconds, and bytes at most, of a command with its workers. Raises: CalledProcessError."""
    before, start, most = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter(), 0
    with subprocess.Popen([sys.executable, "-m", "jaxfilter", *map(str, words), "--units", "m", "-q"]) as process:
        while process.poll() is None:
            held = 0
            for one in [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]:
                try:
                    held += one.memory_info().rss
                except psutil.Error:
                    continue
            most = max(most, held)
            time.sleep(0.1)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, [str(word) for word in words])
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(f"{words[0]:9} {cpu:7.1f} CPU s  {time.perf_counter() - start:7.1f} s  {most / 1e9:5.2f} GB", flush=True)
    return cpu, time.perf_counter() - start, most


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=10_000_000)
    parser.add_argument("--workers", default="2")
    parser.add_argument("--work", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        out, source = Path(name), (options.work or Path(name)) / "survey"
        survey(source, options.points)
        print(f"{jf.open(source, units='m').count:,} points in {SIDE**2} files")
        more = ("--workers", options.workers)
        ground = measured("ground", source, out / "classified", *more)
        dtm = measured("dtm", out / "classified", out / "dtm.tif", *more)
        made = measured("products", source, out / "made", *more)
        memory = made[2] / max(ground[2], dtm[2])
        print(f"products / (ground + dtm): CPU {made[0] / (ground[0] + dtm[0]):.2f}, memory {memory:.2f}")


if __name__ == "__main__":
    main()
