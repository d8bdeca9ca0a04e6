"""Small tables in HTML: how clouds, filters and results show themselves in notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any


def sheet(title: str, rows: Iterable[tuple[str, Any]]) -> str:
    """A titled table of two columns, names and values."""
    return f"<strong>{escape(title)}</strong>" + table((), rows)


def table(heading: Sequence[str], rows: Iterable[Sequence[Any]], numeric: Sequence[int] = ()) -> str:
    """An HTML table; the first cell of a row is its heading, integers get thousands separators, everything is escaped.

    ``numeric``: columns that are set to the right.
    """
    head = "".join(f'<th scope="col"{_side(i in numeric)}>{escape(text)}</th>' for i, text in enumerate(heading))
    lines = []
    for row in rows:
        cells = [_text(value) for value in row]
        tail = "".join(f"<td{_side(i in numeric)}>{cell}</td>" for i, cell in enumerate(cells[1:], 1))
        lines.append(f'<tr><th scope="row"{_side(0 in numeric)}>{cells[0]}</th>{tail}</tr>')
    top = f"<thead><tr>{head}</tr></thead>" if head else ""
    return f"<table>{top}<tbody>{''.join(lines)}</tbody></table>"


def _side(right: bool) -> str:
    return ' style="text-align:right"' if right else ""


def _text(value: Any) -> str:
    plain = isinstance(value, int) and not isinstance(value, bool)
    return f"{value:,}" if plain else escape(str(value))
