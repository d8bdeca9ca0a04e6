"""Models of grid methods as pure functions: under jit and vmap, of bad cells, and by gradient."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage
from test_pmf import hamlet

import jaxfilter as jf
from jaxfilter import scenes
from jaxfilter.engines.grid import sampling

SMRF = jf.SMRF(window=8.0)
PMF = jf.PMF(max_window=17.0)
MSF = jf.MSF(window=6.0)


@pytest.fixture(scope="module")
def small():
    """The points of a small scene, and what is ground."""
    scene = scenes.make("town", size=(60, 50), density=1.0, seed=4)
    points = SMRF.points_of(scene.cloud)
    return points, scene.truth[points.index]


@pytest.mark.parametrize("transform", [jax.jit, jax.grad, lambda f: lambda x: jax.vmap(f)(x[None])])
def test_tracing_a_static_field_is_an_error_that_names_it(transform):
    with pytest.raises(jf.ParameterError, match=r"SMRF\(window=.*cannot be traced"):
        transform(lambda window: jf.SMRF(window=window).slope)(jnp.float32(9.0))


@pytest.mark.parametrize("filter_", [SMRF, PMF, MSF], ids=["smrf", "pmf", "msf"])
def test_cells_whose_elevation_is_no_number_count_as_empty(small, filter_):
    cells = filter_.cells(small[0])
    gone = np.asarray(cells.seen) & (np.random.default_rng(1).random(cells.seen.shape) < 0.1)
    odd = np.where(np.arange(gone.shape[1]) % 2, np.nan, np.inf).astype(np.float32)
    without = dataclasses.replace(cells, seen=cells.seen & ~gone, lowest=jnp.where(gone, 0, cells.lowest))
    found = filter_.model(dataclasses.replace(cells, lowest=jnp.where(gone, odd, cells.lowest)))
    jax.tree.map(np.testing.assert_array_equal, found, filter_.model(without))
    assert not np.array_equal(found.z, filter_.model(cells).z)


@pytest.mark.parametrize(
    "filter_",
    [jf.PMF(), jf.PMF(reading="points", compare="points"), jf.MSF(), jf.CSF()],
    ids=["pmf", "pmf-points", "msf", "csf"],
)
def test_a_cluster_of_low_points_is_barred_and_changes_no_other_label(filter_):
    xyz, _ = hamlet()
    low = np.concatenate([xyz, [[24.3, 24.4, -30.0], [24.5, 24.2, -30.1], [25.1, 24.9, -30.2]]])
    result, plain = filter_(low), filter_.replace(low_clusters=False)(low)
    assert result.barred[-3:].all() and (result.decision[-3:] == jf.Decision.LOW).all()
    assert plain.ground[-3:].all() and not plain.barred.any()
    assert plain.ground[:-3].sum() < result.ground.sum()  # some are lost around them
    np.testing.assert_array_equal(result.ground, [*filter_(xyz).ground, False, False, False])


@pytest.mark.parametrize("field", ["seen", "valid"])
@pytest.mark.parametrize("filter_, level", [(SMRF, 0), (PMF, 0), (MSF, np.inf)], ids=["smrf", "pmf", "msf"])
def test_a_mask_without_a_cell_gives_a_level_surface(small, filter_, level, field):
    xyz, cells = small[0].xyz, filter_.cells(small[0])
    surface = filter_.model(dataclasses.replace(cells, **{field: jnp.zeros_like(cells.seen)}))
    assert (np.asarray(surface.z) == level).all() and (np.asarray(surface.slope) == 0).all()
    tested = filter_.test(surface, xyz)
    np.testing.assert_array_equal(tested.height, xyz[:, 2] - level)
    assert not np.isnan(tested.margin).any() and (filter_ is not MSF or (np.asarray(tested.margin) > 0).all())


@pytest.mark.parametrize("name, shape", [("seen", (128, 64)), ("valid", (128,)), ("lowest", (64, 128))])
def test_shapes_that_do_not_fit_are_an_error_that_names_them(small, name, shape):
    cells = dataclasses.replace(SMRF.cells(small[0]), **{name: np.zeros(shape, np.float32)})
    for call in (SMRF.model, jax.jit(SMRF.model), lambda cells: jf.soft_labels(SMRF, cells, small[0].xyz)):
        with pytest.raises(jf.InputError, match=rf"{name}.*{shape[0]},"):
            call(cells)


@pytest.mark.parametrize(
    "filter_, names",
    [
        pytest.param(dataclasses.replace(SMRF, slope=0.16), ("slope", "threshold", "scaling"), marks=pytest.mark.slow),
        pytest.param(
            dataclasses.replace(PMF, compare="points"),
            ("slope", "initial_distance", "max_distance"),
            marks=pytest.mark.slow,
        ),
        (PMF, ("slope", "initial_distance", "max_distance")),
    ],
    ids=["smrf", "pmf-points", "pmf"],
)
def test_gradients_of_soft_labels_are_those_of_finite_differences(small, filter_, names):
    points, truth = small
    cells = filter_.cells(points)

    def labels(fields):
        one = dataclasses.replace(filter_, **dict(zip(names, fields, strict=True)))
        return jf.soft_labels(one, cells, points.xyz, width=0.3)

    @jax.jit
    def with_gradient(fields):
        found, back = jax.vjp(labels, fields)
        return found, back(jnp.asarray(truth, jnp.float32) / len(truth))[0]

    fields = jnp.asarray([getattr(filter_, name) for name in names], jnp.float32)
    exact = np.asarray(with_gradient(fields)[1])
    for k, step in enumerate(2e-3 * np.eye(len(names), dtype=np.float32)):
        up, down = (np.asarray(with_gradient(fields + sign * step)[0], np.float64) for sign in (1, -1))
        assert exact[k] == pytest.approx(((up - down) * truth).mean() / 4e-3, rel=0.02, abs=1e-4), names[k]
    assert (np.abs(exact) > 1e-3).any()


@pytest.mark.parametrize("filter_", [pytest.param(SMRF, marks=pytest.mark.slow), PMF], ids=["smrf", "pmf"])
def test_soft_labels_have_no_jumps_in_the_slope(small, filter_):
    """Differences lie between the gradients at both ends, across slopes at which cells become objects."""
    points, truth = small
    cells = filter_.cells(points)

    def soft_error(slope):
        one = dataclasses.replace(filter_, slope=slope)
        return ((jf.soft_labels(one, cells, points.xyz, width=0.1) - truth) ** 2).mean()

    slopes = np.linspace(0.1, 0.2, 41, dtype=np.float32)
    error, gradient = map(np.asarray, jax.lax.map(jax.value_and_grad(soft_error), slopes))
    ends, spare = np.sort([gradient[1:], gradient[:-1]], axis=0), 0.03 * np.abs(gradient).max()
    found = np.diff(error) / np.diff(slopes)
    assert ((found >= ends[0] - spare) & (found <= ends[1] + spare)).all() and np.ptp(error) > 5e-4


def test_soft_labels_of_pmf_become_its_labels_where_they_are_sharp(small):
    xyz, cells = small[0].xyz, PMF.cells(small[0])
    sharp = jf.soft_labels(PMF, cells, xyz, width=1e-5)
    margin = np.asarray(PMF.test(PMF.model(cells), xyz).margin)
    clear = np.abs(margin) > 1e-3
    np.testing.assert_array_equal(sharp[clear] > 0.5, margin[clear] < 0)


@pytest.mark.parametrize("extent", [(9, 13), (1, 13), (9, 1)])
def test_bilinear_interpolation_is_that_of_scipy_and_the_border_holds_beyond_it(extent, rng):
    grid = np.full((16, 16), np.nan, np.float32)
    rows, columns = extent
    grid[:rows, :columns] = rng.normal(size=extent)
    at = rng.uniform(-2, 15, (500, 2)).astype(np.float32)
    nodes = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2).astype(np.float32)
    at = np.concatenate([at, nodes])
    found = jax.jit(lambda at, grid: sampling.bilinear(at, jnp.asarray(extent), 16)(grid))(at, grid)
    expected = ndimage.map_coordinates(grid[:rows, :columns].astype(float), at[:, ::-1].T, order=1, mode="nearest")
    np.testing.assert_allclose(found, expected, atol=2e-6)
