"""Three hundred of the damaged files of ``experiments/fuzz``: refused, or labelled into a file that reads back equal."""

from __future__ import annotations

import logging
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import jaxfilter as jf
from experiments.fuzz import check, compressed, mutations
from experiments.fuzz import run as fuzz

SEED = 7


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    logging.disable(logging.ERROR)  # laspy logs what it also raises
    yield mutations.seeds(tmp_path_factory.mktemp("seeds"))
    logging.disable(logging.NOTSET)


def test_sound_files_are_read_and_come_back(tmp_path, found):
    for number, seed in enumerate(found):
        path = tmp_path / f"in{seed.suffix}"
        path.write_bytes(seed.content)
        outcome, detail = check.outcome(path, 2 * number + 1)
        assert outcome == check.EQUAL or "scanner channels" in detail, (seed.name, detail)


@pytest.mark.parametrize("group, numbers", [("binary", range(200)), ("text", range(100))])
def test_damaged_files(tmp_path, found, group, numbers):
    few = fuzz.of_group(found, group)
    outcomes = []
    for number in numbers:
        origin, done, content = mutations.mutant(few, SEED, number)
        path = tmp_path / f"in{origin.suffix}"
        path.write_bytes(content)
        try:
            outcomes.append(check.outcome(path, number, filtered=number % 100 == 51)[0])
        except Exception as error:
            raise AssertionError(f"{group} {number}: {origin.name}, {done}") from error
    assert min(outcomes.count(check.REFUSED), outcomes.count(check.EQUAL)) > 0.1 * len(numbers)


def test_damaged_layers_tables_and_laszip_records(tmp_path):
    """Refused, or with the points of the sound file; where layers exchange bytes, LASzip has to judge."""
    few, path, refused = [one for one in compressed.seeds(tmp_path) if one.kind != "LASzip"], tmp_path / "in.laz", 0
    sound = {}
    for one in few:
        path.write_bytes(compressed.Laz.of(one.content).bytes())
        sound[one.name] = compressed.ours(path)
    for number in range(150):
        origin, act, content = compressed.mutant(few, SEED, number)
        path.write_bytes(content)
        records = compressed.ours(path)
        refused += isinstance(records, str)
        assert isinstance(records, str) or np.array_equal(records, sound[origin.name]) or act == "layers", (number, act)
    assert 75 < refused < 150


@pytest.mark.slow
def test_the_experiment_with_laszip_runs(tmp_path, monkeypatch):
    pytest.importorskip("laszip", reason="laszip is not installed: nothing to compare with")
    monkeypatch.setattr(sys, "argv", ["compressed.py", "--out", str(tmp_path), "--number", "20"])
    compressed.main()
    assert "20 files, seed 20265" in (text := (tmp_path / "compressed.md").read_text()) and "Failures: 0" in text


def test_mutants_are_those_of_their_number(found):
    for group in ("binary", "text"):
        few = fuzz.of_group(found, group)
        ones, others = ([mutations.mutant(few, SEED, n)[1:] for n in range(30)] for _ in range(2))
        assert ones == others and len({content for _, content in ones}) > 25


def test_the_check_sees_what_is_wrong(tmp_path, found, monkeypatch):
    """Readers that change a coordinate, a class, a number of points, or raise something else."""
    seed = next(one for one in found if one.name == "6-4.las")
    path = tmp_path / "in.las"
    path.write_bytes(seed.content)
    sound = jf.read

    def damaged(field, change):
        def read(source, **options):
            cloud = sound(source, **options)
            values = getattr(cloud, field).copy()
            object.__setattr__(cloud, field, change(values))
            return cloud

        return read

    def shift(values):
        values[3] += 1
        return values

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for field, change in (
            ("xyz", shift),
            ("classification", shift),
            ("xyz", lambda v: v * np.inf),
            ("withheld", lambda v: v[1:]),
        ):
            monkeypatch.setattr(jf, "read", damaged(field, change))
            with pytest.raises(check.Wrong):
                check.outcome(path, 1)
        monkeypatch.setattr(jf, "read", lambda *_, **__: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            check.outcome(path, 1)
        monkeypatch.setattr(jf, "read", sound)
        for write in (
            lambda target, *_: target.write_bytes(seed.content[:-9]),
            lambda target, *_: target.write_bytes(seed.content),
        ):
            monkeypatch.setattr(jf, "write", write)
            with pytest.raises(check.Wrong):
                check.outcome(path, 1)


@pytest.mark.slow
def test_the_experiment_runs(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["run.py", "--out", str(tmp_path), "--number", "6", "--groups", "binary"])
    fuzz.main()
    text = (tmp_path / "results.md").read_text()
    assert "6 files, seeds 20260" in text and "Failures: 0" in text
    assert len((tmp_path / "files.csv").read_text().splitlines()) == 7
