"""Trains the model of doubt, and says what it is worth: ``python -m experiments.default.doubt [--data FOLDER] [--write]``.

The model is fitted to simulated scenes and labelled tiles. Every source of tiles is a test by a model that was fitted without
it, and every layout of scenes likewise. All other clouds are tests only. ``--write`` puts the weights into the package.
"""

from __future__ import annotations

import argparse
import dataclasses
import shlex
import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from unittest import mock

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

import jaxfilter as jf
from experiments.default.search import every_cloud
from experiments.defaults import clouds
from experiments.isprs.samples import data_folder
from experiments.report import write_csv, write_page
from experiments.scenes import clouds as others
from jaxfilter.core.compilation import keep_compilations
from jaxfilter.steps import doubt
from jaxfilter.steps.sensors import MATCHING
from jaxfilter.sweeps.comparison import markdown

HERE = Path(__file__).parent
DENSITIES = (0.3, 4.0)
"""Of the scenes that are added to those of the search, pulses per square metre."""
PER_CLOUD = 4000
"""Points that a cloud has in the training, drawn at random; so each cloud counts the same."""
NEAR = 0.1
"""Metres from the triangulation of the labelled ground; what is so near to it lies on the ground."""
THINNED = 0.5
"""If more than this share of the points on the ground are labelled as something else, labels name but some of the ground."""
RIDGE = 1e-3
BINS = 15
MOST = 0.1


TRAINED = ("tiles", "scenes")
"""Kinds of clouds that models are fitted to; each is scored by a model that has not seen its group."""


@dataclasses.dataclass(frozen=True, eq=False)
class Judged:
    """The judged and scored points of a cloud: evidence f32[n, features], labels and errors bool[n].

    ``group``: the source of a tile, or the layout of a scene. ``unnamed``: see :func:`unnamed`.
    """

    kind: str
    name: str
    group: str
    evidence: np.ndarray
    ground: np.ndarray
    wrong: np.ndarray
    unnamed: float

    @property
    def trains(self) -> bool:
        """Whether a model may be fitted to it."""
        return self.kind in TRAINED and self.unnamed <= THINNED


def unnamed(known: clouds.Known) -> float:
    """Share of the scored points within 0.1 m of the labelled ground, in a triangulation, that are not labelled as ground."""
    height = jf.height_above_ground(known.cloud, known.ground & known.scored)
    near = (np.abs(height) <= NEAR) & known.scored
    return float((~known.ground[near]).mean())


def judged(kind: str, known: clouds.Known) -> Judged:
    """What OST decides on a cloud, and the evidence that it has for it."""
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    kept: list[np.ndarray] = []
    probability = doubt.probability

    def keep(evidence: np.ndarray, ground: np.ndarray) -> np.ndarray:
        kept.append(evidence)
        return probability(evidence, ground)

    method = jf.OST.for_cloud(known.cloud)
    with mock.patch.object(doubt, "probability", keep):
        result = method(known.cloud, workers=1)
    points = method.points_of(known.cloud)
    row = np.full(len(known.cloud), -1)
    row[points.index] = points.member
    rows = np.flatnonzero((row >= 0) & known.scored)
    ground, group = result.ground[rows], known.name if kind == "scenes" else known.group
    wrong, thin = ground != known.ground[rows], unnamed(known) if kind == "tiles" else 0.0
    return Judged(kind, known.name, group, np.concatenate(kept)[row[rows]], ground, wrong, thin)


def every(folder: Path) -> Iterator[tuple[str, clouds.Known]]:
    """The clouds of the search, scenes of further densities, and clouds that are tests only, with their kinds."""
    for known in every_cloud(folder):
        yield {"sit": "samples", "sou": "tiles"}.get(known.group[:3], "scenes"), known
    for density in DENSITIES:
        for layout in clouds.LAYOUTS:
            scene = clouds.load(f"{density:g} per m2", layout, density, folder)
            assert scene is not None
            yield "scenes", dataclasses.replace(scene, name=f"scene {layout}")
    for cloud in others.every(folder):
        hard = cloud.kind == "scenes" and cloud.name.rpartition(" ")[0] in others.HARD
        if not hard and cloud.kind not in ("hard tiles", "sensors", "sparse forests"):
            continue
        site, kind = cloud.make(), "hard scenes" if hard else cloud.kind
        if kind == "sensors":
            matching = jf.OST.for_cloud(site.cloud).sensor == MATCHING
            kind = "photographs" if matching else "other lidar"
        if kind == "sparse forests":
            few = cloud.facts["density"] < doubt.SPARSEST
            kind += f", {'fewer' if few else 'more'} than {doubt.SPARSEST:g} points per m2"
        if site.ground.any():
            yield kind, clouds.Known(cloud.name, kind, site.cloud, site.ground, site.scored)


def fitted(parts: Iterable[Judged]) -> np.ndarray:
    """f64[2, 1 + features]: weights for objects and for ground, by maximum likelihood with a small ridge."""
    rng = np.random.default_rng(0)
    chosen = [(one, rng.choice(len(one.wrong), min(PER_CLOUD, len(one.wrong)), replace=False)) for one in parts]
    x = np.concatenate([one.evidence[rows] for one, rows in chosen]).astype(np.float64)
    y = np.concatenate([one.wrong[rows] for one, rows in chosen]).astype(np.float64)
    ground = np.concatenate([one.ground[rows] for one, rows in chosen])
    return np.stack([_logistic(x[ground == label], y[ground == label]) for label in (False, True)])


def _logistic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """By a trust region, in features of unit variance."""
    mean, spread = x.mean(axis=0), x.std(axis=0) + 1e-6
    z = np.concatenate([np.ones((len(x), 1)), (x - mean) / spread], axis=1)
    ridge = np.diag([0.0, *[RIDGE] * x.shape[1]])

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        p = expit(z @ w)
        return float(np.mean(np.logaddexp(0, z @ w) - y * (z @ w)) + w @ ridge @ w / 2), z.T @ (p - y) / len(
            y
        ) + ridge @ w

    def curvature(w: np.ndarray) -> np.ndarray:
        p = expit(z @ w)
        return (z * (p * (1 - p))[:, None]).T @ z / len(y) + ridge

    start = np.zeros(z.shape[1])
    start[0] = np.log(y.mean() / (1 - y.mean()))
    found = minimize(loss, start, jac=True, hess=curvature, method="trust-exact", options={"gtol": 1e-9})
    if not np.abs(found.jac).max() < 1e-6:
        raise RuntimeError("the fit does not converge")
    weights = found.x[1:] / spread
    return np.concatenate([[found.x[0] - weights @ mean], weights])


def stated(one: Judged, weights: np.ndarray) -> np.ndarray:
    """f32[n]: the doubt of a model with these weights."""
    with mock.patch.object(doubt, "WEIGHTS", weights):
        return doubt.probability(one.evidence, one.ground)


def figures(p: np.ndarray, wrong: np.ndarray) -> dict[str, float]:
    """Expected calibration error, per cent of the errors among the most doubtful tenth, errors and mean doubt in per cent."""
    share, mean, rate = reliability(p, wrong)
    first = np.argsort(-p, kind="stable")[: round(MOST * len(p))]
    return {
        "points": len(p), "errors": 100 * wrong.mean(), "doubt": 100 * float(p.mean(dtype=np.float64)),
        "ece": float((share * np.abs(mean - rate)).sum()), "found": 100 * wrong[first].sum() / max(wrong.sum(), 1),
    }  # fmt: skip


def reliability(p: np.ndarray, wrong: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Share of the points, mean doubt and share of errors in 15 bins of equal width; zero in empty ones."""
    of = np.minimum((p * BINS).astype(int), BINS - 1)
    count = np.bincount(of, minlength=BINS)
    total = np.maximum(count, 1)
    return count / len(p), np.bincount(of, p, BINS) / total, np.bincount(of, wrong, BINS) / total


def left_out(parts: Sequence[Judged]) -> list[tuple[Judged, np.ndarray]]:
    """Each cloud with the doubt by a model that has not seen its source of tiles, or its layout."""
    out = []
    for group in sorted({one.group for one in parts}):
        weights = fitted(one for one in parts if one.trains and one.group != group)
        out += [(one, stated(one, weights)) for one in parts if one.group == group]
    return out


def picture(tests: dict[str, tuple[np.ndarray, np.ndarray]], path: Path) -> None:
    """A reliability diagram: share of errors by doubt, for each test."""
    from jaxfilter.plots.maps import new_figure

    figure = new_figure((4.5, 4.5))
    ax = figure.add_subplot()
    ax.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    for name, (p, wrong) in tests.items():
        share, mean, rate = reliability(p, wrong)
        used = share > 1e-4
        ax.plot(mean[used], rate[used], marker="o", markersize=4, label=name)
    ax.set(xlabel="mean doubt of the bin", ylabel="share of errors", xlim=(0, 1), ylim=(0, 1), aspect="equal")
    ax.legend(frameon=False, fontsize=8)
    figure.savefig(path)


def main() -> None:
    """Fit, test, and write tables, the diagram and, if asked, the weights."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="folder with isprs/ and tiles/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "out", help="folder for the results [%(default)s]")
    parser.add_argument("--write", action="store_true", help="put the weights into the package")
    arguments = parser.parse_args()
    with ProcessPoolExecutor() as pool:
        jobs = [pool.submit(judged, *one) for one in every(data_folder(arguments.data))]
        parts = [job.result() for job in jobs]
    weights = np.round(fitted(one for one in parts if one.trains), 4)
    stated_of = [(one, stated(one, weights)) for one in parts if one.kind not in TRAINED]
    stated_of += left_out([one for one in parts if one.kind in TRAINED])
    kinds = dict.fromkeys(one.kind for one in parts)
    tests = {
        f"{kind}, left out" if kind in TRAINED else kind: tuple(
            np.concatenate(columns)
            for columns in zip(*((p, one.wrong) for one, p in stated_of if one.kind == kind), strict=True)
        )
        for kind in kinds
    }
    rows = [{"what": name, **figures(p, wrong)} for name, (p, wrong) in tests.items()]
    each = [{"what": one.name, **figures(p, one.wrong), "unnamed": 100 * one.unnamed} for one, p in stated_of]
    results = arguments.out
    results.mkdir(parents=True, exist_ok=True)
    write_csv(results / "doubt.csv", rows + each)
    columns = [
        ("what", "clouds", ""), ("points", "points", ",d"), ("errors", "errors %", ".2f"), ("doubt", "mean doubt %", ".2f"),
        ("ece", "ECE", ".3f"), ("found", "errors in the most doubtful 10 % of points, %", ".1f"),
    ]  # fmt: skip
    table = markdown(columns, rows)
    detail = markdown([*columns, ("unnamed", "on the ground, not labelled so, %", ".1f")], each)
    command = shlex.join(["python", "-m", "experiments.default.doubt", *sys.argv[1:]])
    write_page(results / "doubt.md", f"# What doubts are worth\n\n{table}\n\n{detail}", command, ("ost", "scenes"))
    picture(dict(list(tests.items())[:3]), results / "doubt.png")
    print(table)
    if arguments.write:
        values = ([name, *row] for name, row in zip(("object", "ground"), weights.tolist(), strict=True))
        lines = [["label", "constant", *doubt.FEATURES], *values]
        doubt.MODEL.write_text("".join(",".join(map(str, line)) + "\n" for line in lines))


if __name__ == "__main__":
    main()
