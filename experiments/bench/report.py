"""How large a report is, how long it takes to write, and how quickly its slider answers in Chromium. See README.md."""

from __future__ import annotations

import argparse
import shlex
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.report import Column, Row, markdown, write_page
from jaxfilter.core.compilation import keep_compilations

HERE = Path(__file__).parent
COLUMNS: list[Column] = [
    ("method", "method", ""),
    ("points", "points", ",d"),
    ("steps", "steps of the slider", "d"),
    ("filter", "s, filter", ".1f"),
    ("report", "s, report", ".1f"),
    ("cpu", "CPU s, report", ".1f"),
    ("size", "MB", ".1f"),
    ("load", "s, page ready", ".1f"),
    ("slider", "ms, slider, median", ".0f"),
    ("slowest", "ms, slider, slowest", ".0f"),
]
SLIDE = """() => { const s = document.getElementById('slider'), out = report.facts.values.map(() => Infinity);
for (let pass = 0; pass < 3; pass++) for (let k = 0; k < out.length; k++) { const t = performance.now(); s.value = k;
s.dispatchEvent(new Event('input')); out[k] = Math.min(out[k], performance.now() - t); } return out; }"""
"""Milliseconds of every position, the best of three passes."""


def main(arguments: list[str] | None = None) -> None:
    """Measure, print a table, and write it where asked."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cloud", type=Path, nargs="?", help="file to read instead of a simulated scene")
    parser.add_argument("--points", type=float, default=5e6, help="about so many, of a simulated scene [%(default)g]")
    parser.add_argument("--methods", nargs="+", default=["smrf"], choices=list(jf.FILTERS), metavar="METHOD")
    parser.add_argument("--copies", type=int, default=1, help="of the cloud, side by side [%(default)s]")
    parser.add_argument("--out", type=Path, help="Markdown file to write")
    options = parser.parse_args(given)
    keep_compilations()
    cloud = _cloud(options.cloud, options.points, options.copies)
    rows = [_row(name, cloud) for name in options.methods]
    command = shlex.join(["python", "experiments/bench/report.py", *given])
    text = f"# Reports\n\n{markdown(COLUMNS, rows)}\n"
    print(text)
    if options.out is not None:
        write_page(options.out, text, command)


def _cloud(path: Path | None, points: float, copies: int) -> jf.PointCloud:
    if path is None:
        side = (points / 2.5) ** 0.5
        cloud = jf.scenes.make("mixed", size=(side, side), density=2.4, seed=0).cloud
    else:
        cloud = jf.read(path, units="m")
    if copies == 1:
        return cloud
    width = float(np.ptp(cloud.xyz[:, 0])) + 1.0
    return jf.PointCloud.from_arrays(np.vstack([cloud.coordinates() + [i * width, 0, 0] for i in range(copies)]))


def _row(name: str, cloud: jf.PointCloud) -> Row:
    filter_ = jf.FILTERS[name].for_cloud(cloud)
    result = filter_(cloud)
    with tempfile.TemporaryDirectory() as folder:
        clock, start = time.process_time(), time.perf_counter()
        path = jf.report(cloud, result, Path(folder) / "page.html")
        row: Row = {
            "method": name,
            "points": len(cloud),
            "filter": result.run.seconds if result.run else None,
            "report": time.perf_counter() - start,
            "cpu": time.process_time() - clock,
            "size": path.stat().st_size / 1e6,
        }
        return row | _in_browser(path)


def _in_browser(path: Path) -> Row:
    """Seconds until the page is ready, and milliseconds for every step of the slider; nothing without Chromium."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        return {}
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        start = time.perf_counter()
        page.goto(path.resolve().as_uri())
        page.wait_for_function("report.state.ready || report.state.failed", timeout=120_000)
        load, times = time.perf_counter() - start, page.evaluate(SLIDE)
        browser.close()
    return {"steps": len(times), "load": load, "slider": statistics.median(times), "slowest": max(times)}


if __name__ == "__main__":
    main()
