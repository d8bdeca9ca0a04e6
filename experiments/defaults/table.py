"""The table of defaults in docs/fidelity.md: values from the classes, their origins from origins.csv.

    python experiments/defaults/table.py

``tests/test_docs.py`` fails where a default or a field changes and this has not been run, or has nothing to say of it.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.report import Row, markdown, read_csv
from jaxfilter.core.params import declared

PAGE = Path(__file__).resolve().parents[2] / "docs" / "fidelity.md"
START, END = "<!-- made by experiments/defaults/table.py -->\n\n", "\n\n<!-- end of the table -->"


def main() -> None:
    """Write the table into the page."""
    PAGE.write_text(page(PAGE.read_text()))


def page(text: str) -> str:
    """The page with the table of today. Raises: ValueError for a field without an origin, or an origin without a field."""
    before, _, rest = text.partition(START)
    _, _, after = rest.partition(END)
    return before + START + markdown(COLUMNS, rows()) + END + after


COLUMNS = [("methods", "methods", ""), ("field", "field", ""), ("value", "default", ""), ("origin", "where from", ""),
           ("looked_at", "labelled data that were looked at", "")]  # fmt: skip


def rows() -> list[Row]:
    """A row per field, or per fields of several methods that have one default and one origin."""
    left = {(name, field.name): field.default for name in jf.FILTERS for field in declared(jf.FILTERS[name])}
    out = []
    for row in read_csv(Path(__file__).parent / "origins.csv"):
        names = row["methods"].split()
        values = {_text(left.pop((name, row["field"]), KeyError)) for name in names}
        if len(values) != 1 or _text(KeyError) in values:
            raise ValueError(
                f"origins.csv: {row['methods']}, {row['field']}: no such field, named twice, or several defaults"
            )
        shown = names if len(names) < len(jf.FILTERS) else ["all"]
        out.append(
            row
            | {"methods": " ".join(f"`{name}`" for name in shown), "field": f"`{row['field']}`", "value": values.pop()}
        )
    if left:
        raise ValueError(f"origins.csv says nothing of {', '.join(f'{name}.{field}' for name, field in left)}")
    return out


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
