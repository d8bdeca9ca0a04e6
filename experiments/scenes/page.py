"""The page of results: a section for each kind of cloud, and for water, cuts and named places. README.md explains the columns."""

from __future__ import annotations

import numpy as np
import pandas as pd

from experiments.report import Column, Row, markdown

MEANS = {
    "clouds": "d", "total": ".2f", "kappa": ".1f", "rmse": ".3f", "p95": ".2f", "off": ".2f", "off_1m": ".2f", "high_1m": ".2f",
    "low_1m": ".2f", "border_off_1m": ".2f", "inside_off_1m": ".2f",
}  # fmt: skip
"""What is shown of every kind of cloud, in the mean, and how."""
SINGLE = {
    "total": "Total error, %", "rmse": "Terrain RMSE, m", "off": "Cells off by more than 0.5 m, %", "type1": "Ground lost, %",
    "called": "Points called ground where nothing is known, %",
}  # fmt: skip
"""What is shown of single clouds of some kinds."""
TABLES: dict[str, tuple[str, list[str], list[str]]] = {
    **dict.fromkeys(("hard tiles", "scenes", "sensors", "drawn anew"), ("cloud", ["method"], [*SINGLE])),
    **dict.fromkeys(("layouts", "photographs", "photographs anew"), ("cloud", ["method"], ["total", "rmse"])),
    **dict.fromkeys(("sparse forests", "sparse forests anew"), ("method", ["density", "share"], ["total", "rmse"])),
}
"""By kind of cloud what has a row, what has a column, and which of :data:`SINGLE` is shown."""
PARTS = {"halls": ("hall", ["place"], ["roof"], ["density"]), "dikes": ("crest", ["width", "slope"], ["density"])}
"""The part of a cloud of which the share that becomes ground is shown, and by what."""
PLACES: list[Column] = [
    ("kind", "clouds", ""), ("found", "of the area off, named, %", ".0f"), ("hit", "places that hold some, %", ".0f"),
    ("tenths", "a tenth of their area, %", ".0f"), ("times", "named area / area off", ".2f"),
]  # fmt: skip
VOLUMES = {"off": ",.0f", "judged": ",.0f", "volume": ",.0f", "volume_true": ",.0f"}


def page(tables: dict[str, list[Row]]) -> str:
    """All tables as Markdown, of what has rows."""
    text = ["# Tiles, scenes and single situations", "[What the clouds and the columns are](../README.md)."]
    for name, rows in tables.items():
        if rows:
            table = pd.DataFrame([{key: value for key, value in row.items() if value != ""} for row in rows])
            text += {"errors": errors, "water": water, "cuts": cuts, "places": places}[name](table)
    return "\n\n".join(text)


def errors(table: pd.DataFrame) -> list[str]:
    """For each kind of cloud means by method, and what else it asks for."""
    text = []
    table = table.reindex(columns=list(dict.fromkeys([*table, *SINGLE, "scene"])))
    table["cloud"] = table["cloud"].mask(table["scene"].notna(), table["scene"])
    for kind, part in table.groupby("kind", sort=False):
        text.append(f"## {str(kind).capitalize()}")
        if kind in PARTS:
            name, *facts = PARTS[str(kind)]
            text.append(_means(part.assign(mostly=100 * (part[name] > 50)), {name: ".1f", "mostly": ".0f"}))
            text.append(f"### Points of a {name} that are ground, %")
            text += [_wide(part, "method", keys, name, ".0f") for keys in facts]
        elif kind in ("sensors", "drawn anew"):
            groups = part.groupby(["cloud", "method"], sort=False)[[*SINGLE]]
            part = groups.agg(lambda values: values.mean(skipna=False)).reset_index()
            title = "Beside the best of the other methods" if kind == "sensors" else "Beside the best, drawn anew"
            text += [f"### {title}", _best(part)]
        else:
            text.append(_means(part, {"total": ".2f"}))
        index, columns, keys = TABLES.get(str(kind), ("", [], []))
        for key in keys:
            if part[key].notna().any():
                form = ".3f" if key == "rmse" else ".2f"
                text += [f"### {SINGLE[key]}, {kind}", _wide(part, index, columns, key, form)]
    return text


def water(table: pd.DataFrame) -> list[str]:
    """Decks and water that OST finds by area, and points of them in tiles."""
    areas = {"deck_f1": ".2f", "deck_wrong": ",.0f", "water_f1": ".2f", "water_wrong": ",.0f", "off": ".2f"}
    scenes = table[table["kind"] == "water"]
    text = ["## Water and bridge decks", _shown(scenes, {"scene": "", "density": ".1f"} | areas)]
    if "water_points" in table:
        points = {f"{what}_{key}": ",.0f" for what in ("water", "deck") for key in ("points", "marked", "both")}
        tiles = table[table["water_points"] + table["deck_points"] > 0]
        text += ["### Points of water and decks in tiles with classes 9 and 17", _shown(tiles, {"cloud": ""} | points)]
    return text


def cuts(table: pd.DataFrame) -> list[str]:
    """What cuts spoil, over all cuts of a kind of cloud."""
    groups = table.groupby(["method", "kind"], sort=False)
    sums = groups.sum(numeric_only=True).assign(cuts=groups.size())
    for key in ("off", "off_whole", "spoiled"):
        sums[key] = 100 * sums[key] / sums["cells"]
    forms = {"method": "", "kind": "", "cuts": "d", "cells": ",.0f", "off": ".2f", "off_whole": ".2f", "spoiled": ".2f"}
    return ["## Cuts", _shown(sums.reset_index(), forms)]


def places(table: pd.DataFrame) -> list[str]:
    """What named places hold, over all clouds of a kind, and of each cloud with 200 m2 or more that are off."""
    sums = table.groupby("kind", sort=False).sum(numeric_only=True)
    sums.loc["all but samples"] = sums.drop(index="samples", errors="ignore").sum()
    rows, single = (
        part.assign(
            found=100 * part["off_named"] / part["off"], hit=100 * part["right"] / part["judged"],
            tenths=100 * part["tenth"] / part["judged"], times=part["named"] / part["off"],
        ).reset_index()
        for part in (sums, table[table["off"] >= 200])
    )  # fmt: skip
    forms = {key: form for key, _, form in PLACES} | VOLUMES
    return [
        "## Named places", markdown(PLACES, rows.to_dict("records")),
        "### Areas and volumes of named places", _shown(rows, {"kind": ""} | VOLUMES),
        "### Named places of single clouds", _shown(single, {"cloud": ""} | forms),
    ]  # fmt: skip


def _shown(table: pd.DataFrame, forms: dict[str, str]) -> str:
    """Columns by their names, each in a format."""
    return markdown([(key, key.replace("_", " "), form) for key, form in forms.items()], table.to_dict("records"))


def _means(table: pd.DataFrame, first: dict[str, str]) -> str:
    """Means over clouds by method, in the order of the first column."""
    groups = table.groupby("method")
    means = groups.mean(numeric_only=True).assign(clouds=groups.size()).sort_values(next(iter(first)))
    return _shown(means.reset_index(), {"method": ""} | first | MEANS)


def _wide(table: pd.DataFrame, index: str, keys: list[str], value: str, form: str) -> str:
    """Means of a column, with a row for each ``index`` and a column for each combination of ``keys``."""
    groups = table.groupby([index, *keys], sort=False)[value].mean().unstack(keys, sort=False).sort_index(axis=1)
    names = [" / ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in np.atleast_1d(name)) for name in groups]
    rows = groups.set_axis(names, axis=1).dropna(how="all").reset_index().to_dict("records")
    return markdown([(index, index, ""), *((name, name, form) for name in names)], rows)


def _best(table: pd.DataFrame) -> str:
    """Total error in percent and RMSE in metres of OST, beside the smallest of the other methods."""
    found, columns = pd.DataFrame(index=table["cloud"].unique()), [("index", "cloud", "")]
    for key, title, form in (("total", "total error, OST", ".2f"), ("rmse", "terrain RMSE, OST", ".3f")):
        wide = table.set_index(["cloud", "method"])[key].unstack().dropna(how="all")
        found[key] = wide.pop("ost")
        found[f"{key}_best"] = wide.apply(lambda row: f"{row.min():{form}} ({row.idxmin().upper()})", axis=1)  # noqa: B023
        columns += [(key, title, form), (f"{key}_best", "best", "")]
    return markdown(columns, found.dropna(how="all").reset_index().to_dict("records"))
