"""Bridge decks and water: on surfaces that are written down here, and in a scene whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

import jaxfilter as jf
from jaxfilter.steps.rules.crossings import CrossingsRule, Sizes

SHAPE = (80, 100)
SIZES = Sizes(cell=1.0, spacing=0.7, widest=50.0, step=0.42, drop=1.8, area=30.0)
ROWS, COLUMNS = np.mgrid[: SHAPE[0], : SHAPE[1]]
VALLEY = np.where(abs(COLUMNS - 50) < 15, np.float32(-5), np.float32(0))


def crossed(z: np.ndarray, inside: np.ndarray, objects: np.ndarray, points: np.ndarray | int = 4):
    """Elevations of decks, and of water, in a surface with ``points`` in each cell."""
    seen, points = np.ones(z.shape, bool), np.broadcast_to(points, z.shape)
    rule = CrossingsRule()
    return rule.find(rule.flanks(z.astype(np.float32), seen, inside, points, SIZES), objects, np.float32(0))[:2]


def found(z: np.ndarray) -> np.ndarray:
    """bool: cells of decks in a surface that is known everywhere; what is higher than the valley and in it is no ground."""
    return np.isfinite(crossed(z, np.ones(SHAPE, bool), z > VALLEY + 0.5)[0])


@pytest.mark.parametrize("half", [2, 5, 20])
def test_a_deck_across_a_valley_is_found(half: int):
    """Narrow, usual, wide; its cells and those beside it, no others."""
    on = (abs(ROWS - 40) <= half) & (abs(COLUMNS - 50) < 15)
    deck = found(np.where(on, 0.0, VALLEY))
    assert deck[on].mean() > 0.9
    assert deck[(abs(ROWS - 40) == half + 1) & (abs(COLUMNS - 50) < 13)].mean() > 0.9
    assert not deck[(abs(ROWS - 40) > half + 1) | (abs(COLUMNS - 50) > 16)].any()


def test_a_deck_that_the_border_cuts_is_found():
    on = (abs(ROWS - 40) <= 5) & (abs(COLUMNS - 50) < 15)
    z = np.where(on, 0.0, VALLEY)
    inside = COLUMNS < 50
    deck = np.isfinite(crossed(z, inside, on)[0])
    assert deck[on & inside].mean() > 0.8


@pytest.mark.parametrize(
    "z",
    [
        np.where((abs(ROWS - 40) <= 5) & (abs(COLUMNS - 50) < 10), 3.0, 0.0),  # a roof
        np.where((abs(ROWS - 40) <= 5) & (COLUMNS < 55), 0.0, VALLEY),  # a headland
        np.where(COLUMNS < 50, 3.0, 0.0),  # a terrace
        np.maximum(VALLEY, -np.maximum(abs(ROWS - 40) - 4, 0) / 1.5),  # an embankment, with slopes at its sides
    ],
    ids=["roof", "headland", "terrace", "embankment"],
)
def test_what_is_no_deck_is_not_found(z: np.ndarray):
    assert not found(z).any()


def pool(level: np.ndarray | float, rim: np.ndarray | float, density: int, cells: float = 24.0) -> np.ndarray:
    """bool: cells of water in a round pool with ``density`` points per cell, of 4 beside it, that is ``rim`` metres deep."""
    rng, away = np.random.default_rng(0), np.hypot(ROWS - 40, COLUMNS - 50) - cells
    z = np.where(away < 0, level, np.minimum(away, 1) * rim + 0.02 * away) + 0.02 * rng.standard_normal(SHAPE)
    count, known = np.where(away < 0, density, 4), np.ones(SHAPE, bool)
    return np.isfinite(crossed(z, known, ~known, count)[1])


def test_water_is_level_and_lower_than_its_rim():
    disk = np.hypot(ROWS - 40, COLUMNS - 50) < 24
    for density in (1, 4):
        water = pool(0.0, 1.5, density)
        assert 2 * (water & disk).sum() > 0.95 * (water.sum() + disk.sum())
    assert not pool(0.0, -1.5, 1).any()  # a level terrace
    assert not pool(0.015 * COLUMNS, 1.5, 4).any()  # a floor that slopes as a car park does
    assert not pool(0.0, 6.0, 4, cells=12).any()  # a court
    assert not pool(0.0, np.where(COLUMNS > 60, -1.5, 1.5), 1).any()  # land falls from a part of its edge
    assert pool(0.0, 1.5, 1, cells=12).any()  # a pond, from its points


@pytest.mark.parametrize("slope, found", [(0.0008, True), (0.003, False)])
def test_a_long_river_falls(slope: float, found: bool):
    """A kilometre of a channel, 20 m wide, with few points."""
    rows, columns = np.mgrid[:60, :1000]
    channel, rng = abs(rows - 30) < 10, np.random.default_rng(0)
    z = slope * columns + np.where(channel, 0, 2) + 0.02 * rng.standard_normal(rows.shape)
    water = np.isfinite(crossed(z, rows >= 0, rows < 0, np.where(channel, 1, 4))[1])
    assert water[channel].mean() > 0.95 if found else not water.any()


def test_ost_marks_decks_and_water_in_a_scene(tmp_path):
    layout = jf.scenes.SceneLayout(relief=4, landform=128, river=28, water_echoes=0.8, forest=0, settlement=0)
    scene = jf.scenes.make(layout, size=(440, 180), density=1.2, seed=7)  # with a river and a bridge
    result = jf.OST.for_cloud(scene.cloud)(scene.cloud)
    kind, names = scene.kind, jf.scenes.Kind
    assert result.water is not None and result.deck is not None
    assert not (result.deck & result.ground).any() and result.ground[result.water].all()
    assert (kind[result.water] == names.WATER).mean() > 0.9
    assert result.water[kind == names.WATER].mean() > 0.9
    assert (kind[result.deck] == names.BRIDGE).mean() > 0.8
    assert result.deck[kind == names.BRIDGE].mean() > 0.8
    lakes = jf.breaklines(scene.cloud, result, tmp_path / "water.gpkg")
    levels = np.unique(np.round(scene.xyz[kind == names.WATER, 2]))
    assert len(lakes) and np.isin(np.round(lakes["elevation"]), levels).all()
    assert len(jf.breaklines(scene.cloud, jf.SMRF()(scene.cloud))) == 0
