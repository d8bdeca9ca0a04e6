"""Tables of figures as Markdown and LaTeX."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]
Column = tuple[str, str, str]
"""Key in the row, heading, and format of the values (as in ``format(value, spec)``; none for text)."""


class Marked(str):
    """A cell with markup of its own, which is not escaped."""


def markdown(columns: Sequence[Column], rows: Iterable[Row]) -> str:
    """A Markdown table. Values that are absent, None or NaN are shown as a dash; numbers are set to the right,
    and bars in text are escaped."""
    heading = "| " + " | ".join(_barred(title) for _, title, _ in columns) + " |"
    rule = "|" + "|".join("---:" if spec else "---" for _, _, spec in columns) + "|"
    lines = ["| " + " | ".join(_barred(_cell(row.get(key), spec)) for key, _, spec in columns) + " |" for row in rows]
    return "\n".join([heading, rule, *lines])


def latex(columns: Sequence[Column], rows: Iterable[Row]) -> str:
    """The same as a LaTeX ``tabular`` with the rules of booktabs; what LaTeX takes for a command is escaped."""
    sides = "".join("r" if spec else "l" for _, _, spec in columns)
    heading = " & ".join(_escaped(title) for _, title, _ in columns)
    lines = [" & ".join(_escaped(_cell(row.get(key), spec, "--")) for key, _, spec in columns) for row in rows]
    body = "".join(f"{line} \\\\\n" for line in lines)
    return (
        f"\\begin{{tabular}}{{{sides}}}\n\\toprule\n{heading} \\\\\n\\midrule\n{body}\\bottomrule\n\\end{{tabular}}\n"
    )


def _cell(value: Any, spec: str, absent: str = "–") -> str:
    if value is None or value == "" or (isinstance(value, float) and math.isnan(value)):
        return absent
    return value if isinstance(value, str) else format(value, spec)


_LATEX = str.maketrans(
    {c: f"\\{c}" for c in "&%$#_{}"}
    | {"\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}"}
)


def _barred(text: str) -> str:
    """Text in which bars do not end a cell of Markdown."""
    return re.sub(r"(?<!\\)\|", r"\\|", text)


def _escaped(text: str) -> str:
    return text if isinstance(text, Marked) else text.translate(_LATEX)
