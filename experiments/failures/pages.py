"""Tables of what the parts of this experiment have measured."""

from __future__ import annotations

import pandas as pd

from experiments.report import Column, Row, markdown

KINDS = ("tiles", "hard tiles", "scenes")


def page(tables: dict[str, list[Row]]) -> str:
    """All tables as Markdown, of the parts that have rows."""
    text = ["# Where methods fail", ""]
    makers = {"measures": measures, "cuts": cuts, "places": places, "spots": spots}
    for part, rows in tables.items():
        if rows:
            text += makers[part](pd.DataFrame(rows))
    return "\n".join(text).rstrip()


def measures(table: pd.DataFrame) -> list[str]:
    """Means over each kind of cloud, and single hard tiles and scenes."""
    columns: list[Column] = [
        ("method", "method", ""), ("clouds", "clouds", "d"), ("total", "TE", ".2f"), ("kappa", "kappa", ".1f"),
        ("rmse", "RMSE, m", ".3f"), ("middle", "its median", ".3f"), ("p95", "95 %, m", ".2f"), ("off", "> 0.5 m", ".2f"),
        ("off_1m", "> 1 m", ".2f"), ("high_1m", "too high", ".2f"), ("low_1m", "too low", ".2f"),
        ("border_off_1m", "> 1 m at the border", ".2f"), ("inside_off_1m", "inside", ".2f"),
    ]  # fmt: skip
    text = [
        "## Errors of labels and of terrain", "",
        "Every method as `for_cloud(cloud)` gives it. Total error and kappa in percent; terrain models on cells of 1 m within "
        "3 m of reference ground, percent of the cells that are off by more than 0.5 and 1 m, those by more than 1 m up and down "
        "apart, and in the 20 m along the border of the data and inside. Outside the hull of its ground a model is as high as at "
        "the nearest ground point. Means over clouds.", "",
    ]  # fmt: skip
    for kind in KINDS:
        part = table[table["kind"] == kind]
        if len(part):
            groups = part.groupby("method", sort=False)
            means = groups.mean(numeric_only=True).assign(clouds=groups.size(), middle=groups["rmse"].median())
            text += [f"### {kind.capitalize()}", "", markdown(columns, _records(means.sort_values("total"))), ""]
    for key, title in (
        ("total", "Total error, %"),
        ("off", "Cells off by more than 0.5 m, %"),
        ("type1", "Ground lost, %"),
    ):
        single = table[table["kind"] != "tiles"]
        if len(single):
            text += [f"### {title}", "", _wide(single, key), ""]
    return text


def cuts(table: pd.DataFrame) -> list[str]:
    """What cuts spoil, over all cuts of a kind of cloud."""
    columns: list[Column] = [
        ("method", "method", ""), ("kind", "clouds", ""), ("cuts", "cuts", "d"), ("cells", "cells", ",.0f"),
        ("off", "off, %", ".2f"), ("off_whole", "in the whole, %", ".2f"), ("spoiled", "spoiled, %", ".2f"),
        ("spoiled_high", "too high, %", ".2f"), ("points", "points", ",.0f"), ("wrong", "wrong, %", ".2f"),
        ("wrong_whole", "in the whole, %", ".2f"), ("spoiled_points", "spoiled, %", ".2f"),
    ]  # fmt: skip
    rows: list[Row] = []
    for method, own in table.groupby("method", sort=False):
        for kind in (*KINDS, "all"):
            part = own if kind == "all" else own[own["kind"] == kind]
            if not len(part):
                continue
            counts = part.apply(pd.to_numeric, errors="coerce").sum()
            row: Row = {
                "method": method,
                "kind": kind,
                "cuts": len(part),
                "cells": counts["cells"],
                "points": counts["rim_points"],
            }
            row |= {key: 100 * counts[key] / counts["cells"] for key in ("off", "off_whole", "spoiled", "spoiled_high")}
            keys = ("wrong", "wrong_whole", "spoiled_points")
            rows.append(row | {key: 100 * counts[key] / counts["rim_points"] for key in keys})
    return [
        "## Cuts", "",
        "Half planes and turned squares at random places of the clouds, the same for all methods. Cells of 1 m and points within "
        "20 m of the cut: those that are off by more than 1 m, or wrong, after the cut and in the whole cloud; *spoiled* are "
        "those that were right in the whole.", "", markdown(columns, rows), "",
    ]  # fmt: skip


def places(table: pd.DataFrame) -> list[str]:
    """Means over samples at each place, and how far single samples move."""
    columns: list[Column] = [
        ("method", "method", ""), ("places", "places", "d"), ("total", "TE", ".2f"), ("kappa", "kappa", ".1f"),
        ("least", "least", ".2f"), ("largest", "largest", ".2f"), ("deviation", "deviation", ".3f"),
        ("range", "largest range of a sample", ".2f"), ("sample", "which", ""),
    ]  # fmt: skip
    rows: list[Row] = []
    for method, part in table.groupby("method", sort=False):
        means = part.groupby("place")["total"].mean()
        ranges = part.groupby("cloud")["total"].agg(lambda v: v.max() - v.min())
        rows.append({
            "method": method, "places": len(means), "total": means.mean(), "kappa": part["kappa"].mean(), "least": means.min(),
            "largest": means.max(), "deviation": means.std(), "range": ranges.max(), "sample": str(ranges.idxmax()),
        })  # fmt: skip
    return [
        "## Places of the grid", "",
        f"The {table['cloud'].nunique()} ISPRS samples, their points shifted by random vectors within 1 km, grids from zero, the "
        "same for all methods: mean total error and kappa, least and largest mean, standard deviation of the means, and the "
        "sample whose error moves most. Percent.", "", markdown(columns, rows), "",
    ]  # fmt: skip


def spots(table: pd.DataFrame) -> list[str]:
    """What named places hold, over all clouds of a kind, and of each cloud with much that is off."""
    columns: list[Column] = [
        ("method", "method", ""), ("kind", "clouds", ""), ("off", "off, m2", ",.0f"), ("found", "of it named, %", ".0f"),
        ("judged", "places", ",.0f"), ("hit", "that hold some, %", ".0f"), ("tenths", "a tenth, %", ".0f"),
        ("times", "named area / off", ".2f"), ("whole", "all named / off", ".2f"), ("volume", "expected, m3", ",.0f"),
        ("volume_true", "true, m3", ",.0f"),
    ]  # fmt: skip
    rows: list[Row] = []
    for method, own in table.groupby("method", sort=False):
        for kind in (*KINDS, "all three", "samples"):
            part = own[own["kind"] != "samples"] if kind == "all three" else own[own["kind"] == kind]
            if len(part):
                rows.append({"method": method, "kind": kind, **shares(part.sum(numeric_only=True))})
    single: list[Row] = [
        {"method": row["cloud"], "kind": row["first"], **shares(pd.Series(row))}
        for row in _records(table)
        if row["off"] >= 200
    ]
    one: list[Column] = [("method", "cloud", ""), ("kind", "first place", ""), *columns[2:]]
    return [
        "## Named places", "",
        "Area off: cells of 1 m within 3 m of reference ground whose terrain is off by more than 0.5 m. A place is right if it "
        "holds some of it (or a tenth of its own area); places without any cell near reference ground are not judged. Named "
        "area: its cells near reference ground, and all of it. Volumes: of cells near reference ground in places. Weights were "
        "fitted to the tiles, hard tiles and scenes, and limits chosen on them; samples were looked at, and not fitted to.", "",
        markdown(columns, rows), "", "Clouds with 200 m2 or more that are off:", "", markdown(one, single), "",
    ]  # fmt: skip


def shares(counts: pd.Series) -> Row:
    """Figures of :func:`spots` from sums over clouds."""
    off, judged = max(float(counts["off"]), 1.0), max(float(counts["judged"]), 1.0)
    return {
        "off": counts["off"], "found": 100 * counts["off_named"] / off, "judged": counts["judged"],
        "hit": 100 * counts["right"] / judged, "tenths": 100 * counts["tenth"] / judged, "times": counts["named"] / off,
        "whole": counts["area"] / off, "volume": counts["volume"], "volume_true": counts["volume_true"],
    }  # fmt: skip


def _records(table: pd.DataFrame) -> list[Row]:
    """Rows as mappings, with the index as a column."""
    return [{str(key): value for key, value in row.items()} for row in table.reset_index().to_dict("records")]


def _wide(table: pd.DataFrame, key: str) -> str:
    """A row per cloud, a column per method, and the smallest figure."""
    wide = table.assign(**{key: pd.to_numeric(table[key], errors="coerce")}).pivot_table(
        index="cloud", columns="method", values=key, sort=False
    )
    best = wide.idxmin(axis=1)
    columns: list[Column] = [("cloud", "cloud", ""), *((name, name, ".2f") for name in wide), ("best", "smallest", "")]
    return markdown(columns, _records(wide.assign(best=best)))
