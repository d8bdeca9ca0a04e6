"""Tables and pictures of sweeps: what is drawn is what was found."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import xarray as xr

from jaxfilter import plots
from jaxfilter.core.cloud import PointCloud
from jaxfilter.core.errors import InputError, ParameterError
from jaxfilter.sweeps.best import axes_of, best_sets

SLOPES, THRESHOLDS, CELLS = [0.05, 0.1, 0.2, 0.4], [0.3, 0.5, 0.7], [0.5, 1.0]


def with_scores(total, dims, coords):
    scores = {"type1": total / 2, "type2": total, "total": total, "kappa": 100 - 2 * total}
    scores["ground"] = np.arange(total.size).reshape(total.shape)
    units = {"slope": "rise/run", "threshold": "m", "cell": "m"}
    coords = {
        name: (on, values, {"units": units[name]} if name in units else {}) for name, (on, values) in coords.items()
    }
    return xr.Dataset({name: (dims, values) for name, values in scores.items()}, coords)


@pytest.fixture
def grid(rng):
    """4 x 3 x 2 sets."""
    names, values = ("slope", "threshold", "cell"), (SLOPES, THRESHOLDS, CELLS)
    total = rng.permutation(24).reshape(4, 3, 2) + 2.0
    return with_scores(total, names, {name: (name, v) for name, v in zip(names, values, strict=True)})


@pytest.fixture
def design(rng):
    """200 sets of two numbers and a word."""
    slope, threshold = rng.uniform(0.1, 0.3, 200), np.exp(rng.uniform(np.log(0.1), np.log(2.0), 200))
    total = 3 + 100 * (slope - 0.2) ** 2 + np.log(threshold / 0.5) ** 2
    words = np.array(["batch", "one_per_facet"])[rng.integers(0, 2, 200)]
    coords = {"slope": slope, "threshold": threshold, "insertion": words}
    return with_scores(
        total, ("set",), {name: ("set", v) for name, v in coords.items()} | {"set": ("set", np.arange(200))}
    )


def several(dataset, *shares):
    """Clouds whose errors are multiples of those given; None = no labels."""
    parts = [dataset * (np.nan if share is None else share) for share in shares]
    return xr.concat(parts, dim=xr.DataArray(list("abc")[: len(shares)], dims="cloud", name="cloud")).transpose(
        ..., "cloud"
    )


def test_best_sets_are_sorted_with_their_fields(grid, design):
    assert axes_of(grid) == ("slope", "threshold", "cell") and axes_of(design) == ("slope", "threshold", "insertion")
    table = best_sets(grid, count=None)
    assert list(table.columns) == ["slope", "threshold", "cell", "type1", "type2", "total", "kappa", "ground"]
    assert table["total"].tolist() == sorted(grid["total"].values.ravel())
    for number, row in table.iterrows():
        there = grid.sel(slope=row["slope"], threshold=row["threshold"], cell=row["cell"])
        assert (there["total"], there["kappa"], there["ground"]) == (row["total"], row["kappa"], row["ground"])
        assert row["ground"] == number  # sets are counted with the last axis fastest
    assert best_sets(grid, "kappa", 3)["kappa"].tolist() == sorted(grid["kappa"].values.ravel())[:-4:-1]
    first = best_sets(design, count=1)
    assert first.index[0] == int(design["total"].values.argmin())
    assert first.iloc[0]["insertion"] == design["insertion"].values[first.index[0]]


def test_best_sets_of_several_clouds_go_by_the_mean_of_those_with_labels(grid):
    both = several(grid, 1.0, 3.0, None)
    table = best_sets(both, count=None)
    np.testing.assert_allclose(table["total"], 2 * best_sets(grid, count=None)["total"])
    np.testing.assert_allclose(table["total_b"], 3 * table["total_a"])
    assert table["total_c"].isna().all()
    assert axes_of(both) == axes_of(grid)


def line(ax, label):
    return next(each for each in ax.lines if each.get_label() == label)


@pytest.mark.parametrize("score, best", [("total", np.min), ("kappa", np.max)])
def test_curve_of_a_grid_is_the_best_over_the_others(grid, score, best):
    ax = plots.sweep_curve(grid, "threshold", score, title="SMRF")
    values = grid[score].values
    np.testing.assert_array_equal(line(ax, "best of the sets").get_xdata(), THRESHOLDS)
    np.testing.assert_array_equal(line(ax, "best of the sets").get_ydata(), best(values, axis=(0, 2)))
    np.testing.assert_allclose(line(ax, "median of the sets").get_ydata(), np.median(values, axis=(0, 2)))
    band = ax.collections[0].get_paths()[0].vertices
    assert band[:, 1].min() == pytest.approx(np.quantile(values, 0.1, axis=(0, 2)).min())
    assert band[:, 1].max() == pytest.approx(np.quantile(values, 0.9, axis=(0, 2)).max())
    ((x,), (y,)) = line(ax, "best set").get_data()
    assert y == best(values) and best(grid[score].sel(threshold=x).values) == y
    assert ax.get_xlabel() == "threshold (m)" and ax.get_title() == "SMRF"
    assert ax.get_ylabel() == {"total": "total error (%)", "kappa": "kappa (%)"}[score]


def test_curve_of_a_design_has_every_set_and_its_lower_envelope(design):
    ax = plots.sweep_curve(design, "slope")
    slope, total = design["slope"].values, design["total"].values
    np.testing.assert_array_equal(ax.collections[0].get_offsets(), np.column_stack([slope, total]))
    x, y = line(ax, "best of nearby sets").get_data()
    assert len(x) == 12 and (np.diff(x) > 0).all() and y.min() == total.min()
    edges = np.linspace(slope.min(), slope.max(), 13)
    parts = [(slope >= low) & (slope <= high) for low, high in itertools.pairwise(edges)]
    np.testing.assert_array_equal(y, [total[part].min() for part in parts])
    assert ax.get_ylim()[1] < total.max(), "the worst sets are cut off"


def test_words_stand_side_by_side_and_ratios_on_a_logarithmic_axis(design, grid):
    ax = plots.sweep_curve(design, "insertion")
    assert [t.get_text() for t in ax.get_xticklabels()] == list(dict.fromkeys(design["insertion"].values))
    assert set(ax.collections[0].get_offsets()[:, 0]) == {0.0, 1.0} and ax.get_xlim() == (-0.5, 1.5)
    assert plots.sweep_curve(design, "threshold").get_xscale() == "log"
    assert plots.sweep_curve(design, "slope").get_xscale() == "linear"
    assert plots.sweep_curve(grid, "slope").get_xscale() == "log"
    mixed = grid.assign_coords(cell=np.array([None, 1.0], object))
    assert [t.get_text() for t in plots.sweep_curve(mixed, "cell").get_xticklabels()] == ["none", "1"]


@pytest.mark.parametrize("score, best", [("total", np.min), ("kappa", np.max)])
def test_map_of_a_grid_is_the_best_over_the_others(grid, score, best):
    ax = plots.sweep_map(grid, "threshold", "slope", score)
    values = grid[score].values
    mesh = ax.collections[0]
    np.testing.assert_array_equal(mesh.get_array(), best(values, axis=2))
    assert (mesh.norm.vmin if score == "total" else mesh.norm.vmax) == best(values)
    ((x,), (y,)) = ax.lines[0].get_data()
    assert best(values[int(y), int(x)]) == best(values)
    assert [t.get_text() for t in ax.get_xticklabels()] == ["0.3", "0.5", "0.7"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("threshold (m)", "slope (rise/run)")
    bar = ax.figure.axes[1]
    assert "best over the other parameters" in bar.get_ylabel()


def test_map_of_a_design_has_every_set_with_the_best_on_top(design):
    ax = plots.sweep_map(design, "slope", "threshold")
    points = ax.collections[0]
    drawn = np.asarray(points.get_array())
    assert (np.diff(drawn) <= 0).all() and drawn[-1] == design["total"].min()
    at = np.argsort(-design["total"].values)
    np.testing.assert_array_equal(points.get_offsets()[:, 0], design["slope"].values[at])
    assert ax.get_yscale() == "log"
    (x,) = ax.lines[0].get_xdata()
    assert design["total"].values[design["slope"].values == x] == [design["total"].values.min()]


def test_maps_have_a_panel_per_pair_and_one_scale(grid):
    figure = plots.sweep_maps(grid)
    panels, bar = figure.axes[:-1], figure.axes[-1]
    assert len(panels) == 3 and "total error (%)" in bar.get_ylabel()
    assert len({(ax.collections[0].norm.vmin, ax.collections[0].norm.vmax) for ax in panels}) == 1
    for scores in (several(grid, 1.0, None), grid):
        np.testing.assert_array_equal(
            plots.sweep_map(scores, "slope", "cell").collections[0].get_array(), grid["total"].min("threshold").T
        )


@pytest.mark.parametrize("draw, error, words", [
    (lambda grid: plots.sweep_curve(grid, "window"), ParameterError, "axis='window': choose one of 'slope'"),
    (lambda grid: plots.sweep_map(grid, "slope", "slope"), ParameterError, "both 'slope'"),
    (lambda grid: plots.sweep_curves(grid, "f1"), ParameterError, "score='f1'"),
    (lambda grid: best_sets(grid, "f1"), ParameterError, "score='f1': choose one of 'type1'"),
    (lambda grid: plots.sweep_curves(grid * np.nan), InputError, "no reference labels"),
    (lambda grid: plots.sweep_maps(grid.isel(threshold=0, cell=0, drop=True)), InputError, "only slope was swept"),
])  # fmt: skip
def test_pictures_name_what_is_wrong(grid, draw, error, words):
    with pytest.raises(error, match=words):
        draw(grid)


def test_votes_map_draws_disputed_points(rng):
    xyz = np.column_stack([rng.uniform(0, 50, (2000, 2)), rng.uniform(0, 0.1, 2000)])
    echoes = {"return_number": 1 + np.arange(2000) % 2, "number_of_returns": np.full(2000, 2)}
    cloud = PointCloud.from_arrays(xyz, **{name: values.astype(np.uint8) for name, values in echoes.items()})
    votes = np.where(cloud.candidate, rng.choice([0.0, 0.25, 0.5, 0.9, 1.0], 2000), 0.0).astype(np.float32)
    ax = plots.votes_map(cloud, votes, title="where parameters matter")
    points, disputed = ax.collections[0], (votes > 0) & (votes < 1)
    drawn = points.get_offsets().tolist()
    assert sorted(map(tuple, drawn)) == sorted(map(tuple, cloud.xyz[disputed, :2].tolist()))
    place = {tuple(xy): share for xy, share in zip(cloud.xyz[:, :2].tolist(), votes, strict=True)}
    of_drawn = np.array([place[tuple(xy)] for xy in drawn])
    np.testing.assert_allclose(points.get_array(), 100 * np.minimum(of_drawn, 1 - of_drawn), rtol=1e-6)
    assert (np.diff(points.get_array()) >= 0).all(), "the most disputed are on top"
    (text,) = (t.get_text() for t in ax.get_legend().get_texts())
    assert f"{disputed.sum():,} of 1,000 judged points ({disputed.sum() / 10:.1f} %)" in text
    for same in (np.zeros(2000), np.where(cloud.candidate, 1.0, 0.0)):
        ax = plots.votes_map(cloud, same)
        assert len(ax.collections[0].get_offsets()) == 0
        assert "0 of 1,000" in ax.get_legend().get_texts()[0].get_text()
    for wrong in (votes[1:], votes + 1, np.where(votes > 0, np.nan, votes)):
        with pytest.raises(InputError, match="votes: shares between 0 and 1 of 2000 points"):
            plots.votes_map(cloud, wrong)
