"""Small tables in HTML: how clouds, filters and results show themselves in notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any


def sheet(title: str, rows: Iterable[tuple[str, Any]]) -> str:
    """A titled table of two columns, names and values."""
    return f"<strong>{escape(title)}</strong>" + table((), rows)


def table(heading: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """An HTML table; the first cell of a row is its heading, integers get thousands separators, everything is escaped."""
    head = "".join(f'<th scope="col">{escape(text)}</th>' for text in heading)
    lines = []
    for row in rows:
        first, *others = map(_text, row)
        lines.append(f'<tr><th scope="row">{first}</th>{"".join(f"<td>{cell}</td>" for cell in others)}</tr>')
    top = f"<thead><tr>{head}</tr></thead>" if head else ""
    return f"<table>{top}<tbody>{''.join(lines)}</tbody></table>"


def _text(value: Any) -> str:
    plain = isinstance(value, int) and not isinstance(value, bool)
    return f"{value:,}" if plain else escape(str(value))
