"""OST: what each of its rules and steps gives, left out one at a time; what it is worth and what it costs.

    python experiments/default/rules.py [--only tiles dikes ...]

Writes ``results/ablations.csv`` and ``results/rules.md``. Rows of a cloud are kept, and not made again while the
labels stay.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import places, samples, search
from experiments.remake import SCENES, word
from experiments.report import Row, markdown, read_csv, write_csv, write_page
from experiments.scenes import clouds
from experiments.scenes.measures import MEASURES
from jaxfilter.core.compilation import keep_compilations
from jaxfilter.steps.rules import RULES

PLACES = 8
"""Places of the grid, for each sample."""
ALL, CORE = "all rules", "the core alone"
RULE = "all rules but "
WHAT = {
    "clusters": ("airborne", "bars false echoes in clusters"),
    "strays": ("airborne", "bars lone ones on slopes, under plants"),
    "pits": ("drone, photographs", "bars wrong matches in pits"),
    "voids": ("airborne, drone", "makes roofs at water stand out"),
    "halls": ("all", "joins roofs of several levels"),
    "steep": ("all", "keeps cliffs, which openings cut, and overhangs"),
    "embankments": ("airborne, drone", "keeps dikes, which openings cut"),
    "crossings": ("airborne, drone", "finds water and decks, which look like land"),
    "plants": ("airborne, drone", "drops seeds and vertices on plants"),
    "ramps": ("photographs, cars", "drops seeds on ramps of walls"),
}
"""By rule the clouds that it is for, and what it does, and why."""
STEPS: dict[str, dict[str, Any]] = {
    "1 without low points": {"low_points": 0},
    "4 one slope for all landscapes": {"relief": 0.0, "slope": 0.15},
    "5 without whole segments": {"roof_area": 1e9},
    "5 segments by marked cells only": {"roof_drop_share": 1.0},
    "7 without densification": {"rounds": 0},
    "7 angles count at any distance": {"noise": 0.0},
    "8 nothing dropped": {"scene_spread": 1e9},
}
"""What is left out of the core, by the number of the step in the class. All rules act."""
VARIANTS = [ALL, CORE, *(RULE + name for name in RULES), *STEPS]
SETS = ("samples", "tiles", "hard tiles", "low outliers")
"""Kinds of clouds with a table of their own; the others are scenes."""
WANTED: dict[str, dict[str, Any]] = {
    "tiles": {}, "hard tiles": {}, "scenes": {"density": 2}, "sensors": {"seed": 101}, "halls": {"density": 2, "seed": 100},
    "dikes": {"density": 2}, "water": {"density": 2}, "sparse forests": {"seed": 101}, "photographs": {"seed": 21},
    "low outliers": {"seed": 1}, "forests with low outliers": {"seed": 301},
}  # fmt: skip
"""By kind of cloud which of :func:`experiments.scenes.clouds.every` are taken."""
AGAIN = 1.3
"""A run that takes so many times what all rules take has compiled something, and is timed again."""
MEANS = {"total": ".2f", "kappa": ".1f", "rmse": ".3f", "off": ".2f"}
"""What is shown of each set."""


def main(arguments: list[str] | None = None) -> None:
    """Make what is missing, and write the page."""
    options = search.options(__file__, __doc__, arguments)
    own, more = word("ost"), word(SCENES)
    chosen = {
        cloud.name: (cloud, f"{own}-{more}" if cloud.simulated else own)
        for cloud in every(samples.data_folder(options.data))
        if not options.only or {cloud.kind, cloud.name} & {*options.only}
    }
    rows = kept(options.out / "ablations.csv", work, chosen, options.processes)
    write_page(options.out / "rules.md", page(pd.DataFrame(rows)), options.command, ("ost", SCENES), keeps=True)
    print(f"results are in {options.out}")


def kept(
    path: Path, work: Callable[[clouds.Cloud], list[Row]], chosen: dict[str, tuple[clouds.Cloud, str]], processes: int
) -> list[Row]:
    """The rows of clouds by name. Those in the file that have the labels that are named beside their cloud are not made again."""
    rows = [row for row in (read_csv(path) if path.exists() else []) if row["cloud"] in chosen]
    rows = [row for row in rows if row["labels"] == chosen[row["cloud"]][1]]
    done, order = {row["cloud"] for row in rows}, [*chosen]
    tasks = [(cloud,) for name, (cloud, _) in chosen.items() if name not in done]
    for number, ((cloud,), found) in enumerate(search.results(work, tasks, processes), 1):
        rows += [{"kind": cloud.kind, "cloud": cloud.name} | row | {"labels": chosen[cloud.name][1]} for row in found]
        rows.sort(key=lambda row: order.index(row["cloud"]))
        write_csv(path, rows)
        print(f"{number} of {len(tasks)} clouds", file=sys.stderr, flush=True)
    return [{key: value for key, value in row.items() if value != ""} for row in rows]


def every(folder: Path) -> Iterator[clouds.Cloud]:
    """The samples with grids from random points, tiles, and scenes."""
    for number in samples.SAMPLES:
        path = samples.sample_path(folder, number)
        for place, anchor in places.drawn(path, PLACES).items():
            yield clouds.Cloud("samples", f"{path.stem}, place {place}", partial(clouds.real, path, anchor), [])
    for cloud in clouds.every(folder):
        if cloud.kind in WANTED and cloud.facts.items() >= WANTED[cloud.kind].items():
            yield cloud


def work(cloud: clouds.Cloud) -> list[Row]:
    """A row for each variant: errors of labels and terrain, percent and metres, F1 of decks and water, and seconds of a
    processor. A rule that is not for the cloud's sensor is not left out; the row is that of all rules."""
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    site = cloud.make()
    whole = jf.OST.for_cloud(site.cloud)
    active = [name for name, rule in RULES.items() if whole.sensor in rule.SENSORS]
    timed(whole, site.cloud)  # what is compiled does not count
    found: dict[str, tuple[jf.FilterResult, Row]] = {}
    rows = []
    for variant in VARIANTS:
        left, changes = variant.removeprefix(RULE), STEPS.get(variant, {})
        if variant == CORE:
            changes = {"rules": ()}
        elif left in RULES:
            changes = {"rules": tuple(name for name in active if name != left)}
        if left in RULES and left not in active:
            row = found[ALL][1]
        else:
            result, seconds = timed(whole.replace(**changes), site.cloud)
            if variant != ALL and seconds > AGAIN * found[ALL][1]["cpu"]:
                seconds = min(seconds, timed(whole.replace(**changes), site.cloud)[1])
            same = (row for one, row in found.values() if alike(one, result))
            row = (next(same, None) or measured(site, result)) | {"cpu": seconds}
            found[variant] = result, row
        rows.append({"variant": variant, "sensor": whole.sensor} | row)
    return [{key: float(f"{v:.5g}") if isinstance(v, float) else v for key, v in row.items()} for row in rows]


def timed(method: jf.Filter, cloud: jf.PointCloud) -> tuple[jf.FilterResult, float]:
    """What a filter gives, and seconds of a processor."""
    start = time.process_time()
    return method(cloud, workers=1), time.process_time() - start


def alike(one: jf.FilterResult, other: jf.FilterResult) -> bool:
    """Whether all that is measured of two results is the same."""
    pairs = ((getattr(result, name) for result in (one, other)) for name in ("ground", "deck", "water"))
    return all(np.array_equal(*pair) for pair in pairs)


def measured(site: clouds.Site, result: jf.FilterResult) -> Row:
    """Of :data:`experiments.scenes.measures.MEASURES` what the page shows."""
    row = MEASURES["errors"](site, "ost", result)[0]
    if site.area is not None:
        row = MEASURES["water"](site, "ost", result)[0] | row
    return {key: row[key] for key in (*MEANS, "deck_f1", "water_f1") if key in row}


def page(table: pd.DataFrame) -> str:
    """All tables as Markdown."""
    table = table.reindex(columns=list(dict.fromkeys([*table, "deck_f1", "water_f1"])))
    broken = table["rmse"].isna().groupby(table["cloud"]).transform("any")
    table.loc[broken, ["rmse", "off"]] = np.nan
    table["set"] = table["kind"].where(table["kind"].isin(SETS), "scenes, of all kinds")
    kinds = table.groupby(["set", "kind", "variant"], sort=False).mean(numeric_only=True)
    text = [
        "# OST: what each rule and step gives",
        "One rule is left out at a time, or all, or one step of the core is changed. A rule acts where it is for the sensor. "
        "Total error and kappa are of labels, percent. Terrain is compared on cells of 1 m within 3 m of reference ground: "
        "`rmse` in metres, and `off`, the percentage of cells that are off by more than 0.5 m. Clouds on which some variant "
        f"leaves no terrain have neither ({table.loc[broken, 'cloud'].nunique()} of {table['cloud'].nunique()} clouds). `cpu` is "
        "the time of the filter relative to that of all rules, summed over the clouds, without reading and compiling. "
        f"Samples are filtered with grids from {PLACES} random points each.",
    ]  # fmt: skip
    text += ["## What a rule gives", summary(table)]
    for name in dict.fromkeys(table["set"]):
        means = kinds.loc[name].groupby("variant", sort=False).mean()  # kinds count alike
        spent = table[table["set"] == name].groupby("variant", sort=False)["cpu"].sum()
        text += [f"## {name.capitalize()}", _shown(means.assign(cpu=spent / spent[ALL]), MEANS | {"cpu": ".2f"})]
    scenes = table[~table["kind"].isin(SETS)]
    for key, title, form in (("total", "Total error, %", ".2f"), ("rmse", "Terrain RMSE, m", ".3f")):
        wide = scenes.groupby(["variant", "kind"], sort=False)[key].mean().unstack(sort=False)
        text += [f"## {title}, by kind of scene", _shown(wide.reindex(VARIANTS), dict.fromkeys(wide, form))]
    areas = dict.fromkeys(("deck_f1", "water_f1"), ".3f")
    text += ["## Areas of decks and water", "F1 of areas, as on the page of [scenes](../../scenes/results/results.md).",
             _shown(table.groupby("variant")[[*areas]].mean(), areas)]  # fmt: skip
    names = {kind: part["cloud"].nunique() for kind, part in table.groupby("kind", sort=False)}
    text.append("Clouds: " + ", ".join(f"{kind} {number}" for kind, number in names.items()) + ".")
    return "\n\n".join(text)


def summary(table: pd.DataFrame) -> str:
    """A row for each rule: points of total error, and of cells that are off, that it saves on labelled clouds and on scenes, and
    its share of the time. All kinds of clouds count alike."""
    kinds = table.assign(scene=~table["kind"].isin(SETS)).groupby(["scene", "kind", "variant"])[["total", "off"]].mean()
    means, spent = kinds.groupby(["scene", "variant"]).mean(), table.groupby("variant")["cpu"].sum()
    rows = []
    for name, (sensors, words) in WHAT.items():
        saved = [means.loc[scene, RULE + name] - means.loc[scene, ALL] for scene in (False, True)]
        labelled, scenes = (f"{one['total']:.2f}/{one['off']:.2f}" for one in saved)
        cost = f"{100 * (1 - spent[RULE + name] / spent[ALL]):.0f}"
        rows.append(
            {"rule": name, "clouds": sensors, "what": words, "labelled": labelled, "scenes": scenes, "cost": cost}
        )
    return markdown([(key, key if key != "cost" else "cost, %", "") for key in rows[0]], rows)


def _shown(table: pd.DataFrame, forms: dict[str, str]) -> str:
    """A row for each variant; columns in their formats."""
    columns = [("variant", "", ""), *((key, key.replace("_", " "), form) for key, form in forms.items())]
    return markdown(columns, table.loc[VARIANTS].reset_index().to_dict("records"))


if __name__ == "__main__":
    main()
