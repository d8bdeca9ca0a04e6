"""Filters compared on the same clouds, and what results, clouds and filters show of themselves."""

from __future__ import annotations

import dataclasses
import itertools
import math
import warnings

import jax
import numpy as np
import pandas
import pytest
import scipy.stats

import jaxfilter as jf
from jaxfilter.sweeps.comparison import Comparison, holm
from jaxfilter.terrain.accuracy import FIGURES


@pytest.fixture(scope="module")
def clouds(town):
    """Two halves of a town; the second without a reference."""
    west = town.xyz[:, 0] < np.median(town.xyz[:, 0])
    truth = town.truth
    return {
        "west": jf.PointCloud.from_arrays(town.xyz[west], reference=truth[west]),
        "east": jf.PointCloud.from_arrays(town.xyz[~west]),
    }


@pytest.fixture(scope="module")
def compared(clouds):
    return jf.compare(["smrf", jf.SMRF(slope=0.3), jf.SMRF(window=0.1, cell=1000.0)], clouds, repeats=2)


def test_a_comparison_has_the_scores_of_every_filter_on_every_cloud(clouds, compared):
    table = compared.table.set_index(["method", "cloud"])
    assert list(dict.fromkeys(compared.table["method"])) == ["SMRF", "SMRF(slope=0.3)", "SMRF(cell=1000.0, window=0.1)"]
    for name, filter_ in (("SMRF", jf.SMRF.for_cloud(clouds["west"])), ("SMRF(slope=0.3)", jf.SMRF(slope=0.3))):
        row, result = table.loc[name, "west"], filter_(clouds["west"])
        scores = jf.evaluate(result, clouds["west"])
        assert [row[key] for key in ("type1", "type2", "total", "kappa")] == [
            scores.type1, scores.type2, scores.total, scores.kappa,
        ]  # fmt: skip
        errors = jf.dtm_rmse(clouds["west"], result, interpolation=jf.Interpolation(fill=True))
        assert [row[key] for key in errors.as_dict()] == list(errors.as_dict().values()) and errors.border.cells > 100
        assert row["ground"] == result.ground.sum() and row["status"] == "CONVERGED"
        assert row["parameters"] == repr(filter_) and 0 < row["seconds"] < row["first_seconds"] + 60
        assert math.isnan(table.loc[name, "east"]["total"]) and math.isnan(table.loc[name, "east"]["border_off_1m"])
        assert table.loc[name, "east"]["seconds"] > 0


def test_terrain_models_are_compared_on_request_and_where_there_are_any(clouds, compared):
    assert compared.by_method("off_1m").loc["west"].between(0, 100).all()
    assert "> 1 m at the border, %" in compared.markdown()
    west = clouds["west"]
    without = jf.compare([jf.SMRF()], west, repeats=0, cell=None)
    assert without.table["rmse"].isna().all() and "RMSE" not in without.markdown()


def test_a_filter_that_fails_is_a_row_without_figures(clouds):
    far = np.vstack([clouds["west"].coordinates(), [[3e5, 0, 0]]])
    table = jf.compare([jf.SMRF()], {"far": jf.PointCloud.from_arrays(far)}, repeats=0).table
    assert table["status"][0].startswith("InputError") and np.isnan(table["seconds"][0])


def test_tables_are_written_as_markdown_and_latex(compared):
    lines = compared.markdown().splitlines()
    assert len(lines) == 2 + len(compared.table) and lines[0].startswith("| method | cloud | points | T.I |")
    assert "–" in next(line for line in lines if "east" in line)
    text = compared.latex()
    assert text.count(r"\\") == 1 + len(compared.table) and r"SMRF(slope=0.3) & west &" in text
    rows = [("A|&", r"x_1 \y", 2.0), ("B", "z", math.nan)]
    odd = Comparison(pandas.DataFrame(rows, columns=["method", "cloud", "kappa"]).assign(points=1))
    odd = dataclasses.replace(odd, table=odd.table.reindex(columns=compared.table.columns))
    assert [line.split("|", 3)[1] for line in odd.markdown().splitlines()[2:]] == [" A\\", " B "]
    assert r"A|\& & x\_1 \textbackslash y & 1 & 2.00 & -- & --" in odd.latex()
    assert str(compared).splitlines()[0].split()[:3] == ["method", "cloud", "points"]


FORMS = {
    "bool": lambda cloud, ground, path: ground,
    "integers": lambda cloud, ground, path: ground.astype(np.uint8),
    "scores": lambda cloud, ground, path: np.where(ground, 0.5, 0.49).astype(np.float32),
    "result": lambda cloud, ground, path: jf.FilterResult.of_labels(ground),
    "points in another order": lambda cloud, ground, path: jf.PointCloud.from_arrays(
        cloud.coordinates()[::-1], classification=np.where(ground, 2, 6)[::-1]
    ),
    "npy": lambda cloud, ground, path: np.save(path.with_suffix(".npy"), ground) or path.with_suffix(".npy"),
    "saved": lambda cloud, ground, path: jf.FilterResult.of_labels(ground).save(path.with_suffix(".npz")),
    "laz": lambda cloud, ground, path: jf.write(path.with_suffix(".laz"), cloud, ground) or path.with_suffix(".laz"),
    "text, where 0 is ground": lambda cloud, ground, path: (
        np.savetxt(path.with_suffix(".txt"), np.column_stack([cloud.coordinates(), ~ground])[::-1], "%.3f")
        or str(path.with_suffix(".txt"))
    ),
}


@pytest.fixture(scope="module")
def labelled(town):
    """Two halves of a town, and labels of each, of which some are wrong."""
    west = town.xyz[:, 0] < np.median(town.xyz[:, 0])
    halves = {"west": west, "east": ~west}
    clouds = {n: jf.PointCloud.from_arrays(town.xyz[h], reference=town.truth[h]) for n, h in halves.items()}
    return clouds, {name: cloud.reference ^ (np.arange(len(cloud)) % 9 == 0) for name, cloud in clouds.items()}


@pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
@pytest.mark.parametrize("form", FORMS)
def test_labels_from_elsewhere_stand_beside_those_of_filters(labelled, tmp_path, form):
    clouds, ground = labelled
    theirs = {name: FORMS[form](clouds[name], ground[name], tmp_path / name) for name in reversed(clouds)}
    given = {"theirs": theirs, "a list": [theirs[name] for name in clouds], "SMRF": jf.SMRF()}
    found = jf.compare(given, clouds, repeats=0, cell=None)
    for name, cloud in clouds.items():
        scores = jf.evaluate(ground[name], cloud)
        assert found.by_method("kappa").loc[name, ["theirs", "a list"]].tolist() == [scores.kappa] * 2
    rows = found.table[found.table["method"] == "theirs"]
    assert rows["seconds"].isna().all() and rows["ground"].tolist() == [ground[name].sum() for name in clouds]
    line = found.markdown().splitlines()[2]
    assert line.startswith("| theirs | west |") and line.endswith("| – | – |")
    assert found.provenance["clouds"] == {name: cloud.digest() for name, cloud in clouds.items()}


@pytest.mark.parametrize("change, error, words", [
    (lambda west, east: [west, east[1:]], jf.InputError, r"compare: theirs on east: labels bool\[\d+\] for \d+ points"),
    (lambda west, east: [west, east + 1], jf.InputError, "theirs on east: the label of point 0 is 2: .* classes == 2"),
    (lambda west, east: [west * np.float32("nan"), east], jf.InputError, "theirs on west: the label of point 0 is nan"),
    (lambda west, east: west, jf.InputError, "theirs: there are 2 clouds and labels of 1"),
    (lambda west, east: {"west": west, "north": east}, jf.InputError, "theirs: labels: east has no labels"),
    (lambda west, east: [west, jf.SMRF()], jf.ParameterError, "the list of theirs has filters and labels"),
    (lambda west, east: [west, "no.npy"], jf.InputError, r"no\.npy: cannot be read .*No such file"),
])  # fmt: skip
def test_labels_that_do_not_fit_are_found_before_anything_runs(labelled, monkeypatch, change, error, words):
    clouds, ground = labelled
    monkeypatch.setattr(jf.SMRF, "__call__", None)
    with pytest.raises(error, match=words):
        jf.compare({"SMRF": jf.SMRF(), "theirs": change(*ground.values())}, clouds)
    with pytest.raises(jf.ParameterError, match="labels need a name"):
        jf.compare([ground["west"]], clouds["west"])


LISTS = {"one of two": [jf.SMRF(threshold=0.2), jf.SMRF(threshold=1.5)]}


@pytest.mark.parametrize("filters, options, words", [
    ([], {}, "there is none"),
    (["no"], {}, "'no' is no filter"),
    ([jf.SMRF(), jf.SMRF()], {}, "two of the name SMRF"),
    ([jf.SMRF()], {"repeats": -1}, "repeats=-1"),
    ([jf.SMRF()], {"cell": 0.0}, "cell=0.0"),
    ([jf.SMRF()], {"workers": 0}, "workers=0"),
    ([jf.SMRF()], {"workers": 1.5}, "workers=1.5"),
    ([jf.SMRF()], {"groups": {"north": "a"}}, "no cloud 'north'"),
    (LISTS, {"groups": {"west": "all", "east": "all"}}, "there is one group only"),
])  # fmt: skip
def test_wrong_arguments_are_found_before_anything_runs(clouds, filters, options, words):
    with pytest.raises(jf.ParameterError, match=words):
        jf.compare(filters, clouds, **options)


def test_clouds_go_by_names_or_numbers(clouds):
    with pytest.raises(jf.InputError, match="compare: two clouds are called '1'"):
        jf.compare([jf.SMRF()], {1: clouds["west"], "1": clouds["east"]})
    with pytest.raises(jf.InputError, match="compare: there is no cloud"):
        jf.compare([jf.SMRF()], {})
    with pytest.raises(jf.ParameterError, match="there is one group only"):  # none is chosen on clouds of its own group
        jf.compare(LISTS, list(clouds.values()), groups={0: "site", 1: "site"}, repeats=0)


def table_of(values):
    """Methods to a total error per cloud; clouds are of the groups a, a, b, b, ..."""
    rows = [
        {"method": m, "cloud": f"c{i}", "group": "abcdefgh"[i // 2], "total": v, "kappa": 100 - v}
        for m, line in values.items()
        for i, v in enumerate(line)
    ]
    return Comparison(pandas.DataFrame(rows))


def significance(own, other, score="total"):
    """Of two methods, the first against the second."""
    return table_of({"own": own, "other": other}).significance(score).iloc[0]


def signed_rank_p(differences):
    """Wilcoxon's two-sided p, by all assignments of signs; no ties, no zeros."""
    ranks = np.argsort(np.argsort(np.abs(differences))) + 1
    observed = ranks[np.asarray(differences) > 0].sum()
    sums = np.array([np.dot(ranks, signs) for signs in itertools.product((0, 1), repeat=len(ranks))])
    return min(1.0, 2 * min((sums >= observed).mean(), (sums <= observed).mean()))


@pytest.mark.filterwarnings("ignore:significance:jaxfilter.JaxfilterWarning")
def test_significance_is_that_of_the_signed_ranks(rng):
    other = rng.normal(10, 1, 9)
    own = other - rng.normal(0.5, 0.6, 9)
    found, as_kappa = significance(own, other), significance(own, other, "kappa")
    assert found["p"] == as_kappa["p"] == pytest.approx(signed_rank_p(other - own))
    assert found["better"] == as_kappa["better"] == (own < other).sum() and found["worse"] == (own > other).sum()
    assert found["difference"] == pytest.approx((own - other).mean()) == pytest.approx(-as_kappa["difference"])
    statistic = scipy.stats.wilcoxon(own, other).statistic  # the smaller of both sums of ranks
    assert abs(found["effect"]) == pytest.approx(1 - 2 * statistic / (9 * 10 / 2))
    assert found["effect"] * found["median_difference"] < 0  # positive: the method errs less
    alike, none = significance([1.0, 2.0], [1.0, 2.0]), significance([math.nan], [1.0])
    assert (alike["p"], alike["effect"], none["clouds"]) == (1.0, 0.0, 0) and math.isnan(none["p"])
    assert significance([1.0, 1.0], [2.0, 3.0])["effect"] == 1.0
    against = table_of({"A": other, "B": own}).significance(against="A")
    assert against["method"].tolist() == ["B"] and against["clouds"][0] == 9
    # Shares in percent that differ by one point in a thousand differ by rounding, too: equal differences have equal ranks.
    own, other = np.array([32, 10, 55, 23, 76, 5]), np.array([33, 11, 56, 22, 77, 4])
    exact, rounded = significance(other, own), significance(100 * other / 1000, 100 * own / 1000)
    assert (rounded["effect"], rounded["p"]) == (exact["effect"], exact["p"])
    assert exact["effect"] == pytest.approx(-2 / 6)


def test_groups_are_compared_on_the_clouds_that_both_have():
    """The harder cloud of three groups, on which B failed, counts for none."""
    rows = [(m, f"{group}{n}", group, 10.0 * n) for group in "abcdef" for n in range(2) for m in "AB"]
    table = pandas.DataFrame(rows, columns=["method", "cloud", "group", "total"])
    table.loc[(table["method"] == "B") & table["cloud"].isin(["a1", "b1", "c1"]), "total"] = math.nan
    [row] = Comparison(table).significance(by="group").to_dict("records")
    assert (row["clouds"], row["difference"], row["effect"]) == (6, 0.0, 0.0)


def test_holm_corrects_step_by_step():
    assert holm([0.01, 0.04, 0.03, math.nan]) == pytest.approx([0.03, 0.06, 0.06, math.nan], nan_ok=True)
    assert holm([0.5, 0.6]) == [1.0, 1.0]


def test_unknown_scores_and_methods_are_named_and_every_figure_has_a_table(compared):
    with pytest.raises(jf.ParameterError, match="score='f1'"):
        compared.by_method("f1")
    with pytest.raises(jf.ParameterError, match="against='CSF'"):
        compared.significance(against="CSF")
    for score in FIGURES:
        assert compared.markdown(score).startswith("| method | west | east | mean |"), score
        assert compared.latex(score).startswith(r"\begin{tabular}"), score


# ---- results, clouds and filters ----


def test_results_become_tables_with_coordinates_and_units(town):
    cloud = dataclasses.replace(town.cloud, classification=town.classes)
    result = jf.SMRF()(cloud)
    data, table = result.to_xarray(), result.to_pandas()
    assert data.sizes == {"point": len(cloud)} and data["height"].units == "m" and data["slope"].units == "degrees"
    assert np.array_equal(np.column_stack([data.x, data.y, data.z]), cloud.coordinates())
    for name in ("ground", "height", "margin", "barred"):
        assert np.array_equal(data[name], getattr(result, name), equal_nan=name != "ground" and name != "barred")
        assert np.array_equal(table[name], data[name], equal_nan=name != "ground" and name != "barred")
    assert np.array_equal(table["classification"], town.classes) and list(table)[:3] == ["x", "y", "z"]
    assert (table["decision"] == "accepted").sum() == (result.decision == jf.Decision.ACCEPTED).sum()
    assert data.attrs["method"] == "SMRF" and data.attrs["status"] == "CONVERGED"
    assert result.run.filter == jf.SMRF() and result.run.cloud is cloud and result.run.seconds > 0
    assert "run" not in repr(result)
    alone = dataclasses.replace(result, run=None)
    assert "x" not in alone.to_xarray().coords and len(alone.to_pandas()) == len(cloud)


@pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
@pytest.mark.parametrize("filter_, key", [
    (jf.OST(), None), (jf.PTD(), jax.random.PRNGKey(7)), (jf.CSF(), jax.random.key(7)), (None, None),
])  # fmt: skip
def test_a_result_comes_back_from_its_file_bit_for_bit(tmp_path, filter_, key):
    cloud = jf.scenes.make("coast", size=80, density=1.0, seed=3).cloud
    result = jf.FilterResult.of_labels(cloud.candidate) if filter_ is None else filter_(cloud, key=key, trace=True)
    again = jf.FilterResult.load(result.save(tmp_path / "result"))
    for name, values in vars(result).items():
        if isinstance(values, np.ndarray):
            assert values.dtype == getattr(again, name).dtype and values.tobytes() == getattr(again, name).tobytes()
    assert (again.status, again.info, again.run, repr(again)) == (result.status, result.info, None, repr(result))
    for before, after in zip(result.trace, again.trace, strict=True):
        assert before.keys() == after.keys() and all(np.array_equal(before[name], after[name]) for name in before)
    assert (again.water_cells is None) == (result.water_cells is None) == (filter_ != jf.OST())
    if again.water_cells is not None:
        assert again.water_cells.side == result.water_cells.side
        assert np.array_equal(again.water_cells.at, result.water_cells.at)
    found = again.provenance
    assert found == result.provenance
    if filter_ is not None:
        assert type(filter_)(**found["parameters"]) == filter_ and found["jaxfilter"] == jf.__version__
        assert found["cloud"] == cloud.digest() and found["key"] == (None if key is None else [0, 7])
        turned = jf.PointCloud.from_arrays(cloud.coordinates()[::-1], candidate=cloud.candidate[::-1])
        assert found["cloud"] != turned.digest()
    with pytest.raises(jf.OutputError, match=r"result: the file exists; pass overwrite=True"):
        result.save(tmp_path / "result")
    assert jf.FilterResult.load(again.save(tmp_path / "result", overwrite=True)).provenance == found


@pytest.mark.parametrize("kind", ["absent", "text", "array", "npz", "length", "cut", "changed"])
def test_a_file_that_is_no_result_is_named(tmp_path, kind):
    path = jf.FilterResult.of_labels(np.ones(1000, bool)).save(tmp_path / "result.npz")
    whole = path.read_bytes()
    if kind == "array":
        path = tmp_path / "a.npy"
        np.save(path, np.ones(3))
    elif kind == "npz":
        np.savez(path, ground=np.ones(3, bool))
    elif kind == "length":
        with np.load(path) as file:
            np.savez(path, **(dict(file) | {"margin": np.ones(999, np.float32)}))
    else:
        made = {"text": b"no result", "cut": whole[:-500], "changed": whole.replace(b"\1" * 900, b"\1" * 899 + b"\0")}
        path.unlink() if kind == "absent" else path.write_bytes(made[kind])
    with pytest.raises(jf.InputError, match=rf"{path.name}: is no result that FilterResult\.save has written"):
        jf.FilterResult.load(path)


def test_too_few_clouds_for_any_significance_are_said():
    least = scipy.stats.wilcoxon([1.0, 2.0, 3.0, 4.0]).pvalue
    four = table_of({"A": [1.0, 2.0, 3.0, 4.0], "B": [2.0, 4.0, 6.0, 8.0]})
    with pytest.warns(jf.JaxfilterWarning, match=r"4 clouds cannot give p below 0\.12.* at least 6 clouds"):
        assert four.significance()["p"].tolist() == [0.125] == [least]
    eight = table_of({"A": np.arange(8.0), "B": np.arange(8.0) * 1.1 + 1})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert eight.significance()["clouds"].tolist() == [8]
    with pytest.warns(jf.JaxfilterWarning, match="4 groups cannot"):
        found = eight.significance(by="group")
    assert found["clouds"].tolist() == [4] and found["mean"].tolist() == [3.5]


def test_methods_by_clouds_have_means_and_the_best_in_bold():
    found = table_of({"A_1": [1.0, 4.0], "B": [2.0, 3.0]})
    assert found.markdown("total").splitlines()[2:] == [
        "| A_1 | **1.00** | 4.00 | **2.50** |",
        "| B | 2.00 | **3.00** | **2.50** |",
    ]
    assert r"A\_1 & \textbf{1.00} & 4.00 & \textbf{2.50} \\" in found.latex("total")
    assert "| A_1 | **99.00** | 96.00 |" in found.markdown("kappa")


def test_scores_stand_side_by_side_above_their_means_as_in_the_literature():
    found = table_of({"A_1": [1.0, 4.0, 3.0], "B": [2.0, 3.0, math.nan]})
    assert found.markdown(["total", "kappa"]).splitlines() == [
        "| cloud | A_1 TE | A_1 kappa | B TE | B kappa |",
        "|---|---:|---:|---:|---:|",
        "| c0 | **1.00** | **99.00** | 2.00 | 98.00 |",
        "| c1 | 4.00 | 96.00 | **3.00** | **97.00** |",
        "| c2 | **3.00** | **97.00** | – | – |",
        "| mean, a | **2.50** | **97.50** | **2.50** | **97.50** |",
        "| mean, b | **3.00** | **97.00** | – | – |",
        "| mean | **2.67** | **97.33** | – | – |",
    ]
    rows = found.latex(["total", "kappa"]).splitlines()
    assert rows[2] == r" & \multicolumn{2}{c}{A\_1} & \multicolumn{2}{c}{B} \\"
    assert rows[3] == r"cloud & TE & kappa & TE & kappa \\"
    assert [i for i, row in enumerate(rows) if row == r"\midrule"] == [4, 8]
    assert rows[9] == r"mean, a & \textbf{2.50} & \textbf{97.50} & \textbf{2.50} & \textbf{97.50} \\"
    with pytest.raises(jf.ParameterError, match="score='f1'"):
        found.markdown(["total", "f1"])


def test_a_model_that_is_too_low_is_no_better_than_one_that_is_too_high():
    rows = [("low", "a", -2.0), ("low", "b", -1.0), ("high", "a", 0.5), ("high", "b", 1.5)]
    found = Comparison(pandas.DataFrame(rows, columns=["method", "cloud", "mean"]))
    assert found.markdown("mean").splitlines()[2:] == [
        "| low | -2.000 | **-1.000** | -1.500 |",
        "| high | **0.500** | 1.500 | **1.000** |",
    ]
    with pytest.warns(jf.JaxfilterWarning, match="cannot give p"):
        [row] = found.significance("mean").to_dict("records")
    assert (row["better"], row["worse"], row["difference"]) == (1, 1, 0.5)


def test_of_a_list_each_group_is_filtered_with_what_is_best_on_the_others(town):
    x = town.xyz[:, 0]
    thirds = np.searchsorted(np.quantile(x, (1 / 3, 2 / 3)), x)
    clouds = {
        f"part {k}": jf.PointCloud.from_arrays(town.xyz[thirds == k], reference=town.truth[thirds == k])
        for k in range(3)
    }
    sets = [jf.SMRF(threshold=t) for t in (0.1, 0.2, 0.4)]
    groups = {"part 0": "west", "part 1": "west", "part 2": "east"}
    found = jf.compare({"SMRF": sets, "plain": jf.SMRF()}, clouds, groups=groups, repeats=0, cell=None)
    total = {
        (one.threshold, name): jf.evaluate(one(cloud), cloud).total for one in sets for name, cloud in clouds.items()
    }
    for name in clouds:
        others = [other for other in clouds if groups[other] != groups[name]]
        best = min(sets, key=lambda one: np.mean([total[one.threshold, other] for other in others]))
        row = found.table[(found.table["method"] == "SMRF") & (found.table["cloud"] == name)].iloc[0]
        assert row["parameters"] == repr(best) and row["total"] == total[best.threshold, name]
    assert found.by_method(by="group").index.tolist() == ["west", "east"]
