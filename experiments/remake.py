"""Makes the pages of results that are stale, and writes the figures that other pages quote.

    python experiments/remake.py [--list] [--only TEXT ...] [--jobs 2]

``pages.toml`` lists the pages. A page is stale if the labels of its methods have changed, if its command has, or if it was
never made. The cheapest page is made first. Pages run side by side, but those that measure time run alone. A page that is
current is not made again, so that a run may be stopped and repeated; most scripts keep rows, too. What a script prints goes to
``out``. Scripts write into a folder ``out`` of their own unless ``--out`` says where: ``remake.py`` adds the folder of the page,
and does not count ``--out`` when it compares commands.

Figures in the README, the documentation and the READMEs of experiments stand between two comments:

    <!-- = isprs/summary.csv protocol=fixed method=ost total .1f -->3.4<!-- / -->
    <!-- = ablation "PTD: 30 degrees" - isprs ptd +.1f -->-0.2<!-- / -->
    <!-- = table tiling/halos.md "Points that differ" -->
    ...
    <!-- / -->

``isprs/summary.csv`` is ``experiments/isprs/results/summary.csv``. Conditions choose its rows (``max``: the largest value). The
mean of the column is shown, with one decimal or in the format. A minus makes a difference of two. The words of :data:`SHORT`
stand for files that are often quoted. ``table`` is the first table of a page of results, or below that heading.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import re
import shlex
import statistics
import subprocess
import sys
import time
import tomllib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

import jaxfilter as jf
from experiments.report import Column, Row, made, markdown, read_csv

HERE = Path(__file__).parent
START, END = "<!-- made by experiments/remake.py -->", "<!-- end of the table -->"
SCENES = "scenes"  # among the methods of a page that stands on simulated scenes
SHORT = {
    "ablation": (["ablations/summary.csv"], ["variant"], "total"),
    "bench": (["bench/bench.csv", "density=1.0", "points=max"], ["name"], "warm_seconds"),
    "defaults": (["defaults/means.csv"], ["choice", "alternative"], "mean"),
    "isprs": (["isprs/summary.csv", "protocol=fixed"], ["method"], "total"),
    "sample": (["isprs/fixed.csv"], ["sample", "method"], "total"),
    "tile": (["tiles/tiles.csv"], ["tile", "method"], "total"),
}
"""Files with conditions, the columns whose values follow, and the column that is shown where none is named."""
_FORM = re.compile(r"[+,]*(\.\d)?[dfg%]")
_FIGURE = re.compile(r"(<!-- = ((?:(?!-->).)+) -->)(.*?)(<!-- / -->)", re.DOTALL)


@functools.cache
def clouds() -> list[jf.PointCloud]:
    """A village at 0.7 points per m2, a steep wood at 9, and one at 4 that hides the ground."""
    found = []
    kinds = (100, 0.7, 0.08, 0.25, 0.3), (30, 9, 0.3, 0.2, 0.4), (60, 4, 0.4, 0, 0.97)
    for side, density, slope, houses, trees in kinds:
        rng = np.random.default_rng(side)
        x, y = xy = rng.uniform(0, side, (2, int(density * side**2)))
        z = slope * (x + 0.4 * y) + 2 * np.sin(x / 15) * np.cos(y / 22) + 1.5 * (y > 0.6 * side + 4 * np.sin(x / 9))
        block = np.floor(x / 18).astype(int) + 97 * np.floor(y / 18).astype(int)
        built = (rng.random(1000)[block] < houses) & (np.abs(xy % 18 - 9) < 6).all(axis=0)
        z += built * (4 + 3 * rng.random(1000)[block]) + rng.normal(0, 0.03, len(x))
        z += ~built * (rng.random(len(x)) < trees) * rng.uniform(0.2, 14, len(x))
        pit = np.hypot(x - side / 3, y - side / 4) < 0.8
        z -= (rng.random(len(x)) < 0.0005) * rng.uniform(2, 9, len(x)) + 3 * pit
        found.append(jf.PointCloud.from_arrays(np.column_stack([x + 5e5, y + 5.4e6, z + 300]).round(2)))
    return found


@functools.cache
def counts(name: str) -> str:
    """Ground points of a method by ``for_cloud`` on :func:`clouds` (the third for OST only), and by "paper" on the first."""
    if name == SCENES:
        scenes = [jf.scenes.make(layout, size=60.0, density=0.5, seed=1) for layout in jf.scenes.LAYOUTS]
        return f"{sum(map(len, scenes))} {sum(int(scene.truth.sum()) for scene in scenes)}"
    method = jf.FILTERS[name]
    results = [method.for_cloud(cloud)(cloud) for cloud in clouds()[: 3 if name == "ost" else 2]]
    results += [method.preset("paper")(clouds()[0])]
    return " ".join(str(int(result.ground.sum())) for result in results)


def word(name: str) -> str:
    """A short word for :func:`counts`, for rows that a script keeps from run to run: it makes those with another word anew."""
    return "l" + hashlib.blake2b(counts(name).encode(), digest_size=3).hexdigest()


@dataclass
class Page:
    """How a page is made; ``pages.toml`` explains the fields."""

    command: str
    what: str
    minutes: float
    after: Sequence[str] = ()
    alone: bool = False
    by_hand: bool = False


def listed() -> dict[str, Page]:
    """All pages of results, by their place in this folder."""
    return {name: Page(**page) for name, page in tomllib.loads((HERE / "pages.toml").read_text()).items()}


def stale(name: str, page: Page) -> str:
    """Why a page is stale, in words; empty if it is current."""
    own = made(HERE / name)
    if own is None:
        return "never made"
    if page.by_hand:
        return ""
    if not _same(own.command, page):
        return "of another command"
    known = (*jf.FILTERS, SCENES)
    if changed := [name for name, was in own.labels.items() if name not in known or counts(name) != was]:
        return f"of other labels: {', '.join(changed)}"
    newer = [other for other in page.after if (read := made(HERE / other)) and read.date > own.date]
    return f"older than {newer[0]}" if newer else ""


def seconds(name: str, page: Page) -> float:
    """What a page took, or what it is expected to take."""
    own = made(HERE / name)
    return own.seconds if own and _same(own.command, page) else 60 * page.minutes


def _same(command: str, page: Page) -> bool:
    """Whether a command is that of the page, wherever it writes to."""
    one, other = (re.sub(r" --out \S+", "", text) for text in (command, f"python {page.command}"))
    return one == other


def table() -> str:
    """All pages as Markdown: what, command, when, how long, and whether they are current."""
    rows: list[Row] = []
    for name, page in sorted(listed().items()):
        own, why = made(HERE / name), stale(name, page)
        rows.append({
            "page": f"[{name.replace('/results', '').removesuffix('.md')}]({name})", "what": page.what,
            "command": f"`python {page.command}`", "made": own and own.date[:10], "two cores": _long(seconds(name, page)),
            "state": f"**stale**, {why}" if why else "by hand" if page.by_hand else "current",
        })  # fmt: skip
    columns: list[Column] = [(key, key, "") for key in ("page", "what", "command", "made", "two cores", "state")]
    whole = _long(sum(seconds(name, page) for name, page in listed().items() if not page.by_hand))
    head = f"{sum('stale' in row['state'] for row in rows)} pages are stale. All that can be take {whole}, one by one."
    return f"{head}\n\n{markdown(columns, rows)}"


def _long(spent: float) -> str:
    return f"{spent:.0f} s" if spent < 90 else f"{spent / 60:.0f} min" if spent < 5400 else f"{spent / 3600:.1f} h"


def texts() -> dict[Path, str]:
    """The pages with the figures and the table as they are now. Raises: ValueError for a figure that no file has."""
    globs = "../README.md", "../docs/*.md", "../docs/filters/*.md", "*/README.md"
    paths = [path for one in globs for path in HERE.glob(one)]
    found = {path: _FIGURE.sub(lambda it: it[1] + quoted(it[2]) + it[4], path.read_text()) for path in paths}
    before, _, rest = (HERE / "README.md").read_text().partition(START)
    return found | {HERE / "README.md": f"{before}{START}\n\n{table()}\n\n{END}{rest.partition(END)[2]}"}


def write() -> None:
    """Write :func:`texts`."""
    for path, text in texts().items():
        if text != path.read_text():
            path.write_text(text)


def quoted(what: str) -> str:
    """What stands between the comments. Raises: ValueError."""
    words = shlex.split(what.replace("\n", " "))
    if words[0] == "table":
        return f"\n\n{_table(*words[1:])}\n\n"
    form = words.pop() if _FORM.fullmatch(words[-1]) else ".1f"
    at = words.index("-") if "-" in words else len(words)
    return f"{value(words[:at]) - (value(words[at + 1 :]) if words[at:] else 0):{form}}"


def value(words: list[str]) -> float:
    """The mean of a column over some rows: file, conditions, column. Raises: ValueError."""
    if words[0] in SHORT:
        file, keys, column = SHORT[words[0]]
        given = [f"{key}={text}" for key, text in zip(keys, words[1:], strict=False)]
        words = [*file, *given, *(words[1 + len(keys) :] or [column])]
    file, *conditions, column = words
    rows = read_csv(HERE / file.replace("/", "/results/", 1))
    for key, text in (condition.split("=", 1) for condition in conditions):
        wanted = str(max(row[key] for row in rows)) if text == "max" else text
        rows = [row for row in rows if str(row[key]) == wanted]
    found = [row[column] for row in rows]
    if not found or not all(isinstance(one, (int, float)) for one in found):
        raise ValueError(f"{' '.join(words)}: {'no number' if found else 'no such row'}")
    return statistics.fmean(found)


def _table(file: str, heading: str = "") -> str:
    page = (HERE / file.replace("/", "/results/", 1)).read_text()
    start = rf"^#+ {re.escape(heading)}$.*?" if heading else ""
    if found := re.search(rf"(?ms){start}^(\|.*?\|)$(?!\n\|)", page):
        return found[1]
    raise ValueError(f"{file}: no table below {heading!r}")


def make(name: str, page: Page) -> None:
    """Run the command of a page, and say how it ended."""
    log, start = HERE / "out" / f"{name.replace('/', '-').removesuffix('.md')}.log", time.time()
    log.parent.mkdir(exist_ok=True)
    with open(log, "w") as file:
        line = [sys.executable, "-u", *shlex.split(page.command)]
        line += [] if "--out" in line else ["--out", (HERE / name).parent.relative_to(HERE.parent).as_posix()]
        code = subprocess.run(line, cwd=HERE.parent, stdout=file, stderr=subprocess.STDOUT, check=False).returncode
    end = f", it is stale, {why}: see {log}" if (why := stale(name, page)) else ""
    print(f"{name}: {_long(time.time() - start)}, exit code {code}{end}", flush=True)


def main(arguments: list[str] | None = None) -> int:
    """List or make what is stale; 1 if a page could not be made."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true", help="write tables and figures, say what is stale, run nothing")
    parser.add_argument("--only", nargs="+", default=[""], metavar="TEXT", help="pages whose place holds one of these")
    parser.add_argument("--jobs", type=int, default=2, help="pages that are made side by side [%(default)s]")
    options = parser.parse_args(arguments)
    pages, tried = listed(), set[str]()
    while True:
        write()
        named = [name for name in pages.keys() - tried if any(text in name for text in options.only)]
        todo = sorted((seconds(name, pages[name]), name) for name in named if stale(name, pages[name]))
        ready = [name for _, name in todo if not any(stale(other, pages[other]) for other in pages[name].after)]
        for expected, name in todo:
            print(f"{_long(expected):>8}  {name}", flush=True)
        if options.list or not ready:
            return int(any(stale(name, pages[name]) for name in tried))
        together = [name for name in ready if not pages[name].alone] or ready[:1]
        with ThreadPoolExecutor(options.jobs) as pool:
            try:
                for one in as_completed([pool.submit(make, name, pages[name]) for name in together]):
                    one.result()
                    write()
            finally:  # after an interruption, which the commands that run have got, too
                pool.shutdown(cancel_futures=True)
        tried |= {*together}


if __name__ == "__main__":
    sys.exit(main())
