"""Labelled clouds by name, and folders of them."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import jaxfilter as jf
from jaxfilter.scoring import reference_labels


@pytest.fixture(scope="module")
def place(town, tmp_path_factory):
    """A data folder: set/train/a.laz, set/test/b.laz with classes, and isprs/samp99.txt with labels."""
    root = tmp_path_factory.mktemp("data")
    (root / "isprs").mkdir()
    for part in ("set/train", "set/test"):
        (root / part).mkdir(parents=True)
    classes = np.where(town.truth, 2, 6).astype(np.uint8)
    classes[:4] = 8, 9, 7, 0
    cloud = dataclasses.replace(town.cloud, classification=classes)
    for name in ("set/train/a.laz", "set/test/b.laz"):
        jf.write(root / name, cloud, None)
    text = np.column_stack([cloud.coordinates()[:50], ~town.truth[:50]])
    np.savetxt(root / "isprs" / "samp99.txt", text, fmt="%.2f %.2f %.2f %d")
    return root, classes


def test_a_folder_is_read_when_it_is_used_and_classes_say_what_is_scored(place):
    root, classes = place
    data = jf.datasets.folder(
        root / "set", ground=[2, 8], ignore=[7, 9], reading=jf.Reading(units="m", ignore_classes=[7])
    )
    assert list(data) == ["test/b", "train/a"] and len(data) == 2
    cloud = data["train/a"]
    assert (cloud.reference == np.isin(classes, (2, 8))).all()
    assert np.flatnonzero(~cloud.candidate & (classes == 9)).size == 0  # water is judged, but not scored
    scores = jf.evaluate(np.ones(len(cloud), bool), cloud)
    assert scores.confusion.sum() == np.isin(classes, (2, 6, 8)).sum()
    assert list(data.split("train")) == ["train/a"]
    (root / "set" / "test" / "broken.laz").write_bytes(b"no cloud")
    again = jf.datasets.folder(root / "set", splits={"mine": ["train/*", "test/b"]})
    assert list(again.split("mine")) == ["train/a", "test/b"] or list(again.split("mine")) == ["test/b", "train/a"]
    with pytest.raises(jf.InputError, match=r"broken\.laz"):
        _ = again["test/broken"]
    with pytest.raises(jf.InputError, match=r"split\('no'\): there are mine"):
        again.split("no")
    (root / "set" / "test" / "broken.laz").unlink()
    with pytest.raises(jf.InputError, match=r"no file of .* is in 'none'"):
        jf.datasets.folder(root / "set", splits={"none": ["x*"]})


def test_a_cloud_is_found_by_its_name_where_the_environment_says(place, monkeypatch):
    root, _ = place
    monkeypatch.setenv("JAXFILTER_DATA", str(root))
    assert len(jf.datasets.load("isprs/samp99")) == 50 == len(jf.datasets.load(str(root / "isprs" / "samp99.txt")))
    assert jf.datasets.load("isprs/samp99").reference is not None
    assert list(jf.datasets.folder("isprs")) == ["samp99"]
    with pytest.raises(jf.InputError, match=r"no data set 'isprs/samp12': .* has samp99(.|\n)*JAXFILTER_DATA"):
        jf.datasets.load("isprs/samp12")
    monkeypatch.setenv("JAXFILTER_DATA", str(root / "nowhere"))
    with pytest.raises(jf.InputError, match=r"nowhere is no folder(.|\n)*Sithole"):
        jf.datasets.load("isprs/samp12")


def test_a_comparison_of_a_folder_has_one_cloud_in_memory_at_a_time(place, monkeypatch):
    root, _ = place
    data = jf.datasets.folder(root / "set", reading=jf.Reading(units="m"))
    compared = jf.compare({"SMRF": jf.SMRF()}, data, repeats=0, cell=None)
    assert compared.table["cloud"].tolist() == ["test/b", "train/a"]
    assert compared.table["total"].nunique() == 1


@pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
def test_the_page_on_benchmarks_suits_folders_of_their_layouts(tmp_path, monkeypatch, capsys):
    """Ground is ground, what has no reference is not scored, and methods see all but what nobody measured."""
    scene = jf.scenes.make("mixed", size=50, density=1.0, seed=2)
    number = np.arange(len(scene))
    ground, kind = scene.truth, number % 10
    layouts = {  # classes of objects, by a number from 0 to 9; that of ground; those that are not scored, and not seen
        "opengf": (["OpenGF/Train/S1_1.laz", "OpenGF/Validation/S1_2.laz", "OpenGF/Validation/S9_3.laz", "OpenGF/Test/T1.laz"],
                   [1], 2, (), ()),
        "dales": (["dales_las/train/5080_54435.las", "dales_las/test/5080_54400.las"], [2, 3, 4, 5, 6, 7, 8, 0], 1, (0,), ()),
        "fractal": (["FRACTAL/train/TRAIN-0.laz", "FRACTAL/val/VAL-0.laz", "FRACTAL/test/TEST-0.laz"],
                    [1, 3, 4, 5, 6, 9, 17, 64, 65, 66], 2, (9, 65, 66), (65, 66)),
    }  # fmt: skip
    classes = {}
    for name, (files, objects, as_ground, *_) in layouts.items():
        classes[name] = np.where(ground, as_ground, np.resize(objects, 10)[kind]).astype(np.uint8)
        for file in files:
            (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
            jf.write(tmp_path / file, dataclasses.replace(scene.cloud, classification=classes[name]), None)
    (tmp_path / "predictions").mkdir()
    np.save(tmp_path / "predictions" / "5080_54400.npy", ground)
    monkeypatch.chdir(tmp_path)
    page, names = Path(__file__).parents[1] / "docs" / "benchmarks.md", {"jf": jf}
    for block in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL):
        exec(block, names)
    echoes = jf.PointCloud.from_arrays(scene.xyz, **{
        key: getattr(scene, key) for key in ("return_number", "number_of_returns")
    }).candidate  # fmt: skip
    for name, (files, _, _, unscored, unseen) in layouts.items():
        assert len(names[name]) == len(files)
        for cloud in names[name].values():
            scored = ~np.isin(classes[name], unscored)
            assert (cloud.reference == ground).all() and (reference_labels(cloud)[1] == scored).all()
            assert (cloud.candidate == (echoes & ~np.isin(classes[name], unseen))).all()
    assert names["terrain"] == {"Validation/S1_2": "S1", "Validation/S9_3": "S9"}
    row = capsys.readouterr().out.splitlines()[2]
    assert row.startswith("| test/5080_54400 | **0.00** | **0.00** | **0.00** | **100.00** |")
