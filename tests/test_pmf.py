import jax
import numpy as np
import pytest
from scipy import ndimage
from test_morphology import footprint

from jaxfilter.core.errors import ParameterError
from jaxfilter.methods.pmf import PMF
from jaxfilter.scoring import evaluate

SAMPLES = (11, 12, 21, 22, 23, 24, 31, 41, 42, 51, 52, 53, 54, 61, 71)
# total errors (%) that PDAL 2.2 filters.pmf and PCL's ProgressiveMorphologicalFilter gave with their default parameters
MEASURED = {
    "pdal": (17.164, 5.881, 6.628, 11.46, 9.333, 6.847, 4.005, 12.189, 4.46, 6.954, 9.215, 10.905, 6.75, 4.846, 7.267),
    "pcl": (15.391, 6.489, 7.361, 10.766, 11.763, 10.024, 9.081, 9.963, 6.89, 9.655, 14.537, 13.698, 12.605, 7.516, 7.689),
}  # fmt: skip


def hamlet(count=2000, size=48.0, seed=5):
    """Points f64[n, 3] in centimetres on a slope with two houses, bushes and voids; bool[n] truth."""
    rng = np.random.default_rng(seed)
    xyz = np.column_stack([rng.random((count, 2)) * size, np.zeros(count)])
    x, y = xyz[:, 0], xyz[:, 1]
    xyz[:, 2] = 0.1 * x + 1.5 * np.sin(y / 9) + rng.normal(0, 0.03, count)
    house = ((np.abs(x - 14) < 6) & (np.abs(y - 30) < 5)) | ((np.abs(x - 36) < 4) & (np.abs(y - 12) < 8))
    bush = (rng.random(count) < 0.1) & ~house
    xyz[house, 2] += 5
    xyz[bush, 2] += 0.7 + rng.random(bush.sum()) * 3
    keep = np.hypot(x - 30, y - 36) > 4
    return xyz[keep].round(2), ~(house | bush)[keep]


def windows(f):
    """(radius in cells, threshold) of each window, by the definitions in words."""
    pairs, radius, step = [], 0, 0
    limit = int(np.ceil((f.max_window / f.cell - 1) / 2))
    while 2 * radius + 1 < f.max_window / f.cell:
        before, radius = radius, 2**step if f.exponential else 2 * (step + 1)
        if 2 * radius + 1 > f.max_window / f.cell and f.last_window != "beyond":
            if f.last_window == "within":
                break
            radius = limit
        rise = f.slope * 2 * (radius - before) * f.cell * (f.cell if f.compare == "points" else 1) if step else 0.0
        pairs.append((radius, min(rise + f.initial_distance, f.max_distance)))
        step += 1
    return pairs


def nearest_known(z):
    """Empty cells from the nearest; of equally near the smaller column offset, the left one, the lower row."""
    full, known = z.copy(), np.argwhere(np.isfinite(z))
    for i, j in np.argwhere(~np.isfinite(z)):
        row, column = (known - (i, j)).T
        best = known[np.lexsort((row, column, abs(column), row**2 + column**2))[0]]
        full[i, j] = z[tuple(best)]
    return full


def brute_grid(xyz, f):
    last = np.ceil(xyz[:, :2].max(axis=0) / f.cell) - 1  # where points on the upper edge belong
    column, row = np.minimum(np.floor(xyz[:, :2] / f.cell), last).astype(int).T
    z = np.full((row.max() + 1, column.max() + 1), np.inf)
    np.minimum.at(z, (row, column), xyz[:, 2])
    z = nearest_known(z)
    ground = np.ones(len(xyz), bool)
    for k, (radius, threshold) in enumerate(windows(f)):
        cells = footprint(radius, f.element)
        opened = ndimage.grey_erosion(z, footprint=cells, mode="constant", cval=np.inf)
        opened = ndimage.grey_dilation(opened, footprint=cells, mode="constant", cval=-np.inf)
        if f.compare == "points" or k == 0:
            ground &= xyz[:, 2] - opened[row, column] <= threshold
        if f.compare == "surfaces":
            ground &= (z - opened <= threshold)[row, column]
        z = opened
    return ground


def brute_points(xyz, f):
    ground = np.arange(len(xyz))
    for radius, threshold in windows(f):
        now = xyz[ground]
        near = (np.abs(now[:, None, :2] - now[None, :, :2]) <= (radius + 0.5) * f.cell + 1e-9).all(axis=2)
        eroded = np.where(near, now[:, 2], np.inf).min(axis=1)
        opened = np.where(near, eroded, -np.inf).max(axis=1)
        ground = ground[now[:, 2] - opened <= threshold]
    return np.isin(np.arange(len(xyz)), ground)


@pytest.mark.parametrize(
    "changes",
    [
        {"element": "square", "max_window": 20.0},
        {"element": "diamond", "compare": "points", "last_window": "beyond", "max_window": 12.0},
        {"exponential": False, "max_window": 21.0, "last_window": "within"},
        {"cell": 2.0, "compare": "points", "max_window": 20.0},
    ],
)
def test_the_grid_reading_equals_brute_force(changes):
    xyz, _ = hamlet()
    f = PMF(low_clusters=False, slope=0.21, initial_distance=0.317, max_distance=2.9137, **changes)
    np.testing.assert_array_equal(f(xyz).ground, brute_grid(xyz, f))


@pytest.mark.parametrize(("height", "kept"), [(0.5, True), (0.75, False)])
def test_cells_that_an_opening_lowers_by_its_threshold_exactly_are_no_objects(height, kept):
    """A block of 4 x 4 cells, which the second opening removes; its threshold is 0.5 m."""
    x, y = (v.ravel() + 0.25 for v in np.mgrid[:24.0, :24.0])
    block = (np.abs(x - 10) < 2) & (np.abs(y - 10) < 2)
    lowest = np.column_stack([x, y, height * block])
    xyz = np.concatenate([lowest, lowest[block] + 0.25])
    f = PMF(low_clusters=False, slope=0.125, initial_distance=0.25, max_window=20.0)
    assert windows(f)[1] == (2, 0.5)
    ground = f(xyz).ground
    np.testing.assert_array_equal(ground, brute_grid(xyz, f))
    assert ground[len(lowest) :].sum() == 12 * kept  # not the four corners, which the first opening cuts


@pytest.mark.parametrize("changes", [{"max_window": 10.0}, {"max_window": 17.0, "cell": 0.7, "max_distance": 1.2037}])
def test_the_reading_around_points_equals_brute_force(changes):
    xyz, _ = hamlet()
    f = PMF.preset("pcl", slope=0.21, initial_distance=0.317, **changes)
    np.testing.assert_array_equal(f(xyz).ground, brute_points(xyz, f))


def test_windows_and_thresholds():
    assert PMF(max_window=33).radii() == [1, 2, 4, 8, 16] == PMF(max_window=33, last_window="beyond").radii()
    assert PMF(max_window=10).radii() == [1, 2, 4, 5]
    assert PMF(max_window=10, last_window="within").radii() == [1, 2, 4]
    assert PMF.preset("cai2023").radii() == [1, 2, 4, 8]  # PCL passes the maximum: 17 m for 10 m
    assert PMF(max_window=14, exponential=False).radii() == [2, 4, 6, 7]
    assert PMF(max_window=0.5).radii() == [1]
    np.testing.assert_allclose(PMF.preset("pdal").thresholds(), [0.15, 2.15, 2.5, 2.5, 2.5])
    np.testing.assert_allclose(PMF.preset("pcl").thresholds(), [0.15, 1.55, 2.95, 5.75, 10.0])
    twice, once = (PMF(cell=2.0, compare=c, max_distance=99.0).thresholds() - 0.5 for c in ("points", "surfaces"))
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-5)
    for name in ("slope", "initial_distance", "max_distance"):  # each may be traced by itself
        traced = jax.jit(lambda value, name=name: PMF(**{name: value}).thresholds())(getattr(PMF(), name))
        np.testing.assert_array_equal(traced, PMF().thresholds())


def test_parameters():
    assert PMF.from_spacing(0.3, 60) == {"cell": 1.0, "max_window": 60}
    assert PMF.from_spacing(2.2, 40) == {"cell": 1.0, "max_window": 40}
    assert PMF.from_spacing(8.0, None) == {"cell": 2.0}
    assert PMF(max_window=60).halo() == 90
    with pytest.raises(ParameterError, match="max_window=5000"):
        PMF(max_window=5000.0)
    with pytest.raises(ParameterError, match="only points can be compared"):
        PMF(reading="points")


@pytest.mark.parametrize(
    "preset", ["recommended", pytest.param("paper", marks=pytest.mark.slow), "pdal", "pcl", "cai2023"]
)
def test_ground_is_found(preset):
    xyz, truth = hamlet()
    result = PMF.preset(preset)(xyz)
    assert evaluate(result.ground, truth).kappa > 70
    np.testing.assert_array_equal(result.ground, result.margin <= 0)
    assert np.isfinite(result.height).all() and np.isfinite(result.margin).all()


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("preset", MEASURED)
def test_presets_of_programs_come_close_to_what_the_programs_gave(sample, preset):
    errors = [evaluate(PMF.preset(preset)(cloud), cloud.reference).total for cloud in map(sample, SAMPLES)]
    assert np.abs(np.subtract(errors, MEASURED[preset])).mean() <= 1.0, np.round(errors, 2)
