"""How flat the constants of OST are that came with borders, cliffs, plants, dense clouds, other sensors, decks and water.

    python experiments/default/flat.py

Each is varied alone, by factors around its default, on small clouds. Writes ``results/flat.csv``, ``flat.png`` and ``flat.md``.
Rows are kept, and not made again unless the labels of OST, or the default, have changed.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import importlib
import math
import statistics
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.defaults.clouds import Known
from experiments.isprs import samples
from experiments.remake import word
from experiments.report import Column, Row, markdown, read_csv, save_png, write_csv, write_page
from experiments.scenes import water as scenes
from experiments.scenes.clouds import FILLED, load
from jaxfilter.core.compilation import keep_compilations
from jaxfilter.steps.sensors import DRONE, MATCHING
from jaxfilter.surveys.tiles import part_of

HERE = Path(__file__).parent
FACTORS = 0.5, 0.71, 1.41, 2.0
FLAT = 0.1
"""Percentage points that a constant may move each mean by, where it is called flat."""
SAMPLES = "samp21", "samp23", "samp24", "samp41", "samp53", "samp71"
TILES = "geo1101_Biesbosch_manual", "geo1101_Delft_manual", "ign_77050_627755", "lasR_bcts_2"
HARD = "ign_mnx_corse", "lidrtut_atlantic"
LAYOUTS = "coast", "gorge", "benches", "vineyard", "canopy"
CROSSED = "road over river", "viaduct", "footbridge", "lake with an islet", "boats, reeds and a weir", "town"
"""Of ``experiments/scenes/water.py``."""
SENSED = ((MATCHING, "town", 60.0, 40.0), (MATCHING, "hills", 60.0, 40.0), (DRONE, "forest", 35.0, 100.0))
"""Sensor, layout, side in metres, and points per square metre."""
SIDE = 120.0
"""Metres along a side of what is cut out of a tile or scene."""
KINDS = {
    "samples": "#3264c8",
    "tiles": "#d2871e",
    "hard tiles": "#b4283c",
    "scenes": "#28825a",
    "decks": "#7846a0",
    "water": "#1ea0b4",
}


class Constant(NamedTuple):
    """A number of the method.

    Attributes:
        subject: what it belongs to. place: "module.NAME" below ``jaxfilter``, or a field of OST.
        pick: keys and indices to it where the place holds several.
        also: modules that have imported the name. sensed: it counts for other sensors and dense clouds only.
    """

    subject: str
    place: str
    pick: tuple[Any, ...] = ()
    also: tuple[str, ...] = ()
    sensed: bool = False

    @property
    def title(self) -> str:
        """As the tables call it."""
        return ".".join([self.place.removeprefix("steps.").removeprefix("methods."), *map(str, self.pick)])

    @property
    def default(self) -> float:
        """Its value now."""
        value = getattr(jf.OST, self.place) if "." not in self.place else getattr(*self._owner())
        for key in self.pick:
            value = value[key]
        return value

    def _owner(self, module: str = "") -> tuple[Any, str]:
        own, _, name = self.place.rpartition(".")
        return importlib.import_module(f"jaxfilter.{module or own}"), name

    def scaled(self, factor: float) -> float | None:
        """The default times the factor; None where that is the default itself, or no share."""
        whole = isinstance(self.default, int)
        value = round(self.default * factor) if whole else float(self.default) * factor
        share = self.place.endswith(
            (".ROOFS", ".WALLS", ".BANKS", ".KNOWN", ".STEADY", ".RISING", ".FALLING", ".STEEPEST_ANGLE")
        )
        most = 90.0 if self.place.endswith(".STEEPEST_ANGLE") else 1.0
        return None if value == self.default or (share and value >= most) else value

    @contextlib.contextmanager
    def at(self, value: float) -> Iterator[dict[str, float]]:
        """With this value; fields that ``for_cloud`` is to be given."""
        if "." not in self.place:
            yield {self.place: value}
            return
        owners = [self._owner(), *(self._owner(module) for module in self.also)]
        before = getattr(*owners[0])
        try:
            for owner, name in owners:
                setattr(owner, name, _replaced(before, self.pick, type(self.default)(value)))
            yield {}
        finally:
            for owner, name in owners:
                setattr(owner, name, before)


def _replaced(value: Any, pick: tuple[Any, ...], new: float) -> Any:
    """A copy of nested dicts and tuples in which one number is another."""
    if not pick:
        return new
    if isinstance(value, dict):
        return value | {pick[0]: _replaced(value[pick[0]], pick[1:], new)}
    return tuple(_replaced(v, pick[1:], new) if i == pick[0] else v for i, v in enumerate(value))


def _of(subject: str, module: str, names: str, **more: Any) -> list[Constant]:
    return [Constant(subject, f"{module}.{name}", **more) for name in names.split()]


CONSTANTS = [
    Constant("low points", "low_points"),
    *_of("low points", "methods.ost", "LOW_DEPTH LOW_SPACINGS"),
    *_of("low points", "steps.outliers", "SCATTER"),
    Constant("voids", "void"),
    *_of("voids", "methods.ost", "VOID_RIM"),
    *_of("borders", "methods.ost", "STEEPEST_ANGLE"),
    *_of("faces at borders", "steps.objects", "FURTHER KNOWN"),
    *_of("steep terrain", "steps.objects", "SMOOTH ROOFS WALLS"),
    *_of("embankments", "steps.objects", "BANK EVEN BANKS"),
    *_of("overhangs", "steps.overhangs", "VOID SHEET_SPREAD"),
    *_of("under plants", "steps.pruning", "VEIL EDGES_AROUND PASSES"),
    *_of("under plants", "methods.ost", "OUT"),
    *_of("decks", "steps.decks", "DROP HIGH NEAR AREA LENGTH STEADY ENDS MOST JOIN LAND"),
    *_of("water", "steps.voids", "VOID_REACH"),
    *_of("water", "steps.water", "FLAT STEP LEVEL_RANGE CORE AREA SLOPING DENSE_AREA DENSE_LEVEL THIN"),
    *_of("water", "steps.water", "RISE RISING FALLING RIM_CELLS"),
    *_of("water", "steps.water", "SURFACE AFLOAT", also=("methods.ost",)),
    *_of("dense clouds", "steps.crowd", "DENSE _SIDE _SHEET", sensed=True),
    *(Constant("other sensors", "methods.ost.SHEET_TOLERANCE", (kind,), sensed=True) for kind in (MATCHING, DRONE)),
    *_of("other sensors", "methods.ost", "THINNEST MATCHED_ROUNDS CLUSTER", sensed=True),
    *(Constant("other sensors", "methods.ost.PITS", (kind, i), sensed=True) for kind in (MATCHING, DRONE) for i in range(2)),
]  # fmt: skip
TRIED = {
    "low points": "53 rules and limits", "voids": "5 rims", "borders": "3 rules", "faces at borders": "9 sets",
    "steep terrain": "40 sets of limits, and 40 of how far distances grow", "embankments": "22 rules and limits",
    "under plants": "about 75 rules and limits",
    "overhangs": "3 voids, 4 sheets, 3 rules",
    "decks": "not counted", "water": "not counted", "dense clouds": "3 squares, 3 sheets",
    "other sensors": "5 multiples of the thickness, 6 numbers of rounds",
}  # fmt: skip
"""How many variants were looked at while each part was made; see docs/filters/ost.md."""


@dataclasses.dataclass(frozen=True, eq=False)
class Small:
    """A small cloud; place: with decks or water whose area is known."""

    known: Known
    place: scenes.Place | None = None
    sensed: bool = False


def clouds(folder: Path) -> Iterator[Small]:
    """Samples, the middle of tiles, and scenes."""
    for name in SAMPLES:
        yield Small(load(folder, name))
    for name in (*TILES, *HARD):
        whole = load(folder, name)
        xy = whole.cloud.coordinates()[:, :2]
        middle = (xy.min(axis=0) + xy.max(axis=0)) / 2
        left = np.flatnonzero((np.abs(xy - middle) <= SIDE / 2).all(axis=1))
        part = part_of(whole.cloud, left)
        yield Small(Known(name, whole.group, part, whole.ground[left], whole.scored[left]))
    for layout in LAYOUTS:
        made = jf.scenes.make(layout, size=(SIDE, SIDE), density=2.0, seed=101, swath=250.0)
        yield Small(Known(layout, "scenes", made.cloud, made.truth, made.cloud.candidate))
    for name in CROSSED:
        place = scenes.place(name, 2.0, scenes.CHECK, SIDE)
        yield Small(Known(name, "scenes", place.cloud, place.truth, place.cloud.candidate), place)
    for sensor, layout, side, density in SENSED:
        made = jf.scenes.make(layout, size=side, density=density, seed=101, sensor=sensor)
        known = Known(f"{sensor}, {layout}", "scenes", made.cloud, made.truth, made.cloud.candidate)
        yield Small(known, sensed=True)


class Unchanged(Exception):
    """No deck and no water body differs from those of the default."""


@contextlib.contextmanager
def kept_steps(kept: dict[str, Any]) -> Iterator[None]:
    """OST with the steps before decks and water as ``kept``, which holds those of the default after its first run.

    Raises: Unchanged from within OST if decks and water are those of the default, so that all labels must be.
    """
    methods = {name: getattr(jf.OST, name) for name in ("scene", "objects", "crossed")}

    def once(name: str) -> Callable[..., Any]:
        def call(*given: Any) -> Any:
            if name not in kept:
                kept[name] = methods[name](*given)
            return kept[name]

        return call

    def crossed(*given: Any) -> Any:
        found = methods["crossed"](*given)
        word = [np.asarray(values).tobytes() for values in found]
        if "crossed" not in kept:
            kept["crossed"] = word
        elif kept["crossed"] == word:
            raise Unchanged
        return found

    try:
        jf.OST.scene, jf.OST.objects, jf.OST.crossed = once("scene"), once("objects"), crossed
        yield
    finally:
        for name, method in methods.items():
            setattr(jf.OST, name, method)


def measured(small: Small, values: dict[str, float], before: Row | None = None) -> Row:
    """Errors of labels, of terrain, and of areas of decks and water, percent; those of ``before`` if no label is another."""
    known, cloud = small.known, small.known.cloud
    try:
        result = jf.OST.for_cloud(cloud, **values)(cloud)
    except Unchanged:
        assert before is not None
        return before
    packed = result.ground.tobytes(), result.deck.tobytes(), result.water.tobytes()
    if before is not None and before["packed"] == packed:
        return before
    found: Row = {"packed": packed, "total": jf.evaluate(result, known.ground, ignore=~known.scored).total}
    found["off"] = jf.dtm_rmse(cloud, result, known.ground, interpolation=FILLED).off
    if small.place is not None:
        place = small.place
        for name, marked, truth in (("decks", result.deck, place.deck), ("water", result.water, place.water)):
            area = scenes.nearest(cloud, marked, place.x, place.y, 1.1)
            found[name] = 100 * (1 - scenes.by_area(area, truth)["f1"]) if truth.any() else math.nan
    return found


def varied(folder: Path, path: Path) -> list[Row]:
    """A row for each constant, factor and cloud; those that are in the file are not made again."""
    now = word("ost")
    kept = {
        (row["constant"], row["factor"], row["cloud"]): row
        for row in (read_csv(path) if path.exists() else [])
        if row["labels"] == now
    }
    rows: list[Row] = []
    start = time.process_time()
    for small in clouds(folder):
        known, base = small.known, None
        steps: dict[str, Any] = {}
        for constant in CONSTANTS:
            if constant.sensed != small.sensed:
                continue
            for factor in (1.0, *FACTORS):
                value = constant.default if factor == 1 else constant.scaled(factor)
                if value is None:
                    continue
                row = kept.get((constant.title, factor, known.name))
                if row is None or not math.isclose(row["value"], value, rel_tol=1e-3):
                    if base is None:
                        with kept_steps(steps):
                            base = measured(small, {})
                    late = kept_steps(steps) if constant.subject in ("decks", "water") else contextlib.nullcontext()
                    with constant.at(value) as fields, late:
                        found = base if factor == 1 else measured(small, fields, base)
                    numbers = {key: round(v, 4) for key, v in found.items() if key != "packed"}
                    row = {
                        "constant": constant.title,
                        "factor": factor,
                        "value": float(f"{value:.4g}"),
                        "cloud": known.name,
                    }
                    row |= {"kind": known.group, "labels": now, **numbers}
                rows.append(row)
        write_csv(path, [*rows, *(row for key, row in kept.items() if key[2] not in {r["cloud"] for r in rows})])
        print(f"{known.name}: {time.process_time() - start:.0f} s", file=sys.stderr, flush=True)
    write_csv(path, rows)
    return rows


def moved(rows: list[Row], constant: Constant) -> dict[str, dict[float, tuple[float, float]]]:
    """By kind of cloud and factor: by how much the means of total error and of terrain differ from those of the default. Areas
    of decks and of water stand in the first of the two."""
    found: dict[str, dict[float, tuple[float, float]]] = {}
    own = [row for row in rows if row["constant"] == constant.title]
    for kind in KINDS:
        keys = (kind, kind) if kind in ("decks", "water") else ("total", "off")
        means = {}
        for factor in (1.0, *FACTORS):
            part = [
                row for row in own if row["factor"] == factor and (kind in ("decks", "water") or row["kind"] == kind)
            ]
            values = [
                [row[key] for row in part if isinstance(row.get(key), int | float) and row[key] == row[key]]
                for key in keys
            ]
            if all(values):
                means[factor] = tuple(statistics.fmean(v) for v in values)
        if 1.0 in means:
            found[kind] = {f: (m[0] - means[1.0][0], m[1] - means[1.0][1]) for f, m in sorted(means.items())}
    return found


def drawn(rows: list[Row], path: Path) -> None:
    """A panel for each constant."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    across = 7
    down = math.ceil((len(CONSTANTS) + 1) / across)
    figure, axes = plt.subplots(down, across, figsize=(2.0 * across, 1.65 * down), sharex=True, sharey=True)
    for axis, constant in zip(axes.flat, CONSTANTS, strict=False):
        axis.axhspan(-FLAT, FLAT, color="#e6e6e6", linewidth=0)
        for kind, by_factor in moved(rows, constant).items():
            x = [math.log2(factor) for factor in by_factor]
            axis.plot(x, [v[0] for v in by_factor.values()], color=KINDS[kind], linewidth=1.2, marker="o", markersize=2)
            if kind not in ("decks", "water"):
                axis.plot(x, [v[1] for v in by_factor.values()], color=KINDS[kind], linewidth=1.0, linestyle=":")
        axis.set_title(f"{constant.title} = {constant.default:.3g}", fontsize=7.5, pad=2)
        axis.set_yscale("symlog", linthresh=FLAT, linscale=0.6)
        axis.set_ylim(-15, 60)
        axis.set_yticks([-10, -1, 0, 1, 10], ["-10", "-1", "0", "1", "10"])
        axis.set_xticks([-1, 0, 1], ["1/2", "1", "2"])
        axis.tick_params(labelsize=6.5, length=2)
        axis.minorticks_off()
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    for axis in axes.flat[len(CONSTANTS) :]:
        axis.set_axis_off()
    handles = [plt.Line2D([], [], color=colour, label=kind) for kind, colour in KINDS.items()]
    handles += [
        plt.Line2D([], [], color="black", label="total error; 1 - F1 of decks and water"),
        plt.Line2D([], [], color="black", linestyle=":", label="cells off by > 0.5 m"),
    ]
    figure.legend(handles=handles, loc="upper center", ncol=8, fontsize=7.5, frameon=False)
    figure.supxlabel("times the default", fontsize=8)
    figure.supylabel("percentage points above the default", fontsize=8)
    figure.tight_layout(rect=(0, 0, 1, 0.975), h_pad=0.5, w_pad=0.4)
    save_png(figure, path, 110)
    plt.close(figure)


def page(rows: list[Row]) -> str:
    """The table as Markdown."""
    table: list[Row] = []
    for constant in CONSTANTS:
        means = moved(rows, constant)
        flat, most, where = [1.0], 0.0, "-"
        for factor in sorted({f for by_factor in means.values() for f in by_factor}):
            here = {(kind, i): means[kind][factor][i] for kind in means if factor in means[kind] for i in range(2)}
            key = max(here, key=lambda k: abs(here[k]))
            if abs(here[key]) <= FLAT:
                flat.append(factor)
            if abs(here[key]) > abs(most):
                what = f"{key[0]}, terrain" if key[1] and key[0] not in ("decks", "water") else key[0]
                most, where = here[key], f"{what}, at {factor:g}"
        low, high = min(flat), max(flat)
        inner = [f for f in (*FACTORS, 1.0) if low < f < high and f not in flat and constant.scaled(f) is not None]
        table.append({
            "subject": constant.subject, "constant": f"`{constant.title}`", "value": f"{float(constant.default):.3g}",
            "flat": f"{low:g} to {high:g}" if not inner else "at places only", "most": most, "where": where,
            "tried": TRIED[constant.subject],
        })  # fmt: skip
    columns: list[Column] = [
        ("subject", "of", ""), ("constant", "constant", ""), ("value", "default", ""), ("flat", f"within {FLAT}, times", ""),
        ("most", "largest change, points", "+.2f"), ("where", "where", ""), ("tried", "variants tried", ""),
    ]  # fmt: skip
    names = list(dict.fromkeys(row["cloud"] for row in rows))
    good = sum(abs(row["most"]) <= FLAT for row in table)
    steep = ", ".join(f"{row['constant']} ({row['where']})" for row in table if abs(row["most"]) > 1)
    return "\n\n".join([
        "# OST: how flat its later constants are",
        f"Each constant is multiplied by {', '.join(f'{f:g}' for f in FACTORS)}, one at a time, all others as they are. The "
        "picture shows by how much means change: total error (lines), cells of 1 m whose terrain is off by more than 0.5 m "
        "(dots), and for decks and water one less F1 by area, percentage points, each kind of cloud on its own. The grey band is "
        f"{FLAT} points on either side; beyond it the scale is logarithmic. Shares are not raised above one. Constants that "
        "count for photographs, drones and dense clouds were varied on scenes of these only, the others on all other clouds.",
        "![Changes of total error and terrain error by factor, a panel for each constant](flat.png)",
        f"{good} of {len(table)} constants move no mean by more than {FLAT} points, from half to double. These move one by more "
        f"than 1 point: {steep}. The clouds are small, so single decks, ponds and faces show in the means; steep terrain and "
        "overhangs rest on one tile. No constant was changed after this picture was seen. Constants of OST that came "
        "earlier are in [results.md](results.md). Not varied: how many cells around a cell are looked at (2 and 4, and "
        "8 lines), which are fixed in compiled code; and the area of the largest building, which follows from `window`.",
        markdown(columns, table),
        f"Clouds: {', '.join(names)}. Tiles and scenes are squares of {SIDE:g} m.",
    ])  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    """Vary all constants, draw, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with isprs/, tiles/ and tiles_hard/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    options = parser.parse_args(arguments)
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    options.out.mkdir(parents=True, exist_ok=True)
    rows = varied(samples.data_folder(options.data), options.out / "flat.csv")
    drawn(rows, options.out / "flat.png")
    write_page(options.out / "flat.md", page(rows), "python experiments/default/flat.py", ("ost", "scenes"), keeps=True)
    print(f"results are in {options.out}")


if __name__ == "__main__":
    main()
