"""PTDF: PTD with a limit below the facet."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

import jaxfilter as jf

PUBLISHED = Path(__file__).resolve().parents[1] / "experiments" / "isprs" / "published"
SEEDS = {"seed_cell": 30.0, "low_clusters": False}


@pytest.fixture(scope="module")
def hillside():
    """A grid of points on a slope of 1 in 5, f64[n, 3], and two flat-bottomed hollows: bool[n] 0.4 m, bool[n] 0.05 m deep.

    The lowest points of cells of 30 m lie at their western edges, so that no hollow holds a seed.
    """
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0.0, 91), np.arange(0.0, 91)))
    deep, shallow = (np.hypot(x - 50, y - at) < 5 for at in (45, 15))
    return np.column_stack([x, y, 0.2 * x - 0.4 * deep - 0.05 * shallow]), deep, shallow


def test_without_the_limit_it_is_ptd(hillside):
    one, two = jf.PTDF(max_below=math.inf, **SEEDS)(hillside[0]), jf.PTD(max_distance=1.5, **SEEDS)(hillside[0])
    assert (one.ground == two.ground).all()
    np.testing.assert_array_equal(one.margin, two.margin)


@pytest.mark.parametrize("limit, reached", [(0.1, False), (0.3, False), (0.5, True)])
def test_a_hollow_is_lost_where_it_is_deeper_than_the_limit(hillside, limit, reached):
    xyz, deep, shallow = hillside
    result = jf.PTDF(max_below=limit, **SEEDS)(xyz)
    level = (xyz[:, 0] < 70) & ~deep
    assert result.ground[level].all() and result.ground[shallow].all()
    assert result.ground[deep].mean() > 0.9 if reached else not result.ground[deep].any()
    low = result.decision == jf.Decision.LOW
    assert (low[deep]).all() != reached
    np.testing.assert_allclose(result.margin[low], -result.height[low] - limit, atol=1e-4)


def test_presets_hold_the_values_of_table_2():
    with open(PUBLISHED / "cai2023_table2.csv", newline="") as file:
        printed = {row["parameter"]: float(row["value"]) for row in csv.DictReader(file) if row["method"] == "PTDF"}
    paper = jf.PTDF.preset("paper")
    assert printed == {
        "window_size": paper.seed_cell,
        "terrain_angle": paper.max_terrain_angle,
        "iteration_angle": paper.max_angle,
        "iteration_distance": paper.max_distance,
    }


@pytest.mark.data
def test_it_loses_more_ground_than_ptd_and_accepts_fewer_objects(sample):
    for number in (24, 41):
        cloud = sample(number, own_corner=True)
        upward, both = (jf.evaluate(f(cloud), cloud.reference) for f in (jf.PTDF(), jf.PTD(max_distance=1.5)))
        assert upward.type1 > both.type1 + 5 and upward.type2 <= both.type2
