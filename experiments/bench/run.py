"""Speed and peak memory against number of points, density and area, beside other programs. See README.md."""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.bench import peers
from experiments.report import Column, Row, markdown, read_csv, save_png, write_csv, write_page

HERE = Path(__file__).parent
COMMAND = "import sys; from jaxfilter.cli import main; sys.exit(main())"
DENSE = {"vertex_spacing": 0.7, "noise_floor": 0.1}


@dataclasses.dataclass(frozen=True)
class Case:
    """A filter with its parameters, and the least density (points per m2) at which it is of interest."""

    method: str
    parameters: dict[str, float]
    least_density: float = 0.0


CASES = {name: Case(name, {}) for name in jf.FILTERS} | {
    f"{name}_spaced": Case(name, DENSE, 4.0)
    for name, method in jf.FILTERS.items()
    if all(hasattr(method, field) for field in DENSE)
}
"""Every method with its defaults; ``_spaced``: at most one vertex per square of 0.7 m, and points within 0.1 m of their
facet are ground."""


def main(arguments: list[str] | None = None) -> None:
    """Measure what the command line asks for and write tables and a figure."""
    given = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(given)
    if options.platform:
        os.environ["JAX_PLATFORMS"] = options.platform
    rows, failures = measure_all(options)
    if not rows:
        raise SystemExit("nothing was measured")
    if options.add:
        rows = added(rows, options.out / "bench.csv")
    large = options.page != "results"
    write_csv(options.out / f"{options.page if large else 'bench'}.csv", rows)
    text = report(rows, options.repeats)
    command = shlex.join(["python", "experiments/bench/run.py", *given])
    methods = [CASES[name].method for name in options.only if name in CASES]
    write_page(options.out / f"{options.page}.md", text, command, (*methods, "scenes"))
    if not large:
        scaling(rows, options.out / "scaling.png")
    print(text)
    if failures:
        raise SystemExit(f"{failures} measurements failed, see above")


def added(rows: list[Row], path: Path) -> list[Row]:
    """The rows with those of an earlier run that they do not replace, by density and name."""
    earlier = [{k: v for k, v in row.items() if v != ""} for row in read_csv(path)] if path.exists() else []

    def key(row: Row) -> tuple[float, str, int]:
        return float(row["density"]), row["name"], int(row["points"])

    known = {key(row) for row in rows}
    names = [*CASES, *peers.ALL]
    return sorted(
        [*rows, *(row for row in earlier if key(row) not in known)],
        key=lambda row: (float(row["density"]), names.index(row["name"]), int(row["points"])),
    )


def measure_all(options: argparse.Namespace) -> tuple[list[Row], int]:
    """A row per method and scene, and how many measurements failed (out of memory, say)."""
    scenes = options.out / "scenes"
    scenes.mkdir(parents=True, exist_ok=True)
    rows, failures = [], 0
    for density, millions in itertools.product(options.densities, options.sizes):
        place = make_scene(scenes, millions, density)
        for name in options.only:
            if density < CASES[name].least_density if name in CASES else millions > options.peer_limit:
                continue
            try:
                row = {"name": name, "density": density, **measure_row(name, place, options)}
            except subprocess.CalledProcessError as error:
                _say(f"{name} at {density:g} points/m2, {millions:g} million points: {error}\n{error.stderr}")
                failures += 1
                continue
            rows.append({**row, "area_km2": row["points"] / density / 1e6})
            _say(
                f"{name:12} {density:4g}/m2 {row['points']:>9,} points  warm {row.get('warm_seconds', np.nan):7.2f} s  "
                f"command {row['command_seconds']:7.2f} s  total error {row.get('total', np.nan):5.2f} %"
            )
        if not options.keep_scenes:
            for path in scenes.iterdir():
                path.unlink()
    return rows, failures


def measure_row(name: str, place: Path, options: argparse.Namespace) -> Row:
    """All figures of a method on a scene. Raises: subprocess.CalledProcessError."""
    with tempfile.TemporaryDirectory(dir=options.out) as scratch:
        row = measure_case(CASES[name], place, Path(scratch), options.repeats) if name in CASES else {}
        return row | whole_command(name, place, Path(scratch))


def make_scene(folder: Path, millions: float, density: float) -> Path:
    """A scene of about so many million points as LAS, with its truth beside it as .npy; made once."""
    path = folder / f"benchmark_{density:g}_{millions:g}M.las"
    if not path.exists():
        side = 1e3 * (millions / density) ** 0.5 / 1.04  # vegetation and edges add echoes: 3 to 13 % by scene
        scene = jf.scenes.make("benchmark", size=side, density=density, seed=1)
        jf.write(path, scene.cloud, np.zeros(len(scene), bool), reset="none")
        np.save(path.with_suffix(".npy"), scene.truth)
    return path


def measure_case(case: Case, place: Path, scratch: Path, repeats: int) -> Row:
    """Two fresh processes with one compilation cache: the first finds it empty, the second filled."""
    environment = os.environ | {"JAXFILTER_CACHE": str(scratch / "cache")}
    task = {
        "method": case.method,
        "parameters": case.parameters,
        "cloud": str(place),
        "truth": str(place.with_suffix(".npy")),
        "repeats": repeats,
    }
    row = _measured(task, environment)
    again = _measured({**task, "repeats": 0}, environment)
    return row | {"cached_first_seconds": again["first_seconds"], "cached_compile_seconds": again["compile_seconds"]}


def _measured(task: dict[str, Any], environment: dict[str, str]) -> Row:
    root = str(HERE.parents[1])
    paths = os.pathsep.join([root, *filter(None, [environment.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, str(HERE / "measure.py"), json.dumps(task)],
        capture_output=True,
        text=True,
        check=True,
        env=environment | {"PYTHONPATH": paths},
    )
    answer: Row = json.loads(done.stdout)
    return answer


def whole_command(name: str, place: Path, scratch: Path) -> Row:
    """Wall and CPU seconds and peak memory of the command from LAS to LAS, and the scores of what it wrote.

    Ours runs with the compilation cache that :func:`measure_case` filled, as any but the first run on a machine does.
    """
    target = scratch / "out.las"
    environment = dict(os.environ)
    if name in CASES:
        flags = [f"--{key.replace('_', '-')}={value:g}" for key, value in CASES[name].parameters.items()]
        line = [
            sys.executable,
            "-c",
            COMMAND,
            "ground",
            CASES[name].method,
            str(place),
            str(target),
            "--units=m",
            "-q",
            *flags,
        ]
        root = str(HERE.parents[1])
        environment |= {
            "JAXFILTER_CACHE": str(scratch / "cache"),
            "PYTHONPATH": os.pathsep.join([root, *filter(None, [environment.get("PYTHONPATH")])]),
        }
    else:
        line = peers.command(name, place, target)
        if name == "pcl_pmf":
            cloud = jf.read(place, units="m")
            peers.write_pcd(place.with_suffix(".pcd"), cloud.xyz[cloud.candidate])
    figures = scratch / "figures.json"
    launcher = [sys.executable, "-S", str(HERE / "timed.py"), str(figures)]
    done = subprocess.run(
        [*launcher, *line], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=True, env=environment
    )
    used = json.loads(figures.read_text())
    if used["code"] != 0:
        raise subprocess.CalledProcessError(used["code"], line, stderr=done.stdout)
    row: Row = {f"command_{key}": used[key] for key in ("seconds", "cpu_seconds", "peak_bytes")}
    if name in CASES:
        return row
    if name == "csf_wheel":
        row["warm_seconds"] = json.loads(done.stdout.splitlines()[-1])["seconds"]
    return row | _peer_scores(place, target)


def _peer_scores(place: Path, target: Path) -> Row:
    cloud = jf.read(place, units="m")
    row: Row = {"points": len(cloud)}
    if target.exists():
        labelled = jf.read(target, units="m")
        scores = jf.evaluate(labelled.classification == 2, np.load(place.with_suffix(".npy")), ignore=~cloud.candidate)
        row |= {"type1": scores.type1, "type2": scores.type2, "total": scores.total, "kappa": scores.kappa}
    return row


def report(rows: list[Row], repeats: int) -> str:
    """Everything as Markdown."""
    time_columns: list[Column] = [
        ("name", "method", ""),
        ("density", "points/m2", "g"),
        ("points", "points", ",d"),
        ("area_km2", "km2", ".2f"),
        ("warm_seconds", "warm, s", ".2f"),
        ("warm_cpu_seconds", "warm, CPU s", ".2f"),
        ("command_seconds", "command, s", ".2f"),
        ("command_cpu_seconds", "command, CPU s", ".2f"),
        ("command_peak", "command, GB", ".2f"),
        ("peak", "in process, GB", ".2f"),
        ("total", "total error, %", ".2f"),
        ("kappa", "kappa, %", ".2f"),
    ]
    start_columns: list[Column] = [
        ("name", "method", ""),
        ("density", "points/m2", "g"),
        ("points", "points", ",d"),
        ("import_seconds", "import, s", ".2f"),
        ("read_seconds", "read, s", ".2f"),
        ("first_seconds", "first call, s", ".2f"),
        ("cached_first_seconds", "first call, cached, s", ".2f"),
        ("warm_seconds", "warm call, s", ".2f"),
        ("compilations", "compiled", "d"),
        ("compile_seconds", "compiling, s", ".2f"),
        ("cached_compile_seconds", "cached, s", ".2f"),
        ("second_points", "second cloud, points", ",d"),
        ("second_compilations", "it compiles", "d"),
    ]
    shown = [
        row
        | {
            "peak": row["peak_bytes"] / 1e9 if "peak_bytes" in row else None,
            "command_peak": row["command_peak_bytes"] / 1e9,
        }
        for row in rows
    ]
    text = [
        "# Speed and memory",
        "",
        f"Scene `benchmark`, seed 1. Warm = a call on a cloud in memory, after a first one, median of {repeats}; its results are "
        "on the host, so nothing is still running when it returns. Command = a fresh process from LAS to LAS with a filled "
        "compilation cache. CPU seconds are those of all threads. In process = peak resident memory of a process that reads "
        "the cloud and filters it. Errors over the points that are filtered. For the CSF wheel, warm = its call alone.",
        "",
        markdown(time_columns, shown),
        "",
        "## Start",
        "",
        "First call = in a process that finds the compilation cache empty; cached = in one that finds it filled. The "
        "second cloud lacks a strip of up to 3 % of the width; its arrays have the same padded sizes.",
        "",
        markdown(start_columns, [row for row in shown if "first_seconds" in row]),
    ]
    text += ["", "## Growth", "", *_growth(rows)] if _growth(rows) else []
    text += ["", "## Vertex spacing and noise floor on dense clouds", "", *_spacing(rows)] if _spacing(rows) else []
    return "\n".join(text) + "\n"


def _growth(rows: list[Row]) -> list[str]:
    """How much longer each next size takes."""
    lines = []
    for name, density in dict.fromkeys((row["name"], row["density"]) for row in rows):
        line = [r for r in rows if (r["name"], r["density"]) == (name, density) and "warm_seconds" in r]
        for a, b in itertools.pairwise(line):
            lines.append(
                f"- {name}, {density:g} points/m2: {b['points'] / a['points']:.2f} times the points "
                f"({a['points']:,} to {b['points']:,}) take {b['warm_seconds'] / a['warm_seconds']:.2f} times as long"
            )
    return lines


def _spacing(rows: list[Row]) -> list[str]:
    """What the bounded triangulation gains and costs."""
    lines = []
    for row in rows:
        if row["name"].endswith("_spaced"):
            plain = [
                r for r in rows if r["name"] == row["name"].removesuffix("_spaced") and r["points"] == row["points"]
            ]
            for other in plain:
                lines.append(
                    f"- {row['name'].removesuffix('_spaced')}, {row['density']:g} points/m2, {row['points']:,} points: "
                    f"{row['warm_seconds']:.2f} s instead of {other['warm_seconds']:.2f} s; total error {row['total']:.2f} % "
                    f"instead of {other['total']:.2f} % ({row['total'] - other['total']:+.2f} points)"
                )
    return lines


def scaling(rows: list[Row], path: Path) -> None:
    """Warm seconds (else of the command) and peak memory against number of points; a column of panels per density."""
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    densities = sorted({row["density"] for row in rows})
    figure = Figure(figsize=(1.2 + 3.4 * len(densities), 5.4), layout="constrained")
    panels = figure.subplots(2, len(densities), sharex=True, sharey="row", squeeze=False)
    shades, marks = matplotlib.colormaps["tab10"].colors, "osD^v<"
    known = list(dict.fromkeys(CASES[name].method if name in CASES else name for name in [*CASES, *peers.ALL]))
    for column, density in enumerate(densities):
        for name in dict.fromkeys(row["name"] for row in rows):
            line = [row for row in rows if row["name"] == name and row["density"] == density]
            points = [row["points"] for row in line]
            number = known.index(CASES[name].method if name in CASES else name)
            style = {
                "color": shades[number % 10],
                "marker": marks[number // 10 + 2 * name.endswith("_spaced")],
                "markersize": 4,
                "linewidth": 1.2,
                "label": name.replace("_", " "),
                "linestyle": "--" if name.endswith("_spaced") else "-" if name in CASES else ":",
            }
            for ax, values in (
                (panels[0, column], [row.get("warm_seconds", row["command_seconds"]) for row in line]),
                (panels[1, column], [row.get("peak_bytes", row["command_peak_bytes"]) / 1e9 for row in line]),
            ):
                if line:
                    ax.loglog(points, values, **style)
        panels[0, column].set_title(f"{density:g} points/m²", fontsize=10)
        panels[1, column].set_xlabel("million points")
    panels[0, 0].set_ylabel("seconds, warm call")
    panels[1, 0].set_ylabel("peak memory (GB)")
    for ax in panels.flat:
        for axis, unit in ((ax.xaxis, 1e6), (ax.yaxis, 1.0)):
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.set_major_formatter(FuncFormatter(lambda value, _, unit=unit: f"{value / unit:g}"))
            axis.set_minor_formatter(NullFormatter())
        ax.grid(True, which="major", color="0.92")
        ax.spines[["top", "right"]].set_visible(False)
    lines = {line.get_label(): line for ax in panels[0] for line in ax.get_lines()}
    figure.legend(lines.values(), lines.keys(), loc="outside right upper", frameon=False, fontsize=8)
    save_png(figure, path, 150)


def _parser() -> argparse.ArgumentParser:
    have = [*CASES, *peers.installed()]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--only", nargs="+", choices=have, default=have, metavar="NAME", help=f"of {', '.join(have)} [all]"
    )
    parser.add_argument(
        "--sizes", nargs="+", type=float, default=[0.1, 0.3, 1.0], metavar="M", help="million points [%(default)s]"
    )
    parser.add_argument(
        "--densities", nargs="+", type=float, default=[1.0, 12.0], metavar="D", help="per m2 [%(default)s]"
    )
    parser.add_argument(
        "--full", action="store_const", const=[0.1, 0.3, 1.0, 3.0, 5.0], dest="sizes", help="sizes 0.1 to 5 million"
    )
    parser.add_argument(
        "--peer-limit",
        type=float,
        default=0.3,
        metavar="M",
        help="largest cloud that other programs are run on, million points [%(default)s]",
    )
    parser.add_argument("--repeats", type=int, default=3, help="warm calls, of which the median counts [%(default)s]")
    parser.add_argument("--platform", help="of JAX, such as cpu or cuda [what JAX finds]")
    parser.add_argument("--add", action="store_true", help="to the figures of an earlier run in --out, instead of anew")
    parser.add_argument("--keep-scenes", action="store_true", help="keep the LAS files for the next run")
    parser.add_argument("--page", default="results", help="name of the page, such as large [%(default)s]")
    parser.add_argument("--out", type=Path, default=HERE / "out", help="folder for the results [%(default)s]")
    return parser


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
