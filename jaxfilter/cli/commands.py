"""The ``jaxfilter`` command as a whole, and its commands ground, evaluate and methods.

Results go to standard output, progress and messages to standard error. Exit codes: 0 done, 1 the run failed, 2 wrong
usage (which is found before any file is read), 128 and the number of the signal that stopped it. What needs JAX is imported
where it is used, so that help stays quick.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..core.process import collect_seldom
from ..core.version import __version__
from ..terrain.layers import LAYERS
from .options import (
    BREAKLINES,
    BY_DATA,
    READING,
    RUN_OPTIONS,
    WRITTEN,
    check_shapes,
    files_of,
    open_files,
    take,
    take_classes,
)
from .output import SESSION, Answer, in_session, json_text, plan_answer, report_text, run_facts, table_text, tell
from .session import BadUsage, Session, logger, stoppable
from .values import CLASS, OUTPUT, on_command_line, option

if TYPE_CHECKING:
    from ..core.filter import Filter
    from ..scoring import Scores
    from ..surveys.measures import Recipe

REVIEW = option("--review", "Also write the places where the terrain may be wrong, to this .gpkg or .geojson.", OUTPUT)

_INSTEAD = {
    "--method": "name the method first, jaxfilter ground smrf IN OUT; dtm, height and report take it by --filter",
    "compare": "jaxfilter evaluate OUT REFERENCE scores labels, jf.compare(['ost', 'smrf'], clouds) in Python whole methods",
    "classify": "that is jaxfilter ground IN OUT",
    "filter": "that is jaxfilter ground IN OUT",
}
"""What is typed first elsewhere, and what to type here."""


def workflow() -> dict[str, tuple[str, ...]]:
    """The commands in the order in which a project needs them."""
    return {
        "Look and try": ("demo", "info", "methods"),
        "Find the ground": ("ground", "report", "evaluate"),
        "Make models": ("products", *LAYERS, "height"),
        "Check and repair": ("review", "apply", "accuracy"),
        "Choose parameters": ("sweep", "calibrate"),
    }


class Program(click.Group):
    """The command as a whole: it can be stopped, see ``stoppable``, answers words of other programs, and has a command for each
    layer."""

    layer_command: type[click.Command]
    """Makes the command of a layer by its name."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names, in the order of the work."""
        return [name for names in workflow().values() for name in names]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """A section for each part of the work."""
        width = max(map(len, self.list_commands(ctx)))
        for title, names in workflow().items():
            commands = [(name.ljust(width), self.get_command(ctx, name)) for name in names]
            with formatter.section(title):
                formatter.write_dl([(name, one.get_short_help_str(200)) for name, one in commands if one])

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """A command by its name."""
        return self.layer_command(name) if name in LAYERS else super().get_command(ctx, name)

    def invoke(self, ctx: click.Context) -> Any:
        collect_seldom()
        with stoppable():
            try:
                return super().invoke(ctx)
            except click.NoSuchOption as error:
                if instead := _INSTEAD.get(error.option_name) or _methods_with(error.option_name):
                    words = f"{error.message.rstrip('.')}: {instead}."
                    raise click.UsageError(words, error.ctx) from error
                raise

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Say what to type where the first word is a method, a file, or the command of another program."""
        word = args[0]
        if not ctx.resilient_parsing and word not in self.list_commands(ctx):
            from ..methods import FILTERS

            words = _INSTEAD.get(word)
            if word in FILTERS:
                words = f"it is a method, jaxfilter ground {word} IN OUT"
            elif Path(word).exists():
                words = f"it is a file or folder, jaxfilter ground {word} OUT"
            if words:
                ctx.fail(f"No such command {word!r}: {words}.")
        return super().resolve_command(ctx, args)


def _methods_with(flag: str) -> str:
    """What to type for an option of some methods; nothing if no method has it."""
    from ..methods import FILTERS
    from .flags import fields

    name = flag.removeprefix("--").removeprefix("no-").replace("-", "_")
    if not (found := [method for method, kind in FILTERS.items() if name in fields(kind)]):
        return ""
    return f"it is a parameter of {', '.join(found)}; name the method first, jaxfilter ground {found[0]} IN OUT {flag} VALUE"


@click.group(cls=Program, context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
@click.version_option(__version__)
def main() -> None:
    """Find the ground points of airborne lidar, and make terrain models of them.

    jaxfilter COMMAND --help explains a command. jaxfilter ground in.laz out.laz classifies a file; jaxfilter products FOLDER OUT
    classifies a folder and makes all models.
    """


def command(
    *parameters: click.Parameter, name: str | None = None, help: str | None = None
) -> Callable[[Callable[..., Answer]], click.Command]:
    """A decorator that makes a command of :data:`main`: it gets a Session, and has these parameters, in this order."""
    return lambda act: main.command(name, params=[*parameters, *SESSION], help=help)(in_session(act))


class Ground(click.Command):
    """The command of a method where one is named first, and else that of the default."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        from ..methods import FILTERS

        if args and args[0] in FILTERS:
            return ground_command(FILTERS[args[0]]).make_context(f"{info_name} {args[0]}", args[1:], parent, **extra)
        return ground_command(None, self.help).make_context(info_name, args, parent, **extra)


@main.command(cls=Ground)
def ground() -> None:
    """Classify the ground points of files.

    IN is a LAS, LAZ or text file, and OUT is another one, or - for standard output. Or IN are folders, patterns, several files,
    a virtual point cloud (.vpc) or URLs, and OUT is a folder.

    The default method needs no parameters: it takes them from the data. To use another one, name it before IN: jaxfilter
    ground smrf IN OUT. Its parameters are options then; jaxfilter ground METHOD --help lists them.

    Ground points get class 2. Points that had class 2 and are no ground get class 1. All else in the files stays as it is.
    Points of classes 7 and 9, and of 17 and above, are not judged (--ignore-class). --classes usgs also writes noise, water
    and bridge decks.

    Large data are cut into tiles. Each tile is read with its surroundings, so results have no seams.
    """


def ground_command(method: type[Filter] | None, help: str | None = None) -> click.Command:
    """The command of a method, or of the default, with its help."""
    from ..files.writing import EXTRAS
    from ..methods import FILTERS
    from . import flags

    @in_session
    def run(session: Session, paths: tuple[str, ...], **options: Any) -> Answer:
        from ..surveys.measures import Recipe

        fields = {} if method is None else flags.fields(method)
        changes = on_command_line(fields)
        for name in fields:
            del options[name]
        return _ground(session, paths, take(Recipe, options, method=method, changes=changes), options)

    def complete(context: click.Context, parameter: click.Parameter, word: str) -> list[str]:
        return [name for name in FILTERS if method is None and name.startswith(word)]

    paths = click.Argument(["paths"], metavar="IN... OUT", nargs=-1, required=True, shell_complete=complete)
    parameters: list[click.Parameter] = [paths]
    if method is not None:
        presets = click.Choice(list(method.PRESETS))
        parameters += [*flags.options(method), option("--preset", "Start from this named set of parameters.", presets)]
    extra = option(
        "--extra", "Also write this quantity of each point, in metres or degrees.", click.Choice(EXTRAS), multiple=True
    )
    parameters += [*BY_DATA, *READING, *WRITTEN, extra, REVIEW, BREAKLINES, *RUN_OPTIONS, *SESSION]
    if method is not None:
        return click.Command(method.__name__.lower(), params=parameters, callback=run, help=_summary(method))
    words = "\n".join(f"{name:6} {_summary(kind)}" for name, kind in FILTERS.items())
    return click.Command("ground", params=parameters, callback=run, help=help, epilog=f"\b\nMethods:\n{words}")


def _ground(session: Session, paths: tuple[str, ...], recipe: Recipe, options: dict[str, Any]) -> Answer:
    recipe.alone()  # what is wrong with the parameters is said before anything is read
    from ..surveys.ground import ground

    review, breaklines = options["review"], options["breaklines"]
    check_shapes(options, review, breaklines)
    classes, extra = take_classes(options), options["extra"]
    files = open_files(session, paths, options, bare=recipe.method is None)
    outputs = {"extra": extra, "review": review, "breaklines": breaklines}
    report = files.do(ground, files.out, recipe, classes=classes, **outputs)
    if report.forecast is not None:
        return plan_answer(report.forecast)
    units, of_class = files.collection.units, classes.ground_class
    counted = sum(n for (_, new), n in report.classes.items() if new == of_class)
    tell(session, report)
    found = f"{report.ground:,} of {report.points:,} points are ground"
    logger.info(f"{files.output}: {len(report.files):,} files, {found}")
    facts = run_facts(session, report, files) | {
        "units": str(units),
        "metres_per_unit": [units.xy, units.z],
        "ground_class": of_class,
        "noise_class": classes.noise_class,
        "written": dataclasses.asdict(classes),
        "of_ground_class": counted if report.classes else None,
        "review": review and str(review),
        "breaklines": breaklines and str(breaklines),
        "all_reset": classes.reset != "none" and not classes.only_ground and classes.other_class != of_class,
    }
    if not report.classes and report.points:
        labels = ((0, report.ground), (1, report.points - report.ground))
        facts["labels"] = [{"label": one, "points": n} for one, n in labels]
    return Answer(facts, report_text(facts), complete=report.complete)


@command(
    click.Argument(["labelled"], metavar="OUT", type=click.Path(exists=True, path_type=Path)),
    click.Argument(["reference"], metavar="REFERENCE", type=click.Path(exists=True, path_type=Path)),
    option("--ignore-class ignore_classes", "Leave out points of this class of REFERENCE.", int, multiple=True),
    option("--candidates-only", "Count only those points of OUT that jaxfilter ground judges by default.", bool),
    option("--ground-class", "Class of the ground points of OUT.", CLASS, default=2),
)
def evaluate(session: Session, labelled: Path, reference: Path, **options: Any) -> Answer:
    """Score ground labels against a reference.

    OUT and REFERENCE are LAS, LAZ or labelled text files of the same points, in any order. Or both are folders of LAS and LAZ:
    then files of the same name are compared, and the scores count all their points. Points of class 0 in REFERENCE were never
    classified and do not count.
    """
    from ..scoring import Scores

    pairs = _pairs(labelled, reference)
    with session.reading(*(path for pair in pairs for path in pair)):
        each = {str(pair[0].name): _score(*pair, **options) for pair in pairs}
    scores = Scores.from_confusion(sum(one.confusion for one in each.values()))
    facts, text = scores.as_dict() | {"output": str(labelled), "reference": str(reference)}, str(scores)
    if labelled.is_dir():
        heading = ("file", "Type I", "Type II", "total", "kappa")
        figures = {name: (one.type1, one.type2, one.total, one.kappa) for name, one in each.items()}
        rows = [(name, *(f"{value:.2f}" for value in values)) for name, values in figures.items()]
        facts["files"] = [{"file": name, **one.as_dict()} for name, one in each.items()]
        text += "\n" + table_text(heading, rows, left=1)
    return Answer(facts, text, always=True)


def _pairs(labelled: Path, reference: Path) -> list[tuple[Path, Path]]:
    """The files that are compared: two files, or those of two folders that have one name but for the suffix. Raises: BadUsage,
    InputError."""
    if labelled.is_dir() != reference.is_dir():
        raise BadUsage(f"{labelled} and {reference}: one is a folder and one is a file; name two files or two folders")
    if labelled.is_file():
        return [(labelled, reference)]
    ours, theirs = ({path.stem: path for path in files_of(folder)} for folder in (labelled, reference))
    if alone := sorted(ours.keys() ^ theirs.keys()):
        here, there = (labelled, reference) if alone[0] in ours else (reference, labelled)
        raise BadUsage(f"{here} holds {alone[0]} and {there} does not: both must hold the same files")
    return [(path, theirs[stem]) for stem, path in ours.items()]


def _score(
    labelled: Path, reference: Path, *, ground_class: int, ignore_classes: tuple[int, ...], candidates_only: bool
) -> Scores:
    """The scores of one file against another. Raises: InputError for missing labels and for other points."""
    from ..core.errors import InputError
    from ..files.reading import read
    from ..scoring import evaluate as score
    from ..scoring import match_points

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
    return score(result[match], truth, classes=classes, ignore_classes=ignore_classes, ignore=ignored)


@main.command(params=[option("--json as_json", "Print JSON.", bool)])
def methods(as_json: bool) -> None:
    """List the methods with their parameters and presets."""
    from ..methods import FILTERS
    from ..methods.papers import citation
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
        click.echo(json_text(table))
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
