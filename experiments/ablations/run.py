"""The choices within the TIN methods, one at a time, on the 15 ISPRS samples. See README.md."""

from __future__ import annotations

import dataclasses
import statistics
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import protocols, samples, search, spaces
from experiments.report import Column, CommandLine, Row, markdown, read_csv, save_png, write_csv, write_page
from jaxfilter.core.points import Points
from jaxfilter.engines.grid.inpaint import fill_membrane, fill_nearest
from jaxfilter.engines.tin.facets import Rule
from jaxfilter.engines.tin.growth import Growth, Mirror, Network, Outliers
from jaxfilter.methods import smrf
from jaxfilter.steps import outliers
from jaxfilter.steps.grid_filter import Surface
from jaxfilter.steps.seeds import lowest_per_cell, lowest_per_window
from jaxfilter.steps.surfaces import Cells, steepest_drops
from jaxfilter.steps.tin_filter import surrounded

HERE = Path(__file__).parent
COLUMNS = ("choice", "variant", "sample", "key", *search.COUNTS, "status")
ANGLES = (6.0, 10.0, 14.0, 18.0, 22.0, 26.0, 30.0, 34.0, 38.0, 42.0)
TINS = ("fptd", "ptd")
RING = 5.0
"""Metres between the points of a dense border."""

COLOURS = {"FPTD": "#D55E00", "PTD": "#0072B2", "PTD's test": "#009E73", "AGPTD": "#CC79A7"}

Maker = Callable[[str], jf.Filter]
"""The filter for a sample such as "samp11"."""
Runner = Callable[[jf.Filter, jf.PointCloud], np.ndarray]
"""bool[n] ground of a cloud."""


def run_filter(filter_: jf.Filter, cloud: jf.PointCloud) -> np.ndarray:
    return filter_(cloud, workers=1).ground


@dataclasses.dataclass(frozen=True)
class Variant:
    """One way to make a choice. ``baseline``: what the others of the choice are compared with, the fixed set as it stands or
    nearest to it; ``labels``: it looks at the reference. Names begin with the method and a colon."""

    choice: str
    name: str
    make: Maker
    run: Runner = run_filter
    baseline: bool = False
    labels: bool = False


def variants() -> list[Variant]:
    """Every choice of the report, in its order."""
    return [
        *_low_outliers(),
        *_fate(),
        *_seed_density(),
        *_seed_cell(),
        *_sign(),
        *_angle(),
        *_blocks(),
        *_insertion(),
        *_mirror(),
        *_border(),
        *_switches(),
        *_search(),
        *_smrf(),
        *_ppdf(),
    ]


def _with(method: str, **changes: Any) -> Maker:
    return lambda sample: spaces.fixed(method, sample).replace(**changes)


def _modified(method: str, changes: dict[str, Any] | None = None, **methods: Callable[..., Any]) -> Maker:
    """The fixed set of a method with steps replaced, as a subclass of it. Raises: AttributeError for a step that it has not."""

    def make(sample: str) -> jf.Filter:
        given = spaces.fixed(method, sample).replace(**(changes or {}))
        for name in methods:
            getattr(given, name)
        cls = type(f"Modified{type(given).__name__}", (type(given),), methods)
        jax.tree_util.register_static(cls)
        return cls(**{f.name: getattr(given, f.name) for f in dataclasses.fields(given)})

    return make


def _variants(choice: str, baseline: str, makers: dict[str, Maker]) -> list[Variant]:
    """Variants by their names, one of which is the baseline."""
    return [Variant(choice, name, make, baseline=name == baseline) for name, make in makers.items()]


def _low_outliers() -> list[Variant]:
    """1. How low outliers are kept from being seeds."""
    choice = "1. low outliers"
    out = []
    for method in TINS:
        title = method.upper()
        without = "windows without their lowest points" if method == "fptd" else "second-lowest point of a cell"
        makers = {
            f"{title}: none": _with(method, low_clusters=False),
            f"{title}: radius filter, 5 m, 10 neighbours": _modified(
                method, {"low_clusters": False}, outliers=_few_neighbours
            ),
            f"{title}: isolated points, 2 m below their 8 neighbours": _modified(method, outliers=_isolated),
            f"{title}: elevation unlike that of 8 neighbours": _modified(method, outliers=_unlike),
            f"{title}: {without}": _modified(method, outliers=_lowest_of_all),
            f"{title}: clusters of low points": _with(method),
            f"{title}: clusters and radius filter": _modified(method, outliers=_few_neighbours),
        }
        out += _variants(choice, f"{title}: clusters of low points", makers)
        name = f"{title}: by the labels, objects 1 m below ground"
        out.append(Variant(choice, name, _modified(method, outliers=_by_labels), labels=True))
    return out


def _few_neighbours(self: Any, points: Points, workers: int | None) -> Outliers:
    given = {"clusters": self.low_clusters, "radius": 5.0, "min_neighbours": 10}
    return outliers.bar_outliers(points, **given, workers=workers)


def _isolated(self: Any, points: Points, workers: int | None) -> Outliers:
    found = outliers.isolated_low(points.xyz, 8, 2.0, workers=workers)
    return Outliers(found, found)


def _unlike(self: Any, points: Points, workers: int | None) -> Outliers:
    found = outliers.knn_outliers(points.xyz, 8, workers=workers)
    return Outliers(found, found)


def _lowest_of_all(self: Any, points: Points, workers: int | None) -> Outliers:
    """What would be the seeds, so that the next points become them. In cells these are the second-lowest; windows overlap,
    and lose all points that are the lowest of any. The points are tested with the others."""
    barred, late = np.zeros(len(points), bool), np.zeros(len(points), bool)
    if isinstance(self, jf.FPTD):
        barred[lowest_per_window(points, self.window, self.stride, late)] = True
    else:
        barred[lowest_per_cell(points, self.seed_cell, late)] = True
    return Outliers(barred, late)


def _by_labels(self: Any, points: Points, workers: int | None) -> Outliers:
    """Objects more than 1 m below the nearest reference ground: what a perfect manual removal would take out."""
    truth = np.zeros(len(points), bool)
    truth[points.member[points.cloud.reference[points.index]]] = True
    _, nearest = cKDTree(points.xyz[truth, :2]).query(points.xyz[:, :2])
    found = ~truth & (points.xyz[:, 2] < points.xyz[truth][nearest, 2] - 1.0)
    return Outliers(found, found)


def _fate() -> list[Variant]:
    """2. What becomes of points that were kept from being seeds."""
    choice = "2. fate of outliers"
    radius = {"radius": 5.0, "min_neighbours": 10, "low_clusters": False}
    own = "FPTD: low clusters tested after the others"
    makers = {
        own: _with("fptd"),
        "FPTD: low clusters tested with the others": _modified("fptd", outliers=_at_once),
        "FPTD: radius filter, tested with the others": _with("fptd", **radius),
    }
    return [
        *_variants(choice, own, makers),
        Variant(choice, "FPTD: low clusters left out", _with("fptd"), run=_left_out),
        Variant(choice, "FPTD: radius filter, left out", _with("fptd", **radius), run=_left_out),
    ]


def _at_once(self: Any, points: Points, workers: int | None) -> Outliers:
    found = jf.FPTD.outliers(self, points, workers)
    return found._replace(late=np.zeros_like(found.late))


def _left_out(filter_: jf.Filter, cloud: jf.PointCloud) -> np.ndarray:
    """The labels of what is left when barred points are taken from the cloud and called objects."""
    kept = ~filter_(cloud, workers=1).barred
    rest = jf.PointCloud.from_arrays(cloud.coordinates()[kept])
    ground = np.zeros(len(cloud), bool)
    ground[kept] = filter_.replace(low_clusters=False, radius=0.0)(rest, workers=1).ground
    return ground


def _seed_density() -> list[Variant]:
    """3. How many seeds: stride of FPTD's windows of 60 m, and the seeds of each method under the test of PTD."""
    limits = {name: getattr(spaces.fixed("ptd", "samp11"), name) for name in ("max_angle", "max_distance")}
    how = "PTD's test"
    names = {stride: f"FPTD: stride {stride} m" for stride in (60, 30, 20, 10, 5)}
    names[60] += ", one seed per cell"
    seeds = {
        f"{how}: cell minima (PTD)": _with("ptd"),
        f"{how}: sliding windows (FPTD)": _modified("fptd", growth=_growing(Rule(**limits))),
        f"{how}: cells divided on slopes (AGPTD)": _with("agptd", **limits),
        f"{how}: opening and local planes (IPTD)": _with("iptd", **limits),
        f"{how}: openings (SPF)": _with("spf", **limits),
        f"{how}: planes (PPDF)": _modified("ptd", start=_on_planes),
    }
    strides = {name: _with("fptd", stride=float(stride)) for stride, name in names.items()}
    return [
        *_variants("3. seed density", names[10], strides),
        *_variants("3. seeds", f"{how}: cell minima (PTD)", seeds),
    ]


def _seed_cell() -> list[Variant]:
    """4. Size of seed cells and windows, whatever the largest building."""
    out = []
    for title, method in {"PTD: {} m": "ptd", "FPTD: {} m, stride a sixth": "fptd", "AGPTD: {} m": "agptd"}.items():
        makers = {}
        for size in (6, 12, 18, 30, 60, 90):
            change = {"window": float(size), "stride": size / 6} if method == "fptd" else {"seed_cell": float(size)}
            makers[title.format(size)] = _with(method, **change)
        out += _variants("4. seed cell", title.format(60), makers)
    return out


def _sign() -> list[Variant]:
    """5. Signed or not, and elevation over the highest vertex against distance to the plane."""

    def rule(signed: float, distance: bool) -> Callable[..., Any]:
        def changed(self: Any, network: Network) -> Growth:
            growth = _before(self).growth(self, network)
            limits = growth.rule._replace(signed=signed)
            if distance:
                limits = limits._replace(max_elevation=np.inf, max_distance=limits.max_elevation)
            return dataclasses.replace(growth, rule=limits)

        return changed

    makers = {
        "FPTD: signed, elevation over the highest vertex": _with("fptd"),
        "FPTD: angle unsigned, elevation over the highest vertex": _modified("fptd", growth=rule(0.0, False)),
        "FPTD: signed, distance to the plane": _modified("fptd", growth=rule(1.0, True)),
        "FPTD: unsigned, distance to the plane, as PTD": _modified("fptd", growth=rule(0.0, True)),
    }
    return _variants("5. sign and height", next(iter(makers)), makers)


def _angle() -> list[Variant]:
    """6. Angle limit, and the noise floor."""
    out = []
    for method in TINS:
        title, own = method.upper(), spaces.fixed(method, "samp11").max_angle
        angles = {f"{title}: {angle:g} degrees": _with(method, max_angle=angle) for angle in sorted({*ANGLES, own})}
        floors = {f"{title}: {floor:g} m": _with(method, noise_floor=floor) for floor in (0.05, 0.1, 0.2)}
        out += _variants("6. angle limit", f"{title}: {own:g} degrees", angles)
        out += _variants("6. noise floor", f"{title}: off", {f"{title}: off": _with(method, noise_floor=0.0)} | floors)
    return out


def _blocks() -> list[Variant]:
    """7. One triangulation, or blocks that grow on their own."""
    one, blocks = "FPTD: one triangulation", "FPTD: independent blocks"
    return _variants("7. blocks", one, {one: _with("fptd"), blocks: _with("fptd", blocks="independent")})


def _insertion() -> list[Variant]:
    """8. Which of the points that pass in a round are added: all, or the lowest over each facet."""
    out = []
    for method in TINS:
        lowest = _modified(method, {"max_rounds": 1000}, growth=_growing(one_per_facet=True))
        batch = f"{method.upper()}: batch"
        out += _variants("8. insertion", batch, {batch: _with(method), f"{method.upper()}: one_per_facet": lowest})
    return out


def _before(self: Any) -> Any:
    """The class of a method whose steps are replaced."""
    return type(self).__mro__[1]


def _on_planes(self: Any, points: Points, workers: int | None, progress: Any, trace: bool = False) -> Network:
    """PPDF's seeds, the points near planes, of which the lowest of each metre count."""
    planes = jf.PPDF(**jf.PPDF.from_spacing(points.spacing(), None))
    found = planes.classify(points, key=None, workers=workers, progress=progress, trace=False).decision
    barred = self.outliers(points, workers)
    seeds = lowest_per_cell(points, 1.0, barred.barred | (found != jf.Decision.SEED))
    return surrounded(self, points, seeds, barred, self.seed_cell)


def _growing(rule: Rule | None = None, **policies: Any) -> Callable[..., Any]:
    """The ``growth`` of a method, with other limits, but for the noise floor, and other policies."""

    def changed(self: Any, network: Network) -> Growth:
        growth = _before(self).growth(self, network)
        limits = growth.rule if rule is None else rule._replace(noise_floor=growth.rule.noise_floor)
        return dataclasses.replace(growth, rule=limits, **policies)

    return changed


def _mirror() -> list[Variant]:
    """9. Mirroring of points over steep facets, of PTD: in place of the point, or as a second chance."""
    makers = {"PTD: off": _with("ptd", max_terrain_angle=90.0)}
    for angle in (88.0, 30.0, 10.0):
        nearest = _growing(mirror=Mirror(angle, nearest=True))
        makers[f"PTD: highest, replace, over {angle:g} degrees"] = _with("ptd", max_terrain_angle=angle)
        makers[f"PTD: nearest, or, over {angle:g} degrees"] = _modified("ptd", growth=nearest)
    return _variants("9. mirroring", "PTD: highest, replace, over 88 degrees", makers)


def _border() -> list[Variant]:
    """10. Simulated border points: elevation and number."""

    def every(spacing: float) -> Callable[..., Any]:
        def start(self: Any, points: Points, *given: Any) -> Network:
            network = _before(self).start(self, points, *given)
            seeds = network.row[network.seed & network.real]
            return surrounded(self, points, seeds, network.outliers, spacing)

        return start

    places = {"every 60 m": {}, "four corners": {"start": every(1e9)}, f"every {RING:g} m": {"start": every(RING)}}
    static = {"growth": _growing(border_follows=False)}
    out = []
    for method in TINS:
        makers = {}
        for place, steps in places.items():
            makers[f"{method.upper()}: {place}, follow the ground"] = _modified(method, **steps)
            makers[f"{method.upper()}: {place}, static"] = _modified(method, **steps, **static)
        own = next(iter(makers))
        out += _variants("10. border points", own, makers | {own: _with(method)})
    return out


def _switches() -> list[Variant]:
    """11. Every switch of the other methods, as far as it can be thrown alone."""
    choice = "11. switches of other methods"
    out = []
    for method in spaces.method_names():
        fields = [f for f in dataclasses.fields(jf.FILTERS[method]) if f.metadata.get("choices")]
        if method in TINS or not fields:
            continue
        out.append(Variant(choice, f"{method.upper()}: fixed set", _with(method), baseline=True))
        base = spaces.fixed(method, "samp11")
        for field in fields:
            for value in field.metadata["choices"]:
                try:
                    base.replace(**{field.name: value})
                except jf.ParameterError:
                    continue
                if value != getattr(base, field.name):
                    name = f"{method.upper()}: {field.name}={value}"
                    out.append(Variant(choice, name, _with(method, **{field.name: value})))
    return out


def _search() -> list[Variant]:
    """12. The constants of the search for clusters of low points, one at a time."""
    tried: dict[str, dict[str, float]] = {
        "depth 1 m": {"depth": 1.0}, "depth 4 m": {"depth": 4.0}, "10 points": {"max_points": 10},
        "120 points": {"max_points": 120}, "reach 8 m": {"reach": 8.0}, "reach 30 m": {"reach": 30.0},
        "no second search": {"farther": 1}, "120 points, no second search": {"max_points": 120, "farther": 1},
    }  # fmt: skip
    out = []
    for method in TINS:
        own = f"{method.upper()}: 2 m, 30 points, 15 m"
        makers = {f"{method.upper()}: {name}": _modified(method, outliers=_found_by(**c)) for name, c in tried.items()}
        out += _variants("12. search for low clusters", own, {own: _with(method)} | makers)
    return out


def _found_by(farther: int = outliers.FARTHER, **constants: Any) -> Callable[..., Outliers]:
    """The ``outliers`` of a method, by the search with other constants. ``farther``: 1 leaves out that for larger clusters."""

    def found(self: Any, points: Points, workers: int | None) -> Outliers:
        before, outliers.FARTHER = outliers.FARTHER, farther
        try:
            barred = outliers.low_clusters(points, **constants).barred
        finally:
            outliers.FARTHER = before
        return Outliers(barred, barred)

    return found


def _smrf() -> list[Variant]:
    """13. The structuring element of SMRF, and how it fills empty cells and those of objects."""
    ways = {
        "disks, membrane": ("disk", _membrane), "squares, membrane": ("square", _membrane),
        "diamonds, membrane": ("diamond", _membrane), "disks, nearest cell": ("disk", fill_nearest),
        "disks, triangles": ("disk", _triangles),
    }  # fmt: skip
    makers = {f"SMRF: {name}": _modified("smrf", **_smrf_steps(*how)) for name, how in ways.items()}
    own = "SMRF: disks, membrane"
    return _variants("13. element and inpainting of SMRF", own, makers | {own: _with("smrf")})


Fill = Callable[[jax.Array, jax.Array, jax.Array], Any]
"""Elevations f32, known cells bool and existing cells bool, [rows, columns] each, to elevations without holes."""


def _smrf_steps(element: str, fill: Fill) -> dict[str, Callable[..., Any]]:
    """SMRF with another structuring element, or another way to fill holes: a square is as wide as the disk that it replaces."""

    def prepare(self: Any, cells: Cells) -> smrf.CellDrops:
        filled = fill(cells.lowest, cells.seen, cells.valid)
        steepest = steepest_drops(filled, cells.valid, self.reach, self.reach, element)
        return self._open(cells, filled)._replace(steepest=steepest)

    def surface(self: Any, prepared: smrf.CellDrops) -> Surface:
        cells, filled, steepest, bare = prepared[:4]
        terrain = fill(filled, bare & (steepest <= self.slope * self.cell), cells.valid)
        return Surface.over(cells, terrain)

    return {"prepare": prepare, "surface": surface}


def _membrane(z: jax.Array, known: jax.Array, inside: jax.Array) -> jax.Array:
    return fill_membrane(z, known, inside).z


def _triangles(z: jax.Array, known: jax.Array, inside: jax.Array) -> jax.Array:
    """Linear in the Delaunay triangles of the known cells, and the nearest of them outside."""
    taken, hole = np.asarray(known & inside), np.asarray(inside & ~known)
    cells, holes, values = np.argwhere(taken), np.argwhere(hole), np.asarray(z)[taken].astype(np.float64)
    height = LinearNDInterpolator(cells, values)(holes)
    outside = np.isnan(height)
    height[outside] = values[cKDTree(cells).query(holes[outside])[1]]
    out = np.array(z)
    out[hole] = height
    return jax.numpy.asarray(out)


def _ppdf() -> list[Variant]:
    """14. On which side of the local plane PPDF takes points."""

    def upward(self: Any, distance: np.ndarray, limit: float) -> np.ndarray:
        return (distance >= 0) & (distance <= limit)

    both = "PPDF: upward and downward"
    makers = {both: _with("ppdf"), "PPDF: upward only": _modified("ppdf", _within=upward)}
    return _variants("14. direction of PPDF", both, makers)


def evaluate(sample: str, path: Path, names: Sequence[tuple[str, str]]) -> list[Row]:
    """One row per variant, named by choice and name; a variant that fails has no counts, and the error as its status."""
    from jaxfilter.core.compilation import keep_compilations

    keep_compilations()
    cloud = jf.read(path)
    table = {(v.choice, v.name): v for v in variants()}
    done: dict[str, np.ndarray] = {}  # labels of unchanged methods: the baseline of one choice is that of others
    rows = []
    for name in names:
        variant = table[name]
        row: Row = {"choice": variant.choice, "variant": variant.name, "sample": sample}
        try:
            filter_ = variant.make(sample)
            key = repr(filter_)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", jf.JaxfilterWarning)
                plain = variant.run is run_filter and type(filter_) in jf.FILTERS.values()
                ground = done[key] if plain and key in done else variant.run(filter_, cloud)
            if plain:
                done[key] = ground
            counts = jf.evaluate(ground, cloud.reference).confusion.ravel().tolist()
            row |= dict(zip(search.COUNTS, counts, strict=True)) | {"status": "OK"}
        except Exception as error:
            row |= {"status": f"{type(error).__name__}: {error}"[:200]}
        rows.append(row)
    return rows


def main(arguments: list[str] | None = None) -> None:
    """Run what the command line asks for, as far as it is not at hand, and write the report."""
    options = _parser().options(arguments)
    folder = samples.data_folder(options.data)
    path, every = options.out / "runs.csv", variants()
    chosen = [v for v in every if not options.choices or v.choice.split(".")[0] in options.choices]
    known = {(v.choice, v.name) for v in every}
    before = [{key: row[key] for key in COLUMNS} for row in (read_csv(path) if path.exists() else [])]
    have = {_place(row): row for row in before if (row["choice"], row["variant"]) in known}
    keys = {(v.choice, v.name, f"samp{n}"): _key(v, f"samp{n}") for n in options.samples for v in chosen}
    missing = [place for place, key in keys.items() if place not in have or have[place]["key"] != key]
    tasks = []
    for number in options.samples:
        names = [(choice, name) for choice, name, sample in missing if sample == f"samp{number}"]
        parts = [names[i : i + 30] for i in range(0, len(names), 30)]
        tasks += [(f"samp{number}", samples.sample_path(folder, number), part) for part in parts]
    for i, (task, rows) in enumerate(search.results(evaluate, tasks, options.processes), 1):
        for row in rows:
            have[_place(row)] = dict.fromkeys(COLUMNS, "") | row | {"key": keys[_place(row)]}
        write_csv(path, list(have.values()))
        print(f"{i}/{len(tasks)}: {task[0]}, {len(rows)} variants", file=sys.stderr, flush=True)
    rows = [have[place] | protocols.scores(have[place]) for place in keys]
    lines = summary(rows, chosen)
    write_csv(options.out / "summary.csv", lines)
    methods = {v.name.split(":")[0].lower() for v in chosen}
    write_page(
        options.out / "results.md", report(lines, rows, len(options.samples)), options.command, methods, keeps=True
    )
    figure(lines, options.out / "total.png")
    print(f"results are in {options.out}")


def _place(row: Row) -> tuple[str, str, str]:
    return row["choice"], row["variant"], row["sample"]


def _key(variant: Variant, sample: str) -> str:
    """A word for the parameters of the filter and the labels of its method; empty for one that is no filter."""
    try:
        return search.digest(variant.make(sample))
    except jf.ParameterError:
        return ""


def summary(rows: Sequence[Row], chosen: Sequence[Variant]) -> list[Row]:
    """One line per variant: means and medians over the samples, and on how many it is better or worse than its baseline."""
    by: dict[tuple[str, str], dict[str, Row]] = {(v.choice, v.name): {} for v in chosen}
    for row in rows:
        by[row["choice"], row["variant"]][row["sample"]] = row
    own = {(v.choice, v.name.split(":")[0]): by[v.choice, v.name] for v in chosen if v.baseline}
    out = []
    for variant in chosen:
        mine = by[variant.choice, variant.name]
        good = [row for row in mine.values() if row["total"] == row["total"]]
        line: Row = {
            "choice": variant.choice, "variant": variant.name, "baseline": variant.baseline, "labels": variant.labels,
            "samples": len(good), "failed": len(mine) - len(good),
        }  # fmt: skip
        for key in protocols.SCORES if good else ():
            line[key] = statistics.fmean(row[key] for row in good)
            line[f"median_{key}"] = statistics.median(row[key] for row in good)
        base = own.get((variant.choice, variant.name.split(":")[0]), {})
        gains = [row["total"] - base[row["sample"]]["total"] for row in good if row["sample"] in base]
        if gains and not variant.baseline:
            line |= {"difference": statistics.fmean(gains)}
            line |= {"better": sum(gain < 0 for gain in gains), "worse": sum(gain > 0 for gain in gains)}
        out.append(line)
    return out


TABLE: list[Column] = [
    ("title", "variant", ""), ("type1", "T.I", ".2f"), ("type2", "T.II", ".2f"), ("total", "TE", ".2f"),
    ("kappa", "kappa", ".2f"), ("median_type1", "T.I, median", ".2f"), ("median_type2", "T.II, median", ".2f"),
    ("median_total", "TE, median", ".2f"), ("median_kappa", "kappa, median", ".2f"),
    ("difference", "TE less baseline", "+.2f"), ("better", "better on", "d"), ("worse", "worse on", "d"),
    ("failed", "failed", "d"),
]  # fmt: skip
"""Means, medians, and the comparison with the baseline of the same method."""


def report(lines: Sequence[Row], rows: Sequence[Row], count: int) -> str:
    """The report as Markdown: a table per choice, and the angle limit per terrain class."""
    text = [
        "# Choices within the methods",
        f"Means and medians over {count} ISPRS samples, in percent. Everything but the choice in question is the fixed "
        "set of the protocol in `experiments/isprs`: `for_cloud(cloud)`, nothing chosen per sample. "
        "The baseline, that fixed set, is bold. Variants marked † use the labels and show only what is to be gained.",
    ]
    for choice in dict.fromkeys(line["choice"] for line in lines):
        part = [line | {"title": _title(line)} for line in lines if line["choice"] == choice]
        used = [column for column in TABLE if any(line.get(column[0]) not in (None, 0) for line in part)]
        text += [f"## {choice}", markdown(used, part)]
        if choice == "6. angle limit":
            text += ["Mean total error by terrain class of Li et al. (2021):", markdown(*_by_class(rows, choice))]
    return "\n\n".join([*text, "![Mean total error per variant](total.png)"]) + "\n"


def _title(line: Row) -> str:
    title = line["variant"] + (" †" if line["labels"] else "")
    return f"**{title}**" if line["baseline"] else title


def _by_class(rows: Sequence[Row], choice: str) -> tuple[list[Column], list[Row]]:
    terrain = samples.terrain_classes()
    table: dict[str, dict[str, list[float]]] = {}
    for row in rows:
        if row["choice"] == choice:
            table.setdefault(row["variant"], {}).setdefault(terrain[row["sample"]], []).append(row["total"])
    classes = sorted({c for groups in table.values() for c in groups})
    order = sorted(table, key=lambda name: (name.split(":")[0], float(name.split()[1])))
    lines = [{"variant": name} | {c: statistics.fmean(v) for c, v in table[name].items()} for name in order]
    return [("variant", "variant", ""), *((c, f"TE, {c}", ".2f") for c in classes)], lines


def figure(lines: Sequence[Row], path: Path) -> None:
    """Mean total error of every variant as a dot, its median as a ring, baselines as lines."""
    from matplotlib.figure import Figure

    choices = [c for c in dict.fromkeys(line["choice"] for line in lines) if not c.startswith("11")]
    parts = [[line for line in lines if line["choice"] == c and "total" in line] for c in choices]
    chart = Figure(figsize=(7.4, 0.16 * sum(map(len, parts)) + 0.42 * len(parts) + 0.6), layout="constrained")
    axes = chart.subplots(len(parts), 1, squeeze=False, sharex=True, height_ratios=[len(p) + 0.6 for p in parts])[:, 0]
    for ax, choice, part in zip(axes, choices, parts, strict=True):
        for method in dict.fromkeys(line["variant"].split(":")[0] for line in part):
            mine = [i for i, line in enumerate(part) if line["variant"].startswith(f"{method}:")]
            colour = COLOURS.get(method, "#0072B2")
            base = [part[i]["total"] for i in mine if part[i]["baseline"]]
            ax.vlines(base, min(mine) - 0.4, max(mine) + 0.4, color=colour, linewidth=0.8, alpha=0.6)
            ax.scatter([part[i]["total"] for i in mine], mine, s=16, color=colour, zorder=3)
            ring = {"facecolors": "none", "edgecolors": colour, "linewidths": 0.8}
            ax.scatter([part[i]["median_total"] for i in mine], mine, s=16, zorder=2, **ring)
        ax.set_yticks(
            range(len(part)), [line["variant"] + (" †" if line["labels"] else "") for line in part], fontsize=6
        )
        ax.set_ylim(len(part) - 0.4, -0.6)
        ax.set_title(choice, fontsize=7.5, loc="left", pad=2)
        ax.set_xscale("log")
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(axis="x", labelsize=7)
        ax.grid(axis="x", which="both", linewidth=0.3, alpha=0.5)
    low, high = axes[-1].get_xlim()
    ticks = [tick for tick in (2, 3, 5, 7, 10, 15, 20, 30, 50, 70) if low <= tick <= high]
    axes[-1].set_xticks(ticks, [str(tick) for tick in ticks])
    axes[-1].minorticks_off()
    axes[-1].set_xlabel("total error, %: mean (dot) and median (ring) over the samples; line: baseline", fontsize=8)
    save_png(chart, path, 150)


def _parser() -> CommandLine:
    parser = CommandLine(__file__, __doc__)
    parser.add_argument(
        "--samples", type=samples.sample_name, nargs="+", default=samples.SAMPLES, help="such as 11 24 [all]"
    )
    parser.add_argument("--choices", nargs="+", metavar="NUMBER", help="such as 1 7 [all]")
    parser.add_argument("--processes", type=int, default=2, help="of one thread each [%(default)s]")
    return parser


if __name__ == "__main__":
    main()
