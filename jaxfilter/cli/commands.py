"""The ``jaxfilter`` command: ground, evaluate, methods.

Terrain models and heights are in ``terrain.py``, sweeps in ``sweeps.py`` and ``calibrate.py``, info in ``surveys.py``, pages
in ``report.py``, pipelines of PDAL in ``pdal.py``, the demonstration in ``demo.py``. What all of them check first is in
``checks.py``, what they print in ``output.py``.

Results go to standard output, progress and messages to standard error. Exit codes: 0 done, 1 the run failed, 2 wrong
usage (which is found before any file is read), 128 and the number of the signal that stopped it. What needs JAX is imported
where it is used, so that help stays quick.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource
from rich.console import Console

from ..core.version import __version__
from . import runs
from .checks import check_reading, check_review, checked_target
from .output import print_json, print_report, run_report
from .runs import ground_collection, is_collection
from .session import BadUsage, Session, logger, session_options, stoppable

if TYPE_CHECKING:
    from ..core.filter import Filter
    from ..files.storage import Place
    from ..scoring import Scores


_INSTEAD = {
    "--method": "name the method first, jaxfilter ground smrf IN OUT; dtm, height and report take it by --filter",
    "--resolution": "the side of a grid's cells is --cell, of jaxfilter dtm and of methods on grids, jaxfilter ground smrf "
    "--cell 1 IN OUT; jaxfilter ground METHOD --help lists the parameters of each",
    "--dry-run": "jaxfilter info IN says what would be read, and nothing is replaced without --overwrite or --in-place",
    "compare": "jaxfilter evaluate OUT REFERENCE scores labels, jf.compare(['ost', 'smrf'], clouds) in Python whole methods",
    "review": "jaxfilter ground IN OUT --review places.gpkg lists the places to look at, jaxfilter report IN page.html shows "
    "them",
    "dsm": "jaxfilter dtm makes a model of the ground, jaxfilter height says how high each point lies above it; PDAL's "
    "writers.gdal with output_type=max makes a model of the highest points",
    "hillshade": "jaxfilter report IN page.html shows one; or jaxfilter dtm IN dtm.tif, and then GDAL's gdaldem hillshade "
    "dtm.tif hillshade.tif",
    "classify": "that is jaxfilter ground IN OUT",
    "filter": "that is jaxfilter ground IN OUT",
}
"""What is typed first elsewhere, and what to type here."""


class Program(click.Group):
    """The command as a whole: it can be stopped, see ``stoppable``."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the subcommand."""
        with stoppable():
            try:
                return super().invoke(ctx)
            except click.NoSuchOption as error:
                if error.option_name not in _INSTEAD:
                    raise
                words = f"No such option {error.option_name!r}: {_INSTEAD[error.option_name]}."
                raise click.UsageError(words, error.ctx) from error

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Say what to type where the first word is a method, a file, or the command of another program."""
        word = args[0]
        if not ctx.resilient_parsing and self.get_command(ctx, word) is None:
            from ..methods import FILTERS

            if word in FILTERS:
                ctx.fail(f"No such command {word!r}: it is a method, jaxfilter ground {word} IN OUT.")
            if Path(word).exists():
                ctx.fail(f"No such command {word!r}: it is a file or folder, jaxfilter ground {word} OUT.")
            if word in _INSTEAD:
                ctx.fail(f"No such command {word!r}: {_INSTEAD[word]}.")
        return super().resolve_command(ctx, args)


@click.group(cls=Program, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__)
def main() -> None:
    """Ground filtering of airborne lidar: LAS in, classified LAS out."""


_DEFAULT = "default"


class _WithoutName(click.Context):
    """Of the default command, which is called by the name of its group."""

    @property
    def command_path(self) -> str:
        """That of the group."""
        return self.parent.command_path if self.parent is not None else super().command_path


class _Default(click.Command):
    context_class = _WithoutName


class Methods(click.Group):
    """A subcommand per registered filter, and one without a name: what is no filter is IN already."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The options of the default command, which most methods share, and the methods."""
        _ground_command(None).format_options(ctx, formatter)
        self.format_commands(ctx, formatter)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put the name of the default command where none is given."""
        from ..methods import FILTERS

        if args and args[0] not in FILTERS and args[0] not in ctx.help_option_names:
            args = [_DEFAULT, *args]
        return super().parse_args(ctx, args)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the filters."""
        from ..methods import FILTERS

        return list(FILTERS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of one filter, with a flag per parameter."""
        from ..methods import FILTERS

        if cmd_name == _DEFAULT:
            return _ground_command(None)
        return _ground_command(FILTERS[cmd_name]) if cmd_name in FILTERS else None


@main.group(cls=Methods, subcommand_metavar="[METHOD] IN... OUT [OPTIONS]")
def ground() -> None:
    """Classify the ground points of a file, or of a collection of files into a folder.

    IN is a LAS, LAZ or text file and OUT another; or IN are folders, patterns, several files, a virtual point cloud (.vpc)
    or URLs, and OUT is a folder. A collection is filtered in tiles that see their surroundings, across files, by several
    processes. Without METHOD the default is taken, set up for the data.

    Only points that the method judges change their class: ground becomes 2, former ground that is none becomes 1, and
    everything else in the file stays as it is. Noise, water, bridge decks and all classes from 17 on are not judged
    (--ignore-class).

    The options below are those without METHOD. METHOD --help adds its parameters and --preset.
    """


def _ground_command(method: type[Filter] | None) -> click.Command:
    """The command of a method, or of the default."""
    from ..core.cloud import KEPT_CLASSES
    from ..files import writing
    from . import flags

    @click.pass_context
    def run(ctx: click.Context, paths: tuple[str, ...], **arguments: Any) -> None:
        changes = {} if method is None else flags.given(method, ctx)
        if is_collection(paths):
            ground_collection(ctx, method, changes, paths, **{"preset": None, **arguments})
            return
        source, target = file_names(ctx, paths)
        for name in ("halo", *runs.RESOURCES):
            if ctx.get_parameter_source(name) == ParameterSource.COMMANDLINE:
                raise BadUsage(f"--{name} is for a collection: name a folder as OUT")
            del arguments[name]
        _ground(method, changes, source=source, target=target, **{"preset": None, **arguments})

    parameters: list[click.Parameter] = [
        click.Argument(["paths"], metavar="IN... OUT", nargs=-1, required=True),
        *([] if method is None else flags.options(method)),
        *([] if method is None else [_preset(method)]),
        click.Option(["--for-cloud"], is_flag=True, help="Set what depends on point spacing from the cloud."),
        click.Option(
            ["--largest-building"],
            type=click.FloatRange(0, min_open=True),
            metavar="METRES",
            help="As --for-cloud, and set what depends on this width as well.",
        ),
        click.Option(
            ["--units"],
            metavar="UNIT",
            help="Of the coordinates: m, ft, us-ft, or XY,Z such as us-ft,m.  [default: as the CRS says]",
        ),
        click.Option(
            ["--bounds"],
            nargs=4,
            type=float,
            metavar="XMIN YMIN XMAX YMAX",
            help="Read and write only the points within, file units.",
        ),
        click.Option(
            ["--returns"],
            default="last,only",
            show_default=True,
            help="Echoes to judge: first, intermediate, last, only, or all.",
        ),
        click.Option(
            ["--ignore-class", "ignore_classes"],
            type=flags.Value(int, optional=True),
            multiple=True,
            default=KEPT_CLASSES,
            show_default="7, 9, and all from 17 on",
            help="Points of this class are not judged and keep it; may be repeated. Replaces the default; none judges all.",
        ),
        click.Option(
            ["--ignore-overlap"],
            is_flag=True,
            help="Points of class 12 or with the overlap flag are not judged either.",
        ),
        click.Option(["--keep-withheld"], is_flag=True, help="Judge withheld points as well."),
        click.Option(["--drop-invalid"], is_flag=True, help="Label NaN and infinite coordinates non-ground."),
        click.Option(["--ground-class"], type=click.IntRange(0, 255), default=2, show_default=True, help="For ground."),
        click.Option(
            ["--other-class"],
            type=click.IntRange(0, 255),
            default=1,
            show_default=True,
            help="For judged points that lose their class.",
        ),
        click.Option(
            ["--reset"],
            type=click.Choice(writing.RESETS),
            default="ground",
            show_default=True,
            help="Which classes judged non-ground points lose: ground and unclassified, all, or none.",
        ),
        click.Option(["--only-ground"], is_flag=True, help="Mark ground and leave every other class as it is."),
        click.Option(
            ["--noise-class"],
            type=click.IntRange(0, 255),
            help="For low outliers: points that METHOD bars as such, below the ground; 7 by the ASPRS. SMRF bars none.  "
            "[default: as others]",
        ),
        click.Option(
            ["--extra"],
            multiple=True,
            type=click.Choice(writing.EXTRAS),
            help="Also write this quantity of each point, in metres or degrees whatever the file has; may be repeated.",
        ),
        *(_review_options() if method is None or method.DOUBTS else ()),
        click.Option(
            ["--workers"],
            type=click.IntRange(1),
            help="Threads for triangulation; of a collection, processes.  [default: one per core]",
        ),
        *runs.options(),
        click.Option(
            ["--overwrite"], is_flag=True, help="Replace OUT if it exists; of a collection, begin anew in OUT."
        ),
        click.Option(["--in-place"], is_flag=True, help="Replace IN."),
        *session_options(),
    ]
    if method is None:
        words = "The default method, set up for the data."
        return _Default(_DEFAULT, params=parameters, callback=run, help=words, hidden=True)
    return click.Command(method.__name__.lower(), params=parameters, callback=run, help=_summary(method))


def _preset(method: type[Filter]) -> click.Option:
    return click.Option(["--preset"], type=click.Choice(list(method.PRESETS)), help="A named set of parameters.")


def file_names(ctx: click.Context, paths: tuple[str, ...]) -> tuple[Place, Place | None]:
    """IN and OUT of a single file. Raises: click.BadParameter if IN is no file, or OUT a folder."""
    from ..core.errors import InputError
    from ..files.storage import Remote, place_of
    from ..methods import FILTERS

    words = dict(zip(("IN", "OUT"), paths, strict=False))
    found: list[Place] = []
    for name, word in words.items():
        try:
            place = place_of(word)
        except InputError as error:
            raise click.BadParameter(str(error), ctx, param_hint=repr(name)) from error
        if isinstance(place, Remote):
            found.append(place)
            continue
        kind = click.Path(exists=name == "IN", dir_okay=False, path_type=Path)
        try:
            found.append(kind.convert(place, None, ctx))
        except click.BadParameter as error:
            message = error.message
            if name == "IN" and ctx.info_name == _DEFAULT and "." not in word:
                message = f"{error.message} It is no method either: choose one of {', '.join(FILTERS)}."
            raise click.BadParameter(message, ctx, param_hint=repr(name)) from error
    return found[0], found[1] if len(found) > 1 else None


def _review_options() -> list[click.Option]:
    return [
        click.Option(
            ["--review"],
            metavar="FILE",
            type=click.Path(dir_okay=False, path_type=Path),
            help="Also write the places to look at, most expected errors first, as polygons (.gpkg or .geojson).",
        ),
        click.Option(
            ["--review-area"],
            type=click.FloatRange(0, 100, min_open=True),
            default=5.0,
            show_default=True,
            help="Per cent of the area that they cover.",
        ),
    ]


def _ground(
    method: type[Filter] | None,
    changes: dict[str, Any],
    *,
    source: Place,
    target: Place | None,
    preset: str | None,
    for_cloud: bool,
    largest_building: float | None,
    quiet: bool,
    as_json: bool,
    debug: bool,
    workers: int | None,
    review: Path | None = None,
    review_area: float = 5.0,
    **options: Any,
) -> None:
    from ..core.cloud import overlap_counts
    from ..files.reading import class_changes, read, write
    from ..files.text import GROUND, OBJECT
    from ..files.writing import holds_classes
    from ..surveys.border import cut_objects

    reading = {k: options[k] for k in ("units", "bounds", *runs.READING)}
    reading["ignore_classes"] = tuple(c for c in options["ignore_classes"] if c is not None)
    how = {k: options[k] for k in ("ground_class", "other_class", "reset", "only_ground", "noise_class")}
    writing = how | {k: options[k] for k in ("overwrite", "in_place", "extra")}
    with Session(quiet=quiet, debug=debug) as session:
        if method is not None:
            filter_ = method.preset(preset, **changes) if preset else method(**changes)
        target = checked_target(source, target, options["overwrite"], options["in_place"])
        check_reading(reading["units"], reading["returns"])
        if review is not None:
            check_review(review, options["overwrite"])
        with session.reading(source):
            cloud = read(source, **reading, progress=session.progress)
        if method is None:
            from ..methods.default import default_filter

            filter_ = default_filter(cloud, largest_building)
        elif for_cloud or largest_building is not None:
            filter_ = method.for_cloud(cloud, largest_building, preset=preset, **changes)
        with session.step("filter", len(cloud)):
            result = filter_(cloud, workers=workers, progress=session.progress)
        with session.step("write"):
            write(target, cloud, result, **writing)
        places = None
        if review is not None:
            # late: it brings SciPy's image functions, a quarter of a second
            from ..reports import review as write_review

            with session.step("review"):
                places = write_review(cloud, result, review, area=review_area, overwrite=options["overwrite"])
        named = holds_classes(target, cloud)
        changed = class_changes(cloud, result, **how) if named else {}
        with session.step("border"):
            cut = [dataclasses.asdict(one) for one in cut_objects(cloud, result)]
        logger.info(f"{target}: {int(result.ground.sum()):,} of {len(cloud):,} points are ground")
        runs.tell_cut(session, cut)
    report = run_report(filter_, result, session) | {
        "input": str(source),
        "output": str(target),
        "units": str(cloud.units),
        "metres_per_unit": [cloud.units.xy, cloud.units.z],
        "ground_class": options["ground_class"],
        "noise_class": options["noise_class"],
        "low_noise": int(result.low_noise.sum()),
        "of_ground_class": sum(n for (_, new), n in changed.items() if new == options["ground_class"]),
        "classes": [{"before": old, "after": new, "points": n} for (old, new), n in changed.items()],
        "overlap": overlap_counts(cloud, result.ground),
        "cut_objects": cut,
    }
    if not named:
        labels = ((GROUND, report["ground"]), (OBJECT, report["points"] - report["ground"]))
        report |= {"of_ground_class": None, "labels": [{"label": int(one), "points": n} for one, n in labels]}
    if places is not None:
        listed, expected = len(places), float(places["expected_errors"].sum())
        report["review"] = {"output": str(review), "places": listed, "expected_errors": expected}
    if as_json:
        print_json(report)
    elif not quiet:
        print_report(report)


@main.command()
@click.argument("labelled", metavar="OUT", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("reference", metavar="REFERENCE", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "--ignore-class",
    "ignore_classes",
    type=int,
    multiple=True,
    help="Leave points of this class of REFERENCE out; may be repeated.",
)
@click.option(
    "--candidates-only",
    is_flag=True,
    help="Count only points of OUT that are judged by default: last and only echoes, not withheld, no class kept.",
)
@click.option("--ground-class", type=click.IntRange(0, 255), default=2, show_default=True, help="Of OUT.")
def evaluate(
    labelled: Path,
    reference: Path,
    ignore_classes: tuple[int, ...],
    candidates_only: bool,
    ground_class: int,
    quiet: bool,
    as_json: bool,
    debug: bool,
) -> None:
    """Score the ground labels of OUT against those of REFERENCE.

    Both are LAS, LAZ or labelled text files of the same points, in any order. Points of class 0 in REFERENCE were never
    classified and do not count.
    """
    from ..core.errors import InputError
    from ..files.reading import read
    from ..scoring import evaluate as score
    from ..scoring import match_points

    with Session(quiet=quiet, debug=debug) as session:
        with session.reading(labelled, reference):
            cloud, truth = read(labelled, units="m"), read(reference, units="m")
        result = cloud.reference if cloud.classification is None else cloud.classification == ground_class
        if result is None:
            raise InputError(f"{labelled} has neither classes nor labels: give the output of jaxfilter ground")
        if truth.reference is None:
            raise InputError(f"{reference} has no ground labels: give a file with class 2 or with a label column")
        match = match_points(truth, cloud, (str(reference), str(labelled)))
        classes = truth.classification
        if classes is None and cloud.classification is not None:
            classes = cloud.classification[match]
        scores = score(
            result[match],
            truth,
            classes=classes,
            ignore_classes=ignore_classes,
            ignore=~cloud.candidate[match] if candidates_only else None,
        )
    if as_json:
        print_json(scores.as_dict() | {"output": str(labelled), "reference": str(reference)} | session.as_dict())
    else:
        _print_scores(scores)


evaluate.params += session_options()


def _print_scores(scores: Scores) -> None:
    from rich.table import Table

    table = Table("score", "percent")
    for name, label in (
        ("type1", "Type I error (ground lost)"),
        ("type2", "Type II error (objects accepted)"),
        ("total", "total error"),
        ("kappa", "kappa"),
        ("accuracy", "accuracy"),
        ("precision", "precision (ground)"),
        ("recall", "recall (ground)"),
        ("f1", "F1 (ground)"),
    ):
        value = getattr(scores, name)
        table.add_row(label, "undefined" if math.isnan(value) else f"{value:.2f}")
    counts = Table("points", "labelled ground", "labelled object")
    for label, row in zip(("reference ground", "reference object"), scores.confusion.tolist(), strict=True):
        counts.add_row(label, *(f"{v:,}" for v in row))
    for each in (table, counts):
        for column in each.columns[1:]:
            column.justify = "right"
        Console().print(each)


@main.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def methods(as_json: bool) -> None:
    """List the methods with their parameters and presets."""
    from ..citing import citation
    from ..methods import FILTERS
    from .flags import describe, fields

    table: dict[str, dict[str, Any]] = {
        name: {
            "summary": _summary(method),
            "presets": method.PRESETS,
            "notes": {preset: values.note for preset, values in method.PRESETS.items()},
            "parameters": {field: describe(declared) for field, declared in fields(method).items()},
            "citation": citation(method),
        }
        for name, method in FILTERS.items()
    }
    if as_json:
        print_json(table)
        return
    for name, entry in table.items():
        click.echo(f"{name}  {entry['summary']}")
        for preset, note in entry["notes"].items():
            click.echo(f"  --preset {preset}: {note}")
        for field, text in entry["parameters"].items():
            click.echo(f"  --{field.replace('_', '-')}: {text}")
        click.echo()


def _summary(method: type[Filter]) -> str:
    """First paragraph of the docstring, on one line."""
    return " ".join((method.__doc__ or "").strip().split("\n\n")[0].split())
