"""Speed and peak memory against number of points, beside other programs; and reports. See README.md."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.bench import peers
from experiments.report import Column, Row, markdown, write_csv, write_page

HERE = Path(__file__).parent
COMMAND = "import sys; from jaxfilter.cli import main; sys.exit(main())"
METHODS = ("smrf", "fptd")
"""Of reports."""
SLIDE = """() => { const s = document.getElementById('slider'), out = report.facts.values.map(() => Infinity);
for (let pass = 0; pass < 3; pass++) for (let k = 0; k < out.length; k++) { const t = performance.now(); s.value = k;
s.dispatchEvent(new Event('input')); out[k] = Math.min(out[k], performance.now() - t); } return out; }"""
"""Milliseconds of every position, the best of three passes."""

TIMES: list[Column] = [
    ("name", "method", ""), ("points", "points", ",d"), ("warm_seconds", "warm, s", ".2f"),
    ("warm_cpu_seconds", "warm, CPU s", ".2f"), ("command_seconds", "command, s", ".2f"),
    ("command_cpu_seconds", "command, CPU s", ".2f"), ("command_peak", "command, GB", ".2f"),
    ("peak", "in process, GB", ".2f"), ("total", "total error, %", ".2f"), ("kappa", "kappa, %", ".2f"),
]  # fmt: skip
STARTS: list[Column] = [
    ("name", "method", ""), ("points", "points", ",d"), ("import_seconds", "import, s", ".2f"),
    ("read_seconds", "read, s", ".2f"), ("first_seconds", "first call, s", ".2f"),
    ("cached_first_seconds", "first call, cached, s", ".2f"), ("warm_seconds", "warm call, s", ".2f"),
    ("compilations", "compiled", "d"), ("compile_seconds", "compiling, s", ".2f"),
    ("second_points", "second cloud, points", ",d"), ("second_compilations", "it compiles", "d"),
]  # fmt: skip
REPORTS: list[Column] = [
    ("method", "method", ""), ("points", "points", ",d"), ("steps", "steps of the slider", "d"), ("report", "written, s", ".1f"),
    ("cpu", "written, CPU s", ".1f"), ("size", "MB", ".1f"), ("load", "page ready, s", ".1f"),
    ("slider", "slider, median, ms", ".0f"), ("slowest", "slider, slowest, ms", ".0f"),
]  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    """Measure what the command line asks for and write the tables."""
    given = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(given)
    options.out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(dir=options.out) as folder:
        scenes = [make_scene(Path(folder), millions) for millions in sorted(options.sizes)]
        for name in options.only:
            if name in jf.FILTERS:
                rows += of_method(name, scenes, Path(folder) / name, options.repeats)
            else:
                rows.append({"name": name, "density": 1.0} | whole_command(name, scenes[0], Path(folder)))
            print(rows[-1], file=sys.stderr, flush=True)
    rows.sort(key=lambda row: (row["points"], options.only.index(row["name"])))
    write_csv(options.out / ("bench.csv" if options.page == "results" else f"{options.page}.csv"), rows)
    command = shlex.join(["python", "experiments/bench/run.py", *given])
    reports = [of_report(name, options.reports) for name in METHODS] if options.reports else []
    text = report(rows, reports, options.repeats)
    write_page(options.out / f"{options.page}.md", text, command, (*options.only, "scenes"))
    print(f"results are in {options.out}")


def make_scene(folder: Path, millions: float) -> Path:
    """A scene of about so many million points at one per m2 as LAS, with its truth beside it as .npy."""
    path, side = folder / f"benchmark_{millions:g}M.las", 1e3 * millions**0.5 / 1.04  # vegetation and edges add echoes
    scene = jf.scenes.make("benchmark", size=side, density=1.0, seed=1)
    jf.write(path, scene.cloud, np.zeros(len(scene), bool), reset="none")
    np.save(path.with_suffix(".npy"), scene.truth)
    return path


def of_method(name: str, scenes: list[Path], scratch: Path, repeats: int) -> list[Row]:
    """A row per scene. The first process finds the compilation cache empty, all others find it filled."""
    scratch.mkdir()
    rows = []
    for place in scenes:
        task = {"method": name, "cloud": str(place), "truth": str(place.with_suffix(".npy")), "repeats": repeats}
        row = _measured(task, scratch)
        again = row.pop("first_seconds")
        if place == scenes[0]:
            row["first_seconds"] = again
            again = _measured(task | {"repeats": 0}, scratch)["first_seconds"]
        row |= {"cached_first_seconds": again} | whole_command(name, place, scratch)
        rows.append({"name": name, "density": 1.0} | row)
    return rows


def _environment(scratch: Path) -> dict[str, str]:
    paths = [str(HERE.parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    return os.environ | {"JAXFILTER_CACHE": str(scratch / "cache"), "PYTHONPATH": os.pathsep.join(paths)}


def _measured(task: Row, scratch: Path) -> Row:
    line = [sys.executable, str(HERE / "measure.py"), json.dumps(task)]
    done = subprocess.run(line, stdout=subprocess.PIPE, text=True, check=True, env=_environment(scratch))
    return dict(json.loads(done.stdout))


def whole_command(name: str, place: Path, scratch: Path) -> Row:
    """Wall and CPU seconds and peak memory of the command from LAS to LAS; of other programs the scores of what it wrote, too."""
    target, figures = scratch / "out.las", scratch / "figures.json"
    line = [sys.executable, "-c", COMMAND, "ground", name, str(place), str(target), "--units=m", "-q", "--overwrite"]
    cloud = None if name in jf.FILTERS else jf.read(place, units="m")
    if cloud is not None:
        line = peers.command(name, place, target)
        if name == "pcl_pmf":
            peers.write_pcd(place.with_suffix(".pcd"), cloud.xyz[cloud.candidate])
    launcher = [sys.executable, "-S", str(HERE / "timed.py"), str(figures)]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    done = subprocess.run([*launcher, *line], check=True, env=_environment(scratch), **streams)
    used = json.loads(figures.read_text())
    if used["code"] != 0:
        raise SystemExit(f"{shlex.join(line)}: exit code {used['code']}\n{done.stdout}")
    row: Row = {f"command_{key}": used[key] for key in ("seconds", "cpu_seconds", "peak_bytes")}
    if cloud is None:
        return row
    row["points"] = len(cloud)
    if name == "csf_wheel":
        row["warm_seconds"] = json.loads(done.stdout.splitlines()[-1])["seconds"]
    if target.exists():
        ground, truth = jf.read(target, units="m").classification == 2, np.load(place.with_suffix(".npy"))
        scores = jf.evaluate(ground, truth, ignore=~cloud.candidate)
        row |= {"type1": scores.type1, "type2": scores.type2, "total": scores.total, "kappa": scores.kappa}
    return row


def of_report(name: str, millions: float) -> Row:
    """How large a report of a simulated scene is, how long it takes to write, and how quickly its slider answers in Chromium."""
    cloud = jf.scenes.make("mixed", size=1e3 * (millions / 2.5) ** 0.5, density=2.4, seed=0).cloud
    result = jf.FILTERS[name].for_cloud(cloud)(cloud)
    with tempfile.TemporaryDirectory() as folder:
        clock, start = time.process_time(), time.perf_counter()
        path = jf.report(cloud, result, Path(folder) / "page.html")
        row: Row = {"method": name.upper(), "points": len(cloud), "report": time.perf_counter() - start}
        row |= {"cpu": time.process_time() - clock, "size": path.stat().st_size / 1e6}
        chromium = shutil.which("chromium") or shutil.which("google-chrome")
        return row | (_in_browser(path, chromium) if chromium else {})


def _in_browser(path: Path, chromium: str) -> Row:
    """Seconds until the page is ready, and milliseconds for every step of the slider."""
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


def report(rows: list[Row], reports: list[Row], repeats: int) -> str:
    """Everything as Markdown."""
    gigabytes = {"peak": "peak_bytes", "command_peak": "command_peak_bytes"}
    shown = [row | {key: row[name] / 1e9 for key, name in gigabytes.items() if name in row} for row in rows]
    text = [
        "# Speed and memory",
        f"Scene `benchmark`, one pulse per m2. Warm = a call on a cloud in memory, after a first one, median of {repeats}. "
        "Command = a fresh process from LAS to LAS with a filled compilation cache. CPU seconds are those of all threads. In "
        "process = peak memory of a process that reads and filters. Errors are over the points that are filtered.",
        markdown(TIMES, shown),
        "## Start",
        "First call = in a process that finds the compilation cache empty; cached = in one that finds it filled by the process "
        "of the smallest cloud. The second cloud lacks a strip of up to 3 % of the width; its arrays have the same padded sizes.",
        markdown(STARTS, [row for row in shown if "cached_first_seconds" in row]),
    ]
    if reports:
        text += ["## Reports", "Of a simulated scene, opened in Chromium if there is one.", markdown(REPORTS, reports)]
    return "\n\n".join(text)


def _parser() -> argparse.ArgumentParser:
    have = [*jf.FILTERS, *peers.installed()]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--only", nargs="+", choices=have, default=have, metavar="NAME", help=f"of {', '.join(have)} [all]"
    )
    parser.add_argument(
        "--sizes", nargs="+", type=float, default=[0.3, 1.0], metavar="M", help="million points [%(default)s]"
    )
    parser.add_argument("--repeats", type=int, default=3, help="warm calls, of which the median counts [%(default)s]")
    parser.add_argument("--reports", type=float, default=0.0, metavar="M", help="million points of reports [none]")
    parser.add_argument("--page", default="results", help="name of the page, such as large [%(default)s]")
    parser.add_argument("--out", type=Path, default=HERE / "out", help="folder for the results [%(default)s]")
    return parser


if __name__ == "__main__":
    main()
