"""What is told of a cloud's sensor, and what OST makes of it, against scenes whose truth is known."""

import dataclasses
import functools

import numpy as np
import pytest
from click.testing import CliRunner

import jaxfilter as jf
from experiments.scenes.clouds import photographed
from jaxfilter.cli.commands import main
from jaxfilter.core.points import canonical_points
from jaxfilter.scenes import SENSORS, Kind, SceneLayout
from jaxfilter.steps.outliers import lowest_few, pits
from jaxfilter.steps.rules import RULES
from jaxfilter.steps.seeds import rising
from jaxfilter.steps.sensors import AIRBORNE, DRONE, KINDS, MATCHING, MOBILE, SensorFacts
from jaxfilter.steps.surfaces import lowest_cells

SIZES = {AIRBORNE: (90.0, 4.0), DRONE: (40.0, 100.0), MATCHING: (60.0, 30.0), MOBILE: (70.0, 20.0)}


@functools.cache
def scene(sensor, layout="town", seed=101, **options):
    side, density = SIZES[sensor]
    return jf.scenes.make(layout, **{"size": side, "density": density, "seed": seed, "sensor": sensor} | options)


def sensed(cloud):
    return SensorFacts.from_points(canonical_points(cloud))


@pytest.mark.parametrize("sensor", [pytest.param(k, marks=pytest.mark.slow) if k == MOBILE else k for k in KINDS])
def test_the_sensor_of_scenes_is_told(sensor):
    assert set(SENSORS) == set(KINDS)
    told = [sensed(scene(sensor, layout).cloud).kind for layout in ("town", "city", "hills", "forest", "terraces")]
    assert told == [sensor] * 5


def test_lidar_without_echo_numbers_is_told_by_what_is_below_leaves():
    cloud = scene(AIRBORNE, "forest").cloud
    bare = dataclasses.replace(cloud, return_number=None, number_of_returns=None)
    assert sensed(bare).kind == AIRBORNE
    leaves = scene(MATCHING, "forest").cloud
    assert sensed(dataclasses.replace(leaves, return_number=None, number_of_returns=None)).kind == MATCHING


@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_the_thickness_is_that_of_ground(noise):
    """White noise on a slope: residuals of planes through nine points or so, below leaves too."""
    rng = np.random.default_rng(1)
    xy = rng.uniform(0, 40, (60_000, 2))
    z = 0.3 * xy[:, 0] + noise * rng.standard_normal(len(xy))
    leaves = rng.random(len(xy)) < 0.5
    z[leaves] += rng.uniform(2, 10, leaves.sum())
    found = sensed(jf.PointCloud.from_arrays(np.column_stack([xy, z]))).thickness
    assert 0.5 * noise < found < noise


def test_for_cloud_sets_limits_by_the_sensor():
    plain = jf.OST.for_cloud(scene(AIRBORNE).cloud)
    assert plain.sensor == AIRBORNE
    for name in ("tolerance", "noise", "rounds", "low_points", "tolerance_spacing"):
        assert getattr(plain, name) == getattr(jf.OST(), name)
    thin, thick = (jf.OST.for_cloud(scene(DRONE, noise=noise).cloud) for noise in (0.015, 0.04))
    assert thin.sensor == thick.sensor == DRONE
    assert thick.tolerance / thin.tolerance == pytest.approx(0.04 / 0.015, rel=0.15)
    assert thick.noise == thick.tolerance and thin.tolerance < jf.OST().tolerance
    photographs = jf.OST.for_cloud(scene(MATCHING).cloud)
    car = jf.OST.for_cloud(scene(MOBILE).cloud)
    voids = RULES["voids"]
    assert [voids in one.active() for one in (plain, thin, photographs, car)] == [True, True, False, False]
    assert car.spacing > 1.5 * canonical_points(scene(MOBILE).cloud).spacing()
    assert jf.OST.for_cloud(scene(DRONE).cloud, tolerance=0.2).tolerance == 0.2


@pytest.mark.parametrize("count", [0, 1, 2, 40])
def test_few_points_count_as_airborne_lidar(count):
    xyz = np.random.default_rng(0).random((count, 3)) * (20, 20, 1)
    assert jf.OST.for_cloud(xyz).sensor == AIRBORNE
    flat = np.zeros((2000, 3))
    flat[:, 0] = np.arange(2000) * 0.1
    assert jf.OST.for_cloud(flat)(flat).ground.all()


def test_the_sensor_is_said_in_the_result_and_in_the_summary(tmp_path):
    cloud = scene(MATCHING, size=40).cloud
    result = jf.default_filter(cloud)(cloud)
    assert result.info["sensor"] == MATCHING
    jf.write(tmp_path / "photos.las", cloud, cloud.candidate)
    answer = CliRunner().invoke(
        main, ["ground", str(tmp_path / "photos.las"), str(tmp_path / "out.las"), "--units", "m"]
    )
    assert answer.exit_code == 0, answer.output
    assert "OST for image matching: " in answer.output


def test_pits_are_small_and_deep():
    """A lattice of 0.25 m over a slope, with a hole of 2 by 2 m, one of 6 by 6 m, a ditch, and a shallow hole."""
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0.125, 40, 0.25), np.arange(0.125, 40, 0.25)))
    z = 0.2 * x

    def within(x0, y0, width, height):
        return (x >= x0) & (x < x0 + width) & (y >= y0) & (y < y0 + height)

    hole, large, ditch, shallow = within(5, 5, 2, 2), within(15, 5, 6, 6), within(0, 20, 40, 1), within(5, 30, 2, 2)
    z = z - 1.0 * (hole | large | ditch) - 0.15 * shallow
    points = canonical_points(jf.PointCloud.from_arrays(np.column_stack([x, y, z])))
    cells = lowest_cells(points, 1.0, "test", corner=(0.0, 0.0))
    found = points.spread(pits(points.xyz, cells, 0.3, 12.0))
    np.testing.assert_array_equal(found, hole)


def test_wrong_matches_below_the_ground_spoil_nothing():
    """They are many points at one place, and none of them is deep enough to be a low point by itself."""
    made = scene(MATCHING, SceneLayout(relief=6, landform=64, forest=0, trees=0, low_vegetation=0), size=90, seed=4)
    low = made.kind == Kind.LOW_OUTLIER
    assert low.sum() > 100
    points = canonical_points(made.cloud)
    assert points.spread(lowest_few(points.xyz, 25.0, 2.0, 30))[low].mean() < 0.5
    result = jf.default_filter(made.cloud)(made.cloud)
    assert result.ground[low].mean() < 0.1 and result.ground[made.truth].mean() > 0.995
    assert jf.dtm_rmse(made.cloud, result, made.truth).low < 0.1


@pytest.mark.parametrize("corner", [(0.0, 0.0), (0.5, 0.5)], ids=["in one cell", "in four cells"])
def test_a_cluster_of_echoes_below_drone_lidar_spoils_nothing_wherever_cells_lie(corner):
    """It is 0.6 m wide and 7 m deep, below a slope whose foot is as low."""
    rng = np.random.default_rng(2)
    xy = rng.uniform(-20, 20, (120_000, 2))
    ground = np.column_stack([xy, 0.4 * xy[:, 0] + 0.01 * rng.standard_normal(len(xy))])
    low = np.column_stack([corner + rng.uniform(-0.3, 0.3, (13, 2)), rng.uniform(-7.5, -6.5, 13)])
    cloud = jf.PointCloud.from_arrays(np.concatenate([ground, low]) + [200, 200, 50])
    filter_ = jf.OST(sensor=DRONE, spacing=0.1, tolerance=0.06, tolerance_spacing=0.0, noise=0.06)
    found = filter_(cloud).ground
    assert not found[len(ground) :].any() and found[: len(ground)].mean() > 0.99


@pytest.mark.parametrize("seed, sides", [(0, 1), (1, 1), (2, 2), (3, 3)])
def test_what_rises_more_steeply_than_terrain_is_told_pair_by_pair(seed, sides):
    rng = np.random.default_rng(seed)
    xyz = rng.uniform(0, 30, (400, 3)).astype(np.float32) * np.float32([1, 1, 0.3])
    rows, others = rng.choice(400, 90, replace=False), np.arange(0, 400, 2)
    quadrants = [
        {
            tuple(q[:2] > p[:2])
            for q in xyz[others].astype(float)
            if np.hypot(*(p - q)[:2]) <= 5 and p[2] - q[2] > 0.8 * np.hypot(*(p - q)[:2]) + 0.3
        }
        for p in xyz[rows].astype(float)
    ]
    steep = [len(some) >= sides for some in quadrants]
    assert 0 < np.sum(steep) < 90
    np.testing.assert_array_equal(rising(xyz, rows, others, 5.0, 0.8, sides), steep)
    assert not rising(xyz, rows[:0], others, 5.0, 0.8).size


@pytest.mark.parametrize("sensor", [MATCHING, MOBILE])
def test_crowns_at_the_edge_of_what_was_seen_are_no_ground(sensor):
    """Trees on both sides of a void wider than the largest building: the surface between them is level, as a terrace is."""
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0.2, 100, 0.5), np.arange(0.2, 30, 0.5)))
    crown = (np.abs(x - 50) > 30) & (np.abs(x - 50) < 32)
    z = 0.2 * np.sin(x / 4) + np.where(crown, 6 + 0.5 * np.sin(y), 0)
    seen = np.abs(x - 50) > 30
    cloud = jf.PointCloud.from_arrays(np.column_stack([x, y, z])[seen] + [200, 200, 50])
    found = jf.OST(sensor=sensor, spacing=0.5)(cloud).ground
    assert found[crown[seen]].mean() < 0.02 and found[~crown[seen]].all()


@pytest.mark.slow
def test_shadows_of_a_scan_from_a_car_are_no_water():
    """Ground at the edge of a shadow stays: behind a crest it is lower, as beside a quay."""
    made = scene(MOBILE, "hills", size=100, density=20)
    filter_ = jf.default_filter(made.cloud)
    lost = {}
    for rules in (None, ("voids", "halls", "steep", "ramps")):
        ground = filter_.replace(rules=rules)(made.cloud).ground
        lost[rules is None] = 100 * (made.truth & ~ground).sum() / made.truth.sum()
    assert lost[True] < min(0.1, lost[False] / 2)


@pytest.mark.parametrize(
    "sensor, layout", [pytest.param(MATCHING, "town", marks=pytest.mark.slow), (DRONE, "hills"), (MOBILE, "city")]
)
def test_ost_is_close_to_the_best_on_clouds_of_other_sensors(sensor, layout):
    made = scene(sensor, layout)
    total, rmse = {}, {}
    for method in (jf.OST, jf.SMRF, jf.CSF, jf.PTD):
        result = method.for_cloud(made.cloud)(made.cloud)
        total[method] = jf.evaluate(result, made.truth, ignore=~made.cloud.candidate).total
        rmse[method] = jf.dtm_rmse(made.cloud, result, made.truth).rmse
    assert total[jf.OST] < min(total.values()) + 0.3 and rmse[jf.OST] < 1.05 * min(rmse.values())


@pytest.mark.slow
@pytest.mark.parametrize("scene, error, rmse", [("village", 9.0, 0.2), ("quarry", 4.5, 0.55)])
def test_walls_of_photographs_are_no_rock_on_level_land_and_faces_are_no_ramps_on_steep_land(scene, error, rmse):
    site = photographed(scene, 21)
    result = jf.OST.for_cloud(site.cloud)(site.cloud)
    assert jf.evaluate(result, site.ground).total < error
    assert jf.dtm_rmse(site.cloud, result, site.ground).rmse < rmse
