"""FPTD, PTD and SMRF on the ISPRS WG III/3 samples and sites, beside the published figures. See README.md."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import measure, samples, tables
from experiments.report import Row, machine, write_csv
from jaxfilter.core.compilation import use_persistent_cache

QUICK = ("24", "41", "54")


def main(arguments: list[str] | None = None) -> None:
    """Run what the command line asks for and write tables and figures."""
    given = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(given)
    repeats = 1 if options.quick else options.repeats
    numbers = options.samples if options.samples is not None else list(QUICK if options.quick else samples.SAMPLES)
    sites = options.sites if options.sites is not None else list(() if options.quick else samples.SITES)
    folder = samples.data_folder(options.data)
    pictures = options.out / "figures"
    pictures.mkdir(parents=True, exist_ok=True)
    use_persistent_cache()

    sample_rows, outlier_rows = _run_samples(folder, numbers, options.methods, repeats, pictures, options.dpi)
    site_rows = _run_sites(folder, sites, repeats, pictures, options.dpi)
    for name, rows in (("samples", sample_rows), ("outliers", outlier_rows), ("sites", site_rows)):
        if rows:
            write_csv(options.out / f"{name}.csv", rows)
    command = shlex.join(["python", "experiments/isprs/run.py", *given])
    text = tables.report(machine(), command, repeats, sample_rows, outlier_rows, site_rows)
    (options.out / "results.md").write_text(text)
    if sample_rows:
        print(tables.summary(sample_rows) + "\n")
    print(f"results are in {options.out}")


def _run_samples(
    folder: Path, numbers: list[str], methods: list[str], repeats: int, pictures: Path, dpi: int
) -> tuple[list[Row], list[Row]]:
    sample_rows: list[Row] = []
    outlier_rows: list[Row] = []
    makers = measure.methods()
    for number in numbers:
        name = f"samp{number}"
        cloud = jf.read(samples.sample_path(folder, number))
        results = {}
        for method in methods:
            row, results[method] = measure.sample_row(name, method, makers[method](name), cloud, repeats)
            sample_rows.append(row)
            _say(f"{name} {method:16} total error {row['total']:6.2f}  kappa {row['kappa']:6.2f}  {row['seconds']:.3f} s")
        if "fptd" in results:
            outlier_rows.append(measure.outlier_row(name, cloud, results["fptd"]))
        if number in ("12", "61", "24", "53") and {"fptd", "ptd"} <= results.keys():
            from experiments.isprs import figures

            shown = {method: results[method] for method in ("ptd", "fptd")}
            figures.sample(name, cloud, shown, pictures / f"{name}.png", dpi)
    return sample_rows, outlier_rows


def _run_sites(folder: Path, sites: list[str], repeats: int, pictures: Path, dpi: int) -> list[Row]:
    rows: list[Row] = []
    maker = measure.methods()["fptd"]
    for site in sites:
        path = samples.site_path(folder, site)
        if path is None:
            _say(f"{site} is left out: {folder / 'isprs_sites'} has no {site}*.laz")
            continue
        cloud = jf.read(path, units="m", returns="all")
        row, result = measure.site_row(site, path.name, maker(site), cloud, repeats)
        rows.append(row)
        _say(f"{site} {row['ground']:,} of {row['points']:,} points are ground  {row['seconds']:.2f} s")
        if site == "FSite5":
            from experiments.isprs import figures

            figures.site(site, cloud, result, pictures / f"{site}.png", dpi)
    if len(rows) > 2:
        from experiments.isprs import figures

        figures.time_against_points(rows, pictures / "time.png", dpi)
    return rows


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="folder with isprs/ and isprs_sites/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "out", help="folder for the results [%(default)s]")
    parser.add_argument("--samples", type=samples.sample_name, nargs="*", metavar="SAMPLE", help="such as 11 24 [all 15]")
    parser.add_argument("--sites", nargs="*", choices=samples.SITES, metavar="SITE", help="such as FSite5 [all 8]")
    parser.add_argument("--methods", nargs="+", choices=list(tables.METHODS), default=list(tables.METHODS), metavar="METHOD",
                        help=f"of {', '.join(tables.METHODS)} [all]")
    parser.add_argument("--repeats", type=int, default=5, help="warm calls, of which the median counts [%(default)s]")
    parser.add_argument("--dpi", type=int, default=130, help="of the figures [%(default)s]")
    parser.add_argument("--quick", action="store_true", help=f"samples {', '.join(QUICK)}, no sites, one warm call")
    return parser


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
