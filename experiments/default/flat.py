"""How flat the constants of OST are: its fields, the fields of its rules, and the numbers of the steps that only it uses.

    python experiments/default/flat.py

Each is varied alone, by factors around its default, on small clouds. Writes ``results/flat.csv``, ``flat.png`` and ``flat.md``.
Rows of a cloud are kept, and not made again while the labels of OST and the defaults stay.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import hashlib
import inspect
import itertools
import math
import sys
import time
import warnings
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import jax
import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.default.rules import kept
from experiments.defaults.table import origins
from experiments.isprs import samples, search
from experiments.remake import SCENES, word
from experiments.report import Column, Row, markdown, save_png, write_page
from experiments.scenes import clouds
from experiments.scenes.measures import MEASURES
from jaxfilter.core.compilation import keep_compilations
from jaxfilter.core.params import declared
from jaxfilter.steps.rules import RULES, plants
from jaxfilter.surveys.tiles import part_of

FACTORS = 0.5, 2.0, 0.71, 1.41
FLAT = 0.1
"""Percentage points that a constant may move each mean by, where it is called flat."""
SIDE, MOST = 120.0, 120_000
"""Metres along a side of the middle of tiles and scenes that is taken; less if that has more points."""
CUT = "tiles", "hard tiles", "scenes", "sensors"
CLOUDS = (
    "samp23", "samp24", "samp41", "samp53", "geo1101_Biesbosch_manual", "geo1101_Delft_manual",
    "ign_77050_627755", "lasR_bcts_2", "ign_mnx_corse", "lidrtut_atlantic", "coast 2", "gorge 2", "vineyard 2",
    "canopy 2", "halls: density 1.0, roof levels, place corner, seed 100",
    "dikes: density 0.5, height 3.0, width 5.0, slope 0.67", "sparse forests: density 0.05, share 10, seed 101",
    "sparse forests: density 0.2, share 5, seed 101", "water: scene road over river, density 2.0",
    "water: scene viaduct, density 2.0", "water: scene lake with an islet, density 2.0",
    "water: scene boats, reeds and a weir, density 2.0", "sensors: scene image matching, town, seed 101",
    "sensors: scene image matching, hills, seed 101", "sensors: scene drone lidar, forest, seed 101",
)  # fmt: skip
"""Of ``experiments/scenes/clouds.py``, by name."""
NUMBERS = {
    "jaxfilter.methods.ost": "SLOPE_PASSES FIRST_SLOPE LEVEL LOW_SHARE LEAST_LOW TESTED SHEET_TOLERANCE",
    "jaxfilter.steps.outliers": "LOW_DEPTH SCATTER", "jaxfilter.steps.objects": "FURTHER EVEN MOST",
    "jaxfilter.steps.seeds": "VEILED ABOVE", "jaxfilter.steps.rules.plants": "BESIDE STEEP PLANT_CELL",
    "jaxfilter.steps.ground_rules": "STEEPEST", "jaxfilter.steps.crowd": "_SIDE _SHEET",
}  # fmt: skip
"""Numbers of the steps, by module."""
SENSED_ONLY = "SHEET_TOLERANCE", "_SIDE", "_SHEET"
"""Numbers that count for other sensors and dense clouds only."""
BELOW = {"MOST": 1.0, "VEILED": 1.0, "steady": 1.0, "thin": 1.0, "higher": 1.0, "STEEPEST": 90.0}
"""Shares, and an angle, that stay below this; the limits of fields of OST are known."""


@cache
def said(module: str) -> dict[str, str]:
    """What is written below assignments in a module, and in its classes, by name."""
    found = {}
    for owner in ast.walk(ast.parse(inspect.getsource(import_module(module)))):
        for node, text in itertools.pairwise(owner.body if isinstance(owner, ast.Module | ast.ClassDef) else []):
            if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(text, ast.Expr):
                names = (name.id for name in ast.walk(node) if isinstance(name, ast.Name))
                found |= dict.fromkeys(names, " ".join(ast.literal_eval(text.value).split()))
    return found


class Constant(NamedTuple):
    """A number of the method.

    Attributes:
        owner: "OST", a rule by name, or a module. pick: which number of a tuple.
        default: zero where it follows from the points. about: what it is, in which unit, and why.
    """

    owner: str
    name: str
    default: float
    about: str
    pick: int | None = None

    @property
    def title(self) -> str:
        """As the tables call it."""
        own = self.name if self.owner == "OST" else f"{self.owner.rpartition('.')[2]}.{self.name}"
        return own if self.pick is None else f"{own}[{self.pick}]"

    def scaled(self, method: jf.Filter, factor: float) -> float | None:
        """The value in this method times the factor; None where that is not allowed."""
        default = getattr(method, self.name) if self.owner == "OST" else self.default
        value = type(default)(round(default * factor) if isinstance(default, int) else default * factor)
        if value >= BELOW.get(self.name, math.inf):
            return None
        try:
            return value if self.owner != "OST" or method.replace(**{self.name: value}) else None
        except jf.ParameterError:
            return None

    def result(self, method: jf.Filter, cloud: jf.PointCloud, value: float) -> jf.FilterResult:
        """What the method gives with this value."""
        with contextlib.ExitStack() as stack:
            if self.owner == "OST":
                method = method.replace(**{self.name: value})
            elif self.owner in RULES:
                rule, new = RULES[self.owner], {self.name: value}
                if self.pick is not None:
                    every = enumerate(getattr(rule, self.name))
                    new = {self.name: tuple(value if i == self.pick else v for i, v in every)}
                stack.enter_context(mock.patch.dict(RULES, {self.owner: dataclasses.replace(rule, **new)}))
            else:
                before = getattr(import_module(self.owner), self.name)
                loaded = [module for name, module in sys.modules.items() if name.startswith("jaxfilter.")]
                for module in loaded:  # also those that have imported it
                    if getattr(module, self.name, None) is before:
                        stack.enter_context(mock.patch.object(module, self.name, type(before)(value)))
                for function in (plants.hidden, plants.standing) if self.name == "ABOVE" else ():
                    stack.enter_context(mock.patch.object(function, "__defaults__", (value,)))
                if self.name == "STEEPEST":  # it is compiled in
                    jax.clear_caches()
                    stack.callback(jax.clear_caches)
                if self.owner == "jaxfilter.methods.ost":
                    method = jf.OST.for_cloud(cloud)
            return method(cloud, workers=1)


def constants() -> list[Constant]:
    """All that are varied: fields of OST and of its rules, and :data:`NUMBERS`."""
    known, found = origins(), []
    for field in declared(jf.OST):
        if field.name not in ("sensor", "rules"):
            unit, origin = field.metadata["unit"], known["ost", field.name].partition(" (")[0]
            about = f"{unit and unit + ': '}{field.metadata['doc']}; {origin}"
            found.append(Constant("OST", field.name, field.default or 0.0, about))
    for name, rule in RULES.items():
        texts = said(type(rule).__module__)
        for key, value in vars(rule).items():
            some = enumerate(value) if isinstance(value, tuple) else [(None, value)]
            found += [Constant(name, key, one, texts[key], pick) for pick, one in some]
    for module, names in NUMBERS.items():
        for name in names.split():
            value, about = getattr(import_module(module), name), said(module)[name]
            found.append(Constant(module, name, value if isinstance(value, int) else float(value), about))
    return found


def work(cloud: clouds.Cloud) -> list[Row]:
    """A row for each constant and factor: errors of labels, of terrain, and of areas of decks and water, percent."""
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    start, site, rows = time.process_time(), cloud.make(), []
    if cloud.kind in CUT:
        xy = site.cloud.coordinates()[:, :2]
        side = min(SIDE, math.sqrt(MOST / len(xy) * float(np.ptp(xy, axis=0).prod())))
        left = np.flatnonzero((np.abs(xy - (xy.min(axis=0) + xy.max(axis=0)) / 2) <= side / 2).all(axis=1))
        site = clouds.Site(site.name, site.group, part_of(site.cloud, left), site.ground[left], site.scored[left])
    method = jf.OST.for_cloud(site.cloud)
    first = method(site.cloud, workers=1)
    found = {labels_of(first): measured(site, first)}
    for constant in constants():
        idle = constant.owner in RULES and method.sensor not in RULES[constant.owner].SENSORS
        if idle or (constant.name in SENSED_ONLY and cloud.kind != "sensors"):
            continue
        head = {"constant": constant.title}
        rows.append(head | {"factor": 1.0} | found[labels_of(first)])
        alike = True
        for factor in FACTORS:  # where neither half nor double changes a label, nothing between is run
            value = constant.scaled(method, factor)
            if value is not None:
                between = alike and factor in FACTORS[2:]
                result = first if between else constant.result(method, site.cloud, value)
                if (labels := labels_of(result)) not in found:
                    found[labels] = measured(site, result)
                rows.append(head | {"factor": factor} | found[labels])
            alike = alike and value is not None and labels == labels_of(first)
    print(f"{cloud.name}: {time.process_time() - start:.0f} s of a processor", file=sys.stderr, flush=True)
    return rows


def labels_of(result: jf.FilterResult) -> bytes:
    """All labels."""
    return b"".join(np.asarray(one).tobytes() for one in (result.ground, result.deck, result.water))


def measured(site: clouds.Site, result: jf.FilterResult) -> Row:
    """Total error, cells whose terrain is off, and 1 - F1 of areas of decks and water, percent."""
    row = MEASURES["errors"](site, "ost", result)[0]
    found = {key: row.get(key, math.nan) for key in ("total", "off")}
    if site.area is not None:
        areas = MEASURES["water"](site, "ost", result)[0]
        found |= {f"{name} by area": 100 * (1 - areas[f"{name}_f1"]) for name in ("deck", "water")}
    return {key: round(value, 4) for key, value in found.items()}


def moved(table: pd.DataFrame) -> pd.DataFrame:
    """By constant, factor and kind of cloud how much means change, points: total error, areas of decks and water
    ("what" is ""), and cells whose terrain is off ("terrain")."""
    keys = ["total", "off", "deck by area", "water by area"]
    table = table.reindex(columns=[*table, *(key for key in keys if key not in table)])
    first = table[table["factor"] == 1].drop_duplicates("cloud").set_index("cloud")[keys]
    table[keys] -= first.loc[table["cloud"]].to_numpy()
    parts = []
    for key in keys:
        part = table.assign(kind=key) if key in ("deck by area", "water by area") else table
        means = part.groupby(["constant", "factor", "kind"])[key].mean().dropna().rename("change").reset_index()
        parts.append(means.assign(what="terrain" if key == "off" else ""))
    return pd.concat(parts)


def draw(changes: pd.DataFrame, path: Path) -> None:
    """A panel for each constant."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    every, across, groups = constants(), 8, list(dict.fromkeys(changes["kind"]))
    down = math.ceil(len(every) / across)
    figure = Figure(figsize=(1.75 * across, 1.5 * down))
    axes = figure.subplots(down, across, sharex=True, sharey=True).ravel()
    for axis, constant in zip(axes, every, strict=False):
        axis.axhspan(-FLAT, FLAT, color="#e6e6e6", linewidth=0)
        own = changes[changes["constant"] == constant.title]
        for (group, what), line in own.groupby(["kind", "what"]):
            style = {"linestyle": ":", "linewidth": 1.0} if what else {"marker": "o", "markersize": 2, "linewidth": 1.2}
            axis.plot(np.log2(line["factor"]), line["change"], color=f"C{groups.index(group)}", **style)
        axis.set_title(constant.title, fontsize=7, pad=2)
        axis.set_yscale("symlog", linthresh=FLAT, linscale=0.6)
        axis.set_ylim(-15, 60)
        axis.set_yticks([-10, -1, 0, 1, 10], ["-10", "-1", "0", "1", "10"])
        axis.set_xticks([-1, 0, 1], ["1/2", "1", "2"])
        axis.tick_params(labelsize=6.5, length=2)
        axis.minorticks_off()
        axis.spines[["top", "right"]].set_visible(False)
    for axis in axes[len(every) :]:
        axis.set_axis_off()
    handles = [Line2D([], [], color=f"C{n}", label=group) for n, group in enumerate(groups)]
    handles += [Line2D([], [], color="black", linestyle=":", label="cells off by > 0.5 m")]
    figure.legend(handles=handles, loc="upper center", ncol=9, fontsize=7.5, frameon=False)
    figure.supxlabel("times the default", fontsize=8)
    figure.supylabel("percentage points above the default", fontsize=8)
    figure.tight_layout(rect=(0, 0, 1, 0.98), h_pad=0.5, w_pad=0.4)
    save_png(figure, path, 110)


def page(changes: pd.DataFrame, names: list[str]) -> str:
    """The table as Markdown."""
    table: list[Row] = []
    for constant in constants():
        own = changes[(changes["constant"] == constant.title) & (changes["factor"] != 1)]
        largest = own.groupby("factor")["change"].agg(lambda values: values.abs().max())
        flat = [1.0, *largest.index[largest <= FLAT]]
        low, high = min(flat), max(flat)
        row: Row = {
            "constant": f"`{constant.title}`", "value": f"{constant.default:.4g}" if constant.default else "–",
            "about": constant.about.rstrip("."), "flat": f"{low:g} to {high:g}", "most": 0.0, "where": "–",
        }  # fmt: skip
        if any(largest[(largest.index > low) & (largest.index < high)] > FLAT):
            row["flat"] = "at places only"
        if len(own) and largest.max() > 0:
            most = own.iloc[own["change"].abs().argmax()]
            what = [most["kind"], *[most["what"]] * bool(most["what"]), f"at {most['factor']:g}"]
            row |= {"most": most["change"], "where": ", ".join(what)}
        table.append(row)
    columns: list[Column] = [
        ("constant", "constant", ""), ("value", "default", ""), ("about", "unit and reason", ""),
        ("flat", f"within {FLAT}, times", ""), ("most", "largest change, points", "+.2f"), ("where", "where", ""),
    ]  # fmt: skip
    good = sum(abs(row["most"]) <= FLAT for row in table)
    steep = ", ".join(f"{row['constant']} ({row['where']})" for row in table if abs(row["most"]) > 1)
    return "\n\n".join([
        "# OST: how flat its constants are",
        f"Each constant is multiplied by {', '.join(f'{f:g}' for f in sorted(FACTORS))}, one at a time, all others as they are. "
        "The picture shows by how much means change: total error (lines), cells of 1 m whose terrain is off by more than 0.5 m "
        "(dots), and for decks and water one less F1 by area, percentage points, each kind of cloud on its own. The grey band is "
        f"{FLAT} points on either side; beyond it the scale is logarithmic. Shares stay below one. A constant of a rule is "
        "varied where the rule is for the sensor; `SHEET_TOLERANCE` and those of `crowd` on the clouds of other sensors.",
        "![Changes of total error and terrain error by factor, a panel for each constant](flat.png)",
        f"{good} of {len(table)} constants move no mean by more than {FLAT} points, from half to double. These move one by more "
        f"than 1 point: {steep or 'none'}. The clouds are small, so single decks, ponds and faces show in the means; steep "
        "terrain rests on one tile. Not varied: how many cells around a cell are looked at, which is fixed in compiled code; and "
        "what tells the sensor.",
        markdown(columns, table),
        f"Clouds: {', '.join(names)}. Of tiles, scenes and sensors the middle {SIDE:g} m, or as much as has {MOST:,} points.",
    ])  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    """Vary all constants, draw, and write the page."""
    options = search.options(__file__, __doc__, arguments)
    path, defaults = options.out / "flat.csv", repr([(constant.title, constant.default) for constant in constants()])
    now = f"{word('ost')}-{word(SCENES)}-{hashlib.blake2b(defaults.encode(), digest_size=3).hexdigest()}"
    wanted = options.only or CLOUDS
    known = {one.name: (one, now) for one in clouds.every(samples.data_folder(options.data)) if one.name in wanted}
    rows = kept(path, work, known, options.processes)
    changes = moved(pd.DataFrame(rows))
    draw(changes, options.out / "flat.png")
    write_page(options.out / "flat.md", page(changes, [*known]), options.command, ("ost", SCENES), keeps=True)
    print(f"results are in {options.out}")


if __name__ == "__main__":
    main()
