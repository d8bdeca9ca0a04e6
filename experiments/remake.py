"""Makes the pages of results that are stale: those of other labels than the code's, of another command, or never made.

    python experiments/remake.py [--list] [--only TEXT ...] [--budget MINUTES]

It runs the command of each stale page, the cheapest first, in a process of its own, and goes on where it was stopped: pages
that are current are not made again, and most scripts keep their rows. What a command prints goes to ``experiments/out/``. After
each page the table in ``experiments/README.md``, the page ``docs/results`` and the figures that pages quote are written anew.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments import labels, quoted, report_page
from experiments.report import SPENT, Row, made, markdown

HERE = Path(__file__).parent
ROOT = HERE.parent
README = HERE / "README.md"
START, END = "<!-- made by experiments/remake.py -->", "<!-- end of the table -->"
TIMES = HERE / "out" / "begun.json"
"""Pages that were begun and not finished, and seconds spent on them."""


@dataclass(frozen=True)
class Page:
    """How a page is made.

    ``command``: what follows ``python``. ``minutes``: on two idle cores, until a run has recorded them. ``after``: pages whose
    results it reads. ``keeps``: its script keeps the rows of methods whose labels have not changed.
    """

    command: str
    what: str
    minutes: float
    after: tuple[str, ...] = ()
    keeps: bool = False


def _tiling(part: str, options: str = "") -> str:
    return f"experiments/tiling/run.py {part}{options} --out experiments/tiling/results"


ISPRS = "isprs/results/results.md"
PAGES = {
    ISPRS: Page("experiments/isprs/run.py --out experiments/isprs/results",
                "every method on the 15 ISPRS samples under three protocols, and the papers' claims", 25, keeps=True),
    "isprs/results/places.md": Page("experiments/isprs/places.py", "what the place of the grid decides on the samples", 8),
    "default/results/results.md": Page("experiments/default/run.py --sets 21", "OST: its constants with sites and sources left "
                                       "out, what each step gives, other methods beside it", 60, keeps=True),
    "default/results/doubt.md": Page("-m experiments.default.doubt", "OST: what its doubts are worth", 15),
    "default/results/flat.md": Page("experiments/default/flat.py", "OST: how flat its later constants are", 12, keeps=True),
    "defaults/results/results.md": Page("experiments/defaults/run.py", "alternatives to the defaults, on simulated scenes and "
                                        "tiles", 60, keeps=True),
    "ablations/results/results.md": Page("experiments/ablations/run.py", "the choices within the methods, one at a time", 25,
                                         keeps=True),
    "papers/results/agptd2024/results.md": Page("experiments/papers/agptd2024.py", "the tables of Zheng et al. (2024): AGPTD", 8),
    "papers/results/li2021/results.md": Page("experiments/papers/li2021.py", "those of Li et al. (2021): FPTD", 10),
    "papers/results/pingel2013/results.md": Page("experiments/papers/pingel2013.py", "those of Pingel et al. (2013): SMRF", 1),
    "papers/results/ppdf2023/results.md": Page("experiments/papers/ppdf2023.py", "those of Cai et al. (2023): PPDF", 10),
    "papers/results/spf2023/results.md": Page("experiments/papers/spf2023.py", "those of Chen et al. (2023): SPF", 3, (ISPRS,)),
    "papers/results/stin2024/results.md": Page("experiments/papers/stin2024.py", "those of Uray and Varlik (2024): STIN", 8),
    "tiles/results/results.md": Page("experiments/tiles/run.py --out experiments/tiles/results", "every method on six labelled "
                                     "tiles of other sensors and densities", 10),
    "failures/results/results.md": Page("experiments/failures/run.py all", "where methods fail: borders, cliffs, cuts through "
                                        "clouds, the place of the grid, places that are named", 45, keeps=True),
    "sensors/results/results.md": Page("experiments/sensors/run.py all", "clouds from photographs, drone lidar and cars", 10),
    "fits/results/results.md": Page("experiments/fits/run.py", "fits by gradient beside searches, sites left out",
                                    20),
    "verdicts/results/results.md": Page("experiments/verdicts/run.py", "errors left after verdicts of people", 15),
    "verdicts/results/speed.md": Page("experiments/verdicts/speed.py", "what apply takes beside ground", 5),
    "halls/results/results.md": Page("experiments/halls/run.py", "large halls that methods find", 10),
    "dikes/results/results.md": Page("experiments/dikes/run.py", "crests of dikes that methods keep", 3),
    "water/results/results.md": Page("experiments/water/run.py", "water and bridge decks in scenes and tiles", 8),
    "bench/results/gpu.md": Page("experiments/bench/gpu.py --out experiments/bench/results", "labels and times on a GPU", 6),
    "bench/results/ops.md": Page("experiments/bench/ops.py", "operations beside those of other libraries", 10),
    "tiling/results/labels.md": Page(_tiling("labels"), "labels of tiles against those of the whole", 15),
    "tiling/results/halos.md": Page(_tiling("halos", " --small 300"), "the same by halo", 10),
    "tiling/results/border.md": Page(_tiling("border", " --methods smrf ost ptd csf"), "places that the border cuts", 1),
    "tiling/results/scale.md": Page(_tiling("scale"), "memory and time by number of files", 15),
    "tiling/results/kills.md": Page(_tiling("kills", " --small 300"), "runs that are killed and repeated", 20),
    "tiling/results/cluster.md": Page(_tiling("cluster"), "a Dask cluster whose worker is killed", 2),
    "tiling/results/tasks.md": Page(_tiling("tasks", " --tasks 1000 10000 100000"), "tasks through a scheduler", 16),
    "tiling/results/country.md": Page(_tiling("country", " --densities 2 10 --millions 4 --costs ost smrf fptd"),
                                      "what a country costs", 20),
    "tiling/results/tiles.md": Page(_tiling("tiles"), "what tiles cost against single files", 15),
    "sensitivity/results/results.md": Page("experiments/sensitivity/run.py", "what the parameters decide", 4, (ISPRS,)),
    "sensitivity/results/speed.md": Page("experiments/sensitivity/speed.py", "how fast sweeps are", 20),
    "sensitivity/results/batches.md": Page("experiments/sensitivity/batches.py", "many clouds with many sets in one call", 8),
    "sensitivity/results/agreement.md": Page("experiments/sensitivity/agreement.py --minutes 20", "labels of sweeps against "
                                             "those of single calls", 21),
    "sensitivity/results/calibration.md": Page("experiments/sensitivity/calibration.py", "calibration from few labels", 40),
    "sensitivity/results/calibration_others.md": Page(
        "experiments/sensitivity/calibration.py --clouds others --shapes patches --draws 3",
        "the same where its constants were chosen", 10),
    "outliers/results/results.md": Page("experiments/outliers/run.py --out experiments/outliers/results",
                                        "the search for clusters of low points", 5),
    "bench/results/results.md": Page("experiments/bench/run.py --sizes 0.3 1 --densities 1 --out experiments/bench/results",
                                     "speed and memory, beside other programs", 30),
    "bench/results/large.md": Page("experiments/bench/run.py --sizes 5 20 --densities 1 --repeats 1 --only fptd smrf "
                                   "--page large --out experiments/bench/results", "FPTD and SMRF on many points", 15),
    "bench/results/dense.md": Page("experiments/bench/dense.py --out experiments/bench/results", "OST at high density", 2),
    "bench/results/report.md": Page("experiments/bench/report.py --methods smrf fptd --out experiments/bench/results/report.md",
                                    "reports of five million points", 3),
    "faults/results/results.md": Page("experiments/faults/run.py --out experiments/faults/results", "kills, signals, races, "
                                      "inputs that change and full disks", 10),
    "faults/results/surveys.md": Page("experiments/faults/surveys.py", "surveys that are damaged", 5),
    "faults/results/parameters.md": Page("experiments/faults/parameters.py", "every method with random parameters", 15),
    "faults/results/adversarial.md": Page("experiments/faults/adversarial.py", "clouds that are made to hurt", 12),
    "fuzz/results/results.md": Page("experiments/fuzz/run.py --number 10000 --seeds 20264 --out experiments/fuzz/results",
                                    "20,000 damaged files", 7),
    "fuzz/results/compressed.md": Page("experiments/fuzz/compressed.py --out experiments/fuzz/results",
                                       "5,000 LAZ files with damaged layers", 3),
    "mutations/results/results.md": Page("experiments/mutations/run.py --number 85 --seconds 15", "small changes of the "
                                         "package, and those that no test notices", 80),
    "surveys/results/results.md": Page("experiments/surveys/run.py --out experiments/surveys/results",
                                       "what surveys of a million files cost", 10),
}  # fmt: skip
"""All pages of results, by their place in this folder."""


def known() -> dict[str, Page]:
    """:data:`PAGES`, and pages that lie in folders of results and are not listed there: these are made by the command that they
    name, if any."""
    found = {path.relative_to(HERE).as_posix(): path for path in sorted(HERE.glob("*/results/**/*.md"))}
    others = {name: made(path) for name, path in found.items() if name not in PAGES}
    said = {name: page.command.removeprefix("python ") if page else "" for name, page in others.items()}
    return PAGES | {name: Page(command, "not listed in `remake.py`", 10) for name, command in said.items()}


def stale(name: str, page: Page) -> str:
    """Why a page is stale, in words; empty if it is current."""
    own = made(HERE / name)
    if own is None:
        return "of unknown labels" if (HERE / name).exists() else "not made yet"
    if own.command != f"python {page.command}":
        return "of another command"
    if changed := [method for method, counts in own.labels.items() if not _same(method, counts)]:
        return f"of other labels: {', '.join(changed)}"
    for other in page.after:
        read = made(HERE / other)
        if stale(other, PAGES[other]) or read is None or read.date > own.date:
            return f"older than {other}"
    return ""


def _same(name: str, counts: str) -> bool:
    try:
        return labels.counts(name) == counts
    except KeyError:  # a method that is no more
        return False


def seconds(name: str, page: Page) -> float:
    """What making a page is expected to take: what it took, or its share of stale methods where rows are kept."""
    own = made(HERE / name)
    if own is None or own.command != f"python {page.command}":
        return 60 * page.minutes
    changed = sum(not _same(method, counts) for method, counts in own.labels.items())
    return own.seconds * (max(changed, 0.1) / len(own.labels) if page.keeps and own.labels else 1.0)


def table() -> str:
    """All pages as Markdown: what, command, when, how long, and whether they are current."""
    rows: list[Row] = []
    for name, page in sorted(known().items()):
        own, why = made(HERE / name), stale(name, page)
        rows.append({
            "page": f"[{name.replace('/results', '').removesuffix('.md')}]({name})" if (HERE / name).exists() else name,
            "what": page.what, "command": f"`python {page.command}`" if page.command else None,
            "date": own.date[:10] if own else None,
            "took": _long(own.seconds) if own else f"about {_long(60 * page.minutes)}",
            "state": f"**stale**, {why}" if why else "current",
        })  # fmt: skip
    columns = [("page", "page", ""), ("what", "what", ""), ("command", "command", ""), ("date", "made", ""),
               ("took", "two cores", ""), ("state", "", "")]  # fmt: skip
    count = sum(row["state"] != "current" for row in rows)
    return f"{count} of {len(rows)} pages are stale.\n\n{markdown(columns, rows)}"


def _long(spent: float) -> str:
    return f"{spent:.0f} s" if spent < 90 else f"{spent / 60:.0f} min" if spent < 5400 else f"{spent / 3600:.1f} h"


def listed(text: str) -> str:
    """The text of the README with the table as it is now."""
    before, _, rest = text.partition(START)
    return f"{before}{START}\n\n{table()}\n\n{END}{rest.partition(END)[2]}"


def write() -> None:
    """The table in the README, ``docs/results``, and the figures that pages quote."""
    README.write_text(listed(README.read_text()))
    report_page.main([])
    quoted.main([])


def plan(only: list[str]) -> Iterator[tuple[float, str, Page]]:
    """Stale pages whose names hold one of these texts, the cheapest first; expected seconds beside each. A page comes after
    those that it reads."""
    pages = known()
    left = {
        name: seconds(name, page)
        for name, page in pages.items()
        if page.command and (not only or any(text in name for text in only)) and stale(name, page)
    }
    while left:
        ready = [name for name in left if not set(pages[name].after) & left.keys()]
        name = min(ready, key=lambda one: left[one])
        yield left.pop(name), name, pages[name]


def make(name: str, page: Page) -> bool:
    """Run the command of a page; whether the page is current now."""
    begun = json.loads(TIMES.read_text()) if TIMES.exists() else {}
    log = TIMES.parent / f"{name.replace('/', '-').removesuffix('.md')}.log"
    before = begun.get(name, {"spent": 0.0})
    spent = before["spent"]
    if "start" in before and log.exists():  # it was killed
        spent += max(log.stat().st_mtime - before["start"], 0.0)

    def keep(entry: dict[str, float] | None) -> None:
        others = {key: value for key, value in begun.items() if key != name}
        TIMES.write_text(json.dumps(others | ({name: entry} if entry else {})))

    TIMES.parent.mkdir(exist_ok=True)
    start = time.time()
    keep({"spent": spent, "start": start})
    with open(log, "w") as file:
        process = subprocess.Popen(
            [sys.executable, *shlex.split(page.command)], cwd=ROOT, env=os.environ | {SPENT: str(spent), "PYTHONUNBUFFERED": "1"},
            stdout=file, stderr=subprocess.STDOUT,
        )  # fmt: skip
        try:
            code = process.wait()
        except BaseException:
            process.terminate()
            process.wait()
            keep({"spent": spent + time.time() - start})
            raise
    why = stale(name, page)
    keep({"spent": spent + time.time() - start} if why else None)
    end = "" if not why else f"; it is stale: {why}. See {log}"
    print(f"  {_long(time.time() - start)}, exit code {code}{end}", flush=True)
    return not why


def main(arguments: list[str] | None = None) -> int:
    """List or make what is stale; 1 if a page that was made is stale still, 130 after an interruption."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true", help="write the tables and say what is stale; run nothing")
    parser.add_argument("--only", nargs="+", default=[], metavar="TEXT", help="pages whose place holds one of these")
    parser.add_argument("--budget", type=float, default=float("inf"), help="minutes; what takes longer is not begun")
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # it stops the command that runs, too, as Ctrl-C does
    end = time.time() + 60 * options.budget
    todo = list(plan(options.only))
    print(f"{len(todo)} stale pages, about {_long(sum(expected for expected, _, _ in todo))}:")
    for expected, name, _ in todo:
        print(f"  {_long(expected):>8}  {name}", flush=True)
    failed = 0
    try:
        for expected, name, page in [] if options.list else todo:
            if time.time() + expected > end:
                print(f"{name} is left: it takes about {_long(expected)}")
                continue
            if waits := [other for other in page.after if stale(other, PAGES[other])]:
                print(f"{name} is left: {waits[0]} is stale")
                continue
            print(f"{name}, about {_long(expected)}: python {page.command}", flush=True)
            failed += not make(name, page)
            write()
    except KeyboardInterrupt:
        print("interrupted; the next run goes on from here")
        return 130
    finally:
        write()
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
