"""Two versions of the package side by side: speed and peak memory of the methods on triangulations. See README.md."""

from __future__ import annotations

import argparse
import json
import os
import resource
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

METHODS = ("fptd", "ptd", "spf", "agptd", "atin", "ptdf", "iptd", "stin")
SAMPLES = (11, 12, 21, 22, 23, 24, 31, 41, 42, 51, 52, 53, 54, 61, 71)
GRID = {"max_angle": [2.0 + 4.0 * k for k in range(11)], "max_elevation": [round(0.6 + 0.2 * k, 1) for k in range(8)]}
COMMAND = "import sys; from jaxfilter.cli import main; sys.exit(main())"


def main(arguments: list[str] | None = None) -> None:
    """Measure what the command line asks for, the versions in turn, and write tables."""
    given = sys.argv[1:] if arguments is None else arguments
    if given[:1] == ["--task"]:
        print(json.dumps(run(json.loads(given[1]))))
        return
    here = Path(__file__).resolve()
    sys.path.insert(0, str(here.parents[2]))
    from experiments.bench.run import make_scene
    from experiments.isprs import samples
    from experiments.report import markdown, write_csv, write_page

    options = _parser().parse_args(given)
    work = here.parent / "out"
    if not options.before.is_dir():  # a revision
        revision, options.before = str(options.before), work / "before"
        if not options.before.is_dir():
            subprocess.run(
                ["git", "worktree", "add", "--detach", options.before, revision], cwd=here.parent, check=True
            )
    versions = {"before": options.before.resolve(), "after": here.parents[2]}
    scenes = work / "scenes"
    scenes.mkdir(parents=True, exist_ok=True)

    def scene(millions: float) -> str:
        return str(make_scene(scenes, millions, 1.0))

    def sample(number: int) -> str:
        return str(samples.sample_path(samples.data_folder(options.data), str(number)))

    tasks = [(f"{m.upper()}, 1 M points, warm", {"warm": m, "clouds": [scene(1)]}) for m in METHODS]
    tasks += [("FPTD, 5 M points, warm", {"warm": "fptd", "clouds": [scene(5)]})]
    if options.large:
        tasks += [
            ("FPTD, 20 M points, first call", {"warm": "fptd", "clouds": [scene(20)], "repeats": 0, "only": "after"})
        ]
    tasks += [("FPTD, the 15 samples, warm, mean", {"warm": "fptd", "clouds": [sample(n) for n in SAMPLES]})]
    tasks += [(f"FPTD, 88 sets on sample {n}", {"sweep": GRID, "clouds": [sample(n)]}) for n in (54, 71, 24, 52)]
    tasks += [
        (f"FPTD, LAS to LAS, {Path(las).stem}", {"command": "fptd", "clouds": [str(las)]})
        for las in options.command or ()
    ]
    if options.large:
        random = {"max_angle": (4.0, 42.0), "max_elevation": (0.6, 2.0)}
        tasks += [
            (
                "FPTD, 100 random sets on 1 M points, with votes",
                {"votes": random, "clouds": [scene(1)], "only": "after"},
            )
        ]
    rows = []
    for name, task in tasks:
        if options.only and not any(part in name for part in options.only):
            continue
        row: dict[str, Any] = {"what": name}
        for version, tree in versions.items():
            if task.get("only", version) != version:
                continue
            done = subprocess.run(
                [sys.executable, str(here), "--task", json.dumps(task)],
                env=os.environ | {"PYTHONPATH": str(tree), "JAXFILTER_CACHE": str(work.resolve() / version)},
                cwd=tree, check=True, capture_output=True, text=True,
            )  # fmt: skip
            found = json.loads(done.stdout.splitlines()[-1])
            row |= {f"{version}_{key}": value for key, value in found.items()}
        if "before_seconds" in row and "after_seconds" in row:
            row["ratio"] = row["before_seconds"] / row["after_seconds"]
        rows.append(row)
        print(row, flush=True)
    write_csv(options.out / "compare.csv", rows)
    columns = [("what", "measured", "s")]
    for version in versions:
        columns += [(f"{version}_seconds", f"{version}, s", ".3g"), (f"{version}_cpu", "CPU s", ".3g")]
        columns += [(f"{version}_peak", "peak MB", ".0f")]
    columns += [("ratio", "times as fast", ".1f")]
    command = shlex.join(["python", "experiments/bench/compare.py", *given])
    text = [
        "# Methods on triangulations, before and after",
        "",
        f"Before: {_version(versions['before'])}; after: {_version(versions['after'])}. Medians "
        "of three calls (one of sweeps), each row and version in a process of its own, after a first call. Peak "
        "memory is that of the process, with the cloud and the libraries. Commands are timed from start to end, with caches "
        "filled.",
        "",
        markdown(columns, rows),
    ]
    write_page(options.out / "compare.md", "\n".join(text), command)
    print("\n".join(text))


def run(task: dict[str, Any]) -> dict[str, float]:
    """Seconds, CPU seconds and peak memory of a task, with the version of the package that is first on the path."""
    if "command" in task:
        return _command(task)
    import jaxfilter as jf
    from jaxfilter.core import compilation

    keep = (
        "keep_compilations" if hasattr(compilation, "keep_compilations") else "use_persistent_cache"
    )  # of older versions
    getattr(compilation, keep)()
    clouds = [jf.read(path, units="m") for path in task["clouds"]]
    if "warm" in task:
        filter_ = jf.FILTERS[task["warm"]]()
        calls = [lambda cloud=cloud: filter_(cloud) for cloud in clouds]
    else:
        axes, design = task.get("sweep") or task["votes"], {"design": "random", "size": 100} if "votes" in task else {}
        calls = [lambda: jf.sweep(jf.FPTD(), clouds[0], axes, votes="votes" in task, **design)]
    seconds, cpu = [], []
    for call in calls:
        wall = []
        for turn in range(1 + task.get("repeats", 3 if "warm" in task else 1)):
            start, busy = time.perf_counter(), time.process_time()
            call()
            wall.append((time.perf_counter() - start, time.process_time() - busy))
            if "votes" in task and turn == 0:
                break
        kept = wall[1:] or wall
        seconds.append(statistics.median(w for w, _ in kept))
        cpu.append(statistics.median(c for _, c in kept))
    return {"seconds": statistics.mean(seconds), "cpu": statistics.mean(cpu), "peak": _peak(resource.RUSAGE_SELF)}


def _command(task: dict[str, Any]) -> dict[str, float]:
    """The whole command, median of three after a first one that fills the caches."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(4):
            before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
            out = str(Path(folder) / f"{turn}.las")
            line = [sys.executable, "-c", COMMAND, "ground", task["command"], task["clouds"][0], out, "--units", "m"]
            subprocess.run(line, check=True, capture_output=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            found.append((time.perf_counter() - start, cpu))
    seconds, cpus = zip(*found[1:], strict=True)
    return {
        "seconds": statistics.median(seconds),
        "cpu": statistics.median(cpus),
        "peak": _peak(resource.RUSAGE_CHILDREN),
    }


def _peak(who: int) -> float:
    """Megabytes."""
    return resource.getrusage(who).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6


def _version(tree: Path) -> str:
    line = ["git", "-C", str(tree), "log", "-1", "--format=%h of %cs"]
    return subprocess.run(line, capture_output=True, text=True).stdout.strip() or "unknown"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--before", type=Path, required=True, help="the earlier version: a checkout, or a revision of git"
    )
    parser.add_argument("--data", type=Path, help="folder of the ISPRS samples [JAXFILTER_DATA or ../shared/data]")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for results [%(default)s]")
    parser.add_argument(
        "--large", action="store_true", help="also, after only, 20 million points and 100 sets on a million"
    )
    parser.add_argument("--command", nargs="*", metavar="LAS", help="clouds to time the whole command on")
    parser.add_argument("--only", nargs="*", help="rows whose names contain one of these")
    return parser


if __name__ == "__main__":
    main()
