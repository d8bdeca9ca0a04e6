"""The experiments: published figures are consistent, tables come out right, and a small run works from end to end."""

import json
import statistics
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from experiments import report  # noqa: E402
from experiments.bench import measure as bench_measure  # noqa: E402
from experiments.bench import run as bench  # noqa: E402
from experiments.isprs import run as isprs  # noqa: E402
from experiments.isprs import samples, tables  # noqa: E402


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


def test_published_errors_agree_with_the_numbers_of_ground_and_object_points():
    ground = {"samp11": 21786, "samp31": 15556, "samp53": 32989}  # Sithole and Vosselman's samples
    for row in samples.published("li2021_table4"):
        if row["sample"] in ground:
            lost = row["type1"] * ground[row["sample"]]
            accepted = row["type2"] * (row["points"] - ground[row["sample"]])
            assert (lost + accepted) / row["points"] == pytest.approx(row["total"], abs=0.02)


def test_every_sample_and_site_has_a_terrain_class_with_the_thresholds_of_its_preset():
    import jaxfilter as jf

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
    row = {
        "sample": "samp24",
        "method": "fptd",
        "terrain": "D3",
        "points": 7492,
        "type1": 1.0,
        "type2": 2.0,
        "total": 3.0,
        "kappa": 90.0,
        "seconds": 0.1,
    }
    line = tables.per_sample([row], "fptd").splitlines()[2]
    assert line == "| samp24 | D3 | 7,492 | 1.00 | 2.00 | 3.00 | 90.00 | 0.100 | 21.79 | 6.95 | 17.71 | 61.59 | 2.31 |"
    assert "smrf" not in tables.summary([row])


def test_time_fit_recovers_a_line():
    slope, intercept, r2 = tables.time_fit([1e5, 5e5, 1e6], [1.2, 2.0, 3.0])
    assert (slope, intercept, r2) == pytest.approx((2.0, 1.0, 1.0))


def test_missing_data_are_reported_with_where_to_get_them(tmp_path):
    with pytest.raises(SystemExit, match=r"Sithole(.|\n)*JAXFILTER_DATA"):
        isprs.main(["--data", str(tmp_path), "--out", str(tmp_path / "out")])


def test_a_quick_run_on_a_generated_scene_writes_tables_and_scores(tmp_path, monkeypatch):
    from jaxfilter import scenes

    monkeypatch.setenv("JAXFILTER_CACHE", str(tmp_path / "cache"))
    scene = scenes.make("town", size=(70, 60), density=0.8, seed=2)
    last = scene.cloud.candidate
    (tmp_path / "isprs").mkdir()
    label = (~scene.truth[last]).astype(int)
    np.savetxt(tmp_path / "isprs" / "samp24.txt", np.column_stack([scene.xyz[last], label]), fmt=["%.2f"] * 3 + ["%d"])
    isprs.main(
        [
            "--data",
            str(tmp_path),
            "--out",
            str(tmp_path / "out"),
            "--quick",
            "--samples",
            "s24",
            "--methods",
            "fptd",
            "ptd",
        ]
    )
    rows = {row["method"]: row for row in report.read_csv(tmp_path / "out" / "samples.csv")}
    assert rows["fptd"]["points"] == last.sum() and rows["fptd"]["total"] < 15
    assert rows["fptd"]["status"] == "CONVERGED" and rows["fptd"]["seeds"] >= rows["ptd"]["seeds"]
    outliers = report.read_csv(tmp_path / "out" / "outliers.csv")[0]
    assert outliers["barred_ground_kept"] <= outliers["barred_ground"] <= outliers["barred"]
    text = (tmp_path / "out" / "results.md").read_text()
    assert "## FPTD" in text and "17.71" in text
    assert (tmp_path / "out" / "figures" / "samp24.png").read_bytes().startswith(b"\x89PNG")


def test_the_second_cloud_of_the_bench_is_smaller_but_in_the_same_bucket():
    from jaxfilter.core.compilation import bucket
    from jaxfilter.scenes import make

    cloud = make("benchmark", size=60, density=1, seed=1).cloud
    other = bench_measure.another_of_its_bucket(cloud)
    assert 0 < len(other) < len(cloud) and bucket(len(other)) == bucket(len(cloud))


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
    text = bench.report(rows, "python run.py", 3)
    assert "5.00 times the points (100 to 500) take 4.50 times as long" in text
    assert "1.00 s instead of 2.00 s; total error 3.25 % instead of 3.00 % (+0.25 points)" in text
