"""What the site must hold: an entry for every public name, and links that lead somewhere."""

from __future__ import annotations

import types
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from urllib.parse import unquote, urlsplit

import jaxfilter as jf

ARRAYS = (
    "engines.cloth.surface",
    "engines.grid.cells",
    "engines.grid.cones",
    "engines.grid.inpaint",
    "engines.grid.morphology",
    "engines.grid.sampling",
    "engines.grid.spread",
    "engines.grid.windows",
    "engines.tin.facets",
    "metrics",
    "steps.planes",
)
"""Modules that docs/arrays.md describes."""


def public_names() -> list[str]:
    """Every name that users may rely on, as ``module.name``."""
    names = [f"jaxfilter.{name}" for name in jf.__all__ if not isinstance(getattr(jf, name), types.ModuleType)]
    names += [f"jaxfilter.scenes.{name}" for name in jf.scenes.__all__]
    for module in (jf.plots, jf.datasets, *(import_module(f"jaxfilter.{name}") for name in ARRAYS)):
        for name, value in vars(module).items():
            home = getattr(value, "__module__", module.__name__) or ""
            ours = home == module.__name__ or (module is jf.plots and home.startswith("jaxfilter.plots."))
            constant = name.isupper() and module is jf.plots
            if not name.startswith("_") and ((callable(value) and ours) or constant):
                names.append(f"{module.__name__}.{name}")
    return names


class Page(HTMLParser):
    """Links and anchors of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.size = path.stat().st_size
        self.pictures: list[str] = []
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        """Keep what leads somewhere or can be led to."""
        for key, value in attributes:
            if key == "id" or (key == "name" and tag == "a"):
                self.anchors.add(value or "")
            elif key in ("href", "src") and value:
                self.links.append(value)
                self.pictures += [value] * (tag in ("img", "script", "link"))


def broken_links(site: Path) -> list[str]:
    """Links of a built site that lead nowhere within it, or that load something from elsewhere."""
    pages = {path.resolve(): Page(path) for path in sorted(site.rglob("*.html")) if "_modules" not in path.parts}
    found = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                found += [f"{path.relative_to(site)}: loads {link}"] * (
                    link in page.pictures and parts.scheme != "data"
                )
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists():
                found.append(f"{path.relative_to(site)}: {link} does not exist")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
                found.append(f"{path.relative_to(site)}: {link} has no such anchor")
    return found


def weight(site: Path, page: str) -> int:
    """Bytes of a page with all that it loads from the site."""
    path = (site / page).resolve()
    one = Page(path)
    loaded = {
        (path.parent / unquote(urlsplit(link).path)).resolve() for link in one.pictures if not urlsplit(link).netloc
    }
    return one.size + sum(file.stat().st_size for file in loaded if file.is_file())
