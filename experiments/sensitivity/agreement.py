"""Whether a sweep gives every point the label of the single call: random sets of all methods on all samples. See README.md."""

from __future__ import annotations

import itertools
import sys
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import spaces
from experiments.report import Column, Row, markdown
from experiments.sensitivity.study import Study
from jaxfilter.core.compilation import keep_compilations
from jaxfilter.core.filter import ground_each
from jaxfilter.core.params import declared
from jaxfilter.sweeps.ranges import around, search_ranges

GROUP = 16
"""Sets of one sweep."""
SLOW = {"ost": 4, "ppdf": 8}
"""Sets of one sweep of methods that take long."""


def main(arguments: list[str] | None = None) -> None:
    """Compare until the sets are used up, and write the table."""
    study = Study("agreement", __doc__, arguments, sets=1500)
    keep_compilations()
    clouds = study.clouds()
    rows: dict[str, Counter[str]] = {name: Counter() for name in (*spaces.method_names(), "all")}
    found: list[str] = []
    for method, sample, sets in drawn({name: len(cloud) for name, cloud in clouds.items()}):
        sets = sets[: study.options.sets - rows["all"]["sets"]]
        if not sets:
            break
        differ, kinds = compared(sets, clouds[sample])
        more = {"sets": len(sets), "points": len(sets) * len(clouds[sample]), "differ": sum(differ), "kinds": kinds}
        for name in (method, "all"):
            rows[name].update(more)
        found += [f"{sample}: {count} labels: {one}" for one, count in zip(sets, differ, strict=True) if count]
        print(dict(rows["all"]), flush=True)
    table: list[Row] = [{"method": name.upper(), **row} for name, row in rows.items() if row]
    columns: list[Column] = [
        ("method", "method", ""), ("sets", "sets", ",d"), ("kinds", "different labellings", ",d"),
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
    study.write("agreement", text, table, rows)


def drawn(sizes: dict[str, int]) -> Iterator[tuple[str, str, list[jf.Filter]]]:
    """Method, sample and sets of one sweep after the other, without end: all methods in turn, small samples more often."""
    rng = np.random.default_rng(0)
    seldom = 1 / np.array(list(sizes.values()))
    for method in itertools.chain.from_iterable(rng.permutation(spaces.method_names()) for _ in itertools.count()):
        sample = str(rng.choice(list(sizes), p=seldom / seldom.sum()))
        try:
            base = varied(rng, spaces.fixed(method, sample))
            yield method, sample, [base.replace(**fields) for fields in thresholds(rng, base)]
        except jf.ParameterError:
            continue  # a choice that the other fields do not go with


def varied(rng: np.random.Generator, base: jf.Filter) -> jf.Filter:
    """The filter itself, one of its presets, or with another choice in one field."""
    kind = rng.integers(4)
    if kind == 2:
        return type(base).preset(str(rng.choice(list(base.PRESETS))))
    choices = [field for field in declared(base) if field.metadata.get("choices")]
    if kind < 2 or not choices:
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
    count = SLOW.get(type(base).__name__.lower(), GROUP)
    return [{name: one.at(rng.random()) for name, one in ranges.items()} for _ in range(count)]


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
