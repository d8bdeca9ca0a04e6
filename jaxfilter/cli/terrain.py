"""From points to rasters and contours of their terrain, a command for each; ``products``, to all of them; ``height``."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..terrain.layers import LAYERS
from .commands import REVIEW, command, main
from .options import (
    BOUNDS,
    BREAKLINES,
    DUPLICATES,
    FILTER,
    GROUND_OPTIONS,
    PRESET_OF_CLASSES,
    READING,
    RUN_OPTIONS,
    Files,
    check_inputs,
    check_shapes,
    check_target,
    open_files,
    take,
    take_classes,
    take_recipe,
)
from .output import SESSION, Answer, answer_of, count, in_session, plan_answer, run_facts, tell, times
from .session import BadUsage, Session, logger
from .values import BOX, CLASS, IN_OUT, INPUT, METRES, option

if TYPE_CHECKING:
    from ..surveys.model import TerrainReport
    from ..surveys.report import RunReport
    from ..surveys.surroundings import GroundSource
    from ..terrain.layer import Layer


CELL = [
    option("--cell", "Side of a cell. --cell-units names the unit.", float, default=1.0),
    option(
        "--cell-units", "Unit of --cell: that of the files, or metres.", click.Choice(["file", "m"]), default="file"
    ),
    option("--like", "A raster whose cells the new rasters have, instead of --cell and bounds.", INPUT),
    option("--nodata", "Number that stands for no value in rasters of decimal numbers.  [default: -9999]", float),
]
_GAP = option("--max-gap", "Cells farther than this from every ground point get no height, in file units.", float)
_LARGEST_EDGE = option(
    "--max-edge",
    "The model ends where ground points at its edge are farther apart, in metres; inf: at their hull.  [default: 5 m and 3 "
    "times their spacing]",
    float,
)
_MODEL = [
    option("--method", "Interpolation: tin, natural, idw or kriging.", default="tin"),
    _GAP,
    _LARGEST_EDGE,
    option("--fill", "Give cells outside the hull of the ground points a height too.", bool),
    option("--neighbours", "Number of nearest ground points that idw and kriging use.", int, default=12),
    option("--power", "Power of the distance that idw uses.", float, default=2.0),
    option("--level-water/--raw-water", "Give water its level, or the triangles of its points.", bool, default=True),
]


class LayerCommand(click.Command):
    """The command of a layer, whose options are made when it is called."""

    def __init__(self, name: str) -> None:
        super().__init__(name, short_help=f"Make {LAYERS[name].help}.")

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """Take the words apart as the layer does."""
        assert self.name is not None
        return layer_command(self.name).make_context(info_name, args, parent, **extra)


main.layer_command = LayerCommand


def layer_command(name: str) -> click.Command:
    """The command of a layer, with its settings as options."""
    kind = LAYERS[name].kind
    form = "a GeoPackage or GeoJSON" if kind.SUFFIXES[0] == ".gpkg" else "a Cloud Optimized GeoTIFF"
    of_raster = "IN may be a raster of heights (.tif) as well: nothing is triangulated anew.\n\n    " * kind.OF_RASTER
    help = f"""Make {LAYERS[name].help}, as {form}.

    IN is a file, or IN are folders, patterns, several files, a virtual point cloud (.vpc) or URLs.

    {of_raster}The ground points are those of class 2 of IN, or of label 0 in text, or those that --filter finds. Cells begin at
    multiples of --cell, in the CRS and units of IN. If OUT is -, the file goes to standard output.
    """
    area = "Bounds of the raster, in file units.  [default: the extent of IN]"
    shared = (*GROUND_OPTIONS, option("--bounds", area, float, nargs=4, metavar=BOX), *RUN_OPTIONS[:-1])
    own = [*map(_option_of, dataclasses.fields(kind)), *(_MODEL if kind.MODEL else ())]

    def run(session: Session, names: tuple[str, ...], **options: Any) -> Answer:
        from ..files.storage import place_of
        from ..surveys.model import Rasters, make_rasters
        from ..terrain.interpolation import Interpolation
        from ..terrain.raster import RASTER_SUFFIXES

        layer = take(kind, options)
        if kind.OF_RASTER and len(names) == 2 and Path(names[0]).suffix.lower() in RASTER_SUFFIXES:
            return _of_raster(layer, names, options, {field.name for field in dataclasses.fields(kind)})
        how = take(Interpolation, options)
        ground = _ground(options)
        files = open_files(session, names, options, layer.SUFFIXES)
        assert files.out is not None
        cell, side = _side(files, options)
        wanted = Rasters({layer: place_of(files.out)}, options["like"] or cell, how, nodata=options["nodata"])
        report = files.do(make_rasters, wanted, ground)
        if report.forecast is not None:
            return plan_answer(report.forecast)
        return _answer(report, files, f"{_cells(report, side)}\n{name}: ", "cell")

    return click.Command(name, params=[IN_OUT, *CELL, *own, *shared, *SESSION], help=help, callback=in_session(run))


def _of_raster(layer: Layer, names: tuple[str, ...], options: dict[str, Any], own: set[str]) -> Answer:
    """What is made of a raster of heights. Raises BadUsage for options that are about points."""
    from ..files.storage import place_of

    context, (source, out) = click.get_current_context(), names
    for one in context.command.params:
        given = context.get_parameter_source(str(one.name)) is click.core.ParameterSource.COMMANDLINE
        if given and isinstance(one, click.Option) and one.name in options and one.name not in (*own, "overwrite"):
            raise BadUsage(f"{one.opts[0]} is about points, and {source} is a raster: leave it out")
    check_inputs([source])
    check_target(place_of(out), options["overwrite"], layer.SUFFIXES)
    layer.from_raster(Path(source), place_of(out), options["overwrite"])
    return Answer({"input": source, "output": out}, f"{out}: {layer.NAME} of {source}")


def _option_of(field: dataclasses.Field[Any]) -> click.Option:
    """The option of a setting of a layer."""
    many = isinstance(field.default, tuple)
    words = f"--{field.name.removesuffix('s') if many else field.name} {field.name}"
    kind = METRES if field.metadata["metres"] else float if many else type(field.default)
    return option(words, field.metadata["help"], kind, multiple=many, default=field.default)


def _side(files: Files, options: dict[str, Any]) -> tuple[float, str]:
    """Of a cell, in file units, and with its unit in words, which are empty for those of another raster."""
    units, cell = files.collection.units, options["cell"]
    if options["like"] is not None:
        return cell, ""
    if options["cell_units"] == "file" or units.xy == 1.0:
        return cell, f"{cell:g} {units.name}"
    return cell / units.xy, f"{cell:g} m ({cell / units.xy:.6g} {units.name})"


def _cells(report: TerrainReport, side: str) -> str:
    """What rasters are, in words."""
    side = side or f"{report.transform[0]:g} units"
    text = f"{report.rows:,} x {report.columns:,} cells of {side} through {report.ground:,} ground points"
    return f"{text}, {report.empty:,} cells without a value"


@command(
    IN_OUT,
    *FILTER,
    *READING,
    PRESET_OF_CLASSES,
    option(
        "--ground-class known", "Points of this class of IN are the ground; classify no files.", CLASS, multiple=True
    ),
    _GAP,
    _LARGEST_EDGE,
    option("--interval", "Difference of elevation between contours, in units of Z.", float, default=1.0),
    option(
        "--azimuth", "Where the light of the hillshade comes from, degrees from north to east.", float, default=315.0
    ),
    option("--only", f"What is made, with commas between: {','.join(LAYERS)}.  [default: everything]", "NAMES"),
    *CELL,
    _MODEL[0],
    REVIEW,
    BREAKLINES,
    *RUN_OPTIONS[:-1],
)
def products(session: Session, names: tuple[str, ...], **options: Any) -> Answer:
    """Classify a survey, and make all rasters and contour lines of it.

    IN is a file, or IN are folders, patterns, several files, a virtual point cloud (.vpc) or URLs. OUT is a folder. It gets the
    folder classified/ (as from jaxfilter ground), one file of each raster, such as dtm.tif, contours.gpkg, and survey.html, a
    page that shows them.

    The default method finds the ground, unless --filter names another one. --resume continues a run that was stopped.
    """
    from ..files.classes import Classes
    from ..surveys.products import products as make_products
    from ..terrain.interpolation import Interpolation

    interpolation = take(Interpolation, options)  # before the filter, whose method has another option
    recipe, classes, known = take_recipe(options), take_classes(options), options.pop("known")
    if recipe is not None and known:
        raise BadUsage(
            "--filter and --ground-class: the first finds the ground, the second says which points it is: pass one of the two"
        )
    if known and classes != Classes():
        raise BadUsage(
            "--classes and --ground-class: no classified files are written if the ground is known: leave out one of the two"
        )
    only = list(LAYERS) if options["only"] is None else options["only"].replace(" ", "").split(",")
    with_settings = {"contours": {"interval": options["interval"]}, "hillshade": {"azimuth": options["azimuth"]}}
    layers = [LAYERS[name].kind(**with_settings[name]) if name in with_settings else name for name in only]
    if names[-1] == "-" or (len(names) > 1 and Path(names[-1]).is_file()):
        raise BadUsage(f"{names[-1]}: products are several files: name a folder")
    check_shapes(options, options["review"], options["breaklines"], made=names[-1])
    files = open_files(session, names, options)
    cell, side = _side(files, options)
    how = {"only": layers, "cell": options["like"] or cell, "nodata": options["nodata"], "interpolation": interpolation}
    how |= {"classes": classes, "review": options["review"], "breaklines": options["breaklines"]}
    made = files.do(make_products, files.out, recipe or known or None, **how)
    plan = made.rasters.forecast
    if plan is not None:
        more = [] if made.ground is None or made.ground.forecast is None else made.ground.forecast.files
        return plan_answer(plan._replace(files=[*more, *plan.files, str(made.page)]))
    if made.ground is not None:
        tell(session, made.ground)
    text = f"{_cells(made.rasters, side)}\n"
    if options["review"] is not None and made.ground is not None:
        text += f"{options['review']}: {count(len(made.ground.places), 'place')}\n"
    if options["breaklines"] is not None:
        text += f"{options['breaklines']}: {count(made.rasters.as_dict()['water_bodies'], 'outline')} of water\n"
    answer = _answer(made.rasters, files, text, "cell")
    answer.facts["classified"] = None if made.ground is None else run_facts(session, made.ground)
    answer.facts["page"] = str(made.page)
    return dataclasses.replace(answer, complete=made.complete)


@command(
    click.Argument(["names"], metavar="IN... [OUT]", nargs=-1, required=True),
    *GROUND_OPTIONS,
    BOUNDS,
    DUPLICATES,
    option("--replace-z", "Replace Z by the height. Without it, heights are an extra dimension.", bool),
    *RUN_OPTIONS,
)
def height(session: Session, names: tuple[str, ...], **options: Any) -> Answer:
    """Write the height of every point above the ground, in the units of Z.

    IN is a file, and OUT is another one. Or IN are folders, patterns, several files, a virtual point cloud (.vpc) or URLs, and
    OUT is a folder. If OUT is -, the file goes to standard output. Heights have no seams: each file sees the ground of its
    neighbours.

    The ground is a triangulation of the ground points. These are the points of class 2 of IN, or of label 0 in text, or those
    that --filter finds. With --filter, classes are written, too, as by jaxfilter ground. All points get a height, also noise
    and water. It is the extra dimension HeightAboveGround, as in PDAL. All else stays as it is.
    """
    from ..files.writing import HEIGHT
    from ..surveys.heights import heights

    ground, replace_z = _ground(options), options["replace_z"]
    files = open_files(session, names, options)
    report = files.do(heights, files.out, ground, replace_z=replace_z)
    if report.forecast is not None:
        return plan_answer(report.forecast)
    low, high = report.heights or (math.nan, math.nan)
    dimension = "Z" if replace_z else HEIGHT
    text = f"{report.points:,} points above {report.ground:,} ground points, {low:.2f} to {high:.2f}, in {dimension}\n"
    answer = _answer(report, files, text, "point")
    answer.facts.update(dimension=dimension, lowest=low, highest=high, units=str(files.collection.units))
    return answer


def _ground(options: dict[str, Any]) -> GroundSource:
    """What is ground, by the options of a command, which are taken out."""
    recipe = take_recipe(options)
    return options["ground_classes"] if recipe is None else recipe


def _answer(report: RunReport, files: Files, text: str, what: str) -> Answer:
    """The facts on a run, and its text with the time added; says what went wrong."""
    logger.info(f"{files.output}: {text.partition(chr(10))[0]}")
    if report.uncertain:
        where = count(report.uncertain, what)
        files.session.warn(f"heights of {where} over wide voids may differ between neighbouring tiles")
    text += f"{count(report.tiles, 'tile')} in {report.elapsed:.1f} s; {times(report.seconds)}"
    return answer_of(files, report, f"{files.output}: {text}")
