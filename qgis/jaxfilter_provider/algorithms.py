"""The algorithms as plain data: how their parameters make the words of a command line. Their help is in ``help/``."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple


class Parameter(NamedTuple):
    """A parameter: its name in scripts, its kind (see ``provider.py``), its label, and the words of the command, in which {} is
    the value. ``default`` is that of the command, so it is not passed on; None: it may be left out."""

    name: str
    kind: str
    label: str
    words: str = ""
    default: Any = None
    tip: str = ""
    choices: Sequence[str] = ()
    advanced: bool = False
    needed: bool = False


class Result(NamedTuple):
    """A file that a command makes: ``pattern`` in the folder, or the file, that the parameter ``of`` names; the style of its
    layer; and its name as an output of the algorithm."""

    of: str
    pattern: str = ""
    style: str = ""
    name: str = ""


class Algorithm(NamedTuple):
    """An algorithm: its id, title, parameters and results, and the words that stand first: the command and parameters."""

    name: str
    title: str
    line: str
    parameters: Sequence[Parameter]
    results: Sequence[Result] = ()


needed, advanced = partial(Parameter, needed=True), partial(Parameter, advanced=True)
METHODS, LAYERS, EXTRAS = json.loads((Path(__file__).parent / "choices.json").read_text("utf-8")).values()
UNITS = ["as the CRS says", "m", "ft", "us-ft"]
FILES = "LAS, LAZ, COPC or text. Layers are read from their files; their filters and unsaved edits have no effect."
BY_DATA = "The default is set up for the data. For the others, what depends on point spacing is set from the data."
AREA = "Only points in these polygons are written. Labels and heights are those of the whole survey."
DOUBT = "In metres or degrees. Doubt is the chance that a label is wrong; the default method and ost have it."
ONE_FILE = "Then no folder is made. A file that ends in .copc.laz opens in QGIS from 3.26 on without an index."
COLUMNS = "x, y, z, and if you like land_cover and vertical_datum"
# fmt: off
method = partial(Parameter, "METHOD", "choice", "Method", default="default", tip=BY_DATA, choices=["default", *METHODS])
CLOUDS = [
    Parameter("INPUT", "clouds", "Points: layers or files", "{}", tip=FILES),
    Parameter("FOLDER", "folder", "Points: or a folder of files", "{}"),
]
STATED = [
    advanced("CRS", "crs", "CRS of files that state none", "--crs {}", tip="Outputs state it; nothing is reprojected."),
    advanced("UNITS", "choice", "Units of X, Y and Z", "--units {}", UNITS[0], choices=UNITS),
]
READING = [
    Parameter("AOI", "polygons", "Area of interest", "--aoi {}", tip=AREA),
    advanced("LARGEST_BUILDING", "number", "Width of the largest building, metres", "--largest-building {}"),
    *STATED,
    advanced("RETURNS", "text", "Echoes to judge: first, intermediate, last, only, or all", "--returns {}", "last,only"),
]
CLASSES = [
    advanced("GROUND_CLASS", "class", "Class for ground points", "--ground-class {}", 2),
    advanced("OTHER_CLASS", "class", "Class for points that are no ground any more", "--other-class {}", 1),
]
CLASSIFIED = advanced("GROUND_CLASS", "class", "Class of ground points", "--ground-class {}", 2)
OUTLINES = Parameter("BREAKLINES", "new places", "Outlines of water bodies, with their level", "--breaklines {}")
LIMITS = [
    advanced("WORKERS", "count", "Number of processes", "--workers {}"),
    advanced("MEMORY", "text", "Memory for all processes, such as 4GB", "--memory {}"),
    advanced("MORE", "words", "Further options of the command, as on the command line", tip="See jaxfilter COMMAND --help."),
]
RUN = [
    Parameter("OVERWRITE", "switch", "Replace what exists", "--overwrite", False),
    advanced("RESUME", "switch", "Go on with the run that was begun for this output", "--resume", False),
    *LIMITS,
]
SURVEY = [
    *READING, advanced("TILE", "number", "Side of the tiles of large data, metres", "--tile {}"), *RUN,
    Parameter("LOAD", "switch", "Load the results into the project", "", True),
]
ALGORITHMS = [
    Algorithm("ground", "Classify ground points", "ground METHOD INPUT FOLDER OUTPUT_FILE OUTPUT", [
        *CLOUDS, method(words="{} --for-cloud"),
        advanced("EXTRA", "choices", "Quantities to write as extra dimensions", "--extra {}", tip=DOUBT, choices=EXTRAS),
        *CLASSES, advanced("NOISE_CLASS", "class", "Class for low outliers (ASPRS: 7)", "--noise-class {}"),
        advanced("WATER_CLASS", "class", "Class for points of water (ASPRS: 9)", "--water-class {}"),
        advanced("BRIDGE_CLASS", "class", "Class for points of bridge decks (ASPRS: 17)", "--bridge-class {}"), *SURVEY,
        needed("OUTPUT", "new folder", "Folder for the classified files", "{}"),
        Parameter("OUTPUT_FILE", "new points", "Or one classified file, of one input", "{}", tip=ONE_FILE),
        Parameter("REVIEW", "new places", "List of places to check", "--review {}"), OUTLINES,
    ], [Result("OUTPUT", "*.la[sz]", "classes"), Result("OUTPUT_FILE", "", "classes"), Result("REVIEW", "", "places"),
        Result("BREAKLINES")]),
    Algorithm("products", "Make terrain products", "products INPUT FOLDER OUTPUT", [
        *CLOUDS, method(words="--filter {} --for-cloud"),
        Parameter("CLASSIFIED", "switch", "The points are classified: class 2 is the ground", "--ground-class 2", False),
        Parameter("ONLY", "list", "Products (none chosen: all)", "--only {}", choices=LAYERS),
        Parameter("CELL", "number", "Side of a cell", "--cell {}", 1.0),
        advanced("CELL_UNITS", "choice", "Units of the side of a cell", "--cell-units {}", "file", choices=["file", "m"]),
        *SURVEY, needed("OUTPUT", "new folder", "Folder for the products", "{}"), OUTLINES,
    ], [
        Result("OUTPUT", "classified/*.la[sz]", "classes"),
        Result("OUTPUT", "dtm.tif", "", "DTM"),
        Result("OUTPUT", "hillshade.tif", "hillshade", "HILLSHADE"),
        Result("OUTPUT", "survey.html", "", "PAGE"), Result("BREAKLINES"),
    ]),
    Algorithm("review", "List places to check", "review INPUT FOLDER OUTPUT", [
        *CLOUDS, CLASSIFIED, *STATED, *RUN,
        needed("OUTPUT", "new places", "List of places", "{}"),
    ], [Result("OUTPUT", "", "places")]),
    Algorithm("apply", "Apply verdicts", "apply PLACES INPUT FOLDER", [
        needed("PLACES", "list of places", "List of places with verdicts", "{}"),
        *CLOUDS, *CLASSES, *STATED, *LIMITS,
    ]),
    Algorithm("accuracy", "State the accuracy", "accuracy INPUT FOLDER MODEL OUTPUT", [
        *CLOUDS, needed("MODEL", "raster", "Terrain model", "{}"),
        Parameter("CHECKPOINTS", "table", "Check points (CSV)", "--checkpoints {}", tip=COLUMNS),
        CLASSIFIED, *STATED, *RUN,
        needed("OUTPUT", "new page", "Statement", "{}"),
    ]),
]
# fmt: on


def words(parameter: Parameter, value: Any) -> list[str]:
    """The words of a parameter; none for an empty value, and for the default of a flag or choice."""
    if parameter.kind == "words":
        return shlex.split((value or "").replace("\\", "\\" * (1 + (os.name == "nt"))))  # there \ parts folders
    if value is False or value in (None, "", []) or (value == parameter.default and parameter.words != "{}"):
        return []
    values = [one for one in (value if isinstance(value, (list, tuple)) else [value]) if one != ""]  # '' of widgets
    if parameter.kind == "list":
        values = [",".join(values)] * bool(values)
    return [word.replace("{}", str(one)) for one in values for word in parameter.words.split()]


def command_line(algorithm: Algorithm, values: Mapping[str, Any]) -> list[str]:
    """The command line of an algorithm, without the program, from the values of its parameters by name."""
    made = {one.name: words(one, values.get(one.name)) for one in algorithm.parameters}
    if made.get("OUTPUT_FILE"):
        made["OUTPUT"] = []
    command, *first = algorithm.line.split()
    rest = [word for name, part in made.items() if name not in first for word in part]
    return [command, *(word for name in first for word in made[name]), *rest]


def in_labels(algorithm: Algorithm, text: str) -> str:
    """A message of the command, with the label of a parameter beside its flag."""
    for one in algorithm.parameters:
        flag = one.words.split(" ")[0]
        if flag.startswith("--"):
            text = re.sub(rf"{flag}(?![\w-])", lambda found, one=one: f'{found[0]} (here: "{one.label}")', text)
    return text
