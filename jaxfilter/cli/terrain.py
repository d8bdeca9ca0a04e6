"""The commands ``dtm``, from a point cloud to a GeoTIFF of its terrain, and ``height``, to heights above it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import building
from .commands import check_reading, check_target, checked_target, file_names, main, print_json
from .runs import Bytes, check_named, is_collection, of_collections, shown
from .session import BadUsage, Session, session_options

if TYPE_CHECKING:
    import numpy as np

    from ..core.cloud import PointCloud
    from ..core.result import FilterResult


def _ground_options(command: Callable[..., None]) -> Callable[..., None]:
    """What says which points of IN are ground, and how IN is read."""
    for option in (
        click.option("--workers", type=click.IntRange(1), help="Threads.  [default: one per core]"),
        click.option(
            "--units", metavar="UNIT", help="Of the coordinates: m, ft, us-ft, or XY,Z.  [default: as the CRS says]"
        ),
        click.option(
            "--ground-class",
            "ground_classes",
            type=click.IntRange(0, 255),
            multiple=True,
            default=(2,),
            show_default=True,
            help="Class of the ground points; may be repeated.",
        ),
        click.option(
            "--largest-building",
            type=click.FloatRange(0, min_open=True),
            metavar="METRES",
            help="With --filter: set what depends on point spacing and on this width from the cloud.",
        ),
        click.option(
            "--set",
            "fields",
            metavar="NAME=VALUE",
            multiple=True,
            help="With --filter: a parameter of the filter; may be repeated.",
        ),
        click.option(
            "--filter",
            "filter_name",
            metavar="METHOD",
            help="Find the ground with this filter instead of by class or label.",
        ),
    ):
        command = option(command)
    return command


def _check_filter(filter_name: str | None, fields: tuple[str, ...]) -> dict[str, Any]:
    """The fields that are set, as numbers and words. Raises BadUsage if there is no such filter, ParameterError for a field."""
    from ..filters import FILTERS
    from . import flags

    if filter_name is None:
        if fields:
            raise BadUsage("--set is for a filter: name one with --filter")
        return {}
    if filter_name not in FILTERS:
        raise BadUsage(f"no filter {filter_name!r}: choose one of {', '.join(FILTERS)}")
    method = FILTERS[filter_name]
    changes = {name: flags.value_of(method, name, text, "--set") for name, text in building.pairs("--set", fields)}
    method(**changes)
    return changes


def _found(
    session: Session,
    source: Path,
    cloud: PointCloud,
    filter_name: str | None,
    changes: dict[str, Any],
    largest_building: float | None,
    ground_classes: tuple[int, ...],
    workers: int | None,
) -> FilterResult | np.ndarray:
    """What is ground: the result of a filter, or bool[n] by class or label. Raises InputError where nothing is."""
    import numpy as np

    from ..core.errors import InputError
    from ..filters import FILTERS

    if filter_name is not None:
        method = FILTERS[filter_name]
        filter_ = (
            method(**changes) if largest_building is None else method.for_cloud(cloud, largest_building, **changes)
        )
        with session.step("filter", len(cloud)):
            result = filter_(cloud, workers=workers, progress=session.progress)
        ground = result.ground
    elif cloud.classification is not None:
        ground = np.isin(cloud.classification, ground_classes)
        if cloud.withheld is not None:
            ground &= ~cloud.withheld
    elif cloud.reference is not None:
        ground = cloud.reference
    elif not len(cloud):
        ground = cloud.candidate
    else:
        raise InputError(f"{source} has neither classes nor labels: find the ground with --filter")
    if len(cloud) and not ground.any():
        raise InputError(f"{source}: no point is ground; classify it first, or find the ground with --filter")
    return ground if filter_name is None else result


@main.command()
@click.argument("names", metavar="IN... OUT", nargs=-1, required=True)
@click.option("--cell", type=float, default=1.0, show_default=True, help="Side of a cell, file units.")
@click.option("--method", default="tin", show_default=True, help="Interpolation: tin, natural, idw or kriging.")
@_ground_options
@click.option("--max-gap", type=float, help="No height farther than this from every ground point, file units.")
@click.option("--fill", is_flag=True, help="Give cells outside the hull of the ground points a height too.")
@click.option(
    "--neighbours", type=int, default=12, show_default=True, help="Of idw and kriging: nearest ground points."
)
@click.option("--power", type=float, default=2.0, show_default=True, help="Of idw: power of the distance.")
@click.option(
    "--bounds",
    nargs=4,
    type=float,
    metavar="XMIN YMIN XMAX YMAX",
    help="Of the raster, file units.  [default: the extent of IN]",
)
@click.option(
    "--tile", type=click.FloatRange(0, min_open=True), metavar="METRES", help=of_collections("side of the tiles")
)
@click.option("--memory", type=Bytes(), help=of_collections("for all processes, such as 4GB", "70 % of what is free"))
@click.option("--scheduler", metavar="ADDRESS", help=of_collections("a Dask scheduler that has the work done"))
@click.option("--overwrite", is_flag=True, help="Replace OUT if it exists.")
@click.pass_context
def dtm(
    ctx: click.Context,
    names: tuple[str, ...],
    filter_name: str | None,
    fields: tuple[str, ...],
    largest_building: float | None,
    ground_classes: tuple[int, ...],
    units: str | None,
    workers: int | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    debug: bool,
    **settings: Any,
) -> None:
    """Make a terrain model, a GeoTIFF of ground heights, of a file or of a collection.

    IN is a file, or IN are folders, patterns, several files, a virtual point cloud (.vpc) or URLs; then the model is made
    in tiles that see the ground around them, and is one Cloud Optimized GeoTIFF.

    The ground points are those of class 2 of IN, or of label 0 in text, or those that --filter finds. Cells are aligned to
    multiples of --cell, in the coordinate system and units of IN.
    """
    from ..core.result import FilterResult
    from ..host.las import read
    from ..terrain import check_settings
    from ..terrain import dtm as make

    if is_collection(names):
        dtm_collection(
            ctx, names, filter_name, fields, largest_building, ground_classes, units, workers, overwrite, settings,
            quiet=quiet, as_json=as_json, debug=debug,
        )  # fmt: skip
        return
    source, given = file_names(ctx, names)
    if given is None:
        raise click.MissingParameter(ctx=ctx, param_hint="'OUT'", param_type="argument")
    target = given
    for name in ("tile", "memory", "scheduler"):
        if settings.pop(name) is not None:
            raise BadUsage(f"--{name} is for a collection, and {source} is one file")
    with Session(quiet=quiet, debug=debug) as session:
        check_settings(*(settings[name] for name in ("cell", "method", "max_gap", "neighbours", "power")))
        _check_target(target, overwrite)
        check_reading(units, "last,only")
        changes = _check_filter(filter_name, fields)
        with session.reading(source):
            cloud = read(source, units=units, progress=session.progress)
        found = _found(session, source, cloud, filter_name, changes, largest_building, ground_classes, workers)
        ground = found.ground if isinstance(found, FilterResult) else found
        with session.step("interpolate", len(cloud)):
            raster = make(cloud, ground, workers=workers, progress=session.progress, **settings)
        with session.step("write"):
            raster.write(target, overwrite=overwrite)
    rows, columns = raster.values.shape
    empty = int((raster.values != raster.values).sum())
    if as_json:
        facts = {"input": str(source), "output": str(target), "points": len(cloud), "ground": int(ground.sum())}
        raster_facts = {"rows": rows, "columns": columns, "empty": empty, "transform": raster.transform}
        print_json(facts | raster_facts | {"bounds": raster.bounds, "nodata": raster.nodata} | session.as_dict())
    elif not quiet:
        seconds = ", ".join(f"{name} {value:.2f} s" for name, value in session.seconds.items())
        click.echo(
            f"{target}: {rows:,} x {columns:,} cells of {raster.cell:g} through {int(ground.sum()):,} ground points, "
            f"{empty:,} cells without height\n{settings['method']}: {seconds}"
        )


dtm.params += session_options()


def dtm_collection(
    ctx: click.Context,
    names: tuple[str, ...],
    filter_name: str | None,
    fields: tuple[str, ...],
    largest_building: float | None,
    ground_classes: tuple[int, ...],
    units: str | None,
    workers: int | None,
    overwrite: bool,
    settings: dict[str, Any],
    *,
    quiet: bool,
    as_json: bool,
    debug: bool,
) -> None:
    """``dtm`` of a collection. Exit code 1 if a tile could not be done."""
    from ..terrain import check_settings

    *inputs, out = names
    target = Path(out)
    tile, memory, scheduler = (settings.pop(name) for name in ("tile", "memory", "scheduler"))
    with Session(quiet=quiet, debug=debug) as session:
        check_settings(*(settings[name] for name in ("cell", "method", "max_gap", "neighbours", "power")))
        _check_target(target, overwrite)
        check_named(inputs)
        changes = _check_filter(filter_name, fields)
        from ..filters import FILTERS
        from ..tiles.collection import open as open_collection
        from ..tiles.terrain import terrain_model

        with session.step("headers"):
            collection = open_collection(inputs, units=units)
        with session.step("tiles", collection.count):
            report = terrain_model(
                collection,
                target,
                None if filter_name is None else FILTERS[filter_name],
                changes,
                largest_building=largest_building,
                ground_classes=ground_classes,
                tile=tile,
                memory=memory,
                workers=workers,
                client=scheduler,
                overwrite=overwrite,
                progress=shown(session),
                **settings,
            )
        if report.uncertain:
            session.warn(f"{report.uncertain:,} cells over voids so wide that neighbouring tiles may differ")
        for one in [*report.set_aside, *report.left_out]:
            session.warn(f"not done: {one}")
    if as_json:
        print_json({"inputs": inputs, "output": out} | dataclasses.asdict(report) | session.as_dict())
    elif not quiet:
        click.echo(
            f"{out}: {report.rows:,} x {report.columns:,} cells of {settings['cell']:g} through {report.ground:,} ground "
            f"points, {report.empty:,} cells without height\n{report.tiles:,} tiles in {report.seconds:.1f} s"
        )
    if report.set_aside or report.left_out:
        ctx.exit(1)


@main.command()
@click.argument("source", metavar="IN", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("target", metavar="[OUT]", required=False, type=click.Path(dir_okay=False, path_type=Path))
@_ground_options
@click.option("--replace-z", is_flag=True, help="Write heights in place of Z instead of as an extra dimension.")
@click.option("--overwrite", is_flag=True, help="Replace OUT if it exists.")
@click.option("--in-place", is_flag=True, help="Replace IN.")
def height(
    source: Path,
    target: Path | None,
    filter_name: str | None,
    fields: tuple[str, ...],
    largest_building: float | None,
    ground_classes: tuple[int, ...],
    units: str | None,
    workers: int | None,
    replace_z: bool,
    overwrite: bool,
    in_place: bool,
    quiet: bool,
    as_json: bool,
    debug: bool,
) -> None:
    """Write the height of every point above the ground, in the units of Z.

    The ground is linear in the triangles of the ground points: those of class 2 of IN, or of label 0 in text, or those
    that --filter finds, whose classes are then written as well, as by jaxfilter ground. All points get a height, noise and
    water included. It goes into the extra dimension HeightAboveGround, as in PDAL; all else stays as it is.
    """
    from ..core.result import FilterResult
    from ..host.las import read
    from ..host.writing import HEIGHT, write
    from ..terrain import height_above_ground

    with Session(quiet=quiet, debug=debug) as session:
        target = checked_target(source, target, overwrite, in_place, text=False)
        check_reading(units, "last,only")
        changes = _check_filter(filter_name, fields)
        with session.reading(source):
            cloud = read(source, units=units, progress=session.progress)
        found = _found(session, source, cloud, filter_name, changes, largest_building, ground_classes, workers)
        with session.step("heights", len(cloud)):
            heights = height_above_ground(cloud, found, workers=workers, progress=session.progress)
        classified = found if isinstance(found, FilterResult) else None
        with session.step("write"):
            write(
                target,
                cloud,
                classified,
                overwrite=overwrite,
                in_place=in_place,
                heights=heights,
                replace_z=replace_z,
            )
    ground = int((found.ground if isinstance(found, FilterResult) else found).sum())
    low, high = (float(heights.min()), float(heights.max())) if len(heights) else (float("nan"), float("nan"))
    if as_json:
        facts = {"input": str(source), "output": str(target), "points": len(cloud), "ground": ground}
        written = {"dimension": "Z" if replace_z else HEIGHT, "lowest": low, "highest": high, "units": str(cloud.units)}
        print_json(facts | written | session.as_dict())
    elif not quiet:
        seconds = ", ".join(f"{name} {value:.2f} s" for name, value in session.seconds.items())
        click.echo(
            f"{target}: {len(cloud):,} points {low:.2f} to {high:.2f} above {ground:,} ground points, in "
            f"{'Z' if replace_z else HEIGHT}\n{seconds}"
        )


height.params += session_options()


def _check_target(target: Path, overwrite: bool) -> None:
    """Raises BadUsage if writing would destroy something or cannot work."""
    from ..host import raster

    if target.suffix.lower() not in raster.SUFFIXES:
        raise BadUsage(f"{target}: the suffix must be one of {', '.join(raster.SUFFIXES)}")
    check_target(target, overwrite)
    raster.check_library()
