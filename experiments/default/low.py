"""Low outliers: labels of tiles to which they are added, and of forests on slopes, by OST, SMRF and CSF.

    python experiments/default/low.py [--only "low outliers" ...]

Writes ``results/low.csv`` and ``results/low.md``.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples, search
from experiments.remake import SCENES
from experiments.report import Row, markdown, write_csv, write_page
from experiments.scenes import clouds
from experiments.scenes.measures import errors
from jaxfilter.core.compilation import keep_compilations

KINDS = ("low outliers", "forests with low outliers")
METHODS = ("ost", "smrf", "csf")
TITLES = {"total": "Total error, %", "off": "Cells of 1 m that are off by more than 0.5 m, %"}


def main(arguments: list[str] | None = None) -> None:
    """Run the methods on all clouds, and write the page."""
    options = search.options(__file__, __doc__, arguments)
    chosen = options.only or KINDS
    tasks = [(one,) for one in clouds.every(samples.data_folder(options.data)) if one.kind in chosen]
    rows = [row for _, rows in search.results(work, tasks, options.processes) for row in rows]
    write_csv(options.out / "low.csv", rows)
    table = pd.DataFrame(rows)
    text = [
        "# Low outliers",
        f"{1000 * clouds.LOW_SHARE:g} points are added to 1,000 of a tile, at random places, {clouds.LOW_DEPTH[0]:g} to "
        f"{clouds.LOW_DEPTH[1]:g} m below the triangulation of its labelled ground; three draws. Forests on slopes are scenes: "
        "one of 1,000 pulses has an echo too low. Low outliers are no ground. Means over draws, and over forests by slope.",
    ]
    for key, title in TITLES.items():
        text.append(f"## {title}")
        for _, part in table.groupby("kind", sort=False):
            wide = part.pivot_table(key, "cloud", "method", sort=False)[[*METHODS]]
            wide.loc["mean"] = wide.mean()
            columns = [("cloud", "cloud", ""), *((name, name, ".2f") for name in METHODS)]
            text.append(markdown(columns, wide.reset_index().to_dict("records")))
    write_page(options.out / "low.md", "\n\n".join(text), options.command, (*METHODS, SCENES))


def work(cloud: clouds.Cloud) -> list[Row]:
    """A row for each method."""
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    site = cloud.make()
    head = {"kind": cloud.kind, "cloud": site.name, **cloud.facts}
    rows = []
    for method in METHODS:
        result = jf.FILTERS[method].for_cloud(site.cloud)(site.cloud, workers=1)
        rows += [head | {"method": method} | row for row in errors(site, method, result)]
    return [{key: float(f"{v:.5g}") if isinstance(v, float) else v for key, v in row.items()} for row in rows]


if __name__ == "__main__":
    main()
