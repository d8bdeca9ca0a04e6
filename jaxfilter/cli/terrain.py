"""The commands ``dtm``, from points to a GeoTIFF of their terrain, and ``height``, to heights above it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import click

from .answer import Answer, in_session
from .commands import main
from .options import (
    RUN,
    check_out,
    check_target,
    open_inputs,
    split_names,
    take_reading,
    take_recipe,
    take_run,
    with_options,
)
from .output import count, tell, times
from .session import Session, logger

if TYPE_CHECKING:
    from ..surveys.report import RunReport
    from ..surveys.surroundings import GroundSource

_GROUND = ("filter", "set", "preset", "for_cloud", "largest_building", "ground_classes", "units")


@main.command()
@click.argument("names", metavar="IN... OUT", nargs=-1, required=True)
@click.option("--cell", type=float, default=1.0, help="Side of a cell, in file units.")
@click.option("--method", "surface", default="tin", help="Interpolation: tin, natural, idw or kriging.")
@with_options(*_GROUND)
@click.option(
    "--max-gap", type=float, help="Cells farther than this from every ground point get no height; in file units."
)
@click.option("--fill", is_flag=True, help="Give cells outside the hull of the ground points a height too.")
@click.option("--neighbours", type=int, default=12, help="Number of nearest ground points that idw and kriging use.")
@click.option("--power", type=float, default=2.0, help="Power of the distance that idw uses.")
@click.option(
    "--bounds",
    nargs=4,
    type=float,
    metavar="XMIN YMIN XMAX YMAX",
    help="Bounds of the raster, in file units.  [default: the extent of IN]",
)
@with_options(*(name for name in RUN if name != "in_place"))
@in_session
def dtm(session: Session, names: tuple[str, ...], **options: Any) -> Answer:
    """Make a terrain model, a Cloud Optimized GeoTIFF of ground heights.

    IN is a file, or IN are folders, patterns, several files, a virtual point cloud (.vpc) or URLs. Large data are made in
    tiles that see the ground around them.

    The ground points are those of class 2 of IN, or of label 0 in text, or those that --filter finds. Cells are aligned to
    multiples of --cell, in the coordinate system and units of IN.
    """
    from ..files.storage import place_of
    from ..surveys.model import terrain_model
    from ..terrain.interpolation import Interpolation
    from ..terrain.raster import SUFFIXES

    ground, reading, run = _ground(options), take_reading(options), take_run(options, session)
    cell, surface = options.pop("cell"), options.pop("surface")
    interpolation = Interpolation(surface, **options)
    inputs, out = split_names(names, False)
    assert out is not None
    check_target(place_of(out), run.overwrite or run.resume, SUFFIXES)
    collection = open_inputs(session, inputs, reading)
    with session.step("run", collection.count):
        report = terrain_model(
            collection, out, ground, cell=cell, interpolation=interpolation, reading=reading, run=run
        )
    logger.info(f"{out}: {report.rows:,} x {report.columns:,} cells through {report.ground:,} ground points")
    text = (
        f"{out}: {report.rows:,} x {report.columns:,} cells of {cell:g} through {report.ground:,} ground points, "
        f"{report.empty:,} cells without height\n{surface}: "
    )
    return _answer(session, report, {"output": out}, inputs, text, "cell")


@main.command()
@click.argument("names", metavar="IN... [OUT]", nargs=-1, required=True)
@with_options(*_GROUND, "bounds")
@click.option("--replace-z", is_flag=True, help="Write heights in place of Z instead of as an extra dimension.")
@with_options(*RUN)
@in_session
def height(session: Session, names: tuple[str, ...], **options: Any) -> Answer:
    """Write the height of every point above the ground, in the units of Z.

    IN is a file and OUT another; or IN are folders, patterns, several files, a virtual point cloud (.vpc) or URLs, and OUT is
    a folder. The ground of neighbouring files counts as well, so that heights have no seams.

    The ground is linear in the triangles of the ground points: those of class 2 of IN, or of label 0 in text, or those
    that --filter finds, whose classes are then written as well, as by jaxfilter ground. All points get a height, noise and
    water included. It goes into the extra dimension HeightAboveGround, as in PDAL; all else stays as it is.
    """
    from ..files.writing import HEIGHT
    from ..surveys.heights import heights

    ground, reading, run = _ground(options), take_reading(options), take_run(options, session)
    replace_z = options.pop("replace_z")
    inputs, out = split_names(names, run.in_place)
    check_out(out, inputs, run)
    collection = open_inputs(session, inputs, reading)
    with session.step("run", collection.count):
        report = heights(collection, out, ground, replace_z=replace_z, reading=reading, run=run)
    output = out or ", ".join(inputs)
    logger.info(
        f"{output}: {len(report.files):,} files, {report.points:,} points above {report.ground:,} ground points"
    )
    low, high = report.heights or (math.nan, math.nan)
    dimension = "Z" if replace_z else HEIGHT
    facts = {"dimension": dimension, "lowest": low, "highest": high, "units": str(collection.units), "output": output}
    text = f"{output}: {report.points:,} points {low:.2f} to {high:.2f} above {report.ground:,} ground points, in {dimension}\n"
    return _answer(session, report, facts, inputs, text, "point")


def _ground(options: dict[str, Any]) -> GroundSource:
    """What is ground, by the options of a command, which are taken out."""
    classes, recipe = options.pop("ground_classes"), take_recipe(options)
    return classes if recipe is None else recipe


def _answer(
    session: Session,
    report: RunReport,
    facts: dict[str, Any],
    inputs: list[str],
    text: str,
    what: str,
) -> Answer:
    """The facts on a run and the command's own, and its text with the time added; says what went wrong."""
    if report.uncertain:
        session.warn(
            f"heights of {count(report.uncertain, what)} over wide voids may differ between neighbouring tiles"
        )
    tell(session, report)
    one = {"input": inputs[0]} if len(inputs) == 1 else {"inputs": inputs}
    facts = report.as_dict() | session.as_dict() | one | facts | {"seconds": dict(report.seconds)}
    text += f"{count(report.tiles, 'tile')} in {report.elapsed:.1f} s; {times(report.seconds)}"
    return Answer(facts, text, complete=report.complete)
