"""What surveys and windows cost: planning with a million files, one pass over a file, a corner of it, COPC over HTTP.

Each part runs in a process of its own, so that peaks of memory are its own; seconds are those of the processor.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import resource
import shlex
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyproj

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))  # with a maker of COPC files and a web server

import jaxfilter as jf
from experiments.report import markdown, write_csv, write_page
from jaxfilter.files import blocks
from jaxfilter.files.disk import Identity
from jaxfilter.files.sources import Source
from jaxfilter.files.windows import blocks_of, read_window
from jaxfilter.surveys.collection import Collection
from jaxfilter.surveys.plan import plan_tiles

TITLES = {
    "bytes": "bytes of the .vpc", "open_s": "CPU seconds to open", "open_and_check_s": "and to check",
    "thousand_questions_s": "CPU seconds for 1000 questions for the files of a box", "peak_gb": "peak memory, GB",
    "plan_s": "CPU seconds to plan", "pass_s": "CPU seconds of the pass", "index_bytes": "bytes of the index",
    "share_of_points": "share of the points in the corner", "share_of_bytes": "share of the bytes read for them",
    "window_s": "CPU seconds to read them",
}  # fmt: skip
FORMS = (
    dict.fromkeys(("files", "bytes", "tiles", "points", "index_bytes"), ",d")
    | dict.fromkeys(("share_of_points", "share_of_bytes"), ".2%")
    | dict.fromkeys(
        ("open_s", "open_and_check_s", "thousand_questions_s", "peak_gb", "plan_s", "pass_s", "window_s"), ".2f"
    )
)


def tiles(path: Path, count: int) -> dict[str, Any]:
    """A .vpc of square tiles of a kilometre."""
    side, wkt = math.isqrt(count - 1) + 1, pyproj.CRS.from_epsg(2154).to_wkt()
    corners = ((2e5 + 1000.0 * (k % side), 6e6 + 1000.0 * (k // side)) for k in range(count))
    members = (
        Source(f"tiles/{x:.0f}_{y:.0f}.copc.laz", "copc", (x, y, x + 1e3, y + 1e3), 10**7, (0.0, 99.0), wkt)
        for x, y in corners
    )
    Collection(members).to_vpc(path)
    return {"files": count, "bytes": path.stat().st_size}


def plan(path: Path) -> dict[str, Any]:
    """Open it, ask for the files of boxes, and plan its tiles."""
    found, start = {}, time.process_time()
    survey = jf.open(path)
    found["open_s"] = time.process_time() - start
    assert survey.crs is not None
    survey.check()
    found["open_and_check_s"] = time.process_time() - start
    start = time.process_time()
    for k in range(1000):
        survey.within((3e5 + 100 * k, 6.1e6, 3e5 + 100 * k + 1e3, 6.101e6))
    found["thousand_questions_s"] = time.process_time() - start
    start = time.process_time()
    found["tiles"] = len(plan_tiles(survey.footprints, survey.counts, halo=90))
    found["plan_s"] = time.process_time() - start
    return found | {"peak_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20}


def corner(path: Path, index: Path) -> dict[str, Any]:
    """The pass over a file, and the bytes for the lower left corner: a twentieth of each side."""
    read: list[int] = []
    packed = blocks.read_ranges
    blocks.read_ranges = lambda *a: read.append(a[3].sum()) or packed(*a)  # type: ignore[func-returns-value]
    source, start = jf.open(path, units="m")[0], time.process_time()
    blocks_of(source.place, Identity.of(source.place), index)
    found: dict[str, Any] = {
        "pass_s": time.process_time() - start,
        "index_bytes": next(index.rglob("*.npz")).stat().st_size,
    }
    read.clear()
    x0, y0, x1, y1 = source.bounds
    start = time.process_time()
    window = read_window(source, (x0, y0, x0 + (x1 - x0) / 20, y0 + (y1 - y0) / 20), index)
    shares = {"share_of_points": len(window.record) / source.count, "share_of_bytes": sum(read) / path.stat().st_size}
    return found | shares | {"window_s": time.process_time() - start}


def over_http(folder: Path) -> dict[str, Any]:
    """A hundredth of the area of a COPC file from a web server."""
    from las_files import OFFSETS, make_deep_copc
    from servers import RangeServer

    make_deep_copc(folder / "in.copc.laz", 6, 500)
    low = OFFSETS[:2] + [31.3, 62.6]
    with RangeServer(folder) as server:
        window = read_window(jf.open(f"{server.url}/in.copc.laz")[0], (*low, *(low + 10.0)))
        size = (folder / "in.copc.laz").stat().st_size
        return {"share_of_points": len(window.record) / (1365 * 500), "share_of_bytes": server.sent / size}


def _answer(pipe: Any, act: Callable[..., dict[str, Any]], arguments: tuple[Any, ...]) -> None:
    pipe.send(act(*arguments))


def alone(act: Callable[..., dict[str, Any]], *arguments: Any) -> dict[str, Any]:
    """What a part returns in a process of its own."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_answer, args=(theirs, act, arguments))
    process.start()
    found = ours.recv()
    process.join()
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=1_000_000, help="of the virtual point cloud")
    parser.add_argument("--points", type=int, default=5_000_000, help="of the LAS and LAZ files")
    parser.add_argument("--out", type=Path, help="folder for the page of results")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        results = {"vpc": alone(tiles, folder / "all.vpc", arguments.files), "plan": alone(plan, folder / "all.vpc")}
        (folder / "all.vpc").unlink()
        side = math.sqrt(arguments.points / 2)
        scene = jf.scenes.make("mixed", size=(side, side), density=1.5, seed=1)
        nothing = np.zeros(len(scene), bool)
        for suffix in ("las", "laz"):
            jf.write(folder / f"in.{suffix}", scene.cloud, nothing, reset="none")
            results[suffix] = {"points": len(scene)} | alone(
                corner, folder / f"in.{suffix}", folder / f"index_{suffix}"
            )
        results["http"] = alone(over_http, folder)
    rows = [{"part": part} | found for part, found in results.items()]
    text = "\n\n".join(
        markdown([(key, TITLES.get(key, key), FORMS.get(key, "")) for key in row], [row]) for row in rows
    )
    print(text)
    if arguments.out is not None:
        arguments.out.mkdir(parents=True, exist_ok=True)
        write_csv(arguments.out / "surveys.csv", rows)
        command = shlex.join(["python", "experiments/surveys/run.py", *sys.argv[1:]])
        write_page(arguments.out / "results.md", f"# What surveys cost\n\n{text}", command)


if __name__ == "__main__":
    main()
