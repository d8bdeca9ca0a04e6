"""Fits by gradient: what goes down is what soft labels say, and clouds that took no part decide."""

import sys

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfilter as jf
from jaxfilter.steps.grid_filter import fit_data, soft_errors


@pytest.fixture(scope="module")
def clouds(town):
    """Four parts of a town, as large."""
    middle = np.median(town.xyz[:, :2], axis=0)
    part = (town.xyz[:, :2] > middle) @ (1, 2) + 1
    parts = {f"scene {n}": part == n for n in range(1, 5)}
    return {name: jf.PointCloud.from_arrays(town.xyz[p], reference=town.truth[p]) for name, p in parts.items()}


@pytest.mark.parametrize(
    "start", [pytest.param(jf.SMRF(window=9.0), marks=pytest.mark.slow), jf.PMF(max_window=17.0)], ids=["SMRF", "PMF"]
)
def test_what_goes_down_is_the_error_of_soft_labels_and_its_gradient_that_of_differences(clouds, start):
    cloud = clouds["scene 1"]
    points, name = start.points_of(cloud), {"SMRF": "threshold", "PMF": "initial_distance"}[type(start).__name__]
    truth = points.gather(cloud.reference)
    rows, out = np.arange(0, len(points), 2), np.zeros((1, 2048), bool)
    data = fit_data(
        start, points, (start.replace(slope=0.05), start.replace(slope=0.5)), rows, np.stack([truth, ~truth])[:, rows]
    )

    def error(slope, value):
        fields = {"slope": jnp.float32([slope]), name: jnp.float32([value])}
        return soft_errors(start, data, out[:, : len(data[1])], fields, 0.1)

    (inside, outside), slopes = error(0.23, 0.6)
    soft = jf.soft_labels(
        start.replace(slope=0.23, **{name: 0.6}), start.cells(points), jnp.asarray(points.xyz[rows]), 0.1
    )
    assert inside[0] == pytest.approx(100 * np.abs(np.asarray(soft) - truth[rows]).mean(), rel=1e-4)
    assert np.isnan(outside[0])  # all points take part
    steps = {
        "slope": (error(0.232, 0.6), error(0.228, 0.6), 0.004),
        name: (error(0.23, 0.605), error(0.23, 0.595), 0.01),
    }
    for field, (above, below, step) in steps.items():
        assert slopes[field][0] == pytest.approx(float(above[0][0][0] - below[0][0][0]) / step, rel=0.05, abs=0.3)


@pytest.mark.slow
def test_a_fit_from_a_bad_start_finds_what_labels_were_made_with(clouds):
    start, true = jf.SMRF(window=9.0, threshold=1.1), jf.SMRF(window=9.0, threshold=0.4)
    labels = {name: true(cloud).ground for name, cloud in clouds.items()}
    seen = {name: clouds[name] for name in list(clouds)[:3]}
    found = jf.fit(start, seen, {name: labels[name] for name in seen}, axes={"threshold": (0.1, 1.5)})
    assert found.moved and found.filter.threshold == pytest.approx(0.4, abs=0.1) and "no better" not in str(found)
    before, after = (jf.evaluate(one(clouds["scene 4"]), labels["scene 4"]).total for one in (start, found.filter))
    assert after < before / 2 and found.after + found.spread < found.before
    held = [jf.evaluate(start(cloud), labels[name]).total for name, cloud in seen.items()]
    assert found.before == found.curves["total"][0] == pytest.approx(np.mean(held))
    first, last = found.curves["fitted"].values[[0, -1]]
    assert last < first and found.curves.attrs["fields"] == ["threshold"]
    assert (found.filter.window, found.filter.slope) == (9.0, 0.15)
    assert jf.plots.fit_curves(found).get_ylabel() == "total error (%)"


@pytest.mark.slow
def test_the_start_is_returned_where_clouds_contradict_each_other(clouds):
    start, names = jf.SMRF(window=9.0, threshold=0.5), list(clouds)[:2]
    labels = {n: start.replace(threshold=t)(clouds[n]).ground for n, t in zip(names, (0.1, 1.5), strict=True)}
    found = jf.fit(start, {n: clouds[n] for n in names}, labels, axes={"threshold": (0.1, 1.5)}, steps=6)
    assert not found.moved and found.filter == start and "no better than the start" in str(found)


@pytest.mark.slow
def test_one_cloud_is_cut_into_blocks_and_clouds_of_a_group_stay_together(clouds):
    start, cloud = jf.SMRF(window=9.0, threshold=1.4), clouds["scene 1"]
    labels = np.where(cloud.xyz[:, 0] < 30, cloud.reference, -1)  # of 45 m
    found = jf.fit(start, cloud, labels, steps=4, validation=jf.CrossValidation(2, block=10.0))
    fold = jf.CrossValidation(2, block=10.0).assign(cloud.xyz[labels >= 0])
    wrong = (start(cloud).ground != cloud.reference)[labels >= 0]
    assert found.before == pytest.approx(np.mean([100 * wrong[fold == k].mean() for k in range(2)]))
    with pytest.raises(jf.InputError, match="all clouds are of the group town"):
        jf.fit(start, clouds, groups=dict.fromkeys(clouds, "town"))


@pytest.mark.parametrize(
    "start, options, words",
    [
        (jf.PTD(), {}, "only filters on a grid have soft labels"),
        (jf.PMF.preset("pcl"), {}, "only filters on a grid have soft labels"),
        (jf.SMRF(), {"axes": {"window": (5.0, 10.0)}}, "window has no gradient; choose from slope, threshold, scaling"),
        (jf.MSF(), {"axes": {"slope": (0.1, 0.3)}}, "no gradient in slope"),
        (jf.SMRF(), {"steps": 0}, "steps=0"),
        (jf.SMRF(), {"groups": {"scene 1": "a"}}, "scene 2 has no group"),
    ],
)
def test_what_cannot_be_fitted_is_said(clouds, start, options, words):
    with pytest.raises((jf.ParameterError, jf.InputError), match=words):
        jf.fit(start, clouds, **options)


def test_without_optax_the_error_says_how_to_install_it(clouds, monkeypatch):
    monkeypatch.setitem(sys.modules, "optax", None)
    with pytest.raises(jf.ParameterError, match=r"pip install 'jaxfilter\[fit\]'"):
        jf.fit(jf.SMRF(), clouds)
