"""What the site has beyond Sphinx: pictures of the stages of every method, links, and checks that fail the build."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

import checks
import stages
from docutils import nodes
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx_gallery.scrapers import figure_rst

import jaxfilter as jf
from jaxfilter.terrain.layers import LAYERS

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = {"docs/examples/tutorials": "docs/made/tutorials", "docs/examples/plots": "docs/made/plots"}
SAMPLES, TILES = "experiments/isprs/results/results.md", "experiments/tiles/results/results.md"
OWN = "experiments/default/results/results.md"
log = logging.getLogger(__name__)


def _get_sg_image_scraper() -> Any:
    """How sphinx-gallery asks for a scraper by the name of its module."""
    return figures


def figures(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Scraper of sphinx-gallery: figures that a block has made, without pyplot, in the order of their names."""
    made: list[str] = []
    for value in list(block_vars["example_globals"].values()):
        figure = value.figure if isinstance(value, Axes) else value
        if isinstance(figure, Figure) and not getattr(figure, "_on_page", False):
            path = next(block_vars["image_path_iterator"])
            figure.savefig(path, dpi=110, bbox_inches="tight")
            figure._on_page = True  # type: ignore[attr-defined]
            made.append(path)
    return figure_rst(made, gallery_conf["src_dir"])


@cache
def table(page: str, *headings: str) -> list[dict[str, str]]:
    """The first table of a page after some headings, one within the other; the first word of each row is its name."""
    part = (ROOT / page).read_text()
    for heading in headings:
        part = part[part.index(heading) :]
    lines = part[part.index("\n|") + 1 :].partition("\n\n")[0].splitlines()
    columns, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    return [{"name": cells[0].split()[0], **dict(zip(columns, cells, strict=True))} for cells in rows]


def as_markdown(rows: list[tuple[str, ...]]) -> str:
    """A table whose first row is its heading."""
    heading, *others = (f"| {' | '.join(cells)} |\n" for cells in rows)
    return "\n" + heading + "|---|" + "---:|" * (len(rows[0]) - 1) + "\n" + "".join(others)


def errors(name: str) -> str:
    """What the experiments say of a method: on the samples of ISPRS, and on the labelled tiles."""
    if name == "ost":
        every = [(row["name"], *row["first"].split(" / ")) for row in table(OWN, "## Every sample and tile")]
        about = (
            f"Samples of ISPRS and labelled tiles, on which its constants were chosen; from [experiments](../../{OWN})."
        )
        return f"\n## Errors\n\n{about}\n" + as_markdown([("cloud", "total error, %", "kappa, %"), *every])

    def of(row: dict[str, str]) -> str:
        return next(value for key, value in row.items() if key.split()[0].lower() == name)

    samples = [
        (row["name"], of(row), of(other))
        for row, other in zip(
            *(table(SAMPLES, f"### {kind} per sample, fixed") for kind in ("Total error", "Kappa")), strict=True
        )
    ]
    both = [{row["name"]: row for row in table(TILES, f"## {kind}, %")}[name] for kind in ("Total error", "Kappa")]
    tiles = [(tile, both[0][tile], both[1][tile]) for tile in list(both[0])[2:-1]]
    about = (
        "Defaults for the cloud, nothing chosen per cloud. Some defaults were chosen on these data or with their errors known: "
        "[where the defaults come from](../fidelity.md#where-the-defaults-come-from). On the [samples of ISPRS]"
        f"(../../{SAMPLES}):"
    )
    return (
        f"\n## Errors\n\n{about}\n"
        + as_markdown([("sample", "total error, %", "kappa, %"), *samples])
        + f"\nOn six [labelled tiles](../../{TILES}):\n"
        + as_markdown([("tile", "total error, %", "kappa, %"), *tiles])
    )


def layers() -> str:
    """A table of the rasters and lines of a survey, from their list."""
    text = "| file | what | values | command |\n|---|---|---|---|\n"
    for name, entry in LAYERS.items():
        file, kind = f"`{name}{entry.kind.SUFFIXES[0]}`", entry.kind
        text += f"| {file} | {entry.help} | {kind.TITLE}, {kind.UNITS} | `jaxfilter {name}` |\n"
    return text


def commands() -> str:
    """The help of every command, as it is printed."""
    from click.testing import CliRunner

    from jaxfilter.cli import main
    from jaxfilter.cli.commands import workflow

    def printed(*words: str) -> str:
        text = CliRunner().invoke(main, [*words, "--help"], prog_name="jaxfilter", terminal_width=100).stdout
        return f"```text\n{text}```\n\n"

    text = printed()
    for title, names in workflow().items():
        text += f"## {title}\n\n" + "".join(f"### {name}\n\n{printed(name)}" for name in names)
    return text + "## Methods\n\n" + "".join(f"### ground {name}\n\n{printed('ground', name)}" for name in jf.FILTERS)


def with_stages(app: Sphinx, docname: str, source: list[str]) -> None:
    """Pages of methods get pictures of their stages and figures from the experiments; those on reports, products and commands
    get a report, a table and the help of all commands."""
    if docname == "docs/products":
        source[0] = source[0].replace("<!-- table of layers: docs/extension.py -->\n", layers())
    if docname == "docs/commands":
        source[0] = source[0].replace("<!-- help of all commands: docs/extension.py -->\n", commands())
    if docname == "docs/reports":
        stages.sample_report(Path(app.outdir) / "report.html")
        link = '<a href="../report.html">A report to try</a>, of SMRF on a simulated town.'
        source[0] = source[0].replace("\n\n", f"\n\n{link}\n\n", 1)
    found = re.fullmatch(r"docs/filters/(\w+)", docname)
    if not found or found[1] not in jf.FILTERS:
        return
    name = found[1]
    before, heading, after = source[0].partition("## Parameters")
    caption = stages.draw(name, ROOT / "docs/made/stages" / f"{name}.png")
    text = f"## Stages\n\n![{caption}](../made/stages/{name}.png)\n\n{caption}\n\n"
    after += errors(name)
    after += f"\n## To cite\n\n```bibtex\n{jf.citation(name)}\n```\n"
    source[0] = before + text + heading + after


def house_style(app: Sphinx, what: str, name: str, value: Any, options: Any, lines: list[str]) -> None:
    """Docstrings may have ``Returns: text`` on one line, with what goes on indented, and ``|height|`` for a magnitude."""
    out, inside = [], False
    for line in lines:
        found = re.match(r"(Returns|Raises|Yields|Warns): (.+)", line)
        inside = bool(found) or (inside and bool(line.strip()))
        if found:
            out += ["", f"**{found[1]}:** {found[2]}"]
        else:
            out.append(line.strip() if inside else line)
        if not out[-1].lstrip().startswith(">>>"):
            out[-1] = re.sub(r"(?<!`)\|(\w+)\|", r"\\|\1\\|", re.sub(r"(?<=[.)]) Raises: ", " **Raises:** ", out[-1]))
    lines[:] = out


def linked(app: Sphinx, doctree: nodes.document) -> None:
    """A link to an example leads to the page that it makes; one to a folder of the repository is text on the site."""
    here = Path(app.env.doc2path(app.env.current_document.docname)).parent
    for node in list(doctree.findall(addnodes.pending_xref)):
        if (target := node.get("reftarget")) and node.get("reftype") == "myst" and (here / target).is_dir():
            node.replace_self(node.children)
    for node in list(doctree.findall(addnodes.download_reference)):
        start = ROOT if node["reftarget"].startswith("/") else here
        target = (start / node["reftarget"].lstrip("/")).resolve()
        folder = target.parent.relative_to(ROOT).as_posix()
        if folder in EXAMPLES and target.suffix == ".py":
            page = addnodes.pending_xref(
                "", *node.children, refdomain="std", reftype="doc", reftarget=f"/{EXAMPLES[folder]}/{target.stem}",
                refexplicit=True, refdoc=app.env.current_document.docname, refwarn=True,
            )  # fmt: skip
            node.replace_self(page)


def complete(app: Sphinx, env: Any) -> None:
    """Every public name has an entry."""
    objects = env.domains.python_domain.objects
    for name in checks.public_names():
        if name not in objects:
            log.warning("%s has no entry in docs/api", name)


def whole(app: Sphinx, exception: Exception | None) -> None:
    """What is only seen in the finished site."""
    if exception or app.builder.name != "html":
        return
    site = Path(app.outdir).resolve()
    found = checks.broken_links(site)
    size = checks.weight(site, "docs/index.html")
    found += [f"docs/index.html weighs {size / 1e6:.1f} MB; 1 MB is the limit"] * (size > 1e6)
    for line in found:
        log.warning("%s", line)
    if found:
        app.statuscode = 1


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect all of it."""
    app.connect("source-read", with_stages)
    app.connect("doctree-read", linked)
    app.connect("autodoc-process-docstring", house_style, priority=400)
    app.connect("env-updated", complete)
    app.connect("build-finished", whole)
    return {"parallel_read_safe": False, "parallel_write_safe": True}  # JAX must not be forked
