"""CSF: the cloth against one moved particle by particle, and labels against the authors' package."""

import os
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

import jaxfilter as jf
from jaxfilter.engines.cloth import drape as module
from jaxfilter.engines.cloth.drape import drape, join_slopes
from jaxfilter.engines.cloth.surface import fill_along_lines, lowest_below

MOVES = {1: (0.3, 0.3), 2: (0.51, 0.42), 3: (0.657, 0.468)}
RING = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (1, -1), (1, 0), (0, 1), (1, 1)]
PACKAGE = """
import sys, numpy, CSF
clouds = numpy.load(sys.argv[1])
labels = {}
for name in clouds:
    csf = CSF.CSF()
    csf.setPointCloud(clouds[name])
    ground, rest = CSF.VecInt(), CSF.VecInt()
    csf.do_filtering(ground, rest, False)
    labels[name] = numpy.isin(numpy.arange(len(clouds[name])), numpy.asarray(ground))
numpy.savez(sys.argv[2], **labels)
"""


def one_by_one(limit, moves, fall, tolerance, iterations):
    """The cloth with plain loops, in double precision."""
    rows, columns = limit.shape
    z, before, pinned = np.zeros(limit.shape), np.zeros(limit.shape), np.zeros(limit.shape, bool)
    for taken in range(1, iterations + 1):  # noqa: B007
        z, before = np.where(pinned, z, z + 0.99 * (z - before) - fall), np.where(pinned, before, z)
        for y, x in np.ndindex(rows, columns):
            for dx, dy in RING + [(2 * dx, 2 * dy) for dx, dy in RING]:
                v, u = y + dy, x + dx
                if not (0 <= v < rows and 0 <= u < columns):
                    continue
                gap = z[v, u] - z[y, x]
                share = moves[0] if pinned[y, x] or pinned[v, u] else moves[1]
                z[y, x] += 0 if pinned[y, x] else share * gap
                z[v, u] -= 0 if pinned[v, u] else share * gap
        most = np.abs(z - before)[~pinned].max(initial=0)
        pinned |= z < limit
        z = np.where(pinned & (z < limit), limit, z)
        if 0 < most < tolerance:
            break
    return z, pinned, taken


def ragged(rng, rows, columns):
    y, x = np.mgrid[:rows, :columns]
    z = -3 + 2 * np.sin(x / 4) + np.cos(y / 3) - 0.1 * x + rng.normal(0, 0.1, (rows, columns))
    z[rows // 3 : rows // 2, columns // 3 : columns // 2] -= 6
    return (z - z.max() - 0.05).astype(np.float32)


@pytest.mark.parametrize(
    "rigidness, shape, tolerance, iterations",
    [
        (1, (11, 14), 0.005, 500), (2, (14, 9), 0.005, 500), (3, (6, 21), 0.005, 8), (2, (1, 30), 0.005, 500),
        (3, (40, 2), 0.005, 500), (1, (1, 1), 0.005, 30), (3, (11, 14), 0.0, 19),
    ],
)  # fmt: skip
def test_the_cloth_is_that_of_one_particle_after_the_other(rng, monkeypatch, rigidness, shape, tolerance, iterations):
    """The last one is not at rest after two sweeps and a part of one."""
    monkeypatch.setattr(module, "_SWEEP", module._SWEEP if tolerance else 8)
    limit = ragged(rng, *shape)
    z, pinned, steps = one_by_one(limit.astype(float), MOVES[rigidness], 0.0357, tolerance, iterations)
    cloth = drape(limit, MOVES[rigidness], 0.0357, tolerance, iterations)
    assert cloth.steps == steps and steps > 5 and (steps == iterations or steps < 200)
    np.testing.assert_allclose(cloth.height, z, atol=1e-4)
    assert (cloth.pinned == pinned).all() and (0 < pinned.sum() < pinned.size or pinned.size == 1)


@pytest.mark.parametrize("sweep, parts", [(50, 24), (7, 3), (2, 40)])
def test_the_cloth_does_not_depend_on_threads_or_sweeps(rng, monkeypatch, sweep, parts):
    limit = ragged(rng, 90, 170)
    alone = drape(limit, MOVES[2], 0.0357, 0.005, 90, workers=1)
    for name, value in (("_LEAST", 1), ("_SWEEP", sweep), ("_PARTS", parts)):
        monkeypatch.setattr(module, name, value)
    shared = drape(limit, MOVES[2], 0.0357, 0.005, 90, workers=5)
    for one, other in zip(alone, shared, strict=True):
        np.testing.assert_array_equal(one, other)
    assert alone.pinned.any() and not alone.pinned.all()


def test_empty_nodes_take_the_next_value_along_lines(rng):
    known = rng.random((9, 12)) < 0.15
    known[4], known[:, 5] = False, False
    z = rng.normal(size=known.shape).astype(np.float32)
    filled = np.asarray(fill_along_lines(jnp.asarray(z), jnp.asarray(known), jnp.ones(known.shape, bool)))
    for y, x in np.ndindex(known.shape):
        lines = (z[y, x:][known[y, x:]], z[y, :x][known[y, :x]][::-1],
                 z[:y, x][known[:y, x]][::-1], z[y:, x][known[y:, x]])  # fmt: skip
        first = next((line[0] for line in lines if len(line)), None)
        assert filled[y, x] in z[known]
        assert first is None or filled[y, x] == first


def test_slopes_join_as_when_grown_step_by_step(rng):
    limit = ndimage.gaussian_filter(rng.normal(0, 9, (60, 70)), 3).astype(np.float32)
    free = ndimage.gaussian_filter(rng.normal(size=(60, 70)), 2.5) > 0
    label, n = ndimage.label(free)
    sizes = ndimage.sum(free, label, range(n + 1))
    grown = ~free
    while True:
        new = grown.copy()
        for y, x in np.argwhere(~grown & (sizes[label] > 50)):
            around = [(y + dy, x + dx) for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))]
            new[y, x] = any(
                0 <= v < 60 and 0 <= u < 70 and grown[v, u] and abs(limit[y, x] - limit[v, u]) < 0.3 for v, u in around
            )
        if (new == grown).all():
            break
        grown = new
    joined = join_slopes(limit, ~free, 0.3)
    assert (joined == (grown & free)).all()
    assert 0 < joined.sum() < free.sum() and (sizes[1:] <= 50).any()


def test_a_particle_takes_the_nearest_or_the_lowest_of_its_points(rng):
    xyz = np.column_stack([rng.uniform(0, 9, (400, 2)), rng.normal(0, 5, 400)]).astype(np.float32)
    xyz[50:60, :2] = xyz[:10, :2]
    carries = rng.random(400) < 0.9
    frame, extent = np.array([-2, -2, 1], np.float32), np.array([14, 14], np.int32)
    node = np.floor(xyz[:, :2] + 2.5).astype(int)
    for nearest in (True, False):
        height, found = (np.asarray(a) for a in lowest_below(xyz, carries, frame, extent, (16, 20), nearest))
        for y, x in np.ndindex(16, 20):
            own = np.flatnonzero((node == (x, y)).all(axis=1) & carries)
            assert found[y, x] == (len(own) > 0)
            if len(own):
                far = np.round(((xyz[own, :2] + 2 - (x, y)) ** 2).sum(axis=1), 5) if nearest else np.zeros(len(own))
                assert height[y, x] == xyz[own[np.lexsort((xyz[own, 2], far))[0]], 2]


def package_labels(clouds, folder):
    """What cloth-simulation-filter says, in a process with one thread: with more it does not repeat itself."""
    pytest.importorskip("CSF", reason="the authors' program is not installed: pip install cloth-simulation-filter")
    np.savez(folder / "clouds.npz", **clouds)
    line = [sys.executable, "-c", PACKAGE, str(folder / "clouds.npz"), str(folder / "labels.npz")]
    subprocess.run(line, check=True, stdout=subprocess.DEVNULL, env=os.environ | {"OMP_NUM_THREADS": "1"})
    return np.load(folder / "labels.npz")


def test_scenes_and_isprs_samples_get_the_labels_of_the_package(data: Path, tmp_path):
    scenes = {name: jf.scenes.make(name, size=(90, 80), density=1.5, seed=4).cloud for name in ("town", "forest")}
    xyz = {name: cloud.xyz[cloud.candidate].astype(float) for name, cloud in scenes.items()}
    xyz |= {name: np.loadtxt(data / "isprs" / f"{name}.txt")[:, :3] for name in ("samp21", "samp24", "samp31")}
    expected = package_labels(xyz, tmp_path)
    for name, one in xyz.items():
        given = one if name in scenes else jf.PointCloud.from_arrays(one, anchor=one[:, :2].min(axis=0))
        ground = jf.CSF.preset("wheel")(given).ground  # their cloth begins at the anchor
        assert (ground == expected[name]).mean() >= 0.98, name
        assert 0.1 < ground.mean() < 0.9, name


def test_gravity_of_the_program_is_weaker_than_that_of_the_equation():
    scene = jf.scenes.make("town", size=(80, 80), density=1.0, seed=2)
    steps = [jf.CSF(gravity=gravity)(scene.cloud) for gravity in ("equation", "program")]
    assert steps[0].height[scene.cloud.candidate].mean() > 0
    side = 80 / jf.CSF().resolution
    assert side**2 < steps[0].info["particles"] < (side + 6) ** 2
    same = jf.CSF(gravity="equation", time_step=0.65**2)(scene.cloud)
    assert (same.ground == jf.CSF(gravity="program", time_step=0.65)(scene.cloud).ground).all()
    assert steps[0].ground.sum() > steps[1].ground.sum()
