"""A page that shows the products of a survey to a client: maps with legends, links to the files, and tables."""

from __future__ import annotations

import base64
import datetime
import io
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.params import declared
from ..core.units import Units, vertical
from ..core.version import __version__
from ..files.classes import class_name
from ..files.disk import Bounds, new_file
from ..files.storage import Place
from ..methods import FILTERS
from ..plots.maps import new_figure, shade
from ..surveys.collection import common
from ..terrain.layer import Layer

if TYPE_CHECKING:
    from ..surveys.collection import Collection
    from ..surveys.model import Rasters, TerrainReport
    from ..surveys.report import RunReport

PAGE = "survey.html"
_PIXELS = 900  # of the longer side of a picture
_MOST_TILES, _MOST_PLACES, _MOST_LINES = 500, 50, 100_000
"""Rows of the tables, and contour lines that are drawn."""
_NOT_STATED = "not stated"
_INTERPOLATIONS = {
    "tin": "linear in triangles (TIN)",
    "natural": "natural neighbours",
    "idw": "inverse distance weighting (IDW)",
    "kriging": "kriging",
}
_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,"><title>{title} – {subject}</title><style>{style}</style></head>
<body><header><h1>{title}</h1><p>{about} · jaxfilter {version}</p></header><main>{main}</main></body></html>
"""
_STYLE = """
img { width: 100%; } .cards { grid-template-columns: repeat(auto-fit, minmax(300px, 1fr)); }
"""


def page_of(title: str, subject: str, about: str, main: str, style: str = "") -> str:
    """A page of HTML that needs no network. ``subject``, ``about``: in few words; ``main``: HTML; ``style``: more CSS."""
    style = files(__package__).joinpath("page.css").read_text(encoding="utf-8") + style
    return _PAGE.format(title=escape(title), subject=subject, about=about, main=main, style=style, version=__version__)


def write_survey_page(
    folder: Place,
    rasters: Rasters,
    reports: tuple[RunReport, TerrainReport],
    collection: Collection,
    *,
    overwrite: bool,
) -> None:
    """Write the page into the folder of ``rasters``. ``reports``: of the run that found the ground, and of the one that made the
    rasters, which may be the same; ``collection``: the inputs. Raises: OutputError."""
    found, today = reports[0], datetime.date.today().isoformat()
    cards = "".join(_card(layer, rasters.places, collection.units) for layer in rasters.places)
    hint = "The colours leave out the lowest and the highest hundredth of the cells. Pale blue cells have no value."
    sections = {
        "The survey": table((), [*_survey_facts(rasters, reports, collection), ("date", today)]),
        "Maps": f'<p class="hint">{hint}</p><div class="cards">{cards}</div>',
        "Classes of the points": _classes(found),
        "Places to check": _places(found),
        "What could not be done": _failures(reports),
        "Tiles": _tiles(found, reports[1].bounds, collection.metre),
    }
    if found.method is not None:
        sections[f"Parameters of the method {found.method}"] = parameter_table(found.method, found.parameters)
    main = "".join(f"<section><h2>{escape(title)}</h2>{body}</section>" for title, body in sections.items())
    with new_file(folder / PAGE, overwrite=overwrite) as temporary:
        text = page_of(folder.name, "survey", f"Products of a survey · {today}", main, _STYLE)
        temporary.write_text(text, encoding="utf-8")


def _survey_facts(
    rasters: Rasters, reports: tuple[RunReport, TerrainReport], collection: Collection
) -> list[tuple[str, Any]]:
    """Names and values: where the survey lies, and how its products were made."""
    (found, made), crs = reports, collection.crs
    name = (
        _NOT_STATED
        if crs is None
        else " ".join((crs.name, f"({':'.join(code)})" if (code := crs.to_authority()) else ""))
    )
    x0, y0, x1, y1 = made.bounds
    return [
        ("coordinate reference system", name),
        ("heights count from", vertical(crs) or _NOT_STATED),
        ("units", collection.units),
        ("extent", f"X {x0:.10g} to {x1:.10g}, Y {y0:.10g} to {y1:.10g}"),
        ("input files", len(collection)),
        ("points", found.points),
        ("ground points", f"{found.ground:,} ({_percent(found.ground, found.points)})"),
        ("ground found by", f"the method {found.method}" if found.method else "the classes of the input files"),
        ("interpolation between ground points", _INTERPOLATIONS[rasters.interpolation.method]),
        ("rasters", f"{made.rows:,} rows and {made.columns:,} columns of cells of {rasters.cell:g} x {rasters.cell:g}"),
        ("software", f"jaxfilter {__version__}, JAX {version('jax')}, NumPy {np.__version__}"),
    ]


def _card(layer: Layer, places: Mapping[Layer, Place], units: Units) -> str:
    """A file in words, with a picture where it lies on this disk."""
    place, unit = places[layer], layer.UNITS.replace("units of Z", units.name.rpartition(" in ")[2])
    picture, values = _draw(layer, places, unit) if isinstance(place, Path) else ("", "")
    name, words = escape(place.name), escape(f"{layer.TITLE}, {unit}{values}")
    return f'<div><a href="{name}"><b>{name}</b>{picture}</a><span>{words}</span></div>'


def _draw(layer: Layer, places: Mapping[Layer, Place], unit: str) -> tuple[str, str]:
    """An image with axes and a legend, and the range of the values in words. Lines lie over the relief of their model."""
    lines, under, figure = layer.cells != layer, places.get(layer.cells), new_figure((5.0, 4.5))
    ax, values, about = figure.add_subplot(), np.zeros((0, 0)), ""
    if isinstance(under, Path):
        values, extent, step = _read(under)
        about = "about " * (step > 1)
        relief = lines or layer.STYLE == "relief"
        shown = shade(values[::-1], (extent[1] - extent[0]) / max(values.shape[-1], 1))[::-1] if relief else values
        low, high = np.nanpercentile(shown, (1, 99)) if np.isfinite(shown).any() else (0.0, 1.0)
        image = ax.imshow(shown, "gray" if relief else layer.STYLE, extent=extent, vmin=low, vmax=max(high, low + 1e-3))
        if not relief:
            figure.colorbar(image, ax=ax, label=unit, extend="both", shrink=0.8)
    if lines:
        values = _add_lines(ax, places[layer])
    ax.set(aspect="equal", facecolor="#d8e6ee")
    ax.ticklabel_format(useOffset=False, style="plain")
    ax.locator_params(nbins=4)
    ax.tick_params(labelsize=7)
    figure.savefig(png := io.BytesIO(), format="png", bbox_inches="tight")
    known = f": {about}{np.nanmin(values):.5g} to {np.nanmax(values):.5g}" if np.isfinite(values).any() else ""
    code = base64.b64encode(png.getvalue()).decode()
    return f'<img alt="{escape(layer.TITLE)}" src="data:image/png;base64,{code}">', known


def _read(raster: Path) -> tuple[np.ndarray, tuple[float, float, float, float], int]:
    """f32[rows, columns] of one cell in ``step`` each way, from north, NaN without a value; left, right, bottom, top; step."""
    import rasterio

    with rasterio.open(raster) as file:
        step = max(1, math.ceil(max(file.shape) / _PIXELS))
        shape = tuple(math.ceil(side / step) for side in file.shape)
        values = file.read(1, out_shape=shape, masked=True).astype(np.float32).filled(np.nan)
        left, bottom, right, top = file.bounds
    return values, (left, right, bottom, top), step


def _add_lines(ax: Any, place: Place) -> np.ndarray:
    """Draw lines of a GeoPackage, but for very many; their elevations f64[k]."""
    import geopandas
    import shapely
    from matplotlib.collections import LineCollection

    table = geopandas.read_file(place)
    if len(table) <= _MOST_LINES:
        paths = [shapely.get_coordinates(line) for line in table.geometry]
        ax.add_collection(LineCollection(paths, colors="saddlebrown", linewidths=0.4))
        ax.autoscale_view()
    return table["elevation"].to_numpy(np.float64)


def _percent(part: float, whole: float) -> str:
    return f"{100 * part / max(whole, 1):.1f} %"


def _capped(shown: Sequence[Any], number: int, what: str) -> str:
    """How many there are, and that a table holds some of them."""
    what = what.removesuffix("s") if number == 1 else what
    return f"<p>{number:,} {what}" + (f"; the first {len(shown):,} are listed" if len(shown) < number else "") + ".</p>"


def _classes(report: RunReport) -> str:
    """How many points are in each class of the classified files."""
    counts = Counter[int]()
    for (_, after), points in report.classes.items():
        counts[after] += points
    rows = [(class_name(one), points, _percent(points, report.points)) for one, points in sorted(counts.items())]
    return (
        table(("class", "points", "share"), rows) if rows else "<p>The points keep the classes of the input files.</p>"
    )


def _places(report: RunReport) -> str:
    """Where a person should look, worst first."""
    shown = report.places[:_MOST_PLACES]
    if report.method is None:
        return "<p>The ground was given by classes, so no places were looked for.</p>"
    words = "The terrain may be wrong there, and the worst place comes first. "
    words += "The chance is that of an error of more than half a metre."
    rows = [
        (f"{number}", f"{one['x']:.10g}", f"{one['y']:.10g}", f"{one['area']:,.0f}", f"{one['volume']:,.0f}")
        + (f"{100 * one['chance']:.0f} %", one["reason"])
        for number, one in enumerate(shown, 1)
    ]
    heading = ("place", "X", "Y", "area, m2", "expected error, m3", "chance", "reason")
    return _capped(shown, len(report.places), "places") + (f"<p>{words}</p>{table(heading, rows)}" if rows else "")


def _failures(reports: tuple[RunReport, TerrainReport]) -> str:
    """Tiles and files that are missing, and why."""
    rows = []
    for report in reports[reports[0] is reports[1] :]:
        rows += [(f"tile {one['tile']}", f"failed: {one['reason']}") for one in report.set_aside]
        rows += [(one["file"], f"could not be read: {one['reason']}") for one in report.left_out]
        rows += [(one["file"], f"was not written: {one['reason']}") for one in report.failed]
    return table(("what", "why"), rows) if rows else "<p>None.</p>"


def _tiles(report: RunReport, bounds: Bounds, metre: float) -> str:
    """The parts in which the survey was worked on, within the bounds of all."""
    rows, shown = [], report.table[:_MOST_TILES].tolist()
    for number, (core, ground, points) in enumerate(shown):
        x0, y0, x1, y1 = common(core, bounds)
        box = [f"{value:.10g}" for value in (x0, x1, y0, y1)]
        density = points / max(max(x1 - x0, 0) * max(y1 - y0, 0) * metre**2, 1e-9)
        state = "failed" if ground == -1 else "done"
        rows.append((f"{number}", *box, points, f"{density:.2f}", f"{100 * ground:.1f} %" if points else "", state))
    heading = ("tile", "X from", "to", "Y from", "to", "points", "points per m2", "ground", "state")
    return _capped(shown, report.tiles, "tiles") + table(heading, rows)


def parameter_table(method: str, values: Mapping[str, Any]) -> str:
    """The parameters of a method with what they mean."""
    known = {field.name: field.metadata for field in declared(FILTERS[method])} if method in FILTERS else {}
    rows = []
    for name, value in values.items():
        about: Mapping[str, Any] = known.get(name, {})
        rows.append((name.replace("_", " "), in_words(value), about.get("unit", ""), about.get("doc", "")))
    return f'<div class="parameters">{table(("parameter", "value", "unit", "meaning"), rows)}</div>'


def in_words(value: Any) -> str:
    """A value as a reader writes it: yes or no, several with commas."""
    if isinstance(value, (list, tuple)):
        return ", ".join(map(str, value)) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "not set" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def table(heading: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """An HTML table; the first cell of a row is its heading, integers get thousands separators, everything is escaped."""
    head = "".join(f'<th scope="col">{escape(text)}</th>' for text in heading)
    lines = []
    for row in rows:
        first, *others = (f"{value:,}" if type(value) is int else escape(str(value)) for value in row)
        lines.append(f'<tr><th scope="row">{first}</th>{"".join(f"<td>{cell}</td>" for cell in others)}</tr>')
    top = f"<thead><tr>{head}</tr></thead>" if head else ""
    return f"<table>{top}<tbody>{''.join(lines)}</tbody></table>"
