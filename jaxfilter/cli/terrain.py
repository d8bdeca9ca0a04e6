"""The commands ``dtm``, from point clouds to a GeoTIFF of their terrain, and ``height``, to heights above it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from . import building
from .checks import check_reading, check_target, checked_target
from .commands import file_names, main
from .output import print_json
from .runs import check_named, count, is_collection, named, resources, shown, tell, to_be_resumed
from .session import BadUsage, Session, logger, session_options

if TYPE_CHECKING:
    import numpy as np

    from ..core.cloud import PointCloud
    from ..core.filter import Filter
    from ..core.result import FilterResult
    from ..files.storage import Place
    from ..surveys.collection import Collection


@dataclasses.dataclass(frozen=True)
class Ground:
    """What both commands are told: which points of IN are ground, how IN is read, and how the command talks.

    ``resources``: what only collections take, by the names of the library.
    """

    filter_name: str | None
    fields: tuple[str, ...]
    largest_building: float | None
    ground_classes: tuple[int, ...]
    units: str | None
    workers: int | None
    overwrite: bool
    quiet: bool
    as_json: bool
    debug: bool
    resources: dict[str, Any]

    @classmethod
    def taken(cls, options: dict[str, Any]) -> Ground:
        """From the options of a command, out of which they are taken."""
        names = [field.name for field in dataclasses.fields(cls) if field.name != "resources"]
        words = {"tile": "tile", "memory": "memory", "scheduler": "client", "work": "work", "resume": "resume"}
        more = {words[name]: options.pop(name) for name in words if name in options}
        return cls(**{name: options.pop(name) for name in names}, resources=more)

    @property
    def method(self) -> type[Filter] | None:
        """The filter that is named."""
        from ..methods import FILTERS

        return None if self.filter_name is None else FILTERS[self.filter_name]

    def session(self) -> Session:
        """The context in which the command runs."""
        return Session(quiet=self.quiet, debug=self.debug)

    def changes(self) -> dict[str, Any]:
        """The fields that are set, as numbers and words. Raises BadUsage if there is no such filter, ParameterError for a
        field."""
        from ..methods import FILTERS
        from . import flags

        if self.filter_name is None:
            if self.fields:
                raise BadUsage("--set is for a filter: name one with --filter")
            return {}
        if self.filter_name not in FILTERS:
            raise BadUsage(f"no filter {self.filter_name!r}: choose one of {', '.join(FILTERS)}")
        method = FILTERS[self.filter_name]
        pairs = building.pairs("--set", self.fields)
        changes = {name: flags.value_of(method, name, text, "--set") for name, text in pairs}
        method(**changes)
        return changes

    def found(
        self, session: Session, source: Place, cloud: PointCloud, changes: dict[str, Any]
    ) -> FilterResult | np.ndarray:
        """What is ground in one file: the result of the filter, or bool[n] by class or label. Raises InputError where nothing
        is."""
        import numpy as np

        from ..core.errors import InputError

        method = self.method
        if method is not None:
            filter_ = (
                method(**changes)
                if self.largest_building is None
                else method.for_cloud(cloud, self.largest_building, **changes)
            )
            with session.step("filter", len(cloud)):
                result = filter_(cloud, workers=self.workers, progress=session.progress)
            ground = result.ground
        elif cloud.classification is not None:
            ground = np.isin(cloud.classification, self.ground_classes)
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
        return ground if method is None else result

    def over_tiles(self, session: Session) -> dict[str, Any]:
        """The arguments of a run over a collection."""
        return self.resources | {
            "largest_building": self.largest_building,
            "ground_classes": self.ground_classes,
            "workers": self.workers,
            "overwrite": self.overwrite,
            "progress": shown(session),
        }

    def opened(self, session: Session, inputs: Sequence[str]) -> Collection:
        """The collection that is named."""
        from ..surveys.collection import open as open_collection

        with session.step("headers"):
            return open_collection(inputs, units=self.units)


def _ground_options(*words: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """The options of :class:`Ground`; ``words``: of those of collections."""
    options = (
        click.option("--workers", type=click.IntRange(1), help="Threads; of a collection, processes.  [default: one per core]"),
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
    )  # fmt: skip

    def decorated(command: Callable[..., None]) -> Callable[..., None]:
        for option in options:
            command = option(command)
        params = command.__click_params__  # type: ignore[attr-defined]
        params[:0] = reversed(resources(words))  # the first is listed last
        return command

    return decorated


def _one_file(ctx: click.Context, names: tuple[str, ...], how: Ground) -> tuple[Place, Place | None]:
    """IN and OUT of a single file. Raises BadUsage for options that it does not take."""
    source, target = file_names(ctx, names)
    for name in ("tile", "memory", "scheduler", "work", "resume"):
        if ctx.get_parameter_source(name) == ParameterSource.COMMANDLINE:
            raise BadUsage(f"--{name} is for a collection, and {source} is one file")
    return source, target


@main.command()
@click.argument("names", metavar="IN... OUT", nargs=-1, required=True)
@click.option("--cell", type=float, default=1.0, show_default=True, help="Side of a cell, file units.")
@click.option("--method", default="tin", show_default=True, help="Interpolation: tin, natural, idw or kriging.")
@_ground_options("tile", "memory", "scheduler", "work", "resume")
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
@click.option("--overwrite", is_flag=True, help="Replace OUT if it exists; of a collection, begin anew.")
@click.pass_context
def dtm(ctx: click.Context, names: tuple[str, ...], **options: Any) -> None:
    """Make a terrain model, a GeoTIFF of ground heights, of a file or of a collection.

    IN is a file, or IN are folders, patterns, several files, a virtual point cloud (.vpc) or URLs; then the model is made
    in tiles that see the ground around them, and is one Cloud Optimized GeoTIFF.

    The ground points are those of class 2 of IN, or of label 0 in text, or those that --filter finds. Cells are aligned to
    multiples of --cell, in the coordinate system and units of IN.
    """
    how = Ground.taken(options)
    if is_collection(names):
        _dtm_collection(ctx, names, how, options)
        return
    from ..core.result import FilterResult
    from ..files.reading import read
    from ..terrain.models import dtm as make

    source, target = _one_file(ctx, names, how)
    if target is None:
        raise click.MissingParameter(ctx=ctx, param_hint="'OUT'", param_type="argument")
    with how.session() as session:
        _check_model(target, how.overwrite, options)
        check_reading(how.units, "last,only")
        changes = how.changes()
        with session.reading(source):
            cloud = read(source, units=how.units, progress=session.progress)
        found = how.found(session, source, cloud, changes)
        ground = found.ground if isinstance(found, FilterResult) else found
        with session.step("interpolate", len(cloud)):
            raster = make(cloud, ground, workers=how.workers, progress=session.progress, **options)
        with session.step("write"):
            raster.write(target, overwrite=how.overwrite)
    rows, columns = raster.values.shape
    empty = int((raster.values != raster.values).sum())
    if how.as_json:
        facts = {"input": str(source), "output": str(target), "points": len(cloud), "ground": int(ground.sum())}
        raster_facts = {"rows": rows, "columns": columns, "empty": empty, "transform": raster.transform}
        print_json(facts | raster_facts | {"bounds": raster.bounds, "nodata": raster.nodata} | session.as_dict())
    elif not how.quiet:
        seconds = ", ".join(f"{name} {value:.2f} s" for name, value in session.seconds.items())
        click.echo(
            f"{target}: {rows:,} x {columns:,} cells of {raster.cell:g} through {int(ground.sum()):,} ground points, "
            f"{empty:,} cells without height\n{options['method']}: {seconds}"
        )


dtm.params += session_options()


def _dtm_collection(ctx: click.Context, names: tuple[str, ...], how: Ground, settings: dict[str, Any]) -> None:
    """``dtm`` of a collection. Exit code 1 if a tile could not be done."""
    from ..files.storage import place_of

    *inputs, out = names
    with how.session() as session:
        _check_model(place_of(out), how.overwrite or how.resources["resume"], settings)
        check_named(inputs)
        changes = how.changes()
        from ..surveys.model import terrain_model

        collection = how.opened(session, inputs)
        with session.step("tiles", collection.count), to_be_resumed():
            report = terrain_model(collection, out, how.method, changes, **how.over_tiles(session), **settings)
        if report.uncertain:
            session.warn(f"{report.uncertain:,} cells over voids so wide that neighbouring tiles may differ")
        for one in [*report.set_aside, *report.left_out]:
            session.warn(f"not done: {one}")
        logger.info(f"{out}: {report.rows:,} x {report.columns:,} cells through {report.ground:,} ground points")
    if how.as_json:
        print_json({"inputs": inputs, "output": out} | dataclasses.asdict(report) | session.as_dict())
    elif not how.quiet:
        click.echo(
            f"{out}: {report.rows:,} x {report.columns:,} cells of {settings['cell']:g} through {report.ground:,} ground "
            f"points, {report.empty:,} cells without height\n{count(report.tiles, 'tile')} in {report.seconds:.1f} s"
        )
    if not report.complete:
        ctx.exit(1)


@main.command()
@click.argument("names", metavar="IN... [OUT]", nargs=-1, required=True)
@_ground_options("tile", "memory", "scheduler", "work", "resume")
@click.option("--replace-z", is_flag=True, help="Write heights in place of Z instead of as an extra dimension.")
@click.option("--overwrite", is_flag=True, help="Replace OUT if it exists; of a collection, begin anew in OUT.")
@click.option("--in-place", is_flag=True, help="Replace IN.")
@click.pass_context
def height(ctx: click.Context, names: tuple[str, ...], *, replace_z: bool, in_place: bool, **options: Any) -> None:
    """Write the height of every point above the ground, in the units of Z, of a file or of a collection.

    IN is a file and OUT another; or IN are folders, patterns, several files, a virtual point cloud (.vpc) or URLs, and OUT is
    a folder: then the ground of neighbouring files counts as well, so that heights have no seams.

    The ground is linear in the triangles of the ground points: those of class 2 of IN, or of label 0 in text, or those
    that --filter finds, whose classes are then written as well, as by jaxfilter ground. All points get a height, noise and
    water included. It goes into the extra dimension HeightAboveGround, as in PDAL; all else stays as it is.
    """
    how = Ground.taken(options)
    if is_collection(names):
        if in_place:
            raise BadUsage(f"--in-place is for a single file, and {named(names)} is a collection")
        _height_collection(ctx, names, how, replace_z)
        return
    from ..core.result import FilterResult
    from ..files.reading import read
    from ..files.writing import write
    from ..terrain.models import height_above_ground

    source, given = _one_file(ctx, names, how)
    with how.session() as session:
        target = checked_target(source, given, how.overwrite, in_place, text=False)
        check_reading(how.units, "last,only")
        changes = how.changes()
        with session.reading(source):
            cloud = read(source, units=how.units, progress=session.progress)
        found = how.found(session, source, cloud, changes)
        with session.step("heights", len(cloud)):
            heights = height_above_ground(cloud, found, workers=how.workers, progress=session.progress)
        classified = found if isinstance(found, FilterResult) else None
        with session.step("write"):
            write(
                target,
                cloud,
                classified,
                overwrite=how.overwrite,
                in_place=in_place,
                heights=heights,
                replace_z=replace_z,
            )
    ground = int((found.ground if isinstance(found, FilterResult) else found).sum())
    span = (float(heights.min()), float(heights.max())) if len(heights) else (math.nan, math.nan)
    facts = {"input": str(source), "output": str(target), "points": len(cloud), "ground": ground}
    if how.as_json:
        print_json(facts | _height_facts(span, replace_z) | {"units": str(cloud.units)} | session.as_dict())
    elif not how.quiet:
        seconds = ", ".join(f"{name} {value:.2f} s" for name, value in session.seconds.items())
        click.echo(f"{_height_line(target, len(cloud), ground, span, replace_z)}\n{seconds}")


height.params += session_options()


def _height_collection(ctx: click.Context, names: tuple[str, ...], how: Ground, replace_z: bool) -> None:
    """``height`` of a collection. Exit code 1 if anything could not be done."""
    *inputs, out = names
    with how.session() as session:
        check_named(inputs)
        changes = how.changes()
        from ..surveys.heights import heights

        collection = how.opened(session, inputs)
        with session.step("tiles", collection.count), to_be_resumed():
            report = heights(collection, out, how.method, changes, replace_z=replace_z, **how.over_tiles(session))
        if report.uncertain:
            session.warn(
                f"{report.uncertain:,} points over voids so wide that heights of neighbouring tiles may differ"
            )
        tell(session, report)
        logger.info(
            f"{out}: {len(report.files):,} files, {report.points:,} points above {report.ground:,} ground points"
        )
    span = report.heights or (math.nan, math.nan)
    facts = report.as_dict() | {"inputs": inputs, "output": out, **_height_facts(span, replace_z)} | session.as_dict()
    if how.as_json:
        print_json(facts | {"units": str(collection.units)})
    elif not how.quiet:
        click.echo(
            f"{_height_line(out, report.points, report.ground, span, replace_z)}\n"
            f"{count(len(report.files), 'file')}, {count(report.tiles, 'tile')} in {report.seconds:.1f} s"
        )
    if not report.complete:
        ctx.exit(1)


def _height_facts(span: tuple[float, float], replace_z: bool) -> dict[str, Any]:
    from ..files.writing import HEIGHT

    return {"dimension": "Z" if replace_z else HEIGHT, "lowest": span[0], "highest": span[1]}


def _height_line(target: Place | str, points: int, ground: int, span: tuple[float, float], replace_z: bool) -> str:
    dimension = _height_facts(span, replace_z)["dimension"]
    return f"{target}: {points:,} points {span[0]:.2f} to {span[1]:.2f} above {ground:,} ground points, in {dimension}"


def _check_model(target: Place, overwrite: bool, settings: dict[str, Any]) -> None:
    """Raises BadUsage if writing would destroy something or cannot work, ParameterError for settings."""
    from ..terrain import raster
    from ..terrain.models import check_settings

    check_settings(*(settings[name] for name in ("cell", "method", "max_gap", "neighbours", "power")))
    if target.suffix.lower() not in raster.SUFFIXES:
        raise BadUsage(f"{target}: the suffix must be one of {', '.join(raster.SUFFIXES)}")
    check_target(target, overwrite)
