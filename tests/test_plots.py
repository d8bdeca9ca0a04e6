"""Pictures: what is drawn is what was given."""

from __future__ import annotations

import numpy as np
import pytest

from jaxfilter import plots
from jaxfilter.core.cloud import PointCloud
from jaxfilter.core.errors import InputError
from jaxfilter.core.grid import Grid


@pytest.fixture(scope="module")
def cloud():
    """20,000 points on a plane with a 20 m wide void, some of them 5 m above it."""
    rng = np.random.default_rng(1)
    xy = rng.uniform(0, 200, (20_000, 2))
    xy = xy[np.abs(xy - 100).max(axis=1) > 10]
    z = 0.1 * xy[:, 0] - 0.05 * xy[:, 1] + 20
    high = rng.random(len(xy)) < 0.3
    return PointCloud.from_arrays(np.column_stack([xy, z + 5 * high]), reference=~high)


def plane(z, grid):
    y, x = np.mgrid[: grid.ny, : grid.nx] * grid.cell + grid.cell / 2
    return z - (0.1 * x - 0.05 * y)


def test_rasterise_recovers_a_plane_and_fills_its_void(cloud):
    z, grid = plots.rasterise(cloud.xyz[cloud.reference], 2.0, over=cloud.xyz)
    assert z.shape == grid.shape == (100, 100)
    assert np.ptp(plane(z, grid)) < 0.4  # the lowest point of a 2 m cell is within 0.15 m of the plane at its centre


def test_rasterise_takes_the_lowest_point_and_leaves_far_places_empty():
    corners = np.array([[0.5, 0.5, 3.0], [0.6, 0.6, 1.0], [99.5, 99.5, 2.0]], np.float32)
    z, grid = plots.rasterise(corners, 1.0)
    assert z[0, 0] == 1.0 and z[-1, -1] == 2.0
    away = np.hypot(*(np.mgrid[: grid.ny, : grid.nx] * 1.0))
    away = np.minimum(away, away[::-1, ::-1])
    np.testing.assert_array_equal(np.isnan(z), away > plots.PICTURE_REACH)


def test_rasterise_limits_the_picture_and_needs_points(cloud):
    assert max(plots.rasterise(np.tile(cloud.xyz, (30, 1)))[1].shape) <= plots.PICTURE_CELLS + 1
    with pytest.raises(InputError, match="no points"):
        plots.rasterise(cloud.xyz[:0])


@pytest.mark.parametrize(
    "rise, brightness", [((0, 0), np.sqrt(0.5)), ((1, -1), np.cos(np.radians(54.7356 - 45))), ((-1, 1), 0.0)]
)
def test_hillshade_is_lit_from_the_north_west(rise, brightness):
    """A plane's brightness is the cosine of the angle between its normal and the light at 45 degrees, in 255 steps."""
    y, x = np.mgrid[:5, :6] * 2.0
    ax = plots.hillshade((rise[0] * x + rise[1] * y, Grid(0.0, 0.0, 2.0, 6, 5)), title="plane")
    np.testing.assert_allclose(ax.images[0].get_array()[1:-1, 1:-1], brightness, atol=1 / 254)
    assert ax.images[0].get_extent() == [0, 12, 0, 10]
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_title()) == ("x (m)", "y (m)", "plane")


def test_error_map_draws_each_error_once(cloud):
    truth = cloud.reference
    result = truth.copy()
    result[:300] ^= True
    ax = plots.error_map(cloud, result, truth)
    near, lost, high = ax.collections
    np.testing.assert_array_equal(lost.get_offsets(), cloud.xyz[truth & ~result, :2])
    drawn = np.concatenate([near.get_offsets(), high.get_offsets()])
    wrong = cloud.xyz[result & ~truth, :2]
    np.testing.assert_array_equal(drawn[np.lexsort(drawn.T)], wrong[np.lexsort(wrong.T)])
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert any(f"({(truth & ~result).sum()})" in t for t in texts) and any("Type II" in t for t in texts)


def test_error_map_tells_low_plants_from_failures(cloud):
    """By the height above the surface that is given, here a plane."""
    flat = np.zeros((3, 4), np.float32), Grid(0.0, 0.0, 10.0, 4, 3)
    xyz = np.array([[5, 5, 0.0], [15, 5, 0.9], [25, 5, 1.0], [35, 5, 8.0]], np.float32)
    some = PointCloud.from_arrays(xyz.astype(float))
    ax = plots.error_map(some, np.ones(4, bool), np.arange(4) == 0, surface=flat)
    near, lost, high = (one.get_offsets()[:, 0].tolist() for one in ax.collections)
    assert (near, lost, high) == ([10.0], [], [20.0, 30.0])  # from the corner


def test_the_surface_on_top_of_all_points_goes_through_the_highest():
    xyz = np.array([[0.5, 0.5, 3.0], [0.6, 0.5, 9.0], [9.5, 0.5, 2.0]])
    some = PointCloud.from_arrays(xyz)
    z, grid = plots.maps.top_of(some, 1.0)
    assert z.shape == grid.shape and z[0, 0] == some.xyz[1, 2] and z[0, -1] == some.xyz[2, 2]


def test_profile_holds_the_points_of_the_strip_by_distance(cloud):
    ax = plots.profile(cloud, cloud.reference, ((20.0, 30.0), (120.0, 30.0)), width=4.0)
    other, ground = ax.collections
    strip = (np.abs(cloud.xyz[:, 1] - 30) <= 2) & (cloud.xyz[:, 0] >= 20) & (cloud.xyz[:, 0] <= 120)
    expected = cloud.xyz[strip & cloud.reference][:, [0, 2]] - [20, 0]
    np.testing.assert_allclose(ground.get_offsets(), expected, atol=1e-4)
    assert len(other.get_offsets()) == (strip & ~cloud.reference).sum()
    with pytest.raises(InputError, match="no length"):
        plots.profile(cloud, cloud.reference, ((1.0, 1.0), (1.0, 1.0)))
