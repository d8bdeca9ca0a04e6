"""SciPy's Delaunay, made anew in each round, beside the triangulation that is updated in place: labels and CPU seconds."""

from __future__ import annotations

import re
import statistics
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples
from experiments.papers.spf2023 import PTDOnePerFacet
from experiments.report import Column, CommandLine, Row, markdown, read_csv, write_csv, write_page
from jaxfilter.core.result import silent
from jaxfilter.engines.tin.ground import GroundTin
from jaxfilter.engines.tin.triangulation import Tin, lattice, triangulated
from jaxfilter.steps.tin_filter import TinFilter, growth_of

METHODS = ("ptd", "atin", "fptd", "stin", "agptd", "spf")
KINDS = ("own", "scipy")
PRESETS = ("paper", "for_cloud")
PARTS = (*PRESETS, "times", "twelve")
COUNTS = ("differ", "tie", "after a tie", "rounding", "else")
SIZES = (10_000, 100_000, 1_000_000)
MANY = 500_000
"""Points above which there is one call."""
AT_ONCE = "one point over each facet a round"
RUNS: dict[str, Callable[[str], TinFilter]] = {
    "FPTD, independent blocks": lambda terrain: jf.FPTD.preset(terrain, blocks="independent"),
    "PTD": lambda terrain: jf.PTD.preset(terrain, refresh_border=False),
    f"PTD, {AT_ONCE}": lambda terrain: PTDOnePerFacet.preset(terrain, refresh_border=False, max_rounds=1000),
}
"""What Li et al. (2021), Table IV, may have timed: the thresholds of the class of the terrain."""
Position = tuple[int, int]


def main(arguments: list[str] | None = None) -> None:
    """Compare labels, measure times, and write the page."""
    parser = CommandLine(__file__, __doc__, "results")
    parser.add_argument("--samples", type=samples.sample_name, nargs="+", default=samples.SAMPLES, metavar="SAMPLE")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="points of the scenes [%(default)s]")
    parser.add_argument("--repeats", type=int, default=3, help="calls whose median is shown [%(default)s]")
    parser.add_argument("--only", nargs="*", choices=PARTS, default=PARTS, help="tables that are measured anew [all]")
    options = parser.options(arguments)
    folder = samples.data_folder(options.data)
    clouds = {f"samp{number}": jf.read(samples.sample_path(folder, number)) for number in options.samples}
    measured: dict[str, Callable[[], Iterator[Row]]] = {
        **{preset: partial(labels_of_samples, clouds, preset) for preset in PRESETS},
        "times": lambda: times_of_sizes(options.sizes, options.repeats),
        "twelve": lambda: times_of_samples(clouds, options.repeats),
    }
    paths = {part: options.out / f"triangulation_{part}.csv" for part in PARTS}
    for part in options.only:
        rows = []
        for row in measured[part]():
            rows.append(row)
            write_csv(paths[part], rows)
            print(row, flush=True)
    if missing := [str(path) for path in paths.values() if not path.exists()]:
        raise SystemExit(f"no page yet, for lack of {', '.join(missing)}")
    tables = {part: read_csv(path) for part, path in paths.items()}
    labels = label_table([row for preset in PRESETS for row in tables[preset]])
    text = ["# SciPy's Delaunay as the reference", INTRODUCTION, *labels, *time_table(tables["times"])]
    text += twelve_table(tables["twelve"])
    command = re.sub(r" --only( [a-z]+)*", "", options.command)
    keeps = len(options.only) < len(PARTS)
    write_page(options.out / "triangulation.md", "\n\n".join(text), command, [*METHODS, "scenes"], keeps=keeps)


INTRODUCTION = (
    '`triangulation="scipy"` triangulates all vertices anew in each round by `scipy.spatial.Delaunay`, finds all points that '
    'wait in it by `find_simplex`, and tests by the same kernel those whose triangle is new. `triangulation="own"`, the default, '
    "updates one triangulation in place. Seconds are CPU seconds of all threads."
)


def compared(filter_: TinFilter, cloud: jf.PointCloud) -> tuple[dict[str, np.ndarray], dict[str, int]]:
    """Grow the ground over both triangulations side by side.

    Returns: by kind the labels bool[n] of the cloud, and how many of its distinct candidates have two labels, by why: the test
        in which the two first differ is over a "tie" (the point or its image lies on an edge, or the corners of both facets lie
        on one circle), "after a tie" (a vertex or a limit differs already), over a facet that is none of the vertices by
        "rounding" in Qhull, or anything "else".
    """
    points = filter_.points_of(cloud)
    both = [filter_.replace(triangulation=kind) for kind in KINDS]
    networks = [one.start(points, None, silent) for one in both]
    first: dict[int, str] = dict.fromkeys(np.flatnonzero(networks[0].seed != networks[1].seed).tolist(), "else")
    with (
        GroundTin.start(networks[0], growth_of(both[0], networks[0])) as own,
        GroundTin.start(networks[1], growth_of(both[1], networks[1])) as other,
    ):
        for _ in range(filter_.max_rounds):
            rounds = [ground for ground in (own, other) if len(ground.todo)]
            passed = [ground.test() for ground in rounds]
            for ground, nodes in zip(rounds, passed, strict=True):
                ground.ground[nodes] = True
            for node in np.flatnonzero(own.ground != other.ground).tolist():
                if node not in first:
                    first[node] = why(own, other, node)
            for ground, nodes in zip(rounds, passed, strict=True):
                ground.take(nodes)
    found, row, real = {}, networks[0].row, networks[0].real
    for kind, ground in zip(KINDS, (own, other), strict=True):
        found[kind] = np.bincount(row[real], ground.ground[real], len(points)) > 0
    differ = found["own"] != found["scipy"]
    reasons = {row[node]: reason for node, reason in first.items() if own.ground[node] != other.ground[node]}
    counts = Counter(reasons[number] for number in np.flatnonzero(differ).tolist())
    counted = {"differ": int(differ.sum())} | {name: counts[name] for name in COUNTS[1:]}
    return {kind: points.spread(values, False) for kind, values in found.items()}, counted


def why(own: GroundTin, other: GroundTin, node: int) -> str:
    """Why the tests of a node differ, by exact integers; see :func:`compared`."""
    x, y = place = _place(own.tin, node)
    tests = [([place], _facet(own.tin, own.tin.where[node]), _facet(other.tin, other.tin.where[node]))]
    if len(own.image_in) and min(own.image_in[node], other.image_in[node]) >= 0:
        about = [_place(own.tin, v) for v in {*tests[0][1], *tests[0][2]}]
        images = [(2 * a - x, 2 * b - y) for a, b in about]
        tests.append((images, _facet(own.tin, own.image_in[node]), _facet(other.tin, other.image_in[node])))
    if not all(own.tin.vertex[[*two]].all() and other.tin.vertex[[*one]].all() for _, one, two in tests):
        return "after a tie"
    for at, one, two in tests:
        corners = [[_place(own.tin, v) for v in facet] for facet in (one, two)]
        if one != two and all(power(*corners[0], p) == 0 for p in corners[1]):
            return "tie"
        if any(min(turn(t[k - 1], t[k], p) for k in range(3)) == 0 for t in corners for p in at):
            return "tie"
    facets = {facet for test in tests for facet in test[1:]}
    moved = any(own.tin.xyz[v, 2] != other.tin.xyz[v, 2] for facet in facets for v in facet)
    if moved or own.rule != other.rule:
        return "after a tie"
    apart = [_place(own.tin, v) for v in np.flatnonzero(own.tin.vertex != other.tin.vertex).tolist()]
    for facet in facets:
        corners = [_place(own.tin, v) for v in facet]
        if any(power(*corners, p) > 0 for p in apart):
            return "after a tie"
    return "rounding" if any(one != two for _, one, two in tests) else "else"


def _facet(tin: Tin, number: int) -> tuple[int, ...]:
    return tuple(tin.corners(np.array([number], np.int32))[0].tolist())


def _place(tin: Tin, node: int) -> Position:
    return int(tin.xy[node, 0]), int(tin.xy[node, 1])


def turn(a: Position, b: Position, c: Position) -> int:
    """Twice the area of a, b, c; positive if they turn to the left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def power(a: Position, b: Position, c: Position, p: Position) -> int:
    """Positive if p lies inside the circle through a, b, c, which turn to the left; zero on it."""
    (a1, a2), (b1, b2), (c1, c2) = ((q[0] - p[0], q[1] - p[1]) for q in (a, b, c))
    a3, b3, c3 = a1 * a1 + a2 * a2, b1 * b1 + b2 * b2, c1 * c1 + c2 * c2
    return a1 * (b2 * c3 - b3 * c2) - a2 * (b1 * c3 - b3 * c1) + a3 * (b1 * c2 - b2 * c1)


def labels_of_samples(clouds: dict[str, jf.PointCloud], preset: str) -> Iterator[Row]:
    """Labels of all methods on samples, by a preset or by ``for_cloud``."""
    for name, cloud in clouds.items():
        for method in METHODS:
            cls = jf.FILTERS[method]
            filter_ = cls.for_cloud(cloud) if preset == "for_cloud" else cls.preset(preset)
            row: Row = {"sample": name, "method": method, "preset": preset, "points": len(cloud)}
            yield row | compared(filter_, cloud)[1]


def label_table(rows: Sequence[Row]) -> list[str]:
    """Sums over the samples."""
    table = []
    for method in METHODS:
        for preset in PRESETS:
            own = [row for row in rows if (row["method"], row["preset"]) == (method, preset)]
            sums = {key: sum(row[key] for row in own) for key in ("points", *COUNTS)}
            worst = max(own, key=lambda row: row["differ"])
            where = f"{worst['sample']}: {worst['differ']}" if worst["differ"] else ""
            share = 100 * sums["differ"] / sums["points"]
            table.append({"method": method.upper(), "preset": preset} | sums | {"share": share, "most": where})
    columns: list[Column] = [
        ("method", "method", ""), ("preset", "preset", ""), ("differ", "points that differ", ",d"),
        ("share", "share, %", ".4f"), ("tie", "ties", ",d"), ("after a tie", "after ties", ",d"),
        ("rounding", "rounding", ",d"), ("else", "else", ",d"), ("most", "most on a sample", ""),
    ]  # fmt: skip
    number = len({row["sample"] for row in rows})
    return [
        "## Labels",
        f"{number} samples, {table[0]['points']:,} points. Both grow side by side. Each point that differs counts by the first "
        'test that the two decide otherwise, by exact integers. "Ties": the point, or its mirror image, lies on an edge, or the '
        'corners of the two facets lie on one circle. "After ties": a vertex, its elevation or a limit differs already. '
        '"Rounding": the facet of Qhull is none of the exact triangulation.',
        markdown(columns, table),
    ]


def timed(call: Callable[[], Any], repeats: int) -> tuple[Any, float]:
    """What a call returns, and the median CPU seconds of calls."""
    spent = []
    for _ in range(repeats):
        start = time.process_time()
        found = call()
        spent.append(time.process_time() - start)
    return found, statistics.median(spent)


def times_of_sizes(sizes: Sequence[int], repeats: int) -> Iterator[Row]:
    """Labels and times on scenes of one density, and of the triangulations alone."""
    from scipy.spatial import Delaunay

    for size in sizes:
        cloud = jf.scenes.make("benchmark", size=size**0.5, density=1.0, seed=1).cloud
        points, times = jf.FPTD().points_of(cloud), 1 if size > MANY else repeats
        xyz = points.xyz[np.sort(np.unique(lattice(points.xyz), axis=0, return_index=True)[1])]
        at = (xyz[:, :2] - xyz[:, :2].mean(axis=0)).astype(np.float64)
        for call in (triangulated, Delaunay):  # compiled, and imported
            call(xyz[:99] if call is triangulated else at[:99])
        row: Row = {"what": "triangulation alone", "points": len(xyz)}
        row["own"], row["scipy"] = (
            timed(partial(call, it), repeats)[1] for call, it in ((triangulated, xyz), (Delaunay, at))
        )
        yield row | {"ratio": row["scipy"] / row["own"]}
        for method in ("ptd", "fptd"):
            filter_, labels = jf.FILTERS[method].for_cloud(cloud), {}
            row = {"what": method.upper(), "points": len(points)}
            for kind in KINDS:
                one = filter_.replace(triangulation=kind)
                if size == sizes[0]:
                    one(cloud)  # compiles
                found, row[kind] = timed(partial(one, cloud), times)
                labels[kind] = found.ground
            row["differ"] = int((labels["own"] != labels["scipy"]).sum())
            yield row | {"ratio": row["scipy"] / row["own"]}


def time_table(rows: Sequence[Row]) -> list[str]:
    """The rows by what is timed."""
    columns: list[Column] = [
        ("what", "", ""), ("points", "points", ",d"), ("own", "own, s", ".3f"), ("scipy", "SciPy, s", ".3f"),
        ("ratio", "ratio", ".1f"), ("differ", "labels that differ", ",d"),
    ]  # fmt: skip
    return [
        "## Time",
        'Scenes ("benchmark", one pulse per square metre), and the filters of `for_cloud`. Median of three warm calls without '
        "reading, but for one call of a filter at a million points. All distinct points are triangulated at once for "
        '"triangulation alone".',
        markdown(columns, sorted(rows, key=lambda row: row["what"] != "triangulation alone")),
    ]


def times_of_samples(clouds: dict[str, jf.PointCloud], repeats: int) -> Iterator[Row]:
    """FPTD and PTD as Li et al. time them, over both triangulations."""
    terrain = samples.terrain_classes()
    printed = {(row["sample"], row["method"]): row["seconds"] for row in samples.published("li2021_table4")}
    for name, cloud in clouds.items():
        for run, make in RUNS.items():
            row: Row = {"sample": name, "run": run, "points": len(cloud)}
            for kind in KINDS:
                found, row[kind] = timed(partial(make(terrain[name]).replace(triangulation=kind), cloud), repeats)
            yield row | {"rounds": len(found.trace), "printed": printed[name, run.split(",")[0].lower()]}


def twelve_table(rows: Sequence[Row]) -> list[str]:
    """Means over the samples that have all runs, and the claim."""
    whole = [name for name, count in Counter(row["sample"] for row in rows).items() if count == len(RUNS)]
    rows = [row for row in rows if row["sample"] in whole]
    table: list[Row] = []
    for run in RUNS:
        own = [row for row in rows if row["run"] == run]
        means = {key: statistics.fmean(row[key] for row in own) for key in ("rounds", "own", "scipy", "printed")}
        table.append({"run": run} | means)
    columns: list[Column] = [
        ("run", "", ""), ("rounds", "rounds", ".0f"), ("scipy", "SciPy, s", ".3f"), ("own", "own, s", ".3f"),
        ("printed", "printed, s", ".2f"),
    ]  # fmt: skip
    number = len(whole)
    return [
        "## FPTD against PTD",
        f"{TWELVE} Means over {number} samples.",
        markdown(columns, table),
        verdicts(rows, table),
    ]


TWELVE = (
    'Li et al. (2021): "the FPTD algorithm yields better error rates and kappa coefficients in 1/12 of the average time '
    'required by the PTD" (abstract), "and even nearly 30 times in some datasets (s42, s23)" (Sec. III-C). Table IV prints '
    "33.39 and 2.82 s on average. The paper does not say how its PTD works. Here both have the thresholds of the class of the "
    "terrain, and SciPy triangulates anew in each round. PTD adds all points that pass in a round, or, in the last row, only the "
    "lowest over each facet, so that it takes more rounds. CPU seconds are medians of three calls."
)


def verdicts(rows: Sequence[Row], table: Sequence[Row]) -> str:
    """The claim, judged by ratios of CPU seconds."""
    fast, *others = RUNS
    out = []
    for run in others:
        for kind, title in (("scipy", "SciPy"), ("own", "own triangulation")):
            mean = {row["run"]: row[kind] for row in table}
            by_sample = {
                name: statistics.fmean(r[kind] for r in rows if (r["sample"], r["run"]) == (name, run))
                / statistics.fmean(r[kind] for r in rows if (r["sample"], r["run"]) == (name, fast))
                for name in dict.fromkeys(r["sample"] for r in rows)
            }
            ratio, most = mean[run] / mean[fast], max(by_sample, key=by_sample.__getitem__)
            word = "Confirmed" if ratio >= 11 else "Refuted"
            span = f"{min(by_sample.values()):.2f} to {by_sample[most]:.2f} ({most})"
            out.append(
                f"- **{run} takes twelve times the time of {fast} ({title}).** Measured: {mean[run]:.3f} and {mean[fast]:.3f} s, "
                f"a ratio of {ratio:.2f}; on single samples {span}. **{word}.**"
            )
    return "\n".join(out)


if __name__ == "__main__":
    main()
