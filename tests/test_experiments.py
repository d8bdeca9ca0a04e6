"""The experiments: published figures are consistent, protocols are fair, pages and quoted figures are those of the code."""

import re
import statistics
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import jaxfilter as jf  # noqa: E402
from experiments import remake, report  # noqa: E402
from experiments.ablations import run as ablations  # noqa: E402
from experiments.benchmark import run as benchmark  # noqa: E402
from experiments.isprs import protocols, samples, search, spaces, tables  # noqa: E402
from experiments.isprs import run as isprs  # noqa: E402
from experiments.papers import li2021, paper  # noqa: E402
from experiments.scenes import clouds as sites  # noqa: E402
from experiments.scenes import measures  # noqa: E402
from experiments.scenes import run as scenes  # noqa: E402
from jaxfilter.sweeps.ranges import search_ranges  # noqa: E402


@pytest.mark.parametrize("name, columns", [
    ("li2021_table4", "total kappa seconds"), ("chen2023_table2", "type1 type2 total"),
    ("zheng2024_table6", "type1 type2 total kappa"),
])  # fmt: skip
def test_averages_that_a_paper_prints_are_those_of_its_rows(name, columns):
    table = samples.published(name)
    for printed in (row for row in table if row["sample"] == "average"):
        rows = [row for row in table if row["method"] == printed["method"] and row["sample"].startswith("samp")]
        assert [row["sample"] for row in rows] == [f"samp{number}" for number in samples.SAMPLES]
        for key in columns.split():
            assert statistics.fmean(row[key] for row in rows) == pytest.approx(printed[key], abs=0.011)


def test_means_of_smrf_are_those_that_its_paper_prints():
    for key, printed, off in (
        ("kappa_oracle", 90.02, 0.005),
        ("total_oracle", 2.97, 0.005),
        ("kappa_fixed", 85.4, 0.05),
    ):
        assert statistics.fmean(row[key] for row in samples.published("pingel2013")) == pytest.approx(printed, abs=off)


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


@pytest.mark.parametrize("method", spaces.method_names())
def test_every_method_is_tried_with_as_many_sets_all_of_which_it_takes(method):
    ranges, sets = search_ranges(jf.FILTERS[method]), spaces.sets(method, 32)
    assert sets[0] == {} and sets[:8] == spaces.sets(method, 8) and len({tuple(s.values()) for s in sets}) == 32
    for thresholds in sets[1:]:
        assert thresholds.keys() == ranges.keys()
        assert all(r.low * 0.999 <= thresholds[name] <= r.high * 1.001 for name, r in ranges.items())
        spaces.fixed(method, "samp51").replace(**thresholds)


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
    assert protocols.class_choice({"samp53": {0: 1.0, 1: 2.0}}, terrain) == {"samp53": 0}  # alone in its class


def test_a_set_that_failed_is_never_chosen():
    failed = {"sample": "samp52", "set": 0, "status": "ParameterError: no"} | dict.fromkeys(search.COUNTS, "")
    good = failed | {"set": 1, "status": "CONVERGED"} | dict.fromkeys(search.COUNTS, 5)
    assert protocols.oracle_choice(protocols.kappa_table([failed, good])) == {"samp52": 1}


def test_pooled_figures_are_those_of_all_points_together():
    counts = [dict(zip(search.COUNTS, values, strict=True)) for values in ((90, 10, 0, 0), (0, 0, 30, 870))]
    rows = [{"method": "ptd", "seconds": 0.5} | c | protocols.scores(c) | {"kappa": 0.0} for c in counts]
    line = protocols.summary(rows)
    assert (line["pooled_type1"], line["pooled_type2"], line["pooled_total"]) == pytest.approx((10.0, 30 / 9, 4.0))
    assert line["seconds_per_million"] == pytest.approx(1000.0)


@pytest.mark.parametrize(("gains", "verdict"), [
    ([4, 1, -1], "tendency"), ([4, 5, 6, 7, 8, 9, 10, -1], "confirmed"), ([8, -1, -1], "mixed"), ([-1, 1, 1], "tendency"),
    ([-4, -1, 1], "refuted"), ([0, 0], "refuted"),
])  # fmt: skip
def test_claims_are_judged_by_mean_number_of_samples_and_chance(gains, verdict):
    found = protocols.compare([(50.0, 50.0 - gain) for gain in gains], larger_is_better=False)
    assert found["verdict"] == verdict
    assert found == found | {"better": sum(g > 0 for g in gains), "worse": sum(g < 0 for g in gains)}
    if verdict == "confirmed":
        assert found["p"] == pytest.approx(4 / 256)  # by counting the signed ranks
    assert protocols.compare([(50.0, 50.0 + gain) for gain in gains], larger_is_better=True)["verdict"] == verdict


@pytest.mark.parametrize(
    ("first", "second", "holds"), [([1, 2], [3, 4], True), ([3, 4], [1, 2], False), ([1, 3], [2, 4], None)]
)
def test_a_difference_of_repeated_figures_is_decided_only_where_they_do_not_overlap(first, second, holds):
    assert paper.all_less(first, second) is holds


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
    folder = tmp_path_factory.mktemp("data")
    (folder / "isprs").mkdir()
    for number, seed in (("52", 2), ("53", 3)):
        scene = jf.scenes.make("town", size=(64, 60), density=0.8, seed=seed)
        last = scene.cloud.candidate
        table = np.column_stack([scene.xyz[last], ~scene.truth[last]])
        np.savetxt(folder / "isprs" / f"samp{number}.txt", table, fmt=["%.2f"] * 3 + ["%d"])
    return folder


@pytest.mark.slow
def test_a_run_on_generated_scenes_writes_every_table_and_goes_on_where_it_was(two_samples, tmp_path, monkeypatch):
    out = tmp_path / "results"
    given = ["--data", str(two_samples), "--out", str(out), "--samples", "52", "53", "--methods", "ptd", "fptd", "smrf"]
    given += ["--budget", "3", "--processes", "1", "--repeats", "1", "--dpi", "40"]
    isprs.main(given)
    table = {name: report.read_csv(out / f"{name}.csv") for name in ("fixed", "class", "oracle")}
    kappa = {name: {(r["sample"], r["method"]): r["kappa"] for r in rows} for name, rows in table.items()}
    assert all(len(rows) == 6 for rows in table.values())
    for key, value in kappa["oracle"].items():
        assert value >= kappa["class"][key] and value >= kappa["fixed"][key] - 1e-9
    runs = {(r["sample"], r["set"]): protocols.scores(r)["kappa"] for r in report.read_csv(out / "search" / "fptd.csv")}
    assert len(runs) == 6 and kappa["fixed"]["samp52", "fptd"] == pytest.approx(runs["samp52", 0])
    chosen = {r["sample"]: r["set"] for r in table["class"] if r["method"] == "fptd"}
    assert runs["samp53", chosen["samp52"]] == max(runs["samp53", i] for i in range(3))
    assert all(f"## {name} protocol" in (out / "results.md").read_text() for name in ("Fixed", "Class", "Oracle"))

    path, tasks = out / "search" / "smrf.csv", []
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    monkeypatch.setattr(search, "evaluate", lambda *task: tasks.append(task) or [])
    isprs.main([*given, "--no-figures", "--protocols", "oracle"])
    assert [(method, sample, list(sets)) for method, sample, _, sets in tasks] == [("smrf", "samp53", [2])]
    monkeypatch.setattr(search, "word", lambda name: "l0")  # rows of other labels are not kept
    search.run(out / "search", two_samples, ["ptd"], ["52", "53"], 3, 1)
    assert [(method, sample, list(sets)) for method, sample, _, sets in tasks[1:]] == [
        ("ptd", name, [0, 1, 2]) for name in ("samp52", "samp53")
    ]


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
    assert "39.99" in (tmp_path / "out" / "results.md").read_text()  # printed kappa of FPTD on sample 53
    assert report.read_csv(tmp_path / "out" / "seeds.csv")[0]["printed_seeds"] == 841
    assert len(report.read_csv(tmp_path / "out" / "table1.csv")) == 23


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


def test_pages_have_the_table_and_the_figures_of_the_results():
    for path, text in remake.texts().items():
        assert path.read_text() == text, f"{path}: run python experiments/remake.py --list"
    for name, page in remake.listed().items():
        script = page.command.removeprefix("-m ").split()[0]
        script = script if script.endswith(".py") else script.replace(".", "/") + ".py"
        assert (ROOT / script).exists() and name.startswith(script.split("/")[1]), name


def test_a_figure_is_the_mean_of_a_column_over_the_rows_asked_for():
    rows = report.read_csv(ROOT / "experiments" / "isprs" / "results" / "fixed.csv")
    mean = {m: statistics.fmean(row["total"] for row in rows if row["method"] == m) for m in ("smrf", "ptd")}
    assert remake.quoted("isprs/fixed.csv method=smrf total .3f") == f"{mean['smrf']:.3f}"
    difference = "isprs/fixed.csv method=smrf total - isprs/fixed.csv method=ptd total +.2f"
    assert remake.quoted(difference) == f"{mean['smrf'] - mean['ptd']:+.2f}"
    for wrong in ("isprs/fixed.csv method=a total", "isprs/fixed.csv method=smrf sample", "table isprs/results.md No"):
        with pytest.raises(ValueError, match=r"no (such row|number|table)"):
            remake.quoted(wrong)


@pytest.fixture
def two_pages(tmp_path, monkeypatch):
    """A folder in place of that of the experiments, with two pages, of which the one on SMRF reads the other."""
    (tmp_path / "here" / "one" / "results").mkdir(parents=True)
    (tmp_path / "README.md").write_text("it is <!-- = one/rows.csv name=a value .1f -->0.0<!-- / -->")
    (tmp_path / "here" / "README.md").write_text(f"before {remake.START} old {remake.END} after")
    (tmp_path / "here" / "one" / "results" / "rows.csv").write_text("name,value\na,2.5\n")
    one, two = "one/results/one.md", "one/results/two.md"
    pages = {
        two: remake.Page(f"script.py {two} smrf", "two", 1, (one,)),
        one: remake.Page(f"script.py {one}", "one", 2),
    }

    def run(command, **_):
        place, *methods = command[3 : command.index("--out")]
        assert command[-1] == "here/one/results"
        report.write_page(tmp_path / "here" / place, "# A title\n\nText.", " ".join(["python", *command[2:]]), methods)
        return SimpleNamespace(returncode=0)

    monkeypatch.setattr(remake, "HERE", tmp_path / "here")
    monkeypatch.setattr(remake, "listed", lambda: pages)
    monkeypatch.setattr(remake, "counts", {"smrf": "1 2 3"}.__getitem__)
    monkeypatch.setattr(remake, "subprocess", SimpleNamespace(run=run, STDOUT=None))
    return tmp_path / "here", pages


def test_stale_pages_are_made_once_after_those_that_they_read(two_pages, monkeypatch, capsys):
    (here, pages), (two, one) = two_pages, two_pages[1]
    assert remake.main(["--only", "two.md"]) == 0 and not (here / two).exists()  # what it reads is not there
    assert remake.main([]) == 0
    made = [line.split(":")[0] for line in capsys.readouterr().out.splitlines() if "exit code" in line]
    assert made == [one, two] and not any(remake.stale(*page) for page in pages.items())
    assert (
        (here / one).read_text().startswith("# A title\n\n`python script.py one/results/one.md --out here/one/results`")
    )
    assert report.made(here / two).labels == {"smrf": "1 2 3"}
    assert "it is <!-- = one/rows.csv name=a value .1f -->2.5<!-- / -->" in (here.parent / "README.md").read_text()
    monkeypatch.setattr(remake, "counts", {"smrf": "1 2 4"}.__getitem__)
    assert remake.main(["--list"]) == 0 and "**stale**, of other labels: smrf" in (here / "README.md").read_text()
    monkeypatch.setitem(pages, one, remake.Page("script.py --other", "one", 2))
    assert remake.stale(one, pages[one]) == "of another command"


def test_a_page_that_could_not_be_made_stays_stale(two_pages, monkeypatch, capsys):
    here, pages = two_pages
    monkeypatch.setattr(remake.subprocess, "run", lambda *_, **__: SimpleNamespace(returncode=1))
    assert remake.main([]) == 1 and "exit code 1, it is stale, never made" in capsys.readouterr().out
    assert "2 pages are stale" in (here / "README.md").read_text() and not any((here / name).exists() for name in pages)


def test_labels_are_counted_on_clouds_that_tell_methods_apart():
    found = {name: remake.counts(name) for name in ("smrf", "ptd", "csf")}
    assert len(set(found.values())) == 3
    cloud = remake.clouds()[0]
    assert found["smrf"].split()[0] == str(int(jf.SMRF.for_cloud(cloud)(cloud).ground.sum()))


def test_the_list_of_tables_and_figures_names_headings_of_the_pages():
    folder = Path(report.__file__).parent / "papers"
    papers = re.split(r"^## ", (folder / "figures.md").read_text(), flags=re.MULTILINE)[1:]
    assert len(papers) == 5
    for text in papers:
        (page,) = re.findall(r"\[results\]\((.+?)\)", text)
        headings = re.findall(r"^## (.+)$", (folder / page).read_text(), re.MULTILINE)
        named = re.findall(r'"([^"]+)"', text)
        assert len(named) > 5 and not set(named) - set(headings), page


@pytest.mark.slow
def test_a_benchmark_of_a_folder_has_every_method_on_every_cloud(two_samples, tmp_path):
    given = [str(two_samples / "isprs"), "--out", str(tmp_path), "--methods", "smrf", "pmf", "--repeats", "0"]
    with pytest.warns(jf.JaxfilterWarning, match="2 clouds cannot give p below"):
        benchmark.main(given)
    found = {(row["method"], row["cloud"]): row["total"] for row in report.read_csv(tmp_path / "runs.csv")}
    assert set(found) == {(method, cloud) for method in ("SMRF", "PMF") for cloud in ("samp52", "samp53")}
    cloud = jf.read(two_samples / "isprs" / "samp53.txt")
    total = jf.evaluate(jf.SMRF.for_cloud(cloud)(cloud), cloud).total
    assert found["SMRF", "samp53"] == pytest.approx(total) and f"{total:.2f}" in (tmp_path / "results.md").read_text()
