"""Whether a sweep gives every point the label of the single call: random sets of all methods on all samples. See README.md."""

from __future__ import annotations

import argparse
import itertools
import shlex
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples, spaces
from experiments.report import Row, markdown, write_csv, write_page
from jaxfilter.core.compilation import keep_compilations
from jaxfilter.core.filter import ground_each
from jaxfilter.core.params import declared
from jaxfilter.sweeps.ranges import Range, around, search_ranges

HERE = Path(__file__).parent
GROUP = 16
"""Sets of one sweep."""
SLOW = {"ost": 4, "ppdf": 8}
"""Sets of one sweep of methods that take long."""


def main(arguments: list[str] | None = None) -> None:
    """Compare until the sets or the time are used up, and write the table."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="folder with isprs/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    parser.add_argument("--sets", type=int, default=5000, help="[%(default)s]")
    parser.add_argument("--minutes", type=float, default=60.0, help="no sweep begins later [%(default)s]")
    parser.add_argument("--seed", type=int, default=0, help="[%(default)s]")
    options = parser.parse_args(given)
    folder = samples.data_folder(options.data)
    options.out.mkdir(parents=True, exist_ok=True)
    keep_compilations()
    clouds = {name: jf.read(samples.sample_path(folder, name)) for name in samples.SAMPLES}
    rows: dict[str, Row] = {}
    found: list[str] = []
    end = time.monotonic() + 60 * options.minutes
    done = 0
    for method, sample, sets in drawn(options.seed, {name: len(cloud) for name, cloud in clouds.items()}):
        if done >= options.sets or time.monotonic() > end:
            break
        sets = sets[: options.sets - done]
        differ, kinds = compared(sets, clouds[sample])
        row = rows.setdefault(
            method, {"method": method.upper(), "sets": 0, "on": set(), "points": 0, "differ": 0, "kinds": 0}
        )
        row["sets"] += len(sets)
        row["on"].add(sample)
        row["points"] += len(sets) * len(clouds[sample])
        row["differ"] += sum(differ)
        row["kinds"] += kinds
        found += [f"samp{sample}: {count} labels: {one}" for one, count in zip(sets, differ, strict=True) if count]
        done += len(sets)
        print(f"{done} sets, {sum(r['differ'] for r in rows.values())} labels differ", end="\r", flush=True)
    table = [{**rows[name], "on": len(rows[name]["on"])} for name in spaces.method_names() if name in rows]
    table.append(
        {"method": "all", **{key: sum(row[key] for row in table) for key in ("sets", "points", "differ", "kinds")}}
    )
    write_csv(options.out / "agreement.csv", table)
    command = shlex.join(["python", "experiments/sensitivity/agreement.py", *given])
    columns = [
        ("method", "method", ""), ("sets", "sets", ",d"), ("on", "samples", "d"), ("kinds", "different labellings", ",d"),
        ("points", "labels", ",d"), ("differ", "differ from the single call", ",d"),
    ]  # fmt: skip
    text = [
        "# Sweeps against single calls",
        f"Each set is classified in a sweep of up to {GROUP} and alone; all labels are compared. "
        "What the sets of a sweep share is the method as `for_cloud` gives it, one of its presets, or another choice in one of "
        "its fields. The fields that calibration searches are drawn from their ranges, the other thresholds of a third of the "
        "sweeps from half to twice their defaults.",
        markdown(columns, table),
        *found,
    ]
    write_page(options.out / "agreement.md", "\n\n".join(text), command, rows)
    print(f"\nresults are in {options.out}")


def drawn(seed: int, sizes: dict[str, int]) -> Iterator[tuple[str, str, list[jf.Filter]]]:
    """Method, sample and sets of one sweep after the other, without end: all methods in turn, small samples more often."""
    rng = np.random.default_rng(seed)
    seldom = 1 / np.array(list(sizes.values()))
    for method in itertools.chain.from_iterable(rng.permutation(spaces.method_names()) for _ in itertools.count()):
        sample = str(rng.choice(list(sizes), p=seldom / seldom.sum()))
        try:
            base = varied(rng, spaces.fixed(method, f"samp{sample}"))
            yield method, sample, [base.replace(**fields) for fields in thresholds(rng, base)]
        except jf.ParameterError:
            continue  # a choice that the other fields do not go with


def varied(rng: np.random.Generator, base: jf.Filter) -> jf.Filter:
    """The filter itself, one of its presets, or with another choice in one field."""
    kind = rng.integers(4)
    if kind < 2:
        return base
    if kind == 2:
        return type(base).preset(str(rng.choice(list(base.PRESETS))))
    choices = [field for field in declared(base) if field.metadata.get("choices")]
    if not choices:
        return base
    field = choices[rng.integers(len(choices))]
    options = field.metadata["choices"]
    return base.replace(**{field.name: options[rng.integers(len(options))]})


def thresholds(rng: np.random.Generator, base: jf.Filter) -> list[dict[str, Any]]:
    """The values of traced fields of every set."""
    traced = {field.name: field for field in declared(base) if not field.metadata["static"]}
    ranges = {name: one for name, one in search_ranges(type(base)).items() if name in traced}
    if rng.random() < 1 / 3:
        ranges = {name: around(field) for name, field in traced.items() if around(field)} | ranges
    return [
        {name: value(rng, one) for name, one in ranges.items()}
        for _ in range(SLOW.get(type(base).__name__.lower(), GROUP))
    ]


def value(rng: np.random.Generator, one: Range) -> float:
    """Any number of a range, with all its digits."""
    if one.scale == "whole":
        return float(rng.integers(one.low, one.high + 1))
    if one.scale == "log":
        return float(np.exp(rng.uniform(np.log(one.low), np.log(one.high))))
    return float(rng.uniform(one.low, one.high))


def compared(sets: list[jf.Filter], cloud: jf.PointCloud) -> tuple[list[int], int]:
    """How many labels of every set differ between the sweep and the single call, and how many sets have labels of their own."""
    points = sets[0].points_of(cloud)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        swept = dict(ground_each(sets[0], points, sets, key=None, workers=None, memory=2e9))
        alone = [one(cloud).ground for one in sets]
    assert sorted(swept) == list(range(len(sets)))
    differ = [int((points.spread(swept[number]) != ground).sum()) for number, ground in enumerate(alone)]
    return differ, len({ground.tobytes() for ground in alone})


if __name__ == "__main__":
    main()
