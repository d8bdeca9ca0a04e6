"""Tiles over files: every point has one core, every window its files."""

from __future__ import annotations

import numpy as np
import pytest

import jaxfilter as jf
from jaxfilter.surveys.plan import HALOS, POINTS, WHOLE, plan_tiles


def survey(n: int = 60, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Boxes of files, some of which overlap, some of them a point or without points, far from zero."""
    rng = np.random.default_rng(seed)
    low = rng.uniform(0, 5000, (n, 2)) + [3e5, -4e6]
    bounds = np.concatenate([low, low + rng.uniform(0, 900, (n, 2))], axis=1)
    bounds[0, 2:] = bounds[0, :2]
    counts = rng.integers(1, 10**6, n)
    counts[1], bounds[1] = 0, np.nan
    return np.round(bounds, 2), counts


@pytest.mark.parametrize(
    "how",
    [
        {"halo": 35.0, "lattice": 10.0},
        {"halo": 0.0},
        {"halo": 60.0, "lattice": 7.0},
        {"halo": 100.0, "lattice": 1.0, "side": 333.0, "metre": 0.3048},
    ],
)
def test_every_point_has_one_core_and_every_window_all_files_that_meet_it(how):
    bounds, counts = survey()
    plan = plan_tiles(bounds, counts, **{"metre": 1.0, **how})
    cores = np.array([plan.core(t) for t in range(len(plan))])
    windows = np.array([plan.window(t) for t in range(len(plan))])
    rng = np.random.default_rng(1)
    for file in np.flatnonzero(counts):
        x0, y0, x1, y1 = bounds[file]
        xy = np.concatenate([rng.uniform((x0, y0), (x1, y1), (40, 2)), [(x0, y0), (x1, y1), (x0, y1)]])
        inside = ((xy[:, None] >= cores[:, :2]) & (xy[:, None] < cores[:, 2:])).all(axis=2)
        assert (inside.sum(axis=1) == 1).all()
        assert set(inside.argmax(axis=1)) <= set(plan.tiles_of[file])
        meets = (windows[:, :2] <= (x1, y1)).all(axis=1) & (windows[:, 2:] > (x0, y0)).all(axis=1)
        near = np.array([file in plan.near[t] for t in range(len(plan))])
        assert (near >= meets).all() and all(file in plan.home[t] for t in plan.tiles_of[file])
    metre, lattice = how.get("metre", 1.0), how.get("lattice", 1.0)
    halo = how["halo"] / metre
    steps = windows * metre / lattice
    assert np.allclose(steps, np.round(steps), rtol=0, atol=1e-4), "windows end on the lattice"
    around = np.concatenate([cores[:, :2] - windows[:, :2], windows[:, 2:] - cores[:, 2:]], axis=1)
    assert (around >= halo - 1e-4).all() and (around < halo + lattice / metre + 1e-4).all()
    if "side" not in how:
        density = counts.sum() / ((bounds[:, 2] - bounds[:, 0]) * (bounds[:, 3] - bounds[:, 1]))[counts > 0].sum()
        assert len(plan) > 1 and plan.points.max() <= max(POINTS, density * (HALOS * how["halo"]) ** 2)
    width, height = plan.largest()
    sides = windows[:, 2:] - windows[:, :2]
    assert (sides <= np.array([width, height]) + 1e-4).all()


def test_expected_points_are_those_of_evenly_filled_files():
    bounds, counts = np.array([[0.0, 0, 1000, 1000], [1000, 0, 2000, 1000]]), np.array([1_000_000, 2_000_000])
    plan = plan_tiles(bounds, counts, metre=1.0, halo=100.0, side=500.0)
    at = {tuple(plan.core(t)[:2]): plan.points[t] for t in range(len(plan))}
    assert at[500.0, 500.0] == pytest.approx(600 * 600 + 100 * 600 * 2, rel=0.01)
    assert at[0.0, 0.0] == pytest.approx(600 * 600, rel=0.01)


def test_points_on_the_upper_edge_need_no_tiles_of_their_own():
    bounds = np.array([[5.0, 5.0, 1000.0, 1000.0]])
    assert len(plan_tiles(bounds, np.array([WHOLE]), halo=0.0, lattice=10.0)) == 1
    assert len(plan_tiles(bounds, np.array([WHOLE + 1]), halo=0.0, lattice=10.0)) == 4
    assert len(plan_tiles(bounds, np.array([4 * POINTS - POINTS // 5]), halo=0.0, lattice=10.0)) == 4


@pytest.mark.parametrize("apart, tiles", [(500.0, 1), (50_000.0, 2)])
def test_files_far_from_each_other_are_no_single_tile(apart, tiles):
    """Of few points, in boxes of 250 m."""
    low = np.array([[3e5, -4e6], [3e5 + apart, -4e6 + apart]])
    plan = plan_tiles(np.concatenate([low, low + 250], axis=1), np.full(2, 10**6), metre=1.0, halo=100.0)
    assert len(plan) == tiles and plan.points.sum() == 2 * 10**6
    assert max(plan.width, plan.height) < 2000


def test_what_cannot_be_planned_is_refused():
    bounds, counts = np.array([[0.0, 0, 1000, 1000]]), np.array([10**9])
    with pytest.raises(jf.ParameterError, match="halo=inf"):
        plan_tiles(bounds, counts, halo=np.inf)
    with pytest.raises(jf.ParameterError, match=r"tile=0\.0"):
        plan_tiles(bounds, counts, metre=1.0, halo=0.0, side=0.0)
    with pytest.raises(jf.InputError, match="stray points"):
        plan_tiles(np.array([[0.0, 0, 1e7, 1e7]]), np.array([10]), metre=1.0, halo=0.0, side=1.0)
    assert len(plan_tiles(np.full((1, 4), np.nan), np.array([0]), metre=1.0, halo=10.0)) == 0
