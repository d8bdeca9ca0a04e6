"""Switches for other readings of the papers, each against its definition; and that they keep what all filters owe."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.distance import cdist

import jaxfilter as jf

SWITCHED = {
    "removed": jf.AGPTD(radius=2.5, min_neighbours=5, outlier_fate="removed"),
    "removed by STIN": jf.STIN(outlier_surface="quadratic", outlier_distance=2.0, outlier_fate="removed"),
    "tails": jf.SPF(histogram_margin=0.5, isolated_depth=0.3, outlier_fate="removed"),
    "vertices between": jf.SPF(interpolated=True),
    "no reach": jf.PPDF(reach=np.inf),
}


@pytest.fixture(scope="module")
def hills():
    """Points f64[2500, 3] in decimetre steps on a slope, with a house, bushes, and some low points."""
    rng = np.random.default_rng(8)
    xy = rng.uniform(0, 70, (2500, 2)).round(1)
    z = 0.1 * xy[:, 0] + 2 * np.sin(xy[:, 1] / 11) + rng.normal(0, 0.03, 2500)
    z[(np.abs(xy[:, 0] - 30) < 7) & (np.abs(xy[:, 1] - 40) < 6)] += 5
    z[::9] += rng.uniform(0, 2, len(z[::9]))
    z[::250] -= 4
    return np.column_stack([xy, z]).round(2)


@pytest.mark.parametrize("name", list(SWITCHED))
def test_order_and_offset_of_the_points_do_not_matter(hills, name, rng):
    filter_ = SWITCHED[name]
    order = rng.permutation(len(hills))
    expected = filter_(hills).ground
    assert 0.2 < expected.mean() < 0.98
    east, north = 500000.37, 4800000.81
    moved = jf.PointCloud.from_arrays(hills[order] + [east, north, 300.0], anchor=(east, north))
    assert (filter_(moved).ground == expected[order]).all()


def test_removed_outliers_are_as_if_they_had_not_been_there(hills):
    filter_ = SWITCHED["removed"].replace(low_clusters=False)
    low, high = hills[:, :2].min(0), hills[:, :2].max(0)
    patch = np.array([[x, y] for x in (0, 0.5, 1) for y in (0, 0.5, 1)])
    corners = np.concatenate([patch + (x, y) for x in (low[0], high[0] - 1) for y in (low[1], high[1] - 1)])
    corners = np.column_stack([corners, 0.1 * corners[:, 0]])
    hills = np.concatenate([hills, corners])  # so that the extent does not depend on outliers
    result = filter_(hills)
    out = result.barred
    assert 20 < out.sum() < 600 and not result.ground[out].any()
    assert (result.decision[out] == jf.Decision.SET_ASIDE).all() and np.isnan(result.margin[out]).all()
    rest = filter_.replace(radius=0.0)(jf.PointCloud.from_arrays(hills[~out]))
    assert (rest.ground != result.ground[~out]).sum() <= 2  # heights are rounded from another origin
    assert filter_.replace(outlier_fate="barred")(hills).ground[out].any()


def test_tails_and_isolated_points_of_spf(rng):
    xyz = np.column_stack([rng.uniform(0, 60, (3000, 2)), rng.normal(0, 0.5, 3000)]).round(2)
    xyz[:3, 2], xyz[3:5, 2], xyz[5, 2] = -30.0, 40.0, -4.0
    low, high = np.quantile(xyz[:, 2], (1e-3, 1 - 1e-3))
    tails = (xyz[:, 2] < low - 5) | (xyz[:, 2] > high + 5)
    filter_ = jf.SPF(low_clusters=False)
    assert (filter_.replace(histogram_margin=5.0)(xyz).barred == tails).all()
    distance = cdist(xyz[~tails, :2], xyz[~tails, :2])
    lowest = xyz[~tails, 2][np.argsort(distance, axis=1)[:, 1:9]].min(axis=1)
    isolated = np.zeros(3000, bool)
    isolated[~tails] = xyz[~tails, 2] < lowest - 0.395
    both = filter_.replace(histogram_margin=5.0, isolated_depth=0.395)(xyz)
    assert tails.sum() == 5 and isolated[5] and isolated.sum() > 20 and (both.barred == tails | isolated).all()


def test_without_a_reach_references_are_found_across_any_void(rng):
    xy = rng.uniform(0, 300, (6000, 2)).round(1)
    xy = xy[np.hypot(*(xy - 150).T) > 90]
    xyz = np.column_stack([xy, 0.02 * xy[:, 0]]).round(2)
    middle = np.array([[150.0, 150.0, 3.0], [150.0, 150.2, 9.0]])  # on the plane of all others, and above it
    cloud = np.concatenate([xyz, middle])
    given = {"low_clusters": False, "window": 0.0, "cell": 20.0, "min_points": 10}
    near, far = jf.PPDF(**given)(cloud), jf.PPDF(**given, reach=np.inf)(cloud)
    assert np.isnan(near.elevation[-2:]).all() and not near.ground[-2:].any()
    assert far.ground[-2] and not far.ground[-1] and far.elevation[-1] == pytest.approx(6.0, abs=0.05)


# Settings of JAX by which careful users find mistakes. SMRF's soft labels have a short test in test_inpaint.py.
STRICT = {"jax_numpy_rank_promotion": "raise", "jax_numpy_dtype_promotion": "strict"}
CAREFUL, WIDE = STRICT | {"jax_debug_nans": True}, STRICT | {"jax_enable_x64": True}
VARIANTS = {
    **{name: {} for name in sorted(jf.FILTERS)},
    "csf smooth": {"smooth": True, "rigidness": 1},
    "pmf points": {"reading": "points", "compare": "points"},
    "smrf cut": {"cut": 20.0},
}
"""Defaults, and parameters that take other ways through the compiled functions."""
SOFT = [
    pytest.param(jf.SMRF(window=4.0), ("slope", "threshold"), marks=pytest.mark.slow),
    pytest.param(jf.PMF(max_window=9.0), ("slope", "initial_distance"), marks=pytest.mark.slow),
    (jf.MSF(), ("initial_distance",)),
]


def with_settings(call, settings=CAREFUL):
    """What a call gives as it is, and with other settings of JAX."""
    expected, before = call(), {name: getattr(jax.config, name) for name in settings}
    try:
        for name, value in settings.items():
            jax.config.update(name, value)
        return expected, call()
    finally:
        for name, value in before.items():
            jax.config.update(name, value)


@pytest.mark.parametrize("settings", [CAREFUL, pytest.param(WIDE, marks=pytest.mark.slow)], ids=["careful", "x64"])
@pytest.mark.parametrize("name", VARIANTS)
def test_settings_of_jax_change_no_label(hills, name, settings):
    filter_ = jf.FILTERS[name.split()[0]](**VARIANTS[name])
    expected, found = with_settings(lambda: filter_(hills), settings)
    assert 0.1 < expected.ground.mean() < 0.99
    for field in ("ground", "height", "margin"):
        np.testing.assert_array_equal(getattr(found, field), getattr(expected, field))


@pytest.mark.parametrize("filter_, fields", SOFT)
def test_careful_settings_of_jax_change_no_soft_label_no_gradient_no_batch_and_no_sweep(hills, filter_, fields):
    cloud = jf.PointCloud.from_arrays(hills, reference=np.arange(len(hills)) % 2 == 0)
    points = filter_.points_of(cloud)
    cells, xyz = filter_.cells(points), jnp.asarray(points.xyz)
    sets = {field: [getattr(filter_, field), 1.2 * getattr(filter_, field)] for field in fields}

    def total(at):
        one = filter_.replace(**dict(zip(fields, at, strict=True)))
        return jf.soft_labels(one, cells, xyz, width=0.1).sum()

    def everything():
        at = jnp.asarray([values[0] for values in sets.values()], jnp.float32)
        batch = jf.batch({"whole": cloud, "half": hills[:1200]}, filter_, blocks=1)
        return (
            jax.value_and_grad(total)(at),
            batch.ground(sets),
            batch.soft(),
            jf.sweep(filter_, cloud, sets).ground.values,
        )

    expected, found = map(jax.tree.leaves, with_settings(everything))
    assert np.abs(expected[1]).min() > 0
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)
