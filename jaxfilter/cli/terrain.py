"""The commands ``dtm``, from points to a GeoTIFF of their terrain, and ``height``, to heights above it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import click

from .commands import main
from .options import (
    BOUNDS,
    GROUND,
    RUN,
    Files,
    open_files,
    take,
    take_recipe,
)
from .output import Answer, count, in_session, run_facts, tell, times
from .session import Session, logger
from .values import BOX, option, with_options

if TYPE_CHECKING:
    from ..surveys.report import RunReport
    from ..surveys.surroundings import GroundSource


@main.command()
@click.argument("names", metavar="IN... OUT", nargs=-1, required=True)
@with_options(
    option("--cell", "Side of a cell, in file units.", float, default=1.0),
    option("--method", "Interpolation: tin, natural, idw or kriging.", default="tin"),
    *GROUND,
    option("--max-gap", "Cells farther than this from every ground point get no height, in file units.", float),
    option("--fill", "Give cells outside the hull of the ground points a height too.", bool),
    option("--neighbours", "Number of nearest ground points that idw and kriging use.", int, default=12),
    option("--power", "Power of the distance that idw uses.", float, default=2.0),
    option(
        "--bounds", "Bounds of the raster, in file units.  [default: the extent of IN]", float, nargs=4, metavar=BOX
    ),
    *RUN[:-1],
)
@in_session
def dtm(session: Session, names: tuple[str, ...], **options: Any) -> Answer:
    """Make a terrain model, a Cloud Optimized GeoTIFF of ground heights.

    IN is a file, or IN are folders, patterns, several files, a virtual point cloud (.vpc) or URLs. Large data are made in
    tiles that see the ground around them.

    The ground points are those of class 2 of IN, or of label 0 in text, or those that --filter finds. Cells are aligned to
    multiples of --cell, in the coordinate system and units of IN.
    """
    from ..surveys.model import terrain_model
    from ..terrain.interpolation import Interpolation
    from ..terrain.raster import SUFFIXES

    how, cell = take(Interpolation, options), options["cell"]
    ground = _ground(options)
    files = open_files(session, names, options, SUFFIXES)
    assert files.out is not None
    with session.step("run", files.collection.count):
        report = terrain_model(
            files.collection, files.out, ground, cell=cell, interpolation=how, reading=files.reading, run=files.run
        )
    text = f"{report.rows:,} x {report.columns:,} cells of {cell:g} through {report.ground:,} ground points"
    return _answer(session, report, files, f"{text}, {report.empty:,} cells without height\n{how.method}: ", "cell")


@main.command()
@click.argument("names", metavar="IN... [OUT]", nargs=-1, required=True)
@with_options(
    *GROUND,
    BOUNDS,
    option("--replace-z", "Write heights in place of Z instead of as an extra dimension.", bool),
    *RUN,
)
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

    ground, replace_z = _ground(options), options["replace_z"]
    files = open_files(session, names, options)
    with session.step("run", files.collection.count):
        report = heights(files.collection, files.out, ground, replace_z=replace_z, reading=files.reading, run=files.run)
    low, high = report.heights or (math.nan, math.nan)
    dimension = "Z" if replace_z else HEIGHT
    text = f"{report.points:,} points above {report.ground:,} ground points, {low:.2f} to {high:.2f}, in {dimension}\n"
    answer = _answer(session, report, files, text, "point")
    answer.facts.update(dimension=dimension, lowest=low, highest=high, units=str(files.collection.units))
    return answer


def _ground(options: dict[str, Any]) -> GroundSource:
    """What is ground, by the options of a command, which are taken out."""
    recipe = take_recipe(options)
    return options["ground_classes"] if recipe is None else recipe


def _answer(session: Session, report: RunReport, files: Files, text: str, what: str) -> Answer:
    """The facts on a run, and its text with the time added; says what went wrong."""
    logger.info(f"{files.output}: {text.partition(chr(10))[0]}")
    if report.uncertain:
        session.warn(
            f"heights of {count(report.uncertain, what)} over wide voids may differ between neighbouring tiles"
        )
    tell(session, report)
    text += f"{count(report.tiles, 'tile')} in {report.elapsed:.1f} s; {times(report.seconds)}"
    return Answer(run_facts(session, report, files), f"{files.output}: {text}", complete=report.complete)
