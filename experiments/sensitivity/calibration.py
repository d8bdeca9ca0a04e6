"""How well a few labelled patches choose the parameters of SMRF on the ISPRS samples. See README.md."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples
from experiments.report import Row, machine, markdown, with_averages, write_csv
from jaxfilter.core.compilation import use_persistent_cache

HERE = Path(__file__).parent
PATCHES = 5
SHARE = 0.02
"""Of the points of a sample that are labelled, in all patches together."""


def main(arguments: list[str] | None = None) -> None:
    """Calibrate on every sample, several times, and write the table."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="folder with isprs/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    parser.add_argument("--samples", type=samples.sample_name, nargs="+", default=list(samples.SAMPLES))
    parser.add_argument("--draws", type=int, default=10, help="of patches, per sample [%(default)s]")
    parser.add_argument("--size", type=int, default=256, help="sets per round of the search [%(default)s]")
    options = parser.parse_args(given)
    folder = samples.data_folder(options.data)
    options.out.mkdir(parents=True, exist_ok=True)
    use_persistent_cache()
    rows = []
    for number in options.samples:
        rows.append(sample_row(number, jf.read(samples.sample_path(folder, number)), options.draws, options.size))
        print(f"{rows[-1]['sample']}  given {rows[-1]['given']:.2f}  calibrated {rows[-1]['calibrated']:.2f}  "
              f"oracle {rows[-1]['oracle']:.2f}  loss {rows[-1]['loss']:.2f}", flush=True)  # fmt: skip
    write_csv(options.out / "calibration.csv", rows)
    command = shlex.join(["python", "experiments/sensitivity/calibration.py", *given])
    (options.out / "calibration.md").write_text(report(rows, command, options.draws, options.size))
    print(f"results are in {options.out}")


def patches(cloud: jf.PointCloud, seed: int) -> np.ndarray:
    """bool[n]: 2 % of the points in five places, each the points nearest to a point drawn at random, both classes in each."""
    rng = np.random.default_rng(seed)
    xy, truth = cloud.xyz[:, :2].astype(np.float64), cloud.reference
    each = max(10, round(SHARE * len(cloud) / PATCHES))
    out = np.zeros(len(cloud), bool)
    found = 0
    for centre in rng.permutation(len(cloud)):
        near = np.argpartition(((xy - xy[centre]) ** 2).sum(axis=1), each)[:each]
        if truth[near].all() or not truth[near].any() or out[near].any():
            continue
        out[near] = True
        found += 1
        if found == PATCHES:
            return out
    raise SystemExit(f"there are no {PATCHES} patches of {each} points with both classes")


def sample_row(number: str, cloud: jf.PointCloud, draws: int, size: int) -> Row:
    """Total errors on the points without labels: as given, calibrated (median of the draws), and with all labels known."""
    truth = cloud.reference
    oracle = jf.calibrate(jf.SMRF(), cloud, truth, size=size)
    everything = oracle.trials.total.values
    best = oracle.filter.replace(
        **{
            name: oracle.trials[name].values[int(everything.argmin())].item()
            for name in oracle.trials.attrs["searched"]
        }
    )
    ceiling, given = best(cloud).ground, jf.SMRF()(cloud).ground
    losses, errors, defaults, ceilings, expected = [], [], [], [], []
    for draw in range(draws):
        labelled = patches(cloud, 1000 * draw + int(number))
        found = jf.calibrate(jf.SMRF(), cloud, truth, labelled=labelled, size=size, seed=draw)

        def error(ground: np.ndarray, aside: np.ndarray = labelled) -> float:
            return jf.evaluate(ground, truth, ignore=aside).total

        errors.append(error(found.filter(cloud).ground))
        defaults.append(error(given))
        ceilings.append(error(ceiling))
        losses.append(errors[-1] - ceilings[-1])
        expected.append(found.score)
    return {
        "sample": f"samp{number}", "points": len(cloud), "labelled": int(labelled.sum()), "given": float(np.median(defaults)),
        "calibrated": float(np.median(errors)), "oracle": float(np.median(ceilings)), "loss": float(np.median(losses)),
        "worst": max(losses), "expected": float(np.median(expected)), "better": float(np.mean(np.less(errors, defaults))),
    }  # fmt: skip


def report(rows: list[Row], command: str, draws: int, size: int) -> str:
    """The table as Markdown."""
    near = sum(row["loss"] <= 0.5 for row in rows)
    return "\n\n".join(
        [
            "# Calibration from a few labels",
            f"`{command}` on {machine()}. SMRF, two rounds of {size} sets over slope, threshold and scaling, total error in "
            f"percent on the points without labels, medians of {draws} draws. {100 * SHARE:g} % of the points are labelled, in "
            f"{PATCHES} patches that hold both classes. Oracle = the best of the same search with all labels. Expected = the "
            "cross-validated score that the calibration itself reports.",
            markdown(
                [
                    ("sample", "sample", ""), ("labelled", "labelled points", ",.0f"), ("given", "as given", ".2f"),
                    ("calibrated", "calibrated", ".2f"), ("oracle", "oracle", ".2f"), ("loss", "loss, points", ".2f"),
                    ("worst", "worst draw", ".2f"), ("expected", "expected", ".2f"), ("better", "share better", ".1f"),
                ],
                with_averages(rows, "sample"),
            ),
            f"The loss is at most 0.5 points on {near} of {len(rows)} samples.",
            "",
        ]
    )  # fmt: skip


if __name__ == "__main__":
    main()
