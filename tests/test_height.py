"""Heights above ground: of all points, and written without loss of anything else."""

from __future__ import annotations

import laspy
import numpy as np
import pytest
from commands import done, facts, run
from las_files import make_copc, make_las
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

import jaxfilter as jf
from jaxfilter.core.cloud import QUANTUM


def expected_heights(xyz, ground):
    """By SciPy: linear between ground points, nearest outside of them; f64[n]."""
    local = xyz - xyz.min(axis=0)
    surface = LinearNDInterpolator(local[ground, :2], local[ground, 2])(local[:, :2])
    nearest = NearestNDInterpolator(local[ground, :2], local[ground, 2])(local[:, :2])
    return local[:, 2] - np.where(np.isnan(surface), nearest, surface)


def a_file(path, point_format=6, n=600, **fields):
    """Random points of distinct positions, a third of them ground."""
    rng = np.random.default_rng(5)
    place = rng.permutation(10_000)[:n]
    ground = np.arange(n) % 3 == 0
    x, y = place % 100 * 100 + rng.integers(0, 60, n), place // 100 * 80 + rng.integers(0, 50, n)
    z = np.where(ground, 500 + 20 * np.sin(x / 900) + y // 100, rng.integers(500, 30_000, n))
    classes = np.where(ground, 2, rng.choice([1, 5, 7, 9], n)).astype(np.uint8)
    return make_las(
        path, point_format, n=n, X=x, Y=y, Z=z, classification=classes, withheld=np.zeros(n, bool), **fields
    )


def test_heights_are_those_of_scipy():
    rng = np.random.default_rng(2)
    xyz = rng.uniform(0, 60, (3000, 3)) * [1, 1, 0.2]
    xyz = np.rint(xyz / QUANTUM) * QUANTUM
    ground = rng.random(3000) < 0.3
    ground[np.hypot(*(xyz[:, :2] - 30).T) > 26] = False  # many points outside the hull
    heights = jf.height_above_ground(jf.PointCloud.from_arrays(xyz), ground)
    assert heights.dtype == np.float64 and (heights[ground] == 0).all()
    difference = np.abs(heights - expected_heights(xyz, ground))
    assert np.quantile(difference, 0.99) < 0.002 and np.median(difference) < 1e-6


FEW = [[0, 0, 1], [5, 5, 5], [9, 9, 8]]
SQUARE = [[0, 0, 0], [32, 0, 8], [0, 32, 0], [32, 32, 8], [16, 0, 9], [32, 16, 9], [8, 32, 9], [8, -4, 9]]
FEET = [[0, 0, 10], [30, 0, 10], [0, 30, 10], [10, 10, 25], [np.nan, 1, 1], [40, 40, 2.5]]


@pytest.mark.parametrize("xyz, ground, units, expected", [
    (FEET, [0, 1, 2, 4], "ft", [0, 0, 0, 15, 0, -7.5]),  # what has no coordinates is no ground, whatever its label
    (SQUARE, [0, 1, 2, 3], "m", [0, 0, 0, 0, 5, 1, 7, 9]),  # on its sides they are linear, beyond the nearest point counts
    (FEW, [0], "m", [0, 4, 7]), (FEW, [0, 1], "m", [0, 0, 3]),  # too few for a triangle: of the nearest
])  # fmt: skip
def test_heights_of_few_points(xyz, ground, units, expected):
    cloud = jf.PointCloud.from_arrays(np.array(xyz, float), units=units, drop_invalid=True)
    heights = jf.height_above_ground(cloud, np.isin(np.arange(len(xyz)), ground))
    np.testing.assert_allclose(heights, expected, atol=2 * QUANTUM / cloud.units.z)
    with pytest.raises(jf.InputError, match="no point is ground"):
        jf.height_above_ground(cloud, np.zeros(len(xyz), bool))


def test_stray_points_far_off():
    xyz = np.array([[0, 0, 10], [30, 0, 10], [0, 30, 10], [10, 10, 25], [5e6, 10, 12], [10, 4e6, 13]])
    ground = np.arange(6) < 3
    with np.errstate(invalid="raise"):  # as of numbers that the lattice of triangles does not hold
        heights = jf.height_above_ground(jf.PointCloud.from_arrays(xyz), ground)
    np.testing.assert_allclose(heights, [0, 0, 0, 15, 2, 3])
    with pytest.raises(jf.InputError, match=r"140 km apart.* leave out stray ones"):
        jf.height_above_ground(jf.PointCloud.from_arrays(np.where(xyz > 1e6, 3e5, xyz)), np.ones(6, bool))
    with pytest.raises(jf.InputError, match=r"more than 2097 km from the corner.* leave out stray ones"):
        jf.height_above_ground(jf.PointCloud.from_arrays(xyz + np.where(ground, 3e6, 0)[:, None] * [1, 0, 0]), ground)


@pytest.mark.parametrize("point_format, suffix, replace", [
    (1, ".las", False), (3, ".laz", False), (6, ".laz", False), (7, ".las", False), (6, ".las", True), (6, ".laz", True),
])  # fmt: skip
def test_heights_are_written_and_nothing_else_is_changed(tmp_path, point_format, suffix, replace):
    """As an extra dimension, or in place of Z: then its extent changes, too."""
    source, target = tmp_path / f"in{suffix}", tmp_path / f"out{suffix}"
    a_file(source, point_format, extra=True)
    said = facts("height", source, target, *["--replace-z"] * replace)
    before, after = laspy.read(source), laspy.read(target)
    for name in set(before.point_format.dimension_names) - ({"Z"} if replace else set()):
        np.testing.assert_array_equal(after[name], before[name])
    found = after.z if replace else after["HeightAboveGround"]
    expected = expected_heights(np.asarray(before.xyz), np.asarray(before.classification) == 2)
    np.testing.assert_allclose(found, expected, atol=0.02)
    assert said["highest"] == pytest.approx(found.max(), abs=0.01 if replace else 1e-3)
    assert after.header.mins[2] == after.z.min() and after.header.maxs[2] == after.z.max()


def test_found_on_the_way(tmp_path, scene):
    """With --filter, the classes are those that jaxfilter ground writes, and the heights those above them."""
    jf.write(tmp_path / "in.las", scene.cloud, np.zeros(len(scene), bool), reset="none")
    done("height", tmp_path / "in.las", tmp_path / "out.las", "--filter", "smrf")
    done("ground", "smrf", tmp_path / "in.las", tmp_path / "ground.las")
    out, ground = laspy.read(tmp_path / "out.las"), laspy.read(tmp_path / "ground.las")
    np.testing.assert_array_equal(out.classification, ground.classification)
    heights = jf.height_above_ground(jf.read(tmp_path / "ground.las"))
    np.testing.assert_array_equal(out["HeightAboveGround"], heights.astype(np.float32))


@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_a_dimension_that_is_there_is_renewed(tmp_path, kind):
    """PDAL writes it as a double."""
    las = a_file(tmp_path / "first.las", 6)
    las.add_extra_dim(laspy.ExtraBytesParams("HeightAboveGround", kind))
    las.write(tmp_path / "in.las")
    done("height", tmp_path / "in.las", tmp_path / "out.las")
    out = laspy.read(tmp_path / "out.las")
    assert list(out.point_format.extra_dimension_names) == ["HeightAboveGround"]
    assert out["HeightAboveGround"].dtype == kind and out["HeightAboveGround"].max() > 1


def test_copc_becomes_laz(tmp_path):
    make_copc(tmp_path / "in.copc.laz")
    cloud = jf.read(tmp_path / "in.copc.laz")
    heights = np.arange(len(cloud)) / 4
    with pytest.warns(jf.JaxfilterWarning, match="COPC"):
        jf.write(tmp_path / "out.laz", cloud, None, heights=heights, replace_z=True)
    out = laspy.read(tmp_path / "out.laz")
    np.testing.assert_allclose(out.z, heights, atol=0.006)
    np.testing.assert_array_equal(out.classification, cloud.classification)


def test_text_and_arrays_become_las(tmp_path):
    xyz = np.random.default_rng(0).uniform(0, 50, (200, 3))
    np.savetxt(tmp_path / "in.txt", np.column_stack([xyz, np.arange(200) % 2]), fmt="%.3f")
    done("height", tmp_path / "in.txt", tmp_path / "out.laz", "--replace-z")
    out = laspy.read(tmp_path / "out.laz")
    np.testing.assert_allclose(out.z, expected_heights(xyz.round(3), np.arange(200) % 2 == 0), atol=0.05)
    assert out.header.mins[2] == out.z.min()


def test_what_cannot_be_is_said(tmp_path):
    a_file(tmp_path / "in.las", 6)
    a_file(tmp_path / "none.las", 6)
    las = laspy.read(tmp_path / "none.las")
    las.classification[:] = 1
    las.write(tmp_path / "none.las")
    for arguments, code, words in (
        ([tmp_path / "none.las", tmp_path / "out.las"], 1, "no point is ground"),
        ([tmp_path / "in.las", tmp_path / "out.txt"], 2, "out.txt: heights need .las or .laz"),
        ([tmp_path / "in.las", tmp_path / "in.las"], 2, "--in-place"),
        ([tmp_path / "in.las"], 2, "OUT is missing"),
        ([tmp_path / "in.las", tmp_path / "out.las", "--filter", "nothing"], 2, "no method 'nothing'"),
    ):
        result = run("height", *arguments)
        assert result.exit_code == code and words in result.stderr and result.stderr.count("\n") == 1, result.output
    cloud = jf.read(tmp_path / "in.las")
    with pytest.raises(jf.InputError, match="600 finite numbers"):
        jf.write(tmp_path / "out.las", cloud, None, heights=np.full(600, np.nan))
    with pytest.raises(jf.OutputError, match="32 bits"):
        jf.write(tmp_path / "out.las", cloud, None, heights=np.full(600, 1e9), replace_z=True)
    with pytest.raises(jf.ParameterError, match="pass heights="):
        jf.write(tmp_path / "out.las", cloud, None, replace_z=True)
    with pytest.raises(jf.OutputError, match=r"needs .las or .laz"):
        jf.write(tmp_path / "out.txt", cloud, np.zeros(600, bool), heights=np.zeros(600))
    with pytest.raises(jf.OutputError, match="there are none; pass result="):
        jf.write(tmp_path / "out.txt", cloud, None)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in.las", "none.las"]
