"""Parts of pages for clients: the page around them, maps with legends, tables."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ..core.params import declared
from ..core.units import Units
from ..core.version import __version__
from ..files.storage import Place
from ..methods import FILTERS
from ..plots.maps import new_figure, shade
from ..terrain.layer import Layer

_PIXELS = 900  # of the longer side of a picture
_MOST_LINES = 100_000  # contour lines that are drawn
_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,"><title>{title} – {subject}</title><style>{style}</style></head>
<body><header><h1>{title}</h1><p>{about} · jaxfilter {version}</p></header><main>{main}</main></body></html>
"""


def page_of(title: str, subject: str, about: str, main: str, style: str = "") -> str:
    """A page of HTML that needs no network. ``subject``, ``about``: in few words; ``main``: HTML; ``style``: more CSS."""
    style = files(__package__).joinpath("page.css").read_text(encoding="utf-8") + style
    return _PAGE.format(title=escape(title), subject=subject, about=about, main=main, style=style, version=__version__)


def map_card(layer: Layer, places: Mapping[Layer, Place], units: Units) -> str:
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
        image = ax.imshow(
            shown, "gray" if relief else layer.STYLE, extent=extent, vmin=low, vmax=high if high > low else low + 1
        )
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
