"""The page of results: a section for each kind of cloud, and for cuts, water and named places."""

from __future__ import annotations

import pandas as pd

from experiments.report import Column, Row, markdown

LABELLED = ("tiles", "hard tiles", "scenes")
MEANS: list[Column] = [
    ("clouds", "clouds", "d"), ("total", "TE", ".2f"), ("kappa", "kappa", ".1f"), ("rmse", "RMSE, m", ".3f"),
    ("p95", "95 %, m", ".2f"), ("off", "> 0.5 m", ".2f"), ("off_1m", "> 1 m", ".2f"), ("high_1m", "too high", ".2f"),
    ("low_1m", "too low", ".2f"), ("border_off_1m", "> 1 m at the border", ".2f"), ("inside_off_1m", "inside", ".2f"),
]  # fmt: skip
"""What is shown of every kind of cloud, in the mean."""
SINGLE = {"total": "Total error, %", "rmse": "Terrain RMSE, m", "off": "Cells off by more than 0.5 m, %"}
"""What is shown of every single cloud of some kinds."""
HEAD = """# Tiles, scenes, and single situations

Every method as `for_cloud(cloud)` gives it. Means over clouds: total error (TE) and kappa in percent; terrain models on cells of
1 m within 3 m of reference ground, percent of the cells that are off by more than 0.5 and 1 m, those by more than 1 m up and down
apart, and in the 20 m along the border of the data and inside. Outside the hull of its ground a model is as high as at the nearest
ground point. A dash stands where a method has failed, or has no terrain."""
WORDS = {
    "scenes": "Scenes at 0.5, 2 and 8 pulses per m2, in strips of 250 m. No constant was chosen on them, but two rules of OST had "
    "the jungle in view.",
    "sensors": "Scenes as cameras, drones and cars see them, and real clouds. The terrain of spanner_UAS is held against the ground "
    "of spanner_ALS; rf4pcc_test and sea_cliff have no labels. The scenes, odmsem3d_brighton_small and spanner_UAS were in view "
    "when the limits of OST were set.",
    "drawn anew": "Means over two other seeds of the scenes of sensors. They were drawn after the limits had been set; one "
    "alternative was turned down with them in view.",
    "halls": "Halls of 70 to 140 m, 5.5 to 12 m high, on gentle terrain with trees; no method is told how large buildings are. The "
    "first columns say what share of the points of halls becomes ground, of how many halls more than half does, and what share of "
    "the ground is lost, percent. OST's rules for halls were made with halls of 2 per m2 in view.",
    "dikes": "Dikes of earth across a plain with plants, 3 and 8 m high. The first columns say what share of the ground of crests "
    "is lost, how many dikes lose more than half of it, and what share of the plants becomes ground, percent. OST's rule for "
    "embankments was made with such dikes in view.",
    "water": "Scenes 200 m wide, of a seed that was not looked at while the rules of OST were chosen. Areas are cells of 1 m: a deck "
    "is where the nearest point, within 1.5 spacings, is marked; water is where a body is, voids included. Water without echoes has "
    "no surface to hold the terrain to. Under a wide deck there are no points, and the model goes across between its abutments.",
    "cuts": "Half planes and turned squares at random places of clouds, the same for both methods. Cells of 1 m within 20 m of a cut "
    "that are off by more than 1 m, after it and in the whole cloud, percent; *spoiled* are those that were right in the whole.",
    "places": "Area off: cells of 1 m within 3 m of reference ground whose terrain, by OST, is off by more than 0.5 m. A place holds "
    "some if one of its cells is off. Places without any cell near reference ground are not judged. Weights were fitted to the "
    "tiles, hard tiles and scenes, and limits chosen on them; samples were looked at, and not fitted to.",
}
"""What stands above tables, by kind of cloud or measure."""


def page(tables: dict[str, list[Row]]) -> str:
    """All tables as Markdown, of what has rows."""
    frames = {name: _frame(rows) for name, rows in tables.items() if rows}
    text = [HEAD]
    for kind, table in frames.pop("errors", pd.DataFrame({"kind": []})).groupby("kind", sort=False):
        text += [f"## {str(kind).capitalize()}", WORDS.get(str(kind), ""), *errors(str(kind), table)]
    for name, make in (("water", water), ("cuts", cuts), ("places", places)):
        if name in frames:
            text += [
                f"## {'Named places' if name == 'places' else name.capitalize()}",
                WORDS[name],
                *make(frames[name]),
            ]
    return "\n\n".join(part for part in text if part)


def errors(kind: str, table: pd.DataFrame) -> list[str]:
    """Means by method, and what else the kind of cloud asks for."""
    if kind == "halls":
        table = table.assign(most=100 * (table["hall"] > 50))
        first: list[Column] = [("hall", "hall", ".1f"), ("most", "halls", ".0f"), ("type1", "lost ground", ".1f")]
        parts = [_by(table, key, "hall") for key in ("place", "roof", "density")]
        return [_means(table, first), "### Points of halls that become ground, %", *map(_wide, parts)]
    if kind == "dikes":
        table = table.assign(crest=100 - table["crest"], most=100 * (table["crest"] < 50))
        first = [("crest", "crest", ".1f"), ("most", "dikes", ".0f"), ("type2", "plants", ".1f")]
        parts = [_by(table, ["width", "slope"], "crest"), _by(table, "density", "crest")]
        return [_means(table, first), "### Crests that are lost, %, by width and slope", *map(_wide, parts)]
    if kind == "drawn anew":
        groups = table.groupby(["scene", "method"], sort=False)[list(SINGLE)]
        table = groups.agg(lambda v: v.mean(skipna=False)).reset_index().rename(columns={"scene": "cloud"})
    text = [] if kind in ("sensors", "drawn anew") else [_means(table)]
    if kind == "sensors":
        text += ["### Beside the best of the other methods", _best(table)]
    if kind == "drawn anew":
        text += ["### Beside the best, drawn anew", _best(table)]
    more = {"scenes": {"type1": "Ground lost, %"}, "sensors": {"called": "Points called ground, %"}}.get(kind, {})
    for key, title in (SINGLE | more).items() if kind != "tiles" else ():
        text += [f"### {title}, {kind}", _wide(_by(table, "cloud", key).T, ".3f" if key == "rmse" else ".2f")]
    return text


def water(table: pd.DataFrame) -> list[str]:
    """Decks and water that OST finds."""
    columns: list[Column] = [
        ("scene", "scene", ""), ("density", "points/m2", ".1f"), ("deck_f1", "deck, F1", ".2f"),
        ("deck_wrong", "no deck, m2", ",.0f"), ("water_f1", "water, F1", ".2f"), ("water_wrong", "no water, m2", ",.0f"),
        ("off", "> 0.5 m", ".2f"),
    ]  # fmt: skip
    text = [markdown(columns, table[table["kind"] == "water"].to_dict("records"))]
    if "water_points" in table:
        heading: list[Column] = [("cloud", "tile", "")]
        heading += [(f"{w}_{k}", f"{w}, {k}", ",.0f") for w in ("water", "deck") for k in ("points", "marked", "both")]
        tiles = table[table["water_points"] + table["deck_points"] > 0].to_dict("records")
        text += ["### Points of water and decks in tiles with classes 9 and 17", markdown(heading, tiles)]
    return text


def cuts(table: pd.DataFrame) -> list[str]:
    """What cuts spoil, over all cuts of a kind of cloud."""
    columns: list[Column] = [
        ("method", "method", ""),
        ("kind", "clouds", ""),
        ("cuts", "cuts", "d"),
        ("cells", "cells", ",.0f"),
    ]
    shown = [("off", "off", ".2f"), ("off_whole", "in the whole", ".2f"), ("spoiled", "spoiled", ".2f")]
    groups = table.groupby(["method", "kind"], sort=False)
    sums = groups.sum(numeric_only=True).assign(cuts=groups.size())
    shares = sums[[key for key, _, _ in shown]].mul(100 / sums["cells"], axis=0)
    return [markdown([*columns, *shown], sums[["cuts", "cells"]].join(shares).reset_index().to_dict("records"))]


def places(table: pd.DataFrame) -> list[str]:
    """What named places hold, over all clouds of a kind, and of each cloud with 200 m2 or more that are off."""
    columns: list[Column] = [
        ("kind", "clouds", ""), ("found", "of the area off, named, %", ".0f"), ("hit", "places that hold some, %", ".0f"),
        ("tenths", "a tenth of their area, %", ".0f"), ("times", "named area / area off", ".2f"),
    ]  # fmt: skip
    further: list[Column] = [
        ("off", "off, m2", ",.0f"), ("judged", "places", ",.0f"), ("volume", "expected, m3", ",.0f"),
        ("volume_true", "true, m3", ",.0f"),
    ]  # fmt: skip
    sums = table.groupby("kind", sort=False).sum(numeric_only=True)
    sums.loc["all but samples"] = sums.drop(index="samples", errors="ignore").sum()
    single = table[table["off"] >= 200].set_index("cloud")
    rows, singles = ([held(row) for _, row in part.iterrows()] for part in (sums, single))
    return [
        markdown(columns, rows), "### Areas and volumes of named places", markdown([columns[0], *further], rows),
        "### Named places of single clouds", markdown([*columns, *further], singles),
    ]  # fmt: skip


def held(counts: pd.Series) -> Row:
    """Shares of :func:`places` from counts."""
    off, judged = counts["off"] or 1, counts["judged"] or 1
    found, hit, tenths = (
        100 * counts[key] / of for key, of in (("off_named", off), ("right", judged), ("tenth", judged))
    )
    shares = {"found": found, "hit": hit, "tenths": tenths, "times": counts["named"] / off}
    return {"kind": counts.name} | {key: counts[key] for key in ("off", "judged", "volume", "volume_true")} | shares


def _frame(rows: list[Row]) -> pd.DataFrame:
    """A table in which what is absent is NaN."""
    return pd.DataFrame([{key: value for key, value in row.items() if value != ""} for row in rows])


def _means(table: pd.DataFrame, first: list[Column] = []) -> str:  # noqa: B006
    """Means over clouds by method, in the order of the first column, or of total errors."""
    groups = table.groupby("method")
    means = groups.mean(numeric_only=True).assign(clouds=groups.size()).sort_values(first[0][0] if first else "total")
    return markdown([("method", "method", ""), *first, *MEANS], means.reset_index().to_dict("records"))


def _by(table: pd.DataFrame, key: str | list[str], value: str) -> pd.DataFrame:
    """Means of a column, methods by ``key``."""
    return table.pivot_table(index="method", columns=key, values=value, sort=False).sort_index()


def _wide(table: pd.DataFrame, form: str = ".0f") -> str:
    """A table with all its columns."""
    table = table.rename(columns=lambda name: f"{name:g}" if isinstance(name, float) else str(name))
    table.columns = [" / ".join(map(str, name)) if isinstance(name, tuple) else name for name in table.columns]
    columns: list[Column] = [(name, name, form) for name in table]
    rows = table.rename_axis(table.index.name or "").reset_index().to_dict("records")
    return markdown([(str(table.index.name), str(table.index.name), ""), *columns], rows)


def _best(table: pd.DataFrame) -> str:
    """Total error and RMSE of OST beside the smallest of the other methods."""
    columns: list[Column] = [("cloud", "cloud", "")]
    parts = []
    for key, name, form in (("total", "TE, %", ".2f"), ("rmse", "RMSE, m", ".3f")):
        wide = _by(table, "cloud", key).T
        others = wide.drop(columns="ost")
        parts.append(
            pd.DataFrame({key: wide["ost"], f"{key}_best": others.min(axis=1), f"{key}_of": others.idxmin(axis=1)})
        )
        columns += [(key, f"{name}: OST", form), (f"{key}_best", "best other", form), (f"{key}_of", "which", "")]
    return markdown(columns, pd.concat(parts, axis=1).reset_index().to_dict("records"))
