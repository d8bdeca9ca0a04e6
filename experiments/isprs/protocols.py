"""The three protocols, and what the papers claim about classic PTD judged under each of them.

*fixed*: ``for_cloud(cloud)``, the defaults and what follows from the point spacing. Nothing is chosen per sample; where the
defaults come from, and which of them were chosen on some of these samples, is told in docs/fidelity.md.
*class*: per terrain class of Li et al. (2021) the set with the best mean kappa on the *other* samples of the class.
*oracle*: per sample the set with the best kappa on that sample itself, of those that were tried: no result for other data, and no
bound of the method.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import statistics
from collections.abc import Mapping, Sequence

import numpy as np

import jaxfilter as jf
from experiments.isprs import search, spaces
from experiments.report import Row
from jaxfilter.sweeps.comparison import paired
from jaxfilter.sweeps.ranges import search_ranges

PROTOCOLS = ("fixed", "class", "oracle")
CLAIMED_UNDER = ("fixed", "matched", "class", "oracle")
"""Where claims are judged; "matched": the fixed set with PTD's limits of angle and distance."""
SCORES = ("type1", "type2", "total", "kappa")


def scores(row: Row) -> dict[str, float]:
    """Errors and kappa in percent from the counts of a row; NaN where a filter failed."""
    counts = [row.get(key) for key in search.COUNTS]
    if not all(isinstance(count, int) for count in counts):
        return dict.fromkeys(SCORES, math.nan)
    found = jf.Scores.from_confusion(np.array(counts).reshape(2, 2))
    return {key: getattr(found, key) for key in SCORES}


def kappa_table(rows: Sequence[Row]) -> dict[str, dict[int, float]]:
    """Kappa by sample and set of one method's search; a failed set has minus infinity."""
    table: dict[str, dict[int, float]] = {}
    for row in rows:
        kappa = scores(row)["kappa"]
        table.setdefault(row["sample"], {})[row["set"]] = -math.inf if math.isnan(kappa) else kappa
    return table


def class_choice(kappa: Mapping[str, Mapping[int, float]], terrain: Mapping[str, str]) -> dict[str, int]:
    """Per sample the set with the best mean kappa over the other samples of its class, itself left out.

    Of equally good sets the first is taken. A sample that is alone in its class keeps set 0, the fixed set.
    """
    chosen = {}
    for sample in kappa:
        others = [s for s in kappa if s != sample and terrain[s] == terrain[sample]]
        common = sorted(set.intersection(*(set(kappa[s]) for s in others))) if others else [0]
        chosen[sample] = max(common, key=lambda i: sum(kappa[s][i] for s in others))
    return chosen


def oracle_choice(kappa: Mapping[str, Mapping[int, float]]) -> dict[str, int]:
    """Per sample the set with the best kappa on its own labels; of equally good sets the first."""
    return {sample: max(sorted(sets), key=sets.__getitem__) for sample, sets in kappa.items()}


def chosen_rows(rows: Sequence[Row], choice: Mapping[str, int], terrain: Mapping[str, str], budget: int) -> list[Row]:
    """The rows of one method's search that were chosen, with scores and thresholds."""
    out = []
    for row in rows:
        if choice.get(row["sample"]) == row["set"]:
            head = {
                "sample": row["sample"],
                "method": row["method"],
                "terrain": terrain[row["sample"]],
                "set": row["set"],
            }
            fixed, changed = spaces.fixed(row["method"], row["sample"]), spaces.sets(row["method"], budget)[row["set"]]
            values = {
                name: changed.get(name, getattr(fixed, name)) for name in search_ranges(jf.FILTERS[row["method"]])
            }
            thresholds = " ".join(f"{name}={value:g}" for name, value in values.items())
            out.append(head | scores(row) | {key: row[key] for key in search.COUNTS} | {"thresholds": thresholds})
    return out


def summary(rows: Sequence[Row]) -> Row:
    """Mean, median and pooled figures of one method's rows under one protocol. Pooled: counts added up over all points."""
    out: Row = {"method": rows[0]["method"], "samples": len(rows)}
    good = [row for row in rows if not math.isnan(row["kappa"])]
    out["failed"] = len(rows) - len(good)
    if not good:
        return out
    for key in SCORES:
        values = [row[key] for row in good]
        out[key], out[f"median_{key}"] = statistics.fmean(values), statistics.median(values)
    sums = {key: sum(row[key] for row in good) for key in search.COUNTS}
    out |= {f"pooled_{key}": value for key, value in scores(sums).items()}
    seconds = [row["seconds"] for row in good if isinstance(row.get("seconds"), float)]
    if seconds:
        points = sum(sum(row[key] for key in search.COUNTS) for row in good)
        out |= {"seconds": statistics.fmean(seconds), "median_seconds": statistics.median(seconds)}
        out["seconds_per_million"] = 1e6 * sum(seconds) / points
    return out


@dataclasses.dataclass(frozen=True)
class Claim:
    """What a paper says of a method against classic PTD. ``printed``: by quantity, PTD's mean and the method's."""

    method: str
    source: str
    printed: dict[str, tuple[float, float]]


CLAIMS = (
    Claim(
        "fptd",
        "Li et al. (2021), Table IV",
        {"type1": (15.56, 5.79), "total": (11.23, 6.12), "kappa": (69.63, 79.76)},
    ),
    Claim(
        "spf",
        "Chen et al. (2023), Table 2 and text",
        {"type1": (23.12, 14.66), "total": (16.34, 11.28)},
    ),
    Claim(
        "agptd", "Zheng et al. (2024), Table 6", {"type1": (5.55, 1.11), "total": (4.82, 2.28), "kappa": (84.19, 90.86)}
    ),
)
"""Uray and Varlik (2024) print larger errors for STIN and IPTD than for ATIN, and so claim nothing here. What the papers say of
time is judged in ``experiments/papers`` alone, by runs that differ in nothing else."""


def claims(tables: Mapping[str, Sequence[Row]]) -> list[Row]:
    """One row per claim, protocol and quantity: means over the samples, and on how many of them the method is better.

    ``tables``: rows by the name of the protocol.

    ``verdict``: "confirmed" if the method is better in the mean, on more than half of the samples, and with p < 0.05;
    "tendency" if only p is not that small; "refuted" if it is better neither in the mean nor on most samples; else
    "mixed". ``p``: Wilcoxon's signed-rank test of the differences, two-sided.
    """
    order = [name for name in CLAIMED_UNDER if name in tables]
    out = []
    for claim, protocol in itertools.product(CLAIMS, order):
        ours, classic = (
            {row["sample"]: row for row in tables[protocol] if row["method"] == method}
            for method in (claim.method, "ptd")
        )
        for quantity, printed in claim.printed.items():
            pairs = [(classic[s].get(quantity), ours[s].get(quantity)) for s in ours if s in classic]
            pairs = [
                (a, b) for a, b in pairs if isinstance(a, float) and isinstance(b, float) and not math.isnan(a - b)
            ]
            if pairs:
                head = {"method": claim.method, "source": claim.source, "quantity": quantity, "protocol": protocol}
                head |= {"printed_ptd": printed[0], "printed_method": printed[1]}
                out.append(head | compare(pairs, larger_is_better=quantity == "kappa"))
    return out


def compare(pairs: Sequence[tuple[float, float]], *, larger_is_better: bool) -> Row:
    """A method (second of each pair) against another (first) over samples; see :func:`claims`."""
    found = paired(pairs, larger_is_better=larger_is_better)
    gain = found["difference"] if larger_is_better else -found["difference"]
    signs = int(gain > 0) + int(found["better"] > len(pairs) / 2)
    return {
        "ptd": found["mean_other"],
        "measured": found["mean"],
        "difference": found["difference"],
        "median_difference": found["median_difference"],
        "better": found["better"],
        "worse": found["worse"],
        "samples": len(pairs),
        "p": found["p"],
        "verdict": ("refuted", "mixed", "tendency" if found["p"] >= 0.05 else "confirmed")[signs],
    }


def differences(rows: Sequence[Row], key: str) -> list[Row]:
    """Per sample: ``key`` of PTD, and by how much each method that claims to improve on it differs."""
    value = {(row["sample"], row["method"]): row[key] for row in rows}
    methods = [claim.method for claim in CLAIMS if any(method == claim.method for _, method in value)]
    names = [sample for sample, method in value if method == "ptd"]
    return [
        {"sample": s, "ptd": value[s, "ptd"]} | {m: value[s, m] - value[s, "ptd"] for m in methods if (s, m) in value}
        for s in names
    ]
