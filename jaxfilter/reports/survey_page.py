"""A page that shows the products of a survey: a picture of each raster, and links to the files."""

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

from ..core.version import __version__
from ..files.disk import new_file
from ..files.storage import Place
from ..plots.maps import shade
from ..terrain.layer import Layer

_PIXELS = 900  # of the longer side of a picture
_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,"><title>{title} – {subject}</title><style>{style}</style></head>
<body><header><h1>{title}</h1><p>{about} · jaxfilter {version}</p></header><main>{main}</main></body></html>
"""
_STYLE = """
img { width: 100%; image-rendering: pixelated; } .cards { grid-template-columns: repeat(auto-fit, minmax(300px, 1fr)); }
"""


def page_of(title: str, subject: str, about: str, main: str, style: str = "") -> str:
    """A page of HTML that needs no network. ``subject``, ``about``: in few words; ``main``: HTML; ``style``: more CSS."""
    style = files(__package__).joinpath("page.css").read_text(encoding="utf-8") + style
    return _PAGE.format(title=escape(title), subject=subject, about=about, main=main, style=style, version=__version__)


def write_survey_page(
    page: Place, title: str, outputs: Mapping[Layer, Place], facts: Iterable[tuple[str, Any]], *, overwrite: bool
) -> None:
    """Write the page beside the files of layers. ``facts``: names and values. Raises: OutputError."""
    cards = "".join(
        f'<div><a href="{escape(place.name)}"><b>{escape(place.name)}</b>{_draw(layer, place)}</a>'
        f"<span>{escape(layer.TITLE)}, {escape(layer.UNITS)}</span></div>"
        for layer, place in outputs.items()
    )
    main = f'<div class="cards">{cards}</div><section><h2>Figures</h2>{table((), facts)}</section>'
    with new_file(page, overwrite=overwrite) as temporary:
        text = page_of(title, "survey", "Products of a survey", main, _STYLE)
        temporary.write_text(text, encoding="utf-8")


def _draw(layer: Layer, place: Place) -> str:
    """An image of a raster on this disk; nothing for others."""
    import rasterio
    from matplotlib import colormaps
    from matplotlib.image import imsave

    if layer.cells != layer or not isinstance(place, Path):
        return ""
    with rasterio.open(place) as file:
        step = max(1, math.ceil(max(file.shape) / _PIXELS))
        shape = tuple(math.ceil(side / step) for side in file.shape)
        z = file.read(1, out_shape=shape, masked=True).astype(np.float32).filled(np.nan)
        side = file.transform.a * step
    if layer.STYLE == "relief":
        z = shade(z[::-1], side)[::-1]
    low, high = np.nanpercentile(z, (1, 99)) if np.isfinite(z).any() else (0.0, 1.0)
    colours = colormaps["gray" if layer.STYLE == "relief" else layer.STYLE].with_extremes(bad="white")
    picture = colours(np.ma.masked_invalid((z - low) / max(high - low, 1e-6)))
    imsave(png := io.BytesIO(), picture, format="png")
    return f'<img alt="{escape(layer.TITLE)}" src="data:image/png;base64,{base64.b64encode(png.getvalue()).decode()}">'


def table(heading: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """An HTML table; the first cell of a row is its heading, integers get thousands separators, everything is escaped."""
    head = "".join(f'<th scope="col">{escape(text)}</th>' for text in heading)
    lines = []
    for row in rows:
        first, *others = (f"{value:,}" if type(value) is int else escape(str(value)) for value in row)
        lines.append(f'<tr><th scope="row">{first}</th>{"".join(f"<td>{cell}</td>" for cell in others)}</tr>')
    top = f"<thead><tr>{head}</tr></thead>" if head else ""
    return f"<table>{top}<tbody>{''.join(lines)}</tbody></table>"
