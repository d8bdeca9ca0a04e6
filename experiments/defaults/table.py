"""The tables of parameters on the pages of the methods: values from the classes, their origins from origins.csv.

    python experiments/defaults/table.py

``tests/test_docs.py`` fails where a default or a field changes and this has not been run, or a field has no origin.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.report import read_csv
from jaxfilter.core.params import declared

PAGES = Path(__file__).resolve().parents[2] / "docs" / "filters"
HEAD = (
    "| parameter | symbol | unit | default | meaning | [origin](../fidelity.md#where-the-defaults-come-from) |\n"
    "|---|---|---|---|---|---|\n"
)


def main() -> None:
    """Write the tables into the pages that have one with origins."""
    for name in jf.FILTERS:
        path = PAGES / f"{name}.md"
        before, head, rest = path.read_text().partition(HEAD)
        if head:
            path.write_text(before + head + "\n".join(rows(name)) + "\n\n" + rest.partition("\n\n")[2])


def rows(name: str) -> list[str]:
    """The rows of a method's table. Raises: KeyError for a field without an origin."""
    known = origins()
    return [row(field, known[name, field.name]) for field in declared(jf.FILTERS[name])]


def row(field: dataclasses.Field[Any], *more: str) -> str:
    """What the class says of a parameter, and further cells."""
    meta, default = field.metadata, field.default
    value = f"{default:g}" if isinstance(default, float) else f"{default}"
    cells = [f"`{field.name}`", meta.get("symbol") or "", meta.get("unit") or "", value, meta["doc"], *more]
    return f"| {' | '.join(cells)} |"


def origins() -> dict[tuple[str, str], str]:
    """By method and field: where the default comes from and, in brackets, labelled data whose errors were known."""
    found: dict[tuple[str, str], str] = {}
    for line in read_csv(Path(__file__).parent / "origins.csv"):
        seen = "" if line["looked_at"] == "none" else f" ({line['looked_at']})"
        for name in line["methods"].split():
            if (name, line["field"]) in found:
                raise ValueError(f"origins.csv: {name}, {line['field']}: named twice")
            found[name, line["field"]] = f"{line['origin']}{seen}"
    return found


if __name__ == "__main__":
    main()
