"""The simulated surveys: closed forms, counts and invariants."""

import dataclasses

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree

from jaxfilter import scenes
from jaxfilter.core.errors import ParameterError
from jaxfilter.scenes import LAYOUTS, Kind, SceneLayout

BARE = SceneLayout(relief=20, forest=0, trees=0, low_vegetation=0)


@pytest.fixture(scope="module")
def ready():
    """One scene of every ready layout."""
    return {name: scenes.make(name, size=(450, 400), density=0.8, seed=3) for name in LAYOUTS}


def above_terrain(scene):
    return scene.xyz[:, 2] - scene.terrain(scene.xyz[:, 0], scene.xyz[:, 1])


def bare(size=1, density=50, pulses=None, **layout):
    """A scene of bare ground and what is named of a layout; by default to ask for its terrain only."""
    return scenes.make(dataclasses.replace(BARE, **layout), size=size, density=density, **(pulses or {}))


def land_share(scene):
    """Share of the extent that is not water, on a lattice of its own."""
    x, y = (scene.origin[k] + np.arange(0.5, scene.size[k], 1.7) for k in (0, 1))
    return 1 - scene.water(x[:, None], y[None, :]).mean()


def last_echoes(scene):
    return scene.return_number == scene.number_of_returns


def components(scene, kind, cell):
    """Label the 8-connected groups of cells that hold points of a kind: indices of the points, their group."""
    index = np.flatnonzero(scene.kind == kind)
    ij = np.floor((scene.xyz[index, :2] - scene.origin[:2]) / cell).astype(int)
    mask = np.zeros(ij.max(axis=0) + 2, bool)
    mask[tuple(ij.T)] = True
    label, _ = ndimage.label(mask, np.ones((3, 3)))
    return index, label[tuple(ij.T)]


def test_scenes_are_the_same_in_every_version(ready):
    """Figures in the documents rest on them: points by kind, and means of x, y and z from the scene's corner."""
    figures = {
        "flat": ([124064, 2473, 0, 222, 7970, 22037, 24, 3, 272], [223.186, 198.827, 2.308]),
        "town": ([109794, 14388, 495, 1152, 4996, 30665, 23, 2, 775], [216.617, 194.586, 3.724]),
        "city": ([91771, 33313, 580, 2524, 818, 14525, 124, 3, 699], [212.419, 200.861, 5.226]),
        "hills": ([99925, 1807, 552, 327, 6092, 86479, 23, 3, 194], [216.15, 193.986, 22.822]),
        "mountain": ([105362, 0, 0, 0, 5094, 77422, 22, 3, 0], [219.119, 196.789, 18.619]),
        "forest": ([50436, 0, 0, 0, 12266, 170812, 9, 2, 0], [221.257, 199.609, 12.875]),
        "quarry": ([112176, 0, 0, 0, 7318, 60288, 24, 3, 0], [217.534, 193.387, 5.33]),
        "terraces": ([117114, 437, 0, 63, 7415, 46130, 24, 2, 26], [218.9, 198.028, 39.298]),
        "mixed": ([106967, 5302, 907, 639, 6185, 44338, 24, 2, 461], [204.512, 189.67, 1.374]),
        "benchmark": ([110302, 2963, 874, 408, 4791, 47714, 1, 2, 362], [209.688, 192.261, -0.501]),
        "coast": ([20368, 0, 0, 0, 1616, 528, 20, 3, 0], [78.783, 208.886, -18.758]),
        "gorge": ([92203, 0, 1232, 0, 5817, 105109, 21, 2, 0], [212.082, 194.455, 4.833]),
        "benches": ([107478, 0, 0, 0, 6947, 74093, 24, 3, 0], [210.615, 191.961, -1.915]),
        "vineyard": ([106680, 0, 0, 0, 20705, 40841, 24, 3, 0], [218.503, 197.728, 130.494]),
        "canopy": ([57552, 0, 0, 0, 3260, 147221, 1, 3, 0], [220.592, 198.348, 12.454]),
    }
    assert set(figures) == set(ready)
    for name, (points, middle) in figures.items():
        found = np.bincount(ready[name].kind)
        assert len(found) <= Kind.WATER, name
        found = np.append(found, np.zeros(Kind.WATER - len(found), int))
        np.testing.assert_allclose(found, points, atol=2, err_msg=name)  # one system's sines may differ from another's
        np.testing.assert_allclose(
            (ready[name].xyz - ready[name].origin).mean(axis=0), middle, atol=0.002, err_msg=name
        )


@pytest.mark.parametrize("sensor, points, middle", [
    ("drone lidar", [12677, 10130, 0, 716, 135, 596, 3, 3, 117], [30.402, 24.993, 8.287]),
    ("image matching", [9801, 10106, 0, 723, 95, 253, 9, 19, 2899], [29.901, 25.003, 8.256]),  # walls are ramps
    ("mobile", [8405, 0, 0, 1706, 18, 131, 0, 0, 3719], [33.061, 10.279, 1.512]),  # walls are seen, roofs are not
])  # fmt: skip
def test_scenes_of_sensors_are_the_same_in_every_version(sensor, points, middle):
    found = scenes.make("city", size=(60, 50), density=8, seed=3, sensor=sensor)
    np.testing.assert_allclose(np.bincount(found.kind), points, atol=2)
    np.testing.assert_allclose((found.xyz - found.origin).mean(axis=0), middle, atol=0.002)


@pytest.mark.parametrize("name", ["mixed", "forest"])
def test_the_same_arguments_give_the_same_bytes(name):
    def bytes_of(seed):
        scene = scenes.make(name, size=150, density=3, seed=seed)
        return [getattr(scene, key).tobytes() for key in ("xyz", "kind", "return_number", "number_of_returns")]

    assert bytes_of(5) == bytes_of(5)
    assert bytes_of(5) != bytes_of(6)


@pytest.mark.parametrize("density, size, options", [
    (0.1, 700, {}), (1, 300, {"pattern": "zigzag"}), (4, (400, 150), {"swath": 100, "overlap": 0.3}), (50, 40, {}),
])  # fmt: skip
def test_density_is_as_asked(density, size, options):
    scene = scenes.make("mixed", size=size, density=density, **options)
    measured = last_echoes(scene).sum() / (np.prod(scene.size) * land_share(scene))
    assert measured == pytest.approx(density, rel=0.1)


def test_points_lie_inside_the_extent_on_the_lattice_of_the_rounding():
    for step in (0.01, 0.001):
        scene = scenes.make("town", size=(120, 80), rounding=step)
        local = scene.xyz - scene.origin
        assert local[:, :2].min() >= -1e-6 and (local[:, :2].max(axis=0) <= np.array([120, 80]) + 1e-6).all()
        assert np.abs(scene.xyz / step - np.rint(scene.xyz / step)).max() < 1e-5
    assert np.abs(scene.xyz * 100 - np.rint(scene.xyz * 100)).max() > 0.05  # millimetres are not centimetres


def test_a_scene_that_no_pulse_meets_is_empty_and_the_size_has_a_default():
    found = scenes.make("town", size=1, density=0.1, seed=1)
    assert len(found) == len(found.cloud) == len(found.truth) == 0 and found.xyz.shape == (0, 3)
    assert scenes.make("flat", density=0.1).size == (400.0, 300.0)


@pytest.mark.parametrize("noise", [0.0, 0.03, 0.2])
def test_ground_points_are_terrain_plus_noise(noise):
    scene = scenes.make("mixed", size=160, noise=noise, rounding=0.001)
    residual = above_terrain(scene)[scene.truth]
    assert residual.std() == pytest.approx(np.hypot(noise, 0.001 / np.sqrt(12)), rel=0.02)
    assert abs(residual.mean()) < 5 * max(noise, 0.001) / np.sqrt(len(residual))


def test_echoes_of_a_pulse_are_complete_and_in_order(ready):
    for name, scene in ready.items():
        number, total = scene.return_number.astype(int), scene.number_of_returns.astype(int)
        assert (number >= 1).all() and (number <= total).all()
        starts = np.flatnonzero(number == 1)
        np.testing.assert_array_equal(np.diff(np.append(starts, len(scene))), total[starts], err_msg=name)
        same = np.arange(len(scene)) - np.repeat(starts, total[starts])
        np.testing.assert_array_equal(number, same + 1)
        within = number[1:] > 1
        assert (np.diff(scene.xyz[:, 2])[within] < 0).all(), name
        assert (np.diff(scene.xyz[:, :2], axis=0)[within] == 0).all(), name
        below = np.isin(scene.kind, (Kind.GROUND, Kind.LOW_VEGETATION, Kind.BRIDGE, Kind.CAR, Kind.LOW_OUTLIER))
        assert (number == total)[below].all(), name
    assert ready["forest"].number_of_returns.max() >= 4


def test_terrain_depends_on_neither_density_nor_extent_nor_company():
    near = scenes.make("mixed", size=100, density=1, seed=9)
    far = scenes.make("mixed", size=(700, 300), density=0.3, seed=9, noise=0.2)
    x, y = near.origin[:2, None] + np.random.default_rng(0).uniform(-300, 1500, (2, 400))
    z = near.terrain(x, y)
    np.testing.assert_array_equal(z, far.terrain(x, y))
    np.testing.assert_array_equal(z[:5], [near.terrain(a, b) for a, b in zip(x[:5], y[:5], strict=True)])


@pytest.mark.slow
def test_objects_depend_on_neither_density_nor_extent():
    def top(scene):
        """Highest roof per 5 m cell of the first 100 m."""
        local = scene.xyz - scene.origin
        k = (scene.kind == Kind.BUILDING) & (local[:, :2] < 100).all(axis=1)
        z = np.full((20, 20), -np.inf)
        np.maximum.at(z, tuple(np.floor(local[k, :2] / 5).astype(int).T), local[k, 2])
        return z

    a = top(scenes.make("city", size=100, density=20, seed=1, noise=0))
    b = top(scenes.make("city", size=(300, 200), density=30, seed=1, noise=0))
    both = np.isfinite(a) & np.isfinite(b)
    assert both.sum() > 40
    assert np.median(np.abs(a[both] - b[both])) < 0.1


def test_relief_is_four_standard_deviations_of_the_terrain():
    scene = bare(relief=40, landform=32)
    x, y = scene.origin[:2, None] + np.random.default_rng(1).uniform(0, 4000, (2, 20_000))
    assert scene.terrain(x, y).std() == pytest.approx(10, rel=0.15)


def test_smaller_hurst_exponents_are_rougher():
    def roughness(hurst):
        scene = bare(hurst=hurst)
        x, y = scene.origin[:2, None] + np.random.default_rng(1).uniform(0, 500, (2, 3000))
        return (scene.terrain(x - 2, y) - 2 * scene.terrain(x, y) + scene.terrain(x + 2, y)).std()

    assert roughness(0.6) > 3 * roughness(1.0) > 9 * roughness(1.5)


WET = dataclasses.replace(BARE, water_echoes=0.8, scan_angle=20)


@pytest.mark.parametrize("shape", [{"river": 60}, {"river": 60, "quay": True}, {"lake": 60}], ids=str)
def test_water_is_level_and_returns_less_at_an_angle(shape):
    scene = scenes.make(dataclasses.replace(WET, **shape), size=(520, 300), density=2, noise=0, swath=100)
    x, y, z = scene.xyz.T
    wet = scene.kind == Kind.WATER
    assert np.ptp(z[wet]) < 0.011 and (scene.classes == 9).sum() == wet.sum() > 1000
    assert scene.water(x, y)[wet].all() and np.abs(scene.water_level(x, y) - z)[wet].max() < 0.006
    assert (scene.terrain(x, y) < z)[wet].all()  # the bed
    bank = scene.truth & ~scene.water(x, y)
    bank[bank] = cKDTree(scene.xyz[wet, :2]).query(scene.xyz[bank, :2], distance_upper_bound=3)[0] < 3
    assert bank.sum() > 100 and (z[bank] > z[wet].min() - 0.01).all()

    def off_centre(x, y):
        """0 in the middle of a strip of the flight, 1 at its sides."""
        x, y, heading = x - scene.origin[0], y - scene.origin[1], np.radians(8)
        return np.abs(((x * np.cos(heading) - y * np.sin(heading)) % 100) / 50 - 1)

    u, v = np.meshgrid(*(scene.origin[k] + np.arange(0.5, scene.size[k]) for k in (0, 1)))
    ranges = [0, 0.3, 0.7, 1]
    echoes, _ = np.histogram(off_centre(x, y)[wet], ranges)
    area, _ = np.histogram(off_centre(u, v)[scene.water(u, v)], ranges)
    share = echoes / (2 * area)
    assert 0.3 < share[0] < 0.8 and share[2] < 0.06


@pytest.mark.slow
def test_boats_reeds_and_weirs_stand_on_the_water():
    layout = dataclasses.replace(WET, river=80, boats=0.3, reeds=0.5, weir=True, bridges=False)
    scene = scenes.make(layout, size=(520, 300), density=4, noise=0)
    x, y, z = scene.xyz.T
    above, wet = z - scene.water_level(x, y), scene.water(x, y)
    for kind, least, most in ((Kind.CAR, 1, 3), (Kind.WALL, 1, 1), (Kind.LOW_VEGETATION, 0.3, 2)):
        found = above[wet & (scene.kind == kind)]
        assert len(found) > 100 and found.min() > least - 0.01 and found.max() < most + 0.01


@pytest.mark.parametrize("shape, width, clear", [
    ({"road": 30, "bridge_rise": 6, "bridge_width": 20}, 20, 6), ({"river": 30, "bridge_rise": 3, "bridge_width": 4}, 4, 7),
    ({"cutting": 7, "bridge_skew": 45}, 10, 6),
], ids=str)  # fmt: skip
def test_decks_have_their_width_and_join_ramps_without_a_step(shape, width, clear):
    scene = bare((520, 300), 5, {"noise": 0}, relief=0, **shape)
    index, group = components(scene, Kind.BRIDGE, 2.0)
    largest = index[group == 1 + np.bincount(group)[1:].argmax()]
    x, y, z = scene.xyz[largest].T
    np.testing.assert_allclose(scene.deck(x, y), z, atol=0.006)
    assert np.median(z - scene.terrain(x, y)) == pytest.approx(clear, abs=1.5)
    spread = scene.xyz[largest, :2] - scene.xyz[largest, :2].mean(axis=0)
    along = np.linalg.svd(spread, full_matrices=False)[2][0]
    middle = np.abs(spread @ along) < 6
    assert np.ptp((spread @ (-along[1], along[0]))[middle]) == pytest.approx(width, rel=0.15, abs=0.8)
    ends = scene.truth & (np.hypot(*(scene.xyz[:, :2] - scene.xyz[largest, :2].mean(axis=0)).T) < 60)
    step, _ = cKDTree(scene.xyz[ends]).query(scene.xyz[largest])
    assert np.count_nonzero(step < 0.6) > 4  # ground beside the deck at its level


@pytest.mark.slow
def test_causeways_are_ground_and_jetties_end_over_water():
    dam, jetty = (
        scenes.make(dataclasses.replace(WET, river=40, relief=0, **more), size=(520, 300), density=4, noise=0)
        for more in ({"causeway": True}, {"jetty": 25, "bridges": False})
    )
    assert not (dam.kind == Kind.BRIDGE).any()
    x, y, z = dam.xyz.T
    over = dam.truth & (z > dam.origin[2] - 1.01) & (z < dam.origin[2] - 0.99) & (np.abs(dam.terrain(x, y) - z) < 0.01)
    assert over.sum() > 500 and not dam.water(x, y)[over].any()
    deck = jetty.kind == Kind.BRIDGE
    assert jetty.water(*jetty.xyz[deck, :2].T).mean() > 0.8
    assert 0.6 * 4 * 25 * 4 < deck.sum() < 2.2 * 4 * 30 * 4


def test_outliers_lie_where_they_are_said_to():
    layout = dataclasses.replace(LAYOUTS["flat"], low_clusters=150.0, low_outliers=1e-4, high_outliers=1e-4)
    scene = scenes.make(layout, size=450, density=4, noise=0)
    height = above_terrain(scene)
    low, high = (scene.kind == k for k in (Kind.LOW_OUTLIER, Kind.HIGH_OUTLIER))
    assert -height[low].max() >= 2 - 0.01 and -height[low].min() <= 30.01
    assert height[high].min() >= 20 - 0.01 and 300 < height[high].max() <= 1100
    assert (height[~low] > -0.01).all()
    index, group = components(scene, Kind.LOW_OUTLIER, 1.5)
    count = np.bincount(group)[1:]
    assert (count == 1).sum() > 20 and 60 < count.max() <= 130
    largest = index[group == 1 + count.argmax()]
    assert np.ptp(scene.xyz[largest, :2], axis=0).max() < 15
    depth = -height[largest]
    assert depth.std() < 0.3 * depth.mean()  # one depth per cluster


def test_zigzag_lines_turn_and_parallel_lines_fly_back():
    steps = {}
    for pattern in ("zigzag", "parallel"):
        scene = scenes.make(BARE, size=100, density=4, pattern=pattern)
        steps[pattern] = np.linalg.norm(np.diff(scene.xyz[:, :2], axis=0), axis=1)
    assert (steps["zigzag"] > 50).sum() <= 1
    assert (steps["parallel"] > 50).sum() > 100


@pytest.mark.parametrize(("size", "density", "seed"), [(400, 1, 0), (150, 12, 1), (1000, 0.3, 2)])
def test_benchmark_is_at_least_half_ground(size, density, seed):
    assert scenes.make("benchmark", size=size, density=density, seed=seed).truth.mean() >= 0.5


def test_cloud_carries_echoes_and_truth_but_no_classes(ready):
    scene = ready["town"]
    cloud = scene.cloud
    np.testing.assert_array_equal(cloud.reference, scene.truth)
    np.testing.assert_array_equal(cloud.candidate, last_echoes(scene))
    assert not cloud.classification.any()
    np.testing.assert_allclose(cloud.coordinates(), scene.xyz, atol=6e-4)
    np.testing.assert_array_equal(scene.classes == 2, scene.truth)
    np.testing.assert_array_equal(scene.classes == 6, scene.kind == Kind.BUILDING)
    assert set(np.unique(ready["mixed"].classes)) == {1, 2, 3, 5, 6, 7, 17, 18}


def test_terrain_grid_samples_cell_centres_of_the_clouds_grid(ready):
    scene = ready["hills"]
    z, grid = scene.terrain_grid(3.0)
    assert z.shape == grid.shape
    j, i = 7, 11
    x = scene.cloud.origin[0] + grid.x0 + (i + 0.5) * 3
    y = scene.cloud.origin[1] + grid.y0 + (j + 0.5) * 3
    assert z[j, i] == pytest.approx(float(scene.terrain(x, y)), abs=1e-9)
    xy = scene.cloud.coordinates()[:, :2]
    cells = np.ceil(xy.max(axis=0) / 3) - np.floor(xy.min(axis=0) / 3)  # of a lattice that counts from zero
    assert (grid.nx, grid.ny) == tuple(cells)
    cell = grid.flat(scene.cloud.xyz)[scene.truth]
    seen = np.unique(cell)
    mean = ndimage.mean(scene.xyz[scene.truth, 2], cell, seen)
    assert np.median(np.abs(mean - z.ravel()[seen])) < 0.3
    with pytest.raises(ParameterError, match=r"cell=0"):
        scene.terrain_grid(0)


PLAIN = SceneLayout(relief=0, forest=0, trees=0, low_vegetation=0, low_clusters=0)


def test_errors_of_photographs_are_those_of_their_neighbours():
    scene = scenes.make(PLAIN, size=60, sensor="image matching", seed=2, noise=0.08, rounding=0.001)
    wrong = np.isin(scene.kind, (Kind.LOW_OUTLIER, Kind.HIGH_OUTLIER))
    assert 0.0005 < wrong.mean() < 0.02 and (scene.kind[~wrong] == Kind.GROUND).all()
    error, xy = above_terrain(scene)[~wrong], scene.xyz[~wrong, :2]
    assert error.std() == pytest.approx(0.08, rel=0.15) and len(scene) == pytest.approx(50 * 3600, rel=0.02)
    pairs = cKDTree(xy)
    alike = {}
    for metres in (0.15, 6.0):
        _, other = pairs.query(xy + (metres, 0))
        near = np.hypot(*(xy[other] - xy - (metres, 0)).T) < 0.1
        alike[metres] = np.corrcoef(error[near], error[other[near]])[0, 1]
    assert alike[0.15] > 0.8 and abs(alike[6.0]) < 0.1
    assert (np.abs(above_terrain(scene)[wrong]) > 0.2).mean() > 0.9


def test_drone_lidar_is_dense_and_thin():
    scene = scenes.make("forest", size=40, sensor="drone lidar", seed=3)
    assert last_echoes(scene).sum() / 1600 == pytest.approx(200, rel=0.1)
    assert above_terrain(scene)[scene.truth].std() == pytest.approx(0.015, rel=0.05)
    assert (scene.number_of_returns > 1).mean() > 0.3


@pytest.mark.parametrize("call, options, message", [
    (scenes.make, {"layout": "moon"}, "layout='moon'"),
    (scenes.make, {"size": (100, -1)}, "size=-1"),
    (scenes.make, {"size": (1, 2, 3)}, r"size=\(1, 2, 3\)"),
    (scenes.make, {"density": 0}, r"density=0\): must be between 0.1 and 1000"),
    (scenes.make, {"seed": -1}, "seed=-1"),
    (scenes.make, {"seed": 1.5}, "seed=1.5"),
    (scenes.make, {"noise": float("nan")}, "noise=nan"),
    (scenes.make, {"pattern": "spiral"}, "pattern='spiral'"),
    (scenes.make, {"rounding": 0.1}, "rounding=0.1"),
    (scenes.make, {"origin": (0, 0)}, "origin="),
    (scenes.make, {"sensor": "radar"}, "sensor='radar'"),
    (SceneLayout, {"relief": -1}, "relief=-1"),
    (SceneLayout, {"forest": 1.2}, "forest=1.2"),
    (SceneLayout, {"pit": "deep"}, "pit='deep'"),
    (SceneLayout, {"bridges": 2}, "bridges=2"),
    (SceneLayout, {"settlement": 0.5, "houses": 0, "rows": 0, "halls": 0, "parks": 0}, "settlement"),
])  # fmt: skip
def test_bad_arguments_are_named(call, options, message):
    with pytest.raises(ParameterError, match=message):
        call(**options)
