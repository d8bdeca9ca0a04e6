"""The experiments: published figures are consistent, tables come out right, and a small run works from end to end."""

import json
import signal
import statistics
import subprocess
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import jaxfilter as jf  # noqa: E402
from experiments import labels, quoted, remake, report, report_page  # noqa: E402
from experiments.ablations import run as ablations  # noqa: E402
from experiments.bench import measure as bench_measure  # noqa: E402
from experiments.bench import ops as bench_ops  # noqa: E402
from experiments.bench import run as bench  # noqa: E402
from experiments.benchmark import run as benchmark  # noqa: E402
from experiments.default import doubt, flat  # noqa: E402
from experiments.defaults import clouds  # noqa: E402
from experiments.fits import run as fits  # noqa: E402
from experiments.isprs import protocols, samples, search, spaces, tables  # noqa: E402
from experiments.isprs import run as isprs  # noqa: E402
from experiments.mutations import kinds as mutations  # noqa: E402
from experiments.papers import agptd2024, li2021, paper, ppdf2023, spf2023, stin2024  # noqa: E402
from experiments.papers.li2021_figures import time_fit  # noqa: E402
from experiments.scenes import clouds as sites  # noqa: E402
from experiments.scenes import measures  # noqa: E402
from experiments.scenes import run as scenes  # noqa: E402
from experiments.sensitivity import calibration  # noqa: E402
from experiments.sensitivity import speed as sweep_speed  # noqa: E402
from jaxfilter.methods import ost  # noqa: E402
from jaxfilter.sweeps.ranges import RANGES, SEARCHED, Range, search_ranges  # noqa: E402


def test_means_of_the_published_tables_are_those_that_their_papers_print():
    table = samples.published("li2021_table4")
    for method, total, kappa, seconds in (("fptd", 6.12, 79.76, 2.82), ("ptd", 11.23, 69.63, 33.39)):
        rows = [row for row in table if row["method"] == method and row["sample"] != "average"]
        assert [row["sample"] for row in rows] == [f"samp{number}" for number in samples.SAMPLES]
        for key, printed in (("total", total), ("kappa", kappa), ("seconds", seconds)):
            assert statistics.fmean(row[key] for row in rows) == pytest.approx(printed, abs=0.011)
    pingel = samples.published("pingel2013")
    assert statistics.fmean(row["kappa_oracle"] for row in pingel) == pytest.approx(90.02, abs=0.005)
    assert statistics.fmean(row["total_oracle"] for row in pingel) == pytest.approx(2.97, abs=0.005)
    assert statistics.fmean(row["kappa_fixed"] for row in pingel) == pytest.approx(85.4, abs=0.05)


def test_averages_that_a_paper_prints_are_those_of_its_rows():
    for name, columns in (("chen2023_table2", "type1 type2 total"), ("zheng2024_table6", "type1 type2 total kappa")):
        table = samples.published(name)
        for printed in (row for row in table if row["sample"] == "average"):
            rows = [row for row in table if row["method"] == printed["method"] and row["sample"].startswith("samp")]
            assert len(rows) == 15
            for key in columns.split():
                assert statistics.fmean(row[key] for row in rows) == pytest.approx(printed[key], abs=0.011)


def test_stin_errors_are_worked_out_from_the_printed_counts():
    counts = {(row["sample"], row["row"]): row for row in samples.published("uray2024_table3")}
    for row in samples.published("uray2024_from_counts"):
        if row["sample"] == "average":
            continue
        as_ground, as_object = (counts[row["sample"], f"classified_{kind}"] for kind in ("ground", "object"))
        lost, accepted = as_object["ground"], as_ground["object"]
        ground, objects = as_ground["ground"] + lost, accepted + as_object["object"]
        found = 100 * lost / ground, 100 * accepted / objects, 100 * (lost + accepted) / (ground + objects)
        assert found == pytest.approx((row["type1"], row["type2"], row["total"]), abs=0.006)


@pytest.mark.parametrize("name", ["li2021_table4", "chen2023_table2"])
def test_published_errors_agree_with_the_numbers_of_ground_and_object_points(name):
    counts = {row["sample"]: row for row in samples.published("sithole2004_samples")}
    assert sum(row["points"] for row in counts.values()) == 384955
    rows = [row for row in samples.published(name) if row["sample"] in counts]
    assert len(rows) == 30
    for row in rows:
        points = counts[row["sample"]]
        lost, accepted = row["type1"] * points["ground"], row["type2"] * points["objects"]
        assert (lost + accepted) / points["points"] == pytest.approx(row["total"], abs=0.021)


def test_every_sample_and_site_has_a_terrain_class_with_the_thresholds_of_its_preset():

    rows = samples.published("li2021_table1")
    assert {row["cloud"] for row in rows} == {f"samp{number}" for number in samples.SAMPLES} | set(samples.SITES)
    for row in rows:
        preset = jf.FPTD.preset(row["terrain"])
        assert (preset.max_angle, preset.max_elevation) == (row["max_angle"], row["max_elevation"])


def test_a_table_shows_numbers_by_format_and_what_is_absent_as_a_dash():
    rows = [{"sample": "a", "total": 1.0, "kappa": float("nan")}, {"sample": "b", "total": 4.0}]
    text = report.markdown(
        [("sample", "sample", ""), ("total", "TE", ".2f"), ("kappa", "kappa", ".1f")],
        report.with_averages(rows, "sample"),
    )
    assert text.splitlines() == [
        "| sample | TE | kappa |",
        "|---|---:|---:|",
        "| a | 1.00 | – |",
        "| b | 4.00 | – |",
        "| mean | 2.50 | – |",
        "| median | 2.50 | – |",
    ]


def test_csv_keeps_rows_with_different_keys(tmp_path):
    rows = [{"name": "x", "points": 3}, {"name": "y", "seconds": 0.5}]
    report.write_csv(tmp_path / "rows.csv", rows)
    assert report.read_csv(tmp_path / "rows.csv") == [
        {"name": "x", "points": 3, "seconds": ""},
        {"name": "y", "points": "", "seconds": 0.5},
    ]


def test_measured_figures_stand_beside_those_printed_for_the_same_sample():
    measured = [
        {"sample": "samp24", "method": "fptd", "total": 18.0},
        {"sample": "samp99", "method": "fptd", "total": 1.0},
    ]
    rows = paper.join(measured, samples.published("li2021_table4"), ("sample", "method"), ("total", "kappa"))
    assert rows[0]["printed_total"] == 17.71 and rows[0]["off_total"] == pytest.approx(0.29)
    assert rows[0]["printed_kappa"] == 61.59 and "off_kappa" not in rows[0]
    assert "printed_total" not in rows[1]
    titles = [title for _, title, _ in paper.columns(rows, ("sample",), ("total",), off=True)]
    assert titles == ["sample", "TE", "TE, printed", "difference"]


def test_time_fit_recovers_a_line():
    slope, intercept, r2 = time_fit([1e5, 5e5, 1e6], [1.2, 2.0, 3.0])
    assert (slope, intercept, r2) == pytest.approx((2.0, 1.0, 1.0))


@pytest.mark.parametrize("method", spaces.method_names())
def test_every_method_is_tried_with_as_many_sets_all_of_which_it_takes(method):
    ranges = search_ranges(jf.FILTERS[method])
    assert 1 <= len(ranges) <= 5
    sets = spaces.sets(method, 32)
    assert len(sets) == 32 and sets == spaces.sets(method, 32) and sets[0] == {}
    assert sets[:8] == spaces.sets(method, 8)
    assert len({tuple(s.values()) for s in sets}) == 32
    for thresholds in sets[1:]:
        assert thresholds.keys() == ranges.keys()
        for name, r in ranges.items():
            assert r.low * 0.999 <= thresholds[name] <= r.high * 1.001
        for sample in ("samp11", "samp51"):
            spaces.fixed(method, sample).replace(**thresholds)


def test_sets_cover_the_ranges_evenly():
    angles = np.array([s["max_angle"] for s in spaces.sets("ptd", 32)[1:]])
    r = RANGES["max_angle"]
    assert np.histogram(angles, 4, (r.low, r.high))[0].tolist() == [7, 8, 8, 8]  # 31 of 32 points of the sequence
    assert spaces.sets("ptd", 9)[5]["max_angle"] == spaces.sets("fptd", 9)[5]["max_angle"]


def test_a_method_without_a_space_of_its_own_is_varied_in_all_its_thresholds(monkeypatch):
    monkeypatch.delitem(SEARCHED, "smrf")
    monkeypatch.delitem(RANGES, "scaling")
    assert search_ranges(jf.SMRF) == {
        "slope": RANGES["slope"],
        "threshold": RANGES["threshold"],
        "scaling": Range(0.625, 2.5, "log"),
    }
    monkeypatch.delitem(SEARCHED, "fptd")
    assert search_ranges(jf.FPTD()).keys() == {"max_angle", "max_elevation"}


def test_matched_sets_differ_from_the_fixed_ones_in_the_limits_of_ptd_only():
    import dataclasses

    for method in spaces.method_names():
        fixed, matched = spaces.fixed(method, "samp51"), spaces.matched(method, "samp51")
        for f in dataclasses.fields(fixed):
            if f.name not in ("max_angle", "max_distance"):
                assert getattr(matched, f.name) == getattr(fixed, f.name)
        if hasattr(matched, "max_angle"):
            assert matched.max_angle == spaces.fixed("ptd", "samp51").max_angle


def random_kappa(rng):
    return {f"samp{n}": dict(enumerate(rng.uniform(0, 100, 6))) for n in samples.SAMPLES}


def test_leave_one_out_never_looks_at_the_sample_it_scores(rng):
    terrain = samples.terrain_classes()
    kappa = random_kappa(rng)
    chosen = protocols.class_choice(kappa, terrain)
    for sample in kappa:
        others = [s for s in kappa if s != sample and terrain[s] == terrain[sample]]
        mean = {i: statistics.fmean(kappa[s][i] for s in others) for i in range(6)}
        assert mean[chosen[sample]] == max(mean.values())
        changed = kappa | {sample: dict.fromkeys(range(6), 0.0) | {int(rng.integers(6)): 100.0}}
        assert protocols.class_choice(changed, terrain)[sample] == chosen[sample]
        outside = {s: v if terrain[s] == terrain[sample] else random_kappa(rng)[s] for s, v in kappa.items()}
        assert protocols.class_choice(outside, terrain)[sample] == chosen[sample]


def test_a_sample_alone_in_its_class_keeps_the_fixed_set(rng):
    assert protocols.class_choice({"samp53": {0: 1.0, 1: 2.0}}, samples.terrain_classes()) == {"samp53": 0}


def test_the_oracle_is_never_below_the_class_protocol_or_the_fixed_set(rng):
    kappa = random_kappa(rng)
    oracle, by_class = protocols.oracle_choice(kappa), protocols.class_choice(kappa, samples.terrain_classes())
    for sample, sets in kappa.items():
        assert sets[oracle[sample]] >= max(sets[by_class[sample]], sets[0])


def test_a_set_that_failed_is_never_chosen():
    failed = {
        "sample": "samp52",
        "set": 0,
        "status": "ParameterError: no",
        "kept": "",
        "lost": "",
        "accepted": "",
        "rejected": "",
    }
    good = failed | {"set": 1, "kept": 5, "lost": 5, "accepted": 5, "rejected": 5, "status": "CONVERGED"}
    table = protocols.kappa_table([failed, good])
    assert protocols.oracle_choice(table) == {"samp52": 1}


def test_pooled_figures_are_those_of_all_points_together():
    counts = (
        {"kept": 90, "lost": 10, "accepted": 0, "rejected": 0},
        {"kept": 0, "lost": 0, "accepted": 30, "rejected": 870},
    )
    rows = [{"method": "ptd", "seconds": 0.5} | c | protocols.scores(c) for c in counts]
    rows[0]["kappa"] = rows[1]["kappa"] = 0.0  # undefined where a class is missing
    line = protocols.summary(rows)
    assert (line["pooled_type1"], line["pooled_type2"], line["pooled_total"]) == pytest.approx((10.0, 30 / 9, 4.0))
    assert line["seconds_per_million"] == pytest.approx(1000.0)


@pytest.mark.parametrize(
    ("gains", "verdict"),
    [
        ([4, 1, -1], "tendency"),
        ([4, 5, 6, 7, 8, 9, 10, -1], "confirmed"),  # p = 4 / 256 by counting the signed ranks
        ([8, -1, -1], "mixed"),
        ([-1, 1, 1], "tendency"),
        ([-4, -1, 1], "refuted"),
        ([0, 0], "refuted"),
    ],
)
def test_claims_are_judged_by_mean_number_of_samples_and_chance(gains, verdict):
    found = protocols.compare([(50.0, 50.0 - gain) for gain in gains], larger_is_better=False)
    assert found["verdict"] == verdict
    assert found == found | {"better": sum(g > 0 for g in gains), "worse": sum(g < 0 for g in gains)}
    if verdict == "confirmed":
        assert found["p"] == pytest.approx(4 / 256)
    assert protocols.compare([(50.0, 50.0 + gain) for gain in gains], larger_is_better=True)["verdict"] == verdict


def test_every_claim_is_judged_against_ptd_under_the_same_protocol():
    rows = [
        {"sample": f"samp{n}", "method": m, "type1": 5.0, "type2": 5.0, "total": t, "kappa": 90.0 - t, "seconds": 1.0}
        for n in samples.SAMPLES
        for m, t in (("ptd", 9.0), ("fptd", 6.0), ("spf", 10.0))
    ]
    found = protocols.claims({"class": rows, "fixed": rows})
    verdicts = {(r["method"], r["quantity"], r["protocol"]): r["verdict"] for r in found}
    assert verdicts["fptd", "total", "fixed"] == "confirmed" and verdicts["spf", "total", "class"] == "refuted"
    assert {method for method, _, _ in verdicts} == {"fptd", "spf"}
    line = next(r for r in found if r["method"] == "fptd" and r["quantity"] == "total")
    assert (line["better"], line["samples"], line["difference"], line["printed_ptd"]) == (15, 15, -3.0, 11.23)
    assert protocols.differences(rows, "total")[0] == {"sample": "samp11", "ptd": 9.0, "fptd": -3.0, "spf": 1.0}


def test_missing_data_are_reported_with_where_to_get_them(tmp_path):
    with pytest.raises(SystemExit, match=r"JAXFILTER_DATA(.|\n)*Sithole"):
        isprs.main(["--data", str(tmp_path), "--out", str(tmp_path / "out")])


@pytest.fixture(scope="module")
def two_samples(tmp_path_factory):
    """A data folder with two generated towns in place of samples 52 and 53, which share a terrain class."""
    from jaxfilter import scenes

    folder = tmp_path_factory.mktemp("data")
    (folder / "isprs").mkdir()
    for number, seed in (("52", 2), ("53", 3)):
        scene = scenes.make("town", size=(64, 60), density=0.8, seed=seed)
        last = scene.cloud.candidate
        table = np.column_stack([scene.xyz[last], ~scene.truth[last]])
        np.savetxt(folder / "isprs" / f"samp{number}.txt", table, fmt=["%.2f"] * 3 + ["%d"])
    return folder


@pytest.mark.slow
def test_a_run_on_generated_scenes_writes_every_table_and_goes_on_where_it_was(two_samples, tmp_path, monkeypatch):
    out = tmp_path / "isprs" / "results"
    given = ["--data", str(two_samples), "--out", str(out), "--samples", "52", "53", "--methods", "ptd", "fptd", "smrf"]
    given += ["--budget", "3", "--processes", "1", "--repeats", "1", "--dpi", "40"]
    isprs.main(given)
    table = {name: report.read_csv(out / f"{name}.csv") for name in ("fixed", "class", "oracle", "claims", "summary")}
    assert len(table["fixed"]) == len(table["class"]) == len(table["oracle"]) == 6
    kappa = {
        name: {(r["sample"], r["method"]): r["kappa"] for r in table[name]} for name in ("fixed", "class", "oracle")
    }
    for key, value in kappa["oracle"].items():
        assert value >= kappa["class"][key] and value >= kappa["fixed"][key] - 1e-9
    runs = {(r["sample"], r["set"]): protocols.scores(r)["kappa"] for r in report.read_csv(out / "search" / "fptd.csv")}
    assert len(runs) == 6 and kappa["fixed"]["samp52", "fptd"] == pytest.approx(runs["samp52", 0])
    chosen = {r["sample"]: r["set"] for r in table["class"] if r["method"] == "fptd"}
    assert runs["samp53", chosen["samp52"]] == max(runs["samp53", i] for i in range(3))
    assert {r["verdict"] for r in table["claims"]} <= {"confirmed", "tendency", "mixed", "refuted"}
    for name in ("totals", "errors", "time"):
        assert (out / "figures" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    text = (out / "results.md").read_text()
    assert all(f"## {name} protocol" in text for name in ("Fixed", "Class", "Oracle"))

    report_page.main(["--experiments", str(tmp_path), "--out", str(tmp_path / "page" / "README.md")])
    page = (tmp_path / "page" / "README.md").read_text()
    assert "../isprs/results/figures/errors.png" in page and "cannot be reproduced" in page

    monkeypatch.setattr(search, "evaluate", lambda *task: pytest.fail("ran again"))
    path = out / "search" / "smrf.csv"
    isprs.main([*given, "--no-figures"])
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:-1]))
    tasks = []
    monkeypatch.setattr(search, "evaluate", lambda *task: tasks.append(task) or [])
    isprs.main([*given, "--no-figures", "--protocols", "oracle"])
    assert [(method, sample, list(sets)) for method, sample, _, sets in tasks] == [("smrf", "samp53", [2])]


@pytest.mark.slow
def test_the_ablations_compare_each_choice_with_the_fixed_set(two_samples, tmp_path):
    every = ablations.variants()
    names = [(v.choice, v.name) for v in every]
    assert len(set(names)) == len(names)
    assert {v.choice.split(".")[0] for v in every} == {str(i) for i in range(1, 15)}
    given = ["--data", str(two_samples), "--out", str(tmp_path), "--samples", "52", "--choices", "2", "5", "10"]
    ablations.main([*given, "--processes", "1"])
    rows = report.read_csv(tmp_path / "summary.csv")
    base = {row["total"] for row in rows if row["baseline"] == "True" and row["variant"].startswith("FPTD")}
    assert len(base) == 1 and not any(row["failed"] for row in rows)
    assert (tmp_path / "total.png").exists() and "**FPTD: signed" in (tmp_path / "results.md").read_text()


def test_static_borders_are_those_of_the_switch_and_steps_that_do_not_exist_are_errors(town):
    made = {v.name: v.make("samp11") for v in ablations.variants() if v.name.startswith("PTD: every")}
    static = made["PTD: every 60 m, static"](town.cloud)
    follows = made["PTD: every 60 m, follow the ground"]
    switched = follows.replace(refresh_border=False)(town.cloud)
    assert np.array_equal(static.height, switched.height, equal_nan=True)
    assert not np.array_equal(static.height, follows(town.cloud).height, equal_nan=True)
    dense = made["PTD: every 5 m, static"](town.cloud).info["border_points"]
    xy = town.cloud.coordinates()[town.cloud.candidate, :2]
    cells = np.ceil(xy.max(axis=0) / 5) - np.floor(xy.min(axis=0) / 5)
    assert dense == 2 * cells.sum() > static.info["border_points"]
    with pytest.raises(AttributeError, match="no_such_step"):
        ablations._modified("ptd", no_such_step=print)("samp11")


def test_points_that_an_ablation_leaves_out_are_objects():

    from jaxfilter import scenes

    scene = scenes.make("town", size=(64, 60), density=0.8, seed=2)
    filter_ = jf.FPTD(radius=3.0, min_neighbours=4, low_clusters=False)
    barred = filter_(scene.cloud).barred
    assert barred.any() and not ablations._left_out(filter_, scene.cloud)[barred].any()


@pytest.mark.slow
def test_smrf_taken_apart_for_the_ablations_is_smrf(rng):
    xy = rng.uniform(0, (64, 60), (3000, 2))
    ridge = np.maximum(0, 6 - 0.3 * np.abs(xy[:, 0] - xy[:, 1]))  # squares cut more from it than disks
    cloud = jf.PointCloud.from_arrays(np.column_stack([xy, ridge + 4 * (rng.random(3000) < 0.2)]))
    apart = ablations._modified("smrf", **ablations._smrf_steps("disk", ablations._membrane))("samp11")
    squares = ablations._modified("smrf", **ablations._smrf_steps("square", ablations._membrane))("samp11")
    ground = spaces.fixed("smrf", "samp11")(cloud).ground
    assert np.array_equal(apart(cloud).ground, ground)
    assert 0 < squares(cloud).ground.sum() < ground.sum()


@pytest.mark.parametrize("fill", [ablations._triangles, ablations._inverse])
def test_holes_are_filled_from_the_cells_around_them(fill, rng):
    z = (np.add.outer(2.0 * np.arange(20), 3.0 * np.arange(30))).astype(np.float32)
    known, inside = rng.random(z.shape) < 0.5, np.ones(z.shape, bool)
    known[[0, 0, -1, -1], [0, -1, 0, -1]] = True
    inside[:, -3:] = False
    known[-1, -4] = known[0, -4] = True
    filled = np.asarray(fill(np.where(known, z, 0.0), known, inside))
    assert np.array_equal(filled[known], z[known])
    assert np.array_equal(fill(z, inside, inside), z)
    away = np.abs(filled - z)[inside & ~known]
    assert away.max() < (1e-3 if fill is ablations._triangles else 6.0)


def test_second_lowest_points_are_the_seeds_once_the_lowest_are_left_out(rng):
    xyz = np.column_stack([rng.uniform(0, 121, (600, 2)), rng.permutation(600) / 50])
    xyz[:2, :2] = (0, 0), (121, 121)
    cloud = jf.PointCloud.from_arrays(xyz)
    filter_ = ablations._modified("ptd", outliers=ablations._lowest_of_all)("samp11")
    seeds = filter_(cloud).decision == jf.core.result.Decision.SEED
    cell = np.minimum(cloud.xyz[:, :2] // 60.0, 1) @ (2, 1)
    for number in range(4):
        mine = np.flatnonzero(cell == number)
        assert np.flatnonzero(seeds & (cell == number)).tolist() == [mine[np.argsort(cloud.xyz[mine, 2])[1]]]


@pytest.mark.slow
def test_tiles_with_the_whole_around_them_have_its_labels_and_without_halo_have_not():
    scene = jf.scenes.make("town", size=(160, 150), density=0.5, seed=2)
    cloud = jf.PointCloud.from_arrays(scene.cloud.coordinates()[scene.cloud.candidate] + (500_000.25, 5_000_000.5, 0.0))
    filter_ = spaces.fixed("smrf", "samp51")
    whole = filter_(cloud).ground
    assert np.array_equal(ablations._tiled(160.0)(filter_, cloud), whole)
    assert np.mean(ablations._tiled(None)(filter_, cloud) != whole) < 0.001
    assert 0 < np.mean(ablations._tiled(0.0)(filter_, cloud) != whole) < 0.3


@pytest.mark.slow
def test_ppdf_upward_only_takes_no_point_below_its_plane():
    scene = jf.scenes.make("forest", size=40, density=3.0, seed=2)
    both, upward = (v.make("samp11")(scene.cloud) for v in ablations._ppdf())
    seeds = both.decision == jf.core.result.Decision.SEED
    assert (both.elevation[both.ground & ~seeds] < 0).any()
    seeds = upward.decision == jf.core.result.Decision.SEED
    assert (upward.elevation[upward.ground & ~seeds] >= 0).all()


def test_every_study_of_a_paper_is_listed_with_its_command():
    folder = ROOT / "experiments" / "papers"
    listed = (folder / "README.md").read_text()
    studies = [path.name for path in folder.glob("*.py") if "def main(" in path.read_text()]
    assert "li2021.py" in studies
    assert [name for name in studies if f"`python experiments/papers/{name}`" not in listed] == []


def test_a_cut_says_how_far_inside_a_point_lies():
    xy = np.array([[3.0, 4.0], [0.0, 0.0], [-1.0, 20.0], [6.0, 8.0]])
    turn = np.arctan2(4.0, 3.0)  # the inner side of the half plane is where (3, 4) points to
    np.testing.assert_allclose(measures.inside(xy, np.zeros(2), turn, None), [5.0, 0.0, 15.4, 10.0])
    np.testing.assert_allclose(measures.inside(xy, np.zeros(2), turn, 7.0), [2.0, 7.0, -8.4, -3.0])
    place = np.random.default_rng(0).uniform(0, 100, (4000, 2))
    few, many = (measures.drawn("a cloud", place, count) for count in (3, 6))
    for one, other in zip(few, many[:3], strict=True):
        np.testing.assert_array_equal(one(place), other(place))
    assert all((cut(place) >= 0).sum() >= measures.LEAST for cut in many)


def test_cuts_count_what_was_right_in_the_whole(monkeypatch):
    """A method that loses level ground within 10 m of the border, and lifts its terrain to a roof there."""
    x, y = (v.ravel() for v in np.meshgrid(*2 * [np.arange(0.25, 100, 0.5)]))
    low = np.column_stack([x, y, np.zeros(len(x))])
    cloud = jf.PointCloud.from_arrays(np.concatenate([low, low + [0.1, 0.1, 6.0]]))
    truth = np.arange(len(cloud)) < len(x)

    class Fooled:
        @classmethod
        def for_cloud(cls, cloud):
            return cls()

        def __call__(self, cloud, workers=None):
            (x, y), (x1, y1) = cloud.xyz[:, :2].T, cloud.xyz[:, :2].max(axis=0)
            near = np.minimum.reduce([x - x.min(), y - y.min(), x1 - x, y1 - y]) < 10
            return SimpleNamespace(ground=(cloud.xyz[:, 2] > 3) == near)

    monkeypatch.setitem(jf.FILTERS, "fooled", Fooled)
    monkeypatch.setattr(measures, "drawn", lambda *_: [lambda xy: xy[:, 0] - 40.0])
    site = sites.Site("level", "scenes", cloud, truth, np.ones(len(cloud), bool))
    row = measures.cuts(site, "fooled", Fooled()(cloud))[0]
    assert row["cells"] == 20 * 100
    assert row["off_whole"] == pytest.approx(20 * 20, abs=40)  # along the south and the north
    assert row["spoiled"] == pytest.approx(10 * 80, abs=90)
    assert row["off"] == row["off_whole"] + row["spoiled"]


def test_clouds_have_names_of_their_own_and_know_their_halls_crests_and_water(tmp_path):
    every = {one.name: one for one in sites.every(tmp_path)}
    assert len(every) == len(list(sites.every(tmp_path))) > 200
    assert {one.kind for one in every.values()} == {"scenes", "sensors", "drawn anew", "halls", "dikes", "water"}
    pond = every["water: scene pond, density 0.5"].make().area
    assert 1250 < pond.water.sum() < 1600 and not pond.deck.any()  # with a radius of 20 m
    roofs = {roof: sites.hall(1.0, roof, "inside", 100) for roof in ("flat", "gable", "annex")}
    heights = {roof: np.ptp(site.cloud.xyz[site.parts["hall"], 2]) for roof, site in roofs.items()}
    assert min(heights, key=heights.get) == "flat"
    assert roofs["annex"].parts["hall"].sum() > roofs["flat"].parts["hall"].sum()
    dike = sites.dike(0.5, 3.0, 5.0, 0.5)
    assert dike.cloud.xyz[dike.parts["crest"], 2].min() > 2.5


def test_clouds_are_measured_once_while_labels_stay(two_samples, tmp_path, monkeypatch):
    dike = sites.Cloud(
        "dikes", "a dike", partial(sites.dike, 0.5, 3.0, 5.0, 0.5), [("errors", "smrf"), ("errors", "pmf")]
    )
    dike = dike._replace(facts={"density": 0.5, "width": 5.0, "slope": 0.5})
    path = two_samples / "isprs" / "samp53.txt"
    sample = sites.Cloud("samples", "samp53", partial(sites.real, path), [("places", "ost"), ("cuts", "smrf")])
    monkeypatch.setattr(sites, "every", lambda folder: iter([dike, sample]))
    monkeypatch.setattr(scenes, "word", lambda name: f"l{name}")
    monkeypatch.setattr(remake, "counts", lambda name: "1 2")
    given = ["--data", str(two_samples), "--out", str(tmp_path), "--processes", "1"]
    scenes.main(given)

    def tables():
        return {name: report.read_csv(tmp_path / f"{name}.csv") for name in measures.MEASURES}

    first = tables()
    assert {name: len(rows) for name, rows in first.items()} == {
        "errors": 2,
        "cuts": measures.COUNT,
        "places": 1,
        "water": 0,
    }
    site, row = dike.make(), first["errors"][1]
    result = jf.SMRF.for_cloud(site.cloud)(site.cloud)
    assert row["total"] == pytest.approx(jf.evaluate(result, site.ground).total, rel=1e-4)  # five digits are kept
    assert row["crest"] == pytest.approx(100 * result.ground[site.parts["crest"]].mean(), rel=1e-4)
    assert 0 <= first["places"][0]["off_named"] <= first["places"][0]["off"]
    text = (tmp_path / "results.md").read_text()
    assert "### Points of a crest that are ground, %" in text and "## Named places" in text
    monkeypatch.setattr(jf.SMRF, "__call__", None)
    scenes.main(given)
    assert tables() == first
    monkeypatch.setattr(scenes, "word", lambda name: f"l{name}" + "2" * (name == "pmf"))
    scenes.main(given)
    assert [row["labels"] for row in tables()["errors"]] == ["lpmf2", "lsmrf"]


@pytest.mark.slow
def test_the_study_of_li_et_al_writes_its_tables(two_samples, tmp_path):
    li2021.main(["--data", str(two_samples), "--out", str(tmp_path / "out"), "--quick", "--samples", "53"])
    text = (tmp_path / "out" / "results.md").read_text()
    assert "39.99" in text  # printed kappa of FPTD on sample 53
    assert report.read_csv(tmp_path / "out" / "seeds.csv")[0]["printed_seeds"] == 841
    assert len(report.read_csv(tmp_path / "out" / "table1.csv")) == 23
    assert (tmp_path / "out" / "samp53.png").exists()


@pytest.mark.parametrize("sample", [f"samp{number}" for number in stin2024.SAMPLES])
def test_stin_and_atin_are_compared_with_thresholds_of_one_kind(sample):
    import dataclasses

    for kind, pair in stin2024.ALIKE.items():
        atin, stin = (stin2024.filters(sample)[name] for name in pair)
        both = {f.name for f in dataclasses.fields(atin)} & {f.name for f in dataclasses.fields(stin)} - {"thresholds"}
        assert {"max_angle", "max_distance", "seed_cell", "mirror", "low_clusters"} <= both
        assert [name for name in both if getattr(atin, name) != getattr(stin, name)] == []
        assert (atin.thresholds == "constant") == (stin.thresholds == "constant") == kind.startswith("constant")


def test_distances_of_the_first_test_of_stin_are_those_from_the_plane(rng):
    x, y = rng.uniform(0, 120, (2, 4000))
    z = 0.25 * x
    z[:500] += 3.0
    cloud = jf.PointCloud.from_arrays(np.column_stack([x, y, z]), reference=np.arange(4000) >= 500)
    distance, angle = stin2024.first_test("samp12", cloud)
    inner = ~np.isnan(angle) & (np.abs(cloud.xyz[:, :2] - 60) < 25).all(axis=1)
    expected = np.where(cloud.reference, 0.0, 3.0 / np.hypot(1, 0.25))
    np.testing.assert_allclose(distance[inner], expected[inner], atol=2e-3)
    row = stin2024.limit_row(
        "samp12", np.where(inner, distance, np.nan), np.where(inner, angle, np.nan), cloud.reference
    )
    assert (row["ground"], row["objects"], row["total"], row["best_total"]) == (100, 0, 0, 0)


def test_the_steps_of_ppdf_are_those_of_the_filter():
    scene = jf.scenes.make("forest", size=40, density=3.0, seed=2)
    cloud = ppdf2023.part(scene.cloud, np.ones(len(scene), bool))
    steps, info = ppdf2023.staged(cloud), jf.PPDF.preset("paper", max_rounds=1)(cloud).info
    found = int(steps.under.sum()), steps.planes.accepted, int(steps.seed.sum())
    assert found == (info["under_canopy"], info["planes"], info["seeds"])
    rows = [ppdf2023.plane_row("forest", steps, size) for size in ppdf2023.sizes(steps)]
    assert sum(row["planes"] for row in rows) == steps.planes.accepted
    assert sum(row["area"] for row in rows) == pytest.approx(100)
    assert ppdf2023.coverage(steps, steps.truth)["covered"] == 100


def test_sites_and_threads_of_li_et_al_are_tabled_with_a_fit(tmp_path):
    n = report.cores()
    rows = [
        {"site": site, "points": points, "ground": points // 2, "seconds": points / 1e6}
        | {f"{blocks}_{workers}": points / 5e5 for blocks in ("global", "independent") for workers in (1, n)}
        | {"global_speedup": 1.0, "independent_speedup": 1.5}
        for site, points in (("CSite2", 500_000), ("CSite3", 400_000), ("FSite7", 300_001))
    ]
    options = paper.arguments("li2021", "", ["--out", str(tmp_path)])
    li2021.table3(study := paper.Report("FPTD", "Li et al.", options), rows)
    li2021.verdicts(
        study, [{"method": m} | dict.fromkeys(paper.SCORES + ("seconds",), 1.0) for m in li2021.VARIANTS], rows
    )
    study.write()
    text = (tmp_path / "results.md").read_text()
    assert "27.68" in text and "1.50 times faster" in text
    fit = report.read_csv(tmp_path / "fits.csv")[0]
    assert (fit["who"], fit["slope"], fit["r2"]) == ("measured", pytest.approx(1.0), pytest.approx(1.0))
    assert (tmp_path / "time.png").exists()


def test_the_second_cloud_of_the_bench_is_smaller_but_in_the_same_bucket():
    from jaxfilter.core.compilation import bucket
    from jaxfilter.scenes import make

    cloud = make("benchmark", size=60, density=1, seed=1).cloud
    other = bench_measure.another_of_its_bucket(cloud)
    assert 0 < len(other) < len(cloud) and bucket(len(other)) == bucket(len(cloud))


@pytest.mark.parametrize("operation, peer", [
    ("opening4", "SciPy"), ("minima", "NumPy"), ("minima", "SciPy"), ("membrane", "SciPy"), ("facets", "NumPy"),
    ("planes", "NumPy"),
])  # fmt: skip
def test_the_bench_of_operations_compares_equal_ones(operation, peer, monkeypatch):
    monkeypatch.setattr(bench_ops, "REPEATS", 1)
    found = bench_ops.measured(operation, peer, 0.0016)
    assert found[peer] >= 0 and "differ" not in found


def test_commands_are_timed_in_a_process_of_their_own(tmp_path):
    figures = tmp_path / "figures.json"
    grow = "import sys; b = bytearray(50_000_000); sys.exit(3)"
    timed = ROOT / "experiments" / "bench" / "timed.py"
    subprocess.run([sys.executable, "-S", str(timed), str(figures), sys.executable, "-c", grow], check=True)
    used = json.loads(figures.read_text())
    assert used["code"] == 3 and 0 < used["cpu_seconds"] < 30 and 50e6 < used["peak_bytes"] < 120e6


def test_the_bench_reports_growth_and_the_gain_of_vertex_spacing():
    plain = {
        "name": "fptd",
        "density": 12.0,
        "points": 100,
        "warm_seconds": 2.0,
        "total": 3.0,
        "command_peak_bytes": 1e9,
        "command_seconds": 3.0,
    }
    rows = [
        plain,
        plain | {"points": 500, "warm_seconds": 9.0},
        plain | {"name": "fptd_spaced", "warm_seconds": 1.0, "total": 3.25},
    ]
    text = bench.report(rows, 3)
    assert "5.00 times the points (100 to 500) take 4.50 times as long" in text
    assert "1.00 s instead of 2.00 s; total error 3.25 % instead of 3.00 % (+0.25 points)" in text


def test_profiles_cross_more_of_the_scene_than_patches_and_less_than_points(monkeypatch):
    monkeypatch.setattr(calibration, "SHARE", 0.06)  # profiles much longer than they are wide
    scene = jf.scenes.make("mixed", size=120.0, density=1.5, seed=2)
    cloud = jf.PointCloud.from_arrays(scene.cloud.coordinates(), reference=scene.truth)
    cells = np.floor(cloud.xyz[:, :2] / calibration.WIDTH)
    touched = {
        shape: np.mean(
            [len(np.unique(cells[calibration.draw_labels(cloud, shape, seed)], axis=0)) for seed in range(5)]
        )
        for shape in calibration.SHAPES
    }
    assert 1.3 * touched["patches"] < touched["profiles"] < 0.7 * touched["points"]


@pytest.mark.parametrize("shape", list(calibration.SHAPES))
def test_labels_for_calibration_are_as_many_as_said_and_lie_together_where_said(shape):
    scene = jf.scenes.make("mixed", size=120.0, density=1.5, seed=2)
    cloud = jf.PointCloud.from_arrays(scene.cloud.coordinates(), reference=scene.truth)
    labelled = calibration.draw_labels(cloud, shape, 3)
    each = round(calibration.SHARE * len(cloud) / calibration.PATCHES)
    assert abs(labelled.sum() - calibration.PATCHES * each) <= calibration.PATCHES
    again, other = calibration.draw_labels(cloud, shape, 3), calibration.draw_labels(cloud, shape, 4)
    assert np.array_equal(labelled, again) and not np.array_equal(labelled, other)
    if shape != "patches":
        return
    xy, left, places = cloud.xyz[:, :2].astype(float), labelled.copy(), 0
    while left.any():  # what hangs together within a few spacings is one patch
        patch = np.zeros(len(cloud), bool)
        patch[np.flatnonzero(left)[0]] = True
        for _ in range(60):
            near = ((xy[left][:, None] - xy[patch][None]) ** 2).sum(axis=2).min(axis=1) < 4.0
            patch[np.flatnonzero(left)[near]] = True
        assert scene.truth[patch].any() and not scene.truth[patch].all()
        left &= ~patch
        places += 1
    assert 1 <= places <= calibration.PATCHES


@pytest.mark.slow
def test_speed_of_sweeps_is_measured_on_the_sets_of_the_sweep(tmp_path):
    scene = jf.scenes.make("mixed", size=60.0, density=1.0, seed=2)
    path = tmp_path / "scene.txt"
    np.savetxt(path, np.column_stack([scene.cloud.coordinates(), ~scene.truth]), fmt="%.3f")
    row = sweep_speed.measured(path, "scene", ("MSF", jf.MSF(), {"slope": [0.1, 0.2], "max_height": [3.0, 6.0]}, {}), 1)
    assert row["sets"] == 4 and row["difference"] < 0.01 and row["compiled_warm"] == 0
    assert min(row["seconds"], row["singly"], row["pool"]) > 0
    assert "MSF" in sweep_speed.report([row], [], 1)


@pytest.mark.slow
def test_thresholds_of_fptd_are_chosen_as_in_figs_5_and_6(tmp_path):
    import xarray

    angles, elevations = [2.0, 22.0, 42.0], [0.6, 1.2, 1.4]
    kappa = np.array([[10, 11, 12], [60, 80, 70], [50, 95, 75]], np.float32)
    flat = dict.fromkeys(("type1", "type2", "total"), (("max_angle", "max_elevation"), 100 - kappa))
    grid = xarray.Dataset(
        {"kappa": (("max_angle", "max_elevation"), kappa), **flat},
        coords={"max_angle": angles, "max_elevation": elevations},
    )
    grids = {run: grid.expand_dims(cloud=["samp71"]) for run in li2021.THRESHOLD_RUNS}
    study = paper.Report("FPTD", "Li et al.", paper.arguments("li2021", "", ["--out", str(tmp_path)]))
    li2021.thresholds(study, grids)
    study.write()
    row = report.read_csv(tmp_path / "thresholds.csv")[0]
    assert (row["angle"], row["printed_angle"]) == (42, 22)  # at 1.4 m
    assert (row["elevation"], row["printed_elevation"]) == (1.2, 1.2)  # at the printed angle
    assert (row["kappa"], row["best_kappa"], row["best_angle"], row["best_elevation"]) == (80, 95, 42, 1.2)
    assert (row["printed_kappa"], row["least_total"]) == (90.06, 5)
    assert len(report.read_csv(tmp_path / "thresholds_sets.csv")) == 27
    assert (tmp_path / "fig5.png").exists() and (tmp_path / "fig6.png").exists()


def test_the_sweep_of_fptd_scores_blocks_as_a_run_alone_does():
    from jaxfilter import scenes

    scene = scenes.make("hills", size=(190, 70), density=0.3, seed=1)
    cloud = jf.PointCloud.from_arrays(scene.xyz, reference=scene.truth)
    grids = li2021.sweep_thresholds({"samp52": cloud}, (6, 38), (1.4,))
    here = {"cloud": "samp52", "max_angle": 6, "max_elevation": 1.4}
    found = {run: float(grids[run].kappa.sel(here)) for run in ("global", "independent")}
    alone = jf.evaluate(jf.FPTD(max_angle=6, max_elevation=1.4, blocks="independent")(cloud), cloud.reference)
    assert found["independent"] == pytest.approx(alone.kappa)
    assert found["global"] != pytest.approx(alone.kappa)


def test_type_1_errors_are_counted_by_the_slope_of_the_reference_ground():
    rng = np.random.default_rng(5)
    xy = rng.uniform(0, 60, (4000, 2))
    truth = np.arange(4000) % 4 > 0
    z = np.tan(np.radians(25)) * xy[:, 1] + np.where(truth, 0.0, 8.0)
    cloud = jf.PointCloud.from_arrays(np.column_stack([xy, z]), reference=truth)
    slope = spf2023.terrain_slope(cloud)
    inner = (np.abs(xy - 30) < 22).all(axis=1)
    assert slope[inner] == pytest.approx(25, abs=0.5)

    steep = np.where(np.arange(4000) < 1000, 25.0, 3.0)
    found = truth.copy()
    found[:40] = ~truth[:40]  # 30 ground points lost and 10 objects accepted, all on the slope
    result = SimpleNamespace(ground=found)
    rows = {row["low"]: row for row in spf2023.slope_rows("samp11", "spf", cloud, result, steep)}
    assert [rows[20.0][key] for key in ("ground", "lost", "objects", "accepted")] == [750, 30, 250, 10]
    assert [rows[0.0][key] for key in ("ground", "lost", "objects", "accepted")] == [2250, 0, 750, 0]
    assert rows[45.0]["ground"] == 0


def test_trial_and_error_of_agptd_is_set_against_table_1():
    import xarray

    total = np.array([[4.0, 3.0, 5.0], [2.0, 1.0, 1.05], [6.0, 7.0, 8.0]])
    axes = {"max_angle": [15.0, 35.0, 55.0], "max_distance": [0.4, 0.8, 1.2]}
    dims = ("cloud", *axes)
    scores = {"total": (dims, np.stack([total, total[::-1]])), "kappa": (dims, 100 - np.stack([total, total[::-1]]))}
    grid = xarray.Dataset(scores, coords=axes | {"cloud": ["samp11", "samp54"]})
    rows = [
        agptd2024.trial_row("table1", name, grid.sel(cloud=name), given, at)
        for name, given, at in (("samp11", (39.0, 0.8), 1.5), ("samp54", (15.0, 0.6), 1.0))
    ]
    assert [rows[0][key] for key in ("angle", "distance", "total", "kappa", "cost", "close")] == [
        35,
        0.8,
        1,
        99,
        0.5,
        2,
    ]
    assert (rows[0]["printed_total"], rows[1]["cost"]) == (4.6, 0)
    summary = agptd2024.trial_summary("table1", grid, rows)
    assert (summary["common"], summary["common_angle"], summary["common_distance"]) == (1, 35, 0.8)
    assert (summary["oracle"], summary["near"], summary["angle_off"], summary["worst"]) == (1, 1, 12, 0.5)


@pytest.mark.slow
def test_the_objects_of_the_research_run_are_the_same_in_its_trial_and_error(two_samples):
    cloud = jf.read(samples.sample_path(two_samples, "53"))
    axes = {"max_angle": [29.0], "max_distance": [1.4]}
    swept = agptd2024.sweep_trial("research", {"samp53": cloud}, axes)
    method, left = agptd2024.filters("samp53")["research"], agptd2024.seen("research_three", "samp53", cloud)
    assert float(swept.total.squeeze()) == pytest.approx(jf.evaluate(method(left), cloud.reference).total)
    gone, objects = cloud.candidate & ~left.candidate, (~cloud.reference).sum()
    assert not cloud.reference[gone].any()
    assert 100 * gone.sum() / objects == pytest.approx(34.27, abs=100 / objects)  # printed in Table 3
    assert agptd2024.seen("as_printed", "samp53", cloud) is cloud


def test_constants_are_replaced_by_clearly_better_ones_only():
    """Total error and kappa from counts equal those of the library; a set that is better by chance does not win."""
    from experiments.default import run

    def row(number, cloud, lost):
        counts = {"points": 100, "ground": 60, "lost": lost, "wrong": 5}
        return {"set": str(number), "cloud": cloud, "group": "g", **{k: str(v) for k, v in counts.items()}}

    names = ["samp1", "samp2", "a", "b", "scene a", "scene b"]
    noisy = run.scored(
        [row(0, n, 10) for n in names] + [row(1, n, k) for n, k in zip(names, (0, 19, 1, 18, 2, 17), strict=True)]
    )
    assert run.best(noisy) == "1" and run.clearly_best(noisy) == "0"
    sure = run.scored([row(0, n, 10) for n in names] + [row(1, n, 5) for n in names])
    assert run.clearly_best(sure) == "1"
    truth = np.arange(100) < 60
    found = ((np.arange(100) >= 10) & truth) | (np.arange(100) >= 95)
    scores = jf.evaluate(found, truth)
    assert sure.loc[0, ["total", "kappa"]].tolist() == pytest.approx([scores.total, scores.kappa])


def test_constants_are_varied_where_they_are_read_and_put_back():
    assert len({constant.title for constant in flat.CONSTANTS}) == len(flat.CONSTANTS)
    for constant in flat.CONSTANTS:
        default, value = constant.default, constant.scaled(0.5)
        assert value is not None and value < default and constant.subject in flat.TRIED
        with constant.at(value) as fields:
            assert fields == {constant.place: value} or constant.default == value
        assert constant.default == default
    shared = next(constant for constant in flat.CONSTANTS if constant.title == "water.AFLOAT")
    with shared.at(9.0):
        assert ost.AFLOAT == 9  # it is the one that OST has imported
    share = next(constant for constant in flat.CONSTANTS if constant.title == "objects.KNOWN")
    assert share.scaled(2.0) is None and share.scaled(0.71) == pytest.approx(0.568)


def test_changes_of_means_are_those_of_a_constant_and_kind():
    rows = [
        {"constant": "void", "factor": f, "kind": kind, "cloud": kind, "total": total, "off": 2 * f, "decks": float("nan")}
        for kind in ("samples", "scenes") for f, total in ((0.5, 3.0), (1.0, 4.0), (2.0, 4.5))
    ]  # fmt: skip
    found = flat.moved(rows, next(constant for constant in flat.CONSTANTS if constant.title == "void"))
    assert list(found) == ["samples", "scenes"]
    assert found["samples"] == {0.5: (-1.0, -1.0), 1.0: (0.0, 0.0), 2.0: (0.5, 2.0)}


def test_labels_name_but_some_of_the_ground_if_most_points_on_it_have_others():
    """Of 100 points on a slope every fourth is labelled as ground; 100 points 3 m above it count for nothing."""
    x, y = (v.ravel() for v in np.mgrid[:10, :10])
    slope = np.stack([x, y, 0.3 * x], axis=1)
    cloud = jf.PointCloud.from_arrays(np.concatenate([slope, slope + [0.0, 0.0, 3.0]]).astype(np.float64))
    corners = ((x == 0) | (x == 9)) & ((y == 0) | (y == 9))
    ground = np.append(corners | (np.arange(100) % 4 == 1), np.zeros(100, bool))
    known = clouds.Known("slope", "source", cloud, ground, np.ones(200, bool))
    assert doubt.unnamed(known) == pytest.approx(1 - ground[:100].mean())
    judged = doubt.Judged(known, "tiles", *[np.empty(0)] * 4, doubt.unnamed(known))
    assert not judged.trains and doubt.Judged(known, "tiles", *[np.empty(0)] * 4, 0.4).trains


def test_methods_are_marked_whose_defaults_were_chosen_with_errors_on_the_samples_known():
    """By the table of origins; the search for low clusters is told of all methods together."""
    origins = report.read_csv(ROOT / "experiments/defaults/origins.csv")
    known = {
        method
        for row in origins
        if row["field"] != "low_clusters" and "ISPRS" in str(row["looked_at"])
        for method in str(row["methods"]).split()
    }
    assert set(tables.SHARED) == known
    lines = (line.split("|") for line in (ROOT / "README.md").read_text().splitlines() if line.startswith("| `"))
    figures = {line[1].strip(" `"): line[3:5] for line in lines if len(line) == 8}
    assert known <= set(figures) and all(tables.MARK in cell for name in known for cell in figures[name])


def test_mutations_change_code_and_leave_messages_and_annotations_alone():
    source = """
def f(é: int | None, limit: float = 1.5) -> int | None:
    \"\"\"Not 2.\"\"\"
    if é is None or limit < 2:
        raise ValueError(f"{é + 1} below {limit}")
    return np.where(é >= 0, abs(é) - 1, -é)
"""
    found = [some for place in mutations.places(source, "f.py") for some in place]
    changed = {(some.kind, some.before, some.after) for some in found}
    assert {
        ("constant", "1.5", "3.0"),
        ("and, or", "é is None or limit < 2", "(é is None and limit < 2)"),
        ("comparison", "limit < 2", "(limit >= 2)"),
        ("statement removed", 'raise ValueError(f"{é + 1} below {limit}")', "pass"),
        ("arguments swapped", "np.where(é >= 0, abs(é) - 1, -é)", "(np.where(é >= 0, -é, abs(é) - 1))"),
        ("call dropped", "abs(é)", "(é)"),
        ("operator", "abs(é) - 1", "(abs(é) + 1)"),
    } <= changed
    for some in found:
        code = some.apply(source.encode()).decode()
        assert compile(code, "f.py", "exec") and code != source
        assert "Not 2." in code and "é: int | None" in code and some.first <= some.line <= 6
    assert not any(some.before == "é + 1" for some in found)


def test_pages_of_results_say_whether_they_are_of_the_labels_of_the_code():
    text = remake.README.read_text()
    assert text == remake.listed(text), "run python experiments/remake.py --list"
    for name, page in remake.PAGES.items():
        script = page.command.removeprefix("-m ").split()[0]
        script = script if script.endswith(".py") else script.replace(".", "/") + ".py"
        assert (ROOT / script).exists() and name.startswith(script.split("/")[1]), name


def test_quoted_figures_are_those_of_the_results():
    for path in quoted.pages():
        assert path.read_text() == quoted.filled(path.read_text()), f"{path}: run python experiments/quoted.py"
    page = ROOT / "docs" / "results" / "README.md"
    assert page.read_text() == report_page.page(ROOT / "experiments", "../../experiments"), (
        "run experiments/report_page.py"
    )


def test_a_figure_is_the_mean_of_a_column_over_the_rows_asked_for():
    rows = report.read_csv(ROOT / "experiments" / "isprs" / "results" / "fixed.csv")
    mean = {m: statistics.fmean(row["total"] for row in rows if row["method"] == m) for m in ("smrf", "ptd")}
    found = quoted.filled("a <!-- = isprs/fixed.csv method=smrf total .3f -->0<!-- / --> b <!-- / -->")
    assert found == f"a <!-- = isprs/fixed.csv method=smrf total .3f -->{mean['smrf']:.3f}<!-- / --> b <!-- / -->"
    assert quoted.quoted("isprs/fixed.csv method=smrf total - isprs/fixed.csv method=ptd total +.2f") == (
        f"{mean['smrf'] - mean['ptd']:+.2f}"
    )
    for wrong in ("method=none total", "method=smrf sample"):
        with pytest.raises(ValueError, match=r"no (such row|number)"):
            quoted.quoted(f"isprs/fixed.csv {wrong} .1f")


@pytest.fixture
def two_pages(tmp_path, monkeypatch):
    """A folder in place of that of the experiments, with a page and one on SMRF that reads it; the labels are made up."""
    script = tmp_path / "script.py"
    script.write_text(f"""
import sys
from pathlib import Path

sys.path.insert(0, {str(ROOT)!r})
from experiments import labels
from experiments.report import write_page

labels.counts = lambda name: "1 2 3"
if "fail" in sys.argv:
    sys.exit("no")
place = Path({str(tmp_path)!r}, "one", "results", sys.argv[1])
write_page(place, "# A title\\n\\nText.", f"python {{' '.join(sys.argv)}}", sys.argv[2:])
""")
    (tmp_path / "one" / "results").mkdir(parents=True)
    readme = tmp_path / "README.md"
    readme.write_text(f"before {remake.START} old {remake.END} after")
    monkeypatch.setattr(remake, "HERE", tmp_path)
    monkeypatch.setattr(remake, "README", readme)
    monkeypatch.setattr(remake, "TIMES", tmp_path / "out" / "begun.json")
    one, two = "one/results/one.md", "one/results/two.md"
    pages = {
        two: remake.Page(f"{script} two.md smrf", "two", 1, (one,)),
        one: remake.Page(f"{script} one.md", "one", 2),
    }
    monkeypatch.setattr(remake, "PAGES", pages)
    monkeypatch.setattr(report_page, "main", lambda _: None)
    monkeypatch.setattr(quoted, "main", lambda _: None)
    monkeypatch.setattr(labels, "counts", {"smrf": "1 2 3"}.__getitem__)
    handler = signal.getsignal(signal.SIGTERM)
    yield tmp_path
    signal.signal(signal.SIGTERM, handler)


@pytest.mark.slow
def test_stale_pages_are_made_once_after_those_that_they_read(two_pages, monkeypatch, capsys):
    one, two = two_pages / "one" / "results" / "one.md", two_pages / "one" / "results" / "two.md"
    assert [name for _, name, _ in remake.plan([])] == ["one/results/one.md", "one/results/two.md"]
    assert remake.main(["--budget", "1.5"]) == 0 and not one.exists() and not two.exists()
    assert remake.main(["--only", "one.md"]) == 0
    made = report.made(one)
    assert made.labels == {} and made.command == f"python {two_pages / 'script.py'} one.md"
    assert one.read_text().splitlines()[0] == "# A title" and 0 < made.seconds < 60
    text = remake.README.read_text()
    assert text.startswith("before ") and text.endswith(" after") and "1 of 2 pages are stale" in text
    assert remake.main([]) == 0
    assert report.made(two).labels == {"smrf": "1 2 3"} and not list(remake.plan([]))
    monkeypatch.setattr(labels, "counts", {"smrf": "1 2 4"}.__getitem__)
    assert remake.stale("one/results/two.md", remake.PAGES["one/results/two.md"]) == "of other labels: smrf"
    assert [name for _, name, _ in remake.plan([])] == ["one/results/two.md"]
    assert "**stale**, of other labels: smrf" in remake.listed(text)
    two.write_text(two.read_text().replace("two.md smrf`", "two.md`"))
    assert remake.stale("one/results/two.md", remake.PAGES["one/results/two.md"]) == "of another command"


def test_a_driver_that_is_interrupted_says_so_and_counts_the_time(two_pages, monkeypatch):
    class Process:
        def __init__(self, *_, **__):
            self.waits = 0

        def wait(self):
            self.waits += 1
            if self.waits == 1:
                raise KeyboardInterrupt

        def terminate(self):
            pass

    monkeypatch.setattr(remake.subprocess, "Popen", Process)
    clock = iter(range(1000, 2000, 7))
    monkeypatch.setattr(remake.time, "time", lambda: float(next(clock)))
    assert remake.main(["--only", "one.md"]) == 130
    assert signal.getsignal(signal.SIGTERM) is signal.default_int_handler  # even where Ctrl-C is ignored
    spent = json.loads(remake.TIMES.read_text())["one/results/one.md"]["spent"]
    assert spent > 0 and "2 of 2 pages are stale" in remake.README.read_text()
    monkeypatch.undo()


def test_a_page_that_could_not_be_made_stays_stale(two_pages, monkeypatch, capsys):
    broken = remake.Page(f"{two_pages / 'script.py'} fail", "one", 2)
    monkeypatch.setitem(remake.PAGES, "one/results/one.md", broken)
    assert remake.main([]) == 1
    said = capsys.readouterr().out
    assert "exit code 1; it is stale: not made yet" in said and "one/results/two.md is left" in said


@pytest.mark.slow
def test_rows_of_other_labels_are_not_kept(tmp_path, two_samples, monkeypatch):
    given = [
        "--data",
        str(two_samples),
        "--out",
        str(tmp_path),
        "--samples",
        "53",
        "--methods",
        "smrf",
        "--budget",
        "2",
    ]
    given += ["--processes", "1", "--repeats", "1", "--no-figures"]
    isprs.main(given)
    first = report.read_csv(tmp_path / "search" / "smrf.csv")
    monkeypatch.setattr(labels, "word", lambda name: "l0")
    ran = []
    evaluate = search.evaluate
    monkeypatch.setattr(search, "evaluate", lambda *task: ran.append(len(task[3])) or evaluate(*task))
    isprs.main(given)
    again = report.read_csv(tmp_path / "search" / "smrf.csv")
    assert ran == [2] and [row | {"parameters": ""} for row in again] == [row | {"parameters": ""} for row in first]
    assert {row["parameters"].partition("-")[2] for row in again} == {"l0"}
    assert len(report.read_csv(tmp_path / "search" / "timed.csv")) == 1


def test_labels_are_counted_on_clouds_that_tell_methods_apart():
    found = {name: labels.counts(name) for name in ("smrf", "ptd", "csf")}
    assert len(set(found.values())) == 3
    cloud = labels.clouds()[0]
    assert found["smrf"].split()[0] == str(int(jf.SMRF.for_cloud(cloud)(cloud).ground.sum()))


@pytest.mark.slow
def test_a_benchmark_of_a_folder_has_every_method_on_every_cloud(two_samples, tmp_path, monkeypatch):
    given = [str(two_samples / "isprs"), "--out", str(tmp_path), "--methods", "smrf", "pmf", "--repeats", "0"]
    with pytest.warns(jf.JaxfilterWarning, match="2 clouds cannot give p below"):
        benchmark.main(given)
    rows = report.read_csv(tmp_path / "runs.csv")
    assert {(row["method"], row["cloud"]) for row in rows} == {
        (m, c) for m in ("SMRF", "PMF") for c in ("samp52", "samp53")
    }
    page, cloud = (tmp_path / "results.md").read_text(), jf.read(two_samples / "isprs" / "samp53.txt")
    total = jf.evaluate(jf.SMRF.for_cloud(cloud)(cloud), cloud).total
    assert next(row["total"] for row in rows if (row["method"], row["cloud"]) == ("SMRF", "samp53")) == pytest.approx(
        total
    )
    assert f"{total:.2f}" in page and "Kappa, %" in page and (tmp_path / "totals.png").stat().st_size > 1000
    assert (tmp_path / "tables.tex").read_text().count(r"\toprule") == 5
    monkeypatch.setenv("JAXFILTER_DATA", str(two_samples))
    with pytest.raises(SystemExit, match="holds no file"):
        benchmark.main([str(tmp_path / "cache"), "--out", str(tmp_path)])


@pytest.mark.slow
def test_fits_leave_each_site_out_and_go_on_where_they_were(two_samples, tmp_path, monkeypatch):
    folder = tmp_path / "data" / "isprs"
    folder.mkdir(parents=True)
    for name, of in (("samp11", "samp52"), ("samp21", "samp53"), ("samp31", "samp53")):
        (folder / f"{name}.txt").write_bytes((two_samples / "isprs" / f"{of}.txt").read_bytes())
    monkeypatch.setattr(fits, "SETS", {"smrf": {"calibrate": 4, "random": 4}})
    given = ["--data", str(folder.parent), "--out", str(tmp_path), "--samples", "11", "21", "31"]
    fits.main([*given, "--methods", "smrf", "--steps", "2"])
    rows = report.read_csv(tmp_path / "runs.csv")
    assert [row["way"] for row in rows] == 3 * list(fits.WAYS)
    cloud = jf.read(folder / "samp21.txt")
    start = next(row for row in rows if (row["sample"], row["way"]) == ("samp21", "start"))
    assert start["total"] == pytest.approx(jf.evaluate(jf.SMRF()(cloud), cloud).total)
    monkeypatch.setattr(jf, "fit", None)
    fits.main([*given, "--methods", "smrf"])
    assert report.read_csv(tmp_path / "runs.csv") == rows
