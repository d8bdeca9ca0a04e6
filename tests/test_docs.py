"""Every filter has a page that lists its parameters as they are declared, and the skeleton of a filter is one."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from jaxfilter import FILTERS
from jaxfilter.core.params import declared

PAGES = Path(__file__).resolve().parents[1] / "docs" / "filters"
sys.path.insert(0, str(PAGES.parents[1]))

from experiments.defaults import table  # noqa: E402


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
    notes = [f"| `{preset}` | {values.note} |" for preset, values in FILTERS[name].PRESETS.items()]
    assert listed[len(fields) :][: len(notes)] == notes, "\n".join(notes)


@pytest.mark.parametrize("name", list(FILTERS))
def test_every_preset_says_what_it_is_and_paper_what_is_not_as_printed(name):
    for preset, values in FILTERS[name].PRESETS.items():
        assert values.note and "\n" not in values.note, preset
    paper = FILTERS[name].PRESETS["paper"].note
    assert re.match(r"as (printed|reported)\b", paper), paper


def test_the_table_of_defaults_names_every_field_with_its_present_default():
    text = (PAGES.parent / "fidelity.md").read_text()
    assert text == table.page(text), "run experiments/defaults/table.py"
    lines = [line.split(" | ") for line in text.partition(table.START)[2].splitlines() if line.startswith("| `")]
    listed = [(name, cells[1], cells[2]) for cells in lines for name in re.findall(r"`(\w+)`", cells[0])]
    for name in FILTERS:
        for field in declared(FILTERS[name]):
            default = f"{field.default:g}" if isinstance(field.default, float) else f"{field.default}"
            assert listed.count((name, f"`{field.name}`", default)) == 1, (name, field.name, default)


def test_the_skeleton_of_a_filter_passes_the_suite_of_all_filters(tmp_path):
    text = (PAGES.parent / "adding_a_filter.md").read_text()
    skeleton = tmp_path / "skeleton.py"
    skeleton.write_text(re.search(r"```python\n(.*?)```", text, re.DOTALL)[1])
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-v", "-x", "-p", "no:cacheprovider", "tests/test_filters.py"]
        + ["--filter-file", str(skeleton), "-k", "tophat"],
        cwd=PAGES.parents[1],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert re.search(r"[3-9]\d passed", done.stdout), done.stdout[-300:]
