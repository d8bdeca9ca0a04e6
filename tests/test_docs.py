"""Every filter has a page that lists its parameters as they are declared."""

from pathlib import Path

import pytest

from jaxfilter import FILTERS
from jaxfilter.core.params import declared

PAGES = Path(__file__).resolve().parents[1] / "docs" / "filters"


def row(field):
    """The table row of a parameter."""
    meta = field.metadata
    symbol, unit = (meta.get(key) or "" for key in ("symbol", "unit"))
    default = f"{field.default:g}" if isinstance(field.default, float) else f"{field.default}"
    return f"| `{field.name}` | {symbol} | {unit} | {default} | {meta['doc']} |"


@pytest.mark.parametrize("name", list(FILTERS))
def test_the_page_of_a_filter_lists_its_parameters_and_presets(name):
    text = (PAGES / f"{name}.md").read_text()
    listed = [line for line in text.splitlines() if line.startswith("| `")]
    fields = [row(field) for field in declared(FILTERS[name])]
    assert listed[: len(fields)] == fields, "\n".join(fields)
    for preset in FILTERS[name].PRESETS:
        assert f"`{preset}`" in text
