"""The ``jaxfilter`` command: ground, evaluate, methods.

Terrain models and heights are in ``terrain.py``, sweeps in ``sweeps.py`` and ``calibrate.py``, info in ``surveys.py``, pages
in ``report.py``, pipelines of PDAL in ``pdal.py``, the demonstration in ``demo.py``. Options that
they share are in ``options.py``, what they print in ``output.py``, and how they begin and end in ``answer.py``.

Results go to standard output, progress and messages to standard error. Exit codes: 0 done, 1 the run failed, 2 wrong
usage (which is found before any file is read), 128 and the number of the signal that stopped it. What needs JAX is imported
where it is used, so that help stays quick.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..core.version import __version__
from .answer import Answer, in_session
from .options import OPTIONS, READING, RUN, check_out, check_target, open_inputs, split_names, take_reading, take_run
from .output import print_json, print_report, print_table, run_facts, tell
from .session import Session, logger, session_options, stoppable
from .values import CLASS, INPUT

if TYPE_CHECKING:
    from ..core.filter import Filter
    from ..scoring import Scores
    from ..surveys.measures import Recipe

REVIEWS = (".gpkg", ".geojson")
"""Suffixes of lists of places."""


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


@click.group(cls=Program, context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
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
    or URLs, and OUT is a folder. Large data are filtered in tiles that see their surroundings, across files, by several
    processes. Without METHOD the default is taken, set up for the data.

    Only points that the method judges change their class: ground becomes 2, former ground that is none becomes 1, and
    everything else in the file stays as it is. Noise, water, bridge decks and all classes from 17 on are not judged
    (--ignore-class).

    The options below are those without METHOD. METHOD --help adds its parameters and --preset.
    """


def _ground_command(method: type[Filter] | None) -> click.Command:
    """The command of a method, or of the default."""
    from ..files import writing
    from . import flags

    @in_session
    def run(session: Session, paths: tuple[str, ...], **arguments: Any) -> Answer:
        from ..surveys.measures import Recipe

        changes = {} if method is None else flags.given(method, click.get_current_context())
        for name in flags.fields(method) if method is not None else ():
            del arguments[name]
        made = {name: arguments.pop(name, None) for name in ("preset", "for_cloud", "largest_building")}
        return _ground(session, paths, Recipe(method, changes, **made), arguments)

    parameters: list[click.Parameter] = [
        click.Argument(["paths"], metavar="IN... OUT", nargs=-1, required=True),
        *([] if method is None else flags.options(method)),
        *([] if method is None else [_preset(method)]),
        *(OPTIONS[name] for name in ("for_cloud", "largest_building", *READING)),
        click.Option(["--ground-class"], type=CLASS, default=2, help="Class for ground points."),
        click.Option(
            ["--other-class"],
            type=CLASS,
            default=1,
            help="Class for judged points that lose their class.",
        ),
        click.Option(
            ["--reset"],
            type=click.Choice(writing.RESETS),
            default="ground",
            help="Which classes judged non-ground points lose: ground and unclassified, all, or none.",
        ),
        click.Option(["--only-ground"], is_flag=True, help="Mark ground and leave every other class as it is."),
        click.Option(
            ["--noise-class"],
            type=CLASS,
            help="Class for low outliers, which METHOD finds below the ground; the ASPRS has 7. SMRF finds none.  "
            "[default: that of other points]",
        ),
        click.Option(
            ["--extra"],
            multiple=True,
            type=click.Choice(writing.EXTRAS),
            help="Also write this quantity of each point, in metres or degrees whatever the file has; may be repeated.",
        ),
        *(_review_options() if method is None or method.DOUBTS else ()),
        *(OPTIONS[name] for name in RUN),
        *session_options(),
    ]
    if method is None:
        words = "The default method, set up for the data."
        return _Default(_DEFAULT, params=parameters, callback=run, help=words, hidden=True)
    return click.Command(method.__name__.lower(), params=parameters, callback=run, help=_summary(method))


def _preset(method: type[Filter]) -> click.Option:
    return click.Option(["--preset"], type=click.Choice(list(method.PRESETS)), help="A named set of parameters.")


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
            help="Per cent of the area that they cover.",
        ),
    ]


def _ground(session: Session, paths: tuple[str, ...], recipe: Recipe, options: dict[str, Any]) -> Answer:
    """Run ``ground``."""
    recipe.alone()  # what is wrong with the parameters is said before anything is read
    inputs, out = split_names(paths, options["in_place"], bare=recipe.method is None)
    from ..files.writing import Classes
    from ..surveys.ground import Review, ground

    reading, run = take_reading(options), take_run(options, session)
    places, area = options.pop("review", None), options.pop("review_area", 5.0)
    if places is not None:
        check_target(places, run.overwrite or run.resume, REVIEWS)
    review = None if places is None else Review(places, area)
    extra = options.pop("extra")
    classes = Classes(**options)
    check_out(out, inputs, run)
    collection = open_inputs(session, inputs, reading)
    with session.step("run", collection.count):
        report = ground(collection, out, recipe, reading=reading, classes=classes, extra=extra, review=review, run=run)
    output = out or ", ".join(inputs)
    tell(session, report)
    logger.info(f"{output}: {len(report.files):,} files, {report.ground:,} of {report.points:,} points are ground")
    facts = run_facts(report, session) | {
        "input": inputs[0] if len(inputs) == 1 else inputs,
        "output": output,
        "units": str(collection.units),
        "metres_per_unit": [collection.units.xy, collection.units.z],
        "ground_class": classes.ground_class,
        "noise_class": classes.noise_class,
        "of_ground_class": sum(n for (_, new), n in report.classes.items() if new == classes.ground_class),
        "all_reset": classes.reset != "none" and not classes.only_ground,
    }
    if not report.classes:
        labels = ((0, report.ground), (1, report.points - report.ground))
        facts |= {"of_ground_class": None, "labels": [{"label": one, "points": n} for one, n in labels]}
    return Answer(facts, lambda: print_report(facts), complete=report.complete)


@main.command()
@click.argument("labelled", metavar="OUT", type=INPUT)
@click.argument("reference", metavar="REFERENCE", type=INPUT)
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
@click.option("--ground-class", type=CLASS, default=2, help="Of OUT.")
@in_session
def evaluate(
    session: Session,
    labelled: Path,
    reference: Path,
    ignore_classes: tuple[int, ...],
    candidates_only: bool,
    ground_class: int,
) -> Answer:
    """Score the ground labels of OUT against those of REFERENCE.

    Both are LAS, LAZ or labelled text files of the same points, in any order. Points of class 0 in REFERENCE were never
    classified and do not count.
    """
    from ..core.errors import InputError
    from ..files.reading import read
    from ..scoring import evaluate as score
    from ..scoring import match_points

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
    ignored = ~cloud.candidate[match] if candidates_only else None
    scores = score(result[match], truth, classes=classes, ignore_classes=ignore_classes, ignore=ignored)
    facts = scores.as_dict() | {"output": str(labelled), "reference": str(reference)} | session.as_dict()
    return Answer(facts, lambda: _print_scores(scores), always=True)


def _print_scores(scores: Scores) -> None:
    labels = {
        "type1": "Type I error (ground lost)",
        "type2": "Type II error (objects accepted)",
        "total": "total error",
        "kappa": "kappa",
        "accuracy": "accuracy",
        "precision": "precision (ground)",
        "recall": "recall (ground)",
        "f1": "F1 (ground)",
    }
    values = {label: getattr(scores, name) for name, label in labels.items()}
    rows = [(label, "undefined" if math.isnan(value) else f"{value:.2f}") for label, value in values.items()]
    print_table(("score", "percent"), rows, left=1)
    names = ("reference ground", "reference object")
    counts = [(name, *(f"{v:,}" for v in row)) for name, row in zip(names, scores.confusion.tolist(), strict=True)]
    print_table(("points", "labelled ground", "labelled object"), counts, left=1)


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
