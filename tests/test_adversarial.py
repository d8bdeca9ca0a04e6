"""Clouds that are made to cause errors, and random parameters: every method gives labels or a clear error, soon."""

import time
import warnings

import numpy as np
import pytest

import jaxfilter as jf
from jaxfilter.core.params import declared

QUICK = "ost", "ptd", "smrf"
FILTERS = [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in sorted(jf.FILTERS)]
SECONDS = 10.0  # of the processor, without what is compiled once for all clouds


def slope(points):
    """f64[n, 3]: a rough slope, one point a square metre."""
    rng = np.random.default_rng(5)
    xy = rng.uniform(0, points**0.5, (points, 2))
    return np.column_stack([xy, 0.05 * xy[:, 0] + rng.normal(0, 0.03, points)]).round(2)


def walls(points):
    """A quarter on the ground, half in forty vertical lines, a quarter in a vertical wall."""
    rng, size, part = np.random.default_rng(6), (points / 4) ** 0.5, points // 4
    lines = np.repeat(rng.uniform(0, size, (40, 2)), part // 20, axis=0)
    lines = np.column_stack([lines, rng.uniform(0, 30, len(lines))])
    wall = np.column_stack([rng.uniform(0, size, part), np.full(part, size / 2), rng.uniform(0, 40, part)])
    return np.concatenate([slope(part), lines, wall]).round(2)


def lattice(points):
    """A regular grid with steps: all positions cocircular, most heights equal."""
    x, y = np.indices([int(points**0.5)] * 2).reshape(2, -1).astype(float)
    return np.column_stack([x, y, 3.0 * ((x // 25 + y // 25) % 2)])


def duplicates(points):
    """One point in half of the rows, and a thousand others twice or more."""
    some = slope(1000)
    return np.concatenate([np.repeat(some[:1], points // 2, axis=0), np.repeat(some, max(2, points // 2000), axis=0)])


def millimetres(points):
    """Points 1 mm apart, with a step of 20 cm."""
    x, y = np.indices([int(points**0.5)] * 2).reshape(2, -1) / 1000
    step = 0.2 * (abs(x - x.mean()) < 0.1 * x.max())
    return np.column_stack([x, y, np.random.default_rng(7).normal(step, 0.002)]).round(3)


CLOUDS = {
    "walls": walls,
    "lattice": lattice,
    "duplicates": duplicates,
    "millimetres": millimetres,
    "offsets": lambda points: slope(points) + [1e9, -1e9, 1e9],
    "far east": lambda points: np.concatenate([slope(points), [[1e6, 50.0, 0.0]]]),
    "far south-west": lambda points: np.concatenate([slope(points), [[-1e6, -1e6, 0.0]]]),
    "five points": lambda _: np.array([[0, 0, 0], [10, 0, 0.1], [0, 10, 0.2], [10, 10, 3], [5, 5, 0.1]]),
}


@pytest.fixture(scope="module", params=FILTERS)
def method(request, town):
    method = jf.FILTERS[request.param]
    method()(town.xyz)  # compiles
    return method


@pytest.mark.parametrize("points", [2000, pytest.param(200_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n == "millimetres" else n for n in CLOUDS])
def test_odd_clouds_give_labels_or_a_clear_error(method, name, points):
    xyz = CLOUDS[name](points)
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jf.JaxfilterWarning)
        try:
            result = method()(xyz)
        except jf.InputError as error:
            assert name.startswith("far") and "stray points" in str(error) and "1 of" in str(error)
        else:
            assert not name.startswith("far") and len(result) == len(xyz) and result.ground.any()
    assert time.process_time() - start < SECONDS


SPARSE = np.random.default_rng(3).uniform(0, (600, 500, 0.1), (300, 3)) + [0, 0, 1000]
"""300 points on level ground at 1,000 m, in every 30th cell of a metre."""


@pytest.mark.parametrize(("filter_", "words"), [
    (lambda: jf.SPF(cell=1.0, fill="zero"), None),  # cells at elevation 0 all round raise every other: no seed is left
    (lambda: jf.STIN(outlier_surface="quadratic", outlier_distance=1e-6), None),  # all points are outliers
    (lambda: jf.OST(spacing=1e9), ""),
    (lambda: jf.FPTD(radius=1.0, min_neighbours=10**9), "must be >= 1 and <= 4096"),
    pytest.param(lambda: jf.OST(landscape=1e9, window=1000.0), "", marks=pytest.mark.slow),
    (lambda: jf.CSF(resolution=0.3, iterations=10_000), "so many steps of .* particles for 300 points"),
    (lambda: jf.CSF(time_step=1e9), "must be > 0 and <= 10"),
    (lambda: jf.AGPTD(neighbours=10**6), "must be >= 0 and <= 4096"),
    (lambda: jf.PTD(seed_cell=0.001), r"PTD\(seed_cell=0.001\): the seeds need .* use larger ones"),
    (lambda: jf.SMRF(cell=0.5, window=300.0), "600 openings of .* cells for 300 points: use larger cells or a smaller"),
    (lambda: jf.PPDF(window=3000.0), "more than 1000 cells of canopy_cell=2 m"),
])  # fmt: skip
def test_odd_parameters_give_labels_or_a_clear_error(filter_, words):
    if words == "":
        assert filter_()(SPARSE * [0.05, 0.05, 1.0]).ground.any()
    elif words is None:
        with pytest.warns(jf.JaxfilterWarning, match="no point is left as a seed of the ground"):
            ground = filter_()(SPARSE).ground
        assert ground[SPARSE[:, 2].argmin()]
    else:
        with pytest.raises((jf.ParameterError, jf.InputError), match=words):
            filter_()(SPARSE)


def drawn(field, rng):
    """A value that the declaration of a field allows: a choice, an end of its range, or up to 10,000 times the default."""
    meta, default = field.metadata, field.default
    if meta.get("choices") is not None:
        return meta["choices"][rng.integers(len(meta["choices"]))]
    if meta.get("optional") and rng.random() < 0.3:
        return None
    limits = meta["limits"].items()
    low = next((bound + 1e-6 * (sign == ">") for sign, bound in limits if ">" in sign), -1e9)
    high = next((bound - 1e-6 * (sign == "<") for sign, bound in limits if "<" in sign), 1e9)
    scale = default if isinstance(default, int | float) and 0 < default < 1e9 else 1.0
    some = scale * 10 ** rng.uniform(-4, 4)
    value = min(max((low, high, some, some, some)[rng.integers(5)], low), high)
    if field.type in ("int", int):
        return int(np.ceil(low) if value == low else np.floor(value))
    return float("inf") if meta.get("endless") and rng.random() < 0.2 else float(value)


MORE = [pytest.param(range(first, first + 10), marks=pytest.mark.slow) for first in range(1, 70, 10)]


@pytest.mark.parametrize("draws", [[0], *MORE])
@pytest.mark.parametrize("name", sorted(jf.FILTERS))
def test_random_parameters_give_labels_or_a_clear_error(name, draws):
    method = jf.FILTERS[name]
    fields = declared(method)
    for number in draws:
        rng = np.random.default_rng([sorted(jf.FILTERS).index(name), number])
        values = {field.name: drawn(field, rng) for field in fields if rng.random() < 0.5}
        xyz, start = walls(400) * 10 ** rng.uniform(-0.5, 2), time.process_time()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", jf.JaxfilterWarning)
                assert len(method(**values)(xyz, workers=2)) == len(xyz)
        except (jf.ParameterError, jf.InputError) as error:
            words = [field.name for field in fields] + [repr(value) for value in values.values()]
            assert any(word in str(error) for word in (*words, "larger cells")), (values, str(error))
        except Exception as error:
            raise AssertionError(values) from error
        assert time.process_time() - start < 6 * SECONDS, values
