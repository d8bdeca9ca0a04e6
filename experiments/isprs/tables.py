"""The report: measured figures beside published ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from experiments.isprs import samples
from experiments.report import Column, Row, markdown, with_averages

SCORES = ("type1", "type2", "total", "kappa", "seconds")
MEASURED: list[Column] = [
    ("type1", "T.I", ".2f"), ("type2", "T.II", ".2f"), ("total", "TE", ".2f"), ("kappa", "kappa", ".2f"),
    ("seconds", "s", ".3f"),
]
PRINTED: list[Column] = [
    ("printed_type1", "T.I, printed", ".2f"), ("printed_type2", "T.II, printed", ".2f"),
    ("printed_total", "TE, printed", ".2f"), ("printed_kappa", "kappa, printed", ".2f"),
    ("printed_seconds", "s, printed", ".2f"),
]
METHODS = {
    "fptd": ("FPTD", "terrain class, global triangulation, label-free low-cluster removal", "fptd"),
    "fptd_independent": ("FPTD, independent blocks", "terrain class, blocks as in the paper, label-free low-cluster "
                                                     "removal", "fptd"),
    "fptd_paper": ("FPTD, radius filter only", "terrain class, blocks as in the paper, nothing in place of the manual "
                                               "removal", "fptd"),
    "ptd": ("PTD", "terrain class of Li et al., global triangulation, label-free low-cluster removal", "ptd"),
    "ptd_static": ("PTD, static border", "the same, border points keep their first elevation", "ptd"),
    "smrf": ("SMRF", "one set: cell 1, slope 0.15, window 18, threshold 0.5, scaling 1.25", "fixed"),
    "smrf_oracle": ("SMRF, oracle", "per sample, chosen by Pingel et al. on the labels", "oracle"),
}
"""Name, parameters, and which published column belongs beside it."""


def printed_scores() -> dict[tuple[str, str], Row]:
    """Published figures by (sample, column), as ``printed_*`` values."""
    out: dict[tuple[str, str], Row] = {}
    for row in samples.published("li2021_table4"):
        if row["sample"] != "average":
            out[row["sample"], row["method"]] = {f"printed_{key}": row[key] for key in SCORES}
    for row in samples.published("pingel2013"):
        out[row["sample"], "fixed"] = {"printed_kappa": row["kappa_fixed"]}
        out[row["sample"], "oracle"] = {"printed_kappa": row["kappa_oracle"], "printed_total": row["total_oracle"]}
    return out


def beside_printed(rows: Sequence[Row], method: str) -> list[Row]:
    """The rows of one method with the published figures of its column, then their mean and median."""
    printed = printed_scores()
    column = METHODS[method][2]
    chosen = [row | printed.get((row["sample"], column), {}) for row in rows if row["method"] == method]
    return with_averages(chosen, "sample")


def summary(rows: Sequence[Row]) -> str:
    """One line per method: means and medians over the samples that were run."""
    lines = []
    for method, (title, parameters, _) in METHODS.items():
        table = beside_printed(rows, method)
        if len(table) == 2:
            continue
        mean, median = table[-2:]
        lines.append(mean | {"title": title, "parameters": parameters, "median_total": median["total"],
                             "median_kappa": median["kappa"]})
    columns: list[Column] = [
        ("title", "method", ""), ("parameters", "parameters", ""), ("type1", "T.I", ".2f"), ("type2", "T.II", ".2f"),
        ("total", "TE", ".2f"), ("median_total", "TE, median", ".2f"), ("kappa", "kappa", ".2f"),
        ("median_kappa", "kappa, median", ".2f"), ("seconds", "s", ".3f"), ("printed_total", "TE, printed", ".2f"),
        ("printed_kappa", "kappa, printed", ".2f"), ("printed_seconds", "s, printed", ".2f"),
    ]
    return markdown(columns, lines)


def per_sample(rows: Sequence[Row], method: str) -> str:
    """Scores per sample, measured beside published."""
    table = beside_printed(rows, method)
    printed = [column for column in PRINTED if any(column[0] in row for row in table)]
    lead: list[Column] = [("sample", "sample", "")]
    if METHODS[method][2] in ("fptd", "ptd"):
        lead.append(("terrain", "class", ""))
    return markdown([*lead, ("points", "points", ",.0f"), *MEASURED, *printed], table)


def outliers(rows: Sequence[Row]) -> str:
    """What was barred from the seeds, and what of it the reference calls ground."""
    total: Row = {"sample": "sum"} | {
        key: sum(row[key] for row in rows) for key in rows[0] if key not in ("sample", "radius_ground_share")
    }
    columns: list[Column] = [
        ("sample", "sample", ""), ("barred", "barred", ",d"), ("barred_ground", "ground by the reference", ",d"),
        ("barred_ground_kept", "of these ground in the result", ",d"),
        ("barred_object_accepted", "barred objects ground in the result", ",d"),
        ("radius", "radius filter would bar", ",d"), ("radius_ground", "ground by the reference", ",d"),
        ("radius_ground_share", "share of all ground, %", ".1f"),
    ]
    return markdown(columns, [*rows, total])


def sites(rows: Sequence[Row]) -> str:
    """Points, ground points and seconds per site, measured beside Table III."""
    printed = {row["site"]: row for row in samples.published("li2021_table3")}
    table = [row | {f"printed_{key}": printed[row["site"]][key] for key in ("points", "ground", "seconds")} for row in rows]
    columns: list[Column] = [
        ("site", "site", ""), ("file", "file", ""), ("terrain", "class", ""), ("points", "points", ",d"),
        ("ground", "ground points", ",d"), ("seconds", "s", ".2f"), ("printed_points", "points, printed", ",d"),
        ("printed_ground", "ground points, printed", ",d"), ("printed_seconds", "s, printed", ".2f"),
    ]
    return markdown(columns, table)


def time_fit(points: Sequence[float], seconds: Sequence[float]) -> tuple[float, float, float]:
    """Least-squares line of seconds against millions of points: slope, intercept, and R squared."""
    x, y = np.asarray(points, float) / 1e6, np.asarray(seconds, float)
    slope, intercept = np.polyfit(x, y, 1)
    residual = y - (slope * x + intercept)
    return float(slope), float(intercept), float(1 - (residual**2).sum() / ((y - y.mean()) ** 2).sum())


def report(
    machine: str, command: str, repeats: int, sample_rows: Sequence[Row], outlier_rows: Sequence[Row],
    site_rows: Sequence[Row],
) -> str:
    """The whole report as Markdown."""
    text = [
        "# FPTD, PTD and SMRF on the ISPRS WG III/3 data", "",
        f"`{command}` on {machine}.", "",
        f"Errors and kappa in percent over all points of a sample; s = seconds of a warm call without I/O, median of "
        f"{repeats}. What is printed is from the papers named in the README beside the experiment; its seconds are those "
        "of its authors' machines.",
    ]
    if sample_rows:
        text += ["", "## Means over the samples", "", summary(sample_rows)]
        for method, (title, parameters, _) in METHODS.items():
            if any(row["method"] == method for row in sample_rows):
                text += ["", f"## {title}", "", f"Parameters: {parameters}.", "", per_sample(sample_rows, method)]
    if outlier_rows:
        text += [
            "", "## Points that FPTD bars from its seeds", "",
            "Clusters of low points, found without labels; the reference only counts them here. They are tested again "
            "after the others. Beside them the paper's radius filter (r = 5 m, n = 10), which our presets leave off: had its "
            "points been removed for good, the last column would be a lower bound of the Type I error.",
            "", outliers(outlier_rows),
        ]
    if site_rows:
        text += [
            "", "## FPTD on the unlabelled sites, all echoes", "",
            "Thresholds by terrain class, global triangulation. Where the file at hand is not the one of the paper, its "
            "number of points differs.",
            "", sites(site_rows),
        ]
        if len(site_rows) > 2:
            printed = samples.published("li2021_table3")
            text += [
                "", "Linear fits of seconds:", "",
                *(f"- {who}, against {what}: {_fit(table, key)}"
                  for who, table in (("measured", site_rows), ("printed", printed))
                  for key, what in (("points", "points"), ("ground", "ground points"))),
            ]
    return "\n".join(text) + "\n"


def _fit(rows: Sequence[Row], key: str) -> str:
    slope, intercept, r2 = time_fit([row[key] for row in rows], [row["seconds"] for row in rows])
    return f"{slope:.2f} s per million {intercept:+.2f} s, R² = {r2:.3f}"
