"""Which alternative does best on simulated scenes and tiles, for every default that is said to be chosen there. See README.md."""

from __future__ import annotations

import statistics
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.defaults import choices, clouds
from experiments.isprs import samples, search
from experiments.report import Column, CommandLine, Row, markdown, read_csv, write_csv, write_page
from jaxfilter.core.compilation import keep_compilations
from jaxfilter.core.points import canonical_points

HERE = Path(__file__).parent
TIE = 0.05
"""Percent; alternatives whose means differ by less count as equally good."""


def main(arguments: list[str] | None = None) -> None:
    """Run what is not at hand and write the tables."""
    options = _parser().options(arguments)
    folder = samples.data_folder(options.data)
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    asked = [c for c in choices.CHOICES if not options.choices or any(c.name.startswith(p) for p in options.choices)]
    path = options.out / "runs.csv"
    kept = {
        _key(row): row
        for row in (read_csv(path) if path.exists() and not options.fresh else [])
        if search.current(row, jf.FILTERS)
    }
    rows = []
    for known in clouds.clouds(folder, [n for n in clouds.names() if not options.groups or n[0] in options.groups]):
        rows += run(known, asked, kept, only_kept=options.at_hand)
        write_csv(path, list(kept.values()))
        print(f"{known.group} {known.name}: done", file=sys.stderr, flush=True)
    tables = [table(choice, [row for row in rows if row["choice"] == choice.name]) for choice in asked]
    write_csv(options.out / "means.csv", [line for lines in tables for line in lines])
    write_page(
        options.out / "results.md",
        report(asked, tables),
        options.command,
        (*{c.method for c in asked}, "scenes"),
        keeps=True,
    )
    for choice, lines in zip(asked, tables, strict=True):
        print(f"{choice.name}\n{_markdown(lines)}\n")


def run(
    known: clouds.Known, asked: Sequence[choices.Choice], kept: dict[tuple[str, ...], Row], *, only_kept: bool = False
) -> list[Row]:
    """A row for every alternative of every choice on one cloud. Filters that are in ``kept`` are not run again."""
    spacing = canonical_points(known.cloud).spacing()
    rows = []
    for choice in asked:
        if choice.on and known.group not in choice.on:
            continue
        for alternative in choice.alternatives:
            filter_ = choice.filter(alternative, spacing)
            head: Row = {"group": known.group, "cloud": known.name, "parameters": search.digest(filter_)}
            if only_kept and _key(head) not in kept:
                continue
            if _key(head) not in kept:
                try:
                    counts = (
                        jf.evaluate(filter_(known.cloud), known.ground, ignore=~known.scored).confusion.ravel().tolist()
                    )
                    status = "OK"
                except jf.JaxfilterError as error:
                    counts, status = [None] * 4, str(error)[:200]
                kept[_key(head)] = head | dict(zip(search.COUNTS, counts, strict=True)) | {"status": status}
            rows.append(kept[_key(head)] | {"choice": choice.name, "alternative": alternative})
    return rows


def _key(row: Row) -> tuple[str, ...]:
    return tuple(str(row[key]) for key in ("group", "cloud", "parameters"))


def table(choice: choices.Choice, rows: Sequence[Row]) -> list[Row]:
    """A line per alternative: mean total error per group of clouds, and over the groups. Groups of which some alternative
    has not been run on every cloud are left out."""
    groups = [
        group
        for group in dict.fromkeys(row["group"] for row in rows)
        if len({sum((r["group"], r["alternative"]) == (group, a) for r in rows) for a in choice.alternatives}) == 1
    ]
    lines = []
    for alternative in choice.alternatives:
        line: Row = {"choice": choice.name, "alternative": alternative}
        for group in groups:
            mine = [row for row in rows if row["alternative"] == alternative and row["group"] == group]
            errors = [_total(row) for row in mine if isinstance(row["kept"], int)]
            line["failed"] = line.get("failed", 0) + len(mine) - len(errors)
            line[group] = statistics.fmean(errors) if errors else None
        deciding = [line[group] for group in groups if group in (choice.on or groups) and line[group] is not None]
        line["mean"] = statistics.fmean(deciding) if deciding else None
        lines.append(line)
    found = [line for line in lines if line["mean"] is not None and not line["failed"]]
    least = min((line["mean"] for line in found), default=0.0)
    alike = [line["alternative"] for line in found if line["mean"] < least + TIE]
    for line in lines:
        good, ours = line["alternative"] in alike, line["alternative"] == choice.present
        line["note"] = (
            ("**default**, among the best" if good else "**default**, not the best") if ours else "best" * good
        )
    return lines


def _total(row: Row) -> float:
    wrong, right = row["lost"] + row["accepted"], row["kept"] + row["rejected"]
    return 100 * wrong / (wrong + right)


def _markdown(lines: Sequence[Row]) -> str:
    groups = [key for key in lines[0] if key not in ("choice", "alternative", "failed", "mean", "note")]
    columns: list[Column] = [
        ("alternative", "alternative", ""),
        *((g, g, ".2f") for g in groups),
        ("mean", "mean", ".2f"),
    ]
    return markdown([*columns, ("note", "", "")], lines)


def report(asked: Sequence[choices.Choice], tables: Sequence[Sequence[Row]]) -> str:
    """All tables as Markdown."""
    text = [
        "# Defaults chosen on simulated scenes and tiles",
        "Mean total errors in percent: ten layouts at each density (last echoes), and the labelled tiles that "
        "`experiments/tiles` does not have (all echoes). Fields that are not named are those of `for_cloud`. The last column of "
        f"numbers is the mean of those before it; within {TIE:g} points of the least it counts as among the best.",
    ]
    for choice, lines in zip(asked, tables, strict=True):
        text += [f"## {choice.name}", _markdown(lines) if lines[0]["mean"] is not None else "Not run yet."]
    return "\n\n".join(text) + "\n"


def _parser() -> CommandLine:
    parser = CommandLine(__file__, __doc__)
    parser.add_argument(
        "--choices", nargs="+", metavar="NAME", help="beginnings of their names, such as 'smrf: ' [all]"
    )
    parser.add_argument("--groups", nargs="+", metavar="GROUP", help="of clouds, such as '1 per m2' tiles [all]")
    parser.add_argument("--at-hand", action="store_true", help="run nothing; tables of what earlier runs left")
    parser.add_argument("--fresh", action="store_true", help="run again what is at hand")
    return parser


if __name__ == "__main__":
    main()
