"""Bad and odd arguments of the library: a typed error, or what the same values give in another form."""

from __future__ import annotations

import jax
import numpy as np
import pandas
import pytest

import jaxfilter as jf

SCENE = jf.scenes.make("mixed", size=40.0, density=1.0, seed=3)
CLOUD, TRUTH, XYZ = SCENE.cloud, SCENE.truth, SCENE.cloud.coordinates()
HIDDEN = np.ma.array(TRUTH, mask=CLOUD.xyz[:, 0] >= 20)


@pytest.mark.parametrize(
    "call, error, words",
    [
        (lambda: jf.calibrate(jf.SMRF(), CLOUD, HIDDEN, size=4, rounds=1), jf.InputError, "masked"),
        (lambda: jf.batch([CLOUD], jf.SMRF(), [HIDDEN]), jf.InputError, "masked"),
        (lambda: jf.dtm(CLOUD, HIDDEN), jf.InputError, "masked"),
        (lambda: jf.height_above_ground(CLOUD, HIDDEN), jf.InputError, "masked"),
        (lambda: jf.batch([CLOUD, CLOUD], jf.SMRF(), [TRUTH]), jf.InputError, "2 clouds and labels of 1"),
        (lambda: jf.batch({"a": CLOUD}, jf.SMRF(), {"b": TRUTH}), jf.InputError, "a has no labels"),
        (lambda: jf.batch([CLOUD], jf.SMRF()).ground({"foo": [1.0]}), jf.ParameterError, "no field 'foo'"),
        (lambda: jf.batch([CLOUD], jf.SMRF()).ground({}), jf.ParameterError, "name at least one field"),
        (lambda: jf.batch([CLOUD], jf.SMRF()).soft(width=-1.0), jf.ParameterError, "width=-1.0"),
        (lambda: jf.sweep(jf.SMRF(), CLOUD, {"slope": np.array(0.3)}), jf.ParameterError, "slope"),
        (lambda: jf.sweep(jf.SMRF(), CLOUD, {"slope": (0.1, 0.3)}, design="random", size=2, seed=-1),
         jf.ParameterError, "seed=-1"),
        (lambda: jf.PPDF()(CLOUD, key=0), jf.ParameterError, r"key=0: .*jax\.random\.key\(0\)"),
        (lambda: jf.SMRF()(CLOUD, key="0"), jf.ParameterError, "key='0'"),
        (lambda: jf.PPDF()(CLOUD, key=np.zeros(3, np.uint32)), jf.ParameterError, "key=array"),
        (lambda: jf.PPDF()(CLOUD, key=jax.random.split(jax.random.key(0))), jf.ParameterError, "one JAX random key"),
        (lambda: jf.sweep(jf.PPDF(), CLOUD, {"slope": [0.3]}, key=0), jf.ParameterError, "key=0"),
        (lambda: jf.calibrate(jf.PPDF(), CLOUD, TRUTH, key=0), jf.ParameterError, "key=0"),
        (lambda: jf.SweepOptions(key=1.5), jf.ParameterError, "key=1.5"),
        (lambda: jf.SMRF(0.2), jf.ParameterError, r"SMRF\(0.2\): name the field that this is: cell, slope, .*scaling"),
        (lambda: jf.PTD(15.0, max_distance=1.0), jf.ParameterError, r"PTD\(15.0\): name the field.*max_angle"),
        (lambda: jf.hillshade(jf.dtm(CLOUD, TRUTH), z_factor=-1.0), jf.ParameterError, "z_factor=-1.0"),
        (lambda: jf.dtm(CLOUD, TRUTH, cell="1"), jf.ParameterError, "cell='1'"),
        (lambda: jf.dtm(CLOUD, TRUTH, workers=-3), jf.ParameterError, "workers=-3"),
        (lambda: jf.PTD()(CLOUD, workers=10**9), jf.ParameterError, "workers=1000000000.*at most 4,096"),
        (lambda: jf.RunOptions(workers=10**18), jf.ParameterError, "workers=1000000000000000000.*at most 4,096"),
        (lambda: jf.RunOptions(memory=10**400), jf.ParameterError, "memory=1000"),
        (lambda: jf.dtm(CLOUD, TRUTH, cell=5e-324), jf.ParameterError, "cell=5e-324.*1e-09 to 1e"),
        (lambda: jf.dtm(CLOUD, TRUTH, cell=1e300), jf.ParameterError, "cell=1e.300.*1e-09 to 1e"),
        (lambda: jf.dtm(CLOUD, TRUTH, cell=10**400), jf.ParameterError, "cell=1000"),
        (lambda: jf.dtm(CLOUD, TRUTH, bounds=(0, 0, np.inf, np.inf)), jf.InputError, "bounds.*more cells than can be"),
        (lambda: jf.dtm(CLOUD, TRUTH, bounds=(0, 0, 1, 10**400)), jf.InputError, "four numbers"),
        (lambda: jf.contours(jf.dtm(CLOUD, TRUTH), 1e-5), jf.ParameterError, "interval=1e-05.* intervals in 512.*5,000"),
        (lambda: jf.contours(jf.dtm(CLOUD, TRUTH), 1e-300), jf.ParameterError, "interval=1e-300"),
        (lambda: jf.voids.replace(distance=1e300)(CLOUD, TRUTH), jf.ParameterError, "distance=1e.300.*of metres, 1e-09"),
        (lambda: jf.dsm.replace(gap=1e300)(CLOUD, TRUTH), jf.ParameterError, "gap=1e.300"),
        (lambda: jf.sweep(jf.SMRF(), CLOUD, {"slope": (0.1, 0.3)}, design="random", size=10**18),
         jf.ParameterError, "size=10.*at most 1,000,000"),
        (lambda: jf.sweep(jf.SMRF(), CLOUD, {k: np.linspace(0.1, 0.3, 200) for k in ("slope", "scaling", "threshold")}),
         jf.ParameterError, "8,000,000 sets, more than 1,000,000"),
        (lambda: jf.calibrate(jf.SMRF(), CLOUD, TRUTH, size=10**18), jf.ParameterError, "size=10.*at most 1,000,000"),
        (lambda: jf.calibrate(jf.SMRF(), CLOUD, TRUTH, rounds=10**18), jf.ParameterError, "rounds=10.*at most 1,000,000"),
        (lambda: jf.scenes.make(size=1e5, density=1000), jf.ParameterError, "at most 1e9 pulses"),
        (lambda: jf.SMRF()("in.laz"), jf.InputError, r"pass jaxfilter\.read\('in.laz'\)"),
        (lambda: jf.PTD()(CLOUD, workers=float("nan")), jf.ParameterError, "workers=nan"),
        (lambda: jf.apply(jf.SMRF()(CLOUD), pandas.DataFrame({"verdict": ["object"]})), jf.InputError, "GeoDataFrame"),
        (lambda: jf.FilterResult.of_labels(np.array([1, 0])), jf.InputError, "ground: bool"),
        (lambda: jf.PointCloud.from_integers(np.zeros((2, 3), np.int64), np.ones(3), np.zeros(3)), jf.InputError, "int64"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_named(call, error, words):
    with pytest.raises(error, match=words):
        call()


@pytest.mark.parametrize("key", [jax.random.key(7), jax.random.PRNGKey(7), np.array(jax.random.PRNGKey(7))])
def test_any_form_of_one_random_key_draws_the_same(key):
    rough = XYZ + np.random.default_rng(0).normal(0, [0, 0, 0.3], XYZ.shape)
    assert (jf.PPDF()(rough, key=key).ground == jf.PPDF()(rough, key=jax.random.key(7)).ground).all()


def test_labels_of_a_batch_go_by_name_or_by_cloud():
    whole = jf.batch([CLOUD], jf.MSF(), [TRUTH]).confusion()
    for made in (jf.batch(CLOUD, jf.MSF(), TRUTH), jf.batch({1: CLOUD}, jf.MSF(), {1: TRUTH})):
        np.testing.assert_array_equal(made.confusion(), whole)


@pytest.mark.parametrize("cell", [np.float32(0.5), np.float16(0.25), 1, np.int64(2)])
def test_a_cell_of_any_number_has_the_raster_of_a_float(cell):
    """Steps of float32 are half a metre at these coordinates."""
    made, same = jf.count(CLOUD, TRUTH, cell=cell), jf.count(CLOUD, TRUTH, cell=float(cell))
    assert np.nansum(made.values) == TRUTH.sum() and made.transform == same.transform
    np.testing.assert_array_equal(made.values, same.values)


@pytest.mark.parametrize("names", ["xyz", "XYZ", "ZYX"])
def test_columns_of_a_table_go_by_name(names):
    columns = {name: XYZ[:, "XYZ".index(name.upper())] for name in names}
    table = pandas.DataFrame(
        columns | {"Classification": np.where(TRUTH, 2, 1), "ReturnNumber": 1, "Number_Of_Returns": 1}
    )
    made = jf.PointCloud.from_structured(table)
    np.testing.assert_array_equal(made.coordinates(), CLOUD.coordinates())
    np.testing.assert_array_equal(made.reference, TRUTH)
    np.testing.assert_array_equal(jf.SMRF()(table).ground, jf.SMRF()(made).ground)


def test_points_without_coordinates_have_none_in_tables():
    xyz = XYZ.copy()
    xyz[5] = np.nan
    cloud = jf.PointCloud.from_arrays(xyz, drop_invalid=True)
    data = jf.SMRF()(cloud).to_xarray()
    np.testing.assert_array_equal(np.isnan(data.x), np.arange(len(xyz)) == 5)


def test_a_raster_that_is_read_is_written_as_it_was(tmp_path):
    shade = jf.hillshade(jf.dtm(CLOUD, TRUTH))
    back = jf.Raster.read(shade.write(tmp_path / "a.tif"))
    assert (back.kind, back.nodata) == (shade.kind, shade.nodata) == ("uint8", 0)
    assert back.write(tmp_path / "b.tif").read_bytes() == (tmp_path / "a.tif").read_bytes()


def test_results_are_told_apart_by_what_they_are():
    one, other = jf.SMRF()(CLOUD), jf.SMRF()(CLOUD)
    assert one != other and one in [other, one] and len({one: 1, other: 2}) == 2


def test_a_gap_wider_than_the_raster_bridges_all_of_it():
    wide = jf.dsm.replace(gap=1e9)(CLOUD, TRUTH).values
    np.testing.assert_array_equal(wide, jf.dsm.replace(gap=1000.0)(CLOUD, TRUTH).values)
