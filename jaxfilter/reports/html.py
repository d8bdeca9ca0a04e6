"""Pages of HTML that need no network, and tables on them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from typing import Any

from ..core.params import declared
from ..core.version import __version__
from ..methods import FILTERS

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,"><title>{title} – {subject}</title><style>{style}</style></head>
<body><header><h1>{title}</h1><p>{about} · jaxfilter {version}</p></header><main>{main}</main></body></html>
"""


def page_of(title: str, subject: str, about: str, main: str, style: str = "") -> str:
    """A page of HTML that needs no network. ``subject``, ``about``: in few words; ``main``: HTML; ``style``: more CSS."""
    style = files(__package__).joinpath("page.css").read_text(encoding="utf-8") + style
    return _PAGE.format(title=escape(title), subject=subject, about=about, main=main, style=style, version=__version__)


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
