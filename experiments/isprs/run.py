"""Every method on the 15 labelled ISPRS samples under three protocols: fixed, class and oracle. See README.md."""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import figures, measure, protocols, samples, search, spaces, tables
from experiments.report import CommandLine, Row, machine, read_csv, write_csv, write_page
from jaxfilter.core.compilation import keep_compilations

QUICK = ("24", "41", "52", "53")
Maker = Callable[[str, str], jf.Filter]
"""The filter for a method and a sample."""


def main(arguments: list[str] | None = None) -> None:
    """Run what the command line asks for, as far as it is not at hand, and write tables and figures."""
    options = _parser().options(arguments)
    if options.quick:
        options.repeats, options.budget = 1, min(options.budget, 4)
    numbers = options.samples or list(QUICK if options.quick else samples.SAMPLES)
    folder = samples.data_folder(options.data)
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    if options.fresh:
        _discard(options.out, options.methods)

    chosen: dict[str, list[Row]] = {}
    matched: list[Row] = []
    if "fixed" in options.protocols:
        chosen["fixed"] = _one_set(options, folder, numbers, options.methods, spaces.fixed)
        judged = [m for m in options.methods if m == "ptd" or m in {claim.method for claim in protocols.CLAIMS}]
        matched = _one_set(options, folder, numbers, judged, spaces.matched)
        write_csv(options.out / "matched.csv", matched)
    if {"class", "oracle"} & set(options.protocols):
        start = time.perf_counter()
        found = search.run(
            options.out / "search", folder, options.methods, numbers, options.budget, options.processes, _say
        )
        _say(f"search: {time.perf_counter() - start:.0f} s")
        for name in ("class", "oracle"):
            if name in options.protocols:
                chosen[name] = [row for rows in found.values() for row in _chosen(name, rows, options.budget)]
    for name, rows in chosen.items():
        write_csv(options.out / f"{name}.csv", rows)
    claims = protocols.claims(chosen | {"matched": matched})
    write_csv(options.out / "claims.csv", claims)
    summaries = [
        {"protocol": p} | protocols.summary(tables.of_method(rows, m))
        for p, rows in chosen.items()
        for m in tables.order(rows)
    ]
    write_csv(options.out / "summary.csv", summaries)
    write_csv(options.out / "printed.csv", tables.printed_rows(chosen))
    pictures = _pictures(options, folder, numbers, chosen, summaries) if options.figures else []
    text = tables.report(options.repeats, options.budget, chosen, claims, pictures)
    write_page(options.out / "results.md", text, options.command, options.methods, keeps=True)
    for name, rows in chosen.items():
        print(f"{name}\n{tables.summary(rows)}\n")
    print(f"results are in {options.out}")


def _one_set(
    options: argparse.Namespace, folder: Path, numbers: Sequence[str], methods: Sequence[str], make: Maker
) -> list[Row]:
    """Rows of one set per method: one run after the other so that nothing disturbs the clock. All that is measured
    on one machine is kept in ``search/timed.csv`` and not run again there."""
    path = options.out / "search" / "timed.csv"
    path.parent.mkdir(exist_ok=True)
    before = read_csv(path) if path.exists() else []
    known = {_key(row): row for row in before if search.current(row) and row.get("machine") == machine()}
    rows = []
    for number in numbers:
        sample, cloud = f"samp{number}", None
        for method in methods:
            filter_ = make(method, sample)
            key = sample, method, search.digest(filter_)
            if key not in known:
                cloud = cloud or jf.read(samples.sample_path(folder, number))
                try:
                    known[key], _ = measure.sample_row(sample, method, filter_, cloud, options.repeats)
                except Exception as error:
                    rows.append(measure.failed_row(sample, method, cloud, error))
                    _say(f"{sample} {method:6} {rows[-1]['status']}")
                    continue
                write_csv(path, list(known.values()))
                _say(f"{sample} {method:6} total error {known[key]['total']:6.2f}  kappa {known[key]['kappa']:6.2f}")
            rows.append(known[key])
    return rows


def _key(row: Row) -> tuple[str, str, str]:
    return row["sample"], row["method"], row["parameters"]


def _chosen(protocol: str, rows: list[Row], budget: int) -> list[Row]:
    terrain = samples.terrain_classes()
    kappa = protocols.kappa_table(rows)
    choice = protocols.class_choice(kappa, terrain) if protocol == "class" else protocols.oracle_choice(kappa)
    return protocols.chosen_rows(rows, choice, terrain, budget)


def _pictures(
    options: argparse.Namespace,
    folder: Path,
    numbers: Sequence[str],
    chosen: dict[str, list[Row]],
    summaries: list[Row],
) -> list[tuple[str, str]]:
    """Draw the figures; their files and captions."""
    place = options.out / "figures"
    place.mkdir(exist_ok=True)
    out = []
    figures.heat_tables(chosen, options.methods, place / "totals.png", options.dpi)
    out.append(
        (
            "figures/totals.png",
            "Total error per sample and method under each protocol, in percent; the lowest per column is bold.",
        )
    )
    if "fixed" in chosen:
        figures.accuracy_against_time(
            [row for row in summaries if row["protocol"] == "fixed"], place / "time.png", options.dpi
        )
        out.append(("figures/time.png", "Mean kappa against time, fixed protocol."))
        clouds = {f"samp{n}": jf.read(samples.sample_path(folder, n)) for n in figures.SHOWN if n in numbers}
        labels = {}
        for name, cloud in clouds.items():
            for row in chosen["fixed"]:
                if row["sample"] == name and row["total"] == row["total"]:
                    labels[name, row["method"]] = spaces.fixed(row["method"], name)(cloud).ground
        if clouds:
            figures.error_panel(clouds, labels, options.methods, place / "errors.png", options.dpi)
            out.append(
                (
                    "figures/errors.png",
                    "Errors of every method over the shaded reference ground, fixed protocol; below each map the total error.",
                )
            )
    return out


def _discard(out: Path, methods: Sequence[str]) -> None:
    """Forget earlier runs of these methods."""
    for method in methods:
        (out / "search" / f"{method}.csv").unlink(missing_ok=True)
    path = out / "search" / "timed.csv"
    if path.exists():
        write_csv(path, [row for row in read_csv(path) if row["method"] not in methods])


def _parser() -> CommandLine:
    names = spaces.method_names()
    parser = CommandLine(__file__, __doc__)
    parser.add_argument(
        "--samples", type=samples.sample_name, nargs="+", metavar="SAMPLE", help="such as 11 24 [all 15]"
    )
    parser.add_argument(
        "--methods", nargs="+", choices=names, default=names, metavar="METHOD", help=f"of {', '.join(names)} [all]"
    )
    parser.add_argument(
        "--protocols",
        nargs="+",
        choices=protocols.PROTOCOLS,
        default=list(protocols.PROTOCOLS),
        metavar="PROTOCOL",
        help=f"of {', '.join(protocols.PROTOCOLS)} [all]",
    )
    parser.add_argument(
        "--budget",
        type=int,
        default=32,
        help="sets per method in class and oracle, the fixed one included [%(default)s]",
    )
    parser.add_argument(
        "--processes", "--workers", type=int, default=2, help="of the search, one thread each [%(default)s]"
    )
    parser.add_argument("--repeats", type=int, default=3, help="warm calls, of which the median counts [%(default)s]")
    parser.add_argument("--fresh", action="store_true", help="discard what earlier runs of the methods left in --out")
    parser.add_argument("--no-figures", dest="figures", action="store_false", help="tables only")
    parser.add_argument("--dpi", type=int, default=170, help="of the figures [%(default)s]")
    parser.add_argument("--quick", action="store_true", help=f"samples {', '.join(QUICK)}, four sets, one warm call")
    return parser


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
