"""The page that shows a survey and its products to a client."""

from __future__ import annotations

import datetime
from collections import Counter
from collections.abc import Sequence
from html import escape
from importlib.metadata import version
from typing import Any

import numpy as np

from ..core.reading import Bounds
from ..core.units import vertical
from ..core.version import __version__
from ..files.classes import class_name
from ..files.disk import new_file
from ..files.storage import Place
from ..reports.parts import map_card, page_of, parameter_table, table
from .collection import Collection, common
from .model import Rasters, TerrainReport
from .report import RunReport

PAGE = "survey.html"
_MOST_TILES, _MOST_PLACES = 500, 50  # rows of tables
_NOT_STATED = "not stated"
_INTERPOLATIONS = {
    "tin": "linear in triangles (TIN)",
    "natural": "natural neighbours",
    "idw": "inverse distance weighting (IDW)",
    "kriging": "kriging",
}
_STYLE = """
img { width: 100%; } .cards { grid-template-columns: repeat(auto-fit, minmax(300px, 1fr)); }
"""


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
    cards = "".join(map_card(layer, rasters.places, collection.units) for layer in rasters.places)
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
    (found, made), crs, name = reports, collection.crs, _NOT_STATED
    if crs is not None:
        code = crs.to_authority()
        name = f"{crs.name} ({':'.join(code)})" if code else crs.name
    side = f"{made.transform[0]:g} x {made.transform[0]:g}"
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
        ("rasters", f"{made.rows:,} rows and {made.columns:,} columns of cells of {side}"),
        ("software", f"jaxfilter {__version__}, JAX {version('jax')}, NumPy {np.__version__}"),
    ]


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
    for report in reports[:1] if reports[0] is reports[1] else reports:
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
