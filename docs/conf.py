"""Sphinx: the pages of the repository as they are, with what is made at build. `sphinx-build -W -c docs . site`.

The source folder is the repository, so that a link from one file to another is right on the site and outside it.
"""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(HERE / "made" / "cache"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
os.environ["JAXFILTER_DATA"] = str(HERE / "made" / "no data")  # so that the site is the same wherever it is built

from jaxfilter import __version__  # noqa: E402

project = "jaxfilter"
author = copyright = "The jaxfilter authors"
release = version = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "extension",
]
root_doc = "docs/index"
include_patterns = [
    "docs/**",
    "experiments/*.md",
    "experiments/**/*.md",
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
]
exclude_patterns = [
    ".*",  # virtual environments are large
    "docs/examples",
    "docs/made/*/*.ipynb",
    "docs/made/*/*.py",
    "docs/made/*/sg_execution_times.rst",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
maximum_signature_line_length = 90
python_use_unqualified_type_names = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

sphinx_gallery_conf = {
    "examples_dirs": ["docs/examples/tutorials", "docs/examples/plots"],
    "gallery_dirs": ["docs/made/tutorials", "docs/made/plots"],
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": ("extension",),
    "ignore_repr_types": r"matplotlib|PosixPath",
    "reset_modules": (),
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,
    "write_computation_times": False,
    "download_all_examples": False,
    "abort_on_example_error": True,
    "remove_config_comments": True,
}

html_theme = "furo"
html_title = "jaxfilter"
html_copy_source = False
html_show_search_summary = False  # they are fetched, which browsers refuse to pages that are opened from a disk
html_show_sphinx = False
html_additional_pages = {"index": "start.html"}
templates_path = [str(HERE / "templates")]
html_static_path = ["static"]
html_css_files = ["site.css"]
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
